"""A measured deviation curve, one value per table position."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.compact import mapped, written
from rotcal_ros.foundation.components import unit_of
from rotcal_ros.foundation.curves.interpolation import SAME_ANGLE, wrap_to_turn
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.raw_data import RawData
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import DEGREE, TURN

CLOSURE_LIMIT: Final = 4.0
"""Two measurements of one position may differ by this many standard uncertainties."""
WIDE: Final = 3.0
"""A gap up to this multiple of the usual distance counts as part of a measured circle."""


@dataclass(frozen=True, eq=False)
class MeasuredCurve:
    """Deviation (n,) at ascending angles (n,) rad with covariance (n, n), in rad or metres.

    ``period`` is 2 pi when the angles go round, with no angle twice, and 0 for an arc.
    ``verdict_line`` is that of the result it comes from, empty for a reference without one;
    ``simulated``: it comes from a simulation. The deviation is known up to any multiple of the
    columns of ``free`` (n, q), besides a constant. ``free_names`` (q,) are the names of offsets of
    this component alone, empty for others; ``open_zeros`` says in words which offsets are open.
    ``raw_data`` are the observations it rests on, with their influence on this curve alone, merged
    like its values. ``serial`` and ``axis`` are those of the measured item and axis; empty: not
    known. ``shown`` is the share of the stated noise that the residuals show, 1 if they show all
    or more.
    """

    angles: Floats
    deviation: Floats
    covariance: Floats
    period: float
    verdict_line: str = ""
    simulated: bool = False
    raw_data: RawData = field(default_factory=RawData)
    free: Floats | None = None
    free_names: tuple[str, ...] = ()
    open_zeros: str = ""
    serial: str = ""
    axis: str = ""
    shown: float = 1.0

    @property
    def free_columns(self) -> Floats:
        """The free directions (n, q); q = 0 if nothing is open."""
        return np.zeros((len(self.angles), 0)) if self.free is None else self.free


def measured_curve(result: Result, component: str = "ECC") -> MeasuredCurve:
    """Return one component of ``result``, averaging positions that coincide after a turn.

    Raises DataError when it is absent, has fewer than two angles, or when two measurements of one
    table position contradict each other (the deviations do not close).
    """
    curve = _complete(result, component)
    angles, merge = average_coincident_angles(curve, component)
    return MeasuredCurve(
        angles=angles,
        deviation=merge @ curve.deviation,
        covariance=written(mapped(curve.covariance, merge)),
        period=curve.period,
        verdict_line=result.verdict_line,
        simulated=result.simulated,
        free=merge @ result.zeros.of(component, len(result.angles)),
        free_names=tuple(d.name if [*d.columns] == [component] else "" for d in result.zeros.free),
        open_zeros=result.zeros.describe([component]),
        raw_data=result.raw_data.of_curve(component).transformed(merge),
        serial=result.circumstances.identity.serial,
        axis=result.circumstances.axis,
        shown=min(result.sigma0, 1.0) if result.dof else 1.0,
    )


def average_coincident_angles(curve: MeasuredCurve, component: str) -> tuple[Floats, csr_array]:
    """Return ascending angles (n',) within a turn, and (n', n) that averages those that coincide.

    An arc is sorted and otherwise stays as it is. Raises DataError if two that coincide
    contradict each other.
    """
    angles = curve.angles
    position = np.array([wrap_to_turn(a) for a in angles]) if curve.period else angles
    order = np.argsort(position, kind="stable")
    new = np.append(True, np.diff(position[order]) > SAME_ANGLE)
    group = np.cumsum(new) - 1
    begin, count = np.flatnonzero(new), np.bincount(group)
    for first in np.flatnonzero(count > 1).tolist():
        _check_closure(component, curve, order[begin[first] : begin[first] + count[first]])
    share = 1.0 / count[group], order, np.append(begin, len(order))
    return position[order][new], csr_array(share, shape=(len(begin), len(order)))


def covers_circle(angles: Floats) -> bool:
    """Whether ``angles`` (rad) go round: the gap left is no wider than the others allow.

    Gaps up to WIDE times the usual one are allowed: a lone angle far from the others, with wide
    gaps on both sides, does not close a circle.
    """
    ascending = np.unique(np.asarray(angles, dtype=np.float64))
    span = float(ascending[-1] - ascending[0])
    if span >= TURN - SAME_ANGLE:
        return True
    gaps = np.diff(ascending)
    allowed = 1.5 * min(np.max(gaps, initial=0.0), WIDE * float(np.median(gaps)))
    return len(ascending) > 2 and TURN - span <= allowed


def period_of(angles: Floats) -> float:
    """Return 2 pi for ``angles`` (rad) that go round, 0 for those of an arc."""
    return TURN if covers_circle(angles) else 0.0


def gaps_of(angles: Floats, period: float) -> Floats:
    """Return the gap (rad) after each of ``angles`` (n,): n of a closed curve, n - 1 of an arc."""
    return np.diff(angles, append=angles[0] + period) if period else np.diff(angles)


def _complete(result: Result, component: str) -> MeasuredCurve:
    """Return ``component`` with the angles as they were measured, else raise DataError.

    A Result itself guarantees one finite deviation for each angle.
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
    return MeasuredCurve(angles, result.deviations[component], covariance, period_of(angles))


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
