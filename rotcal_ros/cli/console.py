"""What all verbs share: JSON goes to standard output, everything else to standard error."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeVar

import click

from rotcal_ros.foundation.errors import RotcalError
from rotcal_ros.foundation.files import write_atomically
from rotcal_ros.report.terminal.console import say, tell

if TYPE_CHECKING:
    from rotcal_ros.foundation.results import Result

Function = TypeVar("Function", bound=Callable[..., Any])

INTERRUPTED: Final = 130
"""Exit code when the user has ended a verb."""
VERDICT_EXIT_CODES: Final[Mapping[str, int]] = {"ok": 0, "suspect": 1, "failed": 1}
"""Exit code of a verb that ends with the verdict of a result."""

path_type = click.Path(path_type=Path)


class NamedFile(click.Path):
    """An output file whose ending says what is in it; ``bare``: it may have none.

    Any other name is refused before work begins, so that no file called PDF holds HTML.
    """

    def __init__(self, *endings: str, bare: bool = True) -> None:
        super().__init__(path_type=Path)
        self.endings, self.bare = endings, bare

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the path; a usage error for a wrong ending."""
        path = Path(str(super().convert(value, param, ctx)))
        known = path.suffix.lower() in self.endings or (self.bare and not path.suffix)
        if not known:
            self.fail(
                f"{path.name!r} does not name a kind of file to write: expected a name that ends "
                f"in {' or '.join(self.endings)}",
                param,
                ctx,
            )
        return path


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


result_option: Final = click.option(
    "-o", "--output", type=NamedFile(".json"), help="Write the result to this file, as JSON."
)


def show_result(result: Result, output: Path | None, *, as_json: bool) -> int:
    """Print a result, and write it to ``output``; return the exit code of its verdict."""
    text = result.to_json()
    if output is not None:
        write_atomically(output, text)
    if as_json:
        for warning in result.warnings:
            say(f"warning: {warning}")
        print_json(text)
    else:
        from rotcal_ros.report.terminal.tables import print_result

        print_result(result)
    if output is not None:
        say(f"result written to {output.absolute()}")
    return VERDICT_EXIT_CODES[result.verdict]


def draw(output: Path, forms: Mapping[str, Callable[[], str]]) -> None:
    """Write a drawing in the form that the ending of ``output`` names."""
    write_atomically(output, forms[output.suffix.lower()]())
    say(f"drawn: {output.absolute()}")


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
        print_marks(outcome["marks"], ", ".join(parts))
        for name, path in outcome.get("files", {}).items():
            tell(f"{name + ':':<14}{path}")
        if goal_line := outcome.get("goal_line"):
            tell(goal_line)
    return VERDICT_EXIT_CODES[outcome["verdict"]]


def print_verdict(verdict_line: str, text: str, write: Callable[..., None] = tell) -> None:
    """Print the verdict on something other than a result, and what it rests on."""
    colour = "green" if verdict_line.startswith("ok") else "red"
    write(f"verdict {verdict_line}: {text}", colour=colour)


def print_marks(marks: Sequence[Mapping[str, str]], text: str) -> None:
    """Print the marks of an outcome in their colours; ``text`` is what the first one rests on."""
    from rotcal_ros.evaluation.marks import Mark

    about, *against = (Mark(**mark) for mark in marks)
    tell(f"{about.line}: {text}", colour=about.colour)
    tell(*filter(None, [about.remark]))
    for mark in against:
        tell(mark.line, colour=mark.colour)


OF_PIP_ALONE: Final = ("mcap", "rosbags", "threadpoolctl")
"""Packages that only pip has: package.xml leaves them to the user."""


def in_lines(error: Exception) -> tuple[str, ...]:
    """Return an error in one line for people, and further lines if it has any."""
    if isinstance(error, RotcalError):
        from rotcal_ros.foundation.table_questions import further_lines

        return str(error), *error.log.splitlines(), *further_lines(error.question)
    if isinstance(error, ModuleNotFoundError) and error.name in OF_PIP_ALONE:
        return (f"{error.name} is missing: pip install {' '.join(OF_PIP_ALONE)}",)
    from rotcal_ros.foundation.plugins import describe_error, failing_plugin

    if isinstance(error, OSError) and error.strerror and not failing_plugin(error):
        return (f"{error.strerror}: {error.filename}" if error.filename else error.strerror,)
    return (f"unexpected {describe_error(error)} ('rotcal --debug ...' shows where)",)
