"""Who stops the cell, as far as the graph shows it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Final

from rotcal_ros.catalogue.check_lines import CheckLine

if TYPE_CHECKING:
    from rotcal_ros.nodes.check_heard import Heard

_TYPE: Final = "std_msgs/msg/Bool"


def safety_lines(heard: Heard) -> Iterator[CheckLine]:
    """Yield whether somebody publishes the emergency stop, in the type that is understood."""
    stop = heard.configuration.safety.emergency_stop
    if not stop:
        return
    name, offers = heard.graph.resolve(stop), heard.graph.offers(stop)
    others = sorted({info.topic_type for info in offers} - {_TYPE})
    if others:
        found = f"{name} is of type {', '.join(others)}, which no node understands as a stop"
        todo = f"publish the stop as {_TYPE}, or correct safety.emergency_stop"
        yield CheckLine("safety", "emergency_stop", "missing", found, todo)
    elif offers:
        nodes = ", ".join(sorted({info.node_name for info in offers}))
        yield CheckLine("safety", "emergency_stop", "good", f"node {nodes} publishes {name}")
    elif "safety.emergency_stop" in heard.configuration.given:
        todo = "start the safety controller's node, or correct safety.emergency_stop"
        yield CheckLine("safety", "emergency_stop", "doubt", f"nobody publishes {name}", todo)
    else:
        found = f"nobody publishes {name}: no message stops this cell"
        yield CheckLine("safety", "emergency_stop", "note", found)
