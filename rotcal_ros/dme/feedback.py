"""Where a machine says it stands: readings of its reports."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from rotcal_ros.dme.faults import ProtocolError
from rotcal_ros.dme.grammar import Call, calls_by_name, parse_values
from rotcal_ros.planning.plan import Point
from rotcal_ros.units import MILLIMETRE

REPORTED: Final = tuple(Call(name) for name in ("X", "Y", "Z", "R"))
"""What the machine is asked to report, of itself and with every point."""


@dataclass(frozen=True, slots=True)
class Standing:
    """Where the tip is (m, machine frame), and the table's R in degrees."""

    position: Point
    r_deg: float


def parse_standing(data: Sequence[str], asked_by: str) -> Standing:
    """Return the one report among the data lines; ProtocolError when it is not there."""
    if len(data) != 1:
        raise ProtocolError(f"{asked_by}: expected one line of data, found {len(data)}")
    return standing_of(data[0], asked_by)


def standing_of(text: str, asked_by: str) -> Standing:
    """Return the report in a data line; ProtocolError when it lacks X, Y, Z or R."""
    found = calls_by_name(parse_values(text))
    missing = [asked.name for asked in REPORTED if asked.name not in found]
    if missing:
        raise ProtocolError(f"{asked_by}: no {', '.join(missing)} in {text!r:.200}")
    x, y, z, r_deg = (found[asked.name].number() for asked in REPORTED)
    return Standing((x * MILLIMETRE, y * MILLIMETRE, z * MILLIMETRE), r_deg)
