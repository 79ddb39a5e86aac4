"""Dynomotion KFLOP with KMotionCNC: a linear correction table for one axis.

The number of points, their distance, where they begin, then ``index,angle``: the angle that has
to be commanded so that the axis gets to begin + index x distance. Linear between the points, the
same in both directions. The table does not know that an axis is round: the rows are repeated for
every turn of the travel. Sources: ``Kflop.facts``.
"""

from __future__ import annotations

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
from rotcal_ros.foundation.units import DEGREE

DECIMALS: Final = 9
PLACES: Final = 6


@dataclass(frozen=True)
class Kflop(EveryTurnController):
    """Dynomotion KFLOP or Kogna: the rows are written for every turn of the travel."""

    suffixes = (".txt",)
    facts = Facts(
        title="Dynomotion KFLOP",
        sign="value = the angle to be commanded, which is the wanted one -(actual - commanded)",
        wrap="none: rows repeated for each turn",
        unit="degrees, 9 decimals",
        source="Dynomotion Wiki, Linear Table Correction (06/2024); Dynomotion Forum, topic 1870",
        verified_on="the maker's example",
    )
    position_resolution = 10.0**-PLACES * DEGREE
    value_resolution = 10.0**-DECIMALS * DEGREE
    switch_on = "Linear Table Correction of the axis in KMotionCNC, with the name of the file"
    own_settings = (
        OwnSetting(
            "BacklashMode, BacklashAmount",
            "of the axis channel act beside the table",
            "leave them as they were during the measurement",
            "",
        ),
    )
    one_direction = True
    unverified = (
        "the two columns of a point: read off a user's table in the maker's forum",
        "what the control does beyond the table: keep the travel inside",
    )

    def write(self, table: CompensationTable, stem: str) -> dict[str, str]:
        """Return the table; ConfigurationError for an arc or uneven rows."""
        spacing = even_interval_deg(table, "KFLOP", 10.0**-PLACES)
        angles, added = repeat_for_turns(
            self.first_turn, self.turns, columns_deg(table)[0], mean_deg(table)
        )
        head = [str(len(angles)), fixed(spacing, PLACES), fixed(360.0 * self.first_turn, PLACES)]
        lines = [f"{k},{fixed(value, DECIMALS)}" for k, value in enumerate(angles + added)]
        return {f"{stem}.txt": "\n".join([*head, *lines]) + "\n"}

    def read(self, files: Mapping[str, str]) -> UnrolledTable:
        """Read the table back; BagError unless it has all points, and covers the travel."""
        name, text = only_file(files, ".txt")
        head, lines = text.splitlines()[:3], text.splitlines()[3:]
        if len(head) < 3 or len(lines) < 3:
            raise BagError(f"{name}: expected number, distance and begin, and at least 3 points")
        count = integer(head[0], f"{name}, line 1")
        spacing, begin = (parse_number(head[k], f"{name}, line {k + 1}") for k in (1, 2))
        index, commanded = parse_numbers(name, lines, 2, ",").T
        if count != len(lines) or not np.array_equal(index, np.arange(count)):
            raise BagError(f"{name}: {len(lines)} points, expected {count}: 0, 1, .. {count - 1}")
        added = commanded - (begin + spacing * index)
        return UnrolledTable.evenly(name, (begin, spacing), (added, added), self.travel, DEGREE)
