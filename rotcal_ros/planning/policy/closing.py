"""Closing a sweep that drifts: two of its lengths are measured again, and tell by how much."""

from __future__ import annotations

import math

from rotcal_ros.observations import Observation
from rotcal_ros.planning.policy.measured import Measured
from rotcal_ros.units import MICROMETRE


class Closing:
    """The steps that close the sweep, if it drifts, and by how much their lengths have changed."""

    def __init__(self) -> None:
        self._changes: dict[int, float] = {}

    @property
    def begun(self) -> bool:
        """Whether there are such steps: a sweep is closed once."""
        return bool(self._changes)

    def begin(self, measured: Measured) -> tuple[int, int]:
        """Return the first and the middle step of what was measured."""
        by_time = [measured.observations[row] for row in measured.time_order().argsort()]
        steps = by_time[0].step, by_time[len(by_time) // 2].step
        self._changes = dict.fromkeys(steps, math.nan)
        return steps

    def note(self, observation: Observation, measured: Measured) -> None:
        """Take notice of a length, before it is ``measured``: one that closes is compared."""
        step = observation.step
        if not math.isnan(self._changes.get(step, 0.0)):
            return
        before = measured.last_of(step)
        if before is None or not measured.of_one_zero(before, observation):
            self._changes[step] = math.inf
        else:
            self._changes[step] = observation.mean[0] - before.mean[0]

    def in_words(self) -> str:
        """Return by how much lengths have changed, to end a sentence with; empty: none closed."""
        known = {s: change for s, change in self._changes.items() if not math.isnan(change)}
        if not known:
            return ""
        return "; closed: step " + ", ".join(f"{s} {_by(change)}" for s, change in known.items())


def _by(change: float) -> str:
    """Return a change of a length (m) in words; infinite: the zero is another one."""
    return f"by {change / MICROMETRE:+.2f} um" if math.isfinite(change) else "with another zero"
