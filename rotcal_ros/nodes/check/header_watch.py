"""What the headers of a topic show: how often, how late, in which frames; whatever its type.

The messages stay bytes: only their first bytes are read, so that a fast stream costs little.
"""

from __future__ import annotations

import struct
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from statistics import median
from typing import Any

from rclpy.node import Node

from rotcal_ros.foundation.units import NANOSECOND
from rotcal_ros.nodes.runtime.draining import Batch, DrainedSubscription, sent_ns
from rotcal_ros.nodes.runtime.qos import adapted_qos

_MOST_FRAMES = 8
_KEPT = 5000


@dataclass
class HeaderWatch:
    """The headers of the messages since the beginning; times of arrival are of this machine.

    ``heard_s`` is the monotonic time of the latest one: setting a clock does not look like
    silence.
    """

    count: int = 0
    first_s: float = 0.0
    latest_s: float = 0.0
    heard_s: float = 0.0
    unstamped: int = 0
    set_back: int = 0
    frames: list[str] = field(default_factory=list)
    has_header: bool = True
    _ahead_ns: list[int] = field(default_factory=list)
    _stamp_ns: int = 0

    @property
    def rate_hz(self) -> float | None:
        """Messages a second; None while fewer than two came."""
        span = self.latest_s - self.first_s
        return (self.count - 1) / span if self.count > 1 and span > 0.0 else None

    @property
    def ahead_s(self) -> float | None:
        """Median of stamp less time of arrival; None where nothing is stamped."""
        return median(self._ahead_ns) * NANOSECOND if self._ahead_ns else None

    def note(self, data: bytes, received_ns: int) -> int:
        """Take a serialised message; return its stamp (ns), 0 where it has none."""
        now_s = received_ns * NANOSECOND
        self.first_s = self.first_s or now_s
        self.latest_s, self.count = now_s, self.count + 1
        self.heard_s = time.monotonic()
        if not self.has_header:
            return 0
        stamp_ns, frame = read_header(data)
        self.set_back += 0 < stamp_ns < self._stamp_ns
        self._stamp_ns = stamp_ns
        if not stamp_ns:
            self.unstamped += 1
        elif len(self._ahead_ns) < _KEPT:
            self._ahead_ns.append(stamp_ns - received_ns)
        if frame not in self.frames and len(self.frames) < _MOST_FRAMES:
            self.frames.append(frame)
        return stamp_ns


def read_header(data: bytes) -> tuple[int, str]:
    """Return stamp (ns) and frame of a serialised message; (0, "") where it has no header."""
    try:
        order = "<" if data[1] & 1 else ">"  # of the CDR encapsulation
        seconds, nanoseconds, length = struct.unpack_from(f"{order}iII", data, 4)
        frame = data[16 : 16 + max(length - 1, 0)].decode(errors="replace")
    except (struct.error, IndexError):
        return 0, ""
    return int(seconds) * 1_000_000_000 + int(nanoseconds), frame


def watch_headers(
    node: Node, message_type: Any, topic: str, stamped: Callable[[int, int, int], None]
) -> HeaderWatch:
    """Return the headers of an absolute ``topic`` from now on, whoever publishes it.

    ``stamped`` is called with stamp, time of sending and of arrival (ns) of every stamped message.
    """
    watch = HeaderWatch(has_header="header" in message_type.get_fields_and_field_types())

    def take(batch: Batch) -> None:
        for data, info in batch:
            received_ns = info["received_timestamp"] or time.time_ns()
            stamp_ns = watch.note(data, received_ns)
            if stamp_ns:
                stamped(stamp_ns, sent_ns(info), received_ns)

    offers = [info.qos_profile for info in node.get_publishers_info_by_topic(topic)]
    DrainedSubscription(node, message_type, topic, adapted_qos(offers), take, raw=True)
    return watch
