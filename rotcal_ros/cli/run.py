"""``rotcal run``: all nodes of one cell in one command, from the first step to the verdict."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from rotcal_ros.cli.completion import configurations
from rotcal_ros.cli.console import (
    INTERRUPTED,
    VERDICT_EXIT_CODES,
    json_option,
    path_type,
    print_json,
    print_line,
    print_verdict,
)


@click.command()
@click.argument("configuration", type=path_type, metavar="CONFIG", shell_complete=configurations)
@click.option(
    "-o", "--output", "--out", type=path_type, help="New folder for everything; default: out/NAME."
)
@click.option(
    "--set", "changes", multiple=True, metavar="GROUP.NAME=VALUE", help="Change a setting."
)
@click.option(
    "--resume",
    type=path_type,
    metavar="FOLDER",
    help="Continue the interrupted calibration in FOLDER at its first missing step.",
)
@click.option("--keep-previous", is_flag=True, help="Move an existing output folder aside.")
@click.option("--no-report", is_flag=True, help="Write no report.")
@click.option("--no-export", is_flag=True, help="Write no controller files.")
@click.option(
    "-y", "--yes", is_flag=True, help="Take every work asked of a person as done at once."
)
@json_option
def command(
    configuration: Path,
    output: Path | None,
    changes: tuple[str, ...],
    resume: Path | None,
    keep_previous: bool,
    no_report: bool,
    no_export: bool,
    yes: bool,
    as_json: bool,
) -> int:
    """Start the nodes of the cell that CONFIG describes, calibrate, end them.

    With a group 'simulation' in CONFIG the cell is simulated, otherwise its instruments must be
    running. Where the plan needs a person, the instruction is shown: a simulated person does it
    at once, a real one presses Enter when done (or calls the service 'resume' of the cell).
    Ctrl-C cancels: the bag stays valid, and --resume continues it.
    """
    from rotcal_ros.sessions.environment import require_ros
    from rotcal_ros.sessions.following import calibrate
    from rotcal_ros.sessions.products import goal_line, write_products
    from rotcal_ros.sessions.resume import resume_session
    from rotcal_ros.sessions.session import prepare_session

    require_ros()
    started = time.monotonic()
    if resume is None:
        folder = output or Path("out") / configuration.stem
        session = prepare_session(configuration, folder, changes, keep_previous=keep_previous)
    elif output is None and not keep_previous:
        session = resume_session(configuration, resume, changes)
    else:
        raise click.UsageError("--resume continues in its own FOLDER, without --output")
    outcome = calibrate(session, at_once=yes)
    if outcome.get("interrupted"):
        return INTERRUPTED
    files = write_products(session, report=not no_report, export=not no_export)
    outcome |= {"seconds": round(time.monotonic() - started, 1), "files": files}
    if as_json:
        print_json(outcome)
    else:
        _print(outcome)
        print_line(goal_line(session.folder))
    return VERDICT_EXIT_CODES[outcome["verdict"]]


def _print(outcome: Mapping[str, Any]) -> None:
    """Print the verdict in one line and where everything is."""
    skipped = len(outcome["skipped_steps"])
    print_verdict(
        outcome["verdict_line"],
        f"{outcome['n_used']} steps used, {skipped} skipped, "
        f"{outcome['n_rejected']} attempts rejected, {outcome['seconds']:.0f} s",
    )
    for name, path in outcome["files"].items():
        click.echo(f"{name + ':':<14}{path}")
