"""What a check of a cell has heard: nodes, drivers, streams and the headers of their messages.

Headers are read from the first bytes of serialised messages, so that a fast stream costs little.
"""

from __future__ import annotations

import os
import struct
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from statistics import median
from typing import Any, Final, NamedTuple, Protocol

from rclpy.node import Node

from rotcal_ros.bags import names
from rotcal_ros.bags.topic_roles import TOPIC
from rotcal_ros.capture.instruments.conventions import single_shots
from rotcal_ros.foundation import plugins
from rotcal_ros.foundation.node_names import FURTHER_NODES, NODES
from rotcal_ros.foundation.plugins import group_nodes, nodes_of_groups
from rotcal_ros.foundation.units import NANOSECOND
from rotcal_ros.methods import Calibration, Configuration
from rotcal_ros.methods.check_lines import CheckLine, DriverCheck
from rotcal_ros.nodes.planner.preflight import Values, joint_faults
from rotcal_ros.nodes.runtime.cell_graph import ORDERS, CellGraph
from rotcal_ros.nodes.runtime.qos import adapted_qos
from rotcal_ros.nodes.runtime.timers_and_subscriptions import Batch, DrainedSubscription, sent_ns
from rotcal_ros.sessions.domains import DEFAULT_DOMAIN, domains_in_use

SIMULATION: Final = FURTHER_NODES["simulation"]
_MOST_FRAMES = 8
_KEPT = 5000
_OURS: Final = ("cell_check", "_cell_check_ears")


class Finding(NamedTuple):
    """What is wrong or looks so, and what to do about it."""

    found: str
    todo: str


class DriverTablePreview(Protocol):
    """The table behind a driver that does not run yet, judged as the driver will judge it."""

    topic: str

    def wrong(self) -> Finding | None:
        """Return why the driver could not use this feedback; None: it can."""

    def outside(self) -> str | None:
        """Return in words that the joint is outside its stated travel; None: it is inside."""

    def controller_lines(self) -> Iterator[CheckLine]:
        """Yield whether a controller is there that accepts the driver's orders."""


@dataclass
class HeaderMonitor:
    """The headers of the messages since the beginning; times of arrival are of this machine.

    ``heard_s`` is the monotonic time of the latest one: setting a clock does not look like
    silence.
    """

    count: int = 0
    first_s: float = 0.0
    latest_s: float = 0.0
    heard_s: float = 0.0
    unstamped: int = 0
    set_back: int = 0
    frames: list[str] = field(default_factory=list)
    has_header: bool = True
    _ahead_ns: list[int] = field(default_factory=list)
    _stamp_ns: int = 0

    @property
    def rate_hz(self) -> float | None:
        """Messages a second; None while fewer than two came."""
        span = self.latest_s - self.first_s
        return (self.count - 1) / span if self.count > 1 and span > 0.0 else None

    @property
    def stamped(self) -> int:
        """How many messages had a stamp."""
        return self.count - self.unstamped if self.has_header else 0

    @property
    def ahead_s(self) -> float | None:
        """Median of stamp less time of arrival; None if nothing is stamped."""
        return median(self._ahead_ns) * NANOSECOND if self._ahead_ns else None

    def note(self, data: bytes, received_ns: int) -> int:
        """Take a serialised message; return its stamp (ns), 0 where it has none."""
        now_s = received_ns * NANOSECOND
        self.first_s = self.first_s or now_s
        self.latest_s, self.count = now_s, self.count + 1
        self.heard_s = time.monotonic()
        if not self.has_header:
            return 0
        stamp_ns, frame = read_header(data)
        self.set_back += 0 < stamp_ns < self._stamp_ns
        self._stamp_ns = stamp_ns
        if not stamp_ns:
            self.unstamped += 1
        elif len(self._ahead_ns) < _KEPT:
            self._ahead_ns.append(stamp_ns - received_ns)
        if frame not in self.frames and len(self.frames) < _MOST_FRAMES:
            self.frames.append(frame)
        return stamp_ns


@dataclass(frozen=True)
class CellSnapshot:
    """What a check has heard; ``calibration`` is None if no configuration was given.

    ``compared`` are the streams whose clocks could be compared with the table's. With a table
    adapter in the configuration, ``adapter`` judges the table behind it.
    """

    graph: CellGraph
    values: Values
    headers: Mapping[str, HeaderMonitor]
    configuration: Configuration
    calibration: Calibration | None
    compared: tuple[str, ...]
    adapter: DriverTablePreview | None = None

    def name(self, role: str) -> str:
        """Return the absolute name of the topic of a role, as the capture knows it."""
        return self.values.get(TOPIC + role) or self.graph.resolve(role)

    def publishers(self, role: str) -> list[str]:
        """Return the names of the nodes that publish the topic of a role."""
        return self.graph.publishers(self.name(role))

    def unusable(self, role: str) -> str | None:
        """Return in words why the topic of a role cannot be used; None: it can."""
        if role == names.JOINT_STATES and self.adapter is not None:
            wrong = self.adapter.wrong()
            return None if wrong is None else wrong.found
        silent = role in single_shots(self.configuration.topics)
        delivered = silent or self.values.get(f"valid.{role}", "0") != "0"
        return next(self.graph.instrument_faults(self.name(role), delivered), None)

    def joint_faults(self) -> Iterator[str]:
        """Yield what is wrong with the table's joint; an adapter judges its joint itself."""
        if self.adapter is None:
            yield from joint_faults(self.values, self.configuration.cell.joint)

    @cached_property
    def nodes(self) -> frozenset[str]:
        """The names of the nodes that are in the cell's namespace."""
        place = self.graph.node.get_namespace().rstrip("/")
        return frozenset(n for n, where in self.graph.nodes() if where.rstrip("/") == place)

    @cached_property
    def brought(self) -> Mapping[str, list[str]]:
        """Role -> nodes, for what the drivers that ``rotcal run`` starts will publish or obey."""
        return roles_of_absent_drivers(self)

    @property
    def topics(self) -> tuple[str, ...]:
        """The instrument topics that must be there."""
        always = (names.JOINT_STATES, names.PROBE_POINT)
        return always if self.calibration is None else self.calibration.topics

    @property
    def not_compared(self) -> tuple[str, ...]:
        """The stamped streams, of those needed, whose clocks could not be compared so far.

        A simulation may run on a time of its own: its clocks are not compared.
        """
        watches = {role: self.headers.get(role) for role in (*self.topics, names.JOINT_STATES)}
        stamped = {
            r for r, watch in watches.items() if watch and watch.has_header and watch.stamped
        }
        if self.configuration.simulated or names.JOINT_STATES not in stamped:
            return ()
        return tuple(sorted(stamped - {names.JOINT_STATES, *self.compared}))

    @property
    def strangers(self) -> tuple[str, ...]:
        """The suite's own machines that are here although the configuration does not have them."""
        ours = nodes_of_groups(self.configuration.given)
        others = {node.name for node in group_nodes().values()} - {*ours, "bridge"}
        return () if self.calibration is None else tuple(sorted(self.nodes & others))

    @property
    def started_by_us(self) -> bool:
        """Whether ``rotcal run`` starts the instruments itself: a node simulates them."""
        simulated = SIMULATION in nodes_of_groups(self.configuration.given)
        return simulated and not self.publishers(names.JOINT_STATES)


def preview_driver_table(node: Node, configuration: Configuration) -> DriverTablePreview | None:
    """Return the table behind a driver of the configuration; None: no driver has one."""
    for _, check in _checks(configuration):
        if check.ears is not None:
            return check.ears(node, configuration)
    return None


def roles_of_absent_drivers(snapshot: CellSnapshot) -> dict[str, list[str]]:
    """Return role -> nodes, for what drivers that do not run yet will publish or obey."""
    found: dict[str, list[str]] = {}
    for group, check in _checks(snapshot.configuration):
        if (node := group_nodes()[group].name) not in snapshot.nodes:
            for role in check.brings(snapshot.configuration.group(group)):
                found.setdefault(role, []).append(node)
    return found


def absent_driver_line(
    snapshot: CellSnapshot, part: str, role: str, does: str
) -> CheckLine | None:
    """Return the line of a role that a driver will take; None if none will."""
    nodes = snapshot.brought.get(role, [])
    if not nodes:
        return None
    if len(nodes) > 1:
        found, todo = f"{' and '.join(nodes)} would both do it", "leave one of their groups out"
        return CheckLine(part, role, "missing", found, todo)
    if already := [n for n in snapshot.strangers if n in _who_does(snapshot, role)]:
        found = (
            f"node {', '.join(already)} {does} already, and rotcal run starts {nodes[0]}, which "
            f"{does} too"
        )
        todo = f"end {', '.join(already)}, or leave out the group of {nodes[0]}"
        return CheckLine(part, role, "missing", found, todo)
    return CheckLine(part, role, "note", f"rotcal run starts {nodes[0]}, which {does}")


def _who_does(snapshot: CellSnapshot, role: str) -> list[str]:
    """Return the nodes that obey an order, or publish a stream, under its name in the cell."""
    graph = snapshot.graph
    return graph.machines(role) if role in ORDERS else graph.publishers(role)


def driver_lines(snapshot: CellSnapshot) -> Iterator[CheckLine]:
    """Yield whether the drivers' devices are there, as far as this can be seen from outside."""
    configuration = snapshot.configuration
    for group, check in _checks(snapshot.configuration):
        if check.look is not None:
            here = group_nodes()[group].name in snapshot.nodes
            yield check.look(configuration.group(group), here, configuration.simulated)


def _checks(configuration: Configuration) -> Iterator[tuple[str, DriverCheck]]:
    """Yield the drivers whose groups the configuration has."""
    known = plugins.names(plugins.DRIVER_CHECKS)
    for group in group_nodes():
        if group in configuration.given and group in known:
            yield group, plugins.load(plugins.DRIVER_CHECKS, group, "driver")


def cell_lines(snapshot: CellSnapshot) -> Iterator[CheckLine]:
    """Yield which nodes are there."""
    others = [pair for pair in snapshot.graph.nodes() if pair[0] not in _OURS]
    place = snapshot.graph.node.get_namespace()
    here = sorted(snapshot.nodes - {*_OURS})
    if not others:
        yield _nobody(snapshot)
    else:
        elsewhere = len(others) - len(here)
        more = f"; {elsewhere} elsewhere in this domain" if elsewhere else ""
        yield CheckLine("cell", "nodes", "note", f"{', '.join(here) or 'none'} in {place}{more}")
    if busy := sorted({*here} & {*NODES, *nodes_of_groups(snapshot.configuration.given)}):
        found = f"nodes of a calibration are here already: {', '.join(busy)}"
        todo = "rotcal run would be refused: let them end (rotcal attach), or calibrate with them"
        yield CheckLine("cell", "calibration", "doubt", found, todo)


def _nobody(snapshot: CellSnapshot) -> CheckLine:
    """Return the line of an empty graph, and how to look elsewhere."""
    domain = int(os.environ.get("ROS_DOMAIN_ID") or DEFAULT_DOMAIN)
    if snapshot.started_by_us:
        return CheckLine("cell", "nodes", "note", "none; rotcal run starts the simulated ones")
    if snapshot.brought.keys() >= {*snapshot.topics}:
        return CheckLine("cell", "nodes", "note", "none; rotcal run starts the drivers")
    used = [d for d in domains_in_use() if d != domain]
    todo = "start your nodes with the same ROS_DOMAIN_ID and ROS_AUTOMATIC_DISCOVERY_RANGE as here"
    if used:
        shown = ", ".join(map(str, used))
        todo = (
            f"on this machine there are participants in ROS_DOMAIN_ID {shown}; look there: "
            f"ROS_DOMAIN_ID={used[0]} rotcal cell check ..."
        )
    return CheckLine("cell", "nodes", "missing", f"no node in domain {domain}", todo)


def read_header(data: bytes) -> tuple[int, str]:
    """Return stamp (ns) and frame of a serialised message; (0, "") where it has no header."""
    try:
        order = "<" if data[1] & 1 else ">"  # of the CDR encapsulation
        seconds, nanoseconds, length = struct.unpack_from(f"{order}iII", data, 4)
        frame = data[16 : 16 + max(length - 1, 0)].decode(errors="replace")
    except (struct.error, IndexError):
        return 0, ""
    return int(seconds) * 1_000_000_000 + int(nanoseconds), frame


def monitor_headers(
    node: Node, message_type: Any, topic: str, stamped: Callable[[int, int, int], None]
) -> HeaderMonitor:
    """Return the headers on an absolute ``topic`` from now on, whoever publishes them.

    ``stamped`` is called with stamp, time of sending and of arrival (ns) of every stamped message.
    """
    watch = HeaderMonitor(has_header="header" in message_type.get_fields_and_field_types())

    def take(batch: Batch) -> None:
        for data, info in batch:
            received_ns = info["received_timestamp"] or time.time_ns()
            stamp_ns = watch.note(data, received_ns)
            if stamp_ns:
                stamped(stamp_ns, sent_ns(info), received_ns)

    offers = [info.qos_profile for info in node.get_publishers_info_by_topic(topic)]
    DrainedSubscription(node, message_type, topic, adapted_qos(offers), take, raw=True)
    return watch
