"""Shows people lines and progress bars on standard error while something runs."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import click

from rotcal_ros.bags.unread_data import note_printed
from rotcal_ros.foundation.escapes import printable

if TYPE_CHECKING:
    from rich.progress import Progress

    from rotcal_ros.foundation.table_reading import Reading


def say(text: str) -> None:
    """Print a line for people on standard error, above a progress bar if there is one."""
    note_printed(text)
    # Not click.echo: it writes past what rich puts in place of standard error meanwhile.
    sys.stderr.write(f"{printable(text)}\n")


def print_reading(reading: Reading) -> None:
    """Say in one line how a table of another form than ours was read."""
    if line := reading.line():
        say(f"read: {line}")


def tell(*lines: str, colour: str = "", err: bool = False) -> None:
    """Print lines on standard output (``err``: error), safe with any names in them."""
    for line in lines:
        note_printed(line)
        click.echo(click.style(printable(line), colour) if colour else printable(line), err=err)


def progress_bar(*, time_left: bool = True) -> Progress:
    """Return a progress bar with counts and time left on standard error; a context manager.

    It is silent when standard error is not a terminal. Without ``time_left`` the description may
    state it.
    """
    # rich takes longer to load than a short verb takes to run.
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
    from rich.progress import TimeRemainingColumn as TimeLeft

    console = Console(stderr=True)
    return Progress(
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        *([TimeLeft()] if time_left else []),
        console=console,
        disable=not console.is_terminal,
    )


@contextmanager
def progress(what: str) -> Iterator[Callable[[int, int], None]]:
    """Show a progress bar and yield the function (done, total) that moves it."""
    if not (sys.stderr.isatty() or "FORCE_COLOR" in os.environ):
        yield lambda _done, _total: None  # rich takes longer to load than a small bag to be solved
        return
    with progress_bar() as bar:
        task = bar.add_task(what, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)
