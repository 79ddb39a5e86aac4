"""What a finished calibration leaves beside its bag: truth, report, controller files."""

from __future__ import annotations

import json
from collections.abc import Mapping
from datetime import datetime, timezone
from hashlib import sha256
from pathlib import Path
from typing import Final

import numpy as np

from rotcal_ros.cli.console import say
from rotcal_ros.compensation.export import prepare_export
from rotcal_ros.compensation.table import table_from_result
from rotcal_ros.compensation.writing import write_files
from rotcal_ros.errors import RotcalError
from rotcal_ros.files import write_atomically
from rotcal_ros.results import Result
from rotcal_ros.sessions.session import Session
from rotcal_ros.simulation import SimulatedCell

FORMATS: Final = ("csv", "linuxcnc")
"""Controller files that need no settings of the user's machine."""


def write_products(
    session: Session, *, report: bool = True, export: bool = True
) -> dict[str, str]:
    """Write what follows from the result; return name -> absolute path of all there is."""
    result_file = session.folder / "result.json"
    paths = {"bag": session.folder / "bag", "result": result_file}
    if session.simulated:
        paths["truth"] = _write_truth(session)
    if report:
        paths |= _write_report(session, result_file, paths)
    folder = _write_compensation(session, result_file) if export else None
    if folder is not None:
        paths["compensation"] = folder
    return {name: str(path) for name, path in paths.items()}


def _write_truth(session: Session) -> Path:
    """Write what the simulation injected at the plan's table angles.

    ``injected`` holds it all, ``deviations`` what the method can see of it: see Method.gauge.
    """
    settings = session.configuration.simulation
    calibration = session.calibration
    angles = np.array(calibration.plan.table_angles)
    cell = SimulatedCell(settings)
    truth = cell.truth_dict(angles)
    truth["injected"] = truth["deviations"]
    seen = calibration.method.gauge(angles, cell.truth(angles))
    truth["deviations"] = {name: values.tolist() for name, values in seen.items()}
    path = session.folder / "truth.json"
    write_atomically(path, json.dumps(truth, indent=1, allow_nan=False) + "\n")
    return path


def _write_report(
    session: Session, result_file: Path, paths: Mapping[str, Path]
) -> dict[str, Path]:
    """Solve the bag again, compare with the live result, and write the page of the recording.

    A failing report never spoils a calibration: it is told and left out.
    """
    # Figures take a second to load, which a run without report should not wait for.
    from rotcal_ros.recordings.replay import read_recording
    from rotcal_ros.report.page import write_report
    from rotcal_ros.report.recorded import report_of

    page = session.folder / "report.html"
    try:
        recording = read_recording(paths["bag"])
        result = recording.solve()
        if result.to_dict() != json.loads(result_file.read_text(encoding="utf-8")):
            say("warning: the bag solved again gives another result than live; see 'rotcal solve'")
        truth = json.loads(paths["truth"].read_text()) if "truth" in paths else None
        write_report(report_of(recording, result, truth), page)
    except (RotcalError, OSError) as error:
        say(f"no report: {error}")
        return {}
    return {"report": page}


def _write_compensation(session: Session, result_file: Path) -> Path | None:
    """Write controller files where the result allows it; say why not otherwise."""
    text = result_file.read_bytes()
    cell = session.configuration.cell
    folder = session.folder / "compensation"
    files: dict[str, str] = {}
    try:
        table = table_from_result(Result.from_dict(json.loads(text)), axis=cell.axis)
        for name in FORMATS:
            sources = {result_file.name: sha256(text).hexdigest()}
            now = datetime.now(timezone.utc)
            files |= prepare_export(table, name, now=now, sources=sources).files
        folder.mkdir()
        write_files(files, folder)
    except RotcalError as error:
        say(f"no compensation files: {error}")
        return None
    return folder
