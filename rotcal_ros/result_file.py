"""A result from its machine-readable form: every entry checked before anybody computes with it.

What is read here can be printed, drawn, compared and exported; a file that was cut or edited ends
in one error with the entry that is wrong.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, Final, get_args

import numpy as np

from rotcal_ros.arrays import Floats
from rotcal_ros.circumstances import Circumstances
from rotcal_ros.errors import ConfigurationError, DataError
from rotcal_ros.in_force import UNKNOWN, check_in_force
from rotcal_ros.protection import Protection, ordered
from rotcal_ros.raw_data import RawData
from rotcal_ros.records import record
from rotcal_ros.results import (
    FILE_NAMES,
    RUNS,
    SCHEMA,
    Directions,
    FreeDirection,
    Rejection,
    RepeatedRuns,
    Residuals,
    Result,
    Verdict,
    Zeros,
)

_WHOLE: Final[Mapping[str, type]] = {
    "table_position": np.int64,
    "target": np.int64,
    "used": np.bool_,
}
"""Columns of the residuals that are no floats."""
_ROUNDING: Final = 1e-6
"""Of the largest variance, by which a covariance may exceed what the variances allow."""


@dataclass(frozen=True)
class _Plain:
    """The entries of a file that are no arrays."""

    method: str
    sigma0: float
    dof: int
    n_observations: int
    rejected: tuple[Rejection, ...]
    verdict: str
    warnings: tuple[str, ...]
    details: Mapping[str, Any]
    protections: tuple[Protection, ...]
    measured_on: str = UNKNOWN


def result_from(data: Any) -> Result:
    """Return the result that ``data`` (see :meth:`Result.to_dict`) states.

    Raises DataError, with the entry, when it is none or does not fit together.
    """
    if not isinstance(data, Mapping) or data.get("schema") != SCHEMA:
        raise DataError(f"not a rotcal result of schema {SCHEMA}: no matching 'schema' entry")
    try:
        return _result(data)
    except KeyError as error:
        raise DataError(f"no whole rotcal result: the entry {error} is missing") from error
    except (ArithmeticError, AttributeError, ConfigurationError, TypeError, ValueError) as error:
        raise DataError(f"damaged rotcal result: {error}") from error


def _result(data: Mapping[str, Any]) -> Result:
    for field in fields(_Plain)[:-1]:
        data[field.name]
    plain = record(_Plain, {f.name: data[f.name] for f in fields(_Plain) if f.name in data})
    if plain.verdict not in get_args(Verdict):
        raise ValueError(f"verdict: {plain.verdict!r} is none of {', '.join(get_args(Verdict))}")
    angles = _column(data["angles_rad"], "angles_rad")
    n, runs = len(angles), _runs(plain.details.get(RUNS))
    deviations = _columns(data["deviations"], "deviations", (n,))
    std = _columns(data["std"], "std", (n,))
    if n == 0 or not std.keys() >= deviations.keys():
        raise ValueError("expected angles, and a std for each of the deviations")
    if any(np.any(column < 0.0) for column in std.values()):
        raise ValueError("std: expected no negative number")
    return Result(
        method=plain.method,
        angles=angles,
        deviations=deviations,
        std=std,
        covariance=_covariances(data["covariance"], n),
        sigma0=plain.sigma0,
        dof=plain.dof,
        n_observations=plain.n_observations,
        rejected=plain.rejected,
        verdict=data["verdict"],
        warnings=plain.warnings,
        protections=ordered(plain.protections),
        adjacent_deviations=_optional(data, "adjacent_deviations_rad", (n - 1,)),
        adjacent_std=_optional(data, "adjacent_std_rad", (n - 1,)),
        residuals=None if data.get("residuals") is None else _residuals(data["residuals"]),
        details={k: v for k, v in plain.details.items() if not (runs and k == RUNS)},
        runs=runs,
        directions=_directions(data.get("directions", {})),
        measured_on=check_in_force(plain.measured_on),
        circumstances=Circumstances.from_dict(data["circumstances"]),
        raw_data=RawData.from_dict(data["raw_data"], n) if "raw_data" in data else RawData(),
        zeros=_zeros(data.get("zeros", {}), n),
    )


def _zeros(data: Mapping[str, Any], n: int) -> Zeros:
    if data and data["within"] not in get_args(Verdict):
        raise ValueError(f"zeros.within: {data['within']!r:.60} is no verdict")
    free = [
        FreeDirection(str(d["name"]), _columns(d["columns"], "zeros.free", (n,)))
        for d in data.get("free", ())
    ]
    counts_from = str(data.get("counts_from", UNKNOWN))
    return Zeros(counts_from, tuple(free), data.get("within", "ok"))


def _runs(data: Any) -> RepeatedRuns | None:
    if not isinstance(data, Mapping) or "targets" not in data:
        return None
    targets = _column(data["targets"], "runs.targets")
    sides = {name: _side(data.get(name), len(targets), name) for name in ("forward", "reverse")}
    shapes = {np.shape(side) for side in sides.values() if side is not None}
    if len(shapes) > 1:
        raise ValueError(f"runs: forward and reverse have different shapes {sorted(shapes)}")
    repeatability = data.get("repeatability_std")
    if not isinstance(repeatability, float | int | None):
        raise ValueError(f"runs.repeatability_std: expected a number, found {repeatability!r:.60}")
    return RepeatedRuns(targets=targets, **sides, repeatability_std=repeatability)


def _side(values: Any, targets: int, name: str) -> Floats | None:
    if values is None:
        return None
    side = _floats(values, f"runs.{name}")
    if side.ndim != 2 or len(side) != targets:
        raise ValueError(f"runs.{name}: expected a row for each of {targets} targets")
    return side


def _directions(data: Any) -> dict[str, Directions]:
    columns = [field.name for field in fields(Directions)]
    return {
        name: Directions(
            **{c: _floats(both[FILE_NAMES.get(c, c)], f"directions.{name}.{c}") for c in columns}
        )
        for name, both in dict(data).items()
    }


def _residuals(data: Mapping[str, Any]) -> Residuals:
    names = [field.name for field in fields(Residuals) if field.name not in ("std", "coordinates")]
    columns: dict[str, Any] = {}
    for name in names:
        key = FILE_NAMES.get(name, name)
        whole = _WHOLE.get(name)
        columns[name] = (
            _floats(data[key], f"residuals.{key}")
            if whole is None
            else np.asarray(data[key], whole)
        )
    shape = np.shape(columns["residual"])
    std, coordinates = _optional(data, "std", shape), data.get("coordinates", 1)
    if len(shape) != 1 or any(np.shape(column) != shape for column in columns.values()):
        raise ValueError("residuals: expected columns of one length")
    if coordinates not in (1, 3):
        raise ValueError(f"residuals.coordinates: expected 1 or 3, found {coordinates!r:.60}")
    return Residuals(**columns, std=std, coordinates=coordinates)


def _columns(data: Any, where: str, shape: tuple[int, ...]) -> dict[str, Floats]:
    """Return arrays of finite numbers by component, all of one ``shape``."""
    columns = {name: _floats(values, f"{where}.{name}") for name, values in dict(data).items()}
    for name, column in columns.items():
        if column.shape != shape or not np.all(np.isfinite(column)):
            raise ValueError(f"{where}.{name}: expected finite numbers of the shape {shape}")
    return columns


def _covariances(data: Any, n: int) -> dict[str, Floats]:
    """Return covariance matrices by component; none exceeds what its variances allow."""
    found = _columns(data, "covariance", (n, n))
    for name, matrix in found.items():
        std = np.sqrt(np.maximum(np.diagonal(matrix), 0.0))
        bound = np.outer(std, std) + _ROUNDING * float(np.max(std**2, initial=0.0))
        if np.any(np.abs(matrix) > bound):
            raise ValueError(f"covariance.{name}: no covariance, it contradicts its variances")
    return found


def _column(values: Any, where: str) -> Floats:
    column = _floats(values, where)
    if column.ndim != 1 or not np.all(np.isfinite(column)):
        raise ValueError(f"{where}: expected a list of finite numbers")
    return column


def _optional(data: Mapping[str, Any], name: str, shape: tuple[int, ...]) -> Floats | None:
    values = data.get(name)
    if values is None:
        return None
    column = _floats(values, name)
    if column.shape != shape:
        raise ValueError(f"{name}: expected numbers of the shape {shape}")
    return column


def _floats(values: Any, where: str) -> Floats:
    """Return numbers as an array; null is NaN. ValueError for texts, which numpy would read."""
    try:
        found = np.asarray(values)
        if found.dtype.kind in "US":
            raise ValueError("it holds texts")
        numbers = found.astype(np.float64)
    except (ArithmeticError, TypeError, ValueError) as error:
        raise ValueError(f"{where}: no array of numbers: {error}") from error
    if np.any(np.isinf(numbers)):
        raise ValueError(f"{where}: it holds infinite numbers")
    return numbers
