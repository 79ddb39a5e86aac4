"""A fringe that the counter may have slipped without being found: allowed for in the uncertainty.

A measurement with one slip is held to be as likely as one with none (SLIPPED), and any moment of
it as any other. With which probability the test of :mod:`.jumps` misses a slip follows from the
geometry, and so does what it then does to the stations, or to the curves of a whole table. The
covariance is the expected square of that. Like all of a covariance it does not depend on the
readings, and can be told in advance.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.special import ndtr

from rotcal_ros.foundation.arrays import Bools, Floats
from rotcal_ros.foundation.protection import POWER, TOLERABLE, Protection
from rotcal_ros.methods.tracer.solver.grid import Grid
from rotcal_ros.methods.tracer.solver.zero_shifts import Shifts

SLIPPED: Final = 0.5
"""Probability that a measurement holds a slip."""


@dataclass(frozen=True, eq=False)
class Slips:
    """Slips of ``size`` (m), one fringe, that begin at the moments of ``shifts``.

    ``missed`` (t,): probability that nothing is found of a slip at each of them.
    """

    size: float
    shifts: Shifts
    missed: Floats

    @property
    def found(self) -> float:
        """How probably a slip at any moment is found."""
        return 1.0 - float(self.missed.mean())

    @property
    def chance(self) -> Floats:
        """How probably (t,) a slip begins at each moment and stays unseen."""
        return SLIPPED / len(self.missed) * self.missed

    def covariance(self) -> Floats:
        """Return what unseen slips add to the covariance (q, q) of what the shifts move, SI."""
        moved = self.size * self.shifts.moved
        return np.asarray((moved.T * self.chance) @ moved, dtype=np.float64)

    def protection(self, share: Floats, cure: str = "") -> Protection:
        """Return the statement about slips.

        ``share`` (t,): the worst that a slip at each moment does, in standard uncertainties. One
        that may do more than TOLERABLE at a moment where it is not found with POWER is named,
        although the uncertainty holds it on average; ``cure`` is added then.
        """
        hidden = share[self.missed > 1.0 - POWER]
        worst = float(hidden.max()) if hidden.size else 0.0
        what = f"a counter that slips a fringe of {self.size:.3g} m"
        why = (
            f"{what} is found in {100 * self.found:.0f} % of the cases, by these lengths in this "
            "order; the uncertainty holds what the others do"
        )
        if worst > TOLERABLE:
            return Protection("slip", "not protected", f"{why} on average{cure}", worst)
        if self.found >= POWER:
            why = f"{what} makes the lengths disagree, and is found"
            return Protection("slip", "tested", why, worst)
        return Protection("slip", "bounded", why, worst)

    def draw(self, grid: Grid, rng: np.random.Generator, count: int) -> Floats:
        """Return what unseen slips do to the lengths of ``count`` trials, (count, p, n) in m."""
        chance, at = self.chance, self.shifts.at
        which = np.searchsorted(np.cumsum(chance), rng.random(count), "right")
        sign = np.where(rng.random(count) < 0.5, -self.size, self.size)
        shift = np.zeros((count, *grid.used.shape))
        hit = np.flatnonzero(which < len(at))
        if len(hit):
            later: Bools = self.shifts.moments.later(grid, at[which[hit]])
            shift[hit] = sign[hit, None, None] * later
        return shift


def slips_among(
    shifts: Shifts, size: float, significance: float, scale: float = 1.0
) -> Slips | None:
    """Return slips of ``size`` (m) that a test of ``significance`` may miss; None of size 0.

    ``scale``: how much larger the noise of all lengths is than their network has it.
    """
    if not size or not len(shifts.at):
        return None
    apart = size * np.sqrt(shifts.information) / scale
    found = ndtr(apart - shifts.limit(significance))
    return Slips(size, shifts, np.where(shifts.enough, 1.0 - found, 1.0))
