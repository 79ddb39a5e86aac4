"""Carrying out one calibration goal, from preflight to result, as one coroutine."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Final

from rotcal_msgs.msg import CalibrationPlan
from rotcal_msgs.srv import FinishCalibration, StartRecording, StopRecording

from rotcal_ros.capture.rejections import Commonest
from rotcal_ros.catalogue import Calibration
from rotcal_ros.catalogue.continuation import Continuation
from rotcal_ros.files import write_atomically
from rotcal_ros.instruments.conventions import single_shots
from rotcal_ros.node_names import PREFLIGHT_NODES, VIEWERS
from rotcal_ros.nodes import conversions
from rotcal_ros.nodes.cell_node import until
from rotcal_ros.nodes.concerns import OF_MACHINES, PREFLIGHT, concerns_told
from rotcal_ros.nodes.goal_watch import Codes, GoalError, GoalWatch
from rotcal_ros.nodes.measuring import Measuring
from rotcal_ros.nodes.plans import RUN, run_name
from rotcal_ros.nodes.preflight import doubts, expected_air, faults, without_air
from rotcal_ros.nodes.sim_clock import unlike_clocks
from rotcal_ros.nodes.topic_names import TOPICS, names_at_odds, topics_value
from rotcal_ros.session_folder import SessionFolder

BAG_TIMEOUT_S: Final = 10.0


class GoalRun:
    """One goal; ``measuring`` pauses where a person has to work.

    ``verdict_line`` is what people read of the result, empty before there is one.
    """

    def __init__(
        self, calibration: Calibration, continuation: Continuation, watch: GoalWatch
    ) -> None:
        self._calibration = calibration
        self._continuation = continuation
        self._folder: SessionFolder | None = None
        self._bag_is_open = False
        self.verdict_line = ""
        self._run = ""
        self.watch = watch
        self.measuring = Measuring(calibration, continuation, watch)

    async def execute(self) -> Codes:
        """Carry the goal out; every way to end leaves a closed bag and an explained outcome."""
        outcome = Codes()
        try:
            await self._preflight()
            folder = self._folder = await self._open_bag()
            await self._announce()
            await self.measuring.measure_all()
            answer = await self._solve()
            outcome.verdict = answer.verdict
            self.verdict_line = json.loads(answer.result_json)["verdict_line"]
            await self._close_bag()
            outcome.result_file = _keep(answer.result_json, folder.result)
        except GoalError as error:
            begun = self._folder is not None or error.code == Codes.CANCELED
            onward = self.watch.how_to_go_on(error.code) if begun else ""
            outcome.error_code = error.code
            outcome.error_msg = f"{error}{self._remarks(error)}{onward}"
            await self._close_bag_after_failure()
        if self._folder is not None:
            outcome.bag_folder = str(self._folder.bag)
        progress = self.watch.progress
        earlier = {o.step for o in self._continuation.observations}
        outcome.n_used = len(earlier.union(progress.accepted))
        outcome.n_rejected = progress.rejected
        outcome.skipped_steps = progress.skipped
        return outcome

    def values(self) -> dict[str, object]:
        """Return what the planner tells of the goal in its beat."""
        progress = self.watch.progress
        own: dict[str, object] = {
            "accepted": len(progress.accepted),
            "rejected": progress.rejected,
            TOPICS: topics_value(self._calibration.configuration),
        }
        return {RUN: self._run, **own} if self._run else own

    def _remarks(self, error: GoalError) -> str:
        """Return what the cell says that may be why the goal has ended."""
        health = self.watch.links.health
        causes = (f"; {t}" for t in concerns_told(health, OF_MACHINES) if t not in str(error))
        return "" if error.code == Codes.CANCELED else health.sim.remark() + "".join(causes)

    async def _preflight(self) -> None:
        """Wait for all nodes and topics; GoalError names what is missing after the time for it."""
        watch, links = self.watch, self.watch.links
        configuration, topics = self._calibration.configuration, self._calibration.method.topics
        needed, wished = expected_air(self._calibration)

        def missing() -> list[str]:
            if odd := names_at_odds(links.node, topics_value(configuration)):
                return odd
            air = [f"nobody publishes {name}, without which the index of refraction is unknown"
                   for name in links.missing_air(needed).values()]  # fmt: skip
            wrong = faults(links.health.values("capture"), configuration, self._calibration.plan)
            silent = single_shots(configuration.topics)
            return links.missing_topics(topics, silent) + air + wrong

        links.forget()
        watch.tell("preflight: nodes")
        await watch.have(links.missing_nodes, Codes.NODE_LOST)
        watch.nodes = (links.health.present() | set(PREFLIGHT_NODES)) - {*VIEWERS}
        watch.tell("preflight: clocks")
        await watch.have(lambda: unlike_clocks(links.health, configuration), Codes.TOPIC_MISSING)
        watch.tell("preflight: topics")
        await watch.have(missing, Codes.TOPIC_MISSING)
        unheard = [without_air(role, name, configuration)
                   for role, name in links.missing_air(wished).items()]  # fmt: skip
        links.warn(PREFLIGHT, unheard + doubts(links.health.values("capture"), configuration))
        watch.nodes |= links.health.present()
        watch.nodes -= set(VIEWERS.values())

    async def _open_bag(self) -> SessionFolder:
        """Have the recorder open a new session folder with a bag."""
        self.watch.tell("opening the bag")
        configuration = self._calibration.configuration
        request = StartRecording.Request(
            plan_id=configuration.plan_id, configuration=configuration.text
        )
        answer = await self._recorder_did(self.watch.links.start_recording, request)
        self._bag_is_open = self.watch.recording = True
        return SessionFolder(Path(answer.folder))

    async def _close_bag(self) -> None:
        self.watch.tell("closing the bag")
        self._bag_is_open = self.watch.recording = False
        await self._recorder_did(self.watch.links.stop_recording, StopRecording.Request())

    async def _recorder_did(self, client: Any, request: Any) -> Any:
        """Return the answer of the recorder; GoalError when it could not do it."""
        answer = await self.watch.call(client, request, BAG_TIMEOUT_S)
        if not answer.success:
            raise GoalError(Codes.RECORDER_FAILED, answer.message)
        return answer

    async def _close_bag_after_failure(self) -> None:
        """Close the bag if the recorder still lives; a dead one left whole chunks behind."""
        links = self.watch.links
        if self._bag_is_open and not links.health.missing(["recorder"]):
            future = links.stop_recording.call_async(StopRecording.Request())
            await until(
                lambda: future.done() or bool(links.health.missing(["recorder"])), BAG_TIMEOUT_S
            )

    async def _announce(self) -> None:
        """Publish the plan and wait until everybody has taken it."""
        links, configuration = self.watch.links, self._calibration.configuration
        message = CalibrationPlan(
            header=conversions.header(links.node.now_ns()),
            plan_id=configuration.plan_id,
            method=configuration.method.name,
            configuration=configuration.text,
            total_steps=len(self._calibration.plan.steps),
            start_index=self._continuation.start_index,
            run=self._continuation.run,
        )
        run = self._run = run_name(message)
        links.health.beat()  # it vouches for the plan
        links.announce(message)
        await self.watch.have(lambda: links.missing_plan(run), Codes.NODE_LOST)
        self.watch.run = run

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
            why = Commonest.of(self.measuring.reasons)
            more = f"; rejected: {why.in_words()}" if why else ""
            raise GoalError(code, f"no result: {answer.message}{more}")
        return answer


def _keep(result_json: str, path: Path) -> str:
    """Write the result into the session folder and return its path."""
    try:
        write_atomically(path, result_json)
    except OSError as error:
        raise GoalError(Codes.RECORDER_FAILED, f"cannot write {path}: {error}") from error
    return str(path)
