"""The names of the cell's topics, as the nodes exchange them in their beats; no ROS.

A topic has the name of its role, below the namespace of the cell, unless it is remapped or the
configuration names another one in its group ``topics``.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final

from rotcal_ros.bags import names
from rotcal_ros.bags.topic_roles import TOPIC, Values, plain_name
from rotcal_ros.methods import Configuration

TOPICS: Final = "topics"
"""Value of the planner while it has a goal: what its group ``topics`` gives, as JSON; of the
capture: what it follows."""
_HEARD_OF_THE_PLANNER: Final = {
    "capture": (names.PLAN, names.OBSERVATION, names.TABLE_ANGLE, names.PROBE_TARGET),
    "solver": (names.PLAN, names.OBSERVATION),
}
"""Roles whose names a node must share with the planner."""

Resolve = Callable[[str], str]
"""The absolute name of a topic for this node."""


def other_names(namespace: str, resolve: Resolve) -> dict[str, str]:
    """Return the values of a beat for roles that have another name in a node."""
    called = {role: resolve(role) for role in sorted(names.ROLES)}
    return {f"{TOPIC}{r}": n for r, n in called.items() if n != plain_name(namespace, r)}


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
