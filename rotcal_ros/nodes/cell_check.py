"""Listening to a cell without taking part in it: python -m rotcal_ros.nodes.cell_check.

Prints what was found as JSON, see :class:`~rotcal_ros.catalogue.check_lines.CellReport`. The
suite's own capture listens, under a hidden name and with what it says kept to itself, and the
planner's preflight judges: what is good here is good there.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Final

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rotcal_msgs.msg import CalibrationPlan

from rotcal_ros.bags import names
from rotcal_ros.bags.topic_settings import TopicSettings
from rotcal_ros.capture.stamp_offsets import OffsetLimits, StampOffsets
from rotcal_ros.catalogue import Calibration, Configuration
from rotcal_ros.catalogue.calibration import prepare_to_measure
from rotcal_ros.catalogue.check_lines import CellReport, CheckLine
from rotcal_ros.catalogue.configuration import changed, parse_configuration, read_configuration
from rotcal_ros.catalogue.dry_run import DryRun
from rotcal_ros.catalogue.method import DEFAULT
from rotcal_ros.errors import BagError
from rotcal_ros.instruments.conventions import Conventions
from rotcal_ros.middleware import discovery_in_words
from rotcal_ros.nodes.capture import CaptureNode
from rotcal_ros.nodes.cell_graph import CellGraph
from rotcal_ros.nodes.channels import message_type
from rotcal_ros.nodes.check_adapter import GROUP, AdapterEars
from rotcal_ros.nodes.check_drivers import driver_lines
from rotcal_ros.nodes.check_frames import FramesHeard
from rotcal_ros.nodes.check_heard import Heard
from rotcal_ros.nodes.check_neighbours import cell_lines
from rotcal_ros.nodes.check_safety import safety_lines
from rotcal_ros.nodes.check_streams import clock_line, stream_lines
from rotcal_ros.nodes.check_table import machine_lines, table_start
from rotcal_ros.nodes.concerns import OFFSET
from rotcal_ros.nodes.header_watch import HeaderWatch, watch_headers
from rotcal_ros.nodes.instrument_streams import TIMED
from rotcal_ros.nodes.qos import LATCHED
from rotcal_ros.nodes.running import EndRequest, leave_with
from rotcal_ros.nodes.steady import steady_timer
from rotcal_ros.nodes.topic_names import TOPIC
from rotcal_ros.sessions.domains import domains_in_use

NAME: Final = "cell_check"
EARS: Final = "_cell_check_ears"
STREAMS: Final = (
    names.JOINT_STATES, names.PROBE_POINT, names.TRACER_LENGTH, names.TEMPERATURE,
    names.AIR_PRESSURE, names.RELATIVE_HUMIDITY,
)  # fmt: skip
_OWN_TOPICS: Final = (
    "heartbeat", "/diagnostics", names.PLAN, names.OBSERVATION, names.TABLE_ANGLE,
    names.PROBE_TARGET,
)  # fmt: skip
"""What a capture says or obeys: here it neither says nor obeys anything."""
_LOOK_S: Final = 0.1
_NO_CONFIGURATION: Final = f"/**: {{ros__parameters: {{method: {DEFAULT}}}}}"


class Listening:
    """The nodes that listen: the hidden capture, and one that looks at graph and headers."""

    def __init__(self) -> None:
        private = [f"{topic}:=~/{topic.strip('/')}" for topic in _OWN_TOPICS]
        rules = [f"capture:__node:={EARS}", *(f"{EARS}:{rule}" for rule in private)]
        arguments = [word for rule in rules for word in ("-r", rule)]
        rclpy.init(
            args=[*sys.argv, "--ros-args", *arguments],
            signal_handler_options=SignalHandlerOptions.NO,
        )
        self.node = Node(NAME)
        self._ears = CaptureNode()
        self._ears.autostart()
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.executor.add_node(self._ears)
        self.headers: dict[str, HeaderWatch] = {}
        self._offsets = StampOffsets(OffsetLimits())
        self._conventions = Conventions(TopicSettings())
        self.frames = FramesHeard(self.node)
        self._adapter: AdapterEars | None = None
        steady_timer(self.node, _LOOK_S, self._look)

    def announce(self, calibration: Calibration) -> None:
        """Let the ears know what they listen for, as a planner does."""
        configuration = calibration.configuration
        if GROUP in configuration.given:
            self._adapter = AdapterEars(self.node, configuration)
            heard = [f"topics.joint_states={self._adapter.topic}"]
            configuration = changed(configuration, heard)  # what the adapter will pass on
        self._conventions = Conventions(configuration.topics)
        self._plans = self._ears.create_publisher(CalibrationPlan, names.PLAN, LATCHED)
        self._plans.publish(
            CalibrationPlan(
                plan_id=configuration.plan_id,
                method=configuration.method.name,
                configuration=configuration.text,
                total_steps=len(calibration.plan.steps),
            )
        )

    def heard(self, configuration: Configuration, calibration: Calibration | None) -> Heard:
        """Return what came so far."""
        _, values = self._ears._report()
        concerns = {**values, **self._ears.health.concerns, **self._ears.health.alarms}
        words = {key: str(value) for key, value in concerns.items()}
        self._offsets.limits = OffsetLimits.of(configuration.capture)
        if clocks := self._offsets.in_words():  # also of a stream that is of no other use
            words.setdefault(OFFSET, clocks)
        compared = self._offsets.compared()
        graph = CellGraph(self.node)
        return Heard(
            graph, words, self.headers, configuration, calibration, compared, self._adapter
        )

    def _stamped(self, topic: str, stamp_ns: int, sent_ns: int, received_ns: int) -> None:
        if topic in TIMED:
            taken_ns = self._conventions.taken_ns(topic, stamp_ns, sent_ns)
            self._offsets.note(topic, taken_ns, received_ns)

    def _look(self) -> None:
        """Listen to the headers of every stream once it is there."""
        _, values = self._ears._report()
        for topic in STREAMS:
            name = values.get(TOPIC + topic) or self.node.resolve_topic_name(topic)
            infos = self.node.get_publishers_info_by_topic(name)
            if infos and topic not in self.headers:
                with suppress(BagError):  # a type that is not installed; its line names it
                    kind = message_type(infos[0].topic_type)
                    self.headers[topic] = watch_headers(
                        self.node, kind, name, partial(self._stamped, topic)
                    )


def _configuration(path: str) -> Configuration:
    if path:
        return read_configuration(Path(path))
    return parse_configuration(_NO_CONFIGURATION, "no configuration")


def _lines(
    heard: Heard, frames: FramesHeard, calibration: Calibration | None
) -> Iterator[CheckLine]:
    yield from cell_lines(heard)
    yield from stream_lines(heard)
    yield from machine_lines(heard)
    yield from driver_lines(heard)
    yield from safety_lines(heard)
    yield clock_line(heard)
    yield from frames.lines(heard)
    if calibration is not None:
        tracer = heard.headers.get(names.TRACER_LENGTH)
        rate = tracer.rate_hz if tracer is not None else None
        yield from DryRun(calibration, table_start(heard), rate).lines()


def _work() -> None:
    end = EndRequest()
    before = domains_in_use()
    listening = Listening()
    path = listening.node.declare_parameter("configuration_file", "").value
    seconds = listening.node.declare_parameter("seconds", 5.0).value
    configuration = _configuration(path)
    calibration = prepare_to_measure(configuration) if path else None
    if calibration is not None:
        listening.announce(calibration)
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline and not end:
        listening.executor.spin_once(timeout_sec=_LOOK_S)
    if end:
        return
    heard = listening.heard(configuration, calibration)
    report = CellReport(
        namespace=listening.node.get_namespace(),
        place=discovery_in_words(os.environ),
        seconds=seconds,
        lines=tuple(_lines(heard, listening.frames, calibration)),
        domains=before,
    )
    sys.stdout.write(json.dumps(asdict(report)) + "\n")
    sys.stdout.flush()


def main() -> None:
    """Listen, print what was found, and leave."""
    leave_with(_work)


if __name__ == "__main__":
    main()
