"""Closures: a table that comes to an angle again should deviate as it did the first time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from rotcal_ros.adjust.distributions import normal_isf
from rotcal_ros.adjust.low_rank import LowRank
from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.units import TURN

MISSED: Final = 1e-7
"""Rad by which typed steps, and their sums, may miss a whole turn; 20 milliarcsec."""


@dataclass(frozen=True, slots=True)
class Closure:
    """Two positions at the same table angle, whole turns apart: what should agree, and how well.

    ``error`` is the deviation at position ``last`` minus that at ``first``, with its standard
    deviation ``std``; SI.
    """

    first: int
    last: int
    error: float
    std: float

    def open(self, significance: float) -> bool:
        """Whether they differ by more than chance, two-sided, explains."""
        return abs(self.error) > normal_isf(0.5 * significance) * self.std


def closures(
    angles: Floats,
    deviations: Floats,
    covariance: LowRank,
    position_ids: Ints,
    upward: Bools | None = None,
) -> tuple[Closure, ...]:
    """Return the closures of ``angles`` (m,), rad: later positions against the first at theirs.

    ``deviations`` (m,) with the ``covariance`` (m, m). Positions are called by ``position_ids``
    (m,). ``upward`` (m,): from which side the table came; what differs between the sides is a
    reversal.
    """
    found = []
    for last in range(1, len(angles)):
        apart = angles[last] - angles[:last]
        meets = np.abs(apart - TURN * np.round(apart / TURN)) < MISSED
        if upward is not None:
            meets &= upward[:last] == upward[last]
        for first in np.flatnonzero(meets)[:1].tolist():
            variance = float(covariance.between(np.array([first]), np.array([last]))[0])
            found.append(
                Closure(
                    first=int(position_ids[first]),
                    last=int(position_ids[last]),
                    error=float(deviations[last] - deviations[first]),
                    std=float(np.sqrt(max(variance, 0.0))),
                )
            )
    return tuple(found)
