"""What two deviation curves of one table have in common: angles, and observations.

They are compared at the angles of the first: measured there or interpolated.

To first order a curve is its truth plus B e, with the errors e of its observations and of what
these have in common (a target's coordinates), each of unit variance, and the influences B that its
method states. Two curves with the same e have the covariance B1 B2' instead of zero. The
covariance of a curve beyond B B' (error motion, slips, allowances) belongs to the run that both
were measured in: at equal angles it counts as the same in both.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.curves.interpolation import SAME_ANGLE, interpolation_matrix
from rotcal_ros.foundation.curves.measured import MeasuredCurve
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.raw_data import Influence
from rotcal_ros.foundation.units import DEGREE, TURN


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


def pair_curves(
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
        interpolated=np.asarray(
            ~same_angles(angles, second.angles, second.period).any(axis=1), dtype=np.bool_
        ),
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


def same_angles(angles: Floats, others: Floats, period: float) -> Bools:
    """Return which of ``others`` (n,) rad each of ``angles`` (m,) is, (m, n); 0: no period."""
    gap = angles[:, None] - others
    if period:
        gap = np.mod(gap + TURN / 2, TURN) - TURN / 2
    return np.asarray(np.abs(gap) <= 1e3 * SAME_ANGLE, dtype=np.bool_)


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
            f"{high / DEGREE:.6g} deg; give results of the same arc"
        )
    return np.clip(angles[rows], second.angles[0], second.angles[-1]), rows


NONLINEAR: Final = 1e-4
"""Share of a standard uncertainty by which two evaluations may differ, as they are not linear."""


def shared_covariance(
    first: MeasuredCurve, second: MeasuredCurve, names: tuple[str, str], *, alike: bool = True
) -> Floats | None:
    """Return the covariance (n1, n2) of two curves by shared observations; None without any.

    ``alike``: they are of one component. Raises DataError where its effect on both is not known.
    """
    here, there = first.raw_data.common_observations(second.raw_data)
    if not len(here):
        return None
    ours, theirs = first.raw_data.influence, second.raw_data.influence
    if ours is None or theirs is None:
        raise DataError(
            f"{names[0]} and {names[1]} share {len(here)} observations (of "
            f"{len(first.raw_data.hashes)} and {len(second.raw_data.hashes)}), and it is not "
            "known how their errors affect both: use results of different measurements, or one of "
            "the two"
        )
    causes = [cause for cause in ours.causes if cause in set(theirs.causes)]
    both = _columns(ours, here, causes) @ _columns(theirs, there, causes).T
    return np.asarray(both + _rest(first, second) if alike else both, dtype=np.float64)


def with_observation_noise_only(curve: MeasuredCurve) -> MeasuredCurve:
    """Return a curve with the covariance of its observations alone, or as it is if unknown.

    Other parts of U, such as an estimated scatter that may not exist, make independent results
    agree better than U says, and so does noise that is stated larger than the residuals show. The
    test whether results agree too well leaves out both.
    """
    raw = curve.raw_data
    if raw.influence is None:
        return curve
    by_name = {c: curve.shown * matrix for c, matrix in raw.influence.deviations.items()}
    matrix = influence_matrix(influence := replace(raw.influence, deviations=by_name))
    if not np.any(matrix):
        return curve
    return replace(curve, covariance=matrix @ matrix.T, raw_data=replace(raw, influence=influence))


def influence_matrix(influence: Influence) -> Floats:
    """Return the influences (m, k) on the one component of a curve."""
    (matrix,) = influence.deviations.values()
    return matrix


def _columns(influence: Influence, wanted: Ints, causes: list[str]) -> Floats:
    """Return the influences of the ``wanted`` observations, zero for unused ones, and causes."""
    matrix, c = influence_matrix(influence), influence.coordinates
    width = len(influence.rows) * c
    index = {row: at for at, row in enumerate(influence.rows.tolist())}
    at = np.array([index.get(row, -1) for row in wanted.tolist()], dtype=np.int64)
    by_row = matrix[:, :width].reshape(len(matrix), -1, c)[:, at]
    by_row[:, at < 0] = 0.0
    of_causes = matrix[:, [width + influence.causes.index(cause) for cause in causes]]
    return np.hstack([by_row.reshape(len(matrix), -1), of_causes])


def _rest(first: MeasuredCurve, second: MeasuredCurve) -> Floats:
    """Return the covariance (n1, n2) beyond the influences, at equal angles."""
    alike = len(first.angles) == len(second.angles) and np.allclose(
        first.angles, second.angles, rtol=0.0, atol=1e3 * SAME_ANGLE
    )
    if not alike:
        return np.zeros((len(first.angles), len(second.angles)))
    return _root(first) @ _root(second)


def _root(curve: MeasuredCurve) -> Floats:
    """Return the symmetric root (n, n) of the covariance beyond the influences."""
    assert curve.raw_data.influence is not None
    matrix = influence_matrix(curve.raw_data.influence)
    values, vectors = np.linalg.eigh(curve.covariance - matrix @ matrix.T)
    return np.asarray((vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T)


def covariance_floor(covariance: Floats) -> Floats:
    """Return the variances (n, n) that keep curves of the same data from being exactly one."""
    return NONLINEAR**2 * float(np.mean(covariance.diagonal())) * np.eye(len(covariance))
