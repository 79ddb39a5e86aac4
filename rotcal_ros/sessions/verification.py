"""Measure the simulated cell, give its control the correction table, and measure again."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from rotcal_ros.catalogue import Calibration
from rotcal_ros.compensation import plain_csv
from rotcal_ros.compensation.adding import combined
from rotcal_ros.compensation.export import ExportFiles
from rotcal_ros.compensation.held import held_table, in_force_of
from rotcal_ros.compensation.table import table_from_result
from rotcal_ros.errors import ConfigurationError, DataError
from rotcal_ros.evaluation.iso230 import BidirectionalRuns, Iso230, iso230
from rotcal_ros.evaluation.verification import Verification, positioning
from rotcal_ros.files import write_atomically
from rotcal_ros.in_force import NONE
from rotcal_ros.recordings.sources import Source, read_source
from rotcal_ros.report.terminal.console import say
from rotcal_ros.results import Result
from rotcal_ros.session_folder import VERIFICATION, SessionFolder
from rotcal_ros.sessions.environment import require_ros
from rotcal_ros.sessions.following import calibrate
from rotcal_ros.sessions.products import export_files, write_exports, write_truth
from rotcal_ros.sessions.session import Session, checked_calibration, prepare_session
from rotcal_ros.simulation.positioning import true_runs

CONTROLLERS: Final = ("linuxcnc", "sinumerik", "csv")
APPLIED: Final = "csv"
"""The rows of this table go into the simulated control."""
ISO_RUNS: Final = 5
ISO_TARGETS: Final = 47
"""Does not divide the usual plans, so that most of the targets lie between measured angles."""


@dataclass(frozen=True)
class Measured:
    """A finished session and its result."""

    session: Session
    source: Source


def verify(
    configuration: Path,
    folder: Path,
    changes: Sequence[str] = (),
    check: Sequence[str] = (),
    *,
    spacing: float,
    controllers: Sequence[str] = (),
    files: Path | None = None,
    accept_unverified: bool = False,
    report_of: Path | None = None,
    again: bool = False,
) -> tuple[Verification, tuple[str, ...]] | None:
    """Return the outcome and the controllers that got files; None when the user ended it.

    ``folder`` gets ``before``, ``after`` and verification.json. ``changes`` hold for both
    measurements, ``check`` for the second one. Files with rows every ``spacing`` rad are written
    for CONTROLLERS and ``controllers`` into ``files`` (``folder``/compensation), as they would be
    with ``accept_unverified``. ``again`` adds what the second measurement leaves to the table in
    force and measures a third time, into ``again``. ``report_of`` is an earlier run whose report
    will tell the outcome.
    Raises ConfigurationError before anything is measured, DataError for a result that is not ok.
    """
    wanted = _Wanted(spacing, controllers, files or folder / "compensation", accept_unverified)
    _check(configuration, folder, changes, check)
    _check_report(folder, report_of)
    _rehearse(wanted, checked_calibration(configuration, changes), folder)
    require_ros()
    before = _measure(configuration, folder / "before", changes)
    if before is None:
        return None
    exports = wanted.files(before.source, before.session.configuration.cell.axis)
    write_exports(exports, wanted.folder)
    first = exports[APPLIED]
    after = _measure(configuration, folder / "after", (*changes, *check, *_applied(first)))
    if after is None:
        return None
    rounds = {"before": before, "after": after}
    if again:
        further = wanted.added(after.source, after.session.configuration.cell.axis, first)
        write_exports({APPLIED: further}, folder / "compensation_added")
        third = _measure(configuration, folder / "again", (*changes, *check, *_applied(further)))
        if third is None:
            return None
        rounds["again"] = third
    verification = Verification(
        before=positioning(before.source.result),
        after=positioning(after.source.result),
        again=positioning(rounds["again"].source.result) if again else None,
        stated=first.residual.stated,
        iso={when: _true_figures(measured) for when, measured in rounds.items()},
        verdict_lines={when: m.source.result.verdict_line for when, m in rounds.items()},
    )
    data = verification.to_dict() | {"controllers": list(exports)}
    write_atomically(folder / VERIFICATION, json.dumps(data, indent=1) + "\n")
    return verification, tuple(exports)


@dataclass(frozen=True)
class _Wanted:
    """The controller files that are wanted: rows every ``spacing`` rad, into ``folder``."""

    spacing: float
    controllers: Sequence[str]
    folder: Path
    accept_unverified: bool

    def files(self, source: Source, axis: str) -> dict[str, ExportFiles]:
        """Return the files of all controllers for ``source``, by controller."""
        table = combined(table_from_result(source.result, axis=axis), lambda: None)
        # An arc is nothing for a control that repeats its table every turn.
        names = (*(n for n in CONTROLLERS if table.closed or n != "sinumerik"), *self.controllers)
        return export_files(
            source,
            table,
            list(dict.fromkeys(names)),
            self.spacing,
            accept_unverified=self.accept_unverified,
        )

    def added(self, source: Source, axis: str, first: ExportFiles) -> ExportFiles:
        """Return the file of the control, with what ``source`` found added to ``first``."""
        held = held_table(plain_csv.PlainCsv(), first.files)
        table = combined(table_from_result(source.result, axis=axis), lambda: held)
        return export_files(source, table, [APPLIED], self.spacing)[APPLIED]


def _check(
    configuration: Path, folder: Path, changes: Sequence[str], check: Sequence[str]
) -> None:
    """Raise ConfigurationError unless both measurements can begin."""
    checked_calibration(configuration, (*changes, *check))
    if not checked_calibration(configuration, changes).configuration.simulated:
        raise ConfigurationError(
            f"{configuration} has no group 'simulation': with a real cell measure (rotcal run), "
            "export, load the table, measure again, and compare (rotcal compare)"
        )
    if folder.exists():
        raise ConfigurationError(f"{folder} exists already and nothing is overwritten")


def _check_report(folder: Path, report_of: Path | None) -> None:
    """Raise ConfigurationError unless the run ``report_of`` can be given its report."""
    if report_of is None:
        return
    run = SessionFolder(report_of)
    if run.report.exists():
        raise ConfigurationError(f"{run.report} exists already and nothing is overwritten")
    if not run.bag.is_dir() and report_of not in (folder / "before", folder / "after"):
        raise ConfigurationError(
            f"--report-of {report_of}: there is no {run.bag}; name the folder of a finished run"
        )


def _rehearse(wanted: _Wanted, calibration: Calibration, folder: Path) -> None:
    """Make the controller files of a perfect table, and raise ConfigurationError where they fail.

    So a misspelt controller, rows that it cannot hold, or a name that is taken are told at once.
    """
    angles = np.unique(calibration.plan.table_angles)
    nothing = {"ECC": np.zeros(len(angles))}
    covariance = {"ECC": np.zeros((len(angles), len(angles)))}
    perfect = Result(
        calibration.plan.method, angles, nothing, nothing, covariance, 1.0, 0, 0, measured_on=NONE
    )
    exports = wanted.files(Source(perfect, {}), calibration.configuration.cell.axis)
    target = wanted.folder.absolute()
    if folder / "after" in (target, *target.parents):
        raise ConfigurationError(f"--files {target}: this folder is for the second measurement")
    for path in (target / name for export in exports.values() for name in export.files):
        if os.path.lexists(path):
            raise ConfigurationError(f"--files: {path} exists already, nothing is overwritten")
    for place in (folder, target):
        above = next(path for path in (place, *place.parents) if path.exists())
        if not (above.is_dir() and os.access(above, os.W_OK | os.X_OK)):
            raise ConfigurationError(f"{place} cannot be made: {above} takes no new files")


def _measure(configuration: Path, folder: Path, changes: Sequence[str]) -> Measured | None:
    """Run one calibration; DataError unless its verdict is ok, None when the user ended it."""
    session = prepare_session(configuration, folder, changes)
    say(f"measuring {folder.name} compensation")
    if calibrate(session).get("interrupted"):
        return None
    write_truth(session)
    source = read_source(session.folder.result)
    if source.result.verdict != "ok":
        raise DataError(
            f"the measurement {folder} has the verdict {source.result.verdict}: "
            f"{'; '.join(source.result.warnings)}"
        )
    return Measured(session, source)


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
