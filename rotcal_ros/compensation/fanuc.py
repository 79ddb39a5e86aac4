"""Fanuc 0i, 16i, 18i, 30i: stored pitch error compensation.

Slots hold *increments* of the correction, whole numbers -7 .. +7 in detection units x
magnification. For a rotary axis the slots reference + 1 .. reference + N cover one turn, their
sum is zero, and the slot of the reference position repeats the last one. The running sum is
rounded, never the increments. The control does not interpolate: between the points the correction
is a staircase. Sources: 0i-PB Parameter Manual B-63980EN/01 p. 100; A-77810E; 16i
Descriptions B-63522EN/02 p. 222; Series 15i Parameter Manual B-63330EN/03 p. 25 (file frame).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from rotcal_ros.arrays import Floats, Ints
from rotcal_ros.compensation.controller import Controller, Facts
from rotcal_ros.compensation.parsing import integer, matches, number, only_file
from rotcal_ros.compensation.rows import (
    even_interval_deg,
    fixed,
    mean_deg,
    require_at_most,
    require_zero_at_start,
)
from rotcal_ros.compensation.table import CompensationTable
from rotcal_ros.errors import BagError, ConfigurationError
from rotcal_ros.observations import Approach
from rotcal_ros.settings import setting
from rotcal_ros.units import DEGREE

LARGEST_STEP: Final = 7
LARGEST_MAGNIFICATION: Final = 100
PITCH_DATA: Final = 10000
"""In a punched file the number of a pitch slot is its slot plus this."""


@dataclass(frozen=True, eq=False)
class PitchTable:
    """Increments (N,) from the reference on, in units of ``unit_deg`` degrees."""

    increments: Ints
    unit_deg: float

    def correction(self, angle: Floats, approach: Approach) -> Floats:
        """Return the running sum (rad) at ``angle`` (rad): each step comes amid its interval.

        The same in both directions. Where exactly inside the interval a control puts out its step
        is not documented; the stated residual holds for any place.
        """
        n = len(self.increments)
        point = np.floor(np.mod(np.asarray(angle) / DEGREE, 360.0) / (360.0 / n) + 0.5).astype(int)
        total = np.concatenate([[0], np.cumsum(self.increments)])
        return np.asarray(total[point] * (self.unit_deg * DEGREE), dtype=np.float64)


@dataclass(frozen=True)
class Fanuc(Controller):
    """Fanuc 0i, 16i, 18i, 30i with pitch error data for one rotary axis."""

    suffixes = (".txt",)
    facts = Facts(
        title="Fanuc",
        sign="slot = step of -(actual - commanded), in detection units x magnification",
        wrap="3605#0 = 0, 3625 = 360, slots reference + 1 .. reference + N, sum zero, "
        "slot(reference) = last",
        unit="detection unit x magnification, whole numbers -7 .. +7",
        source="B-63980EN/01 p. 100, A-77810E, B-63522EN/02 p. 222, B-63330EN/03 p. 25",
    )
    staircase = True
    one_direction = True
    unverified = (
        "the text form of the file (N1xxxxP..; lines for pitch slots, A.. for the axis)",
        "where inside an interval the control puts out its step",
    )

    detection_unit_deg: float = setting(
        0.001, doc="deg, 0.001 (IS-B) or 0.0001 (IS-C)", minimum=1e-6, maximum=0.1
    )
    magnification: int = setting(
        0,
        doc="detection units of one step (parameter 3623); 0: the smallest that fits",
        minimum=0,
        maximum=LARGEST_MAGNIFICATION,
    )
    reference_slot: int = setting(
        0, doc="slot of the reference position (parameter 3620)", minimum=0, maximum=1023
    )
    slots: int = setting(128, doc="pitch slots of the control", minimum=1, maximum=1024)
    axis_number: int = setting(4, doc="number of the controlled axis", minimum=1, maximum=32)

    def __post_init__(self) -> None:
        if self.reference_slot >= self.slots:
            raise ConfigurationError(
                f"fanuc: reference_slot {self.reference_slot} is none of the {self.slots} slots "
                f"0 .. {self.slots - 1}"
            )

    def write(self, table: CompensationTable, stem: str) -> dict[str, str]:
        """Return the punched parameters and pitch data of one axis.

        Raises ConfigurationError when a step is above 7, or the slots do not suffice.
        """
        spacing = even_interval_deg(table, "Fanuc", self.detection_unit_deg)
        require_zero_at_start(table, "Fanuc", self.resolution(table))
        n = len(table.angles)
        last = self.reference_slot + n
        require_at_most(
            last,
            self.slots - 1,
            f"fanuc: last slot for {n} intervals from {self.reference_slot}",
            "choose a wider spacing or a lower reference_slot",
        )
        magnification = self._fitting_magnification(table)
        increments = _increments(table, self.detection_unit_deg * magnification)
        self._refuse_steps(table, increments)
        axis = self.axis_number
        values = {
            3620: f"{self.reference_slot}",
            3621: f"{self.reference_slot}",
            3622: f"{last}",
            3623: f"{magnification}",
            3624: fixed(spacing, 6),
            3625: "360.0",
        }
        lines = [f"N{number:05d}A{axis}P{value};" for number, value in values.items()]
        first = PITCH_DATA + self.reference_slot
        lines += [
            f"N{first + k:05d}P{step};" for k, step in enumerate([increments[-1], *increments])
        ]
        return {f"{stem}.txt": "\n".join(["%", *lines, "%"]) + "\n"}

    def read(self, files: Mapping[str, str]) -> PitchTable:
        """Read parameters and slots back; BagError unless they obey the rule for rotary axes."""
        name, text = only_file(files, ".txt")
        line = r"N(\d{5})(?:A\d+)?P(-?[\d.]+);|%"
        found = matches(name, text, line, "N10061P-3;")
        values = {int(match[1]): match[2] for _, match in found if match[1]}
        missing = [k for k in (3620, 3621, 3622, 3623, 3624, 3625) if k not in values]
        if missing:
            raise BagError(f"{name}: parameters {missing} are missing")
        reference, low, high, magnification = (
            integer(values[k], f"{name}, parameter {k}") for k in (3620, 3621, 3622, 3623)
        )
        turn, interval = (number(values[k], f"{name}, parameter {k}") for k in (3625, 3624))
        slots = range(reference, high + 1)
        n = high - reference
        if low != reference or n < 2 or turn != 360.0 or abs(n * interval - turn) > 1e-3:
            raise BagError(
                f"{name}: slots {low} .. {high} from {reference}, {interval:g} deg apart in a "
                f"turn of {turn:g} deg; expected the first to be the reference and the rest to "
                "make 360 deg"
            )
        if any(PITCH_DATA + k not in values for k in slots):
            raise BagError(f"{name}: not all slots {reference} .. {high} are there")
        steps = [integer(values[PITCH_DATA + k], f"{name}, slot {k}") for k in slots]
        if sum(steps[1:]) != 0 or steps[0] != steps[-1] or max(map(abs, steps)) > LARGEST_STEP:
            raise BagError(
                f"{name}: the steps of a turn add up to {sum(steps[1:])} (expected 0), the slot "
                f"of the reference holds {steps[0]} and the last {steps[-1]} (expected the same), "
                f"the largest is {max(map(abs, steps))} (at most 7)"
            )
        return PitchTable(
            np.array(steps[1:], dtype=np.int64), self.detection_unit_deg * magnification
        )

    def resolution(self, table: CompensationTable) -> float:
        """Return the step of a slot, in rad."""
        return self.detection_unit_deg * self._fitting_magnification(table) * DEGREE

    def _refuse_steps(self, table: CompensationTable, increments: Ints) -> None:
        row = int(np.argmax(np.abs(increments)))
        if abs(increments[row]) > LARGEST_STEP:
            raise ConfigurationError(
                f"fanuc: the step to {360.0 / len(increments) * (row + 1):g} deg is "
                f"{increments[row]} at magnification {self.magnification}, and a slot holds "
                f"-7 .. +7: use a magnification of at least {self._smallest_magnification(table)} "
                "or a narrower spacing"
            )

    def _fitting_magnification(self, table: CompensationTable) -> int:
        return self.magnification or self._smallest_magnification(table)

    def _smallest_magnification(self, table: CompensationTable) -> int:
        for magnification in range(1, LARGEST_MAGNIFICATION + 1):
            steps = _increments(table, self.detection_unit_deg * magnification)
            if np.max(np.abs(steps)) <= LARGEST_STEP:
                return magnification
        steepest = float(np.max(np.abs(np.diff(mean_deg(table)))))
        raise ConfigurationError(
            f"fanuc: a step of {steepest:.4g} deg between rows is more than 7 x "
            f"{LARGEST_MAGNIFICATION} x {self.detection_unit_deg:g} deg: choose a narrower spacing"
        )


def _increments(table: CompensationTable, unit_deg: float) -> Ints:
    """Return the steps (N,) of the rounded running sum, halves away from zero."""
    scaled = mean_deg(table) / unit_deg
    total = np.copysign(np.floor(np.abs(scaled) + 0.5 + 1e-9), scaled).astype(np.int64)
    return np.diff(total)


CONTROLLER: Final = Fanuc
