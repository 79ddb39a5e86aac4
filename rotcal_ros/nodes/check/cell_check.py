"""Listens to a cell without taking part in it: python -m rotcal_ros.nodes.check.cell_check.

Prints what was found as JSON, see :class:`~rotcal_ros.methods.check_lines.CellReport`. The suite's
own capture listens under a hidden name, without publishing, and the planner's preflight judges:
what passes here passes there.

Other modules of ``check`` write the lines on streams, drivers and other nodes. This one writes
those on the frames (what headers name, what /tf_static says), on who may stop the cell, and on the
machine: the joint of its table, and who obeys the two orders.
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
from math import isfinite
from pathlib import Path
from typing import Final

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rotcal_msgs.msg import CalibrationPlan

from rotcal_ros.bags import names
from rotcal_ros.bags.settings import TopicSettings
from rotcal_ros.bags.topic_roles import TOPIC
from rotcal_ros.capture.instruments.conventions import Conventions
from rotcal_ros.capture.stamp_offsets import OffsetLimits, StampOffsets
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.foundation.escapes import printable
from rotcal_ros.foundation.middleware import discovery_in_words
from rotcal_ros.foundation.units import DEGREE
from rotcal_ros.geometry.frames import FrameTree, Pose
from rotcal_ros.methods import Calibration, Configuration
from rotcal_ros.methods.calibration import prepare_to_measure
from rotcal_ros.methods.check_lines import CellReport, CheckLine
from rotcal_ros.methods.configuration import changed, parse_configuration, read_configuration
from rotcal_ros.methods.dry_run import DryRun
from rotcal_ros.methods.method import DEFAULT
from rotcal_ros.nodes.capture.instrument_streams import TIMED
from rotcal_ros.nodes.capture.node import CaptureNode
from rotcal_ros.nodes.check.snapshot import (
    CellSnapshot,
    HeaderWatch,
    TableBehindDriver,
    brought_line,
    cell_lines,
    driver_lines,
    table_behind_driver,
    watch_headers,
)
from rotcal_ros.nodes.check.stream_lines import clock_line, stream_lines
from rotcal_ros.nodes.planner.preflight import (
    chosen_joint,
    frame_doubts,
    joint_doubts,
    joints,
    table_angle,
)
from rotcal_ros.nodes.runtime.beat_values import OFFSET
from rotcal_ros.nodes.runtime.cell_graph import ORDERS, CellGraph
from rotcal_ros.nodes.runtime.message_types import message_type
from rotcal_ros.nodes.runtime.qos import LATCHED
from rotcal_ros.nodes.runtime.running import EndRequest, run_and_exit
from rotcal_ros.nodes.runtime.static_frames import StaticFrames
from rotcal_ros.nodes.runtime.timers_and_subscriptions import steady_timer
from rotcal_ros.planning.table_motion import PUBLISH_VELOCITY
from rotcal_ros.sessions.domains import domains_in_use

NAME: Final = "cell_check"
EARS: Final = "_cell_check_ears"
"""Name of the capture that listens here; ROS hides names that begin with an underscore."""
STREAMS: Final = (
    names.JOINT_STATES, names.PROBE_POINT, names.TRACER_LENGTH, names.TEMPERATURE,
    names.AIR_PRESSURE, names.RELATIVE_HUMIDITY,
)  # fmt: skip
_OWN_TOPICS: Final = (
    names.HEARTBEAT, "/diagnostics", names.PLAN, names.OBSERVATION, names.TABLE_ANGLE,
    names.PROBE_TARGET,
)  # fmt: skip
"""What a capture usually publishes or obeys; here it does neither."""
_LOOK_S: Final = 0.1
_NO_CONFIGURATION: Final = f"/**: {{ros__parameters: {{method: {DEFAULT}}}}}"


class ListeningNodes:
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
        self._adapter: TableBehindDriver | None = None
        steady_timer(self.node, _LOOK_S, self._look)

    def announce(self, calibration: Calibration) -> None:
        """Publish the plan to the capture that listens, as a planner does."""
        configuration = calibration.configuration
        self._adapter = table_behind_driver(self.node, configuration)
        if self._adapter is not None:
            passed_on = [f"topics.joint_states={self._adapter.topic}"]
            configuration = changed(configuration, passed_on)
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

    def snapshot(
        self, configuration: Configuration, calibration: Calibration | None
    ) -> CellSnapshot:
        """Return what has come so far."""
        _, values = self._ears._report()
        concerns = {**values, **self._ears.health.concerns, **self._ears.health.alarms}
        words = {key: str(value) for key, value in concerns.items()}
        self._offsets.limits = OffsetLimits.of(configuration.capture)
        if clocks := self._offsets.reason_to_reject():  # also of a stream that is of no other use
            words.setdefault(OFFSET, clocks)
        compared = self._offsets.compared()
        graph = CellGraph(self.node)
        return CellSnapshot(
            graph, words, self.headers, configuration, calibration, compared, self._adapter
        )

    def _stamped(self, topic: str, stamp_ns: int, sent_ns: int, received_ns: int) -> None:
        if topic in TIMED:
            taken_ns = self._conventions.taken_ns(topic, stamp_ns, sent_ns)
            self._offsets.note(topic, taken_ns, received_ns)

    def _look(self) -> None:
        """Listen to the headers of every stream as soon as it appears."""
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
    snapshot: CellSnapshot, frames: FramesHeard, calibration: Calibration | None
) -> Iterator[CheckLine]:
    yield from cell_lines(snapshot)
    yield from stream_lines(snapshot)
    yield from machine_lines(snapshot)
    yield from driver_lines(snapshot)
    yield from safety_lines(snapshot)
    yield clock_line(snapshot)
    yield from frames.lines(snapshot)
    if calibration is not None:
        tracer = snapshot.headers.get(names.TRACER_LENGTH)
        rate = tracer.rate_hz if tracer is not None else None
        yield from DryRun(calibration, table_start(snapshot), rate).lines()


def _work() -> None:
    end = EndRequest()
    before = domains_in_use()
    listening = ListeningNodes()
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
    snapshot = listening.snapshot(configuration, calibration)
    report = CellReport(
        namespace=listening.node.get_namespace(),
        place=discovery_in_words(os.environ),
        seconds=seconds,
        lines=tuple(_lines(snapshot, listening.frames, calibration)),
        domains=before,
    )
    sys.stdout.write(json.dumps(asdict(report)) + "\n")
    sys.stdout.flush()


_TODO: Final = "publish the points in the machine frame, or set cell.machine_frame to its name"


class FramesHeard:
    """The static frames that were heard since this object was made."""

    def __init__(self, node: Node) -> None:
        self._static = StaticFrames(node)

    def lines(self, snapshot: CellSnapshot) -> Iterator[CheckLine]:
        """Yield which frames the headers name, and what is static among them."""
        cell, named = snapshot.configuration.cell, _by_frame(snapshot)
        if named:
            words = (f"{frame or 'no frame_id'} in {', '.join(t)}" for frame, t in named.items())
            yield CheckLine("frames", "headers", "note", "; ".join(words))
        for doubt in frame_doubts(snapshot.values, snapshot.configuration):
            yield CheckLine("frames", "probe_point", "doubt", doubt, _TODO)
        if not self._static.heard:
            found = "not heard: tf2_msgs is not installed here (a ROS installation has it)"
            yield CheckLine("frames", "tf_static", "note", found)
            return
        tree = FrameTree(self._static.frames)
        for frame in (cell.table_frame, cell.tracer_frame):
            pose = tree.pose(frame, cell.machine_frame)
            where = "not joined" if pose is None else _words(pose)
            yield CheckLine("frames", f"tf {frame}", "note", f"in {cell.machine_frame}: {where}")


def _by_frame(snapshot: CellSnapshot) -> dict[str, list[str]]:
    """Return frame -> topics that are stamped with it."""
    named: dict[str, list[str]] = {}
    for topic, watch in sorted(snapshot.headers.items()):
        for frame in watch.frames:
            named.setdefault(frame, []).append(topic)
    return named


def _words(pose: Pose) -> str:
    origin, z = (", ".join(f"{x:.4f}" for x in v) for v in (pose.origin, pose.axes[:, 2]))
    return f"at ({origin}) m, z along ({z})"


_TYPE: Final = "std_msgs/msg/Bool"


def safety_lines(snapshot: CellSnapshot) -> Iterator[CheckLine]:
    """Yield what stops the cell: a topic, names on /diagnostics, or nothing."""
    settings = snapshot.configuration.safety
    if settings.emergency_stop:
        yield _topic_line(snapshot)
    if settings.stop_on_diagnostics:
        found = f"an ERROR of {', '.join(settings.stop_on_diagnostics)} stops the cell"
        yield CheckLine("safety", "/diagnostics", "note", found)


def _topic_line(snapshot: CellSnapshot) -> CheckLine:
    """Say whether somebody publishes the emergency stop, in the type that is understood."""
    settings = snapshot.configuration.safety
    name = snapshot.graph.resolve(settings.emergency_stop)
    offers = snapshot.graph.offers(settings.emergency_stop)
    others = sorted({info.topic_type for info in offers} - {_TYPE})
    if others:
        found = f"{name} is of type {', '.join(others)}, which is not understood as a stop"
        todo = f"publish the stop as {_TYPE}, or correct safety.emergency_stop"
        return CheckLine("safety", "emergency_stop", "missing", found, todo)
    if offers:
        nodes = ", ".join(sorted({info.node_name for info in offers}))
        return CheckLine("safety", "emergency_stop", "good", f"node {nodes} publishes {name}")
    todo = "start the safety controller's node, or correct safety.emergency_stop"
    if settings.silent_s:
        found = f"nobody publishes {name}, and its silence stops the cell (safety.silent_s)"
        return CheckLine("safety", "emergency_stop", "missing", found, todo)
    if "safety.emergency_stop" in snapshot.configuration.given:
        return CheckLine("safety", "emergency_stop", "doubt", f"nobody publishes {name}", todo)
    return CheckLine("safety", "emergency_stop", "note", f"nobody publishes {name}")


_PARTS: Final = {names.TABLE_ANGLE: "table", names.PROBE_TARGET: "probe"}
_TYPES: Final = {
    names.TABLE_ANGLE: "rotcal_msgs/msg/TableAngle",
    names.PROBE_TARGET: "rotcal_msgs/msg/ProbeTarget",
}


def machine_lines(snapshot: CellSnapshot) -> Iterator[CheckLine]:
    """Yield a line for the joint and for every order."""
    if snapshot.adapter is not None:
        yield from _adapter_lines(snapshot)
    elif joints(snapshot.values):
        yield _joint_line(snapshot)
    for order in ORDERS:
        yield from _order_lines(snapshot, order)


def table_start(snapshot: CellSnapshot) -> float:
    """Return where the table stands (rad), as far as it was heard."""
    angle = table_angle(snapshot.values, snapshot.configuration)
    return angle if isfinite(angle) and not next(_doubts(snapshot), "") else 0.0


def _doubts(snapshot: CellSnapshot) -> Iterator[str]:
    return joint_doubts(snapshot.values, snapshot.configuration)


def _joint_line(snapshot: CellSnapshot) -> CheckLine:
    joint = snapshot.configuration.cell.joint
    chosen = chosen_joint(snapshot.values, joint)
    if fault := next(snapshot.joint_faults(), ""):
        there = ", ".join(map(printable, joints(snapshot.values)))
        todo = f"cell.joint: one of {there}"
        if chosen in joints(snapshot.values):
            todo = f"velocity of the joint: {PUBLISH_VELOCITY}"
        return CheckLine("table", "joint", "missing", fault, todo)
    angle, speed = joints(snapshot.values)[chosen]
    found = f"{chosen} at {angle:.6g} rad = {angle / DEGREE:.4f}°, {speed / DEGREE:.3g}°/s"
    if doubt := next(_doubts(snapshot), ""):
        return CheckLine("table", "joint", "doubt", doubt, "publish the feedback in radians")
    return CheckLine("table", "joint", "good", found)


def _order_lines(snapshot: CellSnapshot, order: str) -> Iterator[CheckLine]:
    """Yield who obeys an order, and who besides the planner gives it."""
    part, graph = _PARTS[order], snapshot.graph
    name, machines = graph.resolve(order), graph.machines(order)
    if line := brought_line(snapshot, part, order, "obeys it"):
        yield line
    elif snapshot.started_by_us and not machines:
        yield CheckLine(part, order, "note", "simulated: rotcal run starts who obeys it")
    elif why := list(graph.without_machine(order)):
        todo = f"let your machine's node subscribe to {name} ({_TYPES[order]}), volatile"
        yield CheckLine(part, order, "missing", "; ".join(why), todo)
    else:
        yield CheckLine(part, order, "good", f"node {', '.join(machines)} obeys it")
    strangers = sorted(set(graph.publishers(order)) - {"planner"})
    if strangers:
        found = f"node {', '.join(strangers)} also gives orders on {name}"
        todo = f"only the planner may order motion: stop the other publishers on {name}"
        yield CheckLine(part, order, "doubt", found, todo)


def _adapter_lines(snapshot: CellSnapshot) -> Iterator[CheckLine]:
    """Yield how the adapter would judge its joint, and whether its controller is there."""
    assert snapshot.adapter is not None
    if wrong := snapshot.adapter.wrong():
        yield CheckLine("table", "joint", "missing", wrong.found, wrong.todo)
    elif outside := snapshot.adapter.outside():
        todo = "publish the joint in rad, or correct table_adapter.lower_deg and upper_deg"
        yield CheckLine("table", "joint", "doubt", outside, todo)
    elif joints(snapshot.values):
        yield _joint_line(snapshot)
    if not snapshot.started_by_us:
        yield from snapshot.adapter.controller_lines()


def main() -> None:
    """Listen, print what was found, and leave."""
    run_and_exit(_work)


if __name__ == "__main__":
    main()
