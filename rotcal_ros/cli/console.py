"""What all verbs share: JSON goes to standard output, everything else to standard error."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Final, TypeVar

import click

if TYPE_CHECKING:
    from rich.progress import Progress

Function = TypeVar("Function", bound=Callable[..., Any])

VERDICT_EXIT_CODES: Final[Mapping[str, int]] = {"ok": 0, "suspect": 1, "failed": 1}
"""Exit code of a verb that ends with the verdict of a result."""


def json_option(function: Function) -> Function:
    """Add ``--json`` (argument ``as_json``): only JSON on standard output, the rest on error."""
    return click.option(
        "--json",
        "as_json",
        is_flag=True,
        help="Print the machine-readable form on standard output, and nothing else there.",
    )(function)


def print_json(data: str | Mapping[str, Any]) -> None:
    """Print JSON text, or a mapping as JSON, on standard output."""
    click.echo(data if isinstance(data, str) else json.dumps(data, indent=1, allow_nan=False))


def say(text: str) -> None:
    """Print a line for people on standard error."""
    click.echo(text, err=True)


def progress_bar() -> Progress:
    """Return a progress bar with counts and time left on standard error; a context manager.

    It is silent when standard error is not a terminal.
    """
    # rich takes longer to load than a short verb takes to run.
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
    from rich.progress import TimeRemainingColumn as TimeLeft

    console = Console(stderr=True)
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeLeft(),
        console=console,
        disable=not console.is_terminal,
    )
