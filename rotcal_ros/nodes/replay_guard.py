"""Company in which no bag is replayed: a machine that would move, a second source of a topic."""

from __future__ import annotations

import time
from argparse import Namespace
from collections.abc import Callable, Iterable, Iterator
from typing import Final

from rclpy.node import Node

from rotcal_ros.bags import names
from rotcal_ros.errors import ConfigurationError
from rotcal_ros.node_names import NODES, VIEWERS
from rotcal_ros.nodes.health import CALIBRATING, Health
from rotcal_ros.nodes.replayed_bag import CLOCK, ReplayedBag

WATCHERS: Final = frozenset({
    *NODES, *VIEWERS.values(), "player", "foxglove_bridge", "rosbridge_websocket",
    "rosbag2_recorder", "rviz", "rviz2", "rqt_gui_py_node",
})  # fmt: skip
"""Nodes that listen to orders without obeying them."""
ORDERS: Final = (names.TABLE_ANGLE, names.PROBE_TARGET)
"""Roles that move machines."""
_COMMAND_LINE: Final = "_ros2cli"
_OF_THE_PLANNER: Final = (
    names.PLAN, names.TABLE_ANGLE, names.PROBE_TARGET, names.STEP_CHOICE
)  # fmt: skip
"""Roles that an idle planner is known to publish."""
_NAMELESS: Final = "_NODE_NAME_UNKNOWN_"
"""What the middleware calls a node whose topics it hears of before its name."""
_NAMES_S, _PERIOD_S = 10.0, 1.0
Wait = Callable[[Callable[[], bool], float], object]


class ReplayGuard:
    """Looks around again and again; ``wait`` waits while the recording stands still.

    A node is known by its topics before it is by its name: each gets some time to tell it.
    """

    def __init__(
        self, node: Node, health: Health, bag: ReplayedBag, given: Namespace, wait: Wait
    ) -> None:
        self._node, self._health, self._bag, self._given = node, health, bag, given
        self._wait = wait
        self._looked_s = 0.0
        self._had_time = set[bytes]()

    def is_due(self) -> bool:
        """Return whether the last look was long ago."""
        return time.monotonic() - self._looked_s > _PERIOD_S

    def look(self, *topics: str) -> None:
        """Raise ConfigurationError when a machine, or another source, of ``topics`` is there."""
        self._wait(lambda: not self._nameless(topics), _NAMES_S)
        self._had_time |= self._nameless(topics)
        self._looked_s = time.monotonic()
        if found := conflicts(self._node, self._health, self._bag, topics, self._given):
            raise ConfigurationError("; ".join(found))

    def _nameless(self, topics: Iterable[str]) -> set[bytes]:
        """Return publishers of ``topics`` and listeners to orders without a name, by their gid."""
        publishers, listeners = (
            self._node.get_publishers_info_by_topic,
            self._node.get_subscriptions_info_by_topic,
        )
        ends = [info for topic in topics for info in publishers(topic)]
        orders = [topic for topic in topics if self._bag.called.role(topic) in ORDERS]
        ends += [info for topic in orders for info in listeners(topic)]
        found = {bytes(info.endpoint_gid) for info in ends if info.node_name == _NAMELESS}
        return found - self._had_time


def conflicts(
    node: Node, health: Health, bag: ReplayedBag, topics: Iterable[str], given: Namespace
) -> list[str]:
    """Return why these topics must not be published here, in words."""
    if not given.everything and health.state("planner").startswith(CALIBRATING):
        return ["a calibration is running here (node planner): nothing is replayed into it"]
    found = [*_moved(node, bag, topics, given.watchers), *_sources(node, bag, topics)]
    if given.clock and (others := _publishers(node, CLOCK)):
        found.append(f"{', '.join(others)} publishes {CLOCK} already: leave --clock out")
    return found


def _moved(
    node: Node, bag: ReplayedBag, topics: Iterable[str], watchers: Iterable[str]
) -> Iterator[str]:
    """Yield which machines would obey the recorded orders."""
    harmless = WATCHERS | {*watchers}
    for topic in topics:
        if bag.called.role(topic) not in ORDERS:
            continue
        listening = {info.node_name for info in node.get_subscriptions_info_by_topic(topic)}
        for name in sorted(listening - harmless):
            if not name.startswith(_COMMAND_LINE):
                yield (
                    f"node {name} listens to {topic}: replayed orders would move its machine; end "
                    f"it, use another ROS_DOMAIN_ID, or say that it only looks: --watcher {name}"
                )


def _sources(node: Node, bag: ReplayedBag, topics: Iterable[str]) -> Iterator[str]:
    """Yield which topics come from somebody else already."""
    for topic in topics:
        others = _publishers(node, topic)
        if bag.called.role(topic) in _OF_THE_PLANNER:
            others = [name for name in others if name != "planner"]
        if others and not topic.startswith(("/rosout", "/diagnostics")):
            yield (
                f"{', '.join(others)} publishes {topic} already: end it, use another "
                "ROS_DOMAIN_ID" + (", or leave --all out" if topic in bag.outputs else "")
            )


def _publishers(node: Node, topic: str) -> list[str]:
    found = {info.node_name for info in node.get_publishers_info_by_topic(topic)}
    return sorted(found - {node.get_name()})
