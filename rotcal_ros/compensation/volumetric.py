"""All deviations that were measured, EXC .. ECC, for volumetric compensation: neutral CSV, JSON.

Deviations, not corrections: actual - commanded, metres and radians, ISO 230-1 names. An absent
component has no column. Every number is written so that it is read back to the last bit.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from rotcal_ros.arrays import Floats
from rotcal_ros.compensation.controller import only_file, parse_rows
from rotcal_ros.compensation.table import check_axis
from rotcal_ros.compensation.writing import check_stem
from rotcal_ros.components import COMPONENTS, TRANSLATIONS
from rotcal_ros.errors import BagError, DataError
from rotcal_ros.results import Result

SIGN: Final = "deviation = actual - commanded; angles counter-clockwise about +z"
KIND: Final = "rotcal_volumetric"


@dataclass(frozen=True, eq=False)
class VolumetricErrors:
    """``deviations`` and ``std`` (k = 1) map ISO 230-1 names to (n,) at ``angles`` (n,) rad."""

    angles: Floats
    deviations: Mapping[str, Floats]
    std: Mapping[str, Floats]


def volumetric_files(result: Result, stem: str, axis: str = "C") -> dict[str, str]:
    """Return ``stem``.csv and ``stem``.json; DataError unless the verdict is ok and all finite."""
    check_stem(stem)
    check_axis(axis)
    if result.verdict != "ok":
        raise DataError(
            f"the verdict of the {result.method} result is '{result.verdict}': only 'ok' may be "
            "fed to a controller"
        )
    present = [name for name in COMPONENTS if name in result.deviations]
    columns = {"angle_rad": result.angles}
    for name in present:
        columns[f"{name}_{_unit(name)}"] = result.deviations[name]
        columns[f"u_{name}_{_unit(name)}"] = result.std[name]
    for name, column in columns.items():
        if np.shape(column) != np.shape(result.angles) or not np.all(np.isfinite(column)):
            raise DataError(
                f"{name}: not one finite number at each of {len(result.angles)} angles"
            )
    lines = [",".join(columns)]
    lines += [",".join(repr(float(x)) for x in row) for row in zip(*columns.values(), strict=True)]
    data = {
        "schema": 1,
        "kind": KIND,
        "axis": axis,
        "sign": SIGN,
        "units": {name: _unit(name) for name in present},
        "method": result.method,
        "verdict": result.verdict,
        "angles_rad": np.asarray(result.angles).tolist(),
        "deviations": {name: np.asarray(result.deviations[name]).tolist() for name in present},
        "std": {name: np.asarray(result.std[name]).tolist() for name in present},
        "warnings": list(result.warnings),
    }
    return {
        f"{stem}.csv": "\n".join(lines) + "\n",
        f"{stem}.json": json.dumps(data, indent=1, allow_nan=False) + "\n",
    }


def read_volumetric_csv(files: Mapping[str, str]) -> VolumetricErrors:
    """Read the CSV form back; BagError names what is damaged."""
    name, text = only_file(files, ".csv")
    head, *lines = text.splitlines() or [""]
    titles = head.split(",")
    data = parse_rows(name, lines, len(titles), ",")
    known = {f"{prefix}{c}_{_unit(c)}" for c in COMPONENTS for prefix in ("", "u_")}
    if titles[0] != "angle_rad" or not set(titles[1:]) <= known:
        raise BagError(f"{name}: the columns are {head}, expected angle_rad, EXC_m, u_EXC_m, ...")
    by_name = dict(zip(titles, data.T, strict=True))
    present = [c for c in COMPONENTS if f"{c}_{_unit(c)}" in by_name]
    return VolumetricErrors(
        angles=data[:, 0],
        deviations={c: by_name[f"{c}_{_unit(c)}"] for c in present},
        std={c: by_name[f"u_{c}_{_unit(c)}"] for c in present if f"u_{c}_{_unit(c)}" in by_name},
    )


def read_volumetric_json(files: Mapping[str, str]) -> VolumetricErrors:
    """Read the JSON form back; BagError when it is not one."""
    name, text = only_file(files, ".json")
    try:
        data = json.loads(text)
        if data["kind"] != KIND:
            raise BagError(f"{name}: kind is {data['kind']!r}, expected {KIND!r}")
        return VolumetricErrors(
            angles=np.array(data["angles_rad"], dtype=np.float64),
            deviations={c: np.array(v, dtype=np.float64) for c, v in data["deviations"].items()},
            std={c: np.array(v, dtype=np.float64) for c, v in data["std"].items()},
        )
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise BagError(f"{name}: no volumetric table of this project: {error!r}") from error


def _unit(component: str) -> str:
    return "m" if component in TRANSLATIONS else "rad"
