"""``rotcal report``: the self-contained page, or the PDF, of a recording or a result."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rotcal_ros.cli.console import VERDICT_EXIT_CODES, NamedFile
from rotcal_ros.cli.options import language_option, set_option, setup_options
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.foundation.language import use_language
from rotcal_ros.foundation.session_folder import SessionFolder, resume_command, unfinished
from rotcal_ros.report.terminal.console import print_reading, say

if TYPE_CHECKING:
    from rotcal_ros.foundation.results import Result
    from rotcal_ros.recordings.inputs import MeasurementInput


@click.command()
@click.argument("source", type=click.Path(exists=True, path_type=Path), metavar="BAG|TABLE|RESULT")
@setup_options
@set_option
@click.option(
    "-o",
    "--output",
    type=NamedFile(".html", ".pdf", ".xml"),
    help="The page to write, .html or .pdf (printed by Chromium); default: report.html of the "
    "session, or NAME_report.html beside the source. Never overwrites, never writes into a "
    "bag.",
)
@click.option(
    "--truth",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="truth.json of a simulation, drawn beside the result.",
)
@click.option(
    "--in-force",
    type=click.Path(exists=True, file_okay=False, path_type=Path),
    metavar="FOLDER",
    help="Files of the table that was in force, to test whether it acts.",
)
@language_option
@click.option(
    "--dcc",
    is_flag=True,
    help="Write a digital calibration certificate instead: certificate.xml, or OUTPUT.",
)
@click.option(
    "--sign",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    metavar="KEY",
    help="Sign it with this private key (RSA, PEM).",
)
@click.option(
    "--certificate",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    metavar="X509",
    help="X.509 certificate (PEM) of the signer.",
)
@click.option(
    "--tables",
    type=click.Path(file_okay=False, path_type=Path),
    metavar="FOLDER",
    help="Also write the tables of the result, such as stations and residuals, as CSV into "
    "FOLDER.",
)
def command(**options: Any) -> int:
    """Solve BAG, or TABLE with its --setup, and write the report.

    It has figures, tables, warnings, verdict and fingerprints. A RESULT (.json) is reported as it
    is, such as a combination or a result whose bag is elsewhere.
    """
    asked = _ReportRequest(**options)
    asked.refuse_what_does_not_fit()
    return _certify(asked) if asked.dcc else _report(asked)


@dataclass(frozen=True)
class _ReportRequest:
    """The options of the command line."""

    source: Path
    setup: Path | None
    targets: Path | None
    changes: tuple[str, ...]
    output: Path | None
    truth: Path | None
    in_force: Path | None
    language: str
    dcc: bool
    sign: Path | None
    certificate: Path | None
    tables: Path | None

    def refuse_what_does_not_fit(self) -> None:
        """Raise UsageError for options of a report with a certificate, or the other way round."""
        ending = "" if self.output is None else self.output.suffix.lower()
        if ending and self.dcc != (ending == ".xml"):
            raise click.UsageError("a certificate (--dcc) is .xml, a report .html or .pdf")
        if self.dcc and (self.truth or self.in_force or self.tables):
            raise click.UsageError(
                "a certificate has no room for --truth, --in-force and --tables"
            )
        if not self.dcc and (self.sign or self.certificate):
            raise click.UsageError("--sign and --certificate belong to --dcc: add it")

    def input(self, source: Path) -> MeasurementInput:
        """Return the bag or table ``source`` with what belongs to it."""
        from rotcal_ros.recordings.inputs import MeasurementInput

        return MeasurementInput(
            source, self.setup, self.targets, self.changes, announce=print_reading
        )


def _certify(asked: _ReportRequest) -> int:
    from rotcal_ros.foundation.plugins import CERTIFICATES, extension

    write: Callable[..., int] = extension(CERTIFICATES, "dcc", "a certificate")
    return write(asked.input(asked.source), asked.output, asked.sign, asked.certificate)


def _report(asked: _ReportRequest) -> int:
    # Figures take a second to load; a wrong option should not wait for them.
    from rotcal_ros.report.page import write_tables
    from rotcal_ros.report.printing import require_writable

    session = SessionFolder(asked.source)
    source = session.bag if session.bag.is_dir() else asked.source
    output = asked.output or default_report_path(source)
    require_writable(output)
    _require_new(output, source)
    _require_empty(asked.tables, source)
    with use_language(asked.language):
        result = _written(asked, source, output)
    say(f"report: {output.absolute()}")
    for path in () if asked.tables is None else write_tables(result, asked.tables):
        say(f"table: {path.absolute()}")
    return max(VERDICT_EXIT_CODES[result.verdict], _acting(result, asked.in_force))


def _written(asked: _ReportRequest, source: Path, output: Path) -> Result:
    """Write the page; return the result that it is about."""
    from rotcal_ros.evaluation.truth_scores import read_document
    from rotcal_ros.recordings.result_sources import read_source
    from rotcal_ros.report.page import report_measurement, report_result

    injected = None if asked.truth is None else read_document(asked.truth)
    given = asked.input(source)
    if source.suffix == ".json":
        return report_result(read_source(source, given), output, injected, asked.in_force)
    begun = source.is_dir() and unfinished(source.parent)
    go_on = resume_command(source.parent) if begun else ""
    return report_measurement(given.read(), output, injected, asked.in_force, go_on)


def _require_new(output: Path, source: Path) -> None:
    """Raise BagError for a page that is there already, or would lie inside a bag."""
    if bag := enclosing_bag(output, source):
        raise BagError(f"{output} would lie inside the bag {bag}; name a file beside it with -o")
    if output.exists():
        raise BagError(f"{output} exists and is not overwritten; name another file with -o")


def _require_empty(folder: Path | None, source: Path) -> None:
    """Raise BagError unless tables may be written into ``folder``: nothing is overwritten."""
    if folder is None:
        return
    if bag := enclosing_bag(folder / "any", source):
        raise BagError(f"{folder} lies inside the bag {bag}; name a folder beside it")
    if folder.exists() and any(folder.iterdir()):
        raise BagError(f"{folder} is not empty, and nothing is overwritten: name a new folder")


def _acting(result: Result, in_force: Path | None) -> int:
    """Print whether the table in force acts on ``result``; return 1 if it does not."""
    if in_force is None:
        return 0
    from rotcal_ros.compensation.earlier_export import effect_of_table_in_force

    effect = effect_of_table_in_force(result, in_force)
    if effect is not None:
        say(f"warning: {effect.fault}" if effect.fault else f"table acts: {effect.describe()}")
    return 1 if effect is not None and effect.fault else 0


def default_report_path(source: Path) -> Path:
    """Return where to put the page about ``source``: beside it, or beside its bag."""
    source = source.absolute()
    source = enclosing_bag(source) or source
    session = SessionFolder(source.parent)
    if source in (session.bag, session.result):
        return session.report
    name = source.name if source.is_dir() else source.stem
    return source.with_name(f"{name}_{session.report.name}")


def enclosing_bag(path: Path, bag: Path | None = None) -> Path | None:
    """Return the bag that ``path`` lies in or would lie in, if any."""
    from rotcal_ros.bags.rosbag2_metadata import METADATA_FILE

    folders = path.absolute().parents
    known = None if bag is None else bag.absolute()
    return next((f for f in folders if f == known or (f / METADATA_FILE).is_file()), None)
