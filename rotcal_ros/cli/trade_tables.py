"""The trade tables of the methods, for programs and, as lines, for people."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rotcal_ros.components import COVERAGE_FACTOR
from rotcal_ros.units import ARCSEC, MICROMETRE

Table = tuple[dict[str, Any], list[str]]
"""In SI for programs; lines for people."""
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
) -> Table:
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
        min_elevation_deg=elevation_deg,
        zero=PER_STATION if zero == "station" else SHARED,
        spacing_m=SPACING_M,
    )
    with progress("plans") as shown:
        rows = trade(
            settings, radii_m, [sigma * MICROMETRE for sigma in sigmas_um],
            time=stated_time(turn_s, length_s), progress=shown,
        )  # fmt: skip
    lines = [
        f"laser tracer, {settings.table_positions} table angles, for U(ECC) <= {need_arcsec:g} "
        f"arcsec (k = 2, rms), a zero per {zero}; every length checked",
        "   R/mm  sigma/um  targets  lengths  no plan below  hours  U/arcsec",
    ]
    for row in rows:
        head = f"{row.radius * 1e3:7.1f}  {row.sigma / MICROMETRE:8.2f}"
        if row.lengths is None:
            lines.append(f"{head}  out of reach: {row.expanded / ARCSEC:.3f} with all lengths")
            continue
        bound, seconds = row.bound or 0.0, row.seconds or 0.0
        lines.append(
            f"{head}  {row.targets:7d}  {row.lengths:7d}  {bound:13.1f}  {seconds / 3600.0:5.2f}"
            f"  {row.expanded / ARCSEC:8.3f}"
        )
    return {"need_rad": need_arcsec * ARCSEC, **_rows(rows)}, lines


def plate_table(
    need_arcsec: float = 0.05,
    grid: int = 72,
    balls: Sequence[int] = (8, 10, 12, 16),
    radius_m: float = 0.185,
    sigma_um: float = 0.05,
    centre_s: float = 35.0,
) -> Table:
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
    lines = [
        f"ball plate, {grid} table angles, R = {1e3 * radius_m:g} mm, sigma = {sigma_um:g} um; "
        f"what U(ECC) <= {need_arcsec:g} arcsec takes (k = 2)",
        "balls  centres  hours  U/arcsec  or R/mm  or sigma/um  no plan saves more than",
        *(
            f"{row.balls:5d}  {row.centres:7d}  {row.seconds / 3600.0:5.1f}  "
            f"{row.expanded / ARCSEC:8.4f}  {1e3 * row.radius:7.1f}  "
            f"{row.sigma / MICROMETRE:11.4f}  {100.0 * row.saving:5.1f} % of the centres"
            for row in rows
        ),
        f"whichever balls at whichever positions: {100.0 * least:.0f} to {100.0 * most:.0f} % is "
        "all that a plan could gain; only R, sigma and the number of centres matter",
    ]
    return {"need_rad": need_arcsec * ARCSEC, **_rows(rows)}, lines


def mirror_table(
    configuration: Path | None = None,
    stations: Sequence[int] = (4, 6, 8),
    reflectors: Sequence[int] = (1, 2, 3),
    move_s: float = 600.0,
    pair_s: float = 50.0,
    nest_s: float = 10.0,
) -> Table:
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
    lines = [
        "plane mirror: stations, reflectors and hours (U with k = 2, rms)",
        "stations  reflectors  pairs  nests  hours  U/arcsec",
        *(
            f"{row.stations:8d}  {row.reflectors:10d}  {row.pairs:5d}  {row.nests:5d}  "
            f"{row.seconds / 3600.0:5.2f}  {row.expanded / ARCSEC:8.3f}"
            for row in rows
        ),
    ]
    return _rows(rows), lines


def _rows(rows: Sequence[Any]) -> dict[str, Any]:
    return {"coverage": COVERAGE_FACTOR, "ways": [asdict(row) for row in rows]}
