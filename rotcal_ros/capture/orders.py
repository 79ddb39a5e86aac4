"""Orders come as two messages: where the table goes, and where the probe goes."""

from __future__ import annotations

from typing import Any, Final

from rotcal_ros.capture.messages import command, stamp_ns
from rotcal_ros.foundation.observations import Command

WAITING_LIMIT: Final = 64
"""Messages that wait for their partner at most; beyond that the oldest is forgotten."""


class Orders:
    """Pairs the messages of an order by step and attempt, whichever comes first.

    A message that comes again before its partner replaces the earlier one. ``stamp_ns`` is the
    stamp of the latest order that was complete.
    """

    def __init__(self) -> None:
        self.stamp_ns = 0
        self._waiting: dict[tuple[int, int], tuple[Any, Any]] = {}

    def table_angle(self, message: Any) -> Command | None:
        """Take a rotcal_msgs/TableAngle; return the order when it is complete."""
        return self._take(message, 0)

    def probe_target(self, message: Any) -> Command | None:
        """Take a rotcal_msgs/ProbeTarget; return the order when it is complete."""
        return self._take(message, 1)

    def clear(self) -> None:
        """Forget what waits for its partner."""
        self._waiting.clear()

    def _take(self, message: Any, place: int) -> Command | None:
        key = (message.step, message.attempt)
        table, probe = self._waiting.pop(key, (None, None))
        if place == 0:
            table = message
        else:
            probe = message
        if table is not None and probe is not None:
            self.stamp_ns = max(stamp_ns(table.header.stamp), stamp_ns(probe.header.stamp))
            return command(table, probe)
        self._waiting[key] = (table, probe)
        if len(self._waiting) > WAITING_LIMIT:
            del self._waiting[next(iter(self._waiting))]
        return None
