"""Whether the stated frame has z away from the table: what no length tells, and beams may.

Targets and places typed in a frame whose z points into the table fit every length as well, and
EZC, EAC and EBC change their signs. But a tracer stands on the table: no beam goes through it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from rotcal_ros.methods.tracer_six.solution import SixSolution
from rotcal_ros.protection import Protection
from rotcal_ros.results import Verdict
from rotcal_ros.units import DEGREE

STEEP: Final = 45.0 * DEGREE
"""No beam goes down so steeply: tracers look past their own foot by 35 degrees or so at most."""


@dataclass(frozen=True, slots=True)
class Upward:
    """The elevations (rad, above the tracer along +z) of the steepest beams both ways."""

    lowest: float
    highest: float

    @classmethod
    def of(cls, solution: SixSolution) -> Upward:
        """Return that of all lengths that were used, in the stated frame."""
        state = solution.rig.state
        beam = state.targets - state.stations(solution.layout)[:, None]
        rises = (beam[..., 2] / np.linalg.norm(beam, axis=2))[solution.grid.used]
        return cls(float(np.arcsin(rises.min())), float(np.arcsin(rises.max())))

    def judged(
        self, verdict: Verdict, warnings: tuple[str, ...]
    ) -> tuple[Verdict, tuple[str, ...]]:
        """Return ``verdict`` and ``warnings``; a frame that stands on its head is not ok."""
        if self.lowest > -STEEP or self.highest > STEEP:
            return verdict, warnings
        warning = (
            f"beams go down by {-self.lowest / DEGREE:.0f} degrees, through the table, and none "
            "goes up as steeply: the z axis of targets and places seems to point into the table, "
            "and then EZC, EAC and EBC have the wrong sign"
        )
        return "suspect" if verdict == "ok" else verdict, (*warnings, warning)

    def protection(self) -> Protection:
        """Return whether targets and places that are both mirrored in z would be found."""
        unseen = (
            "targets and places whose z axis points into the table fit every length as well and "
            "turn the signs of EZC, EAC and EBC"
        )
        if self.highest > STEEP and self.lowest > -STEEP:
            return Protection(
                "sign of z",
                "tested",
                f"{unseen}, but beams that go up by {self.highest / DEGREE:.0f} degrees would go "
                "down as steeply, through the table",
            )
        return Protection(
            "sign of z",
            "not protected",
            f"{unseen}; no beam goes up by {STEEP / DEGREE:.0f} degrees or more alone, which "
            "would tell, for none goes down so steeply, through the table",
        )
