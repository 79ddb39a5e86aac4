"""Delta Tau PMAC: DEFINE COMP and DEFINE BLCOMP, whole numbers of 1/16 count.

Entry k holds the correction at k x spacing, k = 1 .. N; zero is zero by definition and the last
entry is the one at zero again. The table rolls over by itself, it is added to the desired
position. The backlash is subtracted while the motor moves in the negative direction: its size at
home is Ixx86, which is never negative; BLCOMP holds the difference elsewhere, and with Ixx85 = 0
none of it is applied. Sources: ``Pmac.facts``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from rotcal_controllers.machine_files import machine_text
from rotcal_ros.compensation.controller import Comment, Controller, Facts, OwnSetting
from rotcal_ros.compensation.controller_files import (
    PeriodicTable,
    backlash_note,
    columns_deg,
    even_interval_deg,
    integer,
    mean_deg,
    only_file,
    require_zero_at_start,
)
from rotcal_ros.compensation.table import CompensationTable
from rotcal_ros.foundation.arrays import Ints
from rotcal_ros.foundation.errors import BagError, ConfigurationError
from rotcal_ros.foundation.observations import Approach
from rotcal_ros.foundation.settings import setting
from rotcal_ros.foundation.units import ARCSEC, DEGREE

FRACTION: Final = 16
LARGEST: Final = 8_388_607
"""The largest value of Ixx85 and Ixx86."""
BLCOMP: Final = "blcomp"
NOT_KNOWN: Final = (
    "during the measurement is not known: the file overwrites it, and what it corrected is then "
    "missing: state --set backlash_sixteenths=N, 0 for none, or --set machine_file=FILE"
)


@dataclass(frozen=True)
class Pmac(Controller):
    """Delta Tau PMAC and Turbo PMAC."""

    suffixes = (".pmc",)
    comment = Comment(".pmc", 0, "; {}")
    facts = Facts(
        title="Delta Tau PMAC",
        sign="entry = -(actual - commanded), added to the desired position",
        wrap="automatic roll-over; entry N = entry at 0 = 0",
        unit="whole numbers of 1/16 count",
        source="Turbo PMAC User Manual pp. 189-192; Turbo PMAC Software Reference pp. 148, 303; "
        "PMAC Software Reference pp. 207-211",
        verified_on="the maker's example",
    )
    switch_on = "I51=1 (in the file), then home the motor"
    own_settings = (
        OwnSetting(
            "Ixx86, Ixx85",
            "are overwritten by the way back: a backlash in force would be lost",
            "Ixx86 goes into the table: read from machine_file, or stated by backlash_sixteenths",
            "Turbo PMAC User Manual p. 191; PMAC Software Reference pp. 120, 207",
        ),
        OwnSetting(
            "I51",
            "switches on the tables of all motors, those of others too",
            "look first which other motors have tables",
            "PMAC Software Reference p. 207",
        ),
        OwnSetting(
            "Ixx87 (Turbo)",
            "a reversal shorter than this counts as none",
            "keep it below the reversals of the work",
            "Turbo PMAC Software Reference p. 148",
        ),
    )

    motor: int = setting(1, doc="number of the motor", minimum=1, maximum=32)
    counts_per_turn: int = setting(
        360_000, doc="counts of the motor's position in a turn of the table", minimum=360
    )
    reversal: str = setting(
        BLCOMP,
        doc="the way back in BLCOMP and Ixx86, or one column, the mean of both directions",
        choices=(BLCOMP, "mean"),
    )
    take_up_rate: int = setting(
        16,
        minimum=1,
        maximum=LARGEST,
        doc="Ixx85: 1/16 count per background cycle; 0 would switch the way back off",
    )

    backlash_sixteenths: int | None = setting(
        None,
        minimum=0,
        maximum=LARGEST,
        doc="1/16 count, Ixx86 of the motor during a measurement without table; none: that of "
        "machine_file",
    )
    machine_file: str = setting(
        "", doc="text file with the variables of the motor, in lines such as I186=120"
    )

    @property
    def one_direction(self) -> bool:
        """Whether COMP alone is written."""
        return self.reversal != BLCOMP

    def for_axis(self, axis: str) -> Pmac:
        """Return the controller with Ixx86 from the machine's file; 0 where Ixx85 is 0.

        Raises ConfigurationError when the file cannot be read or does not state both.
        """
        if not self.machine_file or self.backlash_sixteenths is not None:
            return self
        text = machine_text(self.machine_file)
        rate, home = (
            re.search(rf"^\s*I{self.motor}{n}\s*=\s*(\d+)\s*$", text, re.MULTILINE)
            for n in (85, 86)
        )
        if rate is None or home is None:
            raise ConfigurationError(
                f"{self.machine_file}: expected lines I{self.motor}85=... and "
                f"I{self.motor}86=...; add them, or state backlash_sixteenths"
            )
        return replace(self, backlash_sixteenths=int(home[1]) if int(rate[1]) else 0)

    def without_table(self, approach: Approach) -> float:
        """Return Ixx86 taken off from above, if the file overwrites it."""
        if approach is Approach.POSITIVE or self.one_direction:
            return 0.0
        return -(self.backlash_sixteenths or 0) * self._unit_deg * DEGREE

    def replaced(self, table: CompensationTable) -> str:
        """Say what became of Ixx86, which the file overwrites if the directions differ.

        Raises ConfigurationError where it would be lost, since nobody states it.
        """
        if self.one_direction:
            return ""
        if self.backlash_sixteenths is None:
            if table.directional:
                raise ConfigurationError(f"I{self.motor}86 {NOT_KNOWN}")
            return ""
        amount = -self.without_table(Approach.NEGATIVE)
        about = f"I{self.motor}86 = {self.backlash_sixteenths}, which the file overwrites,"
        return backlash_note(about, amount, table)

    def write(self, table: CompensationTable, stem: str) -> dict[str, str]:
        """Return the on-line commands; ConfigurationError unless zero stays zero.

        The error is also raised for a reversal at the motor's zero with a sign that Ixx86 cannot
        hold.
        """
        turn, motor, unit_deg = self.counts_per_turn, self.motor, self._unit_deg
        spacing = even_interval_deg(table, "PMAC", 360.0 / turn)
        require_zero_at_start(table, "PMAC", unit_deg * DEGREE)
        n = round(360.0 / spacing)
        _, up, down = columns_deg(table)
        both = table.directional and not self.one_direction
        columns = (up, down) if both else (mean_deg(table),) * 2
        comp, back = (np.rint(c / unit_deg).astype(np.int64) for c in columns)
        comp = comp - comp[0]
        # COMP is rejected while any BLCOMP is there (Turbo PMAC Software Reference p. 303).
        lines = [f"#{motor} DELETE BLCOMP", f"#{motor} DELETE COMP"]
        lines += [f"#{motor} DEFINE COMP {n},{turn}", " ".join(map(str, comp[1:]))]
        if both:
            lines += self._way_back(comp - back, n)
        return {f"{stem}.pmc": "\n".join([*lines, "I51=1"]) + "\n"}

    def read(self, files: Mapping[str, str]) -> PeriodicTable:
        """Read the commands back; BagError unless both tables are complete and end with zero."""
        name, text = only_file(files, ".pmc")
        comp = self._entries(name, text, "COMP")
        if comp is None:
            raise BagError(f"{name}: no DEFINE COMP for motor {self.motor}")
        varying = self._entries(name, text, "BLCOMP")
        home = self._variable(name, text, 86)
        if varying is None and home is None:
            varying, home = np.zeros_like(comp), 0
        elif varying is None or home is None or not self._variable(name, text, 85):
            raise BagError(
                f"{name}: BLCOMP, I{self.motor}86 and an I{self.motor}85 above 0 go together: "
                "without all of them the way back is wrong"
            )
        if len(varying) != len(comp):
            raise BagError(
                f"{name}: {len(comp) - 1} entries in COMP, {len(varying) - 1} in BLCOMP"
            )
        rows = np.linspace(0.0, 360.0, len(comp))
        return PeriodicTable(name, rows, comp, comp - varying - home, self._unit_deg * DEGREE)

    def resolution(self, table: CompensationTable) -> float:
        """Return two units, in rad: the reverse value is the difference of two rounded ones."""
        return 2.0 * self._unit_deg * DEGREE

    @property
    def _unit_deg(self) -> float:
        return 360.0 / self.counts_per_turn / FRACTION

    def _way_back(self, backlash: Ints, n: int) -> list[str]:
        """Return BLCOMP, take-up rate and backlash at home, of the ``backlash`` (n + 1,)."""
        motor, home = self.motor, int(backlash[0])
        if not 0 <= home <= LARGEST:
            raise ConfigurationError(
                f"PMAC: the reversal at the motor's zero is {home} sixteenths of a count "
                f"({home * self._unit_deg * DEGREE / ARCSEC:.4g} arcsec), and I{motor}86 holds "
                f"0 .. {LARGEST}: give reversal=mean to write the mean of both directions"
            )
        return [
            f"#{motor} DEFINE BLCOMP {n},{self.counts_per_turn}",
            " ".join(map(str, backlash[1:] - home)),
            f"I{motor}85={self.take_up_rate}",
            f"I{motor}86={home}",
        ]

    def _variable(self, name: str, text: str, number: int) -> int | None:
        """Return the motor's I-variable ``number``, or None when it is not there."""
        variable = f"I{self.motor}{number}"
        match = re.search(rf"^{variable}=(.*)$", text, re.MULTILINE)
        if match is None:
            return None
        value = integer(match.group(1), f"{name}, {variable}")
        if not 0 <= value <= LARGEST:
            raise BagError(f"{name}: {variable} is {value}, expected 0 .. {LARGEST}")
        return value

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
