"""The time that table, machine and instrument take from length to length of a plan."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.planning.plan import Step


@dataclass(frozen=True)
class Drive:
    """A drive from rest to rest: largest ``speed`` (per s), ``acceleration`` (per s^2).

    ``settle`` (s) follows every motion; standing still takes no time.
    """

    speed: float
    acceleration: float
    settle: float = 0.0

    def time(self, way: Floats) -> Floats:
        """Return the durations (s) of ways of any shape, in the unit of the speed.

        Trapezoidal speed: way / v + v / a if v is reached, else 2 sqrt(way / a).
        """
        way = np.abs(way)
        return np.asarray(np.where(way > 0.0, self.moving(way) + self.settle, 0.0))

    def moving(self, way: Floats) -> Floats:
        """Return the durations (s) without the settling."""
        ramp = self.speed / self.acceleration
        reached = way >= self.speed * ramp
        moving = np.where(reached, way / self.speed + ramp, 2.0 * np.sqrt(way / self.acceleration))
        return np.asarray(moving, dtype=np.float64)


@dataclass(frozen=True)
class TimeModel:
    """How long a length takes: the ``table`` (rad) turns, the ``machine`` (m) moves, both dwell.

    With ``together`` they move at the same time, else one after the other. After its motion the
    machine takes ``report`` (s) at every length; ``dwell`` (s) begins when both are ready. Angles
    are reached from below: from above the table passes by ``overshoot`` (rad) and returns.
    """

    table: Drive
    machine: Drive
    dwell: float
    report: float = 0.0
    overshoot: float = 0.0
    together: bool = True

    def turns(self, angles: Floats) -> Floats:
        """Return the time (m, m) from each of the ``angles`` (m,), rad, to each of them."""
        return self.turns_by(angles - angles[:, None])

    def turns_by(self, ways: Floats) -> Floats:
        """Return the time (s) of turns by ``ways`` of any shape, rad."""
        down = np.abs(np.minimum(ways, 0.0))
        back = self.table.moving(down + self.overshoot) + self.table.settle
        back = back + self.table.moving(np.array(self.overshoot))
        return np.asarray(np.where(down > 0.0, back, self.table.time(ways)), dtype=np.float64)

    def moves(self, targets: Floats) -> Floats:
        """Return the time (n, n) from each of the ``targets`` (n, 3), m, to each of them."""
        return self.machine.time(np.linalg.norm(targets - targets[:, None], axis=2))

    def costs(self, angles: Floats, targets: Floats, position: Ints, target: Ints) -> Floats:
        """Return the time (k, k) from the end of each of k lengths to the end of each other.

        ``position`` (k,), ``target`` (k,): indices into ``angles`` (m,) and ``targets`` (n, 3).
        """
        turns = self.turns(angles)[position[:, None], position]
        moves = self.moves(targets)[target[:, None], target] + self.report
        return self.joined(turns, moves)

    def seconds(self, steps: Sequence[Step]) -> float:
        """Return the time (s) from the end of the first of ``steps`` to the end of the last."""
        angles, at = (
            np.array([getattr(step, name) for step in steps])
            for name in ("table_angle", "position")
        )
        moves = self.machine.time(np.linalg.norm(np.diff(at, axis=0), axis=1)) + self.report
        return float(self.joined(self.turns_by(np.diff(angles)), moves).sum())

    def joined(self, turns: Floats, moves: Floats) -> Floats:
        """Return the time of lengths from that of their ``turns`` and ``moves``, s."""
        both = np.maximum(turns, moves) if self.together else turns + moves
        return np.asarray(both + self.dwell, dtype=np.float64)


def sequence_duration(costs: Floats, order: Ints) -> float:
    """Return the time (s) of all lengths in ``order`` (k,), from the end of the first one."""
    return float(costs[order[:-1], order[1:]].sum())


AT_ONCE: Final = 1e12
"""A speed and acceleration so large that only the settling is left."""

HARDLY: Final = Drive(1e5, AT_ONCE)
"""A machine whose moves are in the time of a length: of equal orders the shorter path wins."""


def constant_time_model(turn: float, length: float, machine: Drive = HARDLY) -> TimeModel:
    """Return the time model of ``turn`` (s) for any rotation and ``length`` (s) for any length."""
    table, together = Drive(AT_ONCE, AT_ONCE, settle=turn), machine is not HARDLY
    return TimeModel(table, machine, dwell=length, together=together)
