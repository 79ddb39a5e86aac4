"""Which table angle belongs to which station: what no length tells.

With all positions of a table renumbered by one every length fits as well, and each deviation
stands at its neighbour's angle; so it does where the table's zero is another one. Where the tracer
stands on the table tells it, if somebody has stated that.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.protection import Protection
from rotcal_ros.foundation.results import Verdict
from rotcal_ros.foundation.units import DEGREE, MILLIMETRE

NEAR: Final = 0.02
"""Distance, m, to which a person knows where the tracer stands on the table."""


@dataclass(frozen=True, slots=True)
class Numbering:
    """How far round the table a tracer stands from its stated place.

    ``bearing`` (rad, counter-clockwise seen from +z) is None where no place is stated, with
    ``where`` (a name for people), and known to ``near`` (m). ``step`` (rad): from one table
    position to the next, ``radius`` (m) of the tracer about the axis.
    """

    where: str
    step: float
    radius: float
    bearing: float | None
    near: float = NEAR

    @classmethod
    def of(
        cls, where: str, angles: Floats, radius: float, bearing: float | None, near: float = NEAR
    ) -> Numbering:
        """Return that of positions at commanded ``angles`` (m,), rad."""
        steps = np.diff(np.unique(angles))
        return cls(where, float(np.median(steps)) if len(steps) else 0.0, radius, bearing, near)

    def judged(
        self, verdict: Verdict, warnings: tuple[str, ...]
    ) -> tuple[Verdict, tuple[str, ...]]:
        """Return ``verdict`` and ``warnings``; whole positions off make an ok suspect."""
        off = 2.0 * self.radius * abs(np.sin(0.5 * (self.bearing or 0.0)))
        if self.bearing is None or self.step == 0.0 or off <= self.near:
            return verdict, warnings
        found = (
            f"the tracer stands {self.bearing / DEGREE:.1f} degrees round the table, "
            f"{off / MILLIMETRE:.0f} mm, from where {self.where} has it"
        )
        count = round(self.bearing / self.step)
        if not count or self.radius * abs(self.bearing - count * self.step) > self.near:
            return verdict, (
                *warnings,
                f"{found}: if that is right, the table's zero is another one than was commanded, "
                "and every deviation stands at an angle that is off by as much",
            )
        positions = f"{abs(count)} table position{'s' if abs(count) > 1 else ''}"
        warning = (
            f"{found}, which is {positions}: the positions are numbered off by {abs(count)}, or "
            f"the table's zero or {self.where} is wrong; every deviation may stand at the angle "
            "of another"
        )
        return "suspect" if verdict == "ok" else verdict, (*warnings, warning)

    def protection(self) -> Protection:
        """Return whether positions numbered off by one would be found."""
        apart = 2.0 * self.radius * abs(np.sin(0.5 * self.step))
        unseen = (
            "positions that are all numbered off by one, or a table's zero elsewhere, fit every "
            "length as well, and each deviation stands at another angle"
        )
        if self.bearing is None:
            return Protection(
                "numbering", "not protected", f"{unseen}: state {self.where}, which would tell"
            )
        if apart <= self.near:
            return Protection(
                "numbering",
                "not protected",
                f"{unseen}: the tracer moves {apart / MILLIMETRE:.2g} mm from one position to the "
                f"next, and {self.where} is believed to {self.near / MILLIMETRE:.2g} mm only",
            )
        return Protection(
            "numbering",
            "tested",
            f"positions that are numbered off by one or more put the tracer "
            f"{apart / MILLIMETRE:.2g} mm or farther from where {self.where} has it",
        )


def turned_by(found: Floats, stated: Floats) -> float:
    """Return by which angle (rad) about z points ``found`` (k, 3) are turned from ``stated``.

    Wherever the axis is: places of a circle that is shifted are turned by nothing.
    """
    here, there = ((points - points.mean(axis=0))[:, :2] @ (1.0, 1j) for points in (found, stated))
    return float(np.angle(np.vdot(there, here)))
