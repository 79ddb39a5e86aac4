"""Fanuc 0i, 16i, 18i, 30i: stored pitch error compensation.

Slots hold *increments* of the correction, whole numbers -7 .. +7 in detection units x
magnification. For a rotary axis the slots reference + 1 .. reference + N cover one turn, their
sum is zero, and the slot of the reference position repeats the last one. The running sum is
rounded, never the increments. The control does not interpolate: between the points the correction
is a staircase. With bidirectional compensation (3605#0) a second set of slots, from 3626 on, holds
the way back in the same manner, and 3627 what it is at the reference position.
Sources: 0i-PB Parameter Manual B-63980EN/01 p. 100; A-77810E; 16i
Descriptions B-63522EN/02 p. 222; Series 15i Parameter Manual B-63330EN/03 p. 25 (file frame).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from rotcal_controllers.machine_files import PunchedParameters, backlash_note
from rotcal_ros.compensation.controller import Controller, Facts, OwnSetting
from rotcal_ros.compensation.controller_files import (
    columns_deg,
    even_interval_deg,
    fixed,
    integer,
    match_lines,
    mean_deg,
    only_file,
    parse_number,
    require_at_most,
    require_zero_at_start,
)
from rotcal_ros.compensation.table import CompensationTable
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.errors import BagError, ConfigurationError
from rotcal_ros.foundation.observations import Approach
from rotcal_ros.foundation.settings import setting
from rotcal_ros.foundation.units import DEGREE

LARGEST_STEP: Final = 7
LARGEST_MAGNIFICATION: Final = 100
PITCH_DATA: Final = 10000
"""Offset of the number of a pitch slot in a punched file from its slot."""
MEAN: Final = "mean"
UNVERIFIED: Final = (
    "the text form of the file (N1xxxxP..; lines for pitch slots, A.. for the axis)",
    "where inside an interval the control puts out its step",
)
UNVERIFIED_BACK: Final = (
    "that the slots of the way back are increments seen in positive direction as well, from "
    "3626 on, with the same rule for a rotary axis",
    "that 3627 counts in detection units, and that the reference return runs in positive "
    "direction; set 3605#0 to 1 by hand, the file leaves its other bits alone",
)


@dataclass(frozen=True, eq=False)
class PitchTable:
    """Increments (N,) upwards and back, in units of ``unit_deg`` degrees.

    ``back_deg`` is the correction of the way back at the reference position.
    """

    increments: Ints
    back: Ints
    back_deg: float
    unit_deg: float

    def correction(self, angle: Floats, approach: Approach) -> Floats:
        """Return the running sum (rad) at ``angle`` (rad): steps come in mid-interval.

        Where exactly inside the interval a control puts out its step is not documented; the stated
        residual holds for any place.
        """
        up = approach is Approach.POSITIVE
        steps, start_deg = (self.increments, 0.0) if up else (self.back, self.back_deg)
        n = len(steps)
        point = np.floor(np.mod(np.asarray(angle) / DEGREE, 360.0) / (360.0 / n) + 0.5).astype(int)
        total = np.concatenate([[0], np.cumsum(steps)])
        turned = start_deg + total[point] * self.unit_deg
        return np.asarray(turned * DEGREE, dtype=np.float64)


@dataclass(frozen=True)
class Fanuc(Controller):
    """Fanuc 0i, 16i, 18i, 30i with pitch error data for one rotary axis."""

    suffixes = (".txt",)
    facts = Facts(
        title="Fanuc",
        sign="slot = step of -(actual - commanded), in detection units x magnification",
        wrap="3605#0 = 0 (directions each: 1), 3625 = 360, slots reference + 1 .. reference + N, "
        "sum zero, slot(reference) = last",
        unit="detection unit x magnification, whole numbers -7 .. +7",
        source="B-63980EN/01 p. 100, A-77810E, B-63522EN/02 p. 222, B-63330EN/03 p. 25",
        verified_on="the maker's example of a rotary axis",
    )
    staircase = True
    own_settings = (
        OwnSetting(
            "1851, 1852 (1800#4)",
            "add their backlash at every reversal, first at one against the direction of the "
            "reference return",
            "read from machine_file, 1851 held against backlash_units; leave them as they were "
            "during the measurement: nothing of them is in the slots",
            "B-64120EN/01 p. 116",
        ),
        OwnSetting(
            "3605#0",
            "adds a second set of slots, from 3626 on, for the way back",
            "has to be 0 for directions: mean, and 1 for directions: each; read from machine_file "
            "and refused, else set by hand",
            "A-77810E",
        ),
        OwnSetting(
            "8135#0 (0i-D)",
            "switches pitch error compensation off while it is 1",
            "set it to 0",
            "",
        ),
    )

    detection_unit_deg: float = setting(
        0.001, doc="deg, 0.001 (IS-B) or 0.0001 (IS-C)", minimum=1e-6, maximum=0.1
    )
    magnification: int = setting(
        0,
        minimum=0,
        maximum=LARGEST_MAGNIFICATION,
        doc="detection units of one step (parameter 3623); 0: the smallest that fits",
    )
    reference_slot: int = setting(
        0, doc="slot of the reference position (parameter 3620)", minimum=0, maximum=1023
    )
    slots: int = setting(128, doc="pitch slots of the control", minimum=1, maximum=1024)
    axis_number: int = setting(4, doc="number of the controlled axis", minimum=1, maximum=32)
    directions: str = setting(
        MEAN,
        doc="one column, the mean of both directions, or one set of slots for each",
        choices=(MEAN, "each"),
    )
    backlash_units: int | None = setting(
        None, doc="detection units, 1851 during the measurement; none: as in machine_file"
    )
    machine_file: str = setting(
        "", doc="punched parameters of the machine, in lines as N01851Q1A1P0A2P0"
    )

    @property
    def one_direction(self) -> bool:
        """Whether one set of slots serves both directions."""
        return self.directions == MEAN

    @property
    def unverified(self) -> tuple[str, ...]:
        """What has not been confirmed on a real control."""
        return UNVERIFIED if self.one_direction else UNVERIFIED + UNVERIFIED_BACK

    def __post_init__(self) -> None:
        if self.reference_slot >= self.slots:
            raise ConfigurationError(
                f"fanuc: reference_slot {self.reference_slot} is none of the {self.slots} slots "
                f"0 .. {self.slots - 1}"
            )

    def replaced(self, table: CompensationTable) -> str:
        """Hold the parameters of ``machine_file`` against what the slots assume.

        Return what stays beside them; ConfigurationError for what contradicts them.
        """
        if not self.machine_file:
            return ""
        found, axis = PunchedParameters.read(self.machine_file), self.axis_number
        both = found.bit(3605, axis, 0)
        if both is not None and both is self.one_direction:
            raise ConfigurationError(
                f"{found.path}: 3605#0 of axis {axis} is {both:d}, and the slots are of "
                f"directions: {self.directions}: set the bit to {not both:d} and punch the "
                "parameters again"
            )
        notes = [backlash_note(
            f"1851 of axis {axis}", found.number(1851, axis), self.backlash_units,
            "detection units",
        )]  # fmt: skip
        rapid = found.number(1852, axis)
        if rapid and found.bit(1800, 0, 4) is not False:
            notes.append(f"1852 = {rapid:g} acts in rapid traverse if 1800#4 is 1")
        return "; ".join(filter(None, notes))

    @property
    def switch_on(self) -> str:
        """Parameter, power and reference."""
        return (
            f"3605#0 = {0 if self.one_direction else 1}, then power off and on, and a reference "
            "return"
        )

    def write(self, table: CompensationTable, stem: str) -> dict[str, str]:
        """Return the punched parameters and pitch data of one axis.

        Raises ConfigurationError when a step is above 7, or the slots do not suffice.
        """
        spacing = even_interval_deg(table, "Fanuc", self.detection_unit_deg)
        require_zero_at_start(table, "Fanuc", self.resolution(table))
        n = len(table.angles)
        sets = 1 if self.one_direction else 2
        last = self.reference_slot + n
        require_at_most(
            last + (sets - 1) * (n + 1),
            self.slots - 1,
            f"fanuc: last slot for {'two times ' * (sets - 1)}{n} intervals from "
            f"{self.reference_slot}",
            "choose a wider spacing or a lower reference_slot",
        )
        magnification = self._fitting_magnification(table)
        totals = self._totals(table, magnification)
        self._refuse_steps(table, totals)
        values = {
            3620: f"{self.reference_slot}",
            3621: f"{self.reference_slot}",
            3622: f"{last}",
            3623: f"{magnification}",
            3624: fixed(spacing, 6),
            3625: "360.0",
        }
        if sets == 2:
            values |= {3626: f"{last + 1}", 3627: f"{totals[1][0] * magnification}"}
        axis = self.axis_number
        lines = [f"N{number:05d}A{axis}P{value};" for number, value in values.items()]
        steps = [step for total in totals for step in _with_first(np.diff(total))]
        first = PITCH_DATA + self.reference_slot
        lines += [f"N{first + k:05d}P{step};" for k, step in enumerate(steps)]
        return {f"{stem}.txt": "\n".join(["%", *lines, "%"]) + "\n"}

    def read(self, files: Mapping[str, str]) -> PitchTable:
        """Read parameters and slots back; BagError unless they obey the rule for rotary axes."""
        name, text = only_file(files, ".txt")
        line = r"N(\d{5})(?:A\d+)?P(-?[\d.]+);|%"
        found = match_lines(name, text, line, "N10061P-3;")
        values = {int(match[1]): match[2] for _, match in found if match[1]}
        missing = [k for k in (3620, 3621, 3622, 3623, 3624, 3625) if k not in values]
        if missing:
            raise BagError(f"{name}: parameters {missing} are missing")
        reference, low, high, magnification = (
            integer(values[k], f"{name}, parameter {k}") for k in (3620, 3621, 3622, 3623)
        )
        turn, interval = (parse_number(values[k], f"{name}, parameter {k}") for k in (3625, 3624))
        n = high - reference
        if low != reference or n < 2 or turn != 360.0 or abs(n * interval - turn) > 1e-3:
            raise BagError(
                f"{name}: slots {low} .. {high} from {reference}, {interval:g} deg apart in a "
                f"turn of {turn:g} deg; expected the first to be the reference and the rest to "
                "make 360 deg"
            )
        up = _steps(name, values, reference, n)
        unit_deg = self.detection_unit_deg * magnification
        if 3626 not in values and 3627 not in values:
            return PitchTable(up, up, 0.0, unit_deg)
        if not (3626 in values and 3627 in values):
            raise BagError(f"{name}: of the parameters 3626 and 3627 one is missing")
        place, back = (integer(values[k], f"{name}, parameter {k}") for k in (3626, 3627))
        if place <= high:
            raise BagError(
                f"{name}: the way back begins in slot {place}, which is one of the way up "
                f"({low} .. {high})"
            )
        return PitchTable(
            up, _steps(name, values, place, n), back * self.detection_unit_deg, unit_deg
        )

    def resolution(self, table: CompensationTable) -> float:
        """Return the step of a slot, in rad."""
        return self.detection_unit_deg * self._fitting_magnification(table) * DEGREE

    def _totals(self, table: CompensationTable, magnification: int) -> list[Ints]:
        """Return the rounded corrections (N + 1,) of each set of slots, halves away from zero."""
        unit_deg = self.detection_unit_deg * magnification
        return [_rounded(column / unit_deg) for column in self._columns(table)]

    def _columns(self, table: CompensationTable) -> tuple[Floats, ...]:
        """Return the corrections (N + 1,) of each set of slots, degrees."""
        return (mean_deg(table),) if self.one_direction else columns_deg(table)[1:]

    def _refuse_steps(self, table: CompensationTable, totals: list[Ints]) -> None:
        for increments in map(np.diff, totals):
            row = int(np.argmax(np.abs(increments)))
            if abs(increments[row]) > LARGEST_STEP:
                raise ConfigurationError(
                    f"fanuc: the step to {360.0 / len(increments) * (row + 1):g} deg is "
                    f"{increments[row]} at magnification {self.magnification}, and a slot holds "
                    f"-7 .. +7: use a magnification of at least "
                    f"{self._smallest_magnification(table)} or a narrower spacing"
                )

    def _fitting_magnification(self, table: CompensationTable) -> int:
        return self.magnification or self._smallest_magnification(table)

    def _smallest_magnification(self, table: CompensationTable) -> int:
        for magnification in range(1, LARGEST_MAGNIFICATION + 1):
            totals = self._totals(table, magnification)
            if max(np.max(np.abs(np.diff(total))) for total in totals) <= LARGEST_STEP:
                return magnification
        steepest = max(float(np.max(np.abs(np.diff(c)))) for c in self._columns(table))
        raise ConfigurationError(
            f"fanuc: a step of {steepest:.4g} deg between rows is more than 7 x "
            f"{LARGEST_MAGNIFICATION} x {self.detection_unit_deg:g} deg: choose a narrower spacing"
        )


def _rounded(values: Floats) -> Ints:
    """Return whole numbers, halves away from zero."""
    return np.copysign(np.floor(np.abs(values) + 0.5 + 1e-9), values).astype(np.int64)


def _with_first(increments: Ints) -> list[int]:
    """Return the slots of a turn: that of the reference repeats the last one."""
    return [int(increments[-1]), *increments.tolist()]


def _steps(name: str, values: Mapping[int, str], first: int, n: int) -> Ints:
    """Return the ``n`` steps of the slots after ``first``; BagError unless they make a turn."""
    slots = range(first, first + n + 1)
    if any(PITCH_DATA + k not in values for k in slots):
        raise BagError(f"{name}: not all slots {first} .. {first + n} are there")
    steps = [integer(values[PITCH_DATA + k], f"{name}, slot {k}") for k in slots]
    if sum(steps[1:]) != 0 or steps[0] != steps[-1] or max(map(abs, steps)) > LARGEST_STEP:
        raise BagError(
            f"{name}: the steps of a turn add up to {sum(steps[1:])} (expected 0), the slot "
            f"of the reference holds {steps[0]} and the last {steps[-1]} (expected the same), "
            f"the largest is {max(map(abs, steps))} (at most 7)"
        )
    return np.array(steps[1:], dtype=np.int64)
