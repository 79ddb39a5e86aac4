"""``rotcal cell``: a live cell, checked before it is calibrated."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from rotcal_ros.cli.console import json_option, path_type, print_json
from rotcal_ros.cli.options import configurations
from rotcal_ros.report.terminal.console import say

if TYPE_CHECKING:
    from rotcal_ros.methods.check_lines import CellReport


@click.group()
def command() -> None:
    """Examine a live cell: what is there, what is missing, what would happen."""


@command.command()
@click.argument(
    "configuration", required=False, type=path_type, metavar="[CONFIG]",
    shell_complete=configurations,
)  # fmt: skip
@click.option("--namespace", default="", help="ROS namespace; default: that of CONFIG, or /cell.")
@click.option(
    "--time",
    "seconds",
    default=5.0,
    show_default=True,
    type=click.FloatRange(1.0, 3600.0),
    help="Seconds to listen.",
)
@click.option(
    "--move",
    is_flag=True,
    help="Then, once you agree, turn the table by 5 degrees and back: checks sign, unit, "
    "handedness, lag and rest.",
)
@json_option
def check(
    configuration: Path | None, namespace: str, seconds: float, move: bool, as_json: bool
) -> int:
    """Listen to the cell of CONFIG and report line by line what is there and what is missing.

    Nothing moves except with --move, and only the cell needs to run. With CONFIG its plan is
    checked too: the first order, whether everything is in reach, and the time. The exit code is 0
    if nothing is missing, otherwise 1, with what to do next.
    """
    from rotcal_ros.sessions.cell_check import check_cell
    from rotcal_ros.sessions.processes import require_ros

    if move and configuration is None:
        raise click.UsageError("--move needs CONFIG: it says which joint the table is")
    require_ros()
    if not as_json:
        say(f"listening for {seconds:g} s; nothing is moved, Ctrl-C ends it")
    report = check_cell(configuration, namespace, seconds)
    if move and configuration is not None:
        report = _moved(configuration, report)
    if as_json:
        print_json(report.to_dict())
    else:
        from rotcal_ros.report.terminal.cell import print_cell

        print_cell(report)
    return 0 if report.complete else 1


def _moved(configuration: Path, report: CellReport) -> CellReport:
    """Turn the table, if nothing speaks against it and the person agrees."""
    from rotcal_ros.sessions.cell_check import move_cell

    against = [line for line in report.lines if line.part == "table" and line.state == "doubt"]
    if not report.complete or against:
        say("the table is not turned: first correct what is missing or doubtful about it")
        return report
    here = (line.found for line in report.lines if (line.part, line.name) == ("table", "joint"))
    say(
        f"{next(here, 'the table')}; it will turn by 5° and back, much further if its unit or "
        "sign is wrong"
    )
    question = "Is its path clear, and a hand on the emergency stop?"
    if not click.confirm(question, err=True):
        return report
    return _answered(move_cell(configuration, report))


def _answered(report: CellReport) -> CellReport:
    """Ask the person which way the table turned, if no instrument could tell."""
    from rotcal_ros.methods.trial_motion import handedness_seen

    if not any(line.name == "handedness" and line.state == "open" for line in report.lines):
        return report
    question = "Seen from above, where did a positive angle turn it"
    sides = click.Choice(["counter-clockwise", "clockwise", "unknown"])
    seen = click.prompt(question, type=sides, default="unknown", err=True)
    return handedness_seen(report, seen)
