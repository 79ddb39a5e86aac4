"""The graph of a cell: who publishes, who subscribes, and which of them cannot connect."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from difflib import SequenceMatcher
from typing import Any, Final

from rclpy.duration import Infinite
from rclpy.node import Node
from rclpy.qos import QoSCompatibility, QoSProfile, qos_check_compatible

from rotcal_ros.bags import names
from rotcal_ros.capture.instruments.conventions import OWN
from rotcal_ros.foundation.node_names import VIEWERS
from rotcal_ros.nodes.runtime.message_types import version_mismatch
from rotcal_ros.nodes.runtime.qos import EVENT

ORDERS: Final = (names.TABLE_ANGLE, names.PROBE_TARGET)
NO_MACHINE: Final = frozenset({"capture", "recorder", *VIEWERS.values()})
"""Nodes that subscribe to orders but do not obey them."""
_AS_THE_GRAPH_SHOWS_IT: Final = QoSProfile(
    depth=EVENT.depth,
    reliability=EVENT.reliability,
    durability=EVENT.durability,
    deadline=Infinite,
    lifespan=Infinite,
    liveliness_lease_duration=Infinite,
)


@dataclass(frozen=True)
class ExpectedPublisher:
    """A publisher that is yet to appear."""

    node_name: str
    qos_profile: QoSProfile


PLANNERS: Final = ExpectedPublisher("planner", _AS_THE_GRAPH_SHOWS_IT)
"""The planner's publishers as they will be, for a check before the planner runs."""


class CellGraph:
    """The graph as ``node`` sees it; topics are named as in its cell."""

    def __init__(self, node: Node) -> None:
        self.node = node

    def resolve(self, topic: str) -> str:
        """Return the absolute name of a topic of the cell."""
        return self.node.resolve_topic_name(topic)

    def publishers(self, topic: str) -> list[str]:
        """Return the names of the nodes that publish ``topic``."""
        return sorted(info.node_name for info in self.offers(topic))

    def listeners(self, topic: str) -> list[str]:
        """Return the names of the nodes that subscribe to ``topic``."""
        return sorted(info.node_name for info in self.subscriber_infos(topic))

    def nodes(self) -> list[tuple[str, str]]:
        """Return name and namespace of all nodes of the domain."""
        return [*self.node.get_node_names_and_namespaces()]

    def machines(self, topic: str) -> list[str]:
        """Return the names of the nodes that obey the order ``topic``."""
        return sorted(set(self.listeners(topic)) - NO_MACHINE)

    def offers(self, topic: str) -> list[Any]:
        """Return what rclpy knows of the publishers of ``topic``."""
        return list(self.node.get_publishers_info_by_topic(self.resolve(topic)))

    def subscriber_infos(self, topic: str) -> list[Any]:
        """Return what rclpy knows of the subscribers of ``topic``."""
        return list(self.node.get_subscriptions_info_by_topic(self.resolve(topic)))

    def instrument_faults(self, topic: str, has_delivered: bool) -> Iterator[str]:
        """Yield why the cell cannot use an instrument's ``topic``."""
        name, publishers = self.resolve(topic), self.publishers(topic)
        if not publishers:
            yield f"no node publishes {name}: start its instrument"
        elif len(publishers) > 1:
            yield from self.duplicate_publishers(topic)
        elif not has_delivered:
            yield f"{name} has not delivered a valid message (node {publishers[0]})"
        yield from incompatible_listeners(self.node, name, {"capture", "recorder"}.__contains__)

    def other_versions(self, heard: Iterable[str], obeyed: Iterable[str] = ()) -> Iterator[str]:
        """Yield which nodes define messages otherwise than they are here.

        Publishers of the topics that are ``heard`` count, and machines that obey the others: such
        a message may end the node that takes it.
        """
        ends = [(topic, info) for topic in heard for info in self.offers(topic)]
        ends += [
            (topic, info)
            for topic in obeyed
            for info in self.subscriber_infos(topic)
            if info.node_name not in NO_MACHINE
        ]
        for topic, info in ends:
            if text := version_mismatch(info.topic_type, str(info.topic_type_hash)):
                yield f"{self.resolve(topic)}: node {info.node_name} has {text}"

    def elsewhere(self, role: str, own: str) -> str:
        """Return what to do if ``own`` lacks a publisher, but another topic may be that of a role.

        Of several the one whose name is nearest; empty if there is none.
        """
        place, _, last = own.rpartition("/")
        found = [
            (name.endswith(f"/{last}"), SequenceMatcher(None, name, own).ratio(), name, types[0])
            for name, types in self.node.get_topic_names_and_types()
            if name.endswith(f"/{role}") or OWN[role] in types
            if name != own and self.offers(name)
        ]
        if not found:
            return ""
        same, _, name, kind = max(found)
        if not same:
            return (
                f"is it {name} ({kind})? Set topics.{role}: {name}, or remap it: "
                f"--ros-args -r {name}:={own}"
            )
        there = name.rpartition("/")[0] or "/"
        return (
            f"such topics are in {there}: set cell.namespace (rotcal cell check --namespace "
            f"{there} looks there), or start their nodes with --ros-args -r __ns:={place}"
        )

    def duplicate_publishers(self, topic: str) -> Iterator[str]:
        """Yield a complaint if an instrument's ``topic`` has several publishers."""
        publishers = self.publishers(topic)
        if len(publishers) > 1:
            yield (
                f"{len(publishers)} publishers on {self.resolve(topic)} (nodes "
                f"{', '.join(publishers)}): one instrument topic has one publisher; stop the "
                "others"
            )

    def machine_faults(self, topic: str) -> Iterator[str]:
        """Yield why no machine can receive the order ``topic``.

        A machine that cannot does not matter if another one can.
        """
        machines = self.machines(topic)
        if not machines:
            yield f"no node obeys {self.resolve(topic)}: start the machine's node"
        planners = () if self.publishers(topic) else (PLANNERS,)
        obeys = set(machines).__contains__
        unmatched = [*incompatible_listeners(self.node, self.resolve(topic), obeys, planners)]
        if len(unmatched) >= len(machines):
            yield from unmatched


def incompatible_listeners(
    node: Node,
    topic: str,
    counts: Callable[[str], bool],
    to_come: Iterable[ExpectedPublisher] = (),
) -> Iterator[str]:
    """Yield which subscribers of an absolute ``topic`` cannot receive from a publisher.

    ``counts`` says by its node name whether a subscriber matters.
    """
    for source in (*node.get_publishers_info_by_topic(topic), *to_come):
        for reader in node.get_subscriptions_info_by_topic(topic):
            if not counts(reader.node_name):
                continue
            verdict, why = qos_check_compatible(source.qos_profile, reader.qos_profile)
            if verdict == QoSCompatibility.ERROR:
                yield (
                    f"node {reader.node_name} cannot receive {topic} from node "
                    f"{source.node_name}: their qualities of service do not match "
                    f"({why.strip(' ;')})"
                )
