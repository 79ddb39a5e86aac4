"""What must be there before the first motion."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from rotcal_ros.bags import names
from rotcal_ros.node_names import PREFLIGHT_NODES
from rotcal_ros.nodes.cell_links import CellLinks
from rotcal_ros.nodes.goal_watch import Codes, GoalWatch
from rotcal_ros.nodes.health import Health

ORDERS: Final = (names.TABLE_ANGLE, names.PROBE_TARGET)


async def check(watch: GoalWatch, topics: Sequence[str]) -> None:
    """Wait for all nodes and ``topics``; GoalError names what is missing after the time for it."""
    links, health = watch.links, watch.links.health
    links.forget()
    watch.tell("preflight: nodes")
    await watch.have(lambda: missing_nodes(links), Codes.NODE_LOST)
    watch.nodes = health.present() | set(PREFLIGHT_NODES)
    watch.tell("preflight: topics")
    await watch.have(lambda: missing_topics(links, topics), Codes.TOPIC_MISSING)
    watch.nodes |= health.present()


def missing_nodes(links: CellLinks) -> list[str]:
    """Return what keeps the nodes of the suite from working together, in words."""
    lost = [f"node {name} does not beat" for name in links.health.missing(PREFLIGHT_NODES)]
    for node, client in (
        ("recorder", links.start_recording),
        ("recorder", links.stop_recording),
        ("solver", links.finish_calibration),
    ):
        if not lost and not client.service_is_ready():
            lost.append(f"node {node} does not offer {client.srv_name}")
    return lost


def missing_topics(links: CellLinks, topics: Sequence[str]) -> list[str]:
    """Return what is missing around the instrument topics and the orders, in words."""
    found: list[str] = []
    heard = links.health.values("capture")
    for topic in topics:
        name = links.resolve(topic)
        publishers = links.publishers(topic)
        if not publishers:
            found.append(f"nobody publishes {name}: start its instrument")
        elif len(publishers) > 1:
            found.append(
                f"{len(publishers)} publishers on {name} (nodes {', '.join(publishers)}): "
                "one instrument topic has one publisher; stop the others"
            )
        elif heard.get(f"valid.{topic}", "0") == "0":
            found.append(f"{name} has not delivered a valid message (node {publishers[0]})")
    disobeyed = (t for t in ORDERS if not set(links.listeners(t)) - {"capture", "recorder"})
    found += [f"nobody obeys {links.resolve(t)}: start the machine's node" for t in disobeyed]
    recorded = (*topics, *ORDERS, names.PLAN, names.OBSERVATION)
    unheard = (topic for topic in recorded if "recorder" not in links.listeners(topic))
    return found + [f"the recorder does not listen to {links.resolve(t)} yet" for t in unheard]


def missing_plan(health: Health, run: str) -> list[str]:
    """Return which nodes have not taken the plan of this run, with their reason."""
    return [
        f"node {name} has not taken the plan ({health.state(name) or 'silent'})"
        for name in ("capture", "solver")
        if health.values(name).get("run") != run
    ]
