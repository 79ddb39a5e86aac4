"""The positioning of an axis for approaches from either side, as one curve with one covariance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.sparse import block_diag, csr_array

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.compact import mapped, written
from rotcal_ros.foundation.curves.interpolation import SAME_ANGLE
from rotcal_ros.foundation.curves.measured import (
    MeasuredCurve,
    average_coincident_angles,
    measured_curve,
    period_of,
)
from rotcal_ros.foundation.errors import ConfigurationError, DataError
from rotcal_ros.foundation.results import Directions, Result
from rotcal_ros.foundation.units import ARCSEC

COMPONENT: Final = "ECC"


@dataclass(frozen=True, eq=False)
class DirectionalCurve:
    """ECC (n,) rad at ascending angles (n,) rad, for both sides of the approach.

    ``covariance`` (2 n, 2 n) is that of ``forward``, then ``reverse``. ``period`` is as in
    :class:`MeasuredCurve`. If only one side was measured, ``both`` is False and the reverse curve
    repeats the forward one; ``notes`` are remarks for people.
    """

    angles: Floats
    forward: Floats
    reverse: Floats
    covariance: Floats
    period: float
    both: bool
    notes: tuple[str, ...] = ()

    @property
    def forward_covariance(self) -> Floats:
        """The covariance (n, n) of the forward curve."""
        n = len(self.angles)
        return self.covariance[:n, :n]

    @property
    def reverse_covariance(self) -> Floats:
        """The covariance (n, n) of the reverse curve."""
        n = len(self.angles)
        return self.covariance[n:, n:]

    @property
    def stacked(self) -> Floats:
        """Both curves (2 n,), in the order of the covariance."""
        return np.concatenate([self.forward, self.reverse])


def directional_curve(result: Result, reverse: Result | None = None) -> DirectionalCurve:
    """Return both sides of ``result``, or ``result`` with an independent ``reverse`` result.

    Positions that coincide after a turn are averaged, as by :func:`measured_curve`. Raises
    DataError when the curves do not close or are at other angles, or a result has runs from both
    sides and only their mean as a curve; ConfigurationError if both sides are already known and
    ``reverse`` is given too.
    """
    for each in (result, reverse):
        if each is not None:
            refuse_lost_reversal(each)
    both = result.directions.get(COMPONENT)
    if reverse is None:
        return _single(result) if both is None else _merged(result, both)
    if both is not None or COMPONENT in reverse.directions:
        raise ConfigurationError(
            f"a result ({result.method}) already holds both directions: leave out the second "
            "result of the reverse direction, or give two results of one direction each"
        )
    return _independent(measured_curve(result), measured_curve(reverse))


def refuse_lost_reversal(result: Result) -> None:
    """Raise DataError for runs from both sides, whose mean would pass as the curve of either."""
    runs = result.runs
    if COMPONENT in result.directions or runs is None:
        return
    if runs.forward is None or runs.reverse is None:
        return
    seen = [np.isfinite(side) for side in (runs.forward, runs.reverse)]
    both = seen[0].any(axis=1) & seen[1].any(axis=1)
    if np.count_nonzero(both) < 2:
        return
    means = [np.nanmean(side[both], axis=1) for side in (runs.forward, runs.reverse)]
    apart = float(np.max(np.abs(np.subtract(*means)))) / ARCSEC
    raise DataError(
        f"the {result.method} result has runs from both sides, up to {apart:.3g} arcsec apart, "
        "and only their mean as a curve (no directions), which would lose this reversal: solve "
        "the measurement again, or give the runs of each side as a result of its own"
    )


def _single(result: Result) -> DirectionalCurve:
    curve = measured_curve(result)
    return DirectionalCurve(
        angles=curve.angles,
        forward=curve.deviation,
        reverse=curve.deviation,
        covariance=np.tile(curve.covariance, (2, 2)),
        period=curve.period,
        both=False,
    )


def _merged(result: Result, own: Directions) -> DirectionalCurve:
    """Return both directions of one result, checked for closure and averaged like its mean."""
    k, period = len(own.angles), period_of(own.angles)
    for values, part in ((own.forward, slice(k)), (own.reverse, slice(k, None))):
        side = MeasuredCurve(own.angles, values, own.covariance[part, part], period)
        angles, merge = average_coincident_angles(side, COMPONENT)
    twice = csr_array(block_diag([merge, merge], format="csr"))
    missing = len(result.angles) - k
    note = (
        f"{missing} of {len(result.angles)} angles were reached only from one side and are left "
        "out: the table holds both directions at the others"
    )
    return DirectionalCurve(
        angles=angles,
        forward=merge @ own.forward,
        reverse=merge @ own.reverse,
        covariance=written(mapped(own.covariance, twice)),
        period=period,
        both=True,
        notes=(note,) if missing else (),
    )


def _independent(forward: MeasuredCurve, backward: MeasuredCurve) -> DirectionalCurve:
    same = len(backward.angles) == len(forward.angles)
    if not same or np.max(np.abs(backward.angles - forward.angles)) > SAME_ANGLE:
        raise DataError(
            f"the reverse run has {len(backward.angles)} angles that are not the "
            f"{len(forward.angles)} of the forward run: measure both directions at the same angles"
        )
    nothing = np.zeros_like(forward.covariance)
    return DirectionalCurve(
        angles=forward.angles,
        forward=forward.deviation,
        reverse=backward.deviation,
        covariance=np.block([[forward.covariance, nothing], [nothing, backward.covariance]]),
        period=forward.period,
        both=True,
    )
