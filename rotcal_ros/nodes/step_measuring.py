"""Measuring one step: order it, wait for the observation and for the receipt that it is kept."""

from __future__ import annotations

from rotcal_ros.catalogue.continuation import ATTEMPTS_PER_RUN
from rotcal_ros.nodes.cell_links import Attempt
from rotcal_ros.nodes.goal_watch import Codes, GoalError, GoalWatch
from rotcal_ros.planning.plan import Plan


class StepMeasuring:
    """Measures steps of a plan in one run of it; no attempt at a step has a number twice."""

    def __init__(self, plan: Plan, run: int, watch: GoalWatch) -> None:
        self._plan = plan
        self._run = run
        self._watch = watch
        self._next_attempt: dict[int, int] = {}

    async def measure(self, index: int) -> None:
        """Measure one step and note whether that succeeded."""
        progress = self._watch.progress
        progress.step = index
        progress.note(index, accepted=await self._captured(index))

    async def _captured(self, index: int) -> bool:
        """Attempt one step; False when all attempts failed.

        A step during which the recorder lost messages is measured again, as long as attempts
        are left.
        """
        limit = self._watch.settings.max_attempts
        first = self._next_attempt.get(index, self._run * ATTEMPTS_PER_RUN)
        self._next_attempt[index] = first + limit
        captured = False
        for number in range(limit):
            key = (index, first + number)
            if not await self._observed(key, number):
                self._watch.progress.rejected += 1
                continue
            captured = True
            if not await self._lost(key):
                break
            self._watch.progress.rejected += 1
        return captured

    async def _observed(self, key: Attempt, number: int) -> bool:
        """Order an attempt; return whether an observation came and is accepted."""
        index, attempt = key
        step = self._plan.steps[index]
        again = f" (attempt {number + 1})" if number else ""
        links = self._watch.links
        self._watch.tell(f"table position {step.table_index}, target {step.target}{again}")
        links.order(step.command(attempt))
        limit_s = self._watch.settings.step_timeout_s
        arrived = await self._watch.wait(lambda: key in links.observations, limit_s)
        return arrived and links.observations[key].accepted

    async def _lost(self, key: Attempt) -> int:
        """Wait for the receipt of an observation; return how many messages were lost."""
        receipts = self._watch.links.receipts
        limit_s = self._watch.settings.receipt_timeout_s
        if not await self._watch.wait(lambda: key in receipts, limit_s):
            reason = self._watch.health.state("recorder") or "silent"
            raise GoalError(
                Codes.RECORDER_FAILED,
                f"step {key[0]}: no receipt from the recorder within {limit_s:g} s ({reason})",
            )
        return receipts[key]
