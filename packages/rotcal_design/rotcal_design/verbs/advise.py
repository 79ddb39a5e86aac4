"""``rotcal plan advise``: which method fits what somebody owns, and the command that begins it."""

from __future__ import annotations

import sys
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import click

from rotcal_design.verbs.options import positive
from rotcal_ros.cli.console import json_option, print_json
from rotcal_ros.cli.options import set_option
from rotcal_ros.foundation.components import COMPONENTS, COVERAGE_FACTOR, unit_of
from rotcal_ros.foundation.errors import PlanError
from rotcal_ros.foundation.units import MICROMETRE, MINUTE
from rotcal_ros.report.terminal.columns import Column, print_table, print_words
from rotcal_ros.report.terminal.console import say

if TYPE_CHECKING:
    from collections.abc import Iterable

    from rotcal_design.advice import Advice, Goal


@click.command()
@click.option(
    "--own",
    "owned",
    multiple=True,
    metavar="INSTRUMENT",
    help="What there is: tracer, tracker, cmm, probe, ball-bar, r-test, polygon, interferometer; "
    "several times for several.",
)
@click.option(
    "--want",
    "wanted",
    multiple=True,
    metavar="COMPONENT[=U]",
    help="What has to be known, with the U (k = 2, arcsec or um) that is needed, such as ECC=2.",
)
@click.option("--minutes", type=positive, help="min, that it may take; default: any.")
@click.option(
    "--positions",
    type=click.IntRange(min=3),
    default=12,
    show_default=True,
    help="Table angles in a turn.",
)
@click.option(
    "--machine-um",
    type=positive,
    help="um (k = 1), how well the machine measures or places a point; default: of each method.",
)
@set_option
@json_option
def advise(
    owned: tuple[str, ...],
    wanted: tuple[str, ...],
    minutes: float | None,
    positions: int,
    machine_um: float | None,
    changes: tuple[str, ...],
    as_json: bool,
) -> int:
    """List the methods that fit what you own and want, predicted, with the command for each.

    What is not given is asked for at a terminal. U, minutes and what stays untested are those of
    the plan that the command begins, by its own measurement with the stated noise. --set states
    more of your instruments, such as solver.length_std_m, planner.turn_s or planner.step_s, for
    the methods that have it. The exit code is 1 if none meets the goal. --json without --own lists
    the instruments and components.
    """
    from rotcal_design.advice import OWNED, Goal, advise

    if as_json and not owned:
        units = {name: dict(zip(("size", "unit"), unit_of(name), strict=True))
                 for name in COMPONENTS}  # fmt: skip
        print_json({"instruments": {n: what for n, (what, _) in OWNED.items()}, "units": units})
        return 0

    asking = sys.stdin.isatty() and not as_json
    if asking and not owned:
        say("\n".join(f"{name:<15} {what}" for name, (what, _) in OWNED.items()))
        owned = tuple(click.prompt("what do you own", err=True).replace(",", " ").split())
    if asking and not wanted:
        question = "what do you want, with U (k = 2) in arcsec or um"
        wanted = tuple(click.prompt(question, default="ECC=2", err=True).split())
        minutes = minutes or float(click.prompt("minutes, 0: any", 0.0, err=True)) or None
        machine_um = machine_um or float(
            click.prompt("um (k = 1), how well the machine places a point, 0: not known", 0.0,
                         err=True)
        ) or None  # fmt: skip
    if not (owned and wanted):
        raise click.UsageError("say what you own and what you want: --own probe --want ECC=2")
    if unknown := sorted({*owned} - {*OWNED}):
        raise PlanError(
            f"no method here takes {', '.join(unknown)}; known: {', '.join(OWNED)}. Deviations "
            "that any instrument states are taken by 'rotcal export TABLE', checked by nothing"
        )
    goal = Goal(dict(map(_need, wanted)), positions, minutes * MINUTE if minutes else float("inf"))
    std = machine_um * MICROMETRE if machine_um else None
    found = advise(owned, goal, machine_std=std, changes=changes)
    if as_json:
        print_json({"coverage": COVERAGE_FACTOR, "ways": [each.to_dict() for each in found]})
    else:
        _print(found, goal)
    return int(not any(each.meets for each in found))


def _need(wanted: str) -> tuple[str, float]:
    """Return component and U in SI of COMPONENT[=U]."""
    name, equals, text = wanted.partition("=")
    with suppress(ValueError):
        value = float(text) if equals else 0.0
        if name in COMPONENTS and 0.0 <= value < float("inf") and bool(value) == bool(equals):
            return name, value * unit_of(name)[0]
    raise PlanError(f"--want {wanted}: expected one of {', '.join(COMPONENTS)}, such as ECC=2")


def _print(found: Iterable[Advice], goal: Goal) -> None:
    every = [each for each in found if not each.refused]
    columns = [
        Column("with", [each.instrument for each in every]),
        Column("method", [each.method for each in every]),
        Column("fits", ["yes" if each.meets else "no" for each in every]),
        Column("minutes", [each.seconds / MINUTE for each in every], ".0f"),
    ]
    for name in goal.need:
        size, label = unit_of(name)
        cells = [each.expanded.get(name) for each in every]
        shown = ["not determined" if u is None else f"{u / size:.2g}" for u in cells]
        columns.append(Column(f"U({name})/{label.replace('µ', 'u')}", shown))
    print_table(columns, "predicted, U with k = 2, the largest of all angles")
    for each in found:
        print_words(f"{each.instrument}, {each.method}: {each.title}", *_words(each))


def _words(each: Advice) -> Iterable[str]:
    if each.refused:
        yield f"  not predicted: {each.refused}"
        return
    yield f"  not tested for: {', '.join(each.untested) or 'nothing'}"
    if each.pauses:
        yield f"  a person's work {each.pauses} times, whose time is not counted"
    rests: dict[str, Any] = dict(each.rests_on)
    yield f"  rests on {', '.join(f'{name}={value}' for name, value in rests.items())}"
    yield f"  {each.command}"
