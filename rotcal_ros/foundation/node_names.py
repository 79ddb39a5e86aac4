"""All nodes, and which are started when; this module imports nothing of rotcal_ros."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

NODES: Final = ("planner", "capture", "solver", "recorder")
"""Nodes of every cell."""
FURTHER_NODES: Final[Mapping[str, str]] = {
    "bridge": "bridge",
    "table_adapter": "table_adapter",
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
