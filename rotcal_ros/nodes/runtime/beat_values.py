"""The values in a node's beat, by key: warnings, latest readings, names of topics. Needs no ROS.

A beat (rotcal_msgs/NodeState) carries key and value as text. Warnings stay there as long as they
hold, and appear in /diagnostics too. The capture adds the latest reading of every instrument, so
that people see it without subscribing to a stream of 1 kHz themselves.

A topic has the name of its role below the namespace of the cell, unless it is remapped or the
group ``topics`` of the configuration names another one; a beat lists such other names.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Iterator, Mapping
from typing import Any, Final

from rotcal_ros.bags import names
from rotcal_ros.bags.topic_roles import TOPIC, Values, plain_name
from rotcal_ros.capture import Record
from rotcal_ros.capture.instruments.steps import Position
from rotcal_ros.foundation.observations import (
    HumiditySample,
    LengthStatus,
    PressureSample,
    ProbeSample,
    TableSample,
    TracerSample,
)
from rotcal_ros.foundation.observations import TemperatureSample as Thermometer
from rotcal_ros.methods import Configuration

REJECTED: Final = "rejected_running"
"""The attempts that were rejected since the last accepted one, and the reasons."""
COMPLAINT: Final = "complaint"
"""What keeps the present order from being measured."""
PREFLIGHT: Final = "preflight"
"""What looks wrong about the instruments before anything moves."""
PREFLIGHT_WAITS: Final = "preflight_waits"
"""What a preflight lacks and waits for."""
OFFSET: Final = "clock_offset"
"""Streams whose clocks differ, and by how much."""
CLOCK_DOUBT: Final = "clock_doubt"
"""Streams whose clocks seem to differ by less than what is rejected."""
FOREIGN_PLAN: Final = "foreign_plan"
"""A plan that is not the planner's."""
INTRUDER: Final = "intruder"
"""Who publishes on a topic of the run, but was not there when it began."""
SIM_CLOCK: Final = "sim_clock"
"""A node that follows ``/clock`` reports that it stands still or does not come."""
EMERGENCY: Final = "emergency_stop"
"""Who stops the cell, and what this node does meanwhile."""
BLOCKED: Final = "blocked"
"""Why a machine does nothing until a person has cleared it."""
SLOW: Final = "slow"
"""The slow nodes that are waited for, with the load of the machine."""
FOR_PEOPLE: Final = (
    REJECTED, COMPLAINT, PREFLIGHT_WAITS, PREFLIGHT, OFFSET, CLOCK_DOUBT, FOREIGN_PLAN, INTRUDER,
    SIM_CLOCK, BLOCKED, SLOW,
)  # fmt: skip
"""Values in a beat that are shown to the person who runs a calibration."""
OF_MACHINES: Final = (BLOCKED, COMPLAINT)
"""Values in a beat that may explain why a calibration cannot go on."""


def set_warning(health: Any, key: str, text: str | None, *, alarm: bool = False) -> None:
    """Show ``text`` as a warning, or with ``alarm`` as an error; None: it is over."""
    for book, is_its in ((health.concerns, not alarm), (health.alarms, alarm)):
        book.pop(key, None)
        if text and is_its:
            book[key] = text


def reported_warnings(health: Any, keys: Collection[str] = FOR_PEOPLE) -> Iterator[str]:
    """Yield the present warnings of the other nodes under these ``keys``."""
    for name in health.others:
        values = health.values(name)
        yield from (f"{name}: {values[key]}" for key in keys if key in values)


NOW: Final = "now."
"""Beginning of the capture's values with the latest reading of a topic."""
FRAME: Final = "frame."
"""Beginning of the capture's values with the frame in a topic's headers."""
HOPELESS: Final = "hopeless"
"""Value in the capture's beat: why no attempt at any step will ever be accepted."""
WAITING_FOR: Final = "waiting_for"
"""Value of the capture: what its oldest undecided attempt waits for, in words."""
RATE: Final = "rate_hz."
"""Beginning of the capture's values with the rate of a stream."""
SCATTER: Final = "scatter_m."
"""Beginning of the capture's values with the standard deviation of a stream's readings."""
REFUSED: Final = "refused."
"""Beginning of the capture's values with the reason why a topic's message type cannot be used."""
SILENT: Final = "silent_s."
"""Beginning of the capture's values with the silence of a stream in seconds."""
JOINT: Final = "joint."
"""Beginning of the capture's values with angle (rad) and velocity (rad/s) of a joint."""
MOST_JOINTS: Final = 32
"""Largest number of joints in a beat, besides the chosen one once there is a plan."""


def reading_values(record: Record | Position) -> str:
    """Return a reading in SI: length and status, point, angle, or air and sensor."""
    match record:
        case TracerSample():
            return f"{record.length:.9f} {LengthStatus(record.status).name}"
        case ProbeSample() | Position():
            return " ".join(f"{x:.7f}" for x in record.position)
        case TableSample():
            return f"{record.angle:.9f}"
        case Thermometer():
            return f"{record.temperature_c:.4f} {record.sensor}"
        case PressureSample():
            return f"{record.pressure_pa:.1f} {record.sensor}"
        case HumiditySample():
            return f"{record.humidity:.4f} {record.sensor}"
    return ""


TOPICS: Final = "topics"
"""Value of the planner while it has a goal: its group ``topics`` as JSON; of the
capture: what it follows."""
LISTENS: Final = "listens_to"
"""Value of the recorder: the absolute names of the topics that it listens to."""
_HEARD_OF_THE_PLANNER: Final = {
    "capture": (names.PLAN, names.OBSERVATION, names.TABLE_ANGLE, names.PROBE_TARGET),
    "solver": (names.PLAN, names.OBSERVATION),
}
"""Roles whose names a node must share with the planner."""

Resolve = Callable[[str], str]
"""The absolute name of a topic for this node."""


def remapped_topic_values(namespace: str, resolve: Resolve) -> dict[str, str]:
    """Return the values of a beat for roles that have another name in a node."""
    called = {role: resolve(role) for role in sorted(names.ROLES)}
    return {f"{TOPIC}{r}": n for r, n in called.items() if n != plain_name(namespace, r)}


def displayed_topic(values: Mapping[str, str], role: str) -> str:
    """Return the name of a role's topic to show; the role itself where it is not renamed."""
    return values.get(TOPIC + role, role)


def mismatched_topics(values: Values, namespace: str, resolve: Resolve) -> Iterator[str]:
    """Yield which topics have another name in a node than in the planner, in words."""
    for node, roles in _HEARD_OF_THE_PLANNER.items():
        for role in roles:
            theirs = values(node).get(TOPIC + role, plain_name(namespace, role))
            if theirs != resolve(role):
                yield (
                    f"topic {role} is {resolve(role)} for the planner and {theirs} for node "
                    f"{node}: remap it for all nodes of the cell, or for none"
                )


def mismatched_topic_lines(node: Any, topics_of_goal: str) -> list[str]:
    """Return which names of topics do not match, in words, as the planner's ``node`` sees it."""
    values = node.health.values
    if values("capture").get(TOPICS) != topics_of_goal:
        return ["node capture has not taken the names in the group topics yet"]
    return list(mismatched_topics(values, node.get_namespace(), node.resolve_topic_name))


def configured_topics(configuration: Configuration) -> dict[str, Any]:
    """Return what a configuration gives in its group ``topics``."""
    given = (name.partition(".") for name in configuration.given)
    found = {name for group, _, name in given if group == "topics" and name}
    return {name: getattr(configuration.topics, name) for name in sorted(found)}


def topics_value(configuration: Configuration) -> str:
    """Return the values of a planner's beat for its goal's group ``topics``."""
    return json.dumps(configured_topics(configuration), sort_keys=True)
