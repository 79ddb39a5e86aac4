"""The drivers that ``rotcal run`` starts for a cell: what they will bring, and their devices."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, NamedTuple, Protocol

from rclpy.node import Node

from rotcal_ros.foundation import plugins
from rotcal_ros.foundation.node_names import FURTHER_NODES
from rotcal_ros.methods import Configuration
from rotcal_ros.methods.check_lines import CheckLine, DriverCheck

if TYPE_CHECKING:
    from rotcal_ros.nodes.check.cell_snapshot import CellSnapshot


class Finding(NamedTuple):
    """What is wrong or looks so, and what to do about it."""

    found: str
    todo: str


class TableEars(Protocol):
    """The table behind a driver that is still to come: heard and judged as the driver will."""

    topic: str

    def wrong(self) -> Finding | None:
        """Return why the driver could not go by this feedback; None: it can."""

    def outside(self) -> str | None:
        """Return in words that the joint stands outside of its stated travel; None: no."""

    def controller_lines(self) -> Iterator[CheckLine]:
        """Yield whether who takes the driver's orders is there."""


def table_ears(node: Node, configuration: Configuration) -> TableEars | None:
    """Return what hears the table behind a driver of the configuration; None: there is none."""
    for _, check in _checks(configuration):
        if check.ears is not None:
            ears: TableEars = check.ears(node, configuration)
            return ears
    return None


def brought(snapshot: CellSnapshot) -> dict[str, list[str]]:
    """Return role -> nodes of all that drivers will bring which are not here yet."""
    found: dict[str, list[str]] = {}
    for group, check in _checks(snapshot.configuration):
        if (node := FURTHER_NODES[group]) not in snapshot.nodes:
            for role in check.brings(snapshot.configuration.group(group)):
                found.setdefault(role, []).append(node)
    return found


def brought_line(snapshot: CellSnapshot, part: str, role: str, does: str) -> CheckLine | None:
    """Return the line of a role that a driver will bring; None where none will."""
    nodes = snapshot.brought.get(role, [])
    if not nodes:
        return None
    if len(nodes) > 1:
        found, todo = f"{' and '.join(nodes)} would both play it", "leave one of their groups out"
        return CheckLine(part, role, "missing", found, todo)
    return CheckLine(part, role, "note", f"{nodes[0]} {does}, which rotcal run starts")


def driver_lines(snapshot: CellSnapshot) -> Iterator[CheckLine]:
    """Yield whether the devices of the drivers are there, as far as that is seen from outside."""
    configuration = snapshot.configuration
    for group, check in _checks(snapshot.configuration):
        if check.look is not None:
            here = FURTHER_NODES[group] in snapshot.nodes
            yield check.look(configuration.group(group), here, configuration.simulated)


def _checks(configuration: Configuration) -> Iterator[tuple[str, DriverCheck]]:
    """Yield the drivers that the configuration asks for, by their groups."""
    known = plugins.names(plugins.DRIVER_CHECKS)
    for group in FURTHER_NODES:
        if group in configuration.given and group in known:
            yield group, plugins.load(plugins.DRIVER_CHECKS, group, "driver")
