"""The capture node: streams in, observations out."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable
from typing import Any

from rotcal_msgs.msg import CalibrationPlan, ProbePoint, TracerLength
from rotcal_msgs.msg import Observation as ObservationMsg
from sensor_msgs.msg import FluidPressure, JointState, RelativeHumidity, Temperature

from rotcal_ros import messages
from rotcal_ros.bags import names
from rotcal_ros.capture import Capture, CaptureSettings, Record
from rotcal_ros.capture.stamp_offsets import StampOffsets
from rotcal_ros.nodes import conversions
from rotcal_ros.nodes.capture_news import CaptureNews
from rotcal_ros.nodes.cell_node import CellNode
from rotcal_ros.nodes.draining import Batch, arrivals
from rotcal_ros.nodes.instrument_topics import InstrumentTopics
from rotcal_ros.nodes.joint_readings import JointReadings
from rotcal_ros.nodes.latest import NOW, WAITING_FOR, reading
from rotcal_ros.nodes.planners_plans import PlannersPlans
from rotcal_ros.nodes.plans import REFUSED, RUN, calibration_of, run_name
from rotcal_ros.nodes.qos import EVENT
from rotcal_ros.nodes.roll_call import LOADING
from rotcal_ros.nodes.running import run
from rotcal_ros.observations import (
    HumiditySample,
    LengthStatus,
    PressureSample,
    ProbeSample,
    TableSample,
    TemperatureSample,
    TracerSample,
)

CONTINUOUS = (names.TRACER_LENGTH, names.JOINT_STATES)
"""Streams that never pause: their silence means that the instrument is lost."""
TIMED = (*CONTINUOUS, names.PROBE_POINT)
"""Streams by whose stamps an observation is made: their clocks must agree."""


class CaptureNode(CellNode):
    """Feeds the capture of the announced plan and publishes what it finds."""

    def __init__(self) -> None:
        super().__init__("capture")

    def configure(self) -> None:
        """Hear the instruments."""
        self._joint = ""
        self._capture: Capture | None = None
        self._run = ""
        self._state = "waiting for a plan"
        self._needed: tuple[str, ...] = ()
        self._valid: Counter[str] = Counter()
        self._heard_s: dict[str, float] = {}
        self._latest: dict[str, Record] = {}
        self._verdicts: Counter[str] = Counter()
        self._joints = JointReadings()
        self._instruments = InstrumentTopics(self, self._switched)
        self._offsets = StampOffsets(CaptureSettings().stamp_offset_s)
        self._news = CaptureNews(self.health, self.get_logger())
        self._observations = self.create_publisher(ObservationMsg, names.OBSERVATION, EVENT)
        PlannersPlans(self, self._take_plan)
        self._listen(TracerLength, names.TRACER_LENGTH, messages.tracer_sample)
        self._listen(JointState, names.JOINT_STATES, self._table_sample)
        self._listen(ProbePoint, names.PROBE_POINT, messages.probe_sample)
        self._listen(Temperature, names.TEMPERATURE, messages.temperature_sample)
        self._listen(FluidPressure, names.AIR_PRESSURE, messages.pressure_sample)
        self._listen(RelativeHumidity, names.RELATIVE_HUMIDITY, messages.humidity_sample)
        self._orders = self.take_orders(self._feed)

    def deactivated(self) -> None:
        """Feed nothing more: what an instrument says in between is missing from every window."""
        self._capture, self._run, self._state = None, "", "waiting for a plan"
        self._orders.clear()

    def _listen(self, kind: type, topic: str, convert: Callable[[Any], Record | None]) -> None:
        """Subscribe to an instrument."""

        def handle(batch: Batch) -> None:
            self._heard_s[topic] = time.monotonic()
            sim_ns = self.now_ns() if self.health.sim.used else 0
            for stamp_ns, received_ns in arrivals(batch, sim_ns) if topic in TIMED else ():
                self._offsets.note(topic, stamp_ns, received_ns)
            for message, _ in batch:
                record = convert(message)
                if record is not None:
                    self._latest[topic] = record
                    self._valid[topic] += _is_valid(record)
                    self._feed(record)

        self._instruments.listen(kind, topic, self.health.guarded(handle))

    def _switched(self, topic: str) -> None:
        """Forget what was heard of an instrument that comes from another topic now."""
        for known in (self._heard_s, self._latest, self._valid):
            known.pop(topic, None)

    def _table_sample(self, message: JointState) -> Record | None:
        """Return the feedback of the table; note what the topic says of its joints."""
        self._joints.note(message, self._joint)
        return messages.table_sample(message, self._joint)

    def _feed(self, record: Record) -> None:
        if self._capture is None or not self.active:
            return
        for observation in map(self._offsets.judged, self._capture.feed(record)):
            self._verdicts["accepted" if observation.accepted else "rejected"] += 1
            self._news.observed(observation)
            self._observations.publish(conversions.observation_message(observation))

    def _take_plan(self, message: CalibrationPlan) -> None:
        self._capture, self._run = None, ""
        self._orders.clear()
        self._news.begin()
        self._state = LOADING
        self.health.beat()
        try:
            calibration = calibration_of(message)
            self._joint = calibration.configuration.cell.joint
            self._instruments.use(calibration.configuration)
            self._capture = calibration.capture(message.run)
            self._offsets.limit_s = calibration.configuration.capture.stamp_offset_s
        except Exception as error:
            self._state = f"{REFUSED}: {error}"
            raise
        self._run, self._needed = run_name(message), calibration.method.topics
        # what came while this node was loading waits to be read: the instruments were not silent
        self._heard_s = dict.fromkeys(self._heard_s, time.monotonic())
        self._verdicts.clear()
        self._state = f"capturing {calibration.method.name}"

    def _report(self) -> tuple[str, dict[str, Any]]:
        now = time.monotonic()
        values: dict[str, Any] = {RUN: self._run, **self._verdicts, **self._instruments.values()}
        values |= {f"valid.{topic}": self._valid[topic] for topic in self._heard_s}
        values |= {f"{NOW}{topic}": reading(record) for topic, record in self._latest.items()}
        values |= self._joints.values()
        for topic in set(CONTINUOUS) & set(self._needed) & self._heard_s.keys():
            values[f"silent_s.{topic}"] = f"{now - self._heard_s[topic]:.2f}"
        self._news.offset(self._offsets.in_words())
        if self._capture is not None:
            for stream, counts in self._capture.counts.items():
                values |= {f"{stream}.{name}": n for name, n in counts.items()}
            values[WAITING_FOR] = self._capture.waiting_for
            self._news.complain(self._capture.complaint())
            for remark in self._capture.remarks():
                self.get_logger().warning(remark, throttle_duration_sec=1.0)
        return self._state, values


def _is_valid(record: Record) -> bool:
    """Return whether an instrument measures: a preflight waits for it."""
    match record:
        case (
            TracerSample(status=LengthStatus.OK, length=number)
            | TableSample(angle=number)
            | TemperatureSample(temperature_c=number)
            | PressureSample(pressure_pa=number)
            | HumiditySample(humidity=number)
        ):
            return math.isfinite(number)
        case ProbeSample():
            return all(map(math.isfinite, record.position))
    return False


def main() -> None:
    """Run the capture node."""
    run(CaptureNode)


if __name__ == "__main__":
    main()
