"""The drivers that ``rotcal run`` starts for a cell: what they will bring, and their devices."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Final

from rotcal_ros.bags import names
from rotcal_ros.foundation import plugins
from rotcal_ros.foundation.node_names import FURTHER_NODES
from rotcal_ros.methods.check_lines import CheckLine, DriverCheck

if TYPE_CHECKING:
    from rotcal_ros.nodes.check.cell_snapshot import CellSnapshot

_OWN: Final = {
    "table_adapter": DriverCheck(lambda _settings: (names.JOINT_STATES, names.TABLE_ANGLE))
}
"""Group -> what its driver brings; those of extensions are found by their entry points."""


def brought(snapshot: CellSnapshot) -> dict[str, list[str]]:
    """Return role -> nodes of all that drivers will bring which are not here yet."""
    found: dict[str, list[str]] = {}
    for group, check in _checks(snapshot):
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
    for group, check in _checks(snapshot):
        if check.look is not None:
            here = FURTHER_NODES[group] in snapshot.nodes
            yield check.look(configuration.group(group), here, configuration.simulated)


def _checks(snapshot: CellSnapshot) -> Iterator[tuple[str, DriverCheck]]:
    """Yield the drivers that the configuration asks for, by their groups."""
    of_extensions = plugins.names(plugins.DRIVER_CHECKS)
    for group in FURTHER_NODES:
        if group in snapshot.configuration.given and group in (*_OWN, *of_extensions):
            load = plugins.load
            yield group, _OWN.get(group) or load(plugins.DRIVER_CHECKS, group, "driver")
