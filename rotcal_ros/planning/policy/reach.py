"""Whether the goal is within reach of all steps: hours of lengths might lead to nothing."""

from __future__ import annotations

import numpy as np

from rotcal_ros.arrays import Bools
from rotcal_ros.planning.policy.lengths import LengthExperiment
from rotcal_ros.planning.policy.measured import Measured
from rotcal_ros.planning.policy.stated import Allowance


class Reach:
    """The uncertainty (rad) that all steps would give with one ``noise`` and coverage factor.

    It is worked out once, and only where it is doubted that the goal can be had.
    """

    def __init__(self, noise: float, coverage_factor: float) -> None:
        self._stated = noise, coverage_factor
        self._doubted = False
        self._best: float | None = None

    def doubt(self) -> None:
        """Have it worked out when it is asked for next: many further lengths are lacking."""
        self._doubted = True

    def best(
        self, of: LengthExperiment, measured: Measured, allowed: Bools, allowance: Allowance
    ) -> float:
        """Return what would be stated of the ``measured`` and all ``allowed`` steps.

        0 while nobody doubts, but never less than what no length lowers.
        """
        if not self._doubted:
            return allowance.floor
        if self._best is None:
            left = np.setdiff1d(np.flatnonzero(allowed), list(measured.steps))
            self._best = of.planned(measured, *self._stated, left)
        return allowance.stated(self._best)
