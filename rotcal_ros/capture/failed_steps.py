"""Steps that failed running: when a calibration is given up, and with which reason."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

from rotcal_ros.capture.rejections import Commonest
from rotcal_ros.capture.window import BEAM_BROKEN

HIDDEN: Final = 10
"""So many times as many steps may fail running because something stands in the beam: a fixture
hides a row of targets, and the rest of the plan is worth measuring."""


@dataclass
class FailedSteps:
    """Counts the steps that failed running, all attempts used up; ``limit`` 0: never give up."""

    limit: int
    _steps: list[tuple[int, tuple[str, ...]]] = field(default_factory=list)

    def note(self, step: int, reasons: Sequence[str]) -> None:
        """Take the end of a step: why its attempts were rejected, nothing when it was captured."""
        if reasons:
            self._steps.append((step, tuple(reasons)))
        else:
            self._steps.clear()

    def why_give_up(self) -> str:
        """Return the reason to give up; empty: there is none yet."""
        hidden = [step for step, reasons in self._steps if all(map(_in_the_beam, reasons))]
        failed = len(self._steps)
        if not self.limit or max(failed - len(hidden), failed / HIDDEN) < self.limit:
            return ""
        found = Commonest.of(r for _, reasons in self._steps for r in reasons)
        assert found is not None
        steps = f"{failed} steps running" if failed > 1 else "a step"
        return (
            f"given up: {steps} failed; of their attempts {found.in_words()}. Put that right, "
            "then go on with 'rotcal run --resume', which measures these steps again "
            f"(planner.max_failed_steps = {self.limit} says how many may fail running)"
        )


def _in_the_beam(reason: str) -> bool:
    return BEAM_BROKEN in reason
