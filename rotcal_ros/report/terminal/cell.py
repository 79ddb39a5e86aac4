"""Shows the findings of a check of a cell: a line for each thing, then what to do next."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Iterator
from itertools import groupby
from typing import TYPE_CHECKING, Final

import click

from rotcal_ros.foundation.escapes import printable
from rotcal_ros.methods.check_lines import CellReport, CheckLine

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

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
    """Return the lines as a table without rules, with the parts of the cell on the left."""
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
    """Yield the lines part by part, in the order in which the parts first occur."""
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
