"""What an instrument read at the steps of a plan, column by column, and in what order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.observations import Observation


def time_ranks(observations: Sequence[Observation]) -> Ints:
    """Return the rank (k,) in time of each observation: by run, then by the end of its window.

    Observations without a time (plain tables) are in the order of the plan.
    """
    keys = (
        [o.step for o in observations],
        [o.window_end_ns for o in observations],
        [o.run for o in observations],
    )
    rank = np.empty(len(observations), dtype=np.int64)
    rank[np.lexsort(np.array(keys, dtype=np.int64))] = np.arange(len(observations))
    return rank


def pass_numbers(station: Ints, position: Ints, order: Ints) -> Ints:
    """Return which pass through the table's positions each reading (n,) belongs to, in time.

    ``order``: their rank in time. A new pass begins with another ``station``, and where the table
    comes to a ``position`` again.
    """
    found, seen, number, before = np.zeros(len(order), np.int64), set[int](), -1, (-1, -1)
    for row in np.argsort(order, kind="stable").tolist():
        here = int(station[row]), int(position[row])
        if here[0] != before[0] or (here != before and here[1] in seen):
            seen, number = set(), number + 1
        seen.add(here[1])
        found[row], before = number, here
    return found


@dataclass(frozen=True, eq=False)
class Readings:
    """One row for each of n observations, in their order; numbers as of a step of the plan.

    ``value`` (n,): what was read, the first of several values, SI. ``order`` (n,): rank in time.
    ``points`` (n, 3): all three values, of observations that have three.
    """

    position: Ints
    target: Ints
    station: Ints
    value: Floats
    order: Ints
    points: Floats = field(default_factory=lambda: np.zeros((0, 3)))

    @classmethod
    def of(cls, observations: Sequence[Observation]) -> Readings:
        """Return the columns of observations."""
        numbers = [(o.table_position, o.target, o.station) for o in observations]
        position, target, station = np.array(numbers, dtype=np.int64).reshape(-1, 3).T.copy()
        points = np.array([o.mean for o in observations]).reshape(len(observations), -1)
        value = points[:, 0].copy()
        return cls(position, target, station, value, time_ranks(observations), points)

    @property
    def when(self) -> Floats:
        """``order`` as numbers (n,) along which something may drift."""
        return self.order.astype(np.float64)
