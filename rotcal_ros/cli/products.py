"""What a finished calibration leaves beside its bag: truth, controller files."""

from __future__ import annotations

import json
from datetime import datetime, timezone
from hashlib import sha256
from pathlib import Path
from typing import Final

from rotcal_ros.bags.durable import write_atomically
from rotcal_ros.cli.console import say
from rotcal_ros.cli.session import SIMULATION, Session
from rotcal_ros.compensation.export import prepare_export
from rotcal_ros.compensation.table import table_from_result
from rotcal_ros.compensation.writing import write_files
from rotcal_ros.errors import RotcalError
from rotcal_ros.planning.cell_settings import CellSettings
from rotcal_ros.results import Result
from rotcal_ros.simulation import SimulatedCell, SimulationSettings

FORMATS: Final = ("csv", "linuxcnc")
"""Controller files that need no settings of the user's machine."""


def write_products(session: Session, *, report: bool) -> dict[str, str]:
    """Write what follows from the result; return name -> absolute path of all there is."""
    result_file = session.folder / "result.json"
    paths = {"bag": session.folder / "bag", "result": result_file}
    if session.simulated:
        paths["truth"] = _write_truth(session)
    if report:
        page = _write_report(session)
        if page is not None:
            paths["report"] = page
    folder = _write_compensation(session, result_file)
    if folder is not None:
        paths["compensation"] = folder
    return {name: str(path) for name, path in paths.items()}


def _write_truth(session: Session) -> Path:
    """Write what the simulation injected at the plan's table angles."""
    settings = session.configuration.group(SIMULATION, SimulationSettings)
    truth = SimulatedCell(settings).truth_dict(session.calibration.plan.table_angles)
    path = session.folder / "truth.json"
    write_atomically(path, json.dumps(truth, indent=1, allow_nan=False) + "\n")
    return path


def _write_report(session: Session) -> Path | None:
    """Write the page of the recording; a report that fails never spoils the calibration."""
    return None


def _write_compensation(session: Session, result_file: Path) -> Path | None:
    """Write controller files where the result allows it; say why not otherwise."""
    text = result_file.read_bytes()
    cell = session.configuration.group("cell", CellSettings)
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
