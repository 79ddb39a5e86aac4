"""``rotcal plan trade``: what a required uncertainty takes, for each of the methods."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rotcal_design.verbs.options import (
    positive,
    positive_numbers,
    positive_whole_numbers,
)
from rotcal_ros.cli.console import json_option, path_type, print_json
from rotcal_ros.cli.options import shown_option
from rotcal_ros.foundation.components import COVERAGE_FACTOR
from rotcal_ros.foundation.units import ARCSEC, HOUR, MICROMETRE, MINUTE
from rotcal_ros.report.terminal.columns import Column, column_of, print_table, print_words

if TYPE_CHECKING:
    from rotcal_ros.methods.configuration import Configuration


@dataclass(frozen=True)
class TradeTable:
    """A trade table: ``data`` in SI for programs; ``columns``, title and ``notes`` for people."""

    data: dict[str, Any]
    columns: Sequence[Column]
    title: str
    notes: tuple[str, ...] = ()

    def show(self) -> None:
        """Print the table for people."""
        print_table(self.columns, self.title)
        print_words(*self.notes)


class TradeCommand(click.Command):
    """A command whose function returns a trade table, which is printed."""

    def invoke(self, context: click.Context) -> int:
        """Print the table that the options ask for."""
        as_json = context.params.pop("as_json")
        table: TradeTable = super().invoke(context)
        if as_json:
            print_json(table.data)
        else:
            table.show()
        return 0


def _usual(command: click.Command) -> TradeTable:
    """Return the table of the default options."""
    context = command.make_context(command.name, [])
    del context.params["as_json"]
    table: TradeTable = click.Command.invoke(command, context)
    return table


@click.group(invoke_without_command=True)
@json_option
@click.pass_context
def trade(context: click.Context, as_json: bool) -> int:
    """Show which sizes, noises and numbers reach a required U(ECC).

    Without a method: the usual case of each.
    """
    if context.invoked_subcommand is None:
        methods = {
            "tracer": tracer, "plate": plate, "mirror": mirror, "balls": balls, "turning": turning
        }  # fmt: skip
        tables = {name: _usual(command) for name, command in methods.items()}
        if as_json:
            print_json({name: table.data for name, table in tables.items()})
            return 0
        for number, table in enumerate(tables.values()):
            click.echo("\n" * bool(number), nl=False)
            table.show()
    return 0


PAPER_ANGLES: dict[str, Any] = {
    "table_start_deg": -145.0,
    "table_step_deg": 30.0,
    "table_positions": 11,
}
"""Table angles of the laser-tracer paper, as settings."""
SPACING_M = 0.17
"""Between the targets that are offered."""


@trade.command(cls=TradeCommand)
@shown_option("--need-arcsec", type=positive, default=1.2, help="arcsec, required U(ECC), k = 2.")
@shown_option("--radius-m", default="0.065,0.13", help="m, distances of the tracer from the axis.")
@shown_option("--sigma-um", default="0.1,0.2,0.4", help="um, noise of a length (k = 1).")
@shown_option("--target-um", type=positive, default=1.0, help="um, error of a target (k = 1).")
@shown_option(
    "--elevation-deg", type=click.FloatRange(-90.0, 89.0), default=10.0, help="deg, lowest beam."
)
@shown_option(
    "--zero",
    type=click.Choice(("run", "station")),
    default="run",
    help="A zero of the lengths per unbroken run, or one per station.",
)
@shown_option("--turn-s", type=positive, default=10.0, help="s, one rotation.")
@shown_option("--length-s", type=positive, default=5.0, help="s, one length with its move.")
@json_option
def tracer(
    need_arcsec: float,
    radius_m: str,
    sigma_um: str,
    target_um: float,
    elevation_deg: float,
    zero: str,
    turn_s: float,
    length_s: float,
) -> TradeTable:
    """Targets and lengths that a tracer needs, by the radius of its circle and its noise.

    The table angles are those of the paper, the targets lie in x +-0.6, y +-0.5, z 0.17 to 1.02 m.
    """
    from rotcal_design.settings import PER_STATION, SHARED, TracerDesignSettings
    from rotcal_design.tracer.trade import tracer_trade
    from rotcal_ros.planning.sequence_time import constant_time_model
    from rotcal_ros.report.terminal.console import progress

    radii, sigmas = (
        positive_numbers(radius_m, "--radius-m"), positive_numbers(sigma_um, "--sigma-um")
    )  # fmt: skip
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
        rows = tracer_trade(
            settings, radii, [sigma * MICROMETRE for sigma in sigmas],
            time=constant_time_model(turn_s, length_s), progress=shown,
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
    notes = (
        "a row without lengths: the goal is out of reach, and U is that of all lengths together",
    ) * beyond
    return TradeTable({"need_rad": need_arcsec * ARCSEC, **_rows(rows)}, columns, title, notes)


@trade.command(cls=TradeCommand)
@shown_option("--need-arcsec", type=positive, default=0.05, help="arcsec, required U(ECC), k = 2.")
@shown_option("--grid", type=click.IntRange(min=5), default=72, help="Table angles in a turn.")
@shown_option("--balls", default="8,10,12,16", help="Numbers of balls.")
@shown_option("--radius-m", type=positive, default=0.185, help="m, radius of the ball circle.")
@shown_option("--sigma-um", type=positive, default=0.05, help="um, noise of a centre (k = 1).")
@shown_option("--centre-s", type=positive, default=35.0, help="s, one centre with its moves.")
@json_option
def plate(
    need_arcsec: float, grid: int, balls: str, radius_m: float, sigma_um: float, centre_s: float
) -> TradeTable:
    """Show what a plate of so many balls gives, and how much a better plan could save."""
    from rotcal_design.ball_plate.ball_layout import plate_trade

    rows = plate_trade(
        grid,
        positive_whole_numbers(balls, "--balls"),
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
        f"whichever balls at whichever positions, a plan could save at most {100.0 * least:.0f} "
        f"to {100.0 * most:.0f} % of the centres; only R, sigma and the number of centres matter"
    )
    return TradeTable({"need_rad": need_arcsec * ARCSEC, **_rows(rows)}, columns, title, (note,))


@trade.command(cls=TradeCommand)
@click.argument("configuration", type=path_type, metavar="[CONFIG]", required=False)
@shown_option("--stations", default="4,6,8", help="Numbers of tracker stations.")
@shown_option("--reflectors", default="1,2,3", help="Numbers of reflectors at each position.")
@shown_option("--move-s", type=positive, default=600.0, help="s, to move the tracker.")
@shown_option("--pair-s", type=positive, default=50.0, help="s, a pair direct and mirrored.")
@shown_option("--nest-s", type=positive, default=10.0, help="s, one nest.")
@json_option
def mirror(
    configuration: Path | None,
    stations: str,
    reflectors: str,
    move_s: float,
    pair_s: float,
    nest_s: float,
) -> TradeTable:
    """Hours and U of a plane mirror by stations and reflectors, for CONFIG or the usual case."""
    from rotcal_design.trades import USUAL_MIRROR, mirror_trade

    rows = mirror_trade(
        _configuration(configuration, USUAL_MIRROR),
        positive_whole_numbers(stations, "--stations"),
        positive_whole_numbers(reflectors, "--reflectors"),
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
    return TradeTable(_rows(rows), columns, title)


@trade.command(cls=TradeCommand)
@click.argument("configuration", type=path_type, metavar="[CONFIG]", required=False)
@shown_option("--need-um", type=positive, default=1.0, help="um, required U of the axis, k = 2.")
@shown_option("--minutes", type=positive, default=15.0, help="min, that it may take.")
@shown_option("--balls", "numbers", default="1,2,3", help="Numbers of balls, of those of CONFIG.")
@shown_option("--angles", default="6,8,12,18", help="Table angles in a turn.")
@shown_option("--runs", default="1,2,3", help="Runs through the angles.")
@shown_option("--touch-s", type=positive, default=2.0, help="s, one touch.")
@shown_option("--way-s", type=positive, default=3.0, help="s, the way to a ball.")
@shown_option("--turn-deg-s", type=positive, default=12.0, help="deg/s, of the table.")
@json_option
def balls(
    configuration: Path | None,
    need_um: float,
    minutes: float,
    numbers: str,
    angles: str,
    runs: str,
    touch_s: float,
    way_s: float,
    turn_deg_s: float,
) -> TradeTable:
    """Touches and minutes that balls on the table take, for CONFIG or the usual case."""
    from rotcal_design.trades import USUAL_BALLS, balls_trade

    rows = balls_trade(
        _configuration(configuration, USUAL_BALLS),
        positive_whole_numbers(numbers, "--balls"),
        positive_whole_numbers(angles, "--angles"),
        positive_whole_numbers(runs, "--runs"),
        touch_s=touch_s,
        way_s=way_s,
        turn_deg_s=turn_deg_s,
    )
    need, limit = need_um * MICROMETRE, minutes * MINUTE
    good = [row for row in rows if row.place <= need and row.seconds <= limit]
    fewest = min(good, key=lambda row: (row.touches, row.seconds), default=None)
    if fewest is None:
        note = f"none of these reaches {need_um:g} um within {minutes:g} minutes"
    else:
        note = (
            f"fewest touches for U <= {need_um:g} um: {fewest.touches}, with {fewest.balls} balls "
            f"at {fewest.angles} angles, runs: {fewest.runs}"
        )
    columns = [
        Column("balls", [row.balls for row in rows]),
        Column("angles", [row.angles for row in rows]),
        Column("runs", [row.runs for row in rows]),
        Column("touches", [row.touches for row in rows]),
        column_of("minutes", [row.seconds for row in rows], MINUTE, ".1f"),
        column_of("U(XOC)/um", [row.place for row in rows], MICROMETRE, ".2f"),
        column_of("no plan below/um", [row.bound for row in rows], MICROMETRE, ".2f"),
        column_of("U(AOC)/arcsec", [row.lean for row in rows], ARCSEC, ".2f"),
        column_of("U(ECC)/arcsec", [row.turn for row in rows], ARCSEC, ".2f"),
    ]
    title = "balls on the table: touches, minutes and U of the axis (k = 2)"
    return TradeTable({"need_m": need, **_rows(rows)}, columns, title, (note,))


@trade.command(cls=TradeCommand)
@click.argument("configuration", type=path_type, metavar="[CONFIG]...", nargs=-1)
@shown_option("--need-arcsec", type=positive, default=1.0, help="arcsec, required U(ECC), k = 2.")
@shown_option("--targets", default="4,6,8", help="Numbers of targets, of those of CONFIG.")
@shown_option("--angles", default="12,36", help="Table angles where the table stands.")
@json_option
def turning(
    configuration: tuple[Path, ...], need_arcsec: float, targets: str, angles: str
) -> TradeTable:
    """Minutes and U of a tracer while the table turns, and where it stands at its angles.

    For each CONFIG, else for the usual cases: at one place (ECC), and at three (all six
    deviations). In both directions, with one noise of a length for both.
    """
    from rotcal_design.trades import USUAL_SIX, USUAL_TURNS, turning_trade
    from rotcal_ros.methods import parse_configuration, read_configuration

    rows = turning_trade(
        [read_configuration(path) for path in configuration]
        or [parse_configuration(usual) for usual in (USUAL_TURNS, USUAL_SIX)],
        positive_whole_numbers(targets, "--targets"),
        positive_whole_numbers(angles, "--angles"),
    )
    need = need_arcsec * ARCSEC
    fewest = next((row for row in rows if not row.stands and row.expanded <= need), None)
    note = f"no turns of so many targets reach {need_arcsec:g} arcsec"
    if fewest is not None:
        note = f"fewest turns for U <= {need_arcsec:g} arcsec: those of {fewest.targets} targets"
    each = {(row.places, row.targets, row.stands) for row in rows}
    notes = [note] + [
        f"{places} places and {number} targets: only while the table turns, at rest too few"
        for places, number, stands in sorted(each)
        if not stands and (places, number, True) not in each
    ]
    columns = [
        Column("table", ["stands" if row.stands else "turns" for row in rows]),
        Column("places", [row.places for row in rows]),
        Column("targets", [row.targets for row in rows]),
        Column("angles", [row.angles for row in rows]),
        Column("lengths", [row.lengths for row in rows]),
        column_of("minutes", [row.seconds for row in rows], MINUTE, ".1f"),
        column_of("U(ECC)/arcsec", [row.expanded for row in rows], ARCSEC, ".2f"),
    ]
    if any(row.shift is not None for row in rows):
        columns += [
            Column("U(EXC EYC EZC)/um", [_shown(row.shift, MICROMETRE) for row in rows]),
            Column("U(EAC EBC)/arcsec", [_shown(row.lean, ARCSEC) for row in rows]),
        ]
    columns.append(Column("not tested for", ["; ".join(row.untested) for row in rows]))
    title = "tracer: a table that turns beside one that stands (U with k = 2, rms)"
    return TradeTable({"need_rad": need, **_rows(rows)}, columns, title, tuple(notes))


def _shown(size: float | None, unit: float) -> str:
    """Return a size in its unit, nothing for one that is not measured."""
    return "" if size is None else f"{size / unit:.2f}"


def _configuration(path: Path | None, usual: str) -> Configuration:
    from rotcal_ros.methods import parse_configuration, read_configuration

    return read_configuration(path) if path else parse_configuration(usual)


def _rows(rows: Sequence[Any]) -> dict[str, Any]:
    return {"coverage": COVERAGE_FACTOR, "ways": [asdict(row) for row in rows]}
