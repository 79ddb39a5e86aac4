"""ACS Motion Control SPiiPlus: a program buffer that switches on a one-dimensional error map.

``ERRORMAP1D axis, zone, base, step, map`` with an array of corrections, evenly spaced. The map
does not know that an axis is round: the rows are repeated for every turn. Sources: ``Acs.facts``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from rotcal_ros.compensation.controller import Comment, EveryTurnController, Facts, OwnSetting
from rotcal_ros.compensation.controller_files import (
    UnrolledTable,
    columns_deg,
    even_interval_deg,
    fixed,
    integer,
    mean_deg,
    only_file,
    parse_number,
    repeat_for_turns,
)
from rotcal_ros.compensation.table import CompensationTable
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.foundation.settings import setting
from rotcal_ros.foundation.units import DEGREE

DECIMALS: Final = 9
PLACES: Final = 6
PROGRAM: Final = re.compile(
    r"GLOBAL REAL (\w+)\((\d+)\)\n((?:\1\(\d+\)=\S+\n)+)ERRORUNMAP (\d+), (\d+)\n"
    r"ERRORMAP1D \4, \5, (\S+), (\S+), \1\nERRORMAPON \4, \5\nSTOP\n"
)


@dataclass(frozen=True)
class Acs(EveryTurnController):
    """A rotary axis of an ACS controller, its user unit in degrees."""

    suffixes = (".prg",)
    comment = Comment(".prg", 0, "! {}")
    facts = Facts(
        title="ACS SPiiPlus (ERRORMAP1D)",
        sign="value = -(actual - commanded)",
        wrap="none: rows repeated for each turn",
        unit="degrees, 9 decimals",
        source="programs in ACSPL+ of builders of stages and machines, public on GitHub",
        verified_on="programs that use the command; no page",
    )
    position_resolution = 10.0**-PLACES * DEGREE
    value_resolution = 10.0**-DECIMALS * DEGREE
    switch_on = "home the axis, then run the buffer (ERRORMAPON is in it)"
    one_direction = True
    unverified = (
        "the sign: a public program of a builder of stages fills the map with target minus "
        "measured",
        "that the map is linear between its points, and what it does beyond them",
    )
    own_settings = (
        OwnSetting(
            "ERRORUNMAP",
            "a map that is in force for this zone has to go first",
            "is in the program, before the new map",
            "programs in ACSPL+, public on GitHub",
        ),
        OwnSetting(
            "homing",
            "the map counts from the zero of the axis, and programs map after homing",
            "run the buffer after homing, and again after the next",
            "programs in ACSPL+, public on GitHub",
        ),
        OwnSetting(
            "backlash compensation of the axis",
            "acts beside the map",
            "leave it as it was during the measurement: the map has one column",
            "",
        ),
    )

    axis_number: int = setting(0, doc="number of the axis, from 0 on", minimum=0)
    zone: int = setting(0, doc="zone of the error map", minimum=0)

    def write(self, table: CompensationTable, stem: str) -> dict[str, str]:
        """Return the program; ConfigurationError for an arc or uneven rows."""
        spacing = even_interval_deg(table, "ACS", 10.0**-PLACES)
        angles, added = repeat_for_turns(
            self.first_turn, self.turns, columns_deg(table)[0], mean_deg(table)
        )
        array, place = f"{table.axis}_CORRECTION", f"{self.axis_number}, {self.zone}"
        even = f"{fixed(angles[0], PLACES)}, {fixed(spacing, PLACES)}"
        lines = [
            f"GLOBAL REAL {array}({len(added)})",
            *(f"{array}({k})={fixed(value, DECIMALS)}" for k, value in enumerate(added)),
            f"ERRORUNMAP {place}",
            f"ERRORMAP1D {place}, {even}, {array}",
            f"ERRORMAPON {place}",
            "STOP",
        ]
        return {f"{stem}.prg": "\n".join(lines) + "\n"}

    def read(self, files: Mapping[str, str]) -> UnrolledTable:
        """Read the program back; BagError unless its array is whole, and covers the travel."""
        name, text = only_file(files, ".prg")
        match = PROGRAM.fullmatch(re.sub(r"^!.*\n", "", text, flags=re.MULTILINE))
        place = f"{self.axis_number}, {self.zone}"
        if match is None or f"{match[4]}, {match[5]}" != place:
            raise BagError(
                f"{name}: expected an array of GLOBAL REAL, its values, ERRORUNMAP, ERRORMAP1D "
                f"and ERRORMAPON for {place}, STOP"
            )
        rows = [re.split(r"[()=]+", line)[1:3] for line in match[3].splitlines()]
        places = [integer(row[0], name) for row in rows]
        if places != list(range(len(rows))) or integer(match[2], name) != len(rows):
            raise BagError(
                f"{name}: {len(rows)} values of {match[2]:.9}, expected all, in their order"
            )
        values = np.array([parse_number(row[1], name) for row in rows], dtype=np.float64)
        even = (parse_number(match[6], f"{name}, base"), parse_number(match[7], f"{name}, step"))
        return UnrolledTable.evenly(name, even, (values, values), self.travel, DEGREE)
