"""A measured deviation curve, one value per table position."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from rotcal_ros.arrays import Floats
from rotcal_ros.components import unit_of
from rotcal_ros.curves.interpolation import SAME_ANGLE, TURN, wrapped
from rotcal_ros.errors import DataError
from rotcal_ros.results import Result
from rotcal_ros.units import DEGREE

CLOSURE_LIMIT: Final = 4.0
"""How many standard uncertainties two measurements of one position may differ."""


@dataclass(frozen=True, eq=False)
class MeasuredCurve:
    """Deviation (n,) at ascending angles (n,) rad with covariance (n, n), in rad or metres.

    ``period`` is 2 pi when the angles go round, with no angle twice, and 0 for an arc.
    ``verdict_line`` is that of the result it comes from, empty for a reference without one.
    """

    angles: Floats
    deviation: Floats
    covariance: Floats
    period: float
    verdict_line: str = ""


def measured_curve(result: Result, component: str = "ECC") -> MeasuredCurve:
    """Return one component of ``result``, positions that coincide after a turn averaged.

    Raises DataError when it is absent, has fewer than two angles, or when two measurements of one
    table position contradict each other (the deviations do not close).
    """
    curve = _complete(result, component)
    angles = curve.angles
    position = np.array([wrapped(a) for a in angles]) if curve.period else angles
    order = np.argsort(position, kind="stable")
    new = np.append(True, np.diff(position[order]) > SAME_ANGLE)
    group = np.cumsum(new) - 1
    merge = np.zeros((group[-1] + 1, len(angles)))
    merge[group, order] = 1.0
    for row in merge[merge.sum(axis=1) > 1]:
        _check_closure(component, curve, np.flatnonzero(row))
    merge /= merge.sum(axis=1, keepdims=True)
    return MeasuredCurve(
        angles=position[order][new],
        deviation=merge @ curve.deviation,
        covariance=merge @ curve.covariance @ merge.T,
        period=curve.period,
        verdict_line=result.verdict_line,
    )


def covers_circle(angles: Floats) -> bool:
    """Whether ``angles`` (rad) go round: the gap left is no wider than the others allow."""
    ascending = np.unique(np.asarray(angles, dtype=np.float64))
    span = float(ascending[-1] - ascending[0])
    if span >= TURN - SAME_ANGLE:
        return True
    return len(ascending) > 2 and TURN - span <= 1.5 * float(np.max(np.diff(ascending)))


def _complete(result: Result, component: str) -> MeasuredCurve:
    """Return ``component`` with the angles as they were measured, else raise DataError.

    That there is one finite deviation for each angle a Result guarantees by itself.
    """
    where = f"the {result.method} result"
    if component not in result.deviations:
        raise DataError(
            f"{where} holds no {component}, only {', '.join(result.deviations) or 'nothing'}: "
            "choose another result or component (a positioning table needs ECC)"
        )
    angles, n = result.angles, len(result.angles)
    if n < 2 or not np.all(np.isfinite(angles)):
        raise DataError(f"{where} holds the angles {angles} rad: expected two or more numbers")
    covariance = result.covariance.get(component)
    if covariance is None:
        covariance = np.diag(result.std.get(component, np.zeros(n)) ** 2)
    if np.shape(covariance) != (n, n) or not np.all(np.isfinite(covariance)):
        raise DataError(
            f"{where}: the covariance of {component} has shape {np.shape(covariance)} or is not "
            f"finite, expected ({n}, {n}) finite numbers"
        )
    period = TURN if covers_circle(angles) else 0.0
    return MeasuredCurve(angles, result.deviations[component], covariance, period)


def _check_closure(component: str, curve: MeasuredCurve, members: NDArray[np.intp]) -> None:
    """Raise DataError when measurements ``members`` of one position contradict each other."""
    scale, unit = unit_of(component)
    angles, covariance, first = curve.angles, curve.covariance, members[0]
    for other in members[1:]:
        gap = float(curve.deviation[other] - curve.deviation[first])
        variance = covariance[first, first] + covariance[other, other]
        # The difference of two equal results may come out below zero by rounding.
        std = float(np.sqrt(max(variance - 2.0 * covariance[first, other], 0.0)))
        if abs(gap) > CLOSURE_LIMIT * std + SAME_ANGLE:
            raise DataError(
                f"the deviations {component} do not close: at {angles[first] / DEGREE:.6g} and "
                f"{angles[other] / DEGREE:.6g} deg, the same table position, they differ by "
                f"{gap / scale:.4g} {unit} with a standard uncertainty of {std / scale:.3g} "
                f"{unit} (limit {CLOSURE_LIMIT:g} times): something moved during the run, "
                "measure again"
            )
