"""The names of the cell's topics, as the nodes exchange them in their beats; no ROS.

A topic has the name of its role, below the namespace of the cell, unless it is remapped or the
configuration names another one in its group ``topics``.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final

from rotcal_ros.bags import names
from rotcal_ros.methods import Configuration
from rotcal_ros.nodes.writing.recording import Recording

TOPIC: Final = "topic."
"""Beginning of the values of a beat with the absolute name of a role that has another name."""
TOPICS: Final = "topics"
"""Value of the planner while it has a goal: what its group ``topics`` gives, as JSON; of the
capture: what it follows."""
_TELLERS: Final[Mapping[str, str]] = {
    names.PLAN: "planner",
    names.TABLE_ANGLE: "planner",
    names.PROBE_TARGET: "planner",
    names.STEP_CHOICE: "planner",
    names.TABLE_IN_FORCE: "solver",
}
"""Which node decides the name of a role; the capture for all others."""
_HEARD_OF_THE_PLANNER: Final = {
    "capture": (names.PLAN, names.OBSERVATION, names.TABLE_ANGLE, names.PROBE_TARGET),
    "solver": (names.PLAN, names.OBSERVATION),
}
"""Roles whose names a node must share with the planner."""

Values = Callable[[str], Mapping[str, str]]
"""The values of the last beat of a node."""
Resolve = Callable[[str], str]
"""The absolute name of a topic for this node."""


def plain_name(namespace: str, role: str) -> str:
    """Return the default name of the topic of a role."""
    return f"{namespace.rstrip('/')}/{role}"


def other_names(namespace: str, resolve: Resolve) -> dict[str, str]:
    """Return the values of a beat for roles that have another name in a node."""
    called = {role: resolve(role) for role in sorted(names.ROLES)}
    return {f"{TOPIC}{r}": n for r, n in called.items() if n != plain_name(namespace, r)}


class CalledOtherwise:
    """Which topics play which role, by the latest beats of the nodes that decide it."""

    def __init__(self, namespace: str) -> None:
        self._namespace = namespace
        self.topics: dict[str, str] = {}

    def look(self, values: Values) -> None:
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
        """Return the role of a topic by its absolute name; its last name where it has none."""
        for role, other in self.topics.items():
            if topic == other:
                return role
        last = topic.rpartition("/")[2]
        return "" if last in self.topics else last

    def lost(self, losses: Mapping[str, int]) -> int:
        """Return how many messages that a replay needs were lost, of ``losses`` by counter."""
        topics = ((counter.rpartition(" ")[2], count) for counter, count in losses.items())
        return sum(count for topic, count in topics if self.role(topic) in names.ROLES)

    def keep_in(self, recording: Recording) -> None:
        """Note in a bag which topics have other names."""
        if self.topics:
            recording.note(names.TOPICS, self.topics)


def name_in(values: Mapping[str, str], role: str) -> str:
    """Return the name of a topic for people; its role where that is its name."""
    return values.get(TOPIC + role, role)


def at_odds(values: Values, namespace: str, resolve: Resolve) -> Iterator[str]:
    """Yield in words which topics have other names in a node than in the planner."""
    for node, roles in _HEARD_OF_THE_PLANNER.items():
        for role in roles:
            theirs = values(node).get(TOPIC + role, plain_name(namespace, role))
            if theirs != resolve(role):
                yield (
                    f"topic {role} is {resolve(role)} for the planner and {theirs} for node "
                    f"{node}: remap it for all nodes of the cell, or for none"
                )


def names_at_odds(node: Any, topics_of_goal: str) -> list[str]:
    """Return why the names of topics do not fit, in words, as the planner's ``node`` sees it."""
    values = node.health.values
    if values("capture").get(TOPICS) != topics_of_goal:
        return ["node capture has not taken the names in the group topics yet"]
    return list(at_odds(values, node.get_namespace(), node.resolve_topic_name))


def given_topics(configuration: Configuration) -> dict[str, Any]:
    """Return what a configuration gives in its group ``topics``."""
    given = (name.partition(".") for name in configuration.given)
    found = {name for group, _, name in given if group == "topics" and name}
    return {name: getattr(configuration.topics, name) for name in sorted(found)}


def topics_value(configuration: Configuration) -> str:
    """Return the values of a planner's beat for its goal's group ``topics``."""
    return json.dumps(given_topics(configuration), sort_keys=True)
