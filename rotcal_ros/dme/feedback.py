"""Where a machine says it stands: readings of its reports, and the speed of its table."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from rotcal_ros.dme.faults import ProtocolError
from rotcal_ros.dme.grammar import Call, calls_by_name, parse_values
from rotcal_ros.observations import TableSample
from rotcal_ros.planning.plan import Point
from rotcal_ros.units import MILLIMETRE, NANOSECOND

REPORTED: Final = tuple(Call(name) for name in ("X", "Y", "Z", "R"))
"""What the machine is asked to report, of itself and with every point."""
_HISTORY: Final = 10_000


@dataclass(frozen=True, slots=True)
class Standing:
    """Where the tip is (m, machine frame), and the table's R in degrees."""

    position: Point
    r_deg: float


def parse_standing(data: Sequence[str], asked_by: str) -> Standing:
    """Return the one report among the data lines; ProtocolError when it is not there."""
    if len(data) != 1:
        raise ProtocolError(f"{asked_by}: expected one line of data, found {len(data)}")
    return standing_of(data[0], asked_by)


def standing_of(text: str, asked_by: str) -> Standing:
    """Return the report in a data line; ProtocolError when it lacks X, Y, Z or R."""
    found = calls_by_name(parse_values(text))
    missing = [asked.name for asked in REPORTED if asked.name not in found]
    if missing:
        raise ProtocolError(f"{asked_by}: no {', '.join(missing)} in {text!r:.200}")
    x, y, z, r_deg = (found[asked.name].number() for asked in REPORTED)
    return Standing((x * MILLIMETRE, y * MILLIMETRE, z * MILLIMETRE), r_deg)


class TableSpeed:
    """The table's angles (rad) become feedback with a speed, taken over at least ``span_s``."""

    def __init__(self, span_s: float) -> None:
        self._span_ns = round(span_s / NANOSECOND)
        self._angles: deque[tuple[int, float]] = deque(maxlen=_HISTORY)

    def restart(self) -> None:
        """Forget the angles before: the table has ended a motion."""
        self._angles.clear()

    def feed(self, stamp_ns: int, angle: float) -> TableSample | None:
        """Return the feedback; None while too little is known for a speed, or time stood still."""
        angles = self._angles
        if angles and stamp_ns <= angles[-1][0]:
            return None
        angles.append((stamp_ns, angle))
        while len(angles) > 2 and stamp_ns - angles[1][0] >= self._span_ns:
            angles.popleft()
        since_ns = stamp_ns - angles[0][0]
        if since_ns < self._span_ns:
            return None
        speed = (angle - angles[0][1]) / (since_ns * NANOSECOND)
        return TableSample(stamp_ns, angle, speed)
