"""MyDrive, a made-up servo drive: an error table as plain text.

    MYDRIVE ERROR TABLE C
    ROWS 36
    0.0000 0 -21
    10.0000 -36 -57

Position in degrees, then the error (actual - commanded) in tenths of an arcsecond, positive and
negative direction. The drive subtracts the error, linearly between the rows, in every turn.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from rotcal_ros.compensation.controller import Controller, Facts
from rotcal_ros.compensation.controller_files import (
    PeriodicTable,
    columns_deg,
    fixed,
    integer,
    only_file,
    parse_rows,
    require_at_most,
    require_circle,
)
from rotcal_ros.compensation.table import CompensationTable
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.foundation.settings import setting
from rotcal_ros.foundation.units import ARCSEC, DEGREE

TITLE: Final = "MYDRIVE ERROR TABLE"
DECIMALS: Final = 4
STEP: Final = 0.1 * ARCSEC


@dataclass(frozen=True)
class MyDrive(Controller):
    """The drive of one axis, as it is set up; every setting has a default."""

    suffixes = (".mdt",)
    facts = Facts(
        title="MyDrive",
        sign="value = actual - commanded",
        wrap="rows 0 .. 360, the last equal to the first",
        unit="whole numbers of 0.1 arcsec",
        source="an example of rotcal_ros",
    )
    position_resolution = 10.0**-DECIMALS * DEGREE

    max_rows: int = setting(400, doc="rows that the drive's memory holds", minimum=3, maximum=400)

    def write(self, table: CompensationTable, stem: str) -> dict[str, str]:
        """Return the file; ConfigurationError for an arc or too many rows."""
        require_circle(table, "MyDrive")
        angles, up, down = columns_deg(table)
        require_at_most(len(angles), self.max_rows, "mydrive: rows", "choose a wider spacing")
        errors = np.rint(-np.column_stack([up, down]) * DEGREE / STEP).astype(np.int64)
        lines = [
            f"{fixed(angle, DECIMALS)} {forward} {reverse}"
            for angle, (forward, reverse) in zip(angles, errors, strict=True)
        ]
        text = "\n".join([f"{TITLE} {table.axis}", f"ROWS {len(lines)}", *lines]) + "\n"
        return {f"{stem}.mdt": text}

    def read(self, files: Mapping[str, str]) -> PeriodicTable:
        """Return the table as the drive loads it; BagError names what is damaged."""
        name, text = only_file(files, ".mdt")
        head, rows = text.splitlines()[:2], text.splitlines()[2:]
        if len(head) < 2 or not head[0].startswith(TITLE) or not head[1].startswith("ROWS "):
            raise BagError(f"{name}: expected the lines '{TITLE} ...' and 'ROWS ...' first")
        if integer(head[1].removeprefix("ROWS "), name) != len(rows):
            raise BagError(f"{name}: {len(rows)} rows, but {head[1]!r} in the second line")
        angles, forward, reverse = parse_rows(name, rows, 3, None).T
        return PeriodicTable(name, angles, forward, reverse, -STEP)

    def resolution(self, table: CompensationTable) -> float:
        """Return the step of the numbers, in rad."""
        return STEP


CONTROLLER: Final = MyDrive
