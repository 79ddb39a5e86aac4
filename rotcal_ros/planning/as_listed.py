"""The policy ``as_listed``: every step that is left, in the order of the plan."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable

from rotcal_ros.planning.choices import Choice, Standing, StepOutcome


class AsListed:
    """Measures ``steps`` in their order; a step that is given up is not asked for again."""

    def __init__(self, steps: Iterable[int]) -> None:
        self._left = deque(steps)

    def choose(self) -> Choice:
        """Return the next step of the list."""
        if not self._left:
            return Choice(None, "all steps of the list are done", Standing(0))
        return Choice(self._left[0], "next of the list", Standing(len(self._left)))

    def note(self, outcome: StepOutcome) -> None:
        """Strike the step off when it is the next one."""
        if self._left and self._left[0] == outcome.step:
            self._left.popleft()
