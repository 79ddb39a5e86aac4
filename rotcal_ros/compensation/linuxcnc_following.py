"""How LinuxCNC's trim follows its table: once in a servo period, with limits of its own.

Half of the joint's velocity and acceleration is left to the trim. A trim at rest makes a small
change at once and ramps to a far one, and between the two lies a dead band in which it stands:
from a quarter to half of MAX_ACCELERATION times the square of the servo period. Source:
compute_screw_comp in src/emc/motion/control.c of LinuxCNC 2.9.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from rotcal_ros.arrays import Floats, Ints
from rotcal_ros.compensation.controller import Lag
from rotcal_ros.curves.interpolation import TURN
from rotcal_ros.units import ARCSEC, DEGREE

EDGE: Final = 0.01
"""Share by which the dead band is taken wider than it is: changes between two rows looked at."""


@dataclass(frozen=True)
class Following:
    """The limits of a joint: ``acceleration`` (rad/s^2), ``velocity`` (rad/s), ``period`` (s)."""

    acceleration: float
    velocity: float
    period: float

    @property
    def at_once(self) -> float:
        """The largest change (rad) that a trim at rest makes within one period."""
        return 0.25 * self.acceleration * self.period**2

    @property
    def in_motion(self) -> float:
        """The change (rad) above which a trim at rest begins to move."""
        gain = min(0.5 * self.acceleration * self.period, 0.5 * self.velocity)
        return 0.5 * gain * self.period + gain**2 / self.acceleration

    def stands(self, change: Floats) -> NDArray[np.bool_]:
        """Return whether a trim at rest stays where it is, for changes (rad) asked of it."""
        size = np.abs(change)
        above = size > self.at_once * (1.0 - EDGE)
        return np.asarray(above & (size <= self.in_motion * (1.0 + EDGE)))

    def fastest_feed(self, steepest: float) -> float:
        """Return the feed (rad/s) up to which a trim follows that rises by ``steepest`` (1)."""
        return self.at_once / (steepest * self.period) if steepest else np.inf

    def behind(self, steepest: float, feed: float) -> float:
        """Return a bound (rad) on how far the trim is behind in motion; inf: farther and farther.

        The trim starts when it is ``in_motion`` behind and changes its speed with half of the
        acceleration; a table that turns back asks it for twice the change of speed.
        """
        if feed <= self.fastest_feed(steepest):
            return 0.0
        speed = steepest * feed
        if speed >= 0.5 * self.velocity:
            return float(np.inf)
        return self.in_motion + 2.0 * speed * self.period + 4.0 * speed**2 / self.acceleration

    def left_standing(self, forward: Floats, reverse: Floats, closed: bool) -> float:
        """Return the most (rad) that stays after a slow reversal at any row and a slow move.

        ``forward`` and ``reverse`` (n,) rad are the trims at close angles that ascend; with
        ``closed`` the last is beside the first.
        """
        rows = np.arange(len(forward))
        away = self._left(forward, reverse, rows, closed)
        return max(away, self._left(reverse[::-1], forward[::-1], rows, closed))

    def left_after_homing(
        self, forward: Floats, reverse: Floats, home: int, closed: bool
    ) -> float:
        """Return the most (rad) that stays in slow moves from row ``home``, where the trim is 0.

        The other arguments are those of :meth:`left_standing`.
        """
        none, back = np.zeros_like(forward), len(forward) - 1 - home
        away = self._left(forward, none, np.array([home]), closed)
        return max(away, self._left(reverse[::-1], none, np.array([back]), closed))

    def _left(self, wanted: Floats, held: Floats, rows: Ints, closed: bool) -> float:
        """Return it for moves over ascending rows from ``rows``, with the trim ``held``."""
        count, worst = len(wanted), 0.0
        start = rows[self.stands(wanted[rows] - held[rows])]
        for ahead in range(count):
            at = start + ahead
            start, at = (start, at % count) if closed else (start[at < count], at[at < count])
            change = wanted[at] - held[start]
            standing = self.stands(change)
            start = start[standing]
            if len(start) == 0:
                break
            worst = max(worst, float(np.max(np.abs(change[standing]))))
        return worst

    def trims(self, wanted: Floats) -> Floats:
        """Return the trim (n, ...) rad in every servo period, for what the table asks (n, ...)."""
        trim = np.zeros(wanted.shape[1:])
        speed, trims = np.zeros_like(trim), np.empty_like(wanted)
        for period, goal in enumerate(wanted):
            trim, speed = self._step(goal, trim, speed)
            trims[period] = trim
        return trims

    def _step(self, goal: Floats, trim: Floats, speed: Floats) -> tuple[Floats, Floats]:
        """Return trim and speed after one servo period."""
        limit, half = 0.5 * self.velocity, 0.5 * self.acceleration
        side = np.where(goal >= trim, 1.0, -1.0)
        left, ahead, gain = np.abs(goal - trim), side * speed, half * self.period
        moved = ahead * self.period
        near = left <= (ahead + gain) ** 2 / (2.0 * half) + moved
        slows = near & (ahead > gain)
        more = np.minimum(gain, limit - ahead)
        extra = 0.5 * more * self.period
        gains = ~near & (left > (ahead + more) ** 2 / (2.0 * half) + moved + extra)
        change = np.where(slows, -gain, np.where(gains, more, 0.0))
        arrives = near & ~slows
        new = trim + side * (moved + 0.5 * change * self.period)
        stays = left == 0.0
        return (
            np.where(arrives | stays, goal, new),
            np.where(stays, speed, np.where(arrives, 0.0, side * (ahead + change))),
        )


def lag(
    following: Following,
    angles: Floats,
    forward: Floats,
    reverse: Floats,
    feed: float,
    closed: bool,
    home: float = 0.0,
) -> Lag:
    """Return what stays of the trims ``forward`` and ``reverse`` (n,) rad at close ``angles``.

    ``feed`` (rad/s) is the fastest at which the axis comes to a place that matters; 0: not known.
    ``home`` (rad) is the angle at which the axis is homed; there the trim begins with 0.
    """
    steepest = float(max(np.max(np.abs(np.gradient(t, angles))) for t in (forward, reverse)))
    standing = following.left_standing(forward, reverse, closed)
    row = int(np.argmin(np.abs(angles - (home % TURN if closed else home))))
    at_first = following.left_after_homing(forward, reverse, row, closed)
    behind = following.behind(steepest, feed)
    notes = []
    if standing:
        notes.append(_standing_note(following, standing, forward - reverse))
    if at_first:
        notes.append(_homing_note(following, at_first, angles[row]))
    if behind:
        notes.append(_behind_note(following, steepest, feed, behind))
    bound = following.in_motion * (1.0 + EDGE) if notes else 0.0
    return Lag(bound, max(standing, at_first), tuple(notes))


def _standing_note(following: Following, standing: float, reversal: Floats) -> str:
    low, high = np.array([following.at_once, following.in_motion]) / ARCSEC
    sizes = np.abs(reversal) / ARCSEC
    return (
        f"a reversal asks LinuxCNC for changes of {np.min(sizes):.3g} to {np.max(sizes):.3g} "
        f"arcsec, and its trim stands still for those of {low:.3g} to {high:.3g} (1/4 to 1/2 of "
        f"MAX_ACCELERATION times the square of the servo period): up to {standing / ARCSEC:.3g} "
        "arcsec stay. Another MAX_ACCELERATION or servo period moves this band away"
    )


def _homing_note(following: Following, standing: float, home: float) -> str:
    low, high = np.array([following.at_once, following.in_motion]) / ARCSEC
    return (
        f"the trim is 0 when the axis has been homed, at {home / DEGREE:.6g} deg, and stands "
        f"still for changes of {low:.3g} to {high:.3g} arcsec: up to {standing / ARCSEC:.3g} "
        "arcsec stay until the axis has come to where the table asks for less or for more. "
        "Choose the home angle as the reference of the table"
    )


def _behind_note(following: Following, steepest: float, feed: float, behind: float) -> str:
    how = "farther and farther" if np.isinf(behind) else f"up to {behind / ARCSEC:.3g} arcsec"
    return (
        f"the trim follows up to a feed of {following.fastest_feed(steepest) / DEGREE:.4g} deg/s, "
        f"and at {feed / DEGREE:.4g} deg/s it is {how} behind while the axis moves; what is in "
        "the dead band when it stops stays"
    )
