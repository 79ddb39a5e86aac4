"""Brings two curves of one table to the angles of the first: measured there or interpolated."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rotcal_ros.evaluation.shared_data import shared_covariance
from rotcal_ros.foundation.arrays import Bools, Floats
from rotcal_ros.foundation.curves.interpolation import SAME_ANGLE, TURN, interpolation_matrix
from rotcal_ros.foundation.curves.measured import MeasuredCurve
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.units import DEGREE


@dataclass(frozen=True, eq=False)
class PairedCurves:
    """Deviations of two curves at the n ``angles`` (rad) that they share, in their unit.

    ``covariances`` (n, n) are each curve's own, ``shared`` (n, n) is that of the first with the
    second by common observations, None without any. ``interpolated`` (n,) marks angles at which
    the second curve was not measured; ``outside`` counts angles of the first beyond the other's
    arc. ``free`` (n, q) are the directions, besides a constant, that either of them leaves open.
    """

    angles: Floats
    first: Floats
    second: Floats
    first_covariance: Floats
    second_covariance: Floats
    shared: Floats | None
    interpolated: Bools
    outside: int
    free: Floats


def pair(
    first: MeasuredCurve, second: MeasuredCurve, names: tuple[str, str] = ("first", "second")
) -> PairedCurves:
    """Return both curves at the angles of ``first``, ``second`` interpolated by its spline.

    Raises DataError if they are of two items or axes, share fewer than two angles, or share
    observations whose influence on both is not known.
    """
    require_one_table({
        "serial number": dict(zip(names, (first.serial, second.serial), strict=True)),
        "axis": dict(zip(names, (first.axis, second.axis), strict=True)),
    })  # fmt: skip
    angles, rows = _common(first, second)
    weights = interpolation_matrix(second.angles, angles, second.period)
    shared = shared_covariance(first, second, names)
    return PairedCurves(
        angles=angles,
        first=first.deviation[rows],
        second=weights @ second.deviation,
        first_covariance=first.covariance[np.ix_(rows, rows)],
        second_covariance=weights @ second.covariance @ weights.T,
        shared=None if shared is None else shared[rows] @ weights.T,
        interpolated=~_coincide(angles, second),
        outside=len(first.angles) - len(rows),
        free=np.hstack([first.free_columns[rows], weights @ second.free_columns]),
    )


def require_one_table(stated: Mapping[str, Mapping[str, str]]) -> None:
    """Raise DataError if the statements of the inputs (by name) differ.

    An empty text states nothing.
    """
    for what, by_name in stated.items():
        first_to_say = {value: name for name, value in reversed(list(by_name.items())) if value}
        if len(first_to_say) > 1:
            named = ", ".join(f"{value} ({name})" for value, name in sorted(first_to_say.items()))
            raise DataError(
                f"the inputs are not of one table: {what} {named}; give measurements of one table "
                "in one state"
            )


def _coincide(angles: Floats, curve: MeasuredCurve) -> Bools:
    """Return which of ``angles`` (n,) rad ``curve`` was measured at."""
    gap = angles[:, None] - curve.angles[None, :]
    if curve.period:
        gap = np.mod(gap + TURN / 2, TURN) - TURN / 2
    return np.asarray(np.min(np.abs(gap), axis=1) <= 1e3 * SAME_ANGLE, dtype=np.bool_)


def _common(first: MeasuredCurve, second: MeasuredCurve) -> tuple[Floats, NDArray[np.intp]]:
    """Return the angles of ``first`` that ``second`` covers, and their rows in ``first``."""
    angles = first.angles
    if second.period:
        return angles, np.arange(len(angles))
    low, high = second.angles[0] - SAME_ANGLE, second.angles[-1] + SAME_ANGLE
    if first.period:
        angles = low + np.mod(angles - low, TURN)
    rows = np.flatnonzero((angles >= low) & (angles <= high))
    if len(rows) < 2:
        raise DataError(
            f"the curves share {len(rows)} angles: the second covers only {low / DEGREE:.6g} .. "
            f"{high / DEGREE:.6g} deg"
        )
    return np.clip(angles[rows], second.angles[0], second.angles[-1]), rows
