"""A plain CSV table, for software and people: no controller's rule, nothing rounded away.

Its columns are ``angle_deg,correction_forward_arcsec,correction_reverse_arcsec,std_arcsec``,
followed by ``std_reverse_arcsec`` if the reverse correction has an uncertainty of its own; a full
circle ends with the row at 360 deg, equal to the first.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from rotcal_ros.compensation.axis_location import rounded_lengths
from rotcal_ros.compensation.controller import Controller, Facts, Located
from rotcal_ros.compensation.controller_files import (
    columns_deg,
    fixed,
    interpolate_periodically,
    only_file,
    parse_rows,
)
from rotcal_ros.compensation.table import CompensationTable
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.foundation.observations import Approach
from rotcal_ros.foundation.results import AxisLine
from rotcal_ros.foundation.units import ARCSEC, DEGREE

HEADER: Final = "angle_deg,correction_forward_arcsec,correction_reverse_arcsec,std_arcsec"
OWN_STD: Final = f"{HEADER},std_reverse_arcsec"
SAME_STD: Final = -1.0
"""Stands for the second standard uncertainty if there is one for both directions."""
ANGLE_DECIMALS: Final = 9
DECIMALS: Final = 6
COLUMNS: Final = 5
"""Numbers in a row: angle, two corrections, the standard uncertainty of each."""


@dataclass(frozen=True, eq=False)
class CsvTable:
    """Columns (n,): degrees, and arcseconds to be added to the command."""

    angle_deg: Floats
    forward_arcsec: Floats
    reverse_arcsec: Floats

    def correction(self, angle: Floats, approach: Approach) -> Floats:
        """Return the correction (rad), linear; 0 .. 360 deg repeats, an arc holds its ends."""
        column = self.forward_arcsec if approach is Approach.POSITIVE else self.reverse_arcsec
        if (self.angle_deg[0], self.angle_deg[-1]) == (0.0, 360.0):
            return interpolate_periodically(angle, self.angle_deg, column) * ARCSEC
        at = np.asarray(angle) / DEGREE
        return np.asarray(np.interp(at, self.angle_deg, column) * ARCSEC, dtype=np.float64)


@dataclass(frozen=True)
class PlainCsv(Controller):
    """Software that reads CSV and adds the correction by itself; nothing to set."""

    suffixes = (".csv",)
    facts = Facts(
        title="plain CSV",
        sign="value = -(actual - commanded), added to the commanded angle",
        wrap="0 .. 360 deg, the last row equals the first",
        unit="degrees and arcseconds",
        source="this project",
        verified_on="this project",
    )
    position_resolution = 10.0**-ANGLE_DECIMALS * DEGREE
    value_resolution = 10.0**-DECIMALS * ARCSEC

    def write(self, table: CompensationTable, stem: str) -> dict[str, str]:
        """Return the table, closed with a row at 360 deg when it is a full circle."""
        angles, up, down = columns_deg(table)
        uncertainties = (
            [table.std] if table.std_reverse is None else [table.std, table.std_reverse]
        )
        std = [np.append(s, s[0]) if table.closed else s for s in uncertainties]
        columns = [angles, up * 3600.0, down * 3600.0, *(s / ARCSEC for s in std)]
        if table.std_reverse is None:
            columns.append(np.full(len(angles), SAME_STD))
        return {f"{stem}.csv": self.text_of(np.column_stack(columns))}

    def locate(self, lines: Sequence[AxisLine], stem: str, head: Sequence[str]) -> Located:
        """Return a point of each axis in mm, and its direction."""
        del head
        names = [f"{part}{axis}" for part in ("point_mm_", "direction_") for axis in "xyz"]
        rows = [["axis", *names]]
        values = dict[str, float]()
        for line in lines:
            numbers = [*rounded_lengths(line.point), *np.round(line.direction, ANGLE_DECIMALS)]
            values |= {f"{line.letter} {n}": float(x) for n, x in zip(names, numbers, strict=True)}
            rows.append([line.letter, *(fixed(x, ANGLE_DECIMALS) for x in numbers)])
        text = "\n".join(",".join(row) for row in rows) + "\n"
        return Located({f"{stem}.csv": text}, values, self.facts.source)

    def read(self, files: Mapping[str, str]) -> CsvTable:
        """Read the table back; BagError names the row that is damaged."""
        angles, up, down, *_ = self.rows_of(*only_file(files, ".csv")).T
        return CsvTable(angles, up, down)

    def rows_of(self, name: str, text: str) -> Floats:
        """Return the numbers (n, 5); BagError names the row that is damaged.

        The last column is -1 if the file has one standard uncertainty for both directions.
        """
        head, *lines = text.splitlines() or [""]
        if head.strip() not in (HEADER, OWN_STD):
            raise BagError(f"{name}: the first line is {head!r}, expected {HEADER}")
        rows = parse_rows(name, lines, head.count(",") + 1, ",")
        same = np.full((len(rows), COLUMNS - rows.shape[1]), SAME_STD)
        return np.hstack([rows, same])

    def text_of(self, rows: Floats) -> str:
        """Return the text of a file with ``rows`` (n, 5), the last column -1 as above."""
        head = HEADER if np.all(rows[:, -1] == SAME_STD) else OWN_STD
        lines = [
            ",".join([fixed(row[0], ANGLE_DECIMALS), *(fixed(x, DECIMALS) for x in row[1:])])
            for row in rows[:, : head.count(",") + 1]
        ]
        return "\n".join([head, *lines]) + "\n"
