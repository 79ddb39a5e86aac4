"""Checks the table behind an adapter that does not run yet, with the adapter's own judgement."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Final

from rclpy.node import Node
from sensor_msgs.msg import JointState

from rotcal_ros.bags import names
from rotcal_ros.capture import messages
from rotcal_ros.capture.publishers import HeardPublishers, publisher_of
from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.escapes import printable
from rotcal_ros.foundation.units import DEGREE
from rotcal_ros.methods import Configuration
from rotcal_ros.methods.check_lines import CheckLine, DriverCheck
from rotcal_ros.nodes.check.snapshot import Finding
from rotcal_ros.nodes.runtime.accepted_publishers import message_publisher
from rotcal_ros.nodes.runtime.cell_graph import incompatible_listeners
from rotcal_ros.nodes.runtime.timers_and_subscriptions import Batch, InstrumentSubscription
from rotcal_ros.nodes.table_adapter.joint_controllers import choose_interface
from rotcal_ros.nodes.table_adapter.joint_watch import JointMonitor
from rotcal_ros.planning.settings import TableAdapterSettings

_LISTENERS: Final = {"trajectory": "joint_trajectory", "positions": "commands"}
_GOALS: Final = "follow_joint_trajectory"
_MOST_NAMES: Final = 12


class AdapterTablePreview:
    """What the adapter would receive: the feedback of the table's joint, and who publishes it."""

    def __init__(self, node: Node, configuration: Configuration) -> None:
        self._node, self._settings = node, configuration.table_adapter
        self._joint = configuration.cell.joint
        self._watch = JointMonitor(self._settings)
        self._publishers = HeardPublishers()
        self._others: dict[str, None] = {}
        self.topic: str = node.resolve_topic_name(self._settings.feedback)
        InstrumentSubscription(node, JointState, self._settings.feedback, self._hear)

    def wrong(self) -> Finding | None:
        """Return why the adapter could not use this feedback; None: it can."""
        topic, joint = self.topic, printable(self._joint)
        if not self._joint:
            there = f", one of {', '.join(self._names())}" if self._others else ""
            todo = f"name the joint of the table in cell.joint{there}"
            return Finding("cell.joint is not set", todo)
        if not self._node.get_publishers_info_by_topic(topic):
            todo = "start joint_state_broadcaster, or correct table_adapter.feedback"
            return Finding(f"no node publishes {topic}", todo)
        if not self._publishers:
            there = ", ".join(self._names())
            found = f"{topic} has no joint {joint!r} (cell.joint)"
            found += f", it has {there or 'said nothing'}"
            return Finding(found, f"cell.joint: one of {there}")
        if len(self._publishers) > 1:
            found = f"{len(self._publishers)} publishers publish the joint {joint!r} on {topic}"
            return Finding(f"{found} ({self._who()})", "stop all but one that publish this joint")
        if text := self._watch.doubt() or self._watch.current_fault(time.monotonic()):
            return Finding(text, f"let {topic} give the joint in rad, and without a pause")
        return None

    def outside(self) -> str | None:
        """Return in words that the joint is outside its stated travel; None: it is inside.

        Degrees that are taken for radians often show this way.
        """
        low, high, latest = self._settings.lower_deg, self._settings.upper_deg, self._watch.latest
        if low is None or high is None or latest is None:
            return None
        angle = latest.angle / DEGREE
        if low - 1.0 <= angle <= high + 1.0:
            return None
        return (
            f"the joint stands at {latest.angle:.6g} rad = {angle:.6g}°, outside its stated "
            f"travel of {low:g}° to {high:g}°: are these degrees?"
        )

    def controller_lines(self) -> Iterator[CheckLine]:
        """Yield whether a controller is there that accepts orders as the adapter sends them."""
        settings, node = self._settings, self._node
        try:
            interface = choose_interface(settings)
        except ConfigurationError as error:
            yield CheckLine("table", "controller", "missing", str(error), "install control_msgs")
            return
        there = offered_interfaces(node, settings)
        name, who = controller_topic(settings, interface), there.get(interface, "")
        if not who:
            found = f"no node takes {interface} on {name}"
            todo = "start and activate the controller, or correct table_adapter.controller"
            if there:
                found += f"; {settings.controller} takes {' and '.join(there)}"
                todo = f"set table_adapter.interface: {next(iter(there))}"
            yield CheckLine("table", "controller", "missing", found, todo)
            return
        topic = node.resolve_topic_name(name)
        unmatched = (
            []
            if interface == "goals"
            else list(incompatible_listeners(node, topic, lambda _: True))
        )
        found = "; ".join(unmatched) or f"node {who} takes {interface} on {name}"
        yield CheckLine("table", "controller", "missing" if unmatched else "good", found)

    def _names(self) -> list[str]:
        return [printable(name) for name in self._others][:_MOST_NAMES]

    def _who(self) -> str:
        """Return the nodes that publish the joint; all of the topic if messages name none."""
        found = self._node.get_publishers_info_by_topic(self.topic)
        named = {publisher_of(info.endpoint_gid): info.node_name for info in found}
        heard = self._publishers.identities or named
        return ", ".join(sorted(named.get(identity, "one that has gone") for identity in heard))

    def _hear(self, batch: Batch) -> None:
        for message, info in batch:
            sample = messages.table_sample(message, self._joint) if self._joint else None
            if sample is None:
                self._others |= dict.fromkeys(message.name)
                continue
            self._publishers.receive(message_publisher(info))
            self._watch.receive(sample, time.monotonic())


def controller_topic(settings: TableAdapterSettings, interface: str) -> str:
    """Return the topic or action of the controller that an interface needs."""
    return f"{settings.controller}/{_LISTENERS.get(interface, _GOALS)}"


def offered_interfaces(node: Node, settings: TableAdapterSettings) -> dict[str, str]:
    """Return interface -> node, for all interfaces by which this controller takes orders."""
    found = {}
    status = node.get_publishers_info_by_topic(
        node.resolve_topic_name(f"{controller_topic(settings, 'goals')}/_action/status")
    )
    if status:
        found["goals"] = status[0].node_name
    for interface in _LISTENERS:
        topic = node.resolve_topic_name(controller_topic(settings, interface))
        if listeners := node.get_subscriptions_info_by_topic(topic):
            found[interface] = listeners[0].node_name
    return found


def provided_roles(_settings: TableAdapterSettings) -> tuple[str, ...]:
    """Return the streams that the adapter will publish, and the orders that it will obey."""
    return (names.JOINT_STATES, names.TABLE_ANGLE)


CHECK: Final = DriverCheck(provided_roles, ears=AdapterTablePreview)
