"""The solver node: turns accepted observations into deviations and a compensation table."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from typing import Any, Final

from rotcal_msgs import msg
from rotcal_msgs.srv import FinishCalibration
from std_srvs.srv import Trigger

from rotcal_ros.bags import names
from rotcal_ros.capture import messages
from rotcal_ros.capture.publishers import RUN, unique_run_name
from rotcal_ros.compensation.table import table_from_result
from rotcal_ros.foundation.errors import DataError, RotcalError
from rotcal_ros.foundation.in_force import states_of_axis
from rotcal_ros.foundation.node_state import LOADING, NO_PLAN, SOLVING, NodeState, State, Why
from rotcal_ros.foundation.observations import Observation
from rotcal_ros.foundation.plugins import describe_error
from rotcal_ros.foundation.results import Result
from rotcal_ros.methods import Calibration, last_accepted
from rotcal_ros.methods.calibration import RunStep
from rotcal_ros.methods.continuation import Recorded
from rotcal_ros.nodes.runtime import conversions
from rotcal_ros.nodes.runtime.announced_plan import (
    PlanSubscription,
    calibration_from_message,
    load_method,
    read_continuation,
)
from rotcal_ros.nodes.runtime.cell_node import CellNode, wait_for_condition
from rotcal_ros.nodes.runtime.health import BEAT_PERIOD_S
from rotcal_ros.nodes.runtime.qos import EVENT, LATCHED
from rotcal_ros.nodes.runtime.running import run_node
from rotcal_ros.nodes.runtime.static_frames import StaticFrames

ARRIVAL_TIMEOUT_S = 10.0
SOLVE_TIMEOUT_S = 3600.0
OBSERVATIONS_S = 0.04
"""During a calibration observations are collected for this time and handled together."""


class SolverNode(CellNode):
    """Solves in a thread of its own, so that no observation waits for a solution."""

    def __init__(self) -> None:
        super().__init__("solver")

    def configure(self) -> None:
        """Wait for plans."""
        load_method(self)
        period_s = self.parameter("preliminary_period_s", 3.0, "s, between preliminary results")
        self._continuation = read_continuation(self)
        self._calibration: Calibration | None = None
        self._run, self._state = "", NO_PLAN
        self._observations: dict[RunStep, Observation] = {}
        self._in_force: list[tuple[str, str]] = []  # axis and state, as announced
        self._worker = ThreadPoolExecutor(max_workers=1, thread_name_prefix="solve")
        self._solving: Future[Result] | None = None
        self._run_number = self._solved_count = 0
        self._values: dict[str, str] = {}  # of the last final result
        self._deviations = self.create_publisher(msg.DeviationArray, "deviations", LATCHED)
        self._tables = self.create_publisher(msg.CompensationTable, "compensation_table", LATCHED)
        self._corrections = self.create_publisher(
            msg.VolumetricCorrection, "volumetric_correction", LATCHED
        )
        self._locations = self.create_publisher(msg.AxisLocation, "axis_location", LATCHED)
        self._earlier = EarlierObservations(self)
        PlanSubscription(self, self._take_plan)
        self._frames = StaticFrames(self, self.health.guarded)
        self.listen(msg.TableInForce, names.TABLE_IN_FORCE, self._note_in_force, LATCHED)
        self.listen(msg.Observation, names.OBSERVATION, self._take, EVENT, judged=True)
        self.offer(FinishCalibration, "finish_calibration", self._finish)
        self.every(period_s, self._preliminary)

    def begin_stop(self) -> None:
        """Give up what is being solved."""
        self._worker.shutdown(wait=False, cancel_futures=True)

    def batch_period_s(self) -> float:
        """Collect observations: no one waits for a preliminary result."""
        return 0.0 if self._answering else self.idle_batch_period_s() or OBSERVATIONS_S

    def _take_plan(self, message: msg.CalibrationPlan) -> None:
        """Begin with a plan, with what the recorder or this node itself has of earlier runs."""
        old, own = self._calibration, self._observations
        self._calibration, self._run, self._observations, self._state = None, "", {}, LOADING
        self._values = {}
        self.health.beat()
        try:
            self._calibration = calibration_from_message(message)
        except RotcalError as error:
            self._state = NodeState.of(State.FAILED, Why.PLAN_REFUSED, error)
            raise
        same = old is not None and old.configuration.plan_id == message.plan_id
        kept = own if same and message.run > self._run_number else {}
        known, self._continuation = self._continuation, None
        if known is not None and (known.plan_id, known.run) == (message.plan_id, message.run):
            kept = {(o.run, o.step): o for o in known.observations}
        self._run_number, self._solved_count = message.run, 0
        if message.run == 0:
            # what was in force earlier does not matter
            self._in_force = list(dict(self._in_force).items())
        self._earlier.ask(message, kept, partial(self._begin_run, message))

    def _begin_run(self, message: msg.CalibrationPlan, known: Known) -> None:
        """Collect from now on; ``known`` is what was observed before this node or run began."""
        self._know(known)
        self._run = unique_run_name(message)
        self._state = NodeState.of(State.WORKING, Why.COLLECTING, message.method)
        self.health.beat()

    def _know(self, known: Known) -> None:
        self._observations = {**known, **self._observations}

    def _note_in_force(self, message: msg.TableInForce) -> None:
        announced = (message.axis, message.in_force)
        if self._in_force[-1:] != [announced]:
            self._in_force.append(announced)

    def _take(self, message: msg.Observation) -> None:
        if self._calibration is not None and message.accepted and message.run == self._run_number:
            self._observations[message.run, message.step] = messages.observation(message)

    def _preliminary(self) -> None:
        """Begin to solve the observations so far, unless that is going on or nothing is new."""
        if self._is_solving() or len(self._observations) == self._solved_count:
            return
        calibration, run = self._calibration, self._run
        if calibration is not None:
            self._solved_count = len(self._observations)
            self._begin(calibration).add_done_callback(
                lambda future: (ros := self.executor) and ros.create_task(self._show, future, run)
            )

    def _begin(self, calibration: Calibration) -> Future[Result]:
        announced = states_of_axis(self._in_force, calibration.configuration.cell.axis)
        known = tuple(self._observations.values()), announced, self._frames.frames
        self._solving = self._worker.submit(calibration.solve, *known)
        self.health.beat()  # before the computation can delay it
        return self._solving

    def _is_solving(self) -> bool:
        return self._solving is not None and not self._solving.done()

    def _show(self, future: Future[Result], run: str) -> None:
        outdated = future is not self._solving or future.cancelled() or run != self._run
        if outdated or not self.active:
            return
        try:
            self._publish(future.result(), final=False)
            count = self._solved_count
            self._state = NodeState.of(State.WORKING, Why.PRELIMINARY_RESULT, count)
        except DataError as error:
            self._state = NodeState.of(State.WORKING, Why.TOO_FEW_OBSERVATIONS, error)
        except Exception as error:
            self.health.note_error("preliminary solution", error)

    async def _finish(
        self, request: FinishCalibration.Request, response: FinishCalibration.Response
    ) -> FinishCalibration.Response:
        try:
            result = await self._final(request)
            if not self.active:
                raise self.not_active_error()
            self._publish(result, final=True)
            response.result_json, response.verdict = result.to_json(), result.verdict
            response.success = True
            self._state = NodeState.of(State.READY, Why.FINAL_RESULT, result.verdict_line)
        except Exception as error:
            response.message = str(error)
            if not isinstance(error, RotcalError):
                self.health.note_error("final solution", error)
                response.message = describe_error(error)
            self._state = NodeState.of(State.FAILED, Why.NO_RESULT, response.message)
        return response

    async def _final(self, request: FinishCalibration.Request) -> Result:
        calibration = self._calibration
        if calibration is None or calibration.configuration.plan_id != request.plan_id:
            raise DataError(f"the solver has no plan {request.plan_id}: announce the plan first")
        steps = {(self._run_number, step) for step in request.steps}
        if not steps <= self._observations.keys():  # a restarted solver may miss the first ones
            self._earlier.ask_again(self._know)
        await wait_for_condition(lambda: steps <= self._observations.keys(), ARRIVAL_TIMEOUT_S)
        missing = sorted(steps - self._observations.keys())
        if missing:
            raise DataError(
                f"the observations of {len(missing)} accepted steps did not arrive at the solver "
                f"(first: {missing[0][1]}); solve the bag instead, it holds them all"
            )
        self._state = SOLVING  # beyond the solution: until it is published
        self._solved_count = len(self._observations)  # no preliminary result follows the final one
        return await self.answer_of(self._begin(calibration), SOLVE_TIMEOUT_S)

    def _publish(self, result: Result, *, final: bool) -> None:
        """Publish the deviations; the final ones with corrections, and where the axes stand."""
        assert self._calibration is not None
        configuration = self._calibration.configuration
        plan_id, now_ns = configuration.plan_id, self.now_ns()
        message = conversions.deviations_message(result, plan_id, now_ns, final=final)
        self._deviations.publish(message)
        if not final:
            return
        self._values = conversions.result_values(result)
        axis = configuration.cell.axis
        self._corrections.publish(conversions.correction_message(result, axis, plan_id, now_ns))
        if result.axes:
            self._locations.publish(conversions.location_message(result, plan_id, now_ns))
        try:
            table = table_from_result(result, axis=axis)
        except RotcalError as error:
            self.get_logger().warning(f"no compensation table: {error}")
            return
        self._tables.publish(conversions.compensation_message(table, plan_id, now_ns))

    def _report(self) -> tuple[NodeState, dict[str, Any]]:
        state = SOLVING if self._is_solving() else self._state
        return state, {RUN: self._run, "observations": len(self._observations), **self._values}


PATIENCE_S: Final = 10.0
"""The recorder is asked again after this long without an answer."""
NO_GOAL_S: Final = 2.0
"""If the planner has had no goal for this long, it did not announce the plan."""
Known = Mapping[RunStep, Observation]
Take = Callable[[Known], None]


class EarlierObservations:
    """Asks the recorder for the observations of a plan so far, all runs of its session.

    It asks only while the planner works on this plan: a plan of another node has none. Meanwhile
    the observations are waited for: without them the joined runs cannot be solved.
    """

    def __init__(self, node: CellNode) -> None:
        self._node = node
        self._client = node.create_client(Trigger, "recorded_observations")
        self._plan: msg.CalibrationPlan | None = None
        self._kept: Known = {}
        self._wanted: tuple[msg.CalibrationPlan, Take, float] | None = None
        self._asked: Any = None
        self._asked_s = 0.0
        node.every(BEAT_PERIOD_S, self._look)

    def ask(self, message: msg.CalibrationPlan, kept: Known, take: Take) -> None:
        """Call ``take`` with the accepted ones, later.

        ``kept`` is what the node itself has; it counts if the recorder knows no earlier run.
        """
        self._plan, self._kept = message, kept
        self.ask_again(take)

    def ask_again(self, take: Take) -> None:
        """Ask once more for the same plan."""
        if self._plan is not None:
            self._wanted = self._plan, take, time.monotonic()
            self._asked = None
            self._look()

    def _look(self) -> None:
        if self._wanted is None:
            return
        message, take, since_s = self._wanted
        now_s = time.monotonic()
        if self._is_foreign(message, now_s - since_s):
            self._answer(take, ())
        elif self._asked is not None and self._asked.done():
            self._answer(take, self._recorded(message))
        elif self._asked is None and self._client.service_is_ready():
            self._asked_s, self._asked = now_s, self._client.call_async(Trigger.Request())
            self._asked.add_done_callback(self._node.health.guarded(lambda _: self._look()))
        elif now_s - max(self._asked_s, since_s) > PATIENCE_S:
            text = "the recorder does not say what was measured earlier: waiting for it"
            self._node.get_logger().warning(text, throttle_duration_sec=PATIENCE_S)
            self._asked = None

    def _is_foreign(self, message: msg.CalibrationPlan, waited_s: float) -> bool:
        """Return whether the plan is not that of the planner's goal: there is nothing to ask."""
        health = self._node.health
        if "planner" not in health.present():
            return True
        goals_run = health.values("planner").get(RUN, "")
        return goals_run != unique_run_name(message) if goals_run else waited_s > NO_GOAL_S

    def _recorded(self, message: msg.CalibrationPlan) -> tuple[Observation, ...]:
        """Return the answer of the recorder, if it is about this plan."""
        try:
            known = Recorded.from_json(self._asked.result().message)
        except DataError as error:
            self._node.get_logger().warning(str(error))
            return ()
        same = (known.plan_id, known.run) == (message.plan_id, message.run)
        return known.observations if same else ()

    def _answer(self, take: Take, recorded: tuple[Observation, ...]) -> None:
        assert self._plan is not None
        self._wanted = self._asked = None
        known: Known = last_accepted(recorded)
        now = self._plan.run
        take(known if any(run < now for run, _ in known) else {**self._kept, **known})


def main() -> None:
    """Run the solver node."""
    run_node(SolverNode)


if __name__ == "__main__":
    main()
