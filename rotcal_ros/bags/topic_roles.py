"""Finds which topics of a cell play which role, as its nodes say or have recorded."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

from rotcal_ros.bags import names

TOPIC: Final = "topic."
"""Beginning of the values of a beat with the absolute name of a role that has another name."""
_TELLERS: Final[Mapping[str, str]] = {
    names.PLAN: "planner",
    names.TABLE_ANGLE: "planner",
    names.PROBE_TARGET: "planner",
    names.STEP_CHOICE: "planner",
    names.TABLE_IN_FORCE: "solver",
}
"""Which node decides the name of a role; the capture for all others."""
Values = Callable[[str], Mapping[str, str]]
"""The values of the last beat of a node."""


def plain_name(namespace: str, role: str) -> str:
    """Return the default name of the topic of a role."""
    return f"{namespace.rstrip('/')}/{role}"


class TopicRoleFinder:
    """Knows which topics play which role, by the latest beats of the nodes that decide it."""

    def __init__(self, namespace: str) -> None:
        self._namespace = namespace
        self.topics: dict[str, str] = {}

    def poll(self, values: Values) -> None:
        """Take the beats of the nodes that are there; what a node said before it left stays."""
        for role in names.ROLES:
            if beat := values(_TELLERS.get(role, "capture")):
                self.topics.pop(role, None)
                if other := beat.get(TOPIC + role):
                    self.topics[role] = other

    def topic(self, role: str) -> str:
        """Return the absolute name of the topic of a role."""
        return self.topics.get(role, plain_name(self._namespace, role))

    def role(self, topic: str) -> str:
        """Return the role of a topic by its absolute name; its last name if it has none."""
        for role, other in self.topics.items():
            if topic == other:
                return role
        last = topic.rpartition("/")[2]
        return "" if last in self.topics else last

    def lost(self, losses: Mapping[str, int]) -> int:
        """Return how many messages that a replay needs were lost, of ``losses`` by counter."""
        topics = ((counter.rpartition(" ")[2], count) for counter, count in losses.items())
        return sum(count for topic, count in topics if self.role(topic) in names.ROLES)

    def keep(self, note: Callable[[str, dict[str, str]], object]) -> None:
        """Note in a bag which topics have other names."""
        if self.topics:
            note(names.TOPICS, self.topics)
