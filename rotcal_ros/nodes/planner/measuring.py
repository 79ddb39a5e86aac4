"""Measures the steps of a goal, and asks a person (or a robot) for work in between."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import count
from math import isfinite
from typing import Final

from rotcal_ros.capture.rejections import FailedSteps, TooManyFailedError
from rotcal_ros.foundation.errors import DataError, RotcalError
from rotcal_ros.foundation.language import phrase
from rotcal_ros.foundation.node_state import Reason, Why
from rotcal_ros.foundation.observations import ATTEMPTS_PER_RUN
from rotcal_ros.methods import Calibration
from rotcal_ros.methods.continuation import Continuation
from rotcal_ros.nodes.planner.cell_links import Attempt
from rotcal_ros.nodes.planner.goal_watch import Codes, GoalError, GoalWatch, StepInterruptedError
from rotcal_ros.nodes.runtime import conversions
from rotcal_ros.nodes.runtime.beat_values import BLOCKED, WAITING_FOR
from rotcal_ros.planning.choices import AS_LISTED, PolicyProgress, StepChoice, StepOutcome
from rotcal_ros.planning.plan import OperatorMove, Pause

SETTLING_S: Final = 1.2
"""After a clock is set the capture accepts nothing for 1 s; this is a little longer."""
REPEAT_PERIOD_S: Final = 2.0
"""An instruction is repeated after this time, for clients that join late."""


@dataclass
class _TriedStep:
    """A step: whether it was captured, also without a loss (``whole``), and why not so far."""

    step: int
    captured: bool = False
    whole: bool = False
    reasons: list[str] = field(default_factory=list)


class GoalMeasurement:
    """Measures the steps of one goal; no two attempts at a step have the same number.

    ``reasons`` says why attempts failed; ``operator`` asks a person for work.
    """

    def __init__(
        self, calibration: Calibration, continuation: Continuation, watch: GoalWatch
    ) -> None:
        self._calibration = calibration
        self._continuation = continuation
        self._watch = watch
        watch.progress.earlier = continuation.done
        self.operator = OperatorRequests(
            watch, calibration.configuration.plan_id, continuation.run
        )
        self._policy = calibration.policy(continuation)
        self._chosen = 0
        self._next_attempt: dict[int, int] = {}
        self._failed = FailedSteps(watch.settings.max_failed_steps)
        self.reasons: list[str] = []

    async def measure_all(self) -> None:
        """Measure what the policy chooses, until it stops."""
        progress = self._watch.progress
        progress.begin()
        made_up = self._watch.owed
        if made_up:
            await self._have_done(*made_up)
        choice = self._policy.choose()
        while choice.step is not None:
            progress.left = choice.standing.left
            progress.uncertainty, progress.goal = choice.standing.uncertainty, choice.standing.goal
            pause = self._calibration.plan.pause_before(choice.step)
            if made_up and pause is made_up[0]:
                pause = None
            if pause is not None:
                work = pause.instruction if pause.again_from is None else None
                await self._have_done(pause, work, pause.first)
            if pause is None or pause.last < pause.first:
                for step, reasons in (await self._measure(choice.step, choice)).items():
                    self._failed.note(step, reasons)
            choice = self._policy.choose()
            self._give_up(at_the_end=choice.step is None)
        self._tell(choice, 0)
        progress.uncertainty, progress.left = choice.standing.uncertainty, 0
        progress.step = progress.total

    def accepted(self) -> list[int]:
        """Return the steps that were accepted in this run."""
        return [step for step in self._watch.progress.accepted if step in self._next_attempt]

    def _give_up(self, *, at_the_end: bool) -> None:
        """Raise GoalError if too many steps failed; at the end, only if none succeeded."""
        solvable = self._watch.progress.accepted or self._continuation.observations
        try:
            self._failed.check()
        except TooManyFailedError as error:
            if not (at_the_end and solvable):
                raise GoalError(Codes.TOO_FEW_OBSERVATIONS, str(error)) from error

    def _tell(self, choice: StepChoice, attempt: int) -> None:
        """Publish which step is measured next and why; people read it, and the bag keeps it."""
        links, plan_id = self._watch.links, self._calibration.configuration.plan_id
        chosen = choice, plan_id, self._continuation.run, self._chosen, attempt
        links.publish_choice(conversions.choice_message(*chosen, links.node.now_ns()))
        self._chosen += 1

    async def _have_done(self, pause: Pause, work: str | None, begin: int) -> None:
        """Have the ``work`` of a pause done and check it, until it is good.

        The check begins with step ``begin``. A fault that the method can live with is complained
        about ``max_attempts`` times, one that makes a result impossible until the goal is
        canceled. The next run begins with unfinished work.
        """
        for times in count(1):
            self._watch.owed = pause, work, begin
            if work:
                self._place(pause.first)
                await self.operator.have_done(work, pause.move)
            self._watch.owed = pause, None, begin
            for index in range(begin, pause.last + 1):
                shows = StepChoice(
                    index, phrase("shows {0}", pause.instruction), PolicyProgress(1)
                )
                await self._measure(index, shows)
            begin = pause.first if pause.again_from is None else pause.again_from
            faults, hopeless = self._complaints()
            if not faults or (times >= self._watch.settings.max_attempts and not hopeless):
                self._watch.owed = None
                return
            work = f"not right yet: {faults}; correct it ({pause.instruction})"

    def _complaints(self) -> tuple[str, bool]:
        """Return what the observations find wrong with the work, and whether it is hopeless."""
        earlier, now = self._continuation.observations, self._watch.links.observations
        try:
            return "; ".join(self._calibration.check([*earlier, *now.values()])), False
        except DataError as error:
            return str(error), True

    async def _measure(self, index: int, choice: StepChoice) -> dict[int, list[str]]:
        """Attempt a step, and with it those that its turn passes behind it.

        If an emergency stop breaks it off, again after a person has resumed. Return for each step
        the reason of each failed attempt; nothing if it was captured.
        """
        try:
            return await self._attempt(index, choice)
        except StepInterruptedError as halted:
            self.reasons.append(str(halted))
        self._watch.progress.rejected += 1
        await self.operator.have_done()
        return await self._measure(index, choice)

    async def _attempt(self, index: int, choice: StepChoice) -> dict[int, list[str]]:
        """Attempt steps until all are captured without a loss, or all attempts are used up.

        A turn is made again as a whole, for what its lengths have in common holds for it alone.
        """
        progress, limit = self._watch.progress, self._watch.settings.max_attempts
        steps = self._calibration.plan.passed_from(index)
        start = self._continuation.run * ATTEMPTS_PER_RUN
        first = max(self._next_attempt.get(step, start) for step in steps)
        self._next_attempt |= dict.fromkeys(steps, first + limit)
        self._tell(choice, first)
        left = [_TriedStep(step) for step in steps]
        for number in range(limit):
            await self._try(left, first + number, number)
            if all(each.whole for each in left):
                break
        for tried in left:
            if not tried.captured:
                progress.note(tried.step, accepted=False)
            attempts = ((tried.step, first + number) for number in range(limit))
            accepted = self._watch.links.last_accepted(attempts)
            self._policy.note(StepOutcome(tried.step, accepted))
            self.reasons += tried.reasons
        return {tried.step: [] if tried.captured else tried.reasons for tried in left}

    async def _try(self, turn: Sequence[_TriedStep], attempt: int, number: int) -> None:
        """Order the first of the steps of a ``turn``, or one alone, and wait for all of them."""
        progress, jumps = self._watch.progress, self._watch.clock_jumps()
        await self._order(turn[0].step, attempt)
        for k, tried in enumerate(turn):
            key = (tried.step, attempt)
            self._place(tried.step)
            step = self._calibration.plan.steps[tried.step]
            self._watch.tell(Why.MEASURING, step.describe(number))
            observed = await self._observed(key)
            if self._watch.clock_jumps() != jumps:
                await self._watch.wait(lambda: False, SETTLING_S)
                tried.reasons.append("a clock was set meanwhile")
            elif observed:
                tried.whole = not await self._lost(key)
                if not tried.captured:
                    progress.note(tried.step, accepted=True)
                    progress.left = max(progress.left - 1, 0)
                tried.captured = True
            else:
                tried.reasons.append(self._reason_of_failure(key))
            progress.rejected += not tried.whole
            if self._watch.clock_jumps() != jumps or not self._goes_on(key):
                for missed in turn[k + 1 :]:
                    missed.reasons += tried.reasons[-1:]
                return

    def _goes_on(self, key: Attempt) -> bool:
        """Return whether the table has passed the angle of a step, and passes those behind it."""
        observation = self._watch.links.observations.get(key)
        return observation is not None and isfinite(observation.table_angle_measured)

    def _reason_of_failure(self, key: Attempt) -> str:
        """Return the rejection of an attempt; without an observation, what capture waits for."""
        links, limit_s = self._watch.links, self._watch.settings.step_timeout_s
        if key in links.observations:
            return links.observations[key].reason
        heard = links.health.values("capture").get(WAITING_FOR) or "the capture says nothing"
        return f"no observation within {limit_s:g} s of the order: {heard}"

    def _place(self, index: int) -> None:
        """Show the progress of the goal: the step of a list, or how many of the expected steps."""
        progress = self._watch.progress
        if self._watch.settings.policy == AS_LISTED:
            progress.step = index
        else:
            progress.step, progress.total = progress.ended, progress.ended + progress.left

    async def _order(self, index: int, attempt: int) -> None:
        """Order an attempt at a step, once no node is slow."""
        await self._watch.wait_for_slow_nodes()
        self._watch.wait_out_stop()
        self._watch.links.order(self._calibration.plan.steps[index].command(attempt))

    async def _observed(self, key: Attempt) -> bool:
        """Return whether an observation of an attempt has come and is accepted."""
        links, limit_s = self._watch.links, self._watch.settings.step_timeout_s
        arrived = await self._watch.wait_for_machine(lambda: key in links.observations, limit_s)
        return arrived and links.observations[key].accepted

    async def _lost(self, key: Attempt) -> int:
        """Wait for the receipt of an observation; return how many messages were lost."""
        receipts = self._watch.links.receipts
        limit_s = self._watch.settings.receipt_timeout_s
        if not await self._watch.wait(lambda: key in receipts, limit_s):
            reason = self._watch.links.health.describe("recorder")
            place = self._calibration.plan.steps[key[0]].describe()
            raise GoalError(
                Codes.RECORDER_FAILED,
                f"{place}: no receipt from the recorder within {limit_s:g} s ({reason}); look at "
                "its log and its disk",
            )
        return receipts[key]


class NotResumableError(RotcalError):
    """A goal that waits for a person cannot go on yet."""


class OperatorRequests:
    """Pauses the goal of a ``watch`` while a person has to do something."""

    def __init__(self, watch: GoalWatch, plan_id: str, run: int) -> None:
        self._watch, self._plan_id, self._run = watch, plan_id, run

    async def have_done(self, work: str | None = None, move: OperatorMove | None = None) -> None:
        """Show what is to be done before the present step, until it is done.

        An emergency stop may come in between; without ``work`` only its end is waited for.
        """
        watch, pauses, stop = self._watch, self._watch.pauses, self._watch.stop
        watch.progress.pause()
        pauses.begin(self._plan_id, self._run, watch.progress.step, stop.count)
        try:
            while pauses.waiting:
                seen = stop.why, stop.latched
                asked = operator_request(*seen, work)
                pauses.show(asked, move)
                watch.tell_again(asked)
                await watch.wait(partial(self._has_changed, seen), REPEAT_PERIOD_S)
            stop.forget()
        finally:
            pauses.end()
            watch.progress.go_on()

    def _has_changed(self, seen: tuple[str | None, str | None]) -> bool:
        """Return whether a person has answered, or the stop has changed since it was ``seen``."""
        stop = self._watch.stop
        return not self._watch.pauses.waiting or (stop.why, stop.latched) != seen


def require_resumable(watch: GoalWatch) -> None:
    """Raise NotResumableError if a goal cannot be resumed yet."""
    health = watch.links.health
    watch.stop.check_stop()
    stop = [f"the emergency stop is on: {watch.stop.why}"] if watch.stop.why else []
    blocked = [
        f"node {name} waits for a person: {text}"
        for name in sorted(health.present())
        if (text := health.values(name).get(BLOCKED))
    ]
    silent = [f"{t} has been silent for {s:.1f} s" for t, s in watch.silent_streams().items()]
    if lasting := [*stop, *blocked, *silent]:
        raise NotResumableError("; ".join(lasting))
    if watch.pauses.stop_between(watch.stop.count):
        raise NotResumableError("an emergency stop came in between: look, then resume again")


def operator_request(why: str | None, latched: str | None, work: str | None) -> Reason:
    """Return what a person has to do during a stop ``why``, once it is over, or as ``work``."""
    if why:
        return Reason.of(Why.STOPPED, why)
    if latched and work:
        return Reason.of(Why.RELEASED_AND_WORK, latched, work)
    return Reason.of(Why.RELEASED, latched) if latched else Reason.of(Why.WORK, work or "")
