"""What the result of the lengths measured so far would state: the U that ends a measurement."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import inf, sqrt
from typing import TypeAlias

from rotcal_ros.foundation.observations import Observation


@dataclass(frozen=True, slots=True)
class Stated:
    """A result as the solver states it now.

    ``uncertainty``: U of ECC less its mean, k = 2, rms over the angles, rad; infinite without a
    result. ``error_motion`` (m): the most likely one of the table, where the solver estimates it.
    ``doubt``: why the verdict is not ok, or why there is no result; empty: it is ok.
    """

    uncertainty: float
    error_motion: float = 0.0
    doubt: str = ""


Solver: TypeAlias = Callable[[Sequence[Observation]], Stated]
"""Solves all accepted observations as the calibration will."""


@dataclass(frozen=True, slots=True)
class Allowance:
    """How what is stated follows from what lengths are planned to give.

    stated^2 = floor^2 + (growth * planned)^2: ``floor`` (rad) is the part of an estimated error
    motion, which no length lowers; ``growth`` is what the solver makes of the rest by estimating
    noise and error motion, allowing for slips, leaving lengths out.
    """

    floor: float = 0.0
    growth: float = 1.0

    @classmethod
    def of(cls, stated: float, planned: float, floor: float) -> Allowance:
        """Return the allowance that makes ``stated`` of ``planned``, both in rad."""
        if not 0.0 < planned < inf:
            return cls(floor)
        return cls(floor, sqrt(max(stated**2 - floor**2, 0.0)) / planned)

    def stated(self, planned: float) -> float:
        """Return what is stated where so much is ``planned``, rad."""
        return sqrt(self.floor**2 + (self.growth * planned) ** 2)

    def planned(self, stated: float) -> float:
        """Return what has to be planned for so much to be ``stated``, rad; 0: nothing helps."""
        return sqrt(max(stated**2 - self.floor**2, 0.0)) / self.growth
