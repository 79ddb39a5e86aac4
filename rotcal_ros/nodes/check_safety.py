"""Who stops the cell, as far as the graph shows it; whether a stop is on is the preflight's."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Final

from rotcal_ros.catalogue.check_lines import CheckLine

if TYPE_CHECKING:
    from rotcal_ros.nodes.check_heard import Heard

_TYPE: Final = "std_msgs/msg/Bool"


def safety_lines(heard: Heard) -> Iterator[CheckLine]:
    """Yield what stops the cell: a topic, names on /diagnostics, or nothing."""
    settings = heard.configuration.safety
    if settings.emergency_stop:
        yield _topic_line(heard)
    if settings.stop_on_diagnostics:
        found = f"an ERROR of {', '.join(settings.stop_on_diagnostics)} stops the cell"
        yield CheckLine("safety", "/diagnostics", "note", found)


def _topic_line(heard: Heard) -> CheckLine:
    """Say whether somebody publishes the emergency stop, in the type that is understood."""
    settings = heard.configuration.safety
    name = heard.graph.resolve(settings.emergency_stop)
    offers = heard.graph.offers(settings.emergency_stop)
    others = sorted({info.topic_type for info in offers} - {_TYPE})
    if others:
        found = f"{name} is of type {', '.join(others)}, which no node understands as a stop"
        todo = f"publish the stop as {_TYPE}, or correct safety.emergency_stop"
        return CheckLine("safety", "emergency_stop", "missing", found, todo)
    if offers:
        nodes = ", ".join(sorted({info.node_name for info in offers}))
        return CheckLine("safety", "emergency_stop", "good", f"node {nodes} publishes {name}")
    todo = "start the safety controller's node, or correct safety.emergency_stop"
    if settings.silent_s:
        found = f"nobody publishes {name}, and its silence stops the cell (safety.silent_s)"
        return CheckLine("safety", "emergency_stop", "missing", found, todo)
    if "safety.emergency_stop" in heard.configuration.given:
        return CheckLine("safety", "emergency_stop", "doubt", f"nobody publishes {name}", todo)
    return CheckLine("safety", "emergency_stop", "note", f"nobody publishes {name}")
