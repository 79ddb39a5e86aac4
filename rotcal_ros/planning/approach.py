"""The approach to a table angle from the ordered side: way of the joint, turns, travel, time.

All angles are in rad, with the joint's sign; those of a way include the turns that the controller
counts, so that the joint makes no extra turn.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import accumulate, pairwise
from math import ceil, floor, inf, isfinite, sqrt
from typing import Final

from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.observations import Approach
from rotcal_ros.foundation.units import DEGREE, TURN
from rotcal_ros.planning.settings import TableAdapterSettings

TOWARDS: Final = {Approach.POSITIVE: 1.0, Approach.NEGATIVE: -1.0}
"""Sign of the last motion, if a side is ordered."""
SHORTEST_S = 0.1
"""Even a step to the joint's present position takes this long: controllers refuse less."""


def require_rest(turn_speed: float) -> None:
    """Raise DataError for an order to turn on at this speed (rad/s), where a table only stops."""
    if turn_speed:
        raise DataError(
            f"ordered to turn on at {turn_speed / DEGREE:g} deg/s, while the linear axes follow: "
            "this adapter moves the table alone, from rest to rest; leave plan.turning_deg_s out"
        )


@dataclass(frozen=True, slots=True)
class JointPath:
    """The ``angles`` (rad) that a joint is sent to one after the other, at rest in each.

    ``start`` is where it stands, ``times_s`` when it shall be at each angle, ``velocity`` (rad/s)
    how fast it moves at the start. In between it moves as a cubic in time, like
    joint_trajectory_controller with positions and velocities.
    """

    start: float
    angles: tuple[float, ...]
    times_s: tuple[float, ...]
    velocity: float = 0.0

    @property
    def goal(self) -> float:
        """Where it ends."""
        return self.angles[-1]

    def at(self, time_s: float) -> tuple[float, float]:
        """Return where (rad) and how fast (rad/s) it shall be ``time_s`` after the start."""
        if time_s >= self.times_s[-1]:
            return self.goal, 0.0
        stops, times = (self.start, *self.angles), (0.0, *self.times_s)
        time_s = max(time_s, 0.0)
        leg = bisect_right(times, time_s) - 1
        way, lasting_s = stops[leg + 1] - stops[leg], times[leg + 1] - times[leg]
        part = (time_s - times[leg]) / lasting_s
        begun = 0.0 if leg else self.velocity
        angle = way * part * part * (3 - 2 * part) + begun * lasting_s * part * (1 - part) ** 2
        speed = 6 * way / lasting_s * part * (1 - part) + begun * (1 - part) * (1 - 3 * part)
        return stops[leg] + angle, speed


def approach_angles(
    here: float, goal: float, approach: Approach, run_up: float
) -> tuple[float, ...]:
    """Return the angles to stop at on the way from ``here`` to ``goal`` (all rad).

    An ordered side is kept on at least the last ``run_up``: a table that is nearer, or beyond,
    goes back so far first.
    """
    towards = TOWARDS.get(approach, 0.0)
    if not towards or towards * (goal - here) >= run_up:
        return (goal,)
    return (goal - towards * run_up, goal)


def path_to(
    angle: float, approach: Approach, start: float, settings: TableAdapterSettings
) -> JointPath:
    """Return the shortest way from ``start`` to a table ``angle`` (any turn of it).

    An ordered ``approach`` is kept on at least the last ``overshoot_deg``. Raises DataError if the
    travel ends before.
    """
    run_up = settings.overshoot_deg * DEGREE
    goals = _turns(angle, start, settings)
    ways = (approach_angles(start, goal, approach, run_up) for goal in goals)
    possible = [legs for legs in ways if _within(legs, settings)]
    if not possible:
        raise DataError(
            f"the table cannot go to {angle / DEGREE:.4f} deg"
            f"{' with this side of approach' if approach in TOWARDS else ''}: its travel is "
            f"{settings.lower_deg:g} to {settings.upper_deg:g} deg; leave this angle out of the "
            "plan, or correct lower_deg and upper_deg"
        )
    angles = min(possible, key=lambda legs: (_length(start, legs), legs))
    stops = (start, *angles)
    times = accumulate(_duration_s(abs(b - a), settings) for a, b in pairwise(stops))
    return JointPath(start, angles, tuple(times))


def stopping_path(angle: float, velocity: float, settings: TableAdapterSettings) -> JointPath:
    """Return the way on which a joint that moves (rad/s) comes to rest from ``angle`` (rad).

    A cubic from this velocity to rest over half the time and distance brakes evenly; if the
    velocity is not finite the joint is to rest where it is.
    """
    velocity = velocity if isfinite(velocity) else 0.0
    time_s = max(abs(velocity) / (settings.acceleration_deg_s2 * DEGREE), SHORTEST_S)
    return JointPath(angle, (angle + velocity * time_s / 2,), (time_s,), velocity)


def _turns(angle: float, start: float, settings: TableAdapterSettings) -> Iterator[float]:
    """Yield ``angle`` in the turns that may be nearest to ``start``, or in all of the travel."""
    if settings.lower_deg is None or settings.upper_deg is None:
        nearest = round((start - angle) / TURN)
        first, last = nearest - 1, nearest + 1
    else:
        first = ceil((settings.lower_deg * DEGREE - angle) / TURN - 1e-12)
        last = floor((settings.upper_deg * DEGREE - angle) / TURN + 1e-12)
    return (angle + turn * TURN for turn in range(first, last + 1))


def _within(legs: tuple[float, ...], settings: TableAdapterSettings) -> bool:
    lower = -inf if settings.lower_deg is None else settings.lower_deg * DEGREE
    upper = inf if settings.upper_deg is None else settings.upper_deg * DEGREE
    return all(lower - 1e-9 <= angle <= upper + 1e-9 for angle in legs)


def _length(start: float, legs: tuple[float, ...]) -> float:
    return sum(abs(b - a) for a, b in pairwise((start, *legs)))


def _duration_s(distance: float, settings: TableAdapterSettings) -> float:
    """Return how long a cubic takes that exceeds neither the speed nor the acceleration."""
    by_speed = 1.5 * distance / (settings.speed_deg_s * DEGREE)
    by_acceleration = sqrt(6.0 * distance / (settings.acceleration_deg_s2 * DEGREE))
    return max(by_speed, by_acceleration, SHORTEST_S)
