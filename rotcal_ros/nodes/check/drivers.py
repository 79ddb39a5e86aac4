"""The drivers that ``rotcal run`` starts for a cell: what they will bring, and their devices."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from typing import TYPE_CHECKING, Final

from rotcal_ros.bags import names
from rotcal_ros.foundation.errors import RotcalError
from rotcal_ros.foundation.node_names import FURTHER_NODES
from rotcal_ros.instrument_plugins.driver import instrument_of
from rotcal_ros.instrument_plugins.instrument import Tracer, Tracker
from rotcal_ros.methods.check_lines import CheckLine

if TYPE_CHECKING:
    from rotcal_ros.nodes.check.cell_snapshot import CellSnapshot

_DME, _PLUGIN, _TABLE = "dme", "instrument", "table_adapter"
_BRINGS: Final = {
    _TABLE: (names.JOINT_STATES, names.TABLE_ANGLE),
    _DME: (names.JOINT_STATES, names.PROBE_POINT, names.TABLE_ANGLE, names.PROBE_TARGET),
}
"""Streams that the driver of a group will tell, and orders that it will obey."""


def brought(snapshot: CellSnapshot) -> dict[str, list[str]]:
    """Return role -> nodes of all that drivers will bring which are not here yet."""
    found: dict[str, list[str]] = {}
    for group in (_TABLE, _DME, _PLUGIN):
        node = FURTHER_NODES[group]
        if group in snapshot.configuration.given and node not in snapshot.nodes:
            for role in _of_the_plugin(snapshot) if group == _PLUGIN else _BRINGS[group]:
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
    given = snapshot.configuration.given
    if _DME in given:
        yield _dme_line(snapshot)
    if _PLUGIN in given:
        yield _plugin_line(snapshot)


def _dme_line(snapshot: CellSnapshot) -> CheckLine:
    """Say whether the address takes connections; not tried while an adapter of this cell runs."""
    settings, node = snapshot.configuration.dme, FURTHER_NODES[_DME]
    place = f"{settings.host}:{settings.port}"
    if node in snapshot.nodes:
        return CheckLine(
            "machine", "I++ DME", "note", f"node {node} is here and speaks to {place}"
        )
    try:
        with socket.create_connection((settings.host, settings.port), settings.reply_timeout_s):
            found = f"{place} takes connections; no session was begun, rotcal run will do so"
    except (OSError, UnicodeError) as error:  # the latter for a name that no host can have
        todo = "start the machine's server, or correct dme.host and dme.port"
        if snapshot.configuration.simulated:
            todo = "start the simulated one: rotcal dme serve CONFIG"
        found = f"nobody answers at {place}: {getattr(error, 'strerror', '') or error}"
        return CheckLine("machine", "I++ DME", "missing", found, todo)
    return CheckLine("machine", "I++ DME", "good", found)


def _plugin_line(snapshot: CellSnapshot) -> CheckLine:
    """Say what the plug-in makes; only its driver may connect, since that may move something."""
    settings, node = snapshot.configuration.instrument, FURTHER_NODES[_PLUGIN]
    title = f"plug-in {settings.plugin}, {settings.address or 'no address'}"
    if node in snapshot.nodes:
        return CheckLine("instrument", "plug-in", "note", f"{title}: node {node} is here")
    try:
        instrument = instrument_of(settings)
    except RotcalError as error:
        todo = "group instrument of the configuration; rotcal settings --group instrument"
        return CheckLine("instrument", "plug-in", "missing", str(error), todo)
    does = {Tracer: "tells lengths", Tracker: "finds reflectors"}
    found = " and ".join(words for kind, words in does.items() if isinstance(instrument, kind))
    todo = "whether it answers is seen when rotcal run connects"
    return CheckLine("instrument", "plug-in", "open", f"{title}: {found}", todo)


def _of_the_plugin(snapshot: CellSnapshot) -> tuple[str, ...]:
    """Return what the plug-in brings; nothing where it cannot be made, which its line tells."""
    try:
        instrument = instrument_of(snapshot.configuration.instrument)
    except RotcalError:
        return ()
    lengths = (names.TRACER_LENGTH,) if isinstance(instrument, Tracer) else ()
    places = (names.PROBE_POINT, names.PROBE_TARGET) if isinstance(instrument, Tracker) else ()
    return lengths + places
