"""Numbers of somebody else's instruments become records: the same code live and from a bag.

Bare numbers have no status, no sequence, no velocity; here they get what follows from them.
"""

from __future__ import annotations

from math import pi, remainder
from typing import Final

import numpy as np
from numpy.typing import NDArray

from rotcal_ros.bags.settings import TopicSettings
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.observations import LengthStatus, TracerSample
from rotcal_ros.planning.table_motion import TableSpeed

READING: Final = np.dtype(
    [
        ("row", np.int64),
        ("stamp_ns", np.int64),
        ("sequence", np.int64),
        ("length", np.float64),
        ("status", np.int64),
    ]
)
FEEDBACK: Final = np.dtype(
    [("row", np.int64), ("stamp_ns", np.int64), ("angle", np.float64), ("velocity", np.float64)]
)
_WRAP: Final = 1 << 32


class BareLengths:
    """Turns bare numbers into tracer readings, numbered as they come.

    A number that is none (a beam that is broken has no other way to say so) or lies outside the
    limits that its message tells is a reading of a broken beam.
    """

    def __init__(self, settings: TopicSettings) -> None:
        self._unit = settings.length_m
        self._counted = 0

    def readings(self, rows: Ints, stamps: Ints, values: Floats) -> NDArray[np.void]:
        """Return the readings (n,) of ``values`` (n, 1), or (n, 3) with their limits."""
        readings = np.zeros(len(rows), READING)
        readings["row"], readings["stamp_ns"] = rows, stamps
        readings["length"] = values[:, 0] * self._unit
        readings["sequence"] = (self._counted + np.arange(len(rows))) % _WRAP
        good = np.isfinite(values[:, 0])
        if values.shape[1] > 1:
            stated = values[:, 2] > values[:, 1]
            within = (values[:, 0] >= values[:, 1]) & (values[:, 0] <= values[:, 2])
            good &= ~stated | within
        readings["status"] = np.where(good, int(LengthStatus.OK), int(LengthStatus.BEAM_BROKEN))
        self._counted += len(rows)
        return readings


class BareAngles:
    """Turns bare angles into feedback with a velocity; full turns are no motion."""

    def __init__(self, settings: TopicSettings) -> None:
        self._unit = settings.angle_rad
        self._speed = TableSpeed(settings.angle_span_s)
        self._unwrapped: float | None = None

    def feedback(self, rows: Ints, stamps: Ints, values: Floats) -> NDArray[np.void]:
        """Return the feedback (m,), m <= n, of ``values`` (n, 1 or more).

        The first ones have no velocity yet and are left out.
        """
        found = []
        angles = (values[:, 0] * self._unit).tolist()
        for row, stamp_ns, angle in zip(rows.tolist(), stamps.tolist(), angles, strict=True):
            sample = self._speed.feed(stamp_ns, self._unwrap(angle))
            if sample is not None:
                found.append((row, stamp_ns, angle, sample.velocity))
        return np.array(found, FEEDBACK)

    def _unwrap(self, angle: float) -> float:
        before = angle if self._unwrapped is None else self._unwrapped
        if np.isfinite(angle - before):
            self._unwrapped = before + remainder(angle - before, 2.0 * pi)
        return angle if self._unwrapped is None else self._unwrapped


def tracer_samples(readings: NDArray[np.void]) -> list[TracerSample]:
    """Return readings (n,) as records."""
    return [
        TracerSample(stamp_ns, sequence, length, 0.0, LengthStatus(status))
        for _, stamp_ns, sequence, length, status in readings.tolist()
    ]
