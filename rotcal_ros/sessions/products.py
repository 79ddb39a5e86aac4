"""Writes what a finished calibration leaves beside its bag: truth, report, controller files."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, Final

import numpy as np

from rotcal_ros.compensation.cascaded_tables import combine_with_table_in_force
from rotcal_ros.compensation.export import ExportFiles, prepare_export
from rotcal_ros.compensation.table import CompensationTable, table_from_result
from rotcal_ros.compensation.writing import write_files
from rotcal_ros.foundation import plugins
from rotcal_ros.foundation.errors import BagError, RotcalError
from rotcal_ros.foundation.files import write_atomically
from rotcal_ros.foundation.session_folder import SessionFolder
from rotcal_ros.foundation.untrusted import load_json, read_text
from rotcal_ros.methods.configuration import read_policy
from rotcal_ros.methods.goal import GoalStanding
from rotcal_ros.methods.simulation.table import true_deviations
from rotcal_ros.planning.choices import UNTIL_GOAL
from rotcal_ros.recordings.replay import read_recording
from rotcal_ros.recordings.result_sources import ResultSource, read_source
from rotcal_ros.report.terminal.console import say
from rotcal_ros.sessions.session import Session

FORMATS: Final = ("csv", "linuxcnc")
"""Controller files that need no settings of the user's machine."""
_HISTORY: Final = "history"
"""The group of a configuration whose results are kept in a history."""


def write_products(
    session: Session,
    *,
    report: bool = True,
    export: bool = True,
    tell: Callable[[str], None] = say,
) -> dict[str, str]:
    """Write what follows from the result; return name -> absolute path of all files.

    A report or controller files that cannot be written never spoil a calibration, nor does a
    history that cannot be reached: the reason is printed, and they are left out.
    """
    folder = session.folder
    paths = {"bag": folder.bag, "result": folder.result}
    if session.configuration.simulated:
        write_truth(session)
        paths["truth"] = folder.truth
    if report:
        try:
            write_report(folder, _since_last_time(session))
            paths["report"] = folder.report
        except (RotcalError, OSError) as error:
            tell(f"no report: {error}")
    if export:
        try:
            _write_compensation(session)
            paths["compensation"] = folder.compensation
        except RotcalError as error:
            tell(f"no compensation files: {error}")
    if _HISTORY in session.configuration.given:
        database, axis = _place_in_history(session)
        try:
            history = plugins.extension(plugins.HISTORIES, _HISTORY, "a history")
            tell(f"history: {history.keep_session(folder, database, axis)}")
        except RotcalError as error:
            later = f"rotcal history add {folder.path} --database {database}"
            tell(f"not in the history: {error}; `{later}` adds it later")
    return {name: str(path) for name, path in paths.items()}


def _place_in_history(session: Session) -> tuple[str, str]:
    """Return the database of a configuration with a history, and the axis."""
    configuration = session.configuration
    return configuration.of_packages[_HISTORY].database, configuration.cell.axis


def _since_last_time(session: Session) -> Sequence[tuple[str, str]]:
    """Return the section of a report on what has changed, if a history records it."""
    sections: Sequence[tuple[str, str]] = ()
    if _HISTORY in session.configuration.given:
        with suppress(RotcalError):  # said when the result is to be kept
            history = plugins.extension(plugins.HISTORIES, _HISTORY, "a history")
            result = read_source(session.folder.result).result
            sections = history.since_last_time(result, *_place_in_history(session))
    return sections


def session_goal_standing(folder: SessionFolder) -> GoalStanding | None:
    """Return whether a session met its goal; None if it had none."""
    if read_policy(read_text(folder.configuration)) != UNTIL_GOAL:
        return None
    recording = read_recording(folder.bag, "observations")
    return recording.goal_standing(read_source(folder.result).result)


def write_truth(session: Session) -> None:
    """Write what the simulation injected at the plan's table angles.

    ``injected`` holds all of it, ``deviations`` what the method can see of it (Method.gauge).
    """
    calibration = session.calibration
    angles = np.array(calibration.plan.distinct_angles)
    injected = true_deviations(session.configuration.simulation.table, angles)
    seen = calibration.method.gauge(angles, injected)
    document = {
        "schema": 1,
        "angles_rad": angles.tolist(),
        "deviations": {name: values.tolist() for name, values in seen.items()},
        "injected": {name: values.tolist() for name, values in injected.items()},
    }
    write_atomically(session.folder.truth, json.dumps(document, indent=1, allow_nan=False) + "\n")


def write_report(folder: SessionFolder, extra: Sequence[tuple[str, str]] = ()) -> None:
    """Solve the bag of a session again, compare with the live result, and write the page.

    ``extra`` holds further sections as (title, HTML). Raises BagError when there is a page.
    """
    # Figures take a second to load, which a run without report should not wait for.
    from rotcal_ros.report.page import report_recording

    if folder.report.exists():
        raise BagError(f"{folder.report} exists already and nothing is overwritten")
    recording = read_recording(folder.bag)
    truth = load_json(read_text(folder.truth)) if folder.truth.exists() else None
    result = report_recording(recording, folder.report, truth, extra)
    live = recording.with_warnings(read_source(folder.result).result)
    if result.to_json() != live.to_json():
        say(f"warning: solving {folder.bag} again gives another result than the live run")


def export_files(
    source: ResultSource,
    table: CompensationTable,
    names: Sequence[str],
    spacing: float | None = None,
    *,
    accept_unverified: bool = False,
    settings: Mapping[str, Mapping[str, Any]] | None = None,
) -> dict[str, ExportFiles]:
    """Return the files of the controllers ``names``, with rows every ``spacing`` rad.

    ``settings`` are those of the controllers, by name; a missing one has its defaults.
    """
    now = datetime.now(timezone.utc)
    return {
        name: prepare_export(
            table,
            name,
            now=now,
            spacing=spacing,
            sources=source.sha256,
            accept_unverified=accept_unverified,
            settings=(settings or {}).get(name),
        )
        for name in names
    }


def write_exports(exports: dict[str, ExportFiles], folder: Path) -> None:
    """Write the files of several controllers, all or none."""
    write_files(
        {n: text for export in exports.values() for n, text in export.files.items()}, folder
    )


def _write_compensation(session: Session) -> None:
    """Write controller files if the result allows it."""
    source = read_source(session.folder.result)
    table = table_from_result(source.result, axis=session.configuration.cell.axis)
    table = combine_with_table_in_force(table, lambda: None)
    write_exports(export_files(source, table, FORMATS), session.folder.compensation)
