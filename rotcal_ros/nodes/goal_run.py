"""Carrying out one calibration goal, from preflight to result, as one coroutine."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from itertools import count
from pathlib import Path
from typing import Any, Final, TypeAlias

from rotcal_msgs.action import Calibrate
from rotcal_msgs.msg import CalibrationPlan
from rotcal_msgs.srv import FinishCalibration, StartRecording, StopRecording

from rotcal_ros.catalogue import Calibration
from rotcal_ros.catalogue.continuation import ATTEMPTS_PER_RUN, Continuation
from rotcal_ros.errors import DataError
from rotcal_ros.files import write_atomically
from rotcal_ros.nodes import conversions, preflight
from rotcal_ros.nodes.cell_links import TABLE_FRAME, CellLinks
from rotcal_ros.nodes.health import Health
from rotcal_ros.nodes.progress import Progress
from rotcal_ros.nodes.waiting import until
from rotcal_ros.planning.plan import PAUSED, Pause
from rotcal_ros.planning.planner_settings import PlannerSettings

Outcome: TypeAlias = Calibrate.Result
CLOSE_TIMEOUT_S: Final = 10.0
RETELL_PERIOD_S: Final = 2.0
"""An instruction is told again after this time, for clients that come late."""
BAG: Final = "bag"
"""Folder of the bag inside the session folder."""
FAILED: Final = "recording failed"
"""How the state of a recorder begins that cannot write any more."""


class GoalError(Exception):
    """The goal cannot go on; ``code`` is an error code of the action."""

    def __init__(self, code: int, text: str) -> None:
        super().__init__(text)
        self.code = code


class GoalRun:
    """One goal. ``show`` is called with every progress; ``canceled`` tells of a cancel request."""

    def __init__(
        self,
        calibration: Calibration,
        settings: PlannerSettings,
        links: CellLinks,
        health: Health,
        *,
        continuation: Continuation,
        show: Callable[[Progress], None],
        canceled: Callable[[], bool],
    ) -> None:
        self._calibration = calibration
        self._settings = settings
        self._links = links
        self._health = health
        self._continuation = continuation
        self._show = show
        self._canceled = canceled
        self._watched: set[str] = set()
        self._stream_beat: object = None
        self._session = Path()
        self._next_attempt: dict[int, int] = {}
        self.stopping = ""
        self.paused = False
        self.progress = Progress(
            total=len(calibration.plan.steps),
            step=continuation.start_index,
            left=len(continuation.steps),
        )
        self.outcome = Outcome()

    async def execute(self) -> Outcome:
        """Carry the goal out; every way to end leaves a closed bag and an explained outcome."""
        recording = False
        try:
            await self._preflight()
            await self._start_recording()
            recording = True
            await self._announce()
            await self._measure()
            result_json = await self._solve()
            recording = False
            await self._stop_recording()
            self._write(result_json)
        except GoalError as error:
            self.outcome.error_code, self.outcome.error_msg = error.code, str(error)
        if recording:
            await self._close_after_failure()
        progress = self.progress
        earlier = {o.step for o in self._continuation.observations}
        self.outcome.n_used = len(earlier.union(progress.accepted))
        self.outcome.n_rejected = progress.rejected
        self.outcome.skipped_steps = progress.skipped
        return self.outcome

    async def _preflight(self) -> None:
        self._tell("preflight: nodes")
        self._links.forget()
        topics = self._calibration.method.topics
        await self._have(
            lambda: preflight.missing_nodes(self._links, self._health), Outcome.NODE_LOST
        )
        self._watched = self._health.present() | set(preflight.NODES)
        self._tell("preflight: topics")
        await self._have(
            lambda: preflight.missing_topics(self._links, self._health, topics),
            Outcome.TOPIC_MISSING,
        )
        self._watched |= self._health.present()

    async def _start_recording(self) -> None:
        self._tell("opening the bag")
        configuration = self._calibration.configuration
        request = StartRecording.Request(
            plan_id=configuration.plan_id, configuration=configuration.text
        )
        answer = await self._call(self._links.start_recording, request, CLOSE_TIMEOUT_S)
        if not answer.success:
            raise GoalError(Outcome.RECORDER_FAILED, answer.message)
        self._session = Path(answer.folder)
        self.outcome.bag_folder = str(self._session / BAG)

    async def _announce(self) -> None:
        now_ns = self._links.now_ns()
        configuration = self._calibration.configuration
        self._links.announce(
            CalibrationPlan(
                header=conversions.header(now_ns, TABLE_FRAME),
                plan_id=configuration.plan_id,
                method=configuration.method.name,
                configuration=configuration.text,
                total_steps=self.progress.total,
                start_index=self._continuation.start_index,
                run=self._continuation.run,
            )
        )
        run = f"{configuration.plan_id}@{now_ns}"
        await self._have(lambda: preflight.missing_plan(self._health, run), Outcome.NODE_LOST)

    async def _measure(self) -> None:
        progress = self.progress
        progress.started_s = time.monotonic()
        left = deque(self._continuation.steps)
        while left:
            pause = self._calibration.plan.pause_before(left[0])
            if pause is not None:
                await self._have_set_up(pause)
                while left and left[0] <= pause.last:
                    left.popleft()
            if pause is None or pause.last < pause.first:
                await self._measure_step(left.popleft())
            progress.left = len(left)
        progress.step = progress.total

    async def _have_set_up(self, pause: Pause) -> None:
        """Have a person do the work of a pause and check it, again and again until it is good.

        What the method can live with is asked for ``max_attempts`` times, what makes a result
        impossible until the goal is canceled.
        """
        text = pause.instruction
        for asked in count(1):
            await self._ask(pause, text)
            for index in range(pause.first, pause.last + 1):
                await self._measure_step(index)
            found, hopeless = self._complaints()
            if not found or (asked >= self._settings.max_attempts and not hopeless):
                return
            text = f"not as it should be: {found}; put it right ({pause.instruction})"

    async def _ask(self, pause: Pause, text: str) -> None:
        """Tell a person what to do and wait for ``resume``, as long as it takes."""
        asked_s = time.monotonic()
        self.progress.step = pause.first
        self.paused = True
        try:
            while self.paused:
                self._tell(PAUSED + text)
                await self._wait(lambda: not self.paused, RETELL_PERIOD_S)
        finally:
            self.paused = False
        self.progress.started_s += time.monotonic() - asked_s

    def _complaints(self) -> tuple[str, bool]:
        """Return what the observations so far say against a person's work; fatal or not."""
        observations = [*self._continuation.observations, *self._links.observations.values()]
        try:
            return "; ".join(self._calibration.check(observations)), False
        except DataError as error:
            return str(error), True

    async def _measure_step(self, index: int) -> None:
        self.progress.step = index
        self.progress.note(index, accepted=await self._step(index))

    async def _step(self, index: int) -> bool:
        """Measure one step; False when all attempts failed.

        A step during which the recorder lost messages is measured again, as long as attempts
        are left.
        """
        step = self._calibration.plan.steps[index]
        limits = self._settings
        first = self._next_attempt.get(index, self._continuation.run * ATTEMPTS_PER_RUN)
        self._next_attempt[index] = first + limits.max_attempts
        captured = False
        for attempt in range(first, first + limits.max_attempts):
            key = (index, attempt)
            again = f" (attempt {attempt - first + 1})" if attempt > first else ""
            self._tell(f"table position {step.table_index}, target {step.target}{again}")
            self._links.order(step.command(attempt))
            arrived = await self._wait(
                lambda key=key: key in self._links.observations,  # type: ignore[misc]
                limits.step_timeout_s,
            )
            if not arrived or not self._links.observations[key].accepted:
                self.progress.rejected += 1
                continue
            if not await self._wait(
                lambda key=key: key in self._links.receipts,  # type: ignore[misc]
                limits.receipt_timeout_s,
            ):
                reason = self._health.state("recorder") or "silent"
                raise GoalError(
                    Outcome.RECORDER_FAILED,
                    f"step {index}: no receipt from the recorder within "
                    f"{limits.receipt_timeout_s:g} s ({reason})",
                )
            captured = True
            if not self._links.receipts[key]:
                break
            self.progress.rejected += 1
        return captured

    async def _solve(self) -> str:
        """Return the result in JSON form."""
        self._tell("solving")
        request = FinishCalibration.Request(
            plan_id=self._calibration.configuration.plan_id, steps=self.progress.accepted
        )
        answer = await self._call(
            self._links.finish_calibration, request, self._settings.solve_timeout_s
        )
        if not answer.success:
            few = not self.progress.accepted and not self._continuation.observations
            code = Outcome.TOO_FEW_OBSERVATIONS if few else Outcome.SOLVER_FAILED
            raise GoalError(code, f"no result: {answer.message}")
        self.outcome.verdict = answer.verdict
        text: str = answer.result_json
        return text

    async def _stop_recording(self) -> None:
        self._tell("closing the bag")
        answer = await self._call(
            self._links.stop_recording, StopRecording.Request(), CLOSE_TIMEOUT_S
        )
        if not answer.success:
            raise GoalError(Outcome.RECORDER_FAILED, answer.message)

    async def _close_after_failure(self) -> None:
        """Close the bag if the recorder still lives; a dead one left whole chunks behind."""
        if self._health.missing(["recorder"]):
            return
        future = self._links.stop_recording.call_async(StopRecording.Request())
        await until(
            lambda: future.done() or bool(self._health.missing(["recorder"])), CLOSE_TIMEOUT_S
        )

    def _write(self, result_json: str) -> None:
        path = self._session / "result.json"
        try:
            write_atomically(path, result_json)
        except OSError as error:
            raise GoalError(Outcome.RECORDER_FAILED, f"cannot write {path}: {error}") from error
        self.outcome.result_file = str(path)

    async def _have(self, missing: Callable[[], list[str]], code: int) -> None:
        """Wait until nothing is missing; after the preflight time raise what still is."""
        if not await self._wait(lambda: not missing(), self._settings.preflight_timeout_s):
            raise GoalError(code, "; ".join(missing()) or "preflight timed out")

    async def _wait(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        return await until(condition, timeout_s, self._check)

    async def _call(self, client: Any, request: Any, timeout_s: float) -> Any:
        future = client.call_async(request)
        if not await self._wait(future.done, timeout_s):
            raise GoalError(
                Outcome.NODE_LOST, f"{client.srv_name} gave no answer in {timeout_s:g} s"
            )
        return future.result()

    def _check(self) -> None:
        """Raise when the goal must end: cancel, shutdown, a node or an instrument lost."""
        place = f"at step {self.progress.step} of {self.progress.total}"
        if self.stopping:
            raise GoalError(Outcome.CANCELED, f"{self.stopping} {place}")
        if self._canceled():
            raise GoalError(
                Outcome.CANCELED,
                f"canceled {place}; continue with start_index {self.progress.step}",
            )
        if missing := self._health.missing(self._watched):
            how = "fell silent" if set(missing) & self._health.lost else "was ended"
            raise GoalError(Outcome.NODE_LOST, f"node {', '.join(missing)} {how} {place}")
        if self.outcome.bag_folder:
            self._check_recorder(place)
            self._check_streams(place)

    def _check_recorder(self, place: str) -> None:
        """Raise when the recorder tells of a failing disk."""
        if self._health.state("recorder").startswith(FAILED):
            raise GoalError(Outcome.RECORDER_FAILED, f"{self._health.state('recorder')}, {place}")

    def _check_streams(self, place: str) -> None:
        """Raise when the capture tells of an instrument that fell silent after it had spoken."""
        beat = self._health.others.get("capture")
        if beat is self._stream_beat:
            return
        self._stream_beat = beat
        for key, value in self._health.values("capture").items():
            if key.startswith("silent_s.") and float(value) > self._settings.stream_timeout_s:
                topic = key.removeprefix("silent_s.")
                publishers = ", ".join(self._links.publishers(topic)) or "gone"
                raise GoalError(
                    Outcome.NODE_LOST,
                    f"{self._links.resolve(topic)} (node {publishers}) has been silent for "
                    f"{value} s {place}",
                )

    def _tell(self, activity: str) -> None:
        self.progress.activity = activity
        self._show(self.progress)
