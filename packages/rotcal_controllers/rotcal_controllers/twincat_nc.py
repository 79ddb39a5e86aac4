"""Beckhoff TwinCAT NC PTP: the table of MC_TableBasedPositionCompensation, as Structured Text.

An array of ST_PositionCompensationTableElement (position, additive compensation) and its
ST_PositionCompensationTableParameter, to be pasted into a list of global variables. Evenly spaced,
modulo. A table works in both directions or in one. Sources: ``TwinCatNc.facts``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from rotcal_ros.compensation.controller import Comment, Controller, Facts, OwnSetting
from rotcal_ros.compensation.controller_files import (
    PeriodicTable,
    columns_deg,
    even_interval_deg,
    fixed,
    integer,
    mean_deg,
    only_file,
    parse_number,
)
from rotcal_ros.compensation.table import CompensationTable
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.foundation.settings import setting
from rotcal_ros.foundation.units import DEGREE

DECIMALS: Final = 9
PLACES: Final = 6
MEAN: Final = "mean"
SETPOINT: Final = "setpoint"
BOTH, POSITIVE, NEGATIVE = "Both", "Positive", "Negative"
ELEMENT: Final = r"\(Position := ([^,()\s]+), Compensation := ([^,()\s]+)\)"
TABLE: Final = re.compile(
    r" *(\w+)_parameter : ST_PositionCompensationTableParameter := \(\n"
    r" *MinPosition := (\S+), MaxPosition := (\S+), NoOfTableElements := (\S+),\n"
    r" *Direction := WorkDirection(Both|Positive|Negative), Modulo := (\w+)\);\n"
    r" *\1_table : ARRAY \[0\.\.(\S+)\] OF ST_PositionCompensationTableElement := \[\n"
    rf"((?: *{ELEMENT},\n)* *{ELEMENT}\n) *\];\n"
)
OPEN: Final = (
    "that the control adds the compensation to the set position: the page of the table and that "
    "of Position Correction say so, that of MC_PositionCorrectionLimiter names the actual one",
    "that the control interpolates linearly, and takes the row at 360 for the one at 0 again",
)
TWO_BLOCKS: Final = (
    "that two blocks, one for each direction, work on one axis: both write its PositionCorrection"
)


@dataclass(frozen=True)
class TwinCatNc(Controller):
    """Beckhoff TwinCAT NC PTP with Tc2_MC2."""

    suffixes = (".st",)
    comment = Comment(".st", 0, "(* {} *)")
    facts = Facts(
        title="Beckhoff TwinCAT NC",
        sign="compensation = -(actual - commanded), additive",
        wrap="Modulo TRUE, rows from 0 to 360, the last equal to the first",
        unit="degrees, 9 decimals",
        source="Beckhoff Information System, Tc2_MC2: MC_TableBasedPositionCompensation, "
        "ST_PositionCompensationTableParameter, ST_PositionCompensationTableElement, "
        "E_WorkDirection; TF50x0: Position Correction",
    )
    position_resolution = 10.0**-PLACES * DEGREE
    value_resolution = 10.0**-DECIMALS * DEGREE
    switch_on = "Position Correction of the axis, then Enable of MC_TableBasedPositionCompensation"
    own_settings = (
        OwnSetting(
            "MC_BacklashCompensation",
            "works by the same Position Correction, and both would write it",
            "add both sums by MC_PositionCorrectionLimiter; leave it as it was in the measurement",
            "Beckhoff Tc2_MC2, 9760638347",
        ),
        OwnSetting(
            "Backlash Compensation of the axis",
            "is there for old projects, and acts beside the table",
            "leave it as it was during the measurement",
            "Beckhoff Tc2_MC2, 9760638347",
        ),
    )

    directions: str = setting(
        MEAN,
        doc="one table, the mean of both directions, or one table for each",
        choices=(MEAN, "each"),
    )
    added_to: str = setting(
        SETPOINT,
        doc="the position that the control adds the compensation to",
        choices=(SETPOINT, "actual"),
    )

    @property
    def one_direction(self) -> bool:
        """Whether one table serves both directions."""
        return self.directions == MEAN

    @property
    def unverified(self) -> tuple[str, ...]:
        """What has not yet been confirmed on a real control."""
        return OPEN if self.one_direction else (*OPEN, TWO_BLOCKS)

    def write(self, table: CompensationTable, stem: str) -> dict[str, str]:
        """Return the declarations; ConfigurationError for an arc or uneven rows."""
        even_interval_deg(table, "TwinCAT NC", 10.0**-PLACES)
        angles, up, down = columns_deg(table)
        columns = {BOTH: mean_deg(table)}
        if table.directional and not self.one_direction:
            columns = {POSITIVE: up, NEGATIVE: down}
        lines = ["VAR_GLOBAL"]
        for way, column in columns.items():
            lines += _declaration(f"{table.axis}_{way}", way, angles, column * self._sign)
        return {f"{stem}.st": "\n".join([*lines, "END_VAR"]) + "\n"}

    def read(self, files: Mapping[str, str]) -> PeriodicTable:
        """Read the declarations back; BagError unless they are one table, or one for each way."""
        name, text = only_file(files, ".st")
        body = re.fullmatch(r"(?:\(\*[^*]*\*\)\n)*VAR_GLOBAL\n(.*)END_VAR\n", text, re.DOTALL)
        found = list(TABLE.finditer(body[1])) if body else []
        if body is None or TABLE.sub("", body[1]):
            raise BagError(f"{name}: expected exactly VAR_GLOBAL, parameters and a table, END_VAR")
        columns = {match[5]: _rows(f"{name}, {match[1]}", match) for match in found}
        if len(found) != len(columns) or set(columns) not in ({BOTH}, {POSITIVE, NEGATIVE}):
            raise BagError(
                f"{name}: tables act in the directions {', '.join(m[5] for m in found) or '-'}, "
                f"expected {BOTH}, or {POSITIVE} and {NEGATIVE}"
            )
        rows, up = columns.get(BOTH) or columns[POSITIVE]
        _, down = columns.get(BOTH) or columns[NEGATIVE]
        return PeriodicTable(name, rows, up, down, self._sign * DEGREE)

    @property
    def _sign(self) -> float:
        return 1.0 if self.added_to == SETPOINT else -1.0


def _declaration(name: str, way: str, angles: Floats, values: Floats) -> list[str]:
    elements = [
        f"(Position := {fixed(angle, PLACES)}, Compensation := {fixed(value, DECIMALS)})"
        for angle, value in zip(angles, values, strict=True)
    ]
    last = len(elements) - 1
    return [
        f"    {name}_parameter : ST_PositionCompensationTableParameter := (",
        f"        MinPosition := 0.0, MaxPosition := 360.0, NoOfTableElements := {last + 1},",
        f"        Direction := WorkDirection{way}, Modulo := TRUE);",
        f"    {name}_table : ARRAY [0..{last}] OF ST_PositionCompensationTableElement := [",
        *(f"        {element}," for element in elements[:-1]),
        f"        {elements[-1]}",
        "    ];",
    ]


def _rows(where: str, match: re.Match[str]) -> tuple[Floats, Floats]:
    """Return positions and compensations (deg) of one table, which is a whole turn."""
    low, high = parse_number(match[2], where), parse_number(match[3], where)
    count, last = integer(match[4], where), integer(match[7], where)
    cells = [
        [parse_number(cell, where) for cell in pair] for pair in re.findall(ELEMENT, match[8])
    ]
    rows, values = np.array(cells, dtype=np.float64).T
    n = len(rows)
    if (low, high, count, last, match[6]) != (0.0, 360.0, n, n - 1, "TRUE") or n < 3:
        raise BagError(
            f"{where}: {n} rows, and the parameters state {count} from {low:g} to {high:g} deg, "
            f"an array [0..{last}] and Modulo {match[6]}; expected {n} from 0 to 360, "
            f"[0..{n - 1}], TRUE"
        )
    if np.max(np.abs(rows - np.linspace(0.0, 360.0, n))) > 10.0**-PLACES:
        raise BagError(f"{where}: the positions are not evenly spaced from 0 to 360 deg")
    return rows, values
