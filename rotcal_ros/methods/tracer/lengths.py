"""Observed lengths as arrays: where the reflector was.

What cannot be, though it was measured well: wrong units, wrong targets, wrong numbers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import dist

import numpy as np

from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.observations import Observation, PointKind
from rotcal_ros.planning.plan import Plan

_FACTOR = 10.0
_SLACK = 1e-3  # m
_RESET = 1.0  # m, by which a zero may change when the beam was broken


def reported_positions(observations: Sequence[Observation]) -> Floats:
    """Return where the machine says the probe was, shape (k, 3)."""
    return np.array([o.probe_position for o in observations]).reshape(-1, 3)


def mean_targets(nominal: Floats, target: Ints, reported: Floats) -> Floats:
    """Return the mean reported position of each target, shape (n, 3)."""
    count = np.bincount(target, minlength=len(nominal))
    total = np.zeros_like(nominal)
    np.add.at(total, target, reported)
    seen = count > 0
    total[seen] /= count[seen, None]
    total[~seen] = nominal[~seen]
    return total


class LengthCheck:
    """Rejects lengths that cannot be metres.

    Between two targets at distance D, seen from one station, a relative length can change by D
    at most (triangle inequality), and by the step of its zero in a new segment. A change of
    more than ten times that (and a millimetre) is no measuring error but a wrong unit or a wrong
    target; smaller contradictions are left to the solver, which knows all observations.
    """

    def __init__(self, plan: Plan) -> None:
        self._last: dict[int, tuple[int, float, int]] = {}
        self._targets = plan.targets

    def __call__(self, observation: Observation) -> Observation:
        """Return the observation, rejected when it cannot be."""
        if not observation.accepted or observation.kind != PointKind.REFLECTOR:
            return observation
        length, target = observation.mean[0], observation.target
        known = self._last.get(observation.table_position)
        if known is not None:
            other, before, segment = known
            apart = dist(self._targets[target], self._targets[other])
            change = length - before
            anew = 0.0 if segment == observation.segment else _RESET
            if abs(change) > _FACTOR * (apart + _SLACK) + anew:
                reason = (
                    f"implausible: length changed by {change:.6g} m between targets {other} and "
                    f"{target}, which are {apart:.6g} m apart (millimetres instead of metres?)"
                )
                return replace(observation, accepted=False, reason=reason)
        self._last[observation.table_position] = (target, length, observation.segment)
        return observation
