"""The capture node: streams in, observations out."""

from __future__ import annotations

import math
import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

from rclpy.node import Node
from rotcal_msgs.msg import CalibrationPlan, ProbePoint, ProbeTarget, TableAngle, TracerLength
from rotcal_msgs.msg import Observation as ObservationMsg
from sensor_msgs.msg import JointState, Temperature

from rotcal_ros.capture import Capture, Record
from rotcal_ros.nodes import conversions
from rotcal_ros.nodes.draining import Batch, InstrumentSubscription
from rotcal_ros.nodes.health import Health
from rotcal_ros.nodes.plan_message import calibration_of, run_name
from rotcal_ros.nodes.qos import EVENT, LATCHED
from rotcal_ros.nodes.running import run_node
from rotcal_ros.observations import LengthStatus

CONTINUOUS = ("tracer_length", "joint_states")
"""Streams that never pause: their silence means that the instrument is lost."""
TRACER_FRAME = "tracer"


class CaptureNode(Node):
    """Feeds the capture of the announced plan and publishes what it finds."""

    def __init__(self) -> None:
        super().__init__("capture")
        self._joint = ""
        self._capture: Capture | None = None
        self._run = ""
        self._state = "waiting for a plan"
        self._needed: tuple[str, ...] = ()
        self._valid: Counter[str] = Counter()
        self._heard_s: dict[str, float] = {}
        self._verdicts: Counter[str] = Counter()
        self._orders: dict[tuple[int, int], Any] = {}
        self._health = Health(self, self._report)
        self._observations = self.create_publisher(ObservationMsg, "observation", EVENT)
        self.create_subscription(
            CalibrationPlan, "plan", self._health.guarded(self._take_plan), LATCHED
        )
        self._listen(TracerLength, "tracer_length", self._tracer)
        self._listen(JointState, "joint_states", self._table)
        self._listen(ProbePoint, "probe_point", self._probe)
        self._listen(Temperature, "temperature", self._temperature)
        for kind, topic in ((TableAngle, "table_angle"), (ProbeTarget, "probe_target")):
            self.create_subscription(kind, topic, self._health.guarded(self._order), EVENT)

    def begin_stop(self) -> None:
        """Say goodbye."""
        self._health.leave()

    def stopped(self) -> bool:
        """Return True: there is nothing to finish."""
        return True

    def _listen(
        self, kind: type, topic: str, convert: Callable[[Any], tuple[Record | None, bool]]
    ) -> None:
        """Subscribe to an instrument; ``convert`` returns (record, whether it is valid)."""

        def handle(batch: Batch) -> None:
            self._heard_s[topic] = time.monotonic()
            for message, _ in batch:
                record, valid = convert(message)
                self._valid[topic] += valid
                if record is not None:
                    self._feed(record)

        InstrumentSubscription(self, kind, topic, self._health.guarded(handle))

    def _tracer(self, message: TracerLength) -> tuple[Record, bool]:
        sample = conversions.tracer_sample(message)
        return sample, sample.status == LengthStatus.OK and math.isfinite(sample.length)

    def _table(self, message: JointState) -> tuple[Record | None, bool]:
        sample = conversions.table_sample(message, self._joint)
        return sample, sample is not None and math.isfinite(sample.angle)

    def _probe(self, message: ProbePoint) -> tuple[Record, bool]:
        sample = conversions.probe_sample(message)
        return sample, all(map(math.isfinite, sample.position))

    def _temperature(self, message: Temperature) -> tuple[Record, bool]:
        sample = conversions.temperature_sample(message)
        return sample, math.isfinite(sample.temperature_c)

    def _order(self, message: TableAngle | ProbeTarget) -> None:
        """Feed an order once both of its messages are here, whichever comes first."""
        key = (message.step, message.attempt)
        other = self._orders.pop(key, None)
        if other is None or type(other) is type(message):
            self._orders = {key: message}
            return
        pair = (message, other) if isinstance(message, TableAngle) else (other, message)
        self._feed(conversions.command(*pair))

    def _feed(self, record: Record) -> None:
        if self._capture is None:
            return
        for observation in self._capture.feed(record):
            self._verdicts["accepted" if observation.accepted else "rejected"] += 1
            self._observations.publish(conversions.observation_message(observation, TRACER_FRAME))

    def _take_plan(self, message: CalibrationPlan) -> None:
        self._capture, self._run = None, ""
        try:
            calibration = calibration_of(message)
            self._joint = calibration.configuration.cell.joint
            self._capture = calibration.capture(message.run)
        except Exception as error:
            self._state = f"plan refused: {error}"
            raise
        self._run, self._needed = run_name(message), calibration.method.topics
        self._verdicts.clear()
        self._state = f"capturing {calibration.method.name}"

    def _report(self) -> tuple[str, dict[str, Any]]:
        now = time.monotonic()
        values: dict[str, Any] = {"run": self._run, **self._verdicts}
        values |= {f"valid.{topic}": self._valid[topic] for topic in self._heard_s}
        for topic in set(CONTINUOUS) & set(self._needed) & self._heard_s.keys():
            values[f"silent_s.{topic}"] = f"{now - self._heard_s[topic]:.2f}"
        if self._capture is not None:
            for stream, counts in self._capture.counts.items():
                values |= {f"{stream}.{name}": n for name, n in counts.items()}
            values["waiting_for"] = self._capture.waiting_for
            for remark in self._capture.remarks():
                self.get_logger().warning(remark, throttle_duration_sec=1.0)
        return self._state, values


def make() -> Node:
    """Return the node."""
    return CaptureNode()


def main(args: Sequence[str] | None = None) -> None:
    """Run the capture node."""
    sys.exit(run_node(make, args))


if __name__ == "__main__":
    main()
