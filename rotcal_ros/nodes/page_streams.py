"""What the heartbeat of the capture tells of the instruments: rates, readings, temperatures."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Mapping
from typing import Final

from rotcal_ros.bags import names
from rotcal_ros.nodes.latest import NOW, SILENT
from rotcal_ros.observations import LengthStatus
from rotcal_ros.page.board import Course
from rotcal_ros.page.state import Lengths, Points, Stream, Temperature

RATE_S: Final = 4.0
LENGTHS_S: Final = 60.0
LENGTH_POINTS: Final = 400
TEMPERATURE_PERIOD_S: Final = 5.0
VALID: Final = "valid."
WORDS: Final = {
    LengthStatus.BEAM_BROKEN.name: "beam broken",
    LengthStatus.UNSTABLE.name: "unstable",
    LengthStatus.UNKNOWN.name: "state unknown",
}
HOUR_S: Final = 3600.0


class Streams:
    """Takes the values of the capture, beat by beat."""

    def __init__(self) -> None:
        self._counts: dict[str, deque[tuple[float, int]]] = {}
        self._lengths: deque[tuple[float, float]] = deque(maxlen=LENGTH_POINTS)
        self._courses: dict[str, Course] = {}
        self._ranges: dict[str, tuple[float, float]] = {}
        self._latest: dict[str, float] = {}
        self._offered_s: dict[str, float] = {}
        self._values: Mapping[str, str] = {}

    def hear(self, values: Mapping[str, str]) -> None:
        """Take the values of a beat."""
        self._values, now = values, time.monotonic()
        for key, value in values.items():
            if key.startswith(VALID):
                counts = self._counts.setdefault(key.removeprefix(VALID), deque())
                counts.append((now, int(value)))
                while now - counts[0][0] > RATE_S:
                    counts.popleft()
        if words := self._reading(names.TRACER_LENGTH):
            length = float(words[0]) * 1e3
            if math.isfinite(length):
                self._lengths.append((round(time.time(), 1), round(length, 4)))
        self._feel()

    def streams(self) -> tuple[Stream, ...]:
        """Return rate and silence of every topic that was heard."""
        found = []
        for topic, counts in sorted(self._counts.items()):
            (begun_s, first), (end_s, last) = counts[0], counts[-1]
            rate = (last - first) / (end_s - begun_s) if end_s > begun_s else 0.0
            silent = self._values.get(f"{SILENT}{topic}")
            found.append(Stream(topic, round(rate, 1), None if silent is None else float(silent)))
        return tuple(found)

    def lengths(self) -> Lengths | None:
        """Return the live reading: a length, else where the probe is; None before any."""
        if words := self._reading(names.TRACER_LENGTH):
            length = float(words[0]) * 1e3
            shown = f"{length:.4f} mm" if math.isfinite(length) else "–"
            return Lengths("Length", shown, WORDS.get(words[1], ""))
        if words := self._reading(names.PROBE_POINT):
            at = "  ".join(f"{float(x) * 1e3:.3f}" for x in words)
            return Lengths("Probe x y z", f"{at} mm", "")
        return None

    def length_course(self) -> Points:
        """Return the lengths of the last minute, in whole seconds between two changes."""
        until_s = int(time.time())
        return tuple((t, x) for t, x in self._lengths if until_s - LENGTHS_S < t <= until_s)

    def temperatures(self) -> tuple[Temperature, ...]:
        """Return what every sensor has told."""
        return tuple(
            Temperature(sensor, now, *self._ranges[sensor], drift(points), points)
            for sensor, now in sorted(self._latest.items())
            for points in [self._courses[sensor].points]
        )

    def _feel(self) -> None:
        """Take the temperature of the sensor that spoke last."""
        words = self._reading(names.TEMPERATURE)
        if not words or not math.isfinite(value := float(words[0])):
            return
        sensor, now_s = " ".join(words[1:]), round(time.time(), 1)
        course = self._courses.setdefault(sensor, Course())
        if now_s - self._offered_s.get(sensor, -math.inf) >= TEMPERATURE_PERIOD_S:
            self._offered_s[sensor] = now_s  # the course may have left it out
            course.add(now_s, value)
        low, high = self._ranges.get(sensor, (value, value))
        self._ranges[sensor] = min(low, value), max(high, value)
        self._latest[sensor] = round(value, 3)

    def _reading(self, topic: str) -> list[str]:
        return self._values.get(f"{NOW}{topic}", "").split()


def drift(course: Points) -> float | None:
    """Return the slope (K/h) of the best line through the last hour; None in the first minute."""
    last = [(t, y) for t, y in course if t >= course[-1][0] - HOUR_S]
    if len(last) < 3 or last[-1][0] - last[0][0] < 60.0:
        return None
    mean_t = sum(t for t, _ in last) / len(last)
    mean_y = sum(y for _, y in last) / len(last)
    above = sum((t - mean_t) * (y - mean_y) for t, y in last)
    return round(above / sum((t - mean_t) ** 2 for t, _ in last) * HOUR_S, 3)
