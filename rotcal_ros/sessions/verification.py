"""Measure the simulated cell, give its control the correction table, and measure again.

What is done stands on the disk, so that an interrupted verification goes on where it was.
"""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from rotcal_ros.catalogue import Calibration
from rotcal_ros.compensation import plain_csv
from rotcal_ros.compensation.adding import combined
from rotcal_ros.compensation.export import ExportFiles
from rotcal_ros.compensation.held import held_table, in_force_of
from rotcal_ros.compensation.table import table_from_result
from rotcal_ros.compensation.writing import of_the_controller
from rotcal_ros.errors import ConfigurationError, DataError
from rotcal_ros.evaluation.iso230 import BidirectionalRuns, Iso230, iso230
from rotcal_ros.evaluation.verification import Verification, positioning
from rotcal_ros.files import write_atomically
from rotcal_ros.in_force import NONE
from rotcal_ros.recordings.sources import Source, read_source
from rotcal_ros.records import record
from rotcal_ros.report.terminal.console import say
from rotcal_ros.results import Result
from rotcal_ros.session_folder import REQUEST, VERIFICATION, SessionFolder
from rotcal_ros.sessions.environment import require_ros
from rotcal_ros.sessions.following import calibrate
from rotcal_ros.sessions.products import export_files, write_exports, write_truth
from rotcal_ros.sessions.resume import resume_session
from rotcal_ros.sessions.session import Session, checked_calibration, prepare_session
from rotcal_ros.sessions.viewers import Viewers
from rotcal_ros.simulation.positioning import true_runs
from rotcal_ros.units import DEGREE
from rotcal_ros.untrusted import load_json, read_text, why

CONTROLLERS: Final = ("linuxcnc", "sinumerik", "csv")
APPLIED: Final = "csv"
"""The rows of this table go into the simulated control."""
ISO_RUNS: Final = 5
ISO_TARGETS: Final = 47
"""Does not divide the usual plans, so that most of the targets lie between measured angles."""


@dataclass(frozen=True)
class Request:
    """What is asked of a verification beside the configuration of the first measurement.

    ``check`` are changes of the second measurement, ``spacing_deg`` is that of the rows of the
    tables. Files are written for CONTROLLERS and ``controllers``, as they would be with
    ``accept_unverified``. ``again`` adds what the second measurement leaves to the table in force
    and measures a third time.
    """

    check: tuple[str, ...] = ()
    spacing_deg: float = 10.0
    controllers: tuple[str, ...] = ()
    accept_unverified: bool = False
    again: bool = False

    def files(self, source: Source, axis: str) -> dict[str, ExportFiles]:
        """Return the files of all controllers for ``source``, by controller."""
        table = combined(table_from_result(source.result, axis=axis), lambda: None)
        # An arc is nothing for a control that repeats its table every turn.
        names = (*(n for n in CONTROLLERS if table.closed or n != "sinumerik"), *self.controllers)
        return export_files(
            source,
            table,
            list(dict.fromkeys(names)),
            self.spacing_deg * DEGREE,
            accept_unverified=self.accept_unverified,
        )

    def added(self, source: Source, axis: str, first: ExportFiles) -> ExportFiles:
        """Return the file of the control, with what ``source`` found added to ``first``."""
        held = held_table(plain_csv.PlainCsv(), first.files)
        table = combined(table_from_result(source.result, axis=axis), lambda: held)
        return export_files(source, table, [APPLIED], self.spacing_deg * DEGREE)[APPLIED]


@dataclass(frozen=True)
class Measured:
    """A finished session and its result."""

    session: Session
    source: Source

    @property
    def axis(self) -> str:
        """The letter of the axis."""
        return self.session.configuration.cell.axis


def begin(
    configuration: Path,
    folder: Path,
    changes: Sequence[str],
    request: Request,
    *,
    keep_previous: bool = False,
) -> None:
    """Check all that will be measured and written, then make ``folder`` with what was asked.

    ``changes`` hold for all measurements. Raises ConfigurationError before anything is made.
    """
    calibration = checked_calibration(configuration, changes)
    checked_calibration(configuration, (*changes, *request.check))
    if not calibration.configuration.simulated:
        raise ConfigurationError(
            f"{configuration} has no group 'simulation': with a real cell measure (rotcal run), "
            "export, load the table, measure again, and compare (rotcal compare)"
        )
    if "dme" in calibration.configuration.given:
        raise ConfigurationError(
            f"{configuration}: its group 'dme' puts the simulated cell behind another process, "
            "whose control takes no table from here; verify one without that group"
        )
    _rehearse(request, calibration)
    above = next(path for path in (folder, *folder.parents) if path.exists())
    if not (above.is_dir() and os.access(above, os.W_OK | os.X_OK)):
        raise ConfigurationError(f"{folder} cannot be made: {above} takes no new files")
    require_ros()
    prepare_session(configuration, folder, changes, keep_previous=keep_previous)
    write_atomically(folder / REQUEST, json.dumps(asdict(request), indent=1) + "\n")


def verify(folder: Path) -> tuple[Verification, tuple[str, ...]] | None:
    """Do what is left of the verification in ``folder``; None when the user ended it.

    Returns the outcome and the controllers that got files. ``folder`` is the session of the first
    measurement and gets ``compensation``, the session ``after`` and verification.json; with
    ``again`` the session of that name too. Raises DataError for a result that is not ok,
    ConfigurationError where no verification was begun.
    """
    request = _read_request(folder)
    first = SessionFolder(folder)
    before = _measure(first.configuration, folder, (), folder)
    if before is None:
        return None
    exports = request.files(before.source, before.axis)
    _write_once(exports, first.compensation)
    changes = (*request.check, *_applied(exports[APPLIED]))
    after = _measure(first.configuration, folder / "after", changes, folder)
    if after is None:
        return None
    rounds = {"before": before, "after": after}
    if request.again:
        further = request.added(after.source, after.axis, exports[APPLIED])
        _write_once({APPLIED: further}, folder / "compensation_added")
        changes = (*request.check, *_applied(further))
        third = _measure(first.configuration, folder / "again", changes, folder)
        if third is None:
            return None
        rounds["again"] = third
    verification = _outcome(rounds, exports[APPLIED].residual.stated)
    data = verification.to_dict() | {"controllers": list(exports)}
    write_atomically(folder / VERIFICATION, json.dumps(data, indent=1) + "\n")
    return verification, tuple(exports)


def _read_request(folder: Path) -> Request:
    try:
        data = load_json(read_text(folder / REQUEST))
        return record(Request, data)
    except FileNotFoundError:
        raise ConfigurationError(
            f"{folder} holds no verification: its {REQUEST} is missing; begin one with 'rotcal "
            "verify CONFIG', or go on with a single measurement: rotcal run CONFIG --resume"
        ) from None
    except (OSError, ValueError) as error:
        raise ConfigurationError(f"{folder / REQUEST} is damaged: {why(error)}") from error


def _outcome(rounds: dict[str, Measured], stated: float) -> Verification:
    again = rounds.get("again")
    return Verification(
        before=positioning(rounds["before"].source.result),
        after=positioning(rounds["after"].source.result),
        again=positioning(again.source.result) if again else None,
        stated=stated,
        iso={when: _true_figures(measured) for when, measured in rounds.items()},
        verdict_lines={when: m.source.result.verdict_line for when, m in rounds.items()},
    )


def _rehearse(request: Request, calibration: Calibration) -> None:
    """Make the controller files of a perfect table, and raise ConfigurationError where they fail.

    So a misspelt controller, or rows that it cannot hold, are told at once.
    """
    angles = np.unique(calibration.plan.table_angles)
    nothing = {"ECC": np.zeros(len(angles))}
    covariance = {"ECC": np.zeros((len(angles), len(angles)))}
    perfect = Result(
        calibration.plan.method, angles, nothing, nothing, covariance, 1.0, 0, 0, measured_on=NONE
    )
    request.files(Source(perfect, {}), calibration.configuration.cell.axis)


def _measure(
    configuration: Path, path: Path, changes: Sequence[str], whole: Path
) -> Measured | None:
    """Return the measurement in the session ``path``, carried out as far as it is not yet.

    DataError unless its verdict is ok, None when the user ended it.
    """
    folder = SessionFolder(path)
    if not folder.configuration.is_file():
        session = prepare_session(configuration, path, changes)
    elif folder.result.is_file() or not folder.bag.is_dir():
        session = Session(checked_calibration(folder.configuration, ()), folder)
    else:
        session = resume_session(folder.configuration, path, ())
    if not folder.result.is_file():
        say(f"measuring {'before' if path == whole else path.name} compensation")
        session = replace(session, continued_by=f"rotcal verify --resume {whole}")
        with Viewers(session) as viewers:
            outcome = calibrate(session, viewers)
            viewers.end(outcome)
        if outcome.get("interrupted"):
            return None
    if not folder.truth.is_file():
        write_truth(session)
    source = read_source(folder.result)
    if source.result.verdict != "ok":
        raise DataError(
            f"the measurement {path} has the verdict {source.result.verdict}: "
            f"{'; '.join(source.result.warnings)}"
        )
    return Measured(session, source)


def _write_once(exports: dict[str, ExportFiles], folder: Path) -> None:
    """Write the files that an interrupted verification has not written yet.

    Raises DataError where one that is there holds another table.
    """
    left = {}
    for name, export in exports.items():
        for file, text in of_the_controller(export.files).items():
            if (folder / file).is_file() and read_text(folder / file, "latin-1") != text:
                raise DataError(f"{folder / file} was changed since it was written")
        there = {file: text for file, text in export.files.items() if (folder / file).exists()}
        rest = {file: text for file, text in export.files.items() if file not in there}
        left[name] = replace(export, files=rest)
    write_exports(left, folder)


def _applied(export: ExportFiles) -> list[str]:
    """Return the changes that put the written table into the simulated control."""
    files = {name: text for name, text in export.files.items() if name.endswith(".csv")}
    rows = plain_csv.PlainCsv().read(files)
    columns = {
        "angles_deg": rows.angle_deg,
        "forward_arcsec": rows.forward_arcsec,
        "reverse_arcsec": rows.reverse_arcsec,
    }
    in_force = f"cell.table_in_force={in_force_of(export.files)}"
    return [in_force] + [
        f"simulation.table.compensation.{name}=[{', '.join(f'{x:.9f}' for x in column)}]"
        for name, column in columns.items()
    ]


def _true_figures(measured: Measured) -> Iso230:
    """Return ISO 230-2 of the simulated axis itself over the measured travel."""
    angles = measured.source.result.angles
    targets = np.linspace(angles[0], angles[-1], ISO_TARGETS)
    settings = measured.session.configuration.simulation
    return iso230(BidirectionalRuns(targets, *true_runs(settings, targets, ISO_RUNS)))
