"""What a check of a cell says about a machine behind I++ DME, seen from outside."""

from __future__ import annotations

import socket

from rotcal_ipp_dme.settings import DmeSettings
from rotcal_ros.bags import names
from rotcal_ros.methods.check_lines import CheckLine, DriverCheck


def provided_roles(_settings: DmeSettings) -> tuple[str, ...]:
    """Return the streams that the adapter will publish, and the orders that it will obey."""
    return (names.JOINT_STATES, names.PROBE_POINT, names.TABLE_ANGLE, names.PROBE_TARGET)


def check_line(settings: DmeSettings, here: bool, simulated: bool) -> CheckLine:
    """Say whether the address takes connections; not tried while an adapter of this cell runs."""
    place = f"{settings.host}:{settings.port}"
    if here:
        return CheckLine(
            "machine", "I++ DME", "note", f"node dme_adapter is here and talks to {place}"
        )
    try:
        with socket.create_connection((settings.host, settings.port), settings.reply_timeout_s):
            found = f"{place} takes connections; no session was begun, rotcal run will do so"
    except (OSError, UnicodeError) as error:  # the latter for a name that no host can have
        todo = "start the machine's server, or correct dme.host and dme.port"
        if simulated:
            todo = "start the simulated one: rotcal dme serve CONFIG"
        found = f"no server answers at {place}: {getattr(error, 'strerror', '') or error}"
        return CheckLine("machine", "I++ DME", "missing", found, todo)
    return CheckLine("machine", "I++ DME", "good", found)


CHECK = DriverCheck(provided_roles, check_line)
