"""``rotcal verify``: measure, compensate, measure again; or judge two measurements there are."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from rotcal_ros.cli.console import (
    INTERRUPTED,
    VERDICT_EXIT_CODES,
    json_option,
    path_type,
    print_json,
    print_verdict,
)
from rotcal_ros.cli.options import (
    complete_configurations,
    complete_plugins,
    language_option,
    reference_option,
)
from rotcal_ros.foundation import plugins
from rotcal_ros.foundation.circumstances import SIMULATED
from rotcal_ros.foundation.files import write_atomically
from rotcal_ros.foundation.language import use_language
from rotcal_ros.foundation.units import ARCSEC, DEGREE
from rotcal_ros.report.terminal.console import print_reading, say, tell

if TYPE_CHECKING:
    from rotcal_ros.evaluation.verification import Verification
    from rotcal_ros.recordings.result_sources import ResultSource


@click.command()
@click.argument(
    "configuration",
    type=path_type,
    metavar="[CONFIG|BEFORE]",
    required=False,
    shell_complete=complete_configurations,
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
    shell_complete=complete_plugins(plugins.CONTROLLERS),
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
@click.option(
    "--after",
    type=path_type,
    metavar="TABLE|RESULT|BAG",
    help="Measure nothing: BEFORE was measured without the table, this one with it.",
)
@click.option(
    "--table",
    type=path_type,
    metavar="FOLDER",
    help="With --after: the table that was loaded, as rotcal export wrote it.",
)
@reference_option
@click.option(
    "--shared-u",
    "shared_std",
    type=click.FloatRange(min=0.0),
    metavar="ARCSEC",
    help="With --after: the part of both uncertainties (k = 1) that is the same error, as of the "
    "calibration of one instrument.",
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
    **apart: Any,
) -> int:
    """Measure the cell of CONFIG, load the table into its control, and measure again.

    A simulated control gets the table by itself. For a real cell you load the table into its
    control (the first --to, or the controller of its group bridge) and confirm it on the terminal,
    or later with --resume FOLDER --loaded. OUTPUT is the first run and holds all that 'rotcal run'
    leaves; OUTPUT/after is the second one, OUTPUT/verification.json has the figures. The exit code
    is 0 if no more is left than the uncertainties explain. Ctrl-C cancels; --resume goes on with
    the options as they were.

    With --after nothing is measured: BEFORE and AFTER are tables of deviations, results or bags.
    They are compared at the angles that both have, and judged in the same way, by the table of
    --table, else by that of BEFORE. --set says how both tables are read, --check how AFTER is.
    """
    if apart["after"] is not None:
        with use_language(language):
            return _verify_two(configuration, output, changes, check, controllers, as_json, apart)
    _refuse({name: value for name, value in apart.items() if value is not None}, "--after TABLE")
    from rotcal_ros.sessions.verification import (
        VerificationRequest,
        begin_verification,
        confirm_loaded,
    )

    if (configuration is None) == (resume is None):
        raise click.UsageError("give a CONFIG, or --resume FOLDER")
    if loaded and resume is None:
        raise click.UsageError(
            "--loaded needs --resume FOLDER: before the first measurement there is no table to "
            "load"
        )
    if configuration is not None:
        folder = (output or Path("out") / configuration.stem).absolute()
        request = VerificationRequest(check, spacing, controllers, accept_unverified, again)
        begin_verification(configuration, folder, changes, request, keep_previous=keep_previous)
    else:
        assert resume is not None
        folder = resume.absolute()
    if loaded:
        confirm_loaded(folder)
    with use_language(language):
        return _verify(folder, as_json)


def _refuse(given: Iterable[str], needed: str) -> None:
    """Raise a usage error for options, by the names of their arguments, that were given."""
    context = click.get_current_context()
    names = {p.name: p.opts[-1] for p in context.command.params}
    if useless := ", ".join(names[name] for name in given):
        raise click.UsageError(f"{useless}: only with {needed}")


OF_CELLS: Final = (
    "spacing", "accept_unverified", "again", "keep_previous", "resume", "loaded",
)  # fmt: skip
"""Arguments that mean nothing where no cell is measured."""


def _verify_two(
    before: Path | None,
    output: Path | None,
    changes: tuple[str, ...],
    check: tuple[str, ...],
    controllers: tuple[str, ...],
    as_json: bool,
    apart: Mapping[str, Any],
) -> int:
    """Judge two measurements that there are, print the outcome, return the exit code."""
    from rotcal_ros.compensation.earlier_export import loaded_table
    from rotcal_ros.evaluation.two_measurements import verification_of
    from rotcal_ros.foundation.session_folder import VERIFICATION
    from rotcal_ros.report.verification import draw_before_and_after

    after, folder, own = apart["after"], apart["table"], click.get_current_context()
    _refuse((name for name in OF_CELLS if own.params[name]), "CONFIG")
    if before is None:
        raise click.UsageError("--after needs what was measured before: rotcal verify BEFORE")
    if controllers and folder is None:
        raise click.UsageError("--to names the controller of --table FOLDER: give both")
    sources = [
        _source(path, stated, apart["reference_std"])
        for path, stated in ((before, changes), (after, (*changes, *check)))
    ]
    results = {str(p): s.result for p, s in zip((before, after), sources, strict=True)}
    if len(results) < 2:
        raise click.UsageError("--after is the file of before: give two measurements")
    held = folder and loaded_table(folder, results[str(after)].measured_on, controllers)
    verification = verification_of(results, held, shared=(apart["shared_std"] or 0.0) * ARCSEC)
    data = verification.to_dict() | {"sources_sha256": [dict(s.sha256) for s in sources]}
    if output is not None:
        if output.exists():
            raise click.UsageError(f"{output} exists, and nothing is overwritten: choose another")
        output.mkdir(parents=True)
        write_atomically(output / VERIFICATION, json.dumps(data, indent=1) + "\n")
        drawn = draw_before_and_after(verification.before, verification.after)
        write_atomically((output / VERIFICATION).with_suffix(".svg"), drawn)
        say(f"written: {output.absolute()}")
    if as_json:
        print_json(data)
    else:
        _print_side_by_side(verification)
    return VERDICT_EXIT_CODES[verification.verdict]


def _source(path: Path, changes: tuple[str, ...], std: float | None) -> ResultSource:
    """Return a measurement; only a table needs ``changes``, or a standard uncertainty (rad)."""
    from rotcal_ros.foundation.tables import is_table
    from rotcal_ros.recordings.inputs import MeasurementInput
    from rotcal_ros.recordings.result_sources import read_source

    if not is_table(path):
        return read_source(path)
    stated = () if std is None else (f"solver.u_arcsec={std / ARCSEC!r}",)
    return read_source(
        path, MeasurementInput(path, changes=(*changes, *stated), announce=print_reading)
    )


def _print_side_by_side(verification: Verification) -> None:
    from rotcal_ros.report.terminal.columns import Column, print_table, print_words

    before, after = verification.before, verification.after
    print_table([
        Column("angle/deg", before.angles / DEGREE, ".6g"),
        *(Column(f"{name}/arcsec", run.deviation / ARCSEC, std=run.std / ARCSEC)
          for name, run in (("before", before), ("after", after))),
    ])  # fmt: skip
    _print(verification, print_words)
    if not (verification.shared and verification.stated):
        print_words(
            "to state: --shared-u ARCSEC, an error of both; --table FOLDER, what was loaded"
        )


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
    from rotcal_ros.sessions.products import session_goal_standing, write_report
    from rotcal_ros.sessions.verification import run_verification

    click.get_current_context().with_resource(lasting_output(folder / "verify.log"))
    verified = run_verification(folder, _loaded)
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
        if (standing := session_goal_standing(session)) is not None:
            tell(standing.describe())
    return VERDICT_EXIT_CODES[verification.verdict]


def _print(verification: Verification, write: Callable[..., None] = tell) -> None:
    """Print figures, verdict and what is not covered, by what ``write`` does with lines."""
    figures = (("accuracy", "A"), ("systematic", "E"), ("repeatability", "R"))
    for name, letter in figures if verification.iso else ():
        first, second = (getattr(verification.iso[w], name) for w in ("before", "after"))
        write(
            f"ISO 230-2 {letter}:   {first / ARCSEC:.3f} arcsec before, "
            f"{second / ARCSEC:.3f} after (true angle, both directions)"
        )
    if verification.again is not None:
        write(
            f"measured E:    {verification.again.systematic / ARCSEC:.3f} arcsec after the rest "
            "was added to the table"
        )
    if verification.effect is not None:
        write(verification.fault or f"table acts:    {verification.effect.describe()}")
    mark = f" ({SIMULATED})" if verification.simulated else ""
    print_verdict(
        f"{verification.verdict}{mark}",
        verification.figures,
        write,
    )
    write(*verification.reserves)
