"""All deviations that were measured, EXC .. ECC, for volumetric compensation: neutral CSV, JSON.

Deviations, not corrections: actual - commanded, metres and radians, ISO 230-1 names. An absent
component has no column. Every number is written so that it is read back to the last bit.
"""

from __future__ import annotations

import json
from typing import Final

import numpy as np

from rotcal_ros.compensation import parsing
from rotcal_ros.compensation.table import check_verdict
from rotcal_ros.compensation.writing import check_stem
from rotcal_ros.components import COMPONENTS, TRANSLATIONS, check_axis
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
    numbers = np.column_stack(list(columns.values()))
    lines = [",".join(columns), *(",".join(map(repr, row)) for row in numbers.tolist())]
    data = {
        "schema": 1,
        "kind": KIND,
        "axis": axis,
        "sign": SIGN,
        "units": {name: _si_unit(name) for name in names},
        "method": result.method,
        "verdict": result.verdict,
        "verdict_line": result.verdict_line,
        "not_protected": list(result.unprotected),
        "angles_rad": result.angles.tolist(),
        "deviations": {name: result.deviations[name].tolist() for name in names},
        "std": {name: result.std[name].tolist() for name in names},
        "warnings": list(result.warnings),
    }
    table, facts = "\n".join(lines) + "\n", json.dumps(data, indent=1) + "\n"
    found = parsing.numbers(f"{stem}.csv", table.splitlines()[1:], len(columns), ",")
    for file, same in (
        ("csv", np.array_equal(found, numbers)),
        ("json", json.loads(facts) == data),
    ):
        if not same:
            raise BagError(f"{stem}.{file}: read back, it is not what was measured")
    return {f"{stem}.csv": table, f"{stem}.json": facts}


def _si_unit(component: str) -> str:
    return "m" if component in TRANSLATIONS else "rad"
