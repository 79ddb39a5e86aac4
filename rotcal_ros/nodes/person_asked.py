"""Having a person do what the plan pauses for, and checking it."""

from __future__ import annotations

import time
from itertools import count
from typing import Final

from rotcal_ros.catalogue import Calibration
from rotcal_ros.catalogue.continuation import Continuation
from rotcal_ros.errors import DataError
from rotcal_ros.nodes.goal_watch import GoalWatch
from rotcal_ros.nodes.step_measuring import StepMeasuring
from rotcal_ros.planning.plan import PAUSED, Pause

REPEAT_PERIOD_S: Final = 2.0
"""An instruction is repeated after this time, for clients that come late."""


class PersonAsked:
    """Asks a person for work; ``waiting`` is True until it is done, whoever says so."""

    def __init__(
        self,
        calibration: Calibration,
        continuation: Continuation,
        watch: GoalWatch,
        steps: StepMeasuring,
    ) -> None:
        self._calibration = calibration
        self._earlier = continuation.observations
        self._watch = watch
        self._steps = steps
        self.waiting = False

    async def have_done(self, pause: Pause) -> None:
        """Have the work of a pause done and check it, again and again until it is good.

        What the method can live with is asked for ``max_attempts`` times, what makes a result
        impossible until the goal is canceled.
        """
        text = pause.instruction
        for asked in count(1):
            await self._ask(pause, text)
            for index in range(pause.first, pause.last + 1):
                await self._steps.measure(index)
            found, hopeless = self._complaints()
            if not found or (asked >= self._watch.settings.max_attempts and not hopeless):
                return
            text = f"not as it should be: {found}; put it right ({pause.instruction})"

    async def _ask(self, pause: Pause, text: str) -> None:
        """Show the instruction and wait for the end of the work, as long as it takes."""
        asked_s = time.monotonic()
        progress = self._watch.progress
        progress.step = pause.first
        self.waiting = True
        try:
            while self.waiting:
                self._watch.tell(PAUSED + text)
                await self._watch.wait(lambda: not self.waiting, REPEAT_PERIOD_S)
        finally:
            self.waiting = False
        progress.started_s += time.monotonic() - asked_s

    def _complaints(self) -> tuple[str, bool]:
        """Return what the observations so far say against the work; hopeless or not."""
        observations = [*self._earlier, *self._watch.links.observations.values()]
        try:
            return "; ".join(self._calibration.check(observations)), False
        except DataError as error:
            return str(error), True
