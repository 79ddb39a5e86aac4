"""What all verbs share: JSON goes to standard output, everything else to standard error."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final, TypeVar

import click

from rotcal_ros.files import write_atomically
from rotcal_ros.report.terminal.console import say, tell

Function = TypeVar("Function", bound=Callable[..., Any])

INTERRUPTED: Final = 130
"""Exit code when the user has ended a verb."""
VERDICT_EXIT_CODES: Final[Mapping[str, int]] = {"ok": 0, "suspect": 1, "failed": 1}
"""Exit code of a verb that ends with the verdict of a result."""

path_type = click.Path(path_type=Path)


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


def draw(output: Path, forms: Mapping[str, Callable[[], str]]) -> None:
    """Write the form of a drawing that the suffix of ``output`` asks for."""
    if output.suffix not in forms:
        raise click.UsageError(f"cannot draw {output.name}: name a {' or '.join(forms)} file")
    write_atomically(output, forms[output.suffix]())
    say(f"drawn: {output.absolute()}")


def print_line(text: str) -> None:
    """Print a line, if there is anything to say."""
    if text:
        tell(text)


def print_outcome(outcome: Mapping[str, Any], *, as_json: bool = False) -> int:
    """Print how a calibration ended and where everything is; return its exit code."""
    if outcome.get("interrupted"):
        return INTERRUPTED
    if as_json:
        print_json(outcome)
    else:
        parts = [
            f"{outcome['n_used']} steps used",
            f"{len(outcome['skipped_steps'])} skipped",
            f"{outcome['n_rejected']} attempts rejected",
        ]
        if "seconds" in outcome:
            parts.append(f"{outcome['seconds']:.0f} s")
        print_verdict(outcome["verdict_line"], ", ".join(parts))
        for name, path in outcome.get("files", {}).items():
            tell(f"{name + ':':<14}{path}")
        print_line(outcome.get("goal_line", ""))
    return VERDICT_EXIT_CODES[outcome["verdict"]]


def print_verdict(verdict_line: str, text: str) -> None:
    """Print the last line: the verdict, what it does not cover, and what it rests on."""
    colour = "green" if verdict_line == "ok" else "yellow"
    if not verdict_line.startswith("ok"):
        colour = "red"
    tell(f"verdict {verdict_line}: {text}", colour=colour)
