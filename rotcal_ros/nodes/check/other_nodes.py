"""Who else is in the graph: nodes of a calibration, no nodes at all, topics with similar names."""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import TYPE_CHECKING, Final

from rotcal_ros.foundation.node_names import NODES, further_nodes
from rotcal_ros.methods.check_lines import CheckLine
from rotcal_ros.nodes.runtime.cell_graph import CellGraph
from rotcal_ros.sessions.domains import DEFAULT_DOMAIN, domains_in_use

if TYPE_CHECKING:
    from rotcal_ros.nodes.check.cell_snapshot import CellSnapshot

_OURS: Final = ("cell_check", "_cell_check_ears")


def cell_lines(snapshot: CellSnapshot) -> Iterator[CheckLine]:
    """Yield who is there."""
    others = [pair for pair in snapshot.graph.nodes() if pair[0] not in _OURS]
    place = snapshot.graph.node.get_namespace()
    here = sorted(snapshot.nodes - {*_OURS})
    if not others:
        yield _nobody(snapshot)
    else:
        elsewhere = len(others) - len(here)
        more = f"; {elsewhere} elsewhere in this domain" if elsewhere else ""
        yield CheckLine("cell", "nodes", "note", f"{', '.join(here) or 'none'} in {place}{more}")
    if busy := sorted({*here} & {*NODES, *further_nodes(snapshot.configuration.given)}):
        found = f"nodes of a calibration are here already: {', '.join(busy)}"
        todo = "rotcal run would be refused here: let it end (rotcal attach), or use its nodes"
        yield CheckLine("cell", "calibration", "doubt", found, todo)


def _nobody(snapshot: CellSnapshot) -> CheckLine:
    """Return the line of a graph with nobody in it, and how to look elsewhere."""
    domain = int(os.environ.get("ROS_DOMAIN_ID") or DEFAULT_DOMAIN)
    if snapshot.started_by_us:
        return CheckLine("cell", "nodes", "note", "none; rotcal run starts the simulated ones")
    if snapshot.brought.keys() >= {*snapshot.topics}:
        return CheckLine("cell", "nodes", "note", "none; rotcal run starts the drivers")
    used = [d for d in domains_in_use() if d != domain]
    todo = "start your nodes with the same ROS_DOMAIN_ID and ROS_AUTOMATIC_DISCOVERY_RANGE as here"
    if used:
        shown = ", ".join(map(str, used))
        todo = (
            f"on this machine there are participants in ROS_DOMAIN_ID {shown}: "
            f"ROS_DOMAIN_ID={used[0]} rotcal cell check ..."
        )
    return CheckLine("cell", "nodes", "missing", f"nobody at all in domain {domain}", todo)


def namesakes(graph: CellGraph, topic: str, own: str, kind: str) -> str | None:
    """Return what to do where another topic has the last name or the type; None: none has."""
    found = []
    for name, types in graph.node.get_topic_names_and_types():
        alike = name.rpartition("/")[2] == topic or kind in types
        if name != own and alike and graph.node.get_publishers_info_by_topic(name):
            found.append((name.rpartition("/")[2] != topic, name, types[0]))
    if not found:
        return None
    other, name, of_type = min(found)
    if other:
        return f"is it {name} ({of_type})? Remap it: --ros-args -r {name}:={own}"
    place = name.rpartition("/")[0] or "/"
    return (
        f"such topics are in {place}: set cell.namespace (rotcal cell check --namespace {place} "
        f"looks there), or start their nodes with --ros-args -r __ns:={own.rpartition('/')[0]}"
    )
