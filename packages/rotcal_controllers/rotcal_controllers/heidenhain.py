"""Heidenhain, newer form: a .COM table of axis errors, assigned to the axis by a .CMA table.

Columns AXISPOS, BACKLASH (values for the negative direction) and one column named after the
axis; 256 entries, of which a rotary axis uses 0 .. 360. Sources: ``Heidenhain.facts``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from rotcal_ros.compensation.axis_location import rounded_lengths
from rotcal_ros.compensation.controller import Controller, Facts, Located, OwnSetting
from rotcal_ros.compensation.controller_files import (
    PeriodicTable,
    columns_deg,
    fixed,
    only_file,
    parse_rows,
    require_at_most,
    require_circle,
)
from rotcal_ros.compensation.table import CompensationTable
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.foundation.results import AxisLine
from rotcal_ros.foundation.settings import setting
from rotcal_ros.foundation.units import DEGREE

MAX_ROWS: Final = 256
DECIMALS: Final = 5
ABSOLUTE: Final = "absolute"
OPEN: Final = (
    "the sign of the axis column: read off a diagram named 'error', not stated in words",
    "the text form of the files (BEGIN, NR, [END])",
    "how the table continues beyond 360 deg",
)
CHAIN_SOURCE: Final = "Technical Manual iTNC 530 HSCI (July 2013) pp. 670, 722"
CHAIN_OPEN: Final = (
    "the sign of the rows Trans, and that they count from the machine's zero: compare with those "
    "that the machine holds, the difference has to be small",
)
LEANS: Final = "the rows hold no leans of the axes: KinematicsOpt changes only places, too"
DIFFERENCE: Final = (
    "a BACKLASH of differences: the manual (p. 716) has values measured in negative direction"
)


@dataclass(frozen=True)
class Heidenhain(Controller):
    """Heidenhain with .COM and .CMA tables."""

    suffixes = (".COM", ".CMA")
    facts = Facts(
        title="Heidenhain (.COM/.CMA)",
        sign="value = actual - commanded (inferred)",
        wrap="rows 0 .. 360, the last equal to the first",
        unit="degrees, 5 decimals",
        source="Technical Manual MANUALplus 620 pp. 716-718; TNC 407/415/425 pp. 4-26 .. 4-31",
    )
    position_resolution = 10.0**-DECIMALS * DEGREE
    value_resolution = 2.0 * position_resolution
    """A difference is rounded twice."""
    switch_on = (
        "copy the line into the active .CMA table (config.cma), its * in the column ACTIVE; "
        "older controls: MP730, and the line by soft key or PLC module 9095"
    )
    own_settings = (
        OwnSetting(
            "MP730 (bit of the axis)",
            "selects the linear compensation, and no table, while it is 0",
            "set the bit of the axis to 1",
            "TNC 407/415/425 pp. 4-26, 4-28",
        ),
        OwnSetting(
            "MP710 (newer: MP_backLash)",
            "is added to the position at every reversal, beside the table",
            "leave it as it was during the measurement: nothing of it is in the table",
            "TNC 426/430 p. 6-36; MANUALplus 620 p. 708",
        ),
        OwnSetting(
            "MP750 (newer: MP_posCtrlRevErr)",
            "is added at every reversal, beside the table",
            "leave it as it was during the measurement",
            "iTNC 530 HSCI p. 650; MANUALplus 620 p. 707",
        ),
        OwnSetting(
            "MP_refPosition",
            "is what AXISPOS counts from, not the datum of the work",
            "measure with the datum of the machine",
            "MANUALplus 620 p. 716",
        ),
    )
    backlash: str = setting(
        ABSOLUTE,
        doc="BACKLASH holds errors, or differences to the other direction",
        choices=(ABSOLUTE, "difference"),
    )

    @property
    def unverified(self) -> tuple[str, ...]:
        """What has not been confirmed yet; differences contradict the manual."""
        return OPEN if self.backlash == ABSOLUTE else (*OPEN, DIFFERENCE)

    def locate(self, lines: Sequence[AxisLine], stem: str, head: Sequence[str]) -> Located:
        """Return rows of a kinematics description, which go to the table's axis at last."""
        rows, at, values = list[str](), np.zeros(3), dict[str, float]()
        for line in reversed(lines):
            for axis, x in zip("XYZ", rounded_lengths(line.point - at), strict=True):
                rows.append(f"Trans     {axis} {x:+.4f}")
                values[f"{axis} before {line.letter}"] = float(x)
            rows.append(f"MachAxis  {line.letter}")
            at = line.point
        text = "\n".join([*(f"; {line}" for line in head), "KEY       AXIS COORD", *rows])
        return Located({f"{stem}.txt": text + "\n"}, values, CHAIN_SOURCE, (LEANS,), CHAIN_OPEN)

    def write(self, table: CompensationTable, stem: str) -> dict[str, str]:
        """Return the .COM table and its .CMA table; ConfigurationError above 256 rows."""
        require_circle(table, "Heidenhain")
        angles, up, down = columns_deg(table)
        require_at_most(len(angles), MAX_ROWS, "heidenhain: rows", "choose a wider spacing")
        reverse = -down if self.backlash == ABSOLUTE else up - down
        name = f"{stem}.COM"
        lines = [f"BEGIN {name}", f"NR AXISPOS BACKLASH {table.axis}"]
        for k, row in enumerate(zip(angles, reverse, -up, strict=True)):
            lines.append(" ".join([str(k), *(fixed(value, DECIMALS) for value in row)]))
        assignment = [f"BEGIN {stem}.CMA", f"NR ACTIVE {table.axis}", f"0 * {stem}", "[END]"]
        return {
            name: "\n".join([*lines, "[END]"]) + "\n",
            f"{stem}.CMA": "\n".join(assignment) + "\n",
        }

    def read(self, files: Mapping[str, str]) -> PeriodicTable:
        """Read the .COM table back; BagError unless it is complete and closes."""
        name, text = only_file(files, ".COM")
        _, assignment = only_file(files, ".CMA")
        lines = text.splitlines()
        if len(lines) < 4 or not lines[0].startswith("BEGIN ") or lines[-1] != "[END]":
            raise BagError(f"{name}: expected BEGIN in the first line and [END] in the last")
        stem = re.escape(name.rsplit(".", 1)[0])
        if not re.search(rf"^\d+ \* {stem}$", assignment, re.MULTILINE):
            raise BagError(f"the .CMA table does not name {name}")
        _, angles, backlash, up = parse_rows(name, lines[2:-1], 4, None).T
        down = backlash if self.backlash == ABSOLUTE else backlash + up
        return PeriodicTable(name, angles, up, down, -DEGREE)
