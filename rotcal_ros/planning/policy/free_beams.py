"""How probably each beam is free: what hides a target hides its neighbours as well."""

from __future__ import annotations

from typing import Final

import numpy as np

from rotcal_ros.arrays import Floats
from rotcal_ros.units import DEGREE

BLOCKED_WIDTH: Final = 15.0 * DEGREE
"""A beam so near to a blocked one is as likely blocked as free."""
TINY: Final = 1e-6


class FreeBeams:
    """Beams along ``directions`` (k, 3), unit vectors; ``allowed`` (k,): not found blocked."""

    def __init__(self, directions: Floats) -> None:
        count = len(directions)
        self._directions = directions
        self.allowed = np.ones(count, dtype=np.bool_)
        self._from_blocked, self._from_free = np.full(count, np.pi), np.full(count, np.pi)
        """Angles (k,) of every beam to the nearest that was blocked, and free, rad."""
        self._free: list[int] = []
        """Beams that were found free, and are not yet in the angles."""

    def note_free(self, number: int) -> None:
        """Note that a beam was free."""
        self._free.append(number)

    def note_blocked(self, number: int) -> None:
        """Note that a beam was blocked: it is not allowed any more."""
        self._from_blocked = np.minimum(self._from_blocked, self._angles_from(number))
        self.allowed[number] = False

    @property
    def chance(self) -> Floats:
        """How probably each beam (k,) is free: less near a blocked one, more near free ones."""
        if not (self._from_blocked < np.pi).any():
            return np.ones(len(self._from_blocked))
        while self._free:
            self._from_free = np.minimum(self._from_free, self._angles_from(self._free.pop()))
        blocked = np.maximum(self._from_blocked, TINY)
        near = 0.5 ** ((blocked / BLOCKED_WIDTH) ** 2)
        return np.asarray(1.0 - near * np.minimum(1.0, self._from_free / blocked))

    def _angles_from(self, number: int) -> Floats:
        cosine = np.clip(self._directions @ self._directions[number], -1.0, 1.0)
        return np.asarray(np.arccos(cosine), dtype=np.float64)
