"""The machine of a cell: the joint of its table, and who obeys the two orders."""

from __future__ import annotations

from collections.abc import Iterator
from math import isfinite
from typing import TYPE_CHECKING, Final

from rotcal_ros.bags import names
from rotcal_ros.catalogue.check_lines import CheckLine
from rotcal_ros.escapes import printable
from rotcal_ros.nodes.cell_graph import ORDERS
from rotcal_ros.nodes.check_adapter import controller_lines
from rotcal_ros.nodes.check_drivers import brought_line
from rotcal_ros.nodes.table_feedback import (
    chosen_joint,
    joint_doubts,
    joints,
    table_angle,
)
from rotcal_ros.table_motion import PUBLISH_VELOCITY
from rotcal_ros.units import DEGREE

if TYPE_CHECKING:
    from rotcal_ros.nodes.check_heard import Heard

_PARTS: Final = {names.TABLE_ANGLE: "table", names.PROBE_TARGET: "probe"}
_TYPES: Final = {
    names.TABLE_ANGLE: "rotcal_msgs/msg/TableAngle",
    names.PROBE_TARGET: "rotcal_msgs/msg/ProbeTarget",
}


def machine_lines(heard: Heard) -> Iterator[CheckLine]:
    """Yield a line for the joint and for every order."""
    if heard.adapter is not None:
        yield from _adapter_lines(heard)
    elif joints(heard.values):
        yield _joint_line(heard)
    for order in ORDERS:
        yield from _order_lines(heard, order)


def table_start(heard: Heard) -> float:
    """Return where the table stands (rad), as far as it was heard."""
    angle = table_angle(heard.values, heard.configuration)
    return angle if isfinite(angle) and not next(_doubts(heard), "") else 0.0


def _doubts(heard: Heard) -> Iterator[str]:
    return joint_doubts(heard.values, heard.configuration)


def _joint_line(heard: Heard) -> CheckLine:
    joint = heard.configuration.cell.joint
    chosen = chosen_joint(heard.values, joint)
    if fault := next(heard.joint_faults(), ""):
        there = ", ".join(map(printable, joints(heard.values)))
        todo = f"cell.joint: one of {there}"
        if chosen in joints(heard.values):
            todo = f"velocity of the joint: {PUBLISH_VELOCITY}"
        return CheckLine("table", "joint", "missing", fault, todo)
    angle, speed = joints(heard.values)[chosen]
    found = f"{chosen} at {angle:.6g} rad = {angle / DEGREE:.4f}°, {speed / DEGREE:.3g}°/s"
    if doubt := next(_doubts(heard), ""):
        return CheckLine("table", "joint", "doubt", doubt, "publish the feedback in radians")
    return CheckLine("table", "joint", "good", found)


def _order_lines(heard: Heard, order: str) -> Iterator[CheckLine]:
    """Yield who obeys an order, and who else than the planner gives it."""
    part, graph = _PARTS[order], heard.graph
    name, machines = graph.resolve(order), graph.machines(order)
    if line := brought_line(heard, part, order, "obeys it"):
        yield line
    elif heard.started_by_us and not machines:
        yield CheckLine(part, order, "note", "simulated: rotcal run starts who obeys it")
    elif why := list(graph.without_machine(order)):
        todo = f"let your machine's node subscribe to {name} ({_TYPES[order]}), volatile"
        yield CheckLine(part, order, "missing", "; ".join(why), todo)
    else:
        yield CheckLine(part, order, "good", f"node {', '.join(machines)} obeys it")
    strangers = sorted(set(graph.publishers(order)) - {"planner"})
    if strangers:
        found = f"node {', '.join(strangers)} gives orders on {name}, too"
        todo = f"the planner alone may order motion: stop what else publishes on {name}"
        yield CheckLine(part, order, "doubt", found, todo)


def _adapter_lines(heard: Heard) -> Iterator[CheckLine]:
    """Yield what the adapter would say of its joint, and whether its controller is there."""
    assert heard.adapter is not None
    wrong, todo = heard.adapter.wrong()
    if wrong:
        yield CheckLine("table", "joint", "missing", wrong, todo)
    elif outside := heard.adapter.outside():
        todo = "publish the joint in rad, or correct table_adapter.lower_deg and upper_deg"
        yield CheckLine("table", "joint", "doubt", outside, todo)
    elif joints(heard.values):
        yield _joint_line(heard)
    if not heard.started_by_us:
        yield from controller_lines(heard)
