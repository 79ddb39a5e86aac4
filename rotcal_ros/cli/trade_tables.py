"""The trade tables of the methods, for programs and for people."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rotcal_ros.components import COVERAGE_FACTOR
from rotcal_ros.report.terminal.columns import Column, column_of
from rotcal_ros.units import ARCSEC, HOUR, MICROMETRE


@dataclass(frozen=True)
class Trade:
    """A trade table: ``data`` in SI for programs; ``columns``, title and ``notes`` for people."""

    data: dict[str, Any]
    columns: Sequence[Column]
    title: str
    notes: tuple[str, ...] = ()


PAPER_ANGLES: dict[str, Any] = {
    "table_start_deg": -145.0,
    "table_step_deg": 30.0,
    "table_positions": 11,
}
"""Table angles of the laser-tracer paper, as settings."""
SPACING_M = 0.17
"""Between the targets that are offered."""


def tracer_table(
    need_arcsec: float = 1.2,
    radii_m: Sequence[float] = (0.065, 0.13),
    sigmas_um: Sequence[float] = (0.1, 0.2, 0.4),
    target_um: float = 1.0,
    elevation_deg: float = 10.0,
    zero: str = "run",
    turn_s: float = 10.0,
    length_s: float = 5.0,
) -> Trade:
    """Return how many targets and lengths each radius and noise takes."""
    from rotcal_ros.planning.sequence_time import stated_time
    from rotcal_ros.planning.tracer_design.settings import (
        PER_STATION,
        SHARED,
        TracerDesignSettings,
    )
    from rotcal_ros.planning.tracer_trade import trade
    from rotcal_ros.report.terminal.console import progress

    settings = TracerDesignSettings(
        **PAPER_ANGLES,
        need_arcsec=need_arcsec,
        target_std_m=(target_um * MICROMETRE,) * 3,
        error_motion_std_m=0.0,
        min_elevation_deg=elevation_deg,
        zero=PER_STATION if zero == "station" else SHARED,
        spacing_m=SPACING_M,
    )
    with progress("plans") as shown:
        rows = trade(
            settings, radii_m, [sigma * MICROMETRE for sigma in sigmas_um],
            time=stated_time(turn_s, length_s), progress=shown,
        )  # fmt: skip
    title = (
        f"laser tracer, {settings.table_positions} table angles, for U(ECC) <= {need_arcsec:g} "
        f"arcsec (k = 2, rms), a zero per {zero}; every length checked; a table without error "
        "motion"
    )
    columns = [
        column_of("R/mm", [row.radius for row in rows], 1e-3, ".1f"),
        column_of("sigma/um", [row.sigma for row in rows], MICROMETRE, ".2f"),
        Column("targets", [row.targets for row in rows]),
        Column("lengths", [row.lengths for row in rows]),
        Column("no plan below", [row.bound for row in rows], ".1f"),
        column_of("hours", [row.seconds for row in rows], HOUR, ".2f"),
        column_of("U/arcsec", [row.expanded for row in rows], ARCSEC, ".3f"),
    ]
    beyond = any(row.lengths is None for row in rows)
    notes = ("without a number of lengths it is out of reach: U is that of all lengths",) * beyond
    return Trade({"need_rad": need_arcsec * ARCSEC, **_rows(rows)}, columns, title, notes)


def plate_table(
    need_arcsec: float = 0.05,
    grid: int = 72,
    balls: Sequence[int] = (8, 10, 12, 16),
    radius_m: float = 0.185,
    sigma_um: float = 0.05,
    centre_s: float = 35.0,
) -> Trade:
    """Return what each number of balls gives, and what radius or noise it takes."""
    from rotcal_ros.planning.plate_trade import plate_trade

    rows = plate_trade(
        grid,
        balls,
        need_arcsec * ARCSEC,
        radius=radius_m,
        sigma=sigma_um * MICROMETRE,
        centre_s=centre_s,
    )
    least, most = min(row.saving for row in rows), max(row.saving for row in rows)
    title = (
        f"ball plate, {grid} table angles, R = {1e3 * radius_m:g} mm, sigma = {sigma_um:g} um; "
        f"what U(ECC) <= {need_arcsec:g} arcsec takes (k = 2)"
    )
    columns = [
        Column("balls", [row.balls for row in rows]),
        Column("centres", [row.centres for row in rows]),
        column_of("hours", [row.seconds for row in rows], HOUR, ".1f"),
        column_of("U/arcsec", [row.expanded for row in rows], ARCSEC, ".4f"),
        column_of("or R/mm", [row.radius for row in rows], 1e-3, ".1f"),
        column_of("or sigma/um", [row.sigma for row in rows], MICROMETRE, ".4f"),
        column_of("no plan saves more than/%", [row.saving for row in rows], 0.01, ".1f"),
    ]
    note = (
        f"whichever balls at whichever positions: {100.0 * least:.0f} to {100.0 * most:.0f} % of "
        "the centres is all that a plan could gain; only R, sigma and the number of centres matter"
    )
    return Trade({"need_rad": need_arcsec * ARCSEC, **_rows(rows)}, columns, title, (note,))


def mirror_table(
    configuration: Path | None = None,
    stations: Sequence[int] = (4, 6, 8),
    reflectors: Sequence[int] = (1, 2, 3),
    move_s: float = 600.0,
    pair_s: float = 50.0,
    nest_s: float = 10.0,
) -> Trade:
    """Return U and hours of each number of stations and reflectors."""
    from rotcal_ros.catalogue import parse_configuration, read_configuration
    from rotcal_ros.catalogue.plane_mirror.trade import USUAL, mirror_trade

    rows = mirror_trade(
        read_configuration(configuration) if configuration else parse_configuration(USUAL),
        stations,
        reflectors,
        move_s=move_s,
        pair_s=pair_s,
        nest_s=nest_s,
    )
    columns = [
        Column("stations", [row.stations for row in rows]),
        Column("reflectors", [row.reflectors for row in rows]),
        Column("pairs", [row.pairs for row in rows]),
        Column("nests", [row.nests for row in rows]),
        column_of("hours", [row.seconds for row in rows], HOUR, ".2f"),
        column_of("U/arcsec", [row.expanded for row in rows], ARCSEC, ".3f"),
    ]
    title = "plane mirror: stations, reflectors and hours (U with k = 2, rms)"
    return Trade(_rows(rows), columns, title)


def _rows(rows: Sequence[Any]) -> dict[str, Any]:
    return {"coverage": COVERAGE_FACTOR, "ways": [asdict(row) for row in rows]}
