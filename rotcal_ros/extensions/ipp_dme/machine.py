"""The simulated cell as a DME server sees it: one machine with a rotary table, point by point.

It has the physics of the simulated cell; only the tip's way around a ball is led by the client
instead of the suite.
"""

from __future__ import annotations

import asyncio
import time
from dataclasses import dataclass, replace
from math import atan2, pi, remainder
from typing import Final

import numpy as np

from rotcal_ros.extensions.ipp_dme.faults import DmeFault
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.errors import ConfigurationError, ControllerError
from rotcal_ros.foundation.observations import Approach
from rotcal_ros.foundation.units import DEGREE, NANOSECOND
from rotcal_ros.methods.simulation import SimulatedCell

VOLUME_M: Final = 2.0
"""Farthest coordinate that the machine reaches, either way."""
SLICE_S: Final = 0.02
"""Wall time between two looks at a motion."""
SHORTEST_SLEEP_S: Final = 5e-4
"""A sleep is never shorter than a tick of the system's clock: shorter motions do not sleep."""
TURNS_DEG: Final = 36_000.0
"""Farthest R, either way."""
TOUCH_S: Final = 0.2
"""Machine time of a probing motion, if the instrument's settings have none."""


class MethodError(Exception):
    """A command ends with an error."""

    def __init__(self, number: int, cause: str) -> None:
        super().__init__(number, cause)
        self.fault = DmeFault.known(number, cause)


@dataclass(frozen=True, slots=True)
class Probing:
    """How a tip probes, m: begins before a surface, ends behind it, goes back from it."""

    approach: float = 0.002
    search: float = 0.003
    retract: float = 0.001


class SimulatedMachine:
    """Table and instrument of a simulated cell, whose time passes as the wall's, but scaled.

    Positions are metres in the machine frame, angles radians. ``moving`` while a motion lasts.
    Raises ConfigurationError for a cell whose table another program moves.
    """

    def __init__(self, cell: SimulatedCell) -> None:
        settings = cell.settings
        if settings.table.external:
            raise ConfigurationError("simulation.table.external: a DME server moves its own table")
        self.settings = settings
        self._cell = cell
        self._looked_s = time.monotonic()
        self._reported = 0
        self.probing = Probing()
        self.homed, self.moving = False, False
        touch_probe = getattr(settings, "touch_probe", None)
        self.tip_radius = float(getattr(touch_probe, "tip_radius_m", 0.0))
        self._touch_s = float(getattr(touch_probe, "touch_time_s", TOUCH_S))

    @property
    def cell(self) -> SimulatedCell:
        """The cell, at the present time."""
        now = time.monotonic()
        elapsed_s, self._looked_s = now - self._looked_s, now
        if not self.moving:
            self._cell.advance(elapsed_s * self.settings.time_scale)
        return self._cell

    def position(self) -> Floats:
        """Return where the tip is believed to be, (3,) m."""
        cell = self.cell
        found: Floats = cell.instrument.positions(np.array([cell.now_ns]))[0]
        return found

    def angle(self) -> float:
        """Return what the table's feedback says, rad."""
        cell = self.cell
        self._reported += 1
        return cell.table.feedback(self._reported, np.array([cell.now_ns]))[0].angle

    async def home(self) -> None:
        """Go up and count that as home; the simulated machine knows its axes anyway."""
        x, y, z = self.position().tolist()
        await self.go(np.array([x, y, max(z, 0.0)]), None, "Home")
        self.homed = True

    async def go(self, place: Floats | None, angle: float | None, cause: str) -> None:
        """Move the tip to ``place`` (3,) and the table to ``angle``, both at once."""
        if not self.homed and cause != "Home":
            raise MethodError(1011, cause)
        cell = self.cell
        if place is not None:
            if np.abs(place).max() > VOLUME_M:
                raise MethodError(2500, cause)
            try:
                free = cell.instrument.go(cell.now_ns, place)
            except ControllerError as error:
                raise MethodError(2002, cause) from error
            if not free:
                raise MethodError(2504, cause)
        if angle is not None:
            if abs(angle) > TURNS_DEG * DEGREE:
                raise MethodError(2505, cause)
            cell.table.order(cell.now_ns, angle, Approach.UNKNOWN)
        rest_ns = max(cell.table.rest_ns, cell.instrument.rest_ns)
        await self._spend((rest_ns - cell.now_ns) * NANOSECOND)

    async def align(self, part: Floats, machine: Floats) -> None:
        """Turn the table the shorter way, so that ``part`` (3,) points along ``machine`` (3,)."""
        vectors = (part[:2], machine[:2])
        for vector in vectors:
            _norm(vector, "AlignPart")
        begin, end = (atan2(float(y), float(x)) for x, y in vectors)
        here = self.angle()
        await self.go(None, here + remainder(end - begin - here, 2.0 * pi), "AlignPart")

    async def touch(self, surface: Floats, direction: Floats) -> Floats:
        """Return the centre (3,) of the tip that met the surface, and go back from it."""
        away, probing = direction / _norm(direction, "PtMeas"), self.probing
        tip = surface + self.tip_radius * away
        await self.go(tip + probing.approach * away, None, "PtMeas")
        await self._spend(self._touch_s)
        search = (probing.approach, probing.search)
        try:
            met = self._cell.instrument.touched(self._cell.now_ns, surface, away, search)
        except ControllerError as error:
            raise MethodError(2002, "PtMeas") from error
        if met is None:
            raise MethodError(1006, "PtMeas")
        back = probing.retract if probing.retract >= 0.0 else probing.approach
        await self.go(met + back * away, None, "PtMeas")
        return met

    def stop(self) -> None:
        """Stand still where tip and table are now."""
        self.moving = False
        cell = self.cell
        now = np.array([cell.now_ns])
        cell.instrument.go(cell.now_ns, cell.instrument.positions(now)[0])
        cell.table.order(cell.now_ns, float(cell.table.angles(now)[0]), Approach.UNKNOWN)

    def set_probing(self, **values: float) -> None:
        """Change how the tip probes, m."""
        self.probing = replace(self.probing, **values)

    async def _spend(self, duration_s: float) -> None:
        """Let machine time pass while the wall's does."""
        self.moving = True
        scale = self.settings.time_scale
        try:
            while duration_s > 0.0:
                part_s = min(duration_s, SLICE_S * scale)
                wall_s = part_s / scale
                await asyncio.sleep(wall_s if wall_s > SHORTEST_SLEEP_S else 0.0)
                self._cell.advance(part_s)
                duration_s -= part_s
        finally:
            self.moving, self._looked_s = False, time.monotonic()


def _norm(vector: Floats, cause: str) -> float:
    """Return the length of a vector; MethodError when it leads nowhere."""
    length = float(np.linalg.norm(vector))
    if not 1e-9 < length < 1e9:
        raise MethodError(1010, cause)
    return length
