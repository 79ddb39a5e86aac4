"""Carrying out one calibration goal, from preflight to result, as one coroutine."""

from __future__ import annotations

import time
from collections import deque

from rotcal_msgs.msg import CalibrationPlan
from rotcal_msgs.srv import FinishCalibration

from rotcal_ros.catalogue import Calibration
from rotcal_ros.catalogue.continuation import Continuation
from rotcal_ros.nodes import conversions, frames, preflight
from rotcal_ros.nodes.goal_watch import Codes, GoalError, GoalWatch
from rotcal_ros.nodes.person_asked import PersonAsked
from rotcal_ros.nodes.plan_message import run_name
from rotcal_ros.nodes.session_recording import SessionRecording
from rotcal_ros.nodes.step_measuring import StepMeasuring


class GoalRun:
    """One goal; ``person`` is who does the work that the plan pauses for."""

    def __init__(
        self, calibration: Calibration, continuation: Continuation, watch: GoalWatch
    ) -> None:
        self._calibration = calibration
        self._continuation = continuation
        self._recording = SessionRecording(watch)
        self._steps = StepMeasuring(calibration.plan, continuation.run, watch)
        self.watch = watch
        self.person = PersonAsked(calibration, continuation, watch, self._steps)

    async def execute(self) -> Codes:
        """Carry the goal out; every way to end leaves a closed bag and an explained outcome."""
        outcome = Codes()
        try:
            await preflight.check(self.watch, self._calibration.method.topics)
            await self._recording.open(self._calibration.configuration)
            await self._announce()
            await self._measure()
            answer = await self._solve()
            outcome.verdict = answer.verdict
            await self._recording.close()
            outcome.result_file = str(self._recording.keep(answer.result_json))
        except GoalError as error:
            outcome.error_code, outcome.error_msg = error.code, str(error)
            await self._recording.close_after_failure()
        if self._recording.folder is not None:
            outcome.bag_folder = str(self._recording.folder.bag)
        progress = self.watch.progress
        earlier = {o.step for o in self._continuation.observations}
        outcome.n_used = len(earlier.union(progress.accepted))
        outcome.n_rejected = progress.rejected
        outcome.skipped_steps = progress.skipped
        return outcome

    async def _announce(self) -> None:
        """Publish the plan and wait until everybody has taken it."""
        links, health = self.watch.links, self.watch.health
        configuration = self._calibration.configuration
        message = CalibrationPlan(
            header=conversions.header(links.now_ns(), frames.TABLE),
            plan_id=configuration.plan_id,
            method=configuration.method.name,
            configuration=configuration.text,
            total_steps=len(self._calibration.plan.steps),
            start_index=self._continuation.start_index,
            run=self._continuation.run,
        )
        links.announce(message)
        run = run_name(message)
        await self.watch.have(lambda: preflight.missing_plan(health, run), Codes.NODE_LOST)

    async def _measure(self) -> None:
        """Measure what is left of the plan, with a person where it needs one."""
        progress = self.watch.progress
        progress.started_s = time.monotonic()
        left = deque(self._continuation.steps)
        while left:
            pause = self._calibration.plan.pause_before(left[0])
            if pause is not None:
                await self.person.have_done(pause)
                while left and left[0] <= pause.last:
                    left.popleft()
            if pause is None or pause.last < pause.first:
                await self._steps.measure(left.popleft())
            progress.left = len(left)
        progress.step = progress.total

    async def _solve(self) -> FinishCalibration.Response:
        """Return the solver's answer, which holds a result."""
        self.watch.tell("solving")
        accepted = self.watch.progress.accepted
        request = FinishCalibration.Request(
            plan_id=self._calibration.configuration.plan_id, steps=accepted
        )
        answer = await self.watch.call(
            self.watch.links.finish_calibration, request, self.watch.settings.solve_timeout_s
        )
        if not answer.success:
            few = not accepted and not self._continuation.observations
            code = Codes.TOO_FEW_OBSERVATIONS if few else Codes.SOLVER_FAILED
            raise GoalError(code, f"no result: {answer.message}")
        return answer
