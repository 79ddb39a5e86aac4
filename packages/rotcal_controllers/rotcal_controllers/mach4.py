"""Mach4: the values of a screw map, to be entered in the plug-in Machine Calibration.

Start point, length, number of points, and the error at each: expected minus actual position,
evenly spaced. Builds after 4780 (2021-11-29) have a map for each direction, older ones one for
both. No file of Mach4 is documented: this is a sheet to enter by hand. Sources: ``Mach4.facts``.
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
    mean_deg,
    only_file,
    parse_number,
    parse_numbers,
    repeat_for_turns,
)
from rotcal_ros.compensation.table import CompensationTable
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.foundation.settings import setting
from rotcal_ros.foundation.units import DEGREE

DECIMALS: Final = 6
MEAN: Final = "mean"
PAGE: Final = "support.machmotion.com, Mach 4 Screw Mapping"
HEAD: Final = re.compile(
    r"Start Point (\S+)\nLength (\S+)\nNumber of Points (\d+)\n"
    r"Position Error positive Error negative\n((?:.+\n)+)"
)


@dataclass(frozen=True)
class Mach4(EveryTurnController):
    """Mach4 with a screw map for the motor of a rotary axis, in degrees."""

    suffixes = (".txt",)
    facts = Facts(
        title="Mach4 screw map",
        sign="value = expected - actual position = -(actual - commanded)",
        wrap="none: rows repeated for each turn",
        unit="degrees, 6 decimals",
        source=PAGE,
    )
    position_resolution = 10.0**-DECIMALS * DEGREE
    value_resolution = 10.0**-DECIMALS * DEGREE
    switch_on = (
        "enter the values in Configure, Plugins, Machine Calibration, Linear Compensation, "
        "and enable the map of the motor"
    )
    unverified = (
        "that 'the difference between the expected position and the actual position' is expected "
        "minus actual",
        "that the map is linear between its points, and what it does beyond them",
    )
    own_settings = (
        OwnSetting(
            "backlash of the motor",
            "is a second way to take up what a map for each direction holds",
            "leave it as it was during the measurement: nothing of it is in the map",
            "",
        ),
        OwnSetting(
            "VAL_SCREWMAP_PERCENT_PER",
            "spreads the change from one map to the other at a reversal over many cycles",
            "let the axis come to rest before it is measured",
            PAGE,
        ),
    )

    directions: str = setting(
        MEAN,
        doc="one map, the mean of both directions, or one for each (builds after 4780)",
        choices=(MEAN, "each"),
    )

    @property
    def one_direction(self) -> bool:
        """Whether one map serves both directions."""
        return self.directions == MEAN

    def write(self, table: CompensationTable, stem: str) -> dict[str, str]:
        """Return the sheet; ConfigurationError for an arc or uneven rows."""
        even_interval_deg(table, "Mach4", 10.0**-DECIMALS)
        angles, *both = columns_deg(table)
        both = [mean_deg(table)] * 2 if self.one_direction else both
        rows = repeat_for_turns(self.first_turn, self.turns, angles, *both)
        head = [
            f"Start Point {fixed(rows[0][0], DECIMALS)}",
            f"Length {fixed(rows[0][-1] - rows[0][0], DECIMALS)}",
            f"Number of Points {len(rows[0])}",
            "Position Error positive Error negative",
        ]
        lines = [" ".join(fixed(x, DECIMALS) for x in row) for row in zip(*rows, strict=True)]
        return {f"{stem}.txt": "\n".join([*head, *lines]) + "\n"}

    def read(self, files: Mapping[str, str]) -> UnrolledTable:
        """Read the sheet back; BagError unless all points are there, evenly, over the travel."""
        name, text = only_file(files, ".txt")
        match = HEAD.fullmatch(text)
        if match is None:
            raise BagError(f"{name}: expected Start Point, Length, Number of Points, and the rows")
        start, length = (parse_number(match[k], name) for k in (1, 2))
        count = integer(match[3], name)
        at, up, down = parse_numbers(name, match[4].splitlines(), 3, None).T
        if count != len(at) or count < 2:
            raise BagError(f"{name}: {len(at)} rows, and Number of Points is {count}")
        spacing = length / (count - 1)
        if np.max(np.abs(at - start - spacing * np.arange(count))) > 2.0 * 10.0**-DECIMALS:
            raise BagError(f"{name}: the positions are not evenly spaced over the length")
        if self.one_direction and not np.array_equal(up, down):
            raise BagError(f"{name}: one map for both directions, and the columns differ")
        return UnrolledTable.evenly(name, (start, spacing), (up, down), self.travel, DEGREE)
