"""What the evaluating verbs read: results of any method, bags, reference tables."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

from rotcal_ros.errors import BagError, DataError

if TYPE_CHECKING:
    from rotcal_ros.curves.measured import MeasuredCurve
    from rotcal_ros.results import Result


def read_text(path: Path) -> str:
    """Return the text of ``path``, a byte order mark left out; raises BagError."""
    try:
        return path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise BagError(f"cannot read {path}: {error}") from error


def read_result(path: Path) -> Result:
    """Return the result in ``path``: a result.json, or a bag, which is solved."""
    from rotcal_ros.results import Result

    if path.suffix != ".json":
        from rotcal_ros.recordings.replay import read_recording

        return read_recording(path).solve()
    try:
        return Result.from_dict(json.loads(read_text(path)))
    except (ValueError, DataError) as error:
        raise DataError(f"{path}: {error}") from error


def read_curve(path: Path, component: str, polygon: MeasuredCurve | None) -> MeasuredCurve:
    """Return one deviation curve of a result, a bag, or a reference table (.csv).

    ``polygon`` holds the face errors that are taken off reference tables.
    """
    if path.suffix != ".csv":
        from rotcal_ros.curves.measured import measured_curve

        return measured_curve(read_result(path), component)
    if component != "ECC":
        raise DataError(f"{path}: a reference table holds ECC only, {component} was asked for")
    from rotcal_ros.evaluation.reference import read_reference, without_polygon

    reading = read_reference(read_text(path), str(path))
    return reading if polygon is None else without_polygon(reading, polygon)
