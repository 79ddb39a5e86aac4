"""Observed lengths: as arrays with their noise, as planned, and whether they can be true."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import dist
from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.observations import Observation, PointKind
from rotcal_ros.geometry.rotations import rotation_about_z
from rotcal_ros.methods.method import See
from rotcal_ros.methods.tracer.solver_settings import LengthNoiseSettings
from rotcal_ros.planning.plan import Plan, Point, Step

_FACTOR: Final = 10.0
"""Times the distance of two targets beyond which a change of the length is no measuring error."""
_SLACK: Final = 1e-3
"""Distance (m) that is added to that of two targets, which may be at the same place."""
_RESET: Final = 1.0
"""By how much (m) a zero may change when the beam was broken."""


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


def stated_variance(
    settings: LengthNoiseSettings, observations: Sequence[Observation], distance: Floats
) -> tuple[Floats, Floats]:
    """Return the variances (k,) of observed lengths, m^2, and the part that grows, a std in m.

    They join the scatter of the window with the instrument's constant and distance-dependent
    parts; for the latter the ``distance`` (k,) from the table's frame is near enough.
    """
    growing = settings.length_std_relative * distance
    window_std = np.array([o.std[0] for o in observations])
    return settings.length_std_m**2 + growing**2 + window_std**2, growing


def read_from(places: Sequence[Point], dead_distance: float) -> See:
    """Return what a tracer reads that stands exactly at its ``places`` on the table, m."""

    def see(step: Step) -> tuple[float, ...]:
        station = rotation_about_z(step.table_angle) @ np.array(places[step.station])
        return (dist(step.position, station) - dead_distance,)

    return see


class LengthCheck:
    """Rejects lengths that cannot be metres: wrong units, wrong targets, wrong numbers.

    Between two targets at distance D, seen from one station, a relative length can change by D
    at most (triangle inequality), and by the step of its zero in a new segment. A change of
    more than ten times that (and a millimetre) is no measuring error but a wrong unit or a wrong
    target; smaller contradictions are left to the solver, which knows all observations.
    """

    def __init__(self, plan: Plan) -> None:
        self._last: dict[tuple[int, int], tuple[int, float, int]] = {}
        """Target, length and segment of the last length of each place and table position."""
        self._targets = plan.targets

    def __call__(self, observation: Observation) -> Observation:
        """Return the observation, rejected when it cannot be."""
        if not observation.accepted or observation.kind != PointKind.REFLECTOR:
            return observation
        length, target = observation.mean[0], observation.target
        here = observation.station, observation.table_position
        known = self._last.get(here)
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
        self._last[here] = (target, length, observation.segment)
        return observation
