"""``rotcal verify``: measure, compensate, measure again."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import click

from rotcal_ros.cli.console import (
    INTERRUPTED,
    VERDICT_EXIT_CODES,
    json_option,
    path_type,
    print_verdict,
)
from rotcal_ros.cli.options import configurations, installed, language_option
from rotcal_ros.foundation import plugins
from rotcal_ros.foundation.circumstances import SIMULATED
from rotcal_ros.foundation.components import COVERAGE_FACTOR
from rotcal_ros.foundation.gum_numbers import value
from rotcal_ros.foundation.language import speaking
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.report.terminal.console import say, tell

if TYPE_CHECKING:
    from rotcal_ros.evaluation.verification import Positioning, Verification


@click.command()
@click.argument(
    "configuration",
    type=path_type,
    metavar="[CONFIG]",
    required=False,
    shell_complete=configurations,
)
@click.option("-o", "--output", "--out", type=path_type, help="New folder; default: out/NAME.")
@click.option(
    "--set",
    "changes",
    multiple=True,
    metavar="GROUP.NAME=VALUE",
    help="Change a setting of all measurements.",
)
@click.option(
    "--check",
    multiple=True,
    metavar="GROUP.NAME=VALUE",
    help="Change a setting of the measurements after compensation.",
)
@click.option("--spacing", default=0.0, help="deg between rows of the tables; default: chosen.")
@click.option(
    "--to",
    "controllers",
    multiple=True,
    shell_complete=installed(plugins.CONTROLLERS),
    help="Controller to write files for; may be given several times.",
)
@click.option(
    "--accept-unverified",
    is_flag=True,
    help="Write files even if something about the controller is not verified.",
)
@click.option(
    "--again", is_flag=True, help="Add the remaining deviations to the table, and measure again."
)
@language_option
@click.option("--keep-previous", is_flag=True, help="Move an existing output folder aside.")
@click.option(
    "--resume", type=path_type, metavar="FOLDER", help="Go on with an interrupted verification."
)
@click.option(
    "--loaded", is_flag=True, help="Confirm that the real control has loaded the table, and go on."
)
@json_option
def command(
    configuration: Path | None,
    output: Path | None,
    changes: tuple[str, ...],
    check: tuple[str, ...],
    spacing: float,
    controllers: tuple[str, ...],
    accept_unverified: bool,
    again: bool,
    language: str,
    keep_previous: bool,
    resume: Path | None,
    loaded: bool,
    as_json: bool,
) -> int:
    """Measure the cell of CONFIG, load the table into its control, and measure again.

    A simulated control gets the table by itself. For a real cell you load the table into its
    control (the first --to, or the controller of its group bridge) and confirm it on the terminal,
    or later with --resume FOLDER --loaded. OUTPUT is the first run and holds all that 'rotcal run'
    leaves; OUTPUT/after is the second one, OUTPUT/verification.json has the figures. The exit code
    is 0 if no more is left than the uncertainties explain. Ctrl-C cancels; --resume goes on with
    the options as they were.
    """
    from rotcal_ros.sessions.verification import Request, begin, confirm_loaded

    if (configuration is None) == (resume is None):
        raise click.UsageError("give a CONFIG, or --resume FOLDER")
    if loaded and resume is None:
        raise click.UsageError(
            "--loaded needs --resume FOLDER: before the first measurement there is no table to "
            "load"
        )
    if configuration is not None:
        folder = (output or Path("out") / configuration.stem).absolute()
        request = Request(check, spacing, controllers, accept_unverified, again)
        begin(configuration, folder, changes, request, keep_previous=keep_previous)
    else:
        assert resume is not None
        folder = resume.absolute()
    if loaded:
        confirm_loaded(folder)
    with speaking(language):
        return _verify(folder, as_json)


def _loaded(folder: Path, files: Sequence[Path]) -> bool:
    """Ask on the terminal whether the files are in the control."""
    say(
        "load this table into the control, make it active (by a restart, for instance), and "
        f"reference the axis again: {', '.join(map(str, files))}"
    )
    from rotcal_ros.foundation.session_folder import resume_command

    later = f"to go on when it is loaded: {resume_command(folder)} --loaded"
    if sys.stdin.isatty():
        with suppress(click.Abort):
            question = "enter 'loaded' when this is done, or 'later' to end here"
            if click.prompt(question, err=True) == "loaded":
                return True
    say(later)
    return False


def _verify(folder: Path, as_json: bool) -> int:
    """Do what is left to do in ``folder``, print the outcome, return the exit code."""
    from rotcal_ros.foundation.session_folder import VERIFICATION, SessionFolder
    from rotcal_ros.report.verification import verification_section
    from rotcal_ros.sessions.lasting_output import lasting_output
    from rotcal_ros.sessions.products import goal_standing, write_report
    from rotcal_ros.sessions.verification import verify

    click.get_current_context().with_resource(lasting_output(folder / "verify.log"))
    verified = verify(folder, _loaded)
    if verified is None:
        return INTERRUPTED
    verification, written = verified
    session = SessionFolder(folder)
    if not session.report.is_file():
        write_report(session, [verification_section(verification)])
    if as_json:
        click.echo((folder / VERIFICATION).read_text(encoding="utf-8"), nl=False)
    else:
        tell(f"result:        {session.result}")
        tell(f"compensation:  {session.compensation} ({', '.join(written)})")
        tell(f"verification:  {folder / VERIFICATION}")
        tell(f"report:        {session.report}")
        _print(verification)
        if (standing := goal_standing(session)) is not None:
            tell(standing.describe())
    return VERDICT_EXIT_CODES[verification.verdict]


def _print(verification: Verification) -> None:
    before, after = verification.before, verification.after
    figures = (("accuracy", "A"), ("systematic", "E"), ("repeatability", "R"))
    for name, letter in figures if verification.iso else ():
        first, second = (getattr(verification.iso[w], name) for w in ("before", "after"))
        click.echo(
            f"ISO 230-2 {letter}:   {first / ARCSEC:.3f} arcsec before, "
            f"{second / ARCSEC:.3f} after (true angle, both directions)"
        )
    if verification.again is not None:
        click.echo(
            f"measured E:    {verification.again.systematic / ARCSEC:.3f} arcsec after the rest "
            "was added to the table"
        )
    if verification.effect is not None:
        click.echo(verification.fault or f"table acts:    {verification.effect.describe()}")
    mark = f" ({SIMULATED})" if verification.simulated else ""
    print_verdict(
        f"{verification.verdict}{mark}",
        f"measured E {_measured(before)} arcsec before, {_measured(after)} after compensation, "
        f"{verification.ratio:.0f} times smaller",
    )
    tell(*verification.reserves)


def _measured(run: Positioning) -> str:
    """Return the range E of what was measured, arcsec, to the digits of its uncertainty."""
    expanded = COVERAGE_FACTOR * float(run.std.max()) / ARCSEC
    return value(run.systematic / ARCSEC, expanded).lstrip("+")
