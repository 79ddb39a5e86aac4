"""All deviations that were measured, EXC .. ECC, for volumetric compensation: neutral CSV, JSON.

Deviations, not corrections: actual - commanded, metres and radians, ISO 230-1 names. An absent
component has no column. Every number is written so that it is read back to the last bit.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from rotcal_ros.arrays import Floats
from rotcal_ros.compensation.parsing import numbers
from rotcal_ros.compensation.table import check_axis, check_verdict
from rotcal_ros.compensation.writing import check_stem
from rotcal_ros.components import COMPONENTS, TRANSLATIONS
from rotcal_ros.errors import BagError, DataError
from rotcal_ros.results import Result

SIGN: Final = "deviation = actual - commanded; angles counter-clockwise about +z"
KIND: Final = "rotcal_volumetric"


def volumetric_files(result: Result, stem: str, axis: str = "C") -> dict[str, str]:
    """Return ``stem``.csv and ``stem``.json after both were read back and compared.

    Raises DataError unless the verdict is ok and every component has its uncertainty.
    """
    check_stem(stem)
    check_axis(axis)
    check_verdict(result)
    names = [name for name in COMPONENTS if name in result.deviations]
    if missing := [name for name in names if name not in result.std]:
        raise DataError(f"the {result.method} result has no uncertainty of {', '.join(missing)}")
    columns = {"angle_rad": result.angles}
    for name in names:
        columns[f"{name}_{_si_unit(name)}"] = result.deviations[name]
        columns[f"u_{name}_{_si_unit(name)}"] = result.std[name]
    lines = [",".join(columns)]
    lines += [",".join(repr(float(x)) for x in row) for row in zip(*columns.values(), strict=True)]
    data = {
        "schema": 1,
        "kind": KIND,
        "axis": axis,
        "sign": SIGN,
        "units": {name: _si_unit(name) for name in names},
        "method": result.method,
        "verdict": result.verdict,
        "angles_rad": result.angles.tolist(),
        "deviations": {name: result.deviations[name].tolist() for name in names},
        "std": {name: result.std[name].tolist() for name in names},
        "warnings": list(result.warnings),
    }
    table, facts = "\n".join(lines) + "\n", json.dumps(data, indent=1) + "\n"
    for file, found in (("csv", _csv_columns(table)), ("json", _json_columns(facts))):
        if not _equal(found, columns):
            raise BagError(f"{stem}.{file}: read back, it is not what was measured")
    return {f"{stem}.csv": table, f"{stem}.json": facts}


def _csv_columns(text: str) -> dict[str, Floats]:
    """Return the columns of the CSV form by title."""
    head, *lines = text.splitlines()
    titles = head.split(",")
    return dict(zip(titles, numbers("volumetric", lines, len(titles), ",").T, strict=True))


def _json_columns(text: str) -> dict[str, Floats]:
    """Return the columns of the JSON form under the titles of the CSV form."""
    data: dict[str, Any] = json.loads(text)
    columns = {"angle_rad": data["angles_rad"]}
    for name, unit in data["units"].items():
        columns[f"{name}_{unit}"] = data["deviations"][name]
        columns[f"u_{name}_{unit}"] = data["std"][name]
    return {title: np.array(column, dtype=np.float64) for title, column in columns.items()}


def _equal(found: Mapping[str, Floats], wanted: Mapping[str, Floats]) -> bool:
    return list(found) == list(wanted) and all(
        np.array_equal(found[title], column) for title, column in wanted.items()
    )


def _si_unit(component: str) -> str:
    return "m" if component in TRANSLATIONS else "rad"
