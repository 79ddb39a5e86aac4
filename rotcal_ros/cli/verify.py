"""``rotcal verify``: measure, compensate, measure again."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from rotcal_ros.cli.console import VERDICT_EXIT_CODES, json_option, print_json, say
from rotcal_ros.cli.main import INTERRUPTED
from rotcal_ros.errors import ConfigurationError, DataError
from rotcal_ros.sessions.session import SIMULATION, Session, prepare_session, require_ros

if TYPE_CHECKING:
    from rotcal_ros.compensation.export import ExportFiles
    from rotcal_ros.evaluation.iso230 import Iso230
    from rotcal_ros.evaluation.verification import Verification
    from rotcal_ros.results import Result

CONTROLLERS: Final = ("linuxcnc", "sinumerik", "csv")
APPLIED: Final = "csv"
"""The rows of this table go into the simulated control."""
ISO_RUNS: Final = 5
ISO_TARGETS: Final = 47
"""Does not divide the usual plans, so that most of the targets lie between measured angles."""

path_type = click.Path(path_type=Path)


@dataclass(frozen=True)
class Measured:
    """A finished session."""

    session: Session
    result: Result
    sha256: str


class _InterruptedError(Exception):
    """The user has ended a measurement."""


@click.command(
    "verify", short_help="Measure the simulated cell, compensate it, and measure again."
)
@click.argument("configuration", type=path_type, metavar="CONFIG")
@click.option("-o", "--output", "--out", type=path_type, help="New folder; default: out/NAME.")
@click.option("--set", "changes", multiple=True, metavar="GROUP.NAME=VALUE", help="Change both.")
@click.option(
    "--check", multiple=True, metavar="GROUP.NAME=VALUE", help="Change the second measurement."
)
@click.option("--spacing", default=10.0, show_default=True, help="deg between rows of the tables.")
@click.option("--to", "controllers", multiple=True, help="Controller to write files for, too.")
@click.option("--files", type=path_type, help="Folder of these; default: OUTPUT/compensation.")
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
    report_of: Path | None,
    as_json: bool,
) -> int:
    """Measure the simulated cell of CONFIG, give its control the table, and measure again.

    OUTPUT/before and OUTPUT/after hold the two runs, OUTPUT/verification.json the figures. The
    exit code is 0 when no more is left than the uncertainties explain.
    """
    require_ros()
    folder = (output or Path("out") / configuration.stem).absolute()
    if folder.exists():
        raise ConfigurationError(f"{folder} exists already and nothing is overwritten")
    try:
        before = _measure(configuration, folder / "before", changes)
        made = _compensate(before, spacing, controllers, files or folder / "compensation")
        applied = _applied(made[APPLIED])
        after = _measure(configuration, folder / "after", (*changes, *check, *applied))
    except _InterruptedError:
        return INTERRUPTED
    verification = _verification(before, after, made[APPLIED])
    data = verification.to_dict() | {"controllers": list(made)}
    from rotcal_ros.files import write_atomically

    write_atomically(folder / "verification.json", json.dumps(data, indent=1) + "\n")
    page = _write_report(report_of or before.session.folder, verification)
    if as_json:
        print_json(data)
    else:
        _conclude(verification, made, folder, page)
    return VERDICT_EXIT_CODES[verification.verdict]


def _measure(configuration: Path, folder: Path, changes: Sequence[str]) -> Measured:
    """Run one calibration; DataError unless its verdict is ok."""
    from rotcal_ros.cli.person import Person
    from rotcal_ros.cli.run import calibrate
    from rotcal_ros.results import Result
    from rotcal_ros.sessions.products import write_products

    session = prepare_session(configuration, folder, changes)
    if not session.simulated:
        raise ConfigurationError(
            f"{configuration} has no group 'simulation': with a real cell measure (rotcal run), "
            "export, load the table, measure again, and compare (rotcal compare)"
        )
    say(f"measuring {folder.name} compensation")
    if calibrate(session, Person(session, at_once=False)).get("interrupted"):
        raise _InterruptedError
    write_products(session, report=False, export=False)
    text = (folder / "result.json").read_bytes()
    result = Result.from_dict(json.loads(text))
    if result.verdict != "ok":
        raise DataError(
            f"the measurement {folder} has the verdict {result.verdict}: "
            f"{'; '.join(result.warnings)}"
        )
    return Measured(session, result, sha256(text).hexdigest())


def _compensate(
    before: Measured, spacing_deg: float, further: Sequence[str], folder: Path
) -> dict[str, ExportFiles]:
    """Write the files of all controllers and return what was made for each of them."""
    from rotcal_ros.compensation.export import prepare_export
    from rotcal_ros.compensation.table import table_from_result
    from rotcal_ros.compensation.writing import write_files
    from rotcal_ros.units import DEGREE

    cell = before.session.configuration.cell
    table = table_from_result(before.result, axis=cell.axis)
    now = datetime.now(timezone.utc)
    made = {
        name: prepare_export(
            table,
            name,
            now=now,
            spacing=spacing_deg * DEGREE,
            sources={"result.json": before.sha256},
        )
        # An arc is nothing for a control that repeats its table every turn.
        for name in dict.fromkeys((*CONTROLLERS, *further))
        if table.closed or name != "sinumerik"
    }
    texts = {file: text for one in made.values() for file, text in one.files.items()}
    write_files(texts, folder)
    return made


def _applied(made: ExportFiles) -> list[str]:
    """Return the changes that put the written table into the simulated control."""
    from rotcal_ros.compensation import plain_csv

    files = {name: text for name, text in made.files.items() if name.endswith(".csv")}
    rows = plain_csv.PlainCsv().read(files)
    columns = {
        "angles_deg": rows.angle_deg,
        "forward_arcsec": rows.forward_arcsec,
        "reverse_arcsec": rows.reverse_arcsec,
    }
    return [
        f"{SIMULATION}.table.compensation.{name}=[{', '.join(f'{x:.9f}' for x in column)}]"
        for name, column in columns.items()
    ]


def _verification(before: Measured, after: Measured, made: ExportFiles) -> Verification:
    from rotcal_ros.evaluation.verification import Verification, positioning

    return Verification(
        before=positioning(before.result),
        after=positioning(after.result),
        stated=made.residual.stated,
        iso={"before": _true_figures(before), "after": _true_figures(after)},
    )


def _true_figures(measured: Measured) -> Iso230:
    """Return ISO 230-2 of the simulated axis itself over the measured travel."""
    import numpy as np

    from rotcal_ros.evaluation.iso230 import BidirectionalRuns, iso230
    from rotcal_ros.simulation.positioning import true_runs

    settings = measured.session.configuration.simulation
    angles = measured.result.angles
    targets = np.linspace(angles[0], angles[-1], ISO_TARGETS)
    forward, reverse = true_runs(settings, targets, ISO_RUNS)
    return iso230(BidirectionalRuns(targets, forward, reverse))


def _write_report(session: Path, verification: Verification) -> Path:
    """Write the report of a session with the section on the verification."""
    from dataclasses import replace

    from rotcal_ros.recordings.replay import read_recording
    from rotcal_ros.report.page import write_report
    from rotcal_ros.report.recorded import report_of
    from rotcal_ros.report.verification import verification_section

    page = session.absolute() / "report.html"
    if page.exists():
        raise ConfigurationError(f"{page} exists already and nothing is overwritten")
    recording = read_recording(session / "bag")
    truth = json.loads((session / "truth.json").read_text(encoding="utf-8"))
    result = recording.solve()
    if result.to_dict() != json.loads((session / "result.json").read_text(encoding="utf-8")):
        say(f"warning: {session / 'bag'} solved again gives another result than live")
    report = report_of(recording, result, truth)
    write_report(replace(report, extra=[verification_section(verification)]), page)
    return page


def _conclude(
    verification: Verification, made: Mapping[str, Any], folder: Path, page: Path
) -> None:
    from rotcal_ros.units import ARCSEC

    before, after = verification.before, verification.after
    click.echo(f"controllers:   {', '.join(made)}")
    click.echo(f"verification:  {folder / 'verification.json'}")
    click.echo(f"report:        {page}")
    for name, words in (("accuracy", "A"), ("systematic", "E"), ("repeatability", "R")):
        first, second = (getattr(verification.iso[w], name) for w in ("before", "after"))
        click.echo(
            f"ISO 230-2 {words}:   {first / ARCSEC:.3f} arcsec before, {second / ARCSEC:.3f} after"
            " (true angle, both directions)"
        )
    click.secho(
        f"verdict {verification.verdict}: measured E {before.systematic / ARCSEC:.3f} arcsec "
        f"before, {after.systematic / ARCSEC:.3f} after compensation, "
        f"{verification.ratio:.0f} times smaller",
        fg="green" if verification.verdict == "ok" else "red",
    )
