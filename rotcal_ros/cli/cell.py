"""``rotcal cell``: a live cell, checked before it is calibrated.

It prints a line for each thing that was checked, then what to do next.
"""

from __future__ import annotations

import shutil
import sys
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click

from rotcal_ros.cli.console import json_option, path_type, print_json
from rotcal_ros.cli.options import complete_configurations
from rotcal_ros.foundation.escapes import printable
from rotcal_ros.methods.check_lines import CellReport, CheckLine
from rotcal_ros.report.terminal.console import say

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from rotcal_ros.methods.check_lines import CellReport


@click.group()
def command() -> None:
    """Examine a live cell: what is there, what is missing, what would happen."""


@command.command()
@click.argument(
    "configuration", required=False, type=path_type, metavar="[CONFIG]",
    shell_complete=complete_configurations,
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
        from rotcal_ros.cli.cell import print_cell

        print_cell(report)
    return 0 if report.complete else 1


def _moved(configuration: Path, report: CellReport) -> CellReport:
    """Turn the table, if nothing speaks against it and the person agrees."""
    from rotcal_ros.sessions.cell_check import move_cell

    against = [line for line in report.lines if line.part == "table" and line.state == "doubt"]
    if not report.complete or against:
        say("the table is not turned: first correct what is missing, or doubtful about the table")
        return report
    here = (line.found for line in report.lines if (line.part, line.name) == ("table", "joint"))
    say(
        f"{next(here, 'the table')}; it will turn by 5° and back, or much further if its unit or "
        "sign is wrong"
    )
    question = "Is its path clear, and is a hand on the emergency stop?"
    if not click.confirm(question, err=True):
        return report
    return _answered(move_cell(configuration, report))


def _answered(report: CellReport) -> CellReport:
    """Ask the person which way the table turned, if no instrument could show it."""
    from rotcal_ros.methods.trial_motion import handedness_seen

    if not any(line.name == "handedness" and line.state == "open" for line in report.lines):
        return report
    question = "Seen from above, which way did a positive angle turn it"
    sides = click.Choice(["counter-clockwise", "clockwise", "unknown"])
    seen = click.prompt(question, type=sides, default="unknown", err=True)
    return handedness_seen(report, seen)


_MARKS: Final = {
    "good": ("✓", "green"),
    "doubt": ("!", "yellow"),
    "missing": ("✗", "red"),
    "open": ("?", "cyan"),
    "note": ("·", "bright_black"),
}
"""State -> mark, colour."""
_PIPE_WIDTH: Final = 200


def print_cell(report: CellReport) -> None:
    """Print a check on standard output, as wide as the terminal is."""
    from rich.console import Console

    width = shutil.get_terminal_size().columns if sys.stdout.isatty() else _PIPE_WIDTH
    console = Console(highlight=False, markup=False, emoji=False, width=width)
    with console.capture() as drawn:
        _draw(console, report)
    for line in drawn.get().splitlines():
        click.echo(line.rstrip())


def _draw(console: Console, report: CellReport) -> None:
    from rich.text import Text

    heading = f"cell {report.namespace}, listened for {report.seconds:g} s"
    console.print(Text(printable(heading), style="bold"))
    console.print(Text(printable(report.place), style="bright_black"))
    console.print(_table(report.lines))
    todos = report.todos()
    if todos:
        console.print(Text("What to do next", style="bold"))
        console.print(_numbered(todos))
    colour, verdict = _verdict(report)
    console.print(Text(verdict, style=f"bold {colour}"))


def _table(lines: tuple[CheckLine, ...]) -> Table:
    """Return the lines as a table without rules, the parts of the cell on the left."""
    from rich.table import Table
    from rich.text import Text

    table = Table.grid(padding=(0, 1))
    table.add_column(no_wrap=True, style="bold")
    table.add_column(no_wrap=True)
    table.add_column(no_wrap=True)
    table.add_column(no_wrap=True, justify="right")
    table.add_column(overflow="fold")
    for part, first, line in _with_parts(lines):
        mark, colour = _MARKS[line.state]
        if first and table.row_count:
            table.add_row()
        table.add_row(
            part if first else "",
            Text(mark, style=colour),
            printable(line.name),
            _rate(line),
            Text(
                printable(_words(line)), style=colour if line.state in ("missing", "doubt") else ""
            ),
        )
    return table


def _with_parts(lines: tuple[CheckLine, ...]) -> Iterator[tuple[str, bool, CheckLine]]:
    """Yield the lines part by part, in the order in which the parts were first named."""
    order = list(dict.fromkeys(line.part for line in lines))
    in_order = sorted(lines, key=lambda line: order.index(line.part))
    for part, group in groupby(in_order, key=lambda line: line.part):
        for number, line in enumerate(group):
            yield part, number == 0, line


def _rate(line: CheckLine) -> str:
    if line.rate_hz is None:
        return ""
    return f"{line.rate_hz:.0f} Hz" if line.rate_hz >= 10 else f"{line.rate_hz:.2g} Hz"


def _words(line: CheckLine) -> str:
    if line.state == "open" and line.todo:
        return f"{line.found}: {line.todo}"
    if line.stamp_offset_s is None:
        return line.found
    offset = line.stamp_offset_s
    size = f"{offset * 1e3:+.1f} ms" if abs(offset) < 1 else f"{offset:+.2f} s"
    return f"{line.found} · stamps {size}"


def _numbered(todos: tuple[str, ...]) -> Table:
    from rich.table import Table

    table = Table.grid(padding=(0, 1))
    table.add_column(justify="right", no_wrap=True)
    table.add_column(overflow="fold")
    for number, text in enumerate(todos, start=1):
        table.add_row(f" {number}.", printable(text))
    return table


def _verdict(report: CellReport) -> tuple[str, str]:
    """Return colour and text of the last line."""
    counts = {state: sum(line.state == state for line in report.lines) for state in _MARKS}
    doubts = f", {counts['doubt']} doubtful" if counts["doubt"] else ""
    moved = "the table was turned there and back" if report.moved else "nothing was moved"
    if report.complete:
        text = "all there" if counts["good"] > 1 else "nothing is missing"
        return ("yellow" if doubts else "green"), f"{text}{doubts}; {moved}"
    return "red", f"{counts['missing']} missing{doubts}; {moved}"
