"""The planner node: offers the action ``calibrate``, one goal at a time, from preflight to result.

A goal is one coroutine. ``wait_until_ready`` waits until all nodes and instruments are there and
fit the configuration. GoalBag has the recorder open, continue and close the bag. GoalRun does all
of it, in several runs of the same session if a node is lost and comes back.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any, Final, TypeVar

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rotcal_msgs.action import Calibrate
from rotcal_msgs.msg import CalibrationGoal, CalibrationPlan, CalibrationProgress
from rotcal_msgs.srv import FinishCalibration, StartRecording, StopRecording
from std_srvs.srv import Trigger

from rotcal_ros.capture.instruments.conventions import single_shots
from rotcal_ros.capture.publishers import RUN, PublisherList, unique_run_name
from rotcal_ros.capture.rejections import MostFrequentReason
from rotcal_ros.foundation.errors import ConfigurationError, DataError, RotcalError
from rotcal_ros.foundation.files import write_atomically
from rotcal_ros.foundation.node_names import PREFLIGHT_NODES, VIEWERS
from rotcal_ros.foundation.node_state import NodeState, State, Why
from rotcal_ros.foundation.plugins import describe_error, name_hint
from rotcal_ros.foundation.session_folder import SessionFolder
from rotcal_ros.foundation.settings import to_mapping
from rotcal_ros.methods import Calibration, prepare_to_measure
from rotcal_ros.methods.configuration import (
    GROUPS,
    Configuration,
    dump_configuration,
    parse_configuration,
    settings_classes,
)
from rotcal_ros.methods.continuation import Continuation, Recorded
from rotcal_ros.methods.method import DEFAULT, find_method
from rotcal_ros.nodes.planner.cell_links import CellLinks, GoalPauses
from rotcal_ros.nodes.planner.goal_watch import SOLVER, Codes, GoalError, GoalWatch, RequiredNodes
from rotcal_ros.nodes.planner.measuring import GoalMeasurement, OperatorRequests, require_resumable
from rotcal_ros.nodes.planner.preflight import (
    expected_air_topics,
    instrument_faults,
    instrument_warnings,
    missing_air_consequence,
)
from rotcal_ros.nodes.planner.progress import GoalProgress
from rotcal_ros.nodes.runtime import conversions
from rotcal_ros.nodes.runtime.accepted_publishers import ACCEPTED
from rotcal_ros.nodes.runtime.announced_plan import read_continuation
from rotcal_ros.nodes.runtime.beat_values import (
    OF_MACHINES,
    PREFLIGHT,
    TOPICS,
    mismatched_topic_lines,
    reported_warnings,
    topics_value,
)
from rotcal_ros.nodes.runtime.cell_node import IDLE_S, CellNode, wait_for_condition
from rotcal_ros.nodes.runtime.clocks import clock_mismatches
from rotcal_ros.nodes.runtime.emergency_stop import EmergencyStop
from rotcal_ros.nodes.runtime.managed_node import read_settings
from rotcal_ros.nodes.runtime.running import run_in_thread, run_node
from rotcal_ros.planning.settings import SafetySettings

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
            onward = self.watch.resume_instruction(error.code, self.bag.folder) if begun else ""
            outcome.error_code = error.code
            outcome.error_msg = "; ".join([str(error), *self._likely_causes(error)]) + onward
            await self.bag.close_after_failure()
        finally:
            self._accepted = PublisherList()
            self.watch.links.node.accepted.decide(self._accepted)
        if self.bag.folder is not None:
            outcome.bag_folder = str(self.bag.folder.bag)
        progress = self.watch.progress
        captured = self._continuation.done.union(progress.accepted)
        outcome.n_used = len(captured & self._calibration.plan.counting)
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
            await wait_until_ready(self._calibration, self.watch, self.measuring.operator)
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
        self.watch.links.node.get_logger().warning(
            f"{lost}: the goal waits for it, then continues"
        )

    def values(self) -> dict[str, object]:
        """Return the values of the planner's beat that describe the goal."""
        heard: dict[str, object] = (
            {ACCEPTED: line} if (line := self._accepted.to_heartbeat()) else {}
        )
        own: dict[str, object] = {**self.watch.progress.counts(), **heard}
        own[TOPICS] = topics_value(self._calibration.configuration)
        return {RUN: self._run, **own} if self._run else own

    async def _fix_publishers(self) -> None:
        """Make the present publishers those of the run, and wait until all nodes know them."""
        await self._accept_publishers()
        if not await self.watch.wait_until_found(self._missing_connections):
            await self._accept_publishers()
            await self.watch.have(self._missing_connections, Codes.NODE_LOST)

    async def _accept_publishers(self) -> None:
        """Accept the present publishers, and tell all nodes at once in a beat."""
        links, watch = self.watch.links, self.watch
        instruments = self._calibration.topics
        await watch.have(lambda: links.unclear(instruments), Codes.TOPIC_MISSING)
        needed, wished = expected_air_topics(self._calibration)
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
        beside = [
            text for text in reported_warnings(health, OF_MACHINES) if text not in str(error)
        ]
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
        self.watch.links.node.get_logger().info(self._calibration.describe_remaining(left))

    async def _announce(self) -> None:
        """Publish the plan and wait until all nodes have taken it."""
        links, configuration = self.watch.links, self._calibration.configuration
        message = CalibrationPlan(
            header=conversions.make_header(links.node.now_ns()),
            plan_id=configuration.plan_id,
            method=configuration.method.name,
            configuration=configuration.text,
            total_steps=len(self._calibration.plan.steps),
            start_index=self._continuation.start_index,
            run=self._continuation.run,
        )
        await self._fix_publishers()
        run = self._run = unique_run_name(message)
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
            await wait_for_condition(
                lambda: future.done() or bool(health.missing(["recorder"])), BAG_TIMEOUT_S
            )

    async def _have_all_recorded(self) -> None:
        """Wait until the recorder has confirmed all observations, rejected ones too."""
        links = self._watch.links
        await wait_for_condition(
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


async def wait_until_ready(
    calibration: Calibration, watch: GoalWatch, operator: OperatorRequests
) -> None:
    """Wait for all nodes and topics; after the time limit GoalError names what is missing."""
    links, configuration = watch.links, calibration.configuration
    links.forget()
    if watch.preflight:  # a later one, after a lost node, hears of a stop in between
        watch.stop.forget()
    watch.tell(Why.PREFLIGHT_NODES)
    await watch.have(links.missing_nodes, Codes.NODE_LOST, in_vain=links.other_versions)
    nodes = watch.required.nodes = watch.required.nodes | _needed(links)
    watch.tell(Why.PREFLIGHT_CLOCKS)
    await watch.have(lambda: clock_mismatches(links.health, configuration), Codes.TOPIC_MISSING)
    watch.tell(Why.PREFLIGHT_TOPICS)
    await _have_topics(calibration, watch, operator)
    _, wished = expected_air_topics(calibration)
    unheard = [
        missing_air_consequence(role, name, configuration)
        for role, name in links.unpublished(wished).items()
    ]
    links.warn(
        PREFLIGHT,
        unheard + instrument_warnings(links.health.values("capture"), configuration, calibration),
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
        await watch.wait_until_stable(lambda: [publishers(links.instrument(r)) for r in roles])
    # What is missing may be there but undiscovered; what is not there is waited for below.
    await watch.wait_until_found(
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
    return not watch.preflight and bool(watch.stop.check_stop())


def _missing(calibration: Calibration, links: CellLinks) -> list[str]:
    """Return what is missing or wrong with the topics, in words."""
    configuration = calibration.configuration
    if odd := mismatched_topic_lines(links.node, topics_value(configuration)):
        return odd
    needed, _ = expected_air_topics(calibration)
    air = [
        f"no node publishes {name}, without which the index of refraction is unknown"
        for name in links.unpublished(needed).values()
    ]
    wrong = instrument_faults(links.health.values("capture"), configuration, calibration.plan)
    silent, stop = single_shots(configuration.topics), configuration.safety.emergency_stop
    return links.missing_topics(calibration.topics, silent, stop) + air + wrong


Plain = TypeVar("Plain", CalibrationGoal, CalibrationProgress)
RESULT_TIMEOUT_S: Final = 3600
FEEDBACK_PERIOD_S: Final = 0.1
NO_ORDERS: Final = "the planner commands no motion; a recording continues"
RESTART_WAIT_S: Final = 20.0
"""A goal waits this long for a lost node to be restarted."""
SAFETY, HEALTH = "safety", "health"
FROM_THE_START: Final = (SAFETY, HEALTH)
"""Groups that are fixed for all nodes at their start: no goal changes them."""
ALWAYS: Final = ("cell", "plan", "capture", "solver", "planner", *FROM_THE_START)
"""Groups that are parameters of the planner even if they were not given."""


class Planner(CellNode):
    """Commands the cell from the first step to the result."""

    def __init__(self) -> None:
        super().__init__("planner")

    def configure(self) -> None:
        """Read the configuration, and offer to calibrate."""
        self._run: GoalRun | None = None
        self._preparing, self._shown_s = False, -math.inf
        self._giving_up: str | None = None
        self._given_up: str | None = None
        self._configured = PlannerParameters(self)
        self._continuation = read_continuation(self)
        text = "s, how long a goal waits for lost nodes of the suite"
        self._restart_wait_s = self.parameter("restart_wait_s", RESTART_WAIT_S, text)
        self._links = CellLinks(self)
        self._stop = EmergencyStop(self, self._configured.safety, NO_ORDERS)
        self._pauses = GoalPauses(self, self._require_free, self._in_words)
        self._server = ActionServer(
            self,
            Calibrate,
            "calibrate",
            self._execute,
            goal_callback=self._judge_goal,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
            result_timeout=RESULT_TIMEOUT_S,
        )

    def activated(self) -> None:
        """Take goals."""
        self._giving_up = None

    def deactivated(self) -> None:
        """Give up the running goal and accept no other."""
        self._give_up("the planner was deactivated")

    def judge_parameters(self, changes: Mapping[str, Any]) -> None:
        """Raise ConfigurationError if no goal could be measured with these parameters."""
        if self.configured:
            self._configured.judge(changes)

    def begin_stop(self) -> None:
        """End the running goal with a valid bag."""
        self._give_up("the planner was ended")

    def stopped(self) -> bool:
        """Return whether no goal runs any more."""
        return not self.configured or (self._run is None and not self._preparing)

    def batch_period_s(self) -> float:
        """Collect messages until there is a goal."""
        return IDLE_S if self.stopped() else 0.0

    def _give_up(self, why: str) -> None:
        self._giving_up = self._given_up = why
        if self._run is not None:
            self._run.watch.stopping = why

    def _judge_goal(self, _goal: Calibrate.Goal) -> GoalResponse:
        """Refuse a goal while another runs; the client reads the reason in the beat."""
        free = self._run is None and not self._preparing
        if self.active and not self._giving_up and free:
            self._given_up = None
            return GoalResponse.ACCEPT
        self.get_logger().warning(f"goal refused: the planner is {self._in_words()}")
        return GoalResponse.REJECT

    def _in_words(self) -> str:
        """Return the planner's state for a person to read."""
        return self._beat_values()[0].describe()

    def _require_free(self) -> None:
        """Raise NotResumableError if the running goal cannot be resumed yet."""
        if self._run is not None:
            require_resumable(self._run.watch)

    async def _execute(self, handle: ServerGoalHandle) -> Codes:
        try:
            goal = await self._prepared(handle)
        except RotcalError as error:
            handle.abort()
            return Codes(error_code=Codes.BAD_CONFIGURATION, error_msg=str(error))
        except Exception as error:
            handle.abort()
            return self._unknown(error)
        self._run = goal
        goal.watch.stopping = self._given_up  # meanwhile, even if it is active again
        try:
            outcome = await goal.execute()
        except Exception as error:
            outcome = self._unknown(error)
            await goal.bag.close_after_failure()
        finally:
            self._run = None
        self._end(handle, outcome, goal.verdict_line)
        return outcome

    def _unknown(self, error: Exception) -> Codes:
        self.health.note_error("goal", error)
        return Codes(error_code=Codes.UNKNOWN, error_msg=describe_error(error))

    async def _prepared(self, handle: ServerGoalHandle) -> GoalRun:
        """Run :meth:`_prepare` in a thread: it may take seconds, and the node goes on."""
        self._preparing = True
        try:
            return await run_in_thread(self._prepare, handle)
        finally:
            self._preparing = False

    def _prepare(self, handle: ServerGoalHandle) -> GoalRun:
        """Return the run of a goal; ConfigurationError or PlanError when it is impossible."""
        calibration = prepare_to_measure(self._configured.configuration(handle.request))
        continuation, self._continuation = self._continuation, None
        self._links.goals.publish(_plain(CalibrationGoal, handle, handle.request, self.now_ns()))
        plan_id, start_index = calibration.configuration.plan_id, handle.request.start_index
        asked = (plan_id, start_index)
        if continuation is None or (continuation.plan_id, continuation.start_index) != asked:
            calibration.plan.step(start_index)  # PlanError when there is no such step
            continuation = calibration.first_run(start_index)
        watch = GoalWatch(
            calibration.configuration.planner,
            self._links,
            self._stop,
            self._pauses,
            GoalProgress(
                total=len(calibration.plan.steps),
                step=continuation.start_index,
                left=len(continuation.steps),
            ),
            show=lambda progress: self._show(handle, progress),
            canceled=lambda: handle.is_cancel_requested,
            required=RequiredNodes(self.health, self._restart_wait_s),
            patience_s=calibration.configuration.planner.preflight_timeout_s,
        )
        return GoalRun(calibration, continuation, watch)

    def _end(self, handle: ServerGoalHandle, outcome: Codes, verdict_line: str) -> None:
        if outcome.error_code == Codes.NONE:
            self.get_logger().info(f"calibration done, verdict {verdict_line}")
            handle.succeed()
            return
        self.get_logger().error(f"calibration ended: {outcome.error_msg}")
        if handle.is_cancel_requested:
            handle.canceled()
        else:
            handle.abort()

    def _show(self, handle: ServerGoalHandle, progress: GoalProgress) -> None:
        """Publish feedback, not more often than a person can follow."""
        now = time.monotonic()
        measuring = 0 < progress.step < progress.total
        if now - self._shown_s < FEEDBACK_PERIOD_S and measuring and not self._pauses.waiting:
            return
        self._shown_s = now
        feedback = feedback_message(progress, self._links.current_std)
        handle.publish_feedback(feedback)
        self._links.progress.publish(_plain(CalibrationProgress, handle, feedback, self.now_ns()))

    def _report(self) -> tuple[NodeState, dict[str, Any]]:
        if self._run is None:
            return NodeState(State.PREPARING if self._preparing else State.READY), {}
        progress = self._run.watch.progress
        doing = (progress.doing,)
        state = NodeState(State.CALIBRATING, doing, progress.step, progress.total)
        return state, self._run.values()


class PlannerParameters:
    """The parameters of a planner: the groups of its configured method, and its ``safety``.

    Raises ConfigurationError for any parameter that is misspelt (with the nearest name) or
    impossible.
    """

    def __init__(self, node: CellNode) -> None:
        self._node = node
        method = find_method(node.parameter("method", DEFAULT, "method of the calibration"))
        for group, value in node.given.items():
            if isinstance(value, dict) and group not in GROUPS:
                raise ConfigurationError(
                    f"{node.get_name()}: parameters: unknown group {group!r}"
                    f"{name_hint(group, GROUPS)}"
                )
        self._groups = {
            group: cls
            for group, cls in settings_classes(method).items()
            if group in ALWAYS or group in node.given
        }
        for group, cls in self._groups.items():
            node.settings(group, cls, read_only=group in FROM_THE_START)
        self.safety: SafetySettings = read_settings(node, SAFETY, SafetySettings)
        self._fixed = {SAFETY: self.safety, HEALTH: node.health.settings}

    def configuration(self, goal: Calibrate.Goal) -> Configuration:
        """Return the configuration of a goal, or that of the parameters if it has none."""
        text, source = goal.configuration, "configuration of the goal"
        if not text:
            method = self._node.get_parameter("method").value
            groups = {
                group: to_mapping(read_settings(self._node, group, cls))
                for group, cls in self._groups.items()
            }
            text, source = dump_configuration(method, groups), "parameters of the planner"
        configuration = parse_configuration(text, source)
        for group, own in self._fixed.items():
            if group in configuration.given and configuration.group(group) != own:
                raise ConfigurationError(
                    f"{source}: its group {group} differs from the one that the planner was "
                    "started with: start the nodes with this configuration"
                )
        if goal.method and goal.method != configuration.method.name:
            raise ConfigurationError(
                f"the goal requests method {goal.method!r}, its configuration describes "
                f"{configuration.method.name!r}"
            )
        return configuration

    def judge(self, changes: Mapping[str, Any]) -> None:
        """Raise ConfigurationError if no goal can be measured with ``changes``, name -> value."""
        for group in {name.partition(".")[0] for name in changes} & self._groups.keys():
            read_settings(self._node, group, self._groups[group], changes)


def feedback_message(progress: GoalProgress, current_std: float) -> Calibrate.Feedback:
    """Return the progress of a goal; ``current_std`` in rad."""
    return Calibrate.Feedback(
        step=progress.step,
        total=progress.total,
        activity=progress.doing.describe(),
        doing=progress.doing.code,
        instruction=progress.doing.instruction or "",
        time_left=progress.time_left(),
        current_std=current_std,
        n_accepted=len(progress.accepted),
        n_rejected=progress.rejected,
        left=progress.left,
        uncertainty=progress.uncertainty,
        goal=progress.goal,
    )


def _plain(kind: type[Plain], handle: ServerGoalHandle, content: Any, now_ns: int) -> Plain:
    """Return the ``content`` of a goal or a feedback as a message that bags can hold."""
    fields = {name: getattr(content, name) for name in content.get_fields_and_field_types()}
    return kind(header=conversions.make_header(now_ns), goal_id=handle.goal_id, **fields)


def main() -> None:
    """Run the planner."""
    run_node(Planner)


if __name__ == "__main__":
    main()
