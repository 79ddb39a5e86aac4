"""All measured deviations, EXC .. ECC, for volumetric compensation, as neutral CSV and JSON.

Deviations, not corrections: actual - commanded, metres and radians, ISO 230-1 names. An absent
component has no column; one that was measured from both sides has three: the mean, forward and
reverse. Every number is written so that it is read back to the last bit.
"""

from __future__ import annotations

import json
from typing import Final

import numpy as np

from rotcal_ros.compensation import controller_files
from rotcal_ros.compensation.table import check_verdict
from rotcal_ros.compensation.writing import check_stem
from rotcal_ros.foundation.arrays import Floats, std_of
from rotcal_ros.foundation.components import COMPONENTS, TRANSLATIONS, check_axis, unit_of
from rotcal_ros.foundation.curves.directional import refuse_lost_reversal
from rotcal_ros.foundation.errors import BagError, DataError
from rotcal_ros.foundation.in_force import describe, known_hash
from rotcal_ros.foundation.results import Result

SIGN: Final = "deviation = actual - commanded; angles counter-clockwise about +z"
KIND: Final = "rotcal_volumetric"


def volumetric_files(result: Result, stem: str, axis: str = "C") -> dict[str, str]:
    """Return ``stem``.csv and ``stem``.json after both were read back and compared.

    Raises DataError unless the verdict is ok and every component has its uncertainty, and for runs
    from both sides of which only the mean is known.
    """
    check_stem(stem)
    check_axis(axis)
    check_verdict(result)
    refuse_lost_reversal(result)
    names = [name for name in COMPONENTS if name in result.deviations]
    if missing := [name for name in names if name not in result.std]:
        raise DataError(f"the {result.method} result has no uncertainty of {', '.join(missing)}")
    deviations, std = _columns(result, names)
    columns = {"angle_rad": result.angles}
    for name, values in deviations.items():
        columns[f"{name}_{_si_unit(name)}"] = values
        columns[f"u_{name}_{_si_unit(name)}"] = std[name]
    numbers = np.column_stack(list(columns.values()))
    lines = [",".join(columns), *(",".join(map(repr, row)) for row in numbers.tolist())]
    on_top = [describe(result.measured_on)] if known_hash(result.measured_on) else []
    data = {
        "schema": 1,
        "kind": KIND,
        "axis": axis,
        "sign": SIGN,
        "units": {name: _si_unit(name) for name in deviations},
        "method": result.method,
        "simulated": result.simulated,
        "item": result.circumstances.identity.title,
        "serial": result.circumstances.identity.serial,
        "measured_on": result.measured_on,
        "verdict": result.verdict,
        "verdict_line": result.verdict_line,
        "not_protected": list(result.unprotected),
        "angles_rad": result.angles.tolist(),
        "deviations": {name: values.tolist() for name, values in deviations.items()},
        "std": {name: values.tolist() for name, values in std.items()},
        "warnings": [*result.warnings, *_one_sided(result, names), *on_top],
    }
    table, facts = "\n".join(lines) + "\n", json.dumps(data, indent=1) + "\n"
    found = controller_files.numbers(f"{stem}.csv", table.splitlines()[1:], len(columns), ",")
    for file, same in (
        ("csv", np.array_equal(found, numbers)),
        ("json", json.loads(facts) == data),
    ):
        if not same:
            raise BagError(f"{stem}.{file}: read back, it differs from what was measured")
    return {f"{stem}.csv": table, f"{stem}.json": facts}


def _columns(result: Result, names: list[str]) -> tuple[dict[str, Floats], dict[str, Floats]]:
    """Return deviations and standard uncertainties (n,), then those of each direction."""
    deviations = {name: result.deviations[name] for name in names}
    std = {name: result.std[name] for name in names}
    for name, both in result.directions.items():
        if np.array_equal(both.angles, result.angles):
            deviations |= {f"{name}_forward": both.forward, f"{name}_reverse": both.reverse}
            own = np.split(std_of(both.covariance), 2)
            std[f"{name}_forward"], std[f"{name}_reverse"] = own
    return deviations, std


def _one_sided(result: Result, names: list[str]) -> list[str]:
    """Return in words how much of a known reversal is missing in the columns."""
    found = []
    for name, both in result.directions.items():
        if name in names and not np.array_equal(both.angles, result.angles):
            scale, unit = unit_of(name)
            found.append(
                f"{name} is the mean of both directions, since some angles were reached only from "
                f"one side: up to {np.max(np.abs(both.reversal)) / scale:.3g} {unit} of reversal "
                "are not in the columns"
            )
    return found


def _si_unit(column: str) -> str:
    return "m" if column[:3] in TRANSLATIONS else "rad"
