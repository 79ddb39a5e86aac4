"""Centroid CNC10, CNC11, CNC12: a compensation table ``cnc-?.tab``, version 3.

A head of axis, units, interval and entries, then rows of position and two corrections, for
forward-going and for reverse-going movement. No wrap is documented: the rows are repeated for
every turn of the travel. Sources: ``Centroid.facts``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from rotcal_ros.compensation.controller import EveryTurnController, Facts, OwnSetting
from rotcal_ros.compensation.controller_files import (
    UnrolledTable,
    columns_deg,
    even_interval_deg,
    fixed,
    integer,
    only_file,
    parse_number,
    parse_numbers,
    repeat_for_turns,
)
from rotcal_ros.compensation.table import CompensationTable
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.foundation.settings import setting
from rotcal_ros.foundation.units import DEGREE

TITLE: Final = "CNC10 TAB FILE VERSION 3"
DECIMALS: Final = 5
PLACES: Final = 4
HEAD: Final = re.compile(
    rf"{TITLE}\nAXIS (\w+)\nUNITS (MM|INCH)\nINTERVAL (\S+)\nENTRIES (\d+)\n((?:.+\n)+)"
)
PAGE: Final = "cncsnw.com/LaserComp.htm"


@dataclass(frozen=True)
class Centroid(EveryTurnController):
    """Centroid with a table of both directions for a rotary axis."""

    suffixes = (".tab",)
    facts = Facts(
        title="Centroid (.tab, version 3)",
        sign="value = -(actual - commanded)",
        wrap="none: rows repeated for each turn",
        unit="degrees, 5 decimals",
        source=f"{PAGE}; a file of a lathe, cnc-x.tab, on GitHub",
        verified_on="page, and a file of a machine whose values are all 0",
    )
    position_resolution = 10.0**-PLACES * DEGREE
    value_resolution = 10.0**-DECIMALS * DEGREE
    switch_on = (
        "copy the file under the name of the axis (cnc-a.tab; Linux: cnc10a.tab), switch its "
        "compensation on in the motor parameters (from memory), then restart"
    )
    unverified = (
        "the sign: the page says 'correction'",
        "the unit of a rotary axis: the file at hand is of a linear one, and all its values are 0",
        "that forward stands before reverse, and the rows may ascend",
        "that the table is linear between its rows, and what the control does beyond them",
    )
    own_settings = (
        OwnSetting(
            "backlash (lash compensation) of the axis",
            "is a second way to take up what the two columns hold",
            "leave it as it was during the measurement: nothing of it is in the table",
            "",
        ),
    )

    units: str = setting(
        "MM", doc="word after UNITS; a rotary axis counts in degrees", choices=("MM", "INCH")
    )

    def write(self, table: CompensationTable, stem: str) -> dict[str, str]:
        """Return the file; ConfigurationError for an arc or uneven rows."""
        spacing = even_interval_deg(table, "Centroid", 10.0**-PLACES)
        rows = repeat_for_turns(self.first_turn, self.turns, *columns_deg(table))
        head = [
            TITLE,
            f"AXIS {table.axis}",
            f"UNITS {self.units}",
            f"INTERVAL {fixed(spacing, PLACES)}",
            f"ENTRIES {len(rows[0])}",
        ]
        places = (PLACES, DECIMALS, DECIMALS)
        lines = [
            "\t".join(fixed(x, n) for x, n in zip(row, places, strict=True))
            for row in zip(*rows, strict=True)
        ]
        return {f"{stem}.tab": "\n".join([*head, *lines]) + "\n"}

    def read(self, files: Mapping[str, str]) -> UnrolledTable:
        """Read the file back; BagError unless all entries are there, evenly, over the travel."""
        name, text = only_file(files, ".tab")
        match = HEAD.fullmatch(text)
        if match is None or match[2] != self.units:
            raise BagError(
                f"{name}: expected {TITLE}, AXIS, UNITS {self.units}, INTERVAL, ENTRIES, and rows"
            )
        at, up, down = parse_numbers(name, match[5].splitlines(), 3, "\t").T
        spacing, count = parse_number(match[3], f"{name}, INTERVAL"), integer(match[4], name)
        even = at[0] + spacing * np.arange(len(at))
        if count != len(at) or np.max(np.abs(at - even)) > 10.0**-PLACES:
            raise BagError(
                f"{name}: {len(at)} rows, expected {count} that are {spacing:g} deg apart"
            )
        return UnrolledTable.evenly(name, (float(at[0]), spacing), (up, down), self.travel, DEGREE)
