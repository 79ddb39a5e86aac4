"""Motion along one coordinate: speed-limited legs, then a lag that decays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import sqrt

import numpy as np

from rotcal_ros.foundation.arrays import Floats, Stamps
from rotcal_ros.foundation.units import NANOSECOND


@dataclass(frozen=True, slots=True)
class MotionLimits:
    """Largest ``speed`` (per s), ``acceleration`` (per s^2), ``lag`` and its time constant (s)."""

    speed: float
    acceleration: float
    lag: float
    settling_time: float


@dataclass(frozen=True, slots=True)
class Leg:
    """From rest at ``start`` to rest at ``stop``, as fast as the limits allow."""

    begin_ns: int
    start: float
    stop: float
    ramp: float  # s, duration of acceleration and of braking
    duration: float  # s
    acceleration: float

    @property
    def end_ns(self) -> int:
        """Stamp at which the leg ends."""
        return self.begin_ns + round(self.duration / NANOSECOND)

    def state(self, stamps: Stamps) -> tuple[Floats, Floats]:
        """Return position and velocity at ``stamps`` (n,)."""
        time = np.clip((stamps - self.begin_ns) * NANOSECOND, 0.0, self.duration)
        left = self.duration - time
        rising = np.minimum(time, self.ramp)
        falling = np.minimum(left, self.ramp)
        speed = self.acceleration * np.minimum(rising, falling)
        cruise = np.clip(time - self.ramp, 0.0, self.duration - 2 * self.ramp)
        ramps = rising**2 + self.ramp**2 - falling**2
        way = self.acceleration * (ramps / 2 + self.ramp * cruise)
        sign = 1.0 if self.stop >= self.start else -1.0
        position = np.where(left > 0, self.start + sign * way, self.stop)
        return position, sign * speed


class Motion:
    """Legs one after the other, from ``begin_ns``; before it at rest at the first place.

    When the last leg ends the coordinate lags behind by ``limits.lag``, which then decays
    exponentially. ``last`` are the limits of the last leg, if it has its own.
    """

    def __init__(
        self,
        begin_ns: int,
        places: Sequence[float],
        limits: MotionLimits,
        last: MotionLimits | None = None,
    ) -> None:
        self._limits = limits
        self._legs: list[Leg] = []
        self.end_ns = begin_ns
        self.place = places[-1]
        for number, (start, stop) in enumerate(pairwise(places), 2):
            own = last if last is not None and number == len(places) else limits
            way = abs(stop - start)
            ramp = min(own.speed / own.acceleration, sqrt(way / own.acceleration))
            cruise = way / (own.acceleration * ramp) - ramp if ramp > 0 else 0.0
            lasts = max(2 * ramp + cruise, 0.0)
            self._legs.append(Leg(self.end_ns, start, stop, ramp, lasts, own.acceleration))
            self.end_ns = self._legs[-1].end_ns

    def state(self, stamps: Stamps) -> tuple[Floats, Floats]:
        """Return position and velocity at ``stamps`` (n,), the lag included."""
        if not self._legs:
            return np.full(len(stamps), self.place), np.zeros(len(stamps))
        first = stamps.min(initial=self.end_ns)
        under_way = [leg for leg in self._legs[:-1] if leg.end_ns > first]
        legs = [*under_way, self._legs[-1]]
        position, velocity = legs[0].state(stamps)
        for leg in legs[1:]:
            later = stamps >= leg.begin_ns
            there, speed = leg.state(stamps)
            position, velocity = np.where(later, there, position), np.where(later, speed, velocity)
        lag = self._lag(stamps)
        return position + lag, velocity - lag / self._limits.settling_time * (lag != 0)

    def _lag(self, stamps: Stamps) -> Floats:
        """Return the lag at ``stamps`` (n,); none before the motion ends."""
        last = self._legs[-1]
        since = (stamps - self.end_ns) * NANOSECOND
        decay = np.exp(-np.maximum(since, 0.0) / self._limits.settling_time)
        lag: Floats = np.where(since >= 0, -np.sign(last.stop - last.start) * decay, 0.0)
        return self._limits.lag * lag
