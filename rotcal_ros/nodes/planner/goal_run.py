"""One calibration goal as one coroutine, from preflight to result.

``be_ready`` waits until all nodes and instruments are there and fit the configuration. GoalBag has
the recorder open, continue and close the bag. GoalRun does all of it, in several runs of the same
session if a node is lost and comes back.
"""

from __future__ import annotations

import json
import math
from functools import partial
from pathlib import Path
from typing import Any, Final

from rotcal_msgs.msg import CalibrationPlan
from rotcal_msgs.srv import FinishCalibration, StartRecording, StopRecording
from std_srvs.srv import Trigger

from rotcal_ros.capture.instruments.conventions import single_shots
from rotcal_ros.capture.publishers import RUN, PublisherList, run_name
from rotcal_ros.capture.rejections import MostFrequentReason
from rotcal_ros.foundation.errors import DataError, RotcalError
from rotcal_ros.foundation.files import write_atomically
from rotcal_ros.foundation.node_names import PREFLIGHT_NODES, VIEWERS
from rotcal_ros.foundation.node_state import Why
from rotcal_ros.foundation.session_folder import SessionFolder
from rotcal_ros.methods import Calibration, Configuration
from rotcal_ros.methods.continuation import Continuation, Recorded
from rotcal_ros.nodes.planner.cell_links import CellLinks
from rotcal_ros.nodes.planner.goal_watch import SOLVER, Codes, GoalError, GoalWatch
from rotcal_ros.nodes.planner.measuring import GoalMeasurement, OperatorRequests
from rotcal_ros.nodes.planner.preflight import doubts, expected_air, faults, without_air
from rotcal_ros.nodes.runtime import conversions
from rotcal_ros.nodes.runtime.accepted_publishers import ACCEPTED
from rotcal_ros.nodes.runtime.beat_values import (
    OF_MACHINES,
    PREFLIGHT,
    TOPICS,
    names_at_odds,
    topics_value,
    warnings_told,
)
from rotcal_ros.nodes.runtime.cell_node import until
from rotcal_ros.nodes.runtime.clocks import unlike_clocks

MOST_IN_VAIN: Final = 2
"""When nodes are lost, this many runs in succession may end without a newly accepted step."""
BAG_TIMEOUT_S: Final = 10.0
OPEN_TIMEOUT_S: Final = 120.0
"""Before it continues, the recorder reads what the earlier runs have recorded."""
LAST_TIMEOUT_S: Final = 2.0
"""The bag stays open this long for observations that are still on their way to the recorder."""


class GoalRun:
    """One goal; ``verdict_line`` is the verdict of its result in words, empty before that."""

    def __init__(
        self, calibration: Calibration, continuation: Continuation, watch: GoalWatch
    ) -> None:
        self._calibration = calibration
        self._continuation = continuation
        self.bag = GoalBag(calibration.configuration, watch)
        self._goes_on = continuation.run == 0 and continuation.start_index > 0
        self._from_step = continuation.start_index
        self._lost: GoalError | None = None
        self.verdict_line = ""
        self._run: str | None = None
        self._accepted = PublisherList()
        self.watch = watch
        self.measuring = GoalMeasurement(calibration, continuation, watch)

    async def execute(self) -> Codes:
        """Carry out the goal; however it ends, the bag is closed and the outcome explained."""
        outcome = Codes()
        try:
            answer = await self._solved()
            outcome.verdict = answer.verdict
            self.verdict_line = json.loads(answer.result_json)["verdict_line"]
            outcome.result_file = self.bag.keep_result(answer.result_json)
        except GoalError as error:
            begun = self.bag.folder is not None or error.code == Codes.CANCELED
            onward = self.watch.how_to_go_on(error.code, self.bag.folder) if begun else ""
            outcome.error_code = error.code
            outcome.error_msg = "; ".join([str(error), *self._likely_causes(error)]) + onward
            await self.bag.close_after_failure()
        finally:
            self._accepted = PublisherList()
            self.watch.links.node.accepted.decide(self._accepted)
        if self.bag.folder is not None:
            outcome.bag_folder = str(self.bag.folder.bag)
        progress = self.watch.progress
        outcome.n_used = len(self._continuation.done.union(progress.accepted))
        outcome.n_rejected = progress.rejected
        outcome.skipped_steps = progress.skipped
        return outcome

    async def _solved(self) -> FinishCalibration.Response:
        """Return the solver's answer; each loss of a node may require another run."""
        in_vain = 0
        while True:
            before = len(self.watch.progress.accepted)
            try:
                return await self._solved_in_one_run()
            except GoalError as error:
                in_vain = in_vain + 1 if len(self.watch.progress.accepted) == before else 0
                waits = error.in_another_run and self.watch.required.restart_wait_s > 0.0
                if not waits or in_vain > MOST_IN_VAIN:
                    raise
                self._begin_anew(error)

    async def _solved_in_one_run(self) -> FinishCalibration.Response:
        try:
            await be_ready(self._calibration, self.watch, self.measuring.operator)
        except GoalError as error:
            of_a_person = error.code in (Codes.CANCELED, Codes.EMERGENCY_STOP)
            if self._lost is None or of_a_person or error.in_another_run:
                raise
            text = f"{self._lost}; did not come back in time: {error}"
            raise GoalError(self._lost.code, text) from error
        await self.bag.open(goes_on=self._goes_on)
        if self._goes_on:
            await self._go_on()
        await self._announce()
        await self.measuring.measure_all()
        answer = await self._solve()
        await self.bag.close()
        return answer

    def _begin_anew(self, lost: GoalError) -> None:
        """Go on in another run of the same session, as soon as all nodes are back."""
        self._lost = lost
        self._goes_on = self._goes_on or self.bag.folder is not None
        self.watch.progress.pause()
        self.watch.end_run(self.watch.required.restart_wait_s)
        self.watch.links.node.get_logger().warning(f"{lost}: the goal waits for it and goes on")

    def values(self) -> dict[str, object]:
        """Return the values of the planner's beat that describe the goal."""
        heard: dict[str, object] = {ACCEPTED: line} if (line := self._accepted.in_a_beat()) else {}
        own: dict[str, object] = {**self.watch.progress.counts(), **heard}
        own[TOPICS] = topics_value(self._calibration.configuration)
        return {RUN: self._run, **own} if self._run else own

    async def _fix_publishers(self) -> None:
        """Make the present publishers those of the run, and wait until all nodes know them."""
        await self._accept_publishers()
        if not await self.watch.is_found(self._missing_connections):
            await self._accept_publishers()
            await self.watch.have(self._missing_connections, Codes.NODE_LOST)

    async def _accept_publishers(self) -> None:
        """Accept the present publishers, and tell all nodes at once in a beat."""
        links, watch = self.watch.links, self.watch
        instruments = self._calibration.topics
        await watch.have(lambda: links.unclear(instruments), Codes.TOPIC_MISSING)
        needed, wished = expected_air(self._calibration)
        watch.instruments = {*instruments, *needed, *wished}
        watch.heard = links.offered(watch.instruments)
        self._accepted = links.accepted(watch.instruments)
        links.node.accepted.decide(self._accepted)
        links.health.beat()

    def _missing_connections(self) -> list[str]:
        return self.watch.links.missing_connections(self._accepted)

    def _likely_causes(self, error: GoalError) -> list[str]:
        """Return warnings of the cell that may have ended the goal; none where a person did."""
        if error.code == Codes.CANCELED:
            return []
        health = self.watch.links.health
        beside = [text for text in warnings_told(health, OF_MACHINES) if text not in str(error)]
        clock = health.sim.remark()
        return beside if clock is None else [clock, *beside]

    async def _go_on(self) -> None:
        """Measure what is left, to be joined with what earlier runs recorded."""
        recorded = await self.bag.recorded()
        try:
            left = self._calibration.continued(
                recorded.run, recorded.observations, self._from_step
            )
            self.measuring = GoalMeasurement(self._calibration, left, self.watch)
        except RotcalError as error:
            raise GoalError(Codes.BAD_CONFIGURATION, str(error)) from error
        self._continuation, self.watch.progress.left = left, len(left.steps)
        self.watch.links.node.get_logger().info(self._calibration.left_in_words(left))

    async def _announce(self) -> None:
        """Publish the plan and wait until all nodes have taken it."""
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
        await self._fix_publishers()
        run = self._run = run_name(message)
        links.health.beat()  # names the run: without it the others ignore the plan
        links.announce(message)
        await self.watch.have(
            lambda: links.missing_plan(run), Codes.NODE_LOST, lambda: links.refused_plan(run)
        )
        self.watch.begin_run(run)

    async def _solve(self) -> FinishCalibration.Response:
        """Return the solver's answer with a result; a restarted solver is asked again."""
        watch = self.watch
        watch.tell(Why.SOLVING)
        request = FinishCalibration.Request(
            plan_id=self._calibration.configuration.plan_id, steps=self.measuring.accepted()
        )
        answer = None
        while answer is None:
            # without a limit of its own: the watch knows how long a solver may be away
            await watch.wait(lambda: not watch.links.missing_plan(watch.run), math.inf)
            answer = await watch.call(
                watch.links.services.finish_calibration,
                request,
                watch.settings.solve_timeout_s,
                in_vain=watch.required.is_another(SOLVER),
            )
        if not answer.success:
            few = not watch.progress.accepted and not self._continuation.observations
            code = Codes.TOO_FEW_OBSERVATIONS if few else Codes.SOLVER_FAILED
            most_frequent = MostFrequentReason.of(self.measuring.reasons)
            more = f"; rejected: {most_frequent.describe()}" if most_frequent else ""
            raise GoalError(code, f"no result: {answer.message}{more}")
        return answer


class GoalBag:
    """The bag of a goal; ``folder`` is that of the session, None before there is one."""

    def __init__(self, configuration: Configuration, watch: GoalWatch) -> None:
        self._configuration = configuration
        self._watch, self._services = watch, watch.links.services
        self._is_open = False
        self.folder: SessionFolder | None = None

    async def open(self, *, goes_on: bool) -> None:
        """Have the recorder open a bag, of a new session or of the next run of the last one."""
        self._watch.tell(Why.OPENING_BAG)
        request = StartRecording.Request(
            plan_id=self._configuration.plan_id, configuration=self._configuration.text
        )
        if not goes_on:
            await self.close_after_failure()  # of a run that was lost before it had begun
        client = self._services.continue_recording if goes_on else self._services.start_recording
        self._is_open = True  # or soon: a cancel does not wait for the answer
        answer = await self._recorder_did(client, request, OPEN_TIMEOUT_S)
        self._watch.recording = True
        self.folder = SessionFolder(Path(answer.folder))

    async def recorded(self) -> Recorded:
        """Return what the recorder has of the session, including earlier runs."""
        asked = self._services.recorded_observations
        answer = await self._recorder_did(asked, Trigger.Request(), OPEN_TIMEOUT_S)
        try:
            return Recorded.from_json(answer.message)
        except DataError as error:
            raise GoalError(Codes.RECORDER_FAILED, str(error)) from error

    async def close(self) -> None:
        """Have the recorder close the bag."""
        self._watch.tell(Why.CLOSING_BAG)
        await self._have_all_recorded()
        self._is_open = self._watch.recording = False
        await self._recorder_did(
            self._services.stop_recording, StopRecording.Request(), BAG_TIMEOUT_S
        )

    async def close_after_failure(self) -> None:
        """Close the bag if the recorder still lives; a dead one has left whole chunks behind."""
        health = self._watch.links.health
        if self._is_open and not health.missing(["recorder"]):
            await self._have_all_recorded()
            future = self._services.stop_recording.call_async(StopRecording.Request())
            await until(lambda: future.done() or bool(health.missing(["recorder"])), BAG_TIMEOUT_S)

    async def _have_all_recorded(self) -> None:
        """Wait until the recorder has confirmed all observations, rejected ones too."""
        links = self._watch.links
        await until(
            lambda: (
                links.observations.keys() <= links.receipts.keys()
                or bool(links.health.missing(["recorder"]))
            ),
            LAST_TIMEOUT_S,
        )

    def keep_result(self, result_json: str) -> str:
        """Write the result into the session folder and return its path."""
        assert self.folder is not None
        path = self.folder.result
        try:
            write_atomically(path, result_json)
        except OSError as error:
            raise GoalError(
                Codes.RECORDER_FAILED, f"cannot write {path}: {error}; make room"
            ) from error
        return str(path)

    async def _recorder_did(self, client: Any, request: Any, timeout_s: float) -> Any:
        """Return the answer of the recorder; GoalError when it could not do it."""
        answer = await self._watch.call(client, request, timeout_s)
        if not answer.success:
            raise GoalError(Codes.RECORDER_FAILED, answer.message)
        return answer


async def be_ready(calibration: Calibration, watch: GoalWatch, operator: OperatorRequests) -> None:
    """Wait for all nodes and topics; after the time limit GoalError names what is missing."""
    links, configuration = watch.links, calibration.configuration
    links.forget()
    if watch.preflight:  # a later one, after a lost node, hears of a stop in between
        watch.stop.forget()
    watch.tell(Why.PREFLIGHT_NODES)
    await watch.have(links.missing_nodes, Codes.NODE_LOST, in_vain=links.other_versions)
    nodes = watch.required.nodes = watch.required.nodes | _needed(links)
    watch.tell(Why.PREFLIGHT_CLOCKS)
    await watch.have(lambda: unlike_clocks(links.health, configuration), Codes.TOPIC_MISSING)
    watch.tell(Why.PREFLIGHT_TOPICS)
    await _have_topics(calibration, watch, operator)
    _, wished = expected_air(calibration)
    unheard = [
        without_air(role, name, configuration) for role, name in links.unpublished(wished).items()
    ]
    links.warn(
        PREFLIGHT, unheard + doubts(links.health.values("capture"), configuration, calibration)
    )
    watch.required.nodes = nodes | _needed(links)
    watch.refuse_stop()
    watch.preflight = False


def _needed(links: CellLinks) -> set[str]:
    """Return the nodes of the suite and all others present, except those that only show."""
    return (links.health.present() | set(PREFLIGHT_NODES)) - {*VIEWERS.values()}


async def _have_topics(
    calibration: Calibration, watch: GoalWatch, operator: OperatorRequests
) -> None:
    """Wait for the topics, after a person has resumed from a stop that broke the run off.

    Instruments may be silent meanwhile, and a restarted capture has heard nothing.
    """
    missing, links = partial(_missing, calibration, watch.links), watch.links
    if watch.preflight:  # a second publisher that is found only in the run would be a stranger
        roles, publishers = calibration.topics, links.graph.publishers
        await watch.stands_still(lambda: [publishers(links.instrument(r)) for r in roles])
    # What is missing may be there but undiscovered; what is not there is waited for below.
    await watch.is_found(
        lambda: [] if _halted(watch) or links.other_versions(calibration.topics) else missing()
    )
    while True:
        await watch.have(
            lambda: [] if _halted(watch) else missing(), Codes.TOPIC_MISSING,
            in_vain=lambda: links.other_versions(calibration.topics),
        )  # fmt: skip
        if not _halted(watch):
            return
        await operator.have_done()


def _halted(watch: GoalWatch) -> bool:
    """Return whether a person has to resume after an emergency stop; not in a first preflight."""
    return not watch.preflight and bool(watch.stop.heed())


def _missing(calibration: Calibration, links: CellLinks) -> list[str]:
    """Return what is missing or wrong with the topics, in words."""
    configuration = calibration.configuration
    if odd := names_at_odds(links.node, topics_value(configuration)):
        return odd
    needed, _ = expected_air(calibration)
    air = [
        f"no node publishes {name}, without which the index of refraction is unknown"
        for name in links.unpublished(needed).values()
    ]
    wrong = faults(links.health.values("capture"), configuration, calibration.plan)
    silent, stop = single_shots(configuration.topics), configuration.safety.emergency_stop
    return links.missing_topics(calibration.topics, silent, stop) + air + wrong
