"""What the feedback of a table says: whether it is there, how fast it turns, in which unit."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from math import isfinite, pi, remainder
from typing import Final

from rotcal_ros.foundation.escapes import printable
from rotcal_ros.foundation.observations import TableSample
from rotcal_ros.foundation.units import DEGREE, NANOSECOND

PUBLISH_VELOCITY: Final = (
    "publish it beside the position, in rad/s (in deg/s with topics.angle_unit: deg)"
)
"""What to do about feedback without velocity."""
_HISTORY: Final = 10_000
_SAME_DEG: Final = 0.05
"""Feedback this close to the commanded angle in degrees counts as degrees."""
_FULL_TURN_DEG: Final = 360.0


def is_near(angle: float, commanded: float, tolerance: float) -> bool:
    """Return whether ``angle`` is within ``tolerance`` (rad); full turns do not count."""
    return isfinite(angle) and abs(remainder(angle - commanded, 2.0 * pi)) <= tolerance


def looks_like_degrees(angle: float, commanded: float) -> bool:
    """Return whether a feedback ``angle`` is in degrees where the table was commanded to (rad).

    A small angle near a commanded zero decides nothing: it is near in either unit.
    """
    if not isfinite(angle):
        return False
    off_deg = remainder(angle - commanded / DEGREE, _FULL_TURN_DEG)
    of_size = abs(remainder(commanded, 2.0 * pi)) > DEGREE or abs(angle) > 4.0 * pi
    return abs(off_deg) <= _SAME_DEG and of_size and abs(angle - commanded) > DEGREE


def looks_reversed(angle: float, commanded: float) -> bool:
    """Return whether a feedback ``angle`` (rad) is where the opposite one was commanded to.

    Near 0 and 180 degrees it decides nothing: there both are one.
    """
    same = _SAME_DEG * DEGREE
    return is_near(angle, -commanded, same) and not is_near(commanded, -commanded, DEGREE)


class TableSpeed:
    """Turns angles (rad) of the table into feedback with a speed, over at least ``span_s``."""

    def __init__(self, span_s: float) -> None:
        self._span_ns = round(span_s / NANOSECOND)
        self._angles: deque[tuple[int, float]] = deque(maxlen=_HISTORY)

    def restart(self) -> None:
        """Forget the angles before: the table has ended a motion."""
        self._angles.clear()

    def feed(self, stamp_ns: int, angle: float) -> TableSample | None:
        """Return the feedback; None before there is a speed, or if the stamp stands still.

        After a clock was set back the speed is taken anew.
        """
        angles = self._angles
        if angles and stamp_ns < angles[-1][0]:
            angles.clear()
        if angles and stamp_ns == angles[-1][0]:
            return None
        angles.append((stamp_ns, angle))
        while len(angles) > 2 and stamp_ns - angles[1][0] >= self._span_ns:
            angles.popleft()
        since_ns = stamp_ns - angles[0][0]
        if since_ns < self._span_ns:
            return None
        speed = (angle - angles[0][1]) / (since_ns * NANOSECOND)
        return TableSample(stamp_ns, angle, speed)


def missing_joint_message(topic: str, joint: str, heard: Iterable[str]) -> str:
    """Say that a topic has no ``joint``, which joints it has, and which one is likely meant."""
    there = list(heard)
    alike = [name for name in there if name.endswith(joint) or joint.endswith(name)]
    hint = f" (is it {printable(alike[0])}?)" if len(alike) == 1 else ""
    return (
        f"{topic} has no joint {joint!r} (cell.joint), it has "
        f"{', '.join(map(printable, there))}: name one of these{hint}, or leave cell.joint empty "
        "for the first"
    )
