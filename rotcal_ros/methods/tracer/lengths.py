"""Observed lengths: as columns with their noise, as planned, and whether they can be true."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from math import dist
from typing import Any, Final

import numpy as np

from rotcal_ros.adjust.bordered import index_within_group
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.language import phrase
from rotcal_ros.foundation.observations import Observation, PointKind
from rotcal_ros.geometry.rotations import rotation_about_z
from rotcal_ros.methods.method import See
from rotcal_ros.methods.tracer.settings import LengthNoiseSettings
from rotcal_ros.planning.plan import Plan, Point, Step
from rotcal_ros.planning.readings import Readings

_FACTOR: Final = 10.0
"""Times the distance of two targets beyond which a change of the length is no measuring error."""
_SLACK: Final = 1e-3
"""Distance (m) that is added to that of two targets, which may be at the same place."""
_RESET: Final = 1.0
"""How much (m) a zero may change when the beam was broken."""


def reported_positions(observations: Sequence[Observation]) -> Floats:
    """Return where the machine says the probe was, shape (k, 3)."""
    return np.array([o.probe_position for o in observations]).reshape(-1, 3)


def times_before(plan: Plan) -> Ints:
    """Return how often the plan has measured the same before each of its steps (n,)."""
    count: Counter[tuple[int, int, int, bool]] = Counter()
    numbers = []
    for step in plan.steps:
        key = (step.station, step.table_position, step.target, step.turn is None)
        numbers.append(count[key])
        count[key] += 1
    return np.array(numbers, dtype=np.int64)


def length_columns(
    settings: LengthNoiseSettings,
    plan: Plan,
    observations: Sequence[Observation],
    beside: float = 0.0,
) -> dict[str, Any]:
    """Return the columns that every problem of lengths has, from accepted ``observations``.

    The coordinates of a target are the mean of what the machine reported there; a target that
    was never observed keeps its nominal place. The noise of a length joins the scatter of its
    window with the instrument's constant and distance-dependent parts, for the latter the distance
    from the table's frame is near enough, and with what is ``beside``, m.
    """
    read = Readings.of(observations)
    target, nominal = read.target, np.array(plan.targets)
    count = np.bincount(target, minlength=len(nominal))
    targets, seen = np.zeros_like(nominal), count > 0
    np.add.at(targets, target, reported_positions(observations))
    targets[seen] /= count[seen, None]
    targets[~seen] = nominal[~seen]
    moved = reported_positions(observations) - targets[target]
    growing = settings.length_std_relative * np.linalg.norm(targets, axis=1)[target]
    window_std = np.array([o.std[0] for o in observations])
    variance = settings.length_std_m**2 + growing**2 + window_std**2
    return {
        "position": read.position,
        "target": target,
        "length": read.value,
        "length_std": np.sqrt(variance + beside**2),
        "order": read.order,
        "moved": moved if moved.any() else None,
        "targets": targets,
        "target_std": np.full(targets.shape, settings.target_std_m),
        "table_angles": np.array(plan.table_angles),
        "settings": settings,
    }


def segments_of(observations: Sequence[Observation], turn: Ints | None = None) -> Ints:
    """Return the segment (k,) of each observation; another run is another segment.

    So is, where the table turned, another ``turn`` (k,) for one target: it takes its time.
    """
    kinds = ("run", "segment", "attempt", "station", "target")[: 2 if turn is None else None]
    every = np.array([[getattr(o, kind) for kind in kinds] for o in observations], dtype=np.int64)
    every = every.reshape(-1, len(kinds))
    if turn is not None:
        every = np.column_stack([every, turn])
    return np.unique(every, axis=0, return_inverse=True)[1].ravel()


def times_measured_before(plan: Plan, observations: Sequence[Observation]) -> Ints:
    """Return how often the same was measured before each observation (k,), in any run."""
    before, found = times_before(plan), np.zeros(len(observations), dtype=np.int64)
    in_time = np.argsort([o.run for o in observations], kind="stable")
    step = np.array([o.step for o in observations], dtype=np.int64)[in_time]
    found[in_time] = before[step] + (before.max(initial=0) + 1) * index_within_group(step)
    return found


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
        self._last: dict[tuple[int, int, bool], tuple[int, float, int]] = {}
        """Target, length and segment of the last length of each place and table position."""
        self._targets, self._counting = plan.targets, plan.counting

    def __call__(self, observation: Observation) -> Observation:
        """Return the observation, rejected when it cannot be."""
        if not observation.accepted or observation.kind != PointKind.REFLECTOR:
            return observation
        length, target = observation.mean[0], observation.target
        counts = observation.step in self._counting
        here = observation.station, observation.table_position, counts
        known = self._last.get(here)
        if known is not None:
            other, before, segment = known
            apart = dist(self._targets[target], self._targets[other])
            change = length - before
            anew = 0.0 if segment == observation.segment else _RESET
            if abs(change) > _FACTOR * (apart + _SLACK) + anew:
                reason = phrase(
                    "implausible: length changed by {0:.6g} m between targets {1} and {2}, which "
                    "are {3:.6g} m apart (millimetres instead of metres?)", change, other, target,
                    apart
                )  # fmt: skip
                return replace(observation, accepted=False, reason=reason)
        self._last[here] = (target, length, observation.segment)
        return observation
