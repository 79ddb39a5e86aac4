"""The lines of a check on the streams: who publishes, how often, and what is wrong."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from typing import Any, Final

from rotcal_ros.bags import names
from rotcal_ros.capture.instruments.conventions import single_shots
from rotcal_ros.capture.instruments.interpreter import FAST
from rotcal_ros.capture.stamp_offsets import DOUBT_S
from rotcal_ros.methods.check_lines import CheckLine, State
from rotcal_ros.nodes.check.snapshot import (
    CellSnapshot,
    Finding,
    HeaderWatch,
    brought_line,
    namesakes,
)
from rotcal_ros.nodes.planner.preflight import (
    air_doubts,
    expected_air,
    length_faults,
    probe_faults,
    rate_faults,
    size_doubts,
    slow_table,
    without_air,
)
from rotcal_ros.nodes.runtime.beat_values import CLOCK_DOUBT, NOW, OFFSET, REFUSED

KINDS: Final[Mapping[str, tuple[str, str]]] = {
    names.JOINT_STATES: ("table", "sensor_msgs/msg/JointState"),
    names.PROBE_POINT: ("probe", "rotcal_msgs/msg/ProbePoint"),
    names.TRACER_LENGTH: ("tracer", "rotcal_msgs/msg/TracerLength"),
    names.TEMPERATURE: ("air", "sensor_msgs/msg/Temperature"),
    names.AIR_PRESSURE: ("air", "sensor_msgs/msg/FluidPressure"),
    names.RELATIVE_HUMIDITY: ("air", "sensor_msgs/msg/RelativeHumidity"),
}
"""The streams: topic -> part of the cell, type."""
_CLOCKS: Final = (
    "synchronise the clocks of all machines (chrony, ptp), and stamp at the time of measurement"
)
_UNITS: Final[Mapping[str, str]] = {
    names.PROBE_POINT: "m", names.TRACER_LENGTH: "m", names.TEMPERATURE: "°C",
    names.AIR_PRESSURE: "Pa", names.RELATIVE_HUMIDITY: "of 1",
}  # fmt: skip

_IN_WORDS: Final[Mapping[str, str]] = {
    names.TEMPERATURE: "degrees Celsius", names.AIR_PRESSURE: "pascal",
    names.RELATIVE_HUMIDITY: "shares from 0 to 1",
}  # fmt: skip


def stream_lines(snapshot: CellSnapshot) -> Iterator[CheckLine]:
    """Yield a line for every stream."""
    for topic in KINDS:
        yield _line(snapshot, topic)


def clock_line(snapshot: CellSnapshot) -> CheckLine:
    """Say whether the clocks of the streams agree, by the times of arrival."""
    if OFFSET in snapshot.values:
        return CheckLine("clocks", "stamps", "missing", snapshot.values[OFFSET], _CLOCKS)
    if doubt := snapshot.values.get(CLOCK_DOUBT):
        return CheckLine("clocks", "stamps", "doubt", doubt, _CLOCKS)
    if not snapshot.compared:
        return CheckLine("clocks", "stamps", "note", "too few stamped streams to compare")
    found = f"{', '.join(snapshot.compared)} and joint_states agree within {DOUBT_S:g} s"
    return CheckLine("clocks", "stamps", "good", found)


def _line(snapshot: CellSnapshot, topic: str) -> CheckLine:
    part, _ = KINDS[topic]
    offers, watch = (
        snapshot.graph.offers(snapshot.name(topic)),
        snapshot.headers.get(topic, HeaderWatch()),
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
    """Return the line of a stream that nobody publishes."""
    part, kind = KINDS[topic]
    name = snapshot.name(topic)
    if snapshot.started_by_us:
        return CheckLine(part, topic, "note", "simulated: rotcal run starts it")
    if line := brought_line(snapshot, part, topic, "tells it"):
        return line
    air = ([], []) if snapshot.calibration is None else expected_air(snapshot.calibration)
    required, wished = air
    if topic in snapshot.topics or topic in required:
        why = snapshot.unusable(topic) or ""
        todo = namesakes(snapshot.graph, topic, name, kind) or f"publish {kind} on {name}"
        return CheckLine(part, topic, "missing", why, todo)
    if topic in wished:
        why = without_air(topic, name, snapshot.configuration)
        return CheckLine(part, topic, "doubt", f"nobody publishes {name}", why)
    return CheckLine(part, topic, "note", "nobody publishes it, and nobody needs it")


def _problem(
    snapshot: CellSnapshot, topic: str, offers: list[Any], watch: HeaderWatch
) -> Finding | None:
    """Return why a stream cannot be used to measure; None: it can."""
    _, kind = KINDS[topic]
    name, limit_s = snapshot.name(topic), snapshot.configuration.planner.stream_timeout_s
    if text := snapshot.values.get(REFUSED + topic):
        return Finding(text, f"publish {kind} on {name}")
    bad_joint = topic == names.JOINT_STATES and any(snapshot.joint_faults())  # its line tells it
    if not bad_joint and (why := snapshot.unusable(topic)):
        if topic == names.JOINT_STATES and snapshot.adapter is not None:
            return snapshot.adapter.wrong()
        many = f"stop all publishers of {name} but one"
        return Finding(why, many if len(offers) > 1 else _silent(watch, name))
    if wrong := next(_faults(snapshot, topic), None):
        return Finding(wrong, f"publish {name} as expected, or set what its line names")
    if watch.unstamped and watch.unstamped == watch.count:
        todo = f"fill header.stamp of {name} with the time of measurement"
        return Finding("its messages have no stamp", todo)
    silence_s = time.monotonic() - watch.heard_s
    steady = topic in FAST and topic not in single_shots(snapshot.configuration.topics)
    if steady and silence_s > limit_s:
        todo = f"let {name} stream without pauses, or raise planner.stream_timeout_s"
        found = f"silent for {silence_s:.1f} s (planner.stream_timeout_s {limit_s:g})"
        return Finding(found, todo)
    return None


def _faults(snapshot: CellSnapshot, topic: str) -> Iterator[str]:
    """Yield what the preflight finds wrong with the numbers of a stream."""
    values, configuration = snapshot.values, snapshot.configuration
    if topic == names.TRACER_LENGTH:
        yield from length_faults(values, configuration)
    if topic == names.PROBE_POINT and snapshot.calibration is not None:
        yield from probe_faults(values, configuration, snapshot.calibration.plan)
    yield from (text for role, text in rate_faults(values, configuration) if role == topic)


def _silent(watch: HeaderWatch, name: str) -> str:
    if not watch.count:
        return f"let its node publish on {name} before it is asked, at least once a second"
    return f"{name} delivers nothing usable: check its status, and whether its numbers are finite"


def _doubt(snapshot: CellSnapshot, topic: str, watch: HeaderWatch) -> Finding | None:
    """Return what looks wrong about a stream that can be used nevertheless."""
    limit_s, name = snapshot.configuration.capture.stamp_offset_s, snapshot.name(topic)
    planned, is_table = snapshot.calibration, topic == names.JOINT_STATES
    if planned and (small := next(size_doubts(snapshot.values, planned, topic), None)):
        return Finding(small, f"publish {name} in the unit that the group topics states")
    if is_table and (slow := next(slow_table(snapshot.values, snapshot.configuration), None)):
        return Finding(slow, f"publish {name} more often")
    if topic in _IN_WORDS and (odd := next(air_doubts(snapshot.values, topic), None)):
        return Finding(odd, f"publish {name} in {_IN_WORDS[topic]}")
    fast = snapshot.configuration.simulated  # a simulation may run on a time of its own
    if watch.ahead_s is not None and abs(watch.ahead_s) > limit_s and not fast:
        way = "ahead of" if watch.ahead_s > 0 else "behind"
        return Finding(f"stamps {abs(watch.ahead_s):.2f} s {way} this machine's clock", _CLOCKS)
    if watch.set_back:
        return Finding(f"{watch.set_back} stamps go back", f"let the stamps of {name} increase")
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
