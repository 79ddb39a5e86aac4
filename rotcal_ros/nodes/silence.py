"""Counting how often streams that should never pause fell silent while a bag was written."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Final

from rotcal_ros.bags import names

NEVER_PAUSE: Final = (names.TRACER_LENGTH, names.JOINT_STATES, names.TEMPERATURE)
"""Last names of the streams that are watched, once somebody publishes them."""


class Silences:
    """``counts`` has one entry ``silent <topic>`` per stream: how often it was silent too long."""

    def __init__(self, limit_s: float) -> None:
        self._limit_s = limit_s
        self._begun_s = 0.0
        self._silent: set[str] = set()
        self.counts: Counter[str] = Counter()

    def begin(self, now_s: float) -> None:
        """Begin to count anew; what was before does not matter."""
        self._begun_s = now_s
        self._silent.clear()
        self.counts.clear()

    def look(self, heard_s: Mapping[str, float], now_s: float) -> None:
        """Take the times at which topics were last heard, by their absolute names."""
        for topic, last_s in heard_s.items():
            if topic.rpartition("/")[2] not in NEVER_PAUSE:
                continue
            if now_s - max(last_s, self._begun_s) <= self._limit_s:
                self._silent.discard(topic)
            elif topic not in self._silent:
                self._silent.add(topic)
                self.counts[f"{names.SILENT} {topic}"] += 1
