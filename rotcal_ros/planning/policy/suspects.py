"""Lengths that do not agree with the others: measured again, or replaced by another target."""

from __future__ import annotations

from typing import Final

from rotcal_ros.observations import Observation
from rotcal_ros.planning.policy.measured import Measured

FEW_SUSPECTS: Final = 4
SUSPECT_SHARE: Final = 0.1
"""When more lengths than either are suspect, that is no error of single lengths but noise."""


class Suspects:
    """The steps whose lengths were suspect, and how far that has been followed."""

    def __init__(self) -> None:
        self._steps: set[int] = set()
        self._gone_over: set[int] = set()
        """Suspect steps that were measured again, and table positions where all were."""

    def single(self, measured: Measured) -> bool:
        """Whether so few lengths were suspect that each may be an error of its own."""
        return len(self._steps) < max(FEW_SUSPECTS, round(SUSPECT_SHARE * len(measured.steps)))

    def again(
        self, suspect: Observation, value: float, measured: Measured
    ) -> tuple[list[int], str]:
        """Return the steps to measure again, and why: the suspect one, then all of its station.

        Where few lengths check each other a wrong one makes others look wrong. Without any, that
        was in vain, and another target has to take its place. ``value``: of the test, in standard
        deviations.
        """
        step, place = suspect.step, suspect.table_position
        why = f"the length of step {step} is suspect ({value:+.1f} standard deviations)"
        if step not in self._steps:
            self._steps.add(step)
            return [step], f"{why}: measured again"
        here = {o.step for o in measured.observations if o.table_position == place}
        others = sorted(here - self._steps)
        if others and place not in self._gone_over:
            self._gone_over.add(place)
            return others, f"{why} once more: measured again with all of its station"
        return [], f"{why} again and again: another target in its place"
