"""``rotcal verify``: measure, compensate, measure again."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from rotcal_ros.cli.console import (
    INTERRUPTED,
    VERDICT_EXIT_CODES,
    json_option,
    path_type,
    print_line,
    print_verdict,
)
from rotcal_ros.units import ARCSEC, DEGREE

if TYPE_CHECKING:
    from rotcal_ros.evaluation.verification import Verification


@click.command()
@click.argument("configuration", type=path_type, metavar="CONFIG")
@click.option("-o", "--output", "--out", type=path_type, help="New folder; default: out/NAME.")
@click.option("--set", "changes", multiple=True, metavar="GROUP.NAME=VALUE", help="Change both.")
@click.option(
    "--check", multiple=True, metavar="GROUP.NAME=VALUE", help="Change the second measurement."
)
@click.option("--spacing", default=10.0, show_default=True, help="deg between rows of the tables.")
@click.option("--to", "controllers", multiple=True, help="Controller to write files for, too.")
@click.option("--files", type=path_type, help="Folder of these; default: OUTPUT/compensation.")
@click.option("--accept-unverified", is_flag=True, help="Write what nobody has verified yet, too.")
@click.option("--again", is_flag=True, help="Add what is left to the table, and measure again.")
@click.option("--report-of", type=path_type, help="Report of this earlier run, not of OUTPUT.")
@json_option
def command(
    configuration: Path,
    output: Path | None,
    changes: tuple[str, ...],
    check: tuple[str, ...],
    spacing: float,
    controllers: tuple[str, ...],
    files: Path | None,
    accept_unverified: bool,
    again: bool,
    report_of: Path | None,
    as_json: bool,
) -> int:
    """Measure the simulated cell of CONFIG, give its control the table, and measure again.

    OUTPUT/before and OUTPUT/after hold the two runs, OUTPUT/verification.json the figures. The
    exit code is 0 when no more is left than the uncertainties explain.
    """
    from rotcal_ros.report.verification import verification_section
    from rotcal_ros.session_folder import VERIFICATION, SessionFolder
    from rotcal_ros.sessions.products import goal_line, write_report
    from rotcal_ros.sessions.verification import verify

    folder = (output or Path("out") / configuration.stem).absolute()
    shown = SessionFolder((report_of or folder / "before").absolute())
    verified = verify(
        configuration,
        folder,
        changes,
        check,
        spacing=spacing * DEGREE,
        controllers=controllers,
        files=files,
        accept_unverified=accept_unverified,
        report_of=report_of and report_of.absolute(),
        again=again,
    )
    if verified is None:
        return INTERRUPTED
    verification, written = verified
    write_report(shown, [verification_section(verification)])
    if as_json:
        click.echo((folder / VERIFICATION).read_text(encoding="utf-8"), nl=False)
    else:
        click.echo(f"controllers:   {', '.join(written)}")
        click.echo(f"verification:  {folder / VERIFICATION}")
        click.echo(f"report:        {shown.report}")
        _print(verification)
        if report_of is not None:
            print_line(goal_line(shown))
    return VERDICT_EXIT_CODES[verification.verdict]


def _print(verification: Verification) -> None:
    before, after = verification.before, verification.after
    for name, letter in (("accuracy", "A"), ("systematic", "E"), ("repeatability", "R")):
        first, second = (getattr(verification.iso[w], name) for w in ("before", "after"))
        click.echo(
            f"ISO 230-2 {letter}:   {first / ARCSEC:.3f} arcsec before, "
            f"{second / ARCSEC:.3f} after (true angle, both directions)"
        )
    if verification.again is not None:
        click.echo(
            f"measured E:    {verification.again.systematic / ARCSEC:.3f} arcsec after what was "
            "left was added to the table (true angle, both directions: "
            f"{verification.iso['again'].systematic / ARCSEC:.3f})"
        )
    for line in verification.reserves:
        click.echo(line)
    print_verdict(
        verification.verdict,
        f"measured E {before.systematic / ARCSEC:.3f} arcsec before, "
        f"{after.systematic / ARCSEC:.3f} after compensation, "
        f"{verification.ratio:.0f} times smaller",
    )
