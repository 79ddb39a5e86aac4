"""The time of a recording as it passes again: faster or slower, and on ``/clock`` where asked."""

from __future__ import annotations

import time
from typing import Final

from rclpy.node import Node
from rosgraph_msgs.msg import Clock

from rotcal_ros.nodes.conversions import time_message
from rotcal_ros.nodes.replayed_bag import CLOCK
from rotcal_ros.units import NANOSECOND

CLOCK_PERIOD_S: Final = 0.01


class ReplayPace:
    """``rate`` seconds of the recording, which begins at ``start_ns``, pass in one second."""

    def __init__(self, node: Node, start_ns: int, rate: float, *, clock: bool) -> None:
        self._start_ns, self._rate = start_ns, rate
        self._clock = node.create_publisher(Clock, CLOCK, 10) if clock else None
        self._begun_s, self._told_s = time.monotonic(), 0.0

    def begin(self) -> None:
        """Begin now."""
        self._begun_s = time.monotonic()

    def stood_still(self, seconds: float) -> None:
        """Go on behind a pause as if there had been none."""
        self._begun_s += seconds

    def passed_s(self) -> float:
        """Return how much of the recording has passed, in s."""
        return (time.monotonic() - self._begun_s) * self._rate

    def left_s(self, log_time_ns: int) -> float:
        """Return how long it is, in s, until a message is due; negative: it is late."""
        due_s = self._begun_s + (log_time_ns - self._start_ns) * NANOSECOND / self._rate
        return due_s - time.monotonic()

    def tick(self) -> None:
        """Publish the time of the recording, when that is due."""
        if self._clock is not None and time.monotonic() - self._told_s > CLOCK_PERIOD_S:
            self._told_s = time.monotonic()
            now_ns = self._start_ns + int(self.passed_s() / NANOSECOND)
            self._clock.publish(Clock(clock=time_message(now_ns)))
