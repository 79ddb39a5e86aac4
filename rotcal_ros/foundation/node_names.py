"""All nodes, and which are started when; this module imports nothing of rotcal_ros."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Final

NODES: Final = ("planner", "capture", "solver", "recorder")
"""Nodes of every cell."""
FURTHER_NODES: Final[Mapping[str, str]] = {
    "bridge": "bridge",
    "table_adapter": "table_adapter",
    "dme": "dme_adapter",
    "instrument": "instrument_driver",
    "simulation": "simulated_cell",
}
"""Nodes that are started when the configuration has a group: group -> node."""
PAGE: Final = "page"
VIEWERS: Final[Mapping[str, str]] = {PAGE: "operator_page", "scene": "scene"}
"""Nodes for people: option -> node. No calibration needs one or ends with it."""
DRIVERS: Final = ("linuxcnc_driver",)
"""Nodes that are started by hand, for the user's machine."""
EXECUTABLES: Final = (*NODES, *FURTHER_NODES.values(), *VIEWERS.values(), *DRIVERS)
"""All nodes of the core; each is a command of the package, and setup.py names its module."""
PREFLIGHT_NODES: Final = tuple(name for name in NODES if name != "planner")
"""Nodes that must beat before anything moves; the planner checks this."""


def further_nodes(groups: Collection[str]) -> list[str]:
    """Return the nodes that a configuration with these groups starts besides those of every cell.

    ``rotcal dme serve`` plays a simulated machine behind I++ DME, which needs no node.
    """
    elsewhere = {"simulation"} if "dme" in groups else set()
    return [node for g, node in FURTHER_NODES.items() if g in groups and g not in elsewhere]
