"""From a table to the texts of a controller's files, proven by the controller's own rule."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from datetime import datetime
from typing import Any, Final

import numpy as np

from rotcal_ros.compensation.controller import Controller
from rotcal_ros.compensation.controllers import make_controller
from rotcal_ros.compensation.quality import ResidualBudget, residual_budget
from rotcal_ros.compensation.resample import resample
from rotcal_ros.compensation.table import (
    SIGN_CONVENTION,
    CompensationTable,
    check_verdict,
)
from rotcal_ros.compensation.writing import check_stem
from rotcal_ros.components import check_axis
from rotcal_ros.errors import ConfigurationError, DataError
from rotcal_ros.units import ARCSEC, DEGREE

SCHEMA: Final = 1


@dataclass(frozen=True)
class ExportFiles:
    """Names and texts of all files of one export, the provenance included, and what they leave."""

    files: Mapping[str, str]
    residual: ResidualBudget
    warnings: tuple[str, ...]
    table: CompensationTable


def prepare_export(
    table: CompensationTable,
    controller_name: str,
    *,
    now: datetime,
    axis: str | None = None,
    spacing: float | None = None,
    reference_angle: float | None = None,
    settings: Mapping[str, Any] | None = None,
    stem: str | None = None,
    accept_unverified: bool = False,
    sources: Mapping[str, str] | None = None,
) -> ExportFiles:
    """Return the files for ``controller_name``, after they were read back and simulated.

    ``axis`` is the axis they are meant for (refused when the table is another's), ``spacing``
    and ``reference_angle`` are radians, ``settings`` go to the controller, ``stem`` is the file
    name without extension, ``sources`` maps what the numbers come from (a bag, a result) to its
    SHA-256. What nobody has verified about a controller is refused unless ``accept_unverified``.

    Raises DataError for a verdict other than "ok" or a file that would make things worse, and
    ConfigurationError for limits, names and settings. Writes nothing.
    """
    controller = make_controller(controller_name, settings)
    check_verdict(table)
    _require_axis(table, axis)
    if not accept_unverified:
        _refuse_unverified(controller)
    name = check_stem(stem or f"{table.axis}_{controller_name}".lower())
    shifted = resample(table, reference_angle=reference_angle)
    rows = resample(shifted, spacing)
    files = controller.write(rows, name)
    residual = residual_budget(shifted, rows, controller, controller.read(files))
    _refuse_harm(residual, controller.facts.title)
    warnings = _warnings(table, controller)
    side = {
        **_origin(table, now, sources or {}),
        "controller": controller_name,
        **_controller_facts(controller),
        **_written_rows(rows, files),
        **_left(residual, table),
        "warnings": list(warnings),
    }
    text = json.dumps(side, indent=1, allow_nan=False) + "\n"
    return ExportFiles(
        files={**files, f"{name}.provenance.json": text},
        residual=residual,
        warnings=warnings,
        table=rows,
    )


def _require_axis(table: CompensationTable, axis: str | None) -> None:
    if axis is not None and check_axis(axis) != table.axis:
        raise ConfigurationError(
            f"the table is for axis {table.axis} and the export for axis {axis}: nothing written"
        )


def _refuse_unverified(controller: Controller) -> None:
    if controller.unverified:
        raise ConfigurationError(
            f"{controller.facts.title}: not verified is {'; '.join(controller.unverified)}. Give "
            "--accept-unverified to write the file all the same, and test it with one small value "
            "first"
        )


def _refuse_harm(residual: ResidualBudget, title: str) -> None:
    """Refuse a file that leaves more than it promised, or more than there was."""
    if residual.simulated > residual.stated * (1.0 + 1e-9) + 1e-14:
        raise DataError(
            f"{title}: read back and applied by the control's rule, the file leaves "
            f"{residual.simulated / ARCSEC:.4g} arcsec, expected at most "
            f"{residual.stated / ARCSEC:.4g}: nothing was written"
        )
    if residual.simulated > residual.before + 1e-14:
        raise DataError(
            f"{title}: the table would leave {residual.simulated / ARCSEC:.4g} arcsec of a "
            f"deviation of {residual.before / ARCSEC:.4g}: the control's resolution or the "
            "spacing is too coarse for it; nothing was written"
        )


def _warnings(table: CompensationTable, controller: Controller) -> tuple[str, ...]:
    line = table.verdict_line
    reserve = (f"the result is {line}",) if line not in ("", "ok") else ()
    unverified = (f"not verified: {text}" for text in controller.unverified)
    return (*reserve, *table.warnings, *unverified)


def _origin(table: CompensationTable, now: datetime, sources: Mapping[str, str]) -> dict[str, Any]:
    """Return what the numbers come from."""
    return {
        "schema": SCHEMA,
        "written": now.isoformat(timespec="seconds"),
        "axis": table.axis,
        "method": table.method,
        "verdict": table.verdict,
        "verdict_line": table.verdict_line,
        "table_sha256": table.table_hash,
        "sources_sha256": dict(sources),
        "sign_of_the_table": SIGN_CONVENTION,
    }


def _controller_facts(controller: Controller) -> dict[str, Any]:
    words = asdict(controller.facts)
    return {"controller_title": words.pop("title"), "settings": asdict(controller), **words}


def _written_rows(rows: CompensationTable, files: Mapping[str, str]) -> dict[str, Any]:
    return {
        "files_sha256": {
            file: hashlib.sha256(text.encode()).hexdigest() for file, text in files.items()
        },
        "rows": len(rows.angles),
        "widest_spacing_deg": float(np.max(np.diff(rows.angles))) / DEGREE,
        "reference_angle_deg": rows.reference_angle / DEGREE,
    }


def _left(residual: ResidualBudget, table: CompensationTable) -> dict[str, Any]:
    figures = {**asdict(residual), "stated": residual.stated}
    count = len(table.angles)
    return {
        "residual": residual.in_words(),
        "residual_arcsec": {part: value / ARCSEC for part, value in figures.items()},
        "blind_to": f"what repeats more than {count // 2} times over the {count} angles measured",
    }
