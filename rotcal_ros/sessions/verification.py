"""Measure a cell, give its control the correction table, and measure again.

A simulated control gets the rows of the table by itself. The table of a real one is loaded by a
person, who confirms it: nothing is measured again before that. Every step is noted on disk, so
that an interrupted verification continues where it was.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from rotcal_ros.compensation import plain_csv
from rotcal_ros.compensation.cascaded_tables import combine_with_table_in_force
from rotcal_ros.compensation.controllers import controller_names
from rotcal_ros.compensation.export import CONTENTS, ExportFiles
from rotcal_ros.compensation.held_table import (
    CorrectionEffect,
    effect_from_result,
    hash_in_force,
    held_table,
)
from rotcal_ros.compensation.table import CompensationTable, table_from_result
from rotcal_ros.compensation.writing import PROVENANCE, without_provenance
from rotcal_ros.evaluation.iso230 import BidirectionalRuns, Iso230, iso230
from rotcal_ros.evaluation.verification import Verification, positioning
from rotcal_ros.foundation.errors import ConfigurationError, DataError
from rotcal_ros.foundation.files import write_atomically
from rotcal_ros.foundation.in_force import NONE
from rotcal_ros.foundation.plugins import group_nodes
from rotcal_ros.foundation.records import record
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.session_folder import REQUEST, VERIFICATION, SessionFolder
from rotcal_ros.foundation.units import DEGREE
from rotcal_ros.foundation.untrusted import cause_of, load_json, read_text
from rotcal_ros.methods import Calibration
from rotcal_ros.methods.configuration import SIMULATION, Configuration, read_configuration
from rotcal_ros.methods.simulation.table import true_runs
from rotcal_ros.recordings.result_sources import ResultSource, read_source
from rotcal_ros.report.terminal.console import say
from rotcal_ros.sessions.attaching import Viewers
from rotcal_ros.sessions.processes import require_ros
from rotcal_ros.sessions.products import export_files, write_exports, write_truth
from rotcal_ros.sessions.running import calibrate
from rotcal_ros.sessions.session import (
    Session,
    checked_calibration,
    prepare_session,
    resume_session,
)

CONTROLLERS: Final = ("linuxcnc", "sinumerik", "csv")
"""Controllers that files are written for in a simulated cell, if they are installed."""
TABLES: Final = {"after": "compensation", "again": "compensation_added"}
"""Folders of the tables that are in force during the further measurements."""
LOADED: Final = "loaded"
"""Prefix of the file that notes a person's confirmation that a real control has loaded a table."""
Loaded = Callable[[Path, Sequence[Path]], bool]
APPLIED: Final = "csv"
"""The rows of this table go into the simulated control."""
ISO_RUNS: Final = 5
ISO_TARGETS: Final = 47
"""Number of targets that does not divide the usual plans: most lie between measured angles."""


@dataclass(frozen=True)
class VerificationRequest:
    """The options of a verification, besides the configuration of the first measurement.

    ``check`` are changes of the second measurement, ``spacing_deg`` is that of the rows of the
    tables, 0: chosen. Files are written for CONTROLLERS and ``controllers``, with
    ``accept_unverified`` as in an export. ``again`` adds the deviations left in the second
    measurement to the table in force and measures a third time.
    """

    check: tuple[str, ...] = ()
    spacing_deg: float = 0.0
    controllers: tuple[str, ...] = ()
    accept_unverified: bool = False
    again: bool = False

    def applied(self, cell: Configuration) -> str:
        """Return the controller whose table comes into force in the ``cell``."""
        if cell.simulated:
            return APPLIED
        return self.controllers[0] if self.controllers else cell.bridge.controller

    def files(self, source: ResultSource, cell: Configuration) -> dict[str, ExportFiles]:
        """Return the files of all controllers for ``source``, by controller."""
        table = combine_with_table_in_force(
            table_from_result(source.result, axis=cell.cell.axis), lambda: None
        )
        # A control that repeats its table every turn cannot take an arc.
        fits = [n for n in CONTROLLERS if table.closed or n != "sinumerik"]
        usual = [n for n in fits if n in controller_names()]
        names = (*(usual if cell.simulated else [self.applied(cell)]), *self.controllers)
        return self._export(source, table, cell, *dict.fromkeys(names))

    def added(self, source: ResultSource, cell: Configuration, first: ExportFiles) -> ExportFiles:
        """Return the files of the control, with what ``source`` found added to ``first``."""
        held = held_table(first.controller, first.files)
        table = combine_with_table_in_force(
            table_from_result(source.result, axis=cell.cell.axis), lambda: held
        )
        name = self.applied(cell)
        return self._export(source, table, cell, name)[name]

    def _export(
        self, source: ResultSource, table: CompensationTable, cell: Configuration, *names: str
    ) -> dict[str, ExportFiles]:
        """Return the files; a controller that the group bridge names has its options there."""
        return export_files(
            source,
            table,
            names,
            self.spacing_deg * DEGREE or None,
            accept_unverified=self.accept_unverified,
            settings={cell.bridge.controller: cell.bridge.controller_settings},
        )


@dataclass(frozen=True)
class FinishedSession:
    """A finished session and its result."""

    session: Session
    source: ResultSource

    @property
    def cell(self) -> Configuration:
        """The configuration of the measurement."""
        return self.session.configuration


def begin_verification(
    configuration: Path,
    folder: Path,
    changes: Sequence[str],
    request: VerificationRequest,
    *,
    keep_previous: bool = False,
) -> None:
    """Check all that will be measured and written, then make ``folder`` with the request.

    ``changes`` hold for all measurements. Raises ConfigurationError before anything is made.
    """
    calibration = checked_calibration(configuration, changes)
    checked_calibration(configuration, (*changes, *request.check))
    _require_known(calibration.configuration, request)
    given, known = calibration.configuration.given, group_nodes().items()
    behind = [group for group, node in known if group in given and SIMULATION in node.instead_of]
    if calibration.configuration.simulated and behind:
        raise ConfigurationError(
            f"{configuration}: its group {behind[0]!r} puts the simulated cell behind another "
            "process, whose control takes no table from here; verify one without that group"
        )
    _rehearse(request, calibration)
    above = next(path for path in (folder, *folder.parents) if path.exists())
    if not (above.is_dir() and os.access(above, os.W_OK | os.X_OK)):
        raise ConfigurationError(
            f"{folder} cannot be made: {above} takes no new files; choose another -o"
        )
    require_ros()
    prepare_session(configuration, folder, changes, keep_previous=keep_previous)
    write_atomically(folder / REQUEST, json.dumps(asdict(request), indent=1) + "\n")


def run_verification(
    folder: Path, loaded: Loaded | None = None
) -> tuple[Verification, tuple[str, ...]] | None:
    """Do what is left of the verification in ``folder``; None if the user ended it.

    Returns the outcome and the controllers that got files. ``folder`` is the session of the first
    measurement and gets ``compensation``, the session ``after`` and verification.json; with
    ``again`` the session of that name too. ``loaded`` asks a person to load files into a real
    control, and returns whether that was done; without it, or until then, the answer is None.
    Raises DataError for a result that is not ok, ConfigurationError if no verification was begun.
    """
    request = _read_request(folder)
    first = SessionFolder(folder)
    before = _measure(first.configuration, folder, (), folder)
    if before is None:
        return None
    exports = request.files(before.source, before.cell)
    applied = exports[request.applied(before.cell)]
    after = _round(folder, "after", before, exports, applied, loaded)
    if after is None:
        return None
    rounds = {"before": before, "after": after}
    effect = effect_from_result(after.source.result, held_table(applied.controller, applied.files))
    if request.again and not (effect and effect.fault):
        further = request.added(after.source, after.cell, applied)
        name = request.applied(before.cell)
        third = _round(folder, "again", before, {name: further}, further, loaded)
        if third is None:
            return None
        rounds["again"] = third
    verification = _outcome(rounds, applied.residual.stated, effect)
    data = verification.to_dict() | {"controllers": list(exports)}
    write_atomically(folder / VERIFICATION, json.dumps(data, indent=1) + "\n")
    return verification, tuple(exports)


def confirm_loaded(folder: Path) -> None:
    """Note that a person says the real control has loaded the waiting table.

    Raises ConfigurationError if none waits: a table that is not written yet cannot be loaded.
    """
    request = _read_request(folder)
    applied = request.applied(read_configuration(SessionFolder(folder).configuration))
    for name, tables in TABLES.items():
        texts = map(load_json, map(read_text, (folder / tables).glob(f"*{PROVENANCE}")))
        sides = [side for side in texts if side["controller"] == applied]
        word = folder / f"{LOADED}_{name}.json"
        if sides and not word.is_file():
            contents = sides[0][CONTENTS]
            write_atomically(word, json.dumps({"contents_sha256": contents}) + "\n")
            return
    raise ConfigurationError(f"{folder} has no table waiting to be loaded: leave out --loaded")


def _round(
    folder: Path,
    name: str,
    before: FinishedSession,
    exports: dict[str, ExportFiles],
    applied: ExportFiles,
    loaded: Loaded | None,
) -> FinishedSession | None:
    """Put the table that is ``applied`` into force and measure in the session ``name``.

    None if the user ended it, or has not loaded the table yet.
    """
    tables = folder / TABLES[name]
    _write_once(exports, tables)
    changes = [*_read_request(folder).check, f"cell.table_in_force={hash_in_force(applied.files)}"]
    if before.cell.simulated:
        changes += [*_rows(applied), f"simulation.run={1 + list(TABLES).index(name)}"]
    elif not _is_loaded(folder, name, applied, loaded):
        return None
    measured = _measure(SessionFolder(folder).configuration, folder / name, changes, folder)
    if measured is None or before.cell.simulated:
        return measured
    found, wanted = measured.source.result.measured_on, hash_in_force(applied.files)
    if found != wanted:
        raise DataError(
            f"{folder / name} was measured with the table {found[:12]} in force, and the one to "
            f"verify is {wanted[:12]}: load the files in {tables}, and begin another verification"
        )
    return measured


def _is_loaded(folder: Path, name: str, applied: ExportFiles, loaded: Loaded | None) -> bool:
    """Return whether a person has confirmed that the table is in the control; noted on disk."""
    word = folder / f"{LOADED}_{name}.json"
    contents = hash_in_force(applied.files)
    if word.is_file():
        if load_json(read_text(word)) == {"contents_sha256": contents}:
            return True
        raise DataError(
            f"{word} is about another table than {contents[:12]}: begin another verification"
        )
    files = [folder / TABLES[name] / file for file in without_provenance(applied.files)]
    if loaded is None or not loaded(folder, files):
        return False
    write_atomically(word, json.dumps({"contents_sha256": contents}) + "\n")
    return True


def _read_request(folder: Path) -> VerificationRequest:
    try:
        data = load_json(read_text(folder / REQUEST))
        return record(VerificationRequest, data)
    except FileNotFoundError:
        raise ConfigurationError(
            f"{folder} holds no verification: its {REQUEST} is missing; begin one with 'rotcal "
            "verify CONFIG', or resume a single measurement: rotcal run --resume "
            f"{folder}"
        ) from None
    except (OSError, ValueError) as error:
        raise ConfigurationError(
            f"{folder / REQUEST} is damaged: {cause_of(error)}; start again: rotcal verify CONFIG"
        ) from error


def _outcome(
    rounds: dict[str, FinishedSession], stated: float, effect: CorrectionEffect | None
) -> Verification:
    again = rounds.get("again")
    simulated = rounds["before"].cell.simulated
    return Verification(
        before=positioning(rounds["before"].source.result),
        after=positioning(rounds["after"].source.result),
        again=positioning(again.source.result) if again else None,
        stated=stated,
        iso={when: _true_figures(m) for when, m in rounds.items()} if simulated else {},
        verdict_lines={when: m.source.result.verdict_line for when, m in rounds.items()},
        effect=effect,
        simulated=simulated,
    )


def _require_known(cell: Configuration, request: VerificationRequest) -> None:
    """Raise ConfigurationError unless a real cell states its controller and table in force."""
    if cell.simulated:
        return
    if not request.controllers and "bridge" not in cell.given:
        raise ConfigurationError(
            "which controller takes the table of this real cell? Name it: --to linuxcnc, or a "
            "group bridge with its controller and options"
        )
    if cell.cell.table_in_force != NONE:
        raise ConfigurationError(
            f"cell.table_in_force is {cell.cell.table_in_force[:12]}: a verification begins with "
            "no table in force. Remove the table or switch it off, and say so: --set "
            f"cell.table_in_force={NONE}"
        )


def _rehearse(request: VerificationRequest, calibration: Calibration) -> None:
    """Make the controller files of a perfect table; raise ConfigurationError if that fails.

    So a misspelt controller, or rows that it cannot hold, are reported at once.
    """
    angles = np.unique(calibration.plan.table_angles)
    nothing = {"ECC": np.zeros(len(angles))}
    covariance = {"ECC": np.zeros((len(angles), len(angles)))}
    perfect = Result(
        calibration.plan.method, angles, nothing, nothing, covariance, 1.0, 0, 0, measured_on=NONE
    )
    request.files(ResultSource(perfect, {}), calibration.configuration)


def _measure(
    configuration: Path, path: Path, changes: Sequence[str], whole: Path
) -> FinishedSession | None:
    """Return the measurement in the session ``path``, after doing what is missing of it.

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
        with Viewers(session) as viewers:
            outcome = calibrate(session, viewers)
            viewers.end(outcome)
        if outcome.get("interrupted"):
            return None
    if session.configuration.simulated and not folder.truth.is_file():
        write_truth(session)
    source = read_source(folder.result)
    if source.result.verdict != "ok":
        raise DataError(
            f"the measurement {path} has the verdict {source.result.verdict}: "
            f"{'; '.join(source.result.warnings)}"
        )
    return FinishedSession(session, source)


def _write_once(exports: dict[str, ExportFiles], folder: Path) -> None:
    """Write the files that an interrupted verification has not written yet.

    Raises DataError if an existing one holds another table.
    """
    left = {}
    for name, export in exports.items():
        for file, text in without_provenance(export.files).items():
            if (folder / file).is_file() and read_text(folder / file, "latin-1") != text:
                raise DataError(
                    f"{folder / file} was changed since it was written; restore it, or start again"
                )
        there = {file: text for file, text in export.files.items() if (folder / file).exists()}
        rest = {file: text for file, text in export.files.items() if file not in there}
        left[name] = replace(export, files=rest)
    write_exports(left, folder)


def _rows(export: ExportFiles) -> list[str]:
    """Return the changes that put the written table into the simulated control."""
    files = {name: text for name, text in export.files.items() if name.endswith(".csv")}
    rows = plain_csv.PlainCsv().read(files)
    columns = {
        "angles_deg": rows.angle_deg,
        "forward_arcsec": rows.forward_arcsec,
        "reverse_arcsec": rows.reverse_arcsec,
    }
    return [
        f"simulation.table.compensation.{name}=[{', '.join(f'{x:.9f}' for x in column)}]"
        for name, column in columns.items()
    ]


def _true_figures(measured: FinishedSession) -> Iso230:
    """Return ISO 230-2 of the simulated axis itself over the measured travel."""
    angles = measured.source.result.angles
    targets = np.linspace(angles[0], angles[-1], ISO_TARGETS)
    settings = measured.session.configuration.simulation
    return iso230(BidirectionalRuns(targets, *true_runs(settings, targets, ISO_RUNS)))
