"""The capture node: turns the streams of the instruments into observations."""

from __future__ import annotations

import time
from collections import Counter
from typing import Any, Final

from rotcal_msgs import msg
from std_srvs.srv import Trigger

from rotcal_ros.bags import names
from rotcal_ros.capture import Capture, Record
from rotcal_ros.capture.instruments.steps import Order, StepFinder
from rotcal_ros.capture.publishers import RUN, unique_run_name
from rotcal_ros.capture.rejections import Rejections, reason_kind
from rotcal_ros.capture.stamp_offsets import StampOffsets
from rotcal_ros.foundation.node_state import LOADING, NO_PLAN, NodeState, State, Why
from rotcal_ros.foundation.observations import Command, Observation
from rotcal_ros.nodes.capture.instrument_streams import InstrumentStreams
from rotcal_ros.nodes.runtime import announced_plan, beat_values, conversions
from rotcal_ros.nodes.runtime.cell_node import CellNode
from rotcal_ros.nodes.runtime.qos import EVENT
from rotcal_ros.nodes.runtime.running import run_node

READINGS_S: Final = 0.01
"""During a calibration readings are collected for this time and handled together."""
PERIOD_S: Final = 0.02
"""How often it is checked whether a length is wanted."""
PATIENCE_S: Final = 2.0
"""A reading may arrive this long after the answer before it is asked for again."""
ANSWER_S: Final = 30.0
"""An instrument may take this long to answer."""


class CaptureWarnings:
    """Reports rejections and what prevents a measurement, each kind once."""

    def __init__(self, health: Any, logger: Any) -> None:
        self._health, self._logger = health, logger
        self.begin()

    def begin(self) -> None:
        """Forget what belongs to an earlier plan."""
        self._rejections, self._kinds = Rejections(), dict[str, str]()
        for key in (beat_values.REJECTED, beat_values.COMPLAINT):
            beat_values.set_warning(self._health, key, None)

    def observed(self, observation: Observation) -> None:
        """Note an observation: three rejected in a row are an error, fewer a warning."""
        if line := self._rejections.note(observation, time.monotonic()):
            self._logger.warning(line)
        alarm, text = self._rejections.is_alarming, self._rejections.describe()
        beat_values.set_warning(self._health, beat_values.REJECTED, text, alarm=alarm)
        if text:
            self._health.beat()  # at once: the goal may end with this rejection

    def complain(self, text: str | None) -> None:
        """Report what is wrong with the present order; None: nothing."""
        self._tell(beat_values.COMPLAINT, text)

    def offset(self, offsets: StampOffsets) -> None:
        """Report streams whose clocks differ too much, or seem to differ a little."""
        self._tell(beat_values.OFFSET, offsets.reason_to_reject())
        self._tell(beat_values.CLOCK_DOUBT, offsets.doubt())

    def _tell(self, key: str, text: str | None) -> None:
        """Show a text while it holds; each kind has one line."""
        if text and reason_kind(text) != self._kinds.get(key):
            self._logger.warning(text)
            self._kinds[key] = reason_kind(text)
        beat_values.set_warning(self._health, key, text)


class CaptureNode(CellNode):
    """Feeds the capture of the announced plan and publishes what it finds."""

    def __init__(self) -> None:
        super().__init__("capture")

    def configure(self) -> None:
        """Subscribe to instruments, plans and orders."""
        announced_plan.load_method(self)
        self._capture: Capture | None = None
        self._finder: StepFinder | None = None
        self._run, self._state = "", NO_PLAN
        self._needed: tuple[str, ...] = ()
        self._verdicts: Counter[str] = Counter()
        self._trigger = LengthTrigger(self)
        self._warnings = CaptureWarnings(self.health, self.get_logger())
        self._observations = self.create_publisher(msg.Observation, names.OBSERVATION, EVENT)
        announced_plan.PlanSubscription(self, self._take_plan)
        self._instruments = InstrumentStreams(self, self._hear)
        self._orders = self.take_orders(self._take_order)
        self.every(PERIOD_S, self._ask)

    def batch_period_s(self) -> float:
        """Collect readings: an observation has to wait for a window of them anyway."""
        return self.idle_batch_period_s() or READINGS_S

    def deactivated(self) -> None:
        """Stop capturing: readings that come meanwhile are missing from every window."""
        self._capture, self._finder, self._run = None, None, ""
        self._state = NO_PLAN
        self._orders.clear()

    def _take_order(self, command: Command) -> None:
        self._hear(Order(command, self._orders.stamp_ns))

    def _hear(self, record: Any) -> None:
        """Feed a record to the capture, after finding the step of a position that names none."""
        if self._finder is not None and self.active:
            for understood in self._finder.understood(record):
                self._feed(understood)

    def _ask(self) -> None:
        """Ask for a length where the instrument measures on request."""
        if self._capture is not None:
            self._trigger.poll(self._capture.readings, wanted=self._capture.asks_for_length)

    def _feed(self, record: Record) -> None:
        if self._capture is None:
            return
        for observation in map(self._instruments.offsets.check_clocks, self._capture.feed(record)):
            self._verdicts["accepted" if observation.accepted else "rejected"] += 1
            self._warnings.observed(observation)
            self._observations.publish(conversions.observation_message(observation))

    def _take_plan(self, message: msg.CalibrationPlan) -> None:
        self._capture, self._finder, self._run = None, None, ""
        self._orders.clear()
        self._warnings.begin()
        self._state = LOADING
        self.health.beat()
        try:
            calibration = announced_plan.calibration_from_message(message)
            settings = calibration.configuration.capture
            self._instruments.use(calibration.configuration)
            topics = self._instruments.topics.settings
            self._finder = StepFinder(
                calibration.plan,
                settings,
                topics.tip_radius_m,
                ordered=True,
                single_shot=topics.probe_single_shot,
            )
            self._trigger.serve(topics.length_trigger)
            self._capture = calibration.capture(message.run)
        except Exception as error:
            self._state = NodeState.of(State.FAILED, Why.PLAN_REFUSED, error)
            raise
        self._run, self._needed = unique_run_name(message), calibration.topics
        self._instruments.restart_silence()
        self._verdicts.clear()
        self._state = NodeState.of(State.WORKING, Why.CAPTURING, calibration.method.name)

    def _report(self) -> tuple[NodeState, dict[str, Any]]:
        values: dict[str, Any] = {RUN: self._run, **self._verdicts}
        values |= self._instruments.values(self._needed)
        self._warnings.offset(self._instruments.offsets)
        if self._capture is not None:
            for stream, counts in self._capture.counts.items():
                values |= {f"{stream}.{name}": n for name, n in counts.items()}
            found = self._finder.current_fault() if self._finder is not None else None
            found = found or self._trigger.current_fault
            values[beat_values.WAITING_FOR] = found or self._capture.waiting_for or ""
            if hopeless := self._capture.why_unmeasurable():
                values[beat_values.HOPELESS] = hopeless
            self._warnings.complain(found or self._capture.current_fault())
            for remark in self._capture.remarks():
                self.get_logger().warning(remark, throttle_duration_sec=1.0)
        return self._state, values


class LengthTrigger:
    """Calls the service of an instrument that measures a length on request (std_srvs/Trigger).

    ``complaint`` says why the instrument could not measure, or that it does not answer.
    """

    def __init__(self, node: CellNode) -> None:
        self._node = node
        self._client: Any = None
        self._call: Any = None
        self._since_s, self._asked = 0.0, -1
        self.current_fault: str | None = None

    def serve(self, name: str) -> None:
        """Ask this service from now on; empty: none."""
        if self._client is not None:
            self._node.destroy_client(self._client)
        self._client = self._node.create_client(Trigger, name) if name else None
        self._call = None
        self._asked, self.current_fault = -1, None

    def poll(self, received: int, *, wanted: bool) -> None:
        """Ask for a length where one is ``wanted``; ``received`` counts the readings so far."""
        if self._client is None or not self._is_free() or not wanted:
            return
        late = time.monotonic() - self._since_s > PATIENCE_S
        if received == self._asked and not late:
            return
        if not self._client.service_is_ready():
            self.current_fault = (
                f"no node offers the service {self._client.srv_name} (length_trigger)"
            )
            return
        self._asked, self._since_s = received, time.monotonic()
        self._call = self._client.call_async(Trigger.Request())

    def _is_free(self) -> bool:
        """Return whether no answer is due; handle one that has come."""
        if self._call is None:
            return True
        if not self._call.done():
            if time.monotonic() - self._since_s <= ANSWER_S:
                return False
            silent = f"no answer to {self._client.srv_name} in {ANSWER_S:g} s"
            self.current_fault = f"the instrument took no length: {silent} (length_trigger)"
            self._client.remove_pending_request(self._call)
            self._call = None
            return True
        answer, self._call = self._call.result(), None
        self._since_s = time.monotonic()
        self.current_fault = None
        if not answer.success:
            name = self._client.srv_name
            self.current_fault = f"the instrument took no length ({name}): {answer.message}"
        return True


def main() -> None:
    """Run the capture node."""
    run_node(CaptureNode)


if __name__ == "__main__":
    main()
