"""Delta Tau PMAC: DEFINE COMP and DEFINE BLCOMP, whole numbers of 1/16 count.

Entry k holds the correction at k x spacing, k = 1 .. N; zero is zero by definition and
the last entry is the one at zero again. The table rolls over by itself. The backlash table is
taken off when the motor moves in the negative direction; its constant part is the backlash
size Ixx86. Source: PMAC User's Manual pp. 79-80, PMAC Software Reference pp. 207-211.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from rotcal_ros.arrays import Ints
from rotcal_ros.compensation.controller import Controller, Facts
from rotcal_ros.compensation.parsing import integer, only_file
from rotcal_ros.compensation.rows import columns_deg, even_interval_deg, require_zero_at_start
from rotcal_ros.compensation.rules import PeriodicTable
from rotcal_ros.compensation.table import CompensationTable
from rotcal_ros.errors import BagError
from rotcal_ros.settings import setting
from rotcal_ros.units import DEGREE

FRACTION: Final = 16


@dataclass(frozen=True)
class Pmac(Controller):
    """Delta Tau PMAC."""

    facts = Facts(
        title="Delta Tau PMAC",
        sign="entry = -(actual - commanded), added to the motor",
        wrap="automatic roll-over; entry N = entry at 0 = 0",
        unit="whole numbers of 1/16 count",
        source="PMAC User's Manual pp. 79-80; Software Reference pp. 207-211",
    )
    unverified = (
        "that the correction is added to the command, not to the measured position",
        "that the constant part of the reversal belongs into Ixx86, in 1/16 count",
    )

    motor: int = setting(1, doc="number of the motor", minimum=1, maximum=32)
    counts_per_turn: int = setting(
        360_000, doc="counts of the motor's position in a turn of the table", minimum=360
    )

    def write(self, table: CompensationTable, stem: str) -> dict[str, str]:
        """Return the on-line commands; ConfigurationError unless zero stays zero."""
        turn, motor, unit_deg = self.counts_per_turn, self.motor, self._unit_deg
        spacing = even_interval_deg(table, "PMAC", 360.0 / turn)
        require_zero_at_start(table, "PMAC", unit_deg * DEGREE)
        n = round(360.0 / spacing)
        _, up, down = (np.rint(c / unit_deg).astype(np.int64) for c in columns_deg(table))
        up = up - up[0]
        backlash = up - down
        lines = [f"#{motor} DEFINE COMP {n},{turn}", " ".join(map(str, up[1:]))]
        if table.directional:
            lines += [f"#{motor} DEFINE BLCOMP {n},{turn}"]
            lines += [" ".join(map(str, backlash[1:] - backlash[0])), f"I{motor}86={backlash[0]}"]
        return {f"{stem}.pmc": "\n".join([*lines, "I51=1"]) + "\n"}

    def read(self, files: Mapping[str, str]) -> PeriodicTable:
        """Read the commands back; BagError unless both tables are complete and end with zero."""
        name, text = only_file(files, ".pmc")
        comp = self._entries(name, text, "COMP")
        if comp is None:
            raise BagError(f"{name}: no DEFINE COMP for motor {self.motor}")
        varying = self._entries(name, text, "BLCOMP")
        constant = re.search(rf"^I{self.motor}86=(-?\d+)$", text, re.MULTILINE)
        backlash = np.zeros_like(comp) if varying is None else varying
        if constant is not None:
            backlash = backlash + integer(constant.group(1), f"{name}, I{self.motor}86")
        if len(backlash) != len(comp):
            raise BagError(
                f"{name}: {len(comp) - 1} entries in COMP, {len(backlash) - 1} in BLCOMP"
            )
        rows = np.linspace(0.0, 360.0, len(comp))
        return PeriodicTable(name, rows, comp, comp - backlash, self._unit_deg * DEGREE)

    def resolution(self, table: CompensationTable) -> float:
        """Return two units, in rad: the reverse value is the difference of two rounded ones."""
        return 2.0 * self._unit_deg * DEGREE

    @property
    def _unit_deg(self) -> float:
        return 360.0 / self.counts_per_turn / FRACTION

    def _entries(self, name: str, text: str, kind: str) -> Ints | None:
        """Return 0 and the entries of one table, or None when it is not there."""
        head = rf"^#{self.motor} DEFINE {kind} (\d+),(\d+)\n([^\n]*)$"
        match = re.search(head, text, re.MULTILINE)
        if match is None:
            return None
        values = [integer(cell, f"{name}, {kind}") for cell in match.group(3).split()]
        found = (len(values), int(match.group(2)), values[-1] if values else None)
        expected = (int(match.group(1)), self.counts_per_turn, 0)
        if found != expected:
            raise BagError(
                f"{name}, {kind}: entries, counts per turn and last entry are {found}, "
                f"expected {expected}"
            )
        return np.array([0, *values], dtype=np.int64)


CONTROLLER: Final = Pmac
