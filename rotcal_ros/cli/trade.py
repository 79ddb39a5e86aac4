"""``rotcal plan trade``: what a wanted uncertainty takes, for each of the methods."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import click

from rotcal_ros.cli.console import json_option, path_type, print_json
from rotcal_ros.cli.trade_tables import Trade, mirror_table, plate_table, tracer_table
from rotcal_ros.errors import PlanError
from rotcal_ros.report.terminal.columns import print_table, print_words

shown_option = partial(click.option, show_default=True)
positive = click.FloatRange(min=0.0, min_open=True)


@click.group(invoke_without_command=True)
@json_option
@click.pass_context
def command(context: click.Context, as_json: bool) -> int:
    """How large, how quiet, how many for U(ECC) <= x; alone: the usual case of every method."""
    if context.invoked_subcommand is None:
        tables = {"tracer": tracer_table(), "plate": plate_table(), "mirror": mirror_table()}
        if as_json:
            print_json({name: table.data for name, table in tables.items()})
            return 0
        for number, table in enumerate(tables.values()):
            click.echo("\n" * bool(number), nl=False)
            _show(table)
    return 0


@command.command()
@shown_option("--need-arcsec", type=positive, default=1.2, help="arcsec, wanted U(ECC), k = 2.")
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
    as_json: bool,
) -> int:
    """Targets and lengths that a tracer needs, by the radius of its circle and its noise.

    The table angles are those of the paper, the targets lie in x +-0.6, y +-0.5, z 0.17 to 1.02 m.
    """
    table = tracer_table(
        need_arcsec,
        _numbers(radius_m, "--radius-m"),
        _numbers(sigma_um, "--sigma-um"),
        target_um,
        elevation_deg,
        zero,
        turn_s,
        length_s,
    )
    return _print(table, as_json)


@command.command()
@shown_option("--need-arcsec", type=positive, default=0.05, help="arcsec, wanted U(ECC), k = 2.")
@shown_option("--grid", type=click.IntRange(min=5), default=72, help="Table angles in a turn.")
@shown_option("--balls", default="8,10,12,16", help="Numbers of balls.")
@shown_option("--radius-m", type=positive, default=0.185, help="m, radius of the ball circle.")
@shown_option("--sigma-um", type=positive, default=0.05, help="um, noise of a centre (k = 1).")
@shown_option("--centre-s", type=positive, default=35.0, help="s, one centre with its moves.")
@json_option
def plate(
    need_arcsec: float,
    grid: int,
    balls: str,
    radius_m: float,
    sigma_um: float,
    centre_s: float,
    as_json: bool,
) -> int:
    """Show what a plate of so many balls gives, and how little a better plan could save."""
    counts = _whole(balls, "--balls")
    return _print(plate_table(need_arcsec, grid, counts, radius_m, sigma_um, centre_s), as_json)


@command.command()
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
    as_json: bool,
) -> int:
    """Hours and U of a plane mirror by stations and reflectors, for CONFIG or the usual case."""
    table = mirror_table(
        configuration,
        _whole(stations, "--stations"),
        _whole(reflectors, "--reflectors"),
        move_s,
        pair_s,
        nest_s,
    )
    return _print(table, as_json)


def _print(table: Trade, as_json: bool) -> int:
    if as_json:
        print_json(table.data)
    else:
        _show(table)
    return 0


def _show(table: Trade) -> None:
    print_table(table.columns, table.title)
    print_words(*table.notes)


def _whole(text: str, option: str) -> list[int]:
    numbers = _numbers(text, option)
    if not all(map(float.is_integer, numbers)):
        raise PlanError(f"{option} {text}: expected whole numbers")
    return [int(number) for number in numbers]


def _numbers(text: str, option: str) -> list[float]:
    """Return positive numbers separated by commas."""
    try:
        numbers = [float(part) for part in text.replace(",", " ").split()]
    except ValueError:
        numbers = []
    if not numbers or not all(0.0 < number < float("inf") for number in numbers):
        raise PlanError(f"{option} {text}: expected positive numbers separated by commas")
    return numbers
