"""A plain CSV table, for software and people: no controller's rule, nothing rounded away.

``angle_deg,correction_forward_arcsec,correction_reverse_arcsec,std_arcsec``; a full circle ends
with the row at 360 deg, equal to the first.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from rotcal_ros.arrays import Floats
from rotcal_ros.compensation.controller import Controller, Facts
from rotcal_ros.compensation.parsing import only_file, parse_rows
from rotcal_ros.compensation.rows import columns_deg, fixed
from rotcal_ros.compensation.rules import periodic
from rotcal_ros.compensation.table import CompensationTable
from rotcal_ros.errors import BagError
from rotcal_ros.observations import Approach
from rotcal_ros.units import ARCSEC, DEGREE

HEADER: Final = "angle_deg,correction_forward_arcsec,correction_reverse_arcsec,std_arcsec"
ANGLE_DECIMALS: Final = 9
DECIMALS: Final = 6


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
            return periodic(angle, self.angle_deg, column) * ARCSEC
        at = np.asarray(angle) / DEGREE
        return np.asarray(np.interp(at, self.angle_deg, column) * ARCSEC, dtype=np.float64)


@dataclass(frozen=True)
class PlainCsv(Controller):
    """Software that reads CSV and adds the correction by itself; nothing to set."""

    facts = Facts(
        title="plain CSV",
        sign="value = -(actual - commanded), added to the commanded angle",
        wrap="0 .. 360 deg, the last row equals the first",
        unit="degrees and arcseconds",
        source="this project",
    )
    position_resolution = 10.0**-ANGLE_DECIMALS * DEGREE

    def write(self, table: CompensationTable, stem: str) -> dict[str, str]:
        """Return the table, closed with a row at 360 deg when it is a full circle."""
        angles, up, down = columns_deg(table)
        std = np.append(table.std, table.std[0]) if table.closed else table.std
        columns = (angles, up * 3600.0, down * 3600.0, std / ARCSEC)
        lines = [
            ",".join([fixed(row[0], ANGLE_DECIMALS), *(fixed(x, DECIMALS) for x in row[1:])])
            for row in zip(*columns, strict=True)
        ]
        return {f"{stem}.csv": "\n".join([HEADER, *lines]) + "\n"}

    def read(self, files: Mapping[str, str]) -> CsvTable:
        """Read the table back; BagError names the row that is damaged."""
        name, text = only_file(files, ".csv")
        head, *lines = text.splitlines() or [""]
        if head.strip() != HEADER:
            raise BagError(f"{name}: the first line is {head!r}, expected {HEADER}")
        angles, up, down, _ = parse_rows(name, lines, 4, ",").T
        return CsvTable(angles, up, down)

    def resolution(self, table: CompensationTable) -> float:
        """Return the last decimal, in rad."""
        return 10.0**-DECIMALS * ARCSEC


CONTROLLER: Final = PlainCsv
