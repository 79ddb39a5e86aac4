"""Whether the table stands at an ordered angle, so that a place may be measured."""

from __future__ import annotations

from math import isnan

from rotcal_ros.foundation.observations import Command, TableSample
from rotcal_ros.foundation.units import ARCSEC, DEGREE
from rotcal_ros.planning.table_motion import is_near


class TableRest:
    """Hears the feedback; the table is at rest after ``settle_s`` in position and slow enough.

    ``tolerance_arcsec`` and ``speed_deg_s`` are those of the capture, which checks again.
    """

    def __init__(self, tolerance_arcsec: float, speed_deg_s: float, settle_s: float) -> None:
        self._tolerance = tolerance_arcsec * ARCSEC
        self._speed = speed_deg_s * DEGREE
        self._settle_ns = round(settle_s * 1e9)
        self._since: TableSample | None = None
        self._latest: TableSample | None = None

    def hear(self, sample: TableSample) -> None:
        """Take a feedback."""
        rests = abs(sample.velocity) <= self._speed
        if not rests or self._since is None or self._off(sample, self._since.angle):
            self._since = sample if rests else None
        self._latest = sample

    def forget(self) -> None:
        """Forget everything: another feedback begins."""
        self._since = self._latest = None

    def why_not(self, order: Command) -> str | None:
        """Return why the table does not rest where ``order`` sent it; None: it does."""
        since, latest = self._since, self._latest
        if latest is None:
            return "no feedback of the table has come"
        if isnan(latest.velocity):
            return "the feedback tells no velocity"
        if since is None:
            return "the table moves"
        if self._off(latest, order.table_angle):
            here, there = latest.angle / DEGREE, order.table_angle / DEGREE
            return f"the table rests at {here:.4f}° and is ordered to {there:.4f}°"
        settled = latest.stamp_ns - since.stamp_ns >= self._settle_ns
        return None if settled else "the table has just come to rest"

    def _off(self, sample: TableSample, angle: float) -> bool:
        return not is_near(sample.angle, angle, self._tolerance)
