"""The operator's page: shows in a browser what the cell does, and passes on a person's requests.

It receives what the nodes publish anyway and subscribes to no instrument; no node waits for it.
GoalFollower follows the planner's latest goal, whoever sent it; PageTopics takes plan, deviations,
rejected attempts, orders and warnings; CaptureValues takes rates, readings and temperatures from
the beat of the capture; PendingTable is the compensation table that waits at the bridge, and its
confirmation by a person.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Awaitable, Callable, Mapping
from concurrent.futures import Future
from dataclasses import replace
from functools import partial
from math import ceil
from statistics import linear_regression
from typing import Any, Final

import numpy as np
from action_msgs.msg import GoalStatus, GoalStatusArray
from action_msgs.srv import CancelGoal
from rcl_interfaces.msg import Log
from rclpy.logging import LoggingSeverity
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_action_status_default
from rotcal_msgs.action import Calibrate
from rotcal_msgs.msg import CalibrationPlan, DeviationArray, Pause
from rotcal_msgs.msg import CompensationTable as CompensationTableMsg
from rotcal_msgs.msg import Observation as ObservationMsg
from rotcal_msgs.srv import ApplyTable, GetCorrection
from std_srvs.srv import Trigger

from rotcal_ros.bags import names
from rotcal_ros.capture.messages import stamp_ns
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.components import COVERAGE_FACTOR
from rotcal_ros.foundation.errors import RotcalError
from rotcal_ros.foundation.language import phrase
from rotcal_ros.foundation.node_state import LOADING, NodeState, Reason, State, Why
from rotcal_ros.foundation.observations import Approach, Command, LengthStatus, place_in_words
from rotcal_ros.foundation.units import ARCSEC, DEGREE, NANOSECOND
from rotcal_ros.methods import Calibration
from rotcal_ros.nodes.bridge.node import NEVER, OFFERED, WITHHELD
from rotcal_ros.nodes.client.calibrator import Feedback, Outcome
from rotcal_ros.nodes.operator_page import sections as page_sections
from rotcal_ros.nodes.runtime.announced_plan import calibration_from_message
from rotcal_ros.nodes.runtime.beat_values import NOW, SILENT
from rotcal_ros.nodes.runtime.cell_node import CellNode
from rotcal_ros.nodes.runtime.health import PLANNER
from rotcal_ros.nodes.runtime.qos import EVENT, LATCHED, VIEW
from rotcal_ros.nodes.runtime.running import run_node
from rotcal_ros.page.app import ActionOutcome, PageServer
from rotcal_ros.page.settings import PageSettings
from rotcal_ros.page.state import (
    Cell,
    LiveReading,
    LogLine,
    OrderedStep,
    PlannerStatus,
    Points,
    RejectedAttempt,
    ShownOffer,
    ShownUncertainty,
    StateBoard,
    StepProgress,
    Temperature,
    TopicState,
    ValueHistory,
    current_activity,
)

PERIOD_S: Final = 0.25
LAST_WORD_S: Final = 2.0
"""Time to wait for the end of a goal: its client may hear of it earlier and end the nodes."""


class OperatorPage(CellNode):
    """Turns messages and beats into the sections of the page."""

    def __init__(self) -> None:
        super().__init__("operator_page")

    def configure(self) -> None:
        """Serve the page."""
        settings = self.settings("page", PageSettings)
        self.board = StateBoard()
        self._streams = CaptureValues()
        self._course = ValueHistory()
        self._drawn: float | None = None
        self._beat: object = None
        self._ending_s: float | None = None
        self._goal = GoalFollower(self, self._begin)
        self._table = PendingTable(self)
        self._topics = PageTopics(self, self.board)
        if "simulation" in self.given:
            self.board.show(cell=Cell(simulated=True))
        self.every(PERIOD_S, self._look)
        self._server = PageServer(settings, self.board, self)
        self.get_logger().info(f"page: {self._server.address}")

    def resume(self, instruction: str) -> Future[ActionOutcome]:
        """Go on after a person's work; called from the server's thread."""
        return self._asked(partial(self._goal.resume, instruction))

    def stop(self) -> Future[ActionOutcome]:
        """Cancel the goal; called from the server's thread."""
        return self._asked(self._goal.stop)

    def apply(self, confirmation: str, secret: str) -> Future[ActionOutcome]:
        """Confirm a table; called from the server's thread."""
        return self._asked(partial(self._table.apply, confirmation, secret))

    def begin_stop(self) -> None:
        """Wait for the last message of the planner, then tell the viewers the end."""
        self._ending_s = time.monotonic()

    def stopped(self) -> bool:
        """Return whether the viewers know how it ended."""
        assert self._ending_s is not None
        if self._goal.settled or time.monotonic() - self._ending_s > LAST_WORD_S:
            if not self.board.state.ended:
                self._look()
                self._server.close()
            return self._server.closed
        return False

    def _asked(self, work: Callable[[], Awaitable[ActionOutcome]]) -> Future[ActionOutcome]:
        """Run ``work`` in the executor; the future is for the thread of the server."""
        future: Future[ActionOutcome] = Future()

        async def do() -> None:
            try:
                inactive = ActionOutcome(False, str(self.not_active_error()))
                answer = await work() if self.active else inactive
                future.set_result(answer)
            except Exception as error:
                self.health.note_error("request of a person", error)
                future.set_result(ActionOutcome(False, str(error)))

        self.executor.create_task(do)
        return future

    def _begin(self) -> None:
        """Forget what belongs to an earlier goal."""
        self._course, self._drawn = ValueHistory(), None
        self._topics.begin()
        self.board.show(standing=ShownUncertainty(), recording=None)

    def _look(self) -> None:
        """Update what the heartbeats show."""
        health, goal = self.health, self._goal
        capture = health.others.get("capture")
        if capture is not None and capture is not self._beat:
            self._beat = capture
            self._streams.receive(health.values("capture"))
        offer = self._table.offer()
        self.board.show(
            now=current_activity(self._heard(), offer),
            steps=goal.steps(),
            standing=self._standing(),
            table_deg=self._streams.table_deg(),
            lengths=self._streams.lengths(),
            length_course=self._streams.length_course(),
            temperatures=self._streams.temperatures(),
            nodes=page_sections.node_states(health),
            streams=self._streams.streams(),
            # An idle recorder says nothing more about the bag that it closed.
            recording=page_sections.recorder_state(health.values("recorder"))
            or self.board.state.recording,
            offer=offer,
        )

    def _heard(self) -> PlannerStatus:
        health, goal = self.health, self._goal
        feedback, outcome = goal.feedback, goal.outcome
        return PlannerStatus(
            planner=health.node_state(PLANNER),
            silent=PLANNER in health.lost,
            calibrating=goal.running or (outcome is None and health.is_calibrating()),
            doing=feedback.doing if feedback else Why.UNKNOWN,
            activity=self._activity(feedback) if feedback else "",
            instruction=feedback.instruction if feedback else "",
            task=self.board.state.task,
            stopping=goal.stopping,
            ended=outcome is not None,
            canceled=outcome is not None and outcome.canceled,
            verdict=outcome.verdict if outcome else "",
            error=outcome.error_msg if outcome else "",
            command=page_sections.resume_command_line(outcome.bag_folder) if outcome else "",
        )

    def _activity(self, feedback: Feedback) -> str:
        """Return what a goal does: from what its planner and its orders say, as data."""
        pointing = self.board.state.pointing
        if feedback.doing is Why.MEASURING and pointing is not None:
            return pointing.place
        reasons = self.health.node_state(PLANNER).reasons
        words = (reason.describe() for reason in reasons if reason.code == feedback.doing)
        return next(words, feedback.activity)

    def _standing(self) -> ShownUncertainty:
        """Return U of the curve, and if there is a goal the policy's figure beside it."""
        feedback, curve = self._goal.feedback, self._topics.uncertainty
        if feedback is None:
            return self.board.state.standing
        if curve is not None and curve != self._drawn:
            self._drawn = curve
            self._course.add(feedback.accepted, round(curve / ARCSEC, 4))
        if self._topics.withheld:
            return ShownUncertainty(withheld=self._topics.withheld)
        rms, goal = feedback.uncertainty_rad, feedback.goal_rad
        return ShownUncertainty(
            largest_arcsec=None if curve is None else round(curve / ARCSEC, 4),
            rms_arcsec=None if rms is None else round(rms / ARCSEC, 4),
            goal_arcsec=None if goal is None else goal / ARCSEC,
            course=self._course.points,
        )

    def _report(self) -> tuple[NodeState, dict[str, Any]]:
        address = self._server.address
        if self._topics.loading:
            return replace(LOADING, page=address), {}
        serving = Reason.of(Why.SERVING, address)
        return NodeState(State.READY, (serving,), page=address), {}


RUNNING = (GoalStatus.STATUS_ACCEPTED, GoalStatus.STATUS_EXECUTING, GoalStatus.STATUS_CANCELING)


class GoalFollower:
    """The latest goal of the action ``calibrate``: its feedback, and how it ended.

    ``begun`` is called with every new goal. ``outcome`` is None while it runs.
    """

    def __init__(self, node: CellNode, begun: Callable[[], None]) -> None:
        self._begun = begun
        self._id: Any = None
        self.running = self.stopping = False
        self.feedback: Feedback | None = None
        self.outcome: Outcome | None = None
        impl = Calibrate.Impl
        node.listen(impl.FeedbackMessage, "calibrate/_action/feedback", self._hear, VIEW)
        node.listen(
            GoalStatusArray,
            "calibrate/_action/status",
            self._look,
            qos_profile_action_status_default,
        )
        self._result = node.create_client(impl.GetResultService, "calibrate/_action/get_result")
        self._cancel = node.create_client(CancelGoal, "calibrate/_action/cancel_goal")
        self._resume = node.create_client(Trigger, "resume")

    @property
    def settled(self) -> bool:
        """Whether nothing more will be heard of a goal."""
        return self._id is None or self.outcome is not None

    def steps(self) -> StepProgress | None:
        """Return how far the goal has come, None before its first feedback."""
        heard = self.feedback
        if heard is None:
            return None
        left_s = None if self.outcome or heard.instruction else heard.time_left_s
        return StepProgress(
            step=heard.step,
            total=heard.total,
            accepted=heard.accepted,
            rejected=heard.rejected,
            left=heard.left,
            end_s=None if left_s is None else round(time.time() + left_s, 1),
        )

    async def resume(self, instruction: str) -> ActionOutcome:
        """Tell the planner that the work of this instruction is done, once."""
        asked = self.feedback
        if asked is None or not asked.instruction:
            return ActionOutcome(False, phrase("nothing is waiting to be resumed"))
        if instruction != asked.instruction:
            return ActionOutcome(
                False, phrase("the instruction has changed: read the new one first")
            )
        if not self._resume.service_is_ready():
            return ActionOutcome(False, phrase("the planner does not answer"))
        # Until the planner's next feedback, a second click finds that nothing is asked for.
        going_on = Reason(Why.GOING_ON)
        self.feedback = continuing = replace(
            asked, doing=going_on.code, activity=going_on.describe(), instruction=""
        )
        answer = await self._resume.call_async(Trigger.Request())
        if not answer.success and self.feedback is continuing:
            self.feedback = asked
        return ActionOutcome(answer.success, answer.message or phrase("the calibration continues"))

    async def stop(self) -> ActionOutcome:
        """Cancel the goal that is followed, and no other."""
        if self._id is None or not self.running:
            return ActionOutcome(False, phrase("no calibration runs"))
        request = CancelGoal.Request()
        request.goal_info.goal_id = self._id
        answer = await self._cancel.call_async(request)
        self.stopping = answer.return_code == CancelGoal.Response.ERROR_NONE
        words = phrase("stopping") if self.stopping else phrase("it has ended already")
        return ActionOutcome(self.stopping, words)

    def _look(self, message: GoalStatusArray) -> None:
        goals = sorted(message.status_list, key=lambda s: stamp_ns(s.goal_info.stamp))
        if not goals:
            return
        latest = goals[-1]
        if self._id is None or bytes(latest.goal_info.goal_id.uuid) != bytes(self._id.uuid):
            self._id = latest.goal_info.goal_id
            self.feedback, self.outcome, self.stopping = None, None, False
            self._begun()
            self._ask_for_the_end(self._id)
        self.running = latest.status in RUNNING
        self.stopping = self.stopping or latest.status == GoalStatus.STATUS_CANCELING

    def _ask_for_the_end(self, goal_id: Any) -> None:
        request = Calibrate.Impl.GetResultService.Request(goal_id=goal_id)

        def note(future: Any) -> None:
            if goal_id is self._id and future.exception() is None:
                self.outcome, self.running = Outcome.of(future.result()), False

        self._result.call_async(request).add_done_callback(note)

    def _hear(self, message: Any) -> None:
        if self._id is not None and bytes(message.goal_id.uuid) == bytes(self._id.uuid):
            self.feedback = Feedback.of(message.feedback)


REJECTIONS: Final = 50
LOG_LINES: Final = 100
ROSOUT: Final = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class PageTopics:
    """Shows on a board what its topics say.

    ``uncertainty`` is the largest expanded one (k = 2) of ECC in the latest solution, rad; None
    where it is not known. ``withheld`` says why it may not be stated; it is empty if it may.
    ``loading`` is true while a plan is read.
    """

    def __init__(self, node: CellNode, board: StateBoard) -> None:
        self._node, self._board = node, board
        self._calibration: Calibration | None = None
        self._pause = Pause()
        self._rejections: deque[RejectedAttempt] = deque(maxlen=REJECTIONS)
        self._log: deque[LogLine] = deque(maxlen=LOG_LINES)
        self._visited: dict[float, None] = {}
        self.uncertainty: float | None = None
        self.withheld, self.loading = "", False
        node.listen(CalibrationPlan, names.PLAN, self._take_plan, LATCHED, judged=True)
        node.listen(DeviationArray, "deviations", self._take_deviations, LATCHED)
        # There are few, and a person has to see all of them, however busy the machine is.
        node.listen(ObservationMsg, names.OBSERVATION, self._take_observation, EVENT)
        node.listen(Pause, names.PAUSE, self._take_pause, LATCHED)
        node.listen(Log, "/rosout", self._take_log, ROSOUT)
        node.take_orders(self._point)

    def begin(self) -> None:
        """Forget what belongs to an earlier goal."""
        self._rejections.clear()
        self._visited.clear()
        self.uncertainty, self.withheld = None, ""
        self._board.show(rejections=(), deviations=None, pointing=None)

    def _take_plan(self, message: CalibrationPlan) -> None:
        self.loading = True
        self._node.health.beat()
        try:
            self._calibration = calibration_from_message(message)
        except RotcalError as error:
            self._calibration = None
            self._board.show(cell=Cell(), view=None)
            self._node.get_logger().warning(f"the plan cannot be drawn: {error}")
            return
        finally:
            self.loading = False
        self._board.show(
            cell=page_sections.cell_section(self._calibration, self._node.get_namespace()),
            view=page_sections.plan_view(self._calibration),
        )
        self._show_task()

    def _take_deviations(self, message: DeviationArray) -> None:
        if self._calibration and message.plan_id == self._calibration.configuration.plan_id:
            identity = self._calibration.configuration.identity
            found = page_sections.deviations_section(message, identity)
            self._board.show(deviations=found)
            ecc = next((c for c in found.curves if c.name == "ECC"), None)
            known = [u for u in ecc.expanded if u is not None] if ecc else []
            self.uncertainty = max(known) * ARCSEC if known else None
            self.withheld = found.withheld

    def _take_observation(self, message: ObservationMsg) -> None:
        if not message.accepted:
            place = place_in_words(message.table_index, message.target, message.attempt)
            row = RejectedAttempt(time.time(), place, message.reason)
            self._rejections.appendleft(row)
            self._board.show(rejections=tuple(self._rejections))

    def _take_pause(self, message: Pause) -> None:
        self._pause = message
        self._show_task()

    def _show_task(self) -> None:
        """Show what the latest pause is for, once its plan has come too."""
        known, pause = self._calibration, self._pause
        ours = known is not None and known.configuration.plan_id == pause.plan_id
        self._board.show(
            task=page_sections.operator_task(known, pause) if known and ours else None
        )

    def _take_log(self, message: Log) -> None:
        if message.level >= LoggingSeverity.WARN:
            error = message.level >= LoggingSeverity.ERROR
            when_s = stamp_ns(message.stamp) * NANOSECOND
            name = message.name.rpartition(".")[2]
            self._log.appendleft(LogLine(when_s, error, name, message.msg))
            self._board.show(log=tuple(self._log))

    def _point(self, order: Command) -> None:
        if self._calibration is None:
            return
        step = self._calibration.plan.steps[order.step]
        place = self._calibration.instrument_place(step)
        angle_deg = round(order.table_angle / DEGREE, 3)
        self._visited[angle_deg % 360.0] = None
        self._board.show(
            pointing=OrderedStep(
                place=step.describe(order.attempt),
                table_angle_deg=angle_deg,
                target=page_sections.seen_from_above(order.position),
                stand=None if place is None else page_sections.seen_from_above(place),
                visited_deg=tuple(self._visited),
            )
        )


RATE_S: Final = 4.0
LENGTHS_S: Final = 60.0
LENGTH_POINTS: Final = 400
TEMPERATURE_PERIOD_S: Final = 5.0
VALID: Final = "valid."
WORDS: Final = {
    LengthStatus.BEAM_BROKEN.name: phrase("beam broken"),
    LengthStatus.UNSTABLE.name: phrase("unstable"),
    LengthStatus.UNKNOWN.name: phrase("state unknown"),
}
HOUR_S: Final = 3600.0


class CaptureValues:
    """Takes the values of the capture, beat by beat."""

    def __init__(self) -> None:
        self._counts: dict[str, deque[tuple[float, int]]] = {}
        self._lengths: deque[tuple[float, float]] = deque(maxlen=LENGTH_POINTS)
        self._courses: dict[str, ValueHistory] = {}
        self._ranges: dict[str, tuple[float, float]] = {}
        self._latest: dict[str, float] = {}
        self._offered_s: dict[str, float] = {}
        self._values: Mapping[str, str] = {}

    def receive(self, values: Mapping[str, str]) -> None:
        """Take the values of a beat."""
        self._values, now = values, time.monotonic()
        for key, value in values.items():
            if key.startswith(VALID):
                counts = self._counts.setdefault(key.removeprefix(VALID), deque())
                counts.append((now, int(value)))
                while now - counts[0][0] > RATE_S:
                    counts.popleft()
        if words := self._reading(names.TRACER_LENGTH):
            length = float(words[0]) * 1e3
            if math.isfinite(length):
                self._lengths.append((round(time.time(), 1), round(length, 4)))
        self._feel()

    def streams(self) -> tuple[TopicState, ...]:
        """Return rate and silence of every topic that was heard."""
        found = []
        for topic, counts in sorted(self._counts.items()):
            (begun_s, first), (end_s, last) = counts[0], counts[-1]
            rate = (last - first) / (end_s - begun_s) if end_s > begun_s else 0.0
            silent = self._values.get(f"{SILENT}{topic}")
            found.append(
                TopicState(topic, round(rate, 1), None if silent is None else float(silent))
            )
        return tuple(found)

    def lengths(self) -> LiveReading | None:
        """Return the live reading: a length, else the probe's position; None before the first."""
        if words := self._reading(names.TRACER_LENGTH):
            length = float(words[0]) * 1e3
            shown = f"{length:.4f} mm" if math.isfinite(length) else "–"
            return LiveReading(phrase("Length"), shown, WORDS.get(words[1], ""))
        if words := self._reading(names.PROBE_POINT):
            at = "  ".join(f"{float(x) * 1e3:.3f}" for x in words)
            return LiveReading(phrase("Probe x y z"), f"{at} mm", "")
        return None

    def table_deg(self) -> float | None:
        """Return where the table stands, to 0.1 deg; None before its first reading."""
        words = self._reading(names.JOINT_STATES)
        return round(float(words[0]) / DEGREE, 1) % 360.0 if words else None

    def length_course(self) -> Points:
        """Return the lengths of the last minute, in whole seconds between two changes."""
        until_s = int(time.time())
        return tuple((t, x) for t, x in self._lengths if until_s - LENGTHS_S < t <= until_s)

    def temperatures(self) -> tuple[Temperature, ...]:
        """Return the temperatures of every sensor."""
        return tuple(
            Temperature(sensor, now, *self._ranges[sensor], drift_k_per_h(points), points)
            for sensor, now in sorted(self._latest.items())
            for points in [self._courses[sensor].points]
        )

    def _feel(self) -> None:
        """Take the temperature of the sensor that spoke last."""
        words = self._reading(names.TEMPERATURE)
        if not words or not math.isfinite(value := float(words[0])):
            return
        sensor, now_s = " ".join(words[1:]), round(time.time(), 1)
        course = self._courses.setdefault(sensor, ValueHistory())
        if now_s - self._offered_s.get(sensor, -math.inf) >= TEMPERATURE_PERIOD_S:
            self._offered_s[sensor] = now_s  # the history may have left it out
            course.add(now_s, value)
        low, high = self._ranges.get(sensor, (value, value))
        self._ranges[sensor] = min(low, value), max(high, value)
        self._latest[sensor] = round(value, 3)

    def _reading(self, topic: str) -> list[str]:
        return self._values.get(f"{NOW}{topic}", "").split()


def drift_k_per_h(course: Points) -> float | None:
    """Return the slope (K/h) of the best line through the last hour; None in the first minute."""
    last = [(t, y) for t, y in course if t >= course[-1][0] - HOUR_S]
    if len(last) < 3 or last[-1][0] - last[0][0] < 60.0:
        return None
    return round(linear_regression(*zip(*last, strict=True)).slope * HOUR_S, 3)


BRIDGE: Final = "bridge"
MOST_ANGLES: Final = 120
SILENCE_S: Final = 10.0
"""After this long without an answer the bridge is asked for the drawing again."""
UNDRAWN: Final = phrase("it is not drawn yet")


class PendingTable:
    """Follows the bridge; ``offer`` is None while no table has come to it.

    What the controller would add is asked of the bridge itself, so that the drawing shows what
    will be applied. Without the drawing nothing can be confirmed.
    """

    def __init__(self, node: CellNode) -> None:
        self._node = node
        self._table: Any = None
        self._asked_for = self._drawn_for = self._applied = ""
        self._attempt: object = None
        self._heard_s = 0.0
        self._drawing: dict[str, tuple[float, ...]] = {}
        node.listen(CompensationTableMsg, "compensation_table", self._take, LATCHED)
        self._look_up = node.create_client(GetCorrection, "get_correction")
        self._apply = node.create_client(ApplyTable, "apply")

    def offer(self) -> ShownOffer | None:
        """Return the present offer of the bridge."""
        health = self._node.health
        values = health.values(BRIDGE) if BRIDGE in health.present() else {}
        if "table_hash" not in values:
            return None
        confirmation, why_not = values.get("confirmation", ""), ""
        if OFFERED not in values:
            withheld = values.get(WITHHELD)
            refused = phrase("the bridge does not offer it")
            why_not = phrase("not offered: {0}", withheld) if withheld else refused
        if not confirmation:
            why_not = health.describe(BRIDGE)
        elif never := values.get(NEVER):
            why_not = never
        elif self._drawn_for != confirmation:
            why_not = why_not or UNDRAWN
            self._see_to_the_drawing(confirmation, values["table_hash"])
        return ShownOffer(
            confirmation=confirmation,
            table_hash=values["table_hash"],
            verdict=phrase(values.get("verdict", "")),
            in_force=values.get("in_force", ""),
            residual=values.get("residual", ""),
            bridge=health.describe(BRIDGE),
            why_not=why_not,
            applied=bool(confirmation) and confirmation == self._applied,
            simulated=self._table is not None
            and self._table.table_hash == values["table_hash"]
            and bool(self._table.simulated),
            **(self._drawing if confirmation == self._drawn_for else {}),
        )

    async def apply(self, confirmation: str, secret: str) -> ActionOutcome:
        """Have the bridge feed the table with this hash to the controller."""
        if not self._apply.service_is_ready():
            return ActionOutcome(False, phrase("the bridge does not offer to apply a table"))
        request = ApplyTable.Request(confirmation=confirmation, secret=secret)
        answer = await self._apply.call_async(request)
        if answer.success:
            self._applied = confirmation
        return ActionOutcome(answer.success, answer.message)

    def _take(self, message: Any) -> None:
        self._table = message

    def _see_to_the_drawing(self, confirmation: str, table_hash: str) -> None:
        """Ask for the drawing, again if an answer was lost."""
        silent = time.monotonic() - self._heard_s > SILENCE_S
        if (silent or self._asked_for != confirmation) and self._can_draw(table_hash):
            self._asked_for, self._attempt = confirmation, object()
            self._heard_s = time.monotonic()
            self._node.begin(self._draw, confirmation, self._table, self._attempt)

    def _can_draw(self, table_hash: str) -> bool:
        """Return whether the table of the bridge has arrived here too, and the bridge answers."""
        known = self._table is not None and self._table.table_hash == table_hash
        return known and bool(self._look_up.service_is_ready())

    async def _draw(self, confirmation: str, table: Any, attempt: object) -> None:
        """Draw the correction at the rows.

        The measured deviations are what the previous one left.
        """
        every = max(1, ceil(len(table.angles) / MOST_ANGLES))
        angles = np.array(table.angles[::every])
        drawing = {"angles_deg": _rounded(angles / DEGREE)}
        columns = {Approach.POSITIVE: ("", table.correction_forward),
                   Approach.NEGATIVE: ("_reverse", table.correction_reverse)}  # fmt: skip
        for side, (suffix, measured) in columns.items():
            answers = await self._ask(angles, side, attempt)
            if answers is None:
                return
            after = np.array([a.correction for a in answers])
            std = np.array([a.std for a in answers])
            # What the table in force adds already is what this one adds less what was measured.
            drawing[f"before{suffix}_arcsec"] = _rounded((after - measured[::every]) / ARCSEC)
            drawing[f"after{suffix}_arcsec"] = _rounded(after / ARCSEC)
            drawing[f"expanded{suffix}_arcsec"] = _rounded(COVERAGE_FACTOR * std / ARCSEC)
        self._drawn_for, self._drawing = confirmation, drawing

    async def _ask(self, angles: Floats, side: Approach, attempt: object) -> list[Any] | None:
        """Return the bridge's answers; None when one fails, or another attempt has begun.

        One after the other: a service holds ten requests and drops the rest.
        """
        answers = []
        for angle in angles:
            request = GetCorrection.Request(angle=float(angle), approach=int(side))
            answers.append(await self._look_up.call_async(request))
            if attempt is not self._attempt or not answers[-1].success:
                return None
            self._heard_s = time.monotonic()
        return answers


def _rounded(values: Any) -> tuple[float, ...]:
    return tuple(round(float(v), 4) for v in values)


def main() -> None:
    """Run the operator's page."""
    run_node(OperatorPage)


if __name__ == "__main__":
    main()
