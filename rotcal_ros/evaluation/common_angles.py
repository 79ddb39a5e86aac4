"""Two deviation curves at the angles of the first: measured there, or interpolated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rotcal_ros.arrays import Bools, Floats
from rotcal_ros.curves.interpolation import SAME_ANGLE, TURN, interpolation_matrix
from rotcal_ros.curves.measured import MeasuredCurve
from rotcal_ros.errors import DataError
from rotcal_ros.units import DEGREE


@dataclass(frozen=True, eq=False)
class PairedCurves:
    """Deviations of two curves at the n ``angles`` (rad) that they share, in their unit.

    ``covariances`` (n, n) are each curve's own. ``interpolated`` (n,) marks angles at which the
    second curve was not measured; ``outside`` counts angles of the first beyond the other's arc.
    """

    angles: Floats
    first: Floats
    second: Floats
    first_covariance: Floats
    second_covariance: Floats
    interpolated: Bools
    outside: int


def pair(first: MeasuredCurve, second: MeasuredCurve) -> PairedCurves:
    """Return both curves at the angles of ``first``, ``second`` interpolated by its spline.

    Raises DataError when they share fewer than two angles.
    """
    angles, rows = _common(first, second)
    weights = interpolation_matrix(second.angles, angles, second.period)
    return PairedCurves(
        angles=angles,
        first=first.deviation[rows],
        second=weights @ second.deviation,
        first_covariance=first.covariance[np.ix_(rows, rows)],
        second_covariance=weights @ second.covariance @ weights.T,
        interpolated=~_coincide(angles, second),
        outside=len(first.angles) - len(rows),
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
