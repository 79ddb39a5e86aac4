"""Listens to a cell without taking part in it: python -m rotcal_ros.nodes.check.cell_check.

Prints what was found as JSON, see :class:`~rotcal_ros.methods.check_lines.CellReport`. The suite's
own capture listens under a hidden name, without publishing, and the planner's preflight judges:
what passes here passes there.

The lines about drivers and other nodes come from ``snapshot``. Those made here are about the
frames (what headers name, what /tf_static says), the emergency stop, the machine (the joint of its
table, and the nodes that obey the two orders), and the streams: who publishes them, how often, and
what is wrong with them.
"""

from __future__ import annotations

import json
import os
import re
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict
from functools import partial
from math import isfinite
from pathlib import Path
from typing import Any, Final

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rotcal_msgs.msg import CalibrationPlan

from rotcal_ros.bags import names
from rotcal_ros.bags.settings import TopicSettings
from rotcal_ros.bags.topic_roles import TOPIC
from rotcal_ros.capture.instruments.conventions import OWN, Conventions, single_shots
from rotcal_ros.capture.instruments.interpreter import FAST
from rotcal_ros.capture.stamp_offsets import DOUBT_S, OffsetLimits, StampOffsets
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.foundation.escapes import printable
from rotcal_ros.foundation.machine_load import describe_load, load_scaled_timeout
from rotcal_ros.foundation.middleware import discovery_in_words
from rotcal_ros.foundation.node_names import FURTHER_NODES
from rotcal_ros.foundation.units import DEGREE
from rotcal_ros.geometry.frames import FrameTree, Pose
from rotcal_ros.methods import Calibration, Configuration
from rotcal_ros.methods.calibration import prepare_to_measure
from rotcal_ros.methods.check_lines import CellReport, CheckLine, State
from rotcal_ros.methods.configuration import changed, parse_configuration, read_configuration
from rotcal_ros.methods.dry_run import DryRun
from rotcal_ros.methods.method import DEFAULT
from rotcal_ros.nodes.capture.instrument_streams import TIMED
from rotcal_ros.nodes.capture.node import CaptureNode
from rotcal_ros.nodes.check.snapshot import (
    CellSnapshot,
    DriverTablePreview,
    Finding,
    HeaderMonitor,
    absent_driver_line,
    cell_lines,
    driver_lines,
    monitor_headers,
    preview_driver_table,
)
from rotcal_ros.nodes.planner import preflight
from rotcal_ros.nodes.runtime.beat_values import CLOCK_DOUBT, NOW, OFFSET, RATE, REFUSED
from rotcal_ros.nodes.runtime.cell_graph import ORDERS, CellGraph
from rotcal_ros.nodes.runtime.message_types import ONE_VERSION, message_type
from rotcal_ros.nodes.runtime.qos import LATCHED
from rotcal_ros.nodes.runtime.running import EndRequest, run_and_exit
from rotcal_ros.nodes.runtime.static_frames import StaticFrames
from rotcal_ros.nodes.runtime.timers_and_subscriptions import steady_timer
from rotcal_ros.sessions.cell_check import LONGER_S
from rotcal_ros.sessions.domains import domains_in_use

NAME: Final = "cell_check"
EARS: Final = "_cell_check_ears"
"""Name of the capture that listens here; ROS hides names that begin with an underscore."""
STREAMS: Final[Mapping[str, str]] = {
    names.JOINT_STATES: "table", names.PROBE_POINT: "probe", names.TRACER_LENGTH: "tracer",
    names.TEMPERATURE: "air", names.AIR_PRESSURE: "air", names.RELATIVE_HUMIDITY: "air",
}  # fmt: skip
"""The streams: topic -> part of the cell."""
_OWN_TOPICS: Final = (
    names.HEARTBEAT, "/diagnostics", names.PLAN, names.OBSERVATION, names.TABLE_ANGLE,
    names.PROBE_TARGET,
)  # fmt: skip
"""What a capture usually publishes or obeys; here it does neither."""
_LOOK_S: Final = 0.1
_AGAIN_S: Final = 0.5
"""What has come is judged again after this time."""
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
        self.headers: dict[str, HeaderMonitor] = {}
        self._offsets = StampOffsets(OffsetLimits())
        self._conventions = Conventions(TopicSettings())
        self.frames = StaticFrameListener(self.node)
        self._adapter: DriverTablePreview | None = None
        steady_timer(self.node, _LOOK_S, self._look)

    def announce(self, calibration: Calibration) -> None:
        """Publish the plan to the capture that listens, as a planner does."""
        configuration = calibration.configuration
        self._adapter = preview_driver_table(self.node, configuration)
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
        for role in FAST:  # few messages of a slow stream, or of a busy machine
            watch = self.headers.get(role)
            if watch is not None and watch.rate_hz is not None:
                words.setdefault(RATE + role, f"{watch.rate_hz:.4g}")
        graph = CellGraph(self.node)
        return CellSnapshot(
            graph, words, self.headers, configuration, calibration, compared, self._adapter
        )

    def _stamped(self, topic: str, stamp_ns: int, sent_ns: int, received_ns: int) -> None:
        if topic in TIMED:
            taken_ns = self._conventions.measured_at_ns(topic, stamp_ns, sent_ns)
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
                    self.headers[topic] = monitor_headers(
                        self.node, kind, name, partial(self._stamped, topic)
                    )


def _configuration(path: str) -> Configuration:
    if path:
        return read_configuration(Path(path))
    return parse_configuration(_NO_CONFIGURATION, "no configuration")


def _lines(
    snapshot: CellSnapshot, frames: StaticFrameListener, calibration: Calibration | None
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
        yield from DryRun(calibration, measured_table_angle(snapshot), rate).lines()


def _listened(
    listening: ListeningNodes,
    seconds: float,
    end: EndRequest,
    configuration: Configuration,
    calibration: Calibration | None,
) -> CellSnapshot:
    """Return what was heard in so many seconds, or longer where that does not judge the clocks."""
    enough_s = time.monotonic() + seconds
    latest_s = enough_s + min(load_scaled_timeout(seconds), LONGER_S)
    while True:
        while time.monotonic() < enough_s and not end:
            listening.executor.spin_once(timeout_sec=_LOOK_S)
        snapshot = listening.snapshot(configuration, calibration)
        if end or not snapshot.not_compared or time.monotonic() > latest_s:
            return snapshot
        enough_s = time.monotonic() + _AGAIN_S


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
    begun_s = time.monotonic()
    snapshot = _listened(listening, seconds, end, configuration, calibration)
    if end:
        return
    report = CellReport(
        namespace=listening.node.get_namespace(),
        place=discovery_in_words(os.environ),
        seconds=round(time.monotonic() - begun_s, 1),
        lines=tuple(_lines(snapshot, listening.frames, calibration)),
        domains=before,
    )
    sys.stdout.write(json.dumps(asdict(report)) + "\n")
    sys.stdout.flush()


_TODO: Final = "publish the points in the machine frame, or set cell.machine_frame to its name"


class StaticFrameListener:
    """The static frames that were heard since this object was made."""

    def __init__(self, node: Node) -> None:
        self._static = StaticFrames(node)

    def lines(self, snapshot: CellSnapshot) -> Iterator[CheckLine]:
        """Yield which frames the headers name, and what is static among them."""
        cell, named = snapshot.configuration.cell, _by_frame(snapshot)
        if named:
            words = (f"{frame or 'no frame_id'} in {', '.join(t)}" for frame, t in named.items())
            yield CheckLine("frames", "headers", "note", "; ".join(words))
        for doubt in preflight.frame_warnings(snapshot.values, snapshot.configuration):
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
        found = f"no node publishes {name}, and its silence stops the cell (safety.silent_s)"
        return CheckLine("safety", "emergency_stop", "missing", found, todo)
    if "safety.emergency_stop" in snapshot.configuration.given:
        return CheckLine("safety", "emergency_stop", "doubt", f"no node publishes {name}", todo)
    return CheckLine("safety", "emergency_stop", "note", f"no node publishes {name}")


_PARTS: Final = {names.TABLE_ANGLE: "table", names.PROBE_TARGET: "probe"}
_TYPES: Final = {
    names.TABLE_ANGLE: "rotcal_msgs/msg/TableAngle",
    names.PROBE_TARGET: "rotcal_msgs/msg/ProbeTarget",
}


def machine_lines(snapshot: CellSnapshot) -> Iterator[CheckLine]:
    """Yield a line for the joint and for every order."""
    if snapshot.adapter is not None:
        yield from _adapter_lines(snapshot)
    elif preflight.joint_states(snapshot.values):
        yield _joint_line(snapshot)
    for order in ORDERS:
        yield from _order_lines(snapshot, order)


def measured_table_angle(snapshot: CellSnapshot) -> float:
    """Return where the table stands (rad), as far as it was heard."""
    angle = preflight.table_angle(snapshot.values, snapshot.configuration)
    return angle if isfinite(angle) and not next(_doubts(snapshot), "") else 0.0


def _doubts(snapshot: CellSnapshot) -> Iterator[str]:
    return preflight.table_angle_warnings(snapshot.values, snapshot.configuration)


def _joint_line(snapshot: CellSnapshot) -> CheckLine:
    joint = snapshot.configuration.cell.joint
    chosen = preflight.table_joint(snapshot.values, joint)
    if fault := next(snapshot.joint_faults(), ""):
        there = ", ".join(map(printable, preflight.joint_states(snapshot.values)))
        return CheckLine("table", "joint", "missing", fault, f"cell.joint: one of {there}")
    angle, speed = preflight.joint_states(snapshot.values)[chosen]
    speed_text = f"{speed / DEGREE:.3g}°/s" if isfinite(speed) else "its speed by its angles"
    found = f"{chosen} at {angle:.6g} rad = {angle / DEGREE:.4f}°, {speed_text}"
    if doubt := next(_doubts(snapshot), ""):
        todo = _as_it_says(doubt, "publish the feedback in radians")
        return CheckLine("table", "joint", "doubt", doubt, todo)
    return CheckLine("table", "joint", "good", found)


def _order_lines(snapshot: CellSnapshot, order: str) -> Iterator[CheckLine]:
    """Yield which nodes obey an order, and which nodes besides the planner give it."""
    part, graph = _PARTS[order], snapshot.graph
    name, machines = graph.resolve(order), graph.machines(order)
    if versions := next(graph.other_versions((), [order]), None):
        yield CheckLine(part, order, "missing", versions, ONE_VERSION)
        return
    stray = sorted({*machines} & {*snapshot.strangers})
    own = [node for node in machines if node not in stray]
    line = absent_driver_line(snapshot, part, order, "obeys it")
    if line is not None:
        yield line
    elif snapshot.started_by_us and not machines:
        yield CheckLine(part, order, "note", "simulated: rotcal run starts the node that obeys it")
    elif why := list(graph.machine_faults(order)):
        todo = f"let your machine's node subscribe to {name} ({_TYPES[order]}), volatile"
        yield CheckLine(part, order, "missing", "; ".join(why), todo)
    else:
        state: State = "good" if own else "note"
        yield CheckLine(part, order, state, f"node {', '.join(own or stray)} obeys it")
    if stray and (line is None or line.state != "missing"):  # else it has said so
        too = "too " if line is not None or own else ""
        found = f"node {', '.join(stray)} obeys it {too}and has no group in the configuration"
        todo = f"end {', '.join(stray)}, or give the configuration the group of that node"
        yield CheckLine(part, order, "missing" if too else "doubt", found, todo)
    strangers = sorted(set(graph.publishers(order)) - {"planner"})
    if strangers:
        found = f"node {', '.join(strangers)} also gives orders on {name}"
        todo = f"only the planner may order motion: stop the other publishers on {name}"
        yield CheckLine(part, order, "doubt", found, todo)


def _adapter_lines(snapshot: CellSnapshot) -> Iterator[CheckLine]:
    """Yield how the adapter would judge its joint, and whether its controller is there."""
    assert snapshot.adapter is not None
    cells, adapter = snapshot.graph.resolve(names.JOINT_STATES), FURTHER_NODES["table_adapter"]
    others = sorted({*snapshot.graph.publishers(names.JOINT_STATES)} - {adapter})
    if others and cells != snapshot.adapter.topic:
        found = f"node {', '.join(others)} publishes {cells}, and so does {adapter}"
        todo = f"end {', '.join(others)}, or leave out the group of {adapter}"
        yield CheckLine("table", "joint_states", "missing", found, todo)
    if wrong := snapshot.adapter.wrong():
        yield CheckLine("table", "joint", "missing", wrong.found, wrong.todo)
    elif outside := snapshot.adapter.outside():
        todo = "publish the joint in rad, or correct table_adapter.lower_deg and upper_deg"
        yield CheckLine("table", "joint", "doubt", outside, todo)
    elif preflight.joint_states(snapshot.values):
        yield _joint_line(snapshot)
    if not snapshot.started_by_us:
        yield from snapshot.adapter.controller_lines()


_CLOCKS: Final = (
    "synchronise the clocks of all machines (chrony, ptp), and stamp the time of measurement"
)
_UNITS: Final[Mapping[str, str]] = {
    names.PROBE_POINT: "m", names.TRACER_LENGTH: "m", names.TEMPERATURE: "°C",
    names.AIR_PRESSURE: "Pa", names.RELATIVE_HUMIDITY: "of 1",
}  # fmt: skip

_IN_WORDS: Final[Mapping[str, str]] = {
    names.TEMPERATURE: "degrees Celsius", names.AIR_PRESSURE: "pascal",
    names.RELATIVE_HUMIDITY: "shares from 0 to 1",
}  # fmt: skip


_ADVICE: Final = re.compile(
    r"\b(?:[Ss]et (?:topics\.\w+: \S+|a \w+ [^;]*)|add \S+ to topics\.\w+"
    r"|topics\.\w+: \w+ takes [^;]*)"
)
"""What a finding says to do; a setting, or how to change it."""


def _as_it_says(found: str, otherwise: str) -> str:
    """Return what to do: the setting that a line names, or what else the cell can do."""
    advice = _ADVICE.search(found)
    return (
        otherwise if advice is None else f"{otherwise}, or {advice[0][:1].lower()}{advice[0][1:]}"
    )


def stream_lines(snapshot: CellSnapshot) -> Iterator[CheckLine]:
    """Yield a line for every stream."""
    for topic in STREAMS:
        yield _line(snapshot, topic)


def clock_line(snapshot: CellSnapshot) -> CheckLine:
    """Say whether the clocks of the streams agree, by the times of arrival."""
    if OFFSET in snapshot.values:
        words = snapshot.values[OFFSET]
        return CheckLine("clocks", "stamps", "missing", words, _as_it_says(words, _CLOCKS))
    if doubt := snapshot.values.get(CLOCK_DOUBT):
        return CheckLine("clocks", "stamps", "doubt", doubt, _as_it_says(doubt, _CLOCKS))
    agree = f"{', '.join(snapshot.compared)} and joint_states agree within {DOUBT_S:g} s"
    if missed := snapshot.not_compared:
        counts = ", ".join(f"{role} ({snapshot.headers[role].count} messages)" for role in missed)
        found = f"not compared with joint_states: {counts}, too few or too uneven to tell; "
        found += describe_load() if not snapshot.compared else f"{describe_load()}; {agree}"
        # A probe that says only now and then where it is may be sound; a steady stream is not.
        steady = {*missed} & {*FAST} - {*single_shots(snapshot.configuration.topics)}
        todo = "listen longer, with --time 30, or beside less other work"
        return CheckLine("clocks", "stamps", "missing" if steady else "open", found, todo)
    if not snapshot.compared:
        return CheckLine("clocks", "stamps", "note", "too few stamped streams to compare")
    return CheckLine("clocks", "stamps", "good", agree)


def _line(snapshot: CellSnapshot, topic: str) -> CheckLine:
    part = STREAMS[topic]
    offers, watch = (
        snapshot.graph.offers(snapshot.name(topic)),
        snapshot.headers.get(topic, HeaderMonitor()),
    )
    if not offers:
        return _absent(snapshot, topic)
    problem = _problem(snapshot, topic, offers, watch)
    wrong = [w for w in (problem, _doubt(snapshot, topic, watch)) if w is not None]
    state: State = "doubt" if wrong else "good"
    if problem is not None and topic in snapshot.topics:
        state = "missing"
    found = "; ".join([*(w.found for w in wrong), _seen(snapshot, topic, offers)])
    todo = wrong[0].todo if wrong else ""
    return CheckLine(part, topic, state, found, todo, watch.rate_hz, watch.ahead_s)


def _absent(snapshot: CellSnapshot, topic: str) -> CheckLine:
    """Return the line of a stream without a publisher."""
    part, kind = STREAMS[topic], OWN[topic]
    name = snapshot.name(topic)
    if snapshot.started_by_us:
        return CheckLine(part, topic, "note", "simulated: rotcal run starts it")
    if line := absent_driver_line(snapshot, part, topic, "publishes it"):
        return line
    planned = snapshot.calibration
    required, wished = preflight.expected_air_topics(planned) if planned else ([], [])
    if topic in snapshot.topics or topic in required:
        why = snapshot.unusable(topic) or ""
        todo = snapshot.graph.elsewhere(topic, name) or f"publish {kind} on {name}"
        return CheckLine(part, topic, "missing", why, todo)
    if topic in wished:
        why = preflight.missing_air_consequence(topic, name, snapshot.configuration)
        return CheckLine(part, topic, "doubt", f"no node publishes {name}", why)
    return CheckLine(part, topic, "note", "no node publishes it, and it is not needed")


def _problem(
    snapshot: CellSnapshot, topic: str, offers: list[Any], watch: HeaderMonitor
) -> Finding | None:
    """Return why a stream cannot be used to measure; None: it can."""
    kind, name = OWN[topic], snapshot.name(topic)
    limit_s = snapshot.configuration.planner.stream_timeout_s
    if text := next(snapshot.graph.other_versions([name]), None):
        return Finding(text, ONE_VERSION)
    if text := snapshot.values.get(REFUSED + topic):
        return Finding(text, f"publish {kind} on {name}")
    bad_joint = topic == names.JOINT_STATES and any(snapshot.joint_faults())  # its line says so
    if not bad_joint and (why := snapshot.unusable(topic)):
        if topic == names.JOINT_STATES and snapshot.adapter is not None:
            return snapshot.adapter.wrong()
        many = f"stop all publishers of {name} but one"
        return Finding(why, many if len(offers) > 1 else _silent(watch, name))
    if wrong := next(_faults(snapshot, topic), None):
        fill = f"fill header.stamp of {name} with the time of measurement"
        way = fill if "stamps" in wrong else f"publish {name} as its line above expects it"
        return Finding(wrong, _as_it_says(wrong, way))
    if watch.unstamped and watch.unstamped == watch.count:
        todo = f"fill header.stamp of {name} with the time of measurement"
        return Finding("its messages have no stamp", todo)
    silence_s = time.monotonic() - watch.heard_s
    steady = topic in FAST and topic not in single_shots(snapshot.configuration.topics)
    if steady and silence_s > limit_s:
        todo = f"let {name} stream without a pause, or raise planner.stream_timeout_s"
        found = f"silent for {silence_s:.1f} s (planner.stream_timeout_s {limit_s:g})"
        return Finding(found, todo)
    return None


def _faults(snapshot: CellSnapshot, topic: str) -> Iterator[str]:
    """Yield what the preflight finds wrong with the numbers of a stream."""
    values, configuration = snapshot.values, snapshot.configuration
    if topic == names.TRACER_LENGTH:
        yield from preflight.length_faults(values, configuration)
    if topic == names.PROBE_POINT and snapshot.calibration is not None:
        yield from preflight.probe_faults(values, configuration, snapshot.calibration.plan)
    rates = preflight.rate_faults(values, configuration)
    yield from (text for role, text in rates if role == topic)


def _silent(watch: HeaderMonitor, name: str) -> str:
    if not watch.count:
        return f"let its node publish on {name} before it is asked, at least once a second"
    return f"{name} delivers nothing usable: see its status, and whether its numbers are finite"


def _doubt(snapshot: CellSnapshot, topic: str, watch: HeaderMonitor) -> Finding | None:
    """Return what looks wrong with a stream although it can be used to measure."""
    limit_s, name = snapshot.configuration.capture.stamp_offset_s, snapshot.name(topic)
    planned, is_table, values = snapshot.calibration, topic == names.JOINT_STATES, snapshot.values
    if planned and (small := next(preflight.unit_warnings(values, planned, topic), None)):
        return Finding(small, _as_it_says(small, f"publish {name} in metres"))
    slow = preflight.table_rate_warnings if is_table else preflight.length_rate_warnings
    rare = is_table or topic == names.TRACER_LENGTH
    if rare and (found := next(slow(values, snapshot.configuration), None)):
        return Finding(found, f"publish {name} more often")
    if topic in _IN_WORDS and (odd := next(preflight.air_warnings(values, topic), None)):
        return Finding(odd, _as_it_says(odd, f"publish {name} in {_IN_WORDS[topic]}"))
    fast = snapshot.configuration.simulated  # a simulation may run on a time of its own
    if watch.ahead_s is not None and abs(watch.ahead_s) > limit_s and not fast:
        way = "ahead of" if watch.ahead_s > 0 else "behind"
        return Finding(f"stamps {abs(watch.ahead_s):.2f} s {way} this machine's clock", _CLOCKS)
    if watch.set_back:
        found = f"{watch.set_back} stamps are earlier than the one before"
        return Finding(found, f"let the stamps of {name} only increase")
    return None


def _seen(snapshot: CellSnapshot, topic: str, offers: list[Any]) -> str:
    """Return what can be seen of a stream that is published."""
    nodes = ", ".join(sorted({info.node_name for info in offers}))
    profile = offers[0].qos_profile
    words = [f"node {nodes}"]
    now = snapshot.values.get(NOW + topic, "")
    if topic in _UNITS and now:
        words.append(_reading(now, topic))
    words.append(profile.reliability.name.lower().replace("_", " "))
    if profile.durability.name == "TRANSIENT_LOCAL":
        words.append("latched")
    return " · ".join(words)


def _reading(now: str, topic: str) -> str:
    """Return a reading of the capture's beat with its unit."""
    if topic == names.PROBE_POINT:
        return f"({', '.join(f'{float(x):.4f}' for x in now.split())}) m"
    value, *rest = now.split()
    return " ".join([value, _UNITS[topic], *rest])


def main() -> None:
    """Listen, print what was found, and leave."""
    run_and_exit(_work)


if __name__ == "__main__":
    main()
