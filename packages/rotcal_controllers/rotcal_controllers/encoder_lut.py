"""Lookup tables of encoders and closed-loop steppers: N whole numbers per turn, as a C array.

The encoder sits on the table's axis. Of three forms two hold what is taken off the reading, at
even readings: ``counts`` (signed, for firmware of your own) and ``simplefoc`` (CalibratedSensor,
unsigned); ``servo`` (StepperServoCAN) holds the reading at even angles of the table. The firmware
is linear between them, in every turn, and the same in both directions. Sources:
``EncoderLut.facts``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from rotcal_ros.compensation.controller import Comment, Controller, Facts, OwnSetting
from rotcal_ros.compensation.controller_files import even_interval_deg, integer, only_file
from rotcal_ros.compensation.table import CompensationTable, Correction, average_directions
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.errors import BagError, ConfigurationError
from rotcal_ros.foundation.observations import Approach
from rotcal_ros.foundation.settings import setting
from rotcal_ros.foundation.units import ARCSEC, DEGREE, TURN

COUNTS, SIMPLEFOC, SERVO = "counts", "simplefoc", "servo"
SCALE, MIDDLE = 65535.0 / TURN, 32767
"""SimpleFOC's LUT_SCALE (1/rad) and LUT_OFFSET."""
NAMES: Final = {COUNTS: "encoder_lut", SIMPLEFOC: "calibrationLut", SERVO: "FlashCalData"}
IN_A_LINE: Final = 10
STEPS: Final = 20
"""Iterations of a reading that depends on itself; each gains the slope of the table."""


@dataclass(frozen=True, eq=False)
class EncoderLookUp:
    """What firmware takes off a reading: ``taken`` (n,) rad at ``readings`` (n,) rad, ascending.

    ``sense`` is -1 for an encoder that counts against the table, ``zero`` (rad) its reading where
    the table stands at 0.
    """

    readings: Floats
    taken: Floats
    sense: int
    zero: float

    def correction(self, angle: Floats, approach: Approach) -> Floats:
        """Return how far (rad) the true angle is turned on, until the corrected reading fits.

        The uncorrected reading r that is reached has r - taken(r) = the wanted one; so the motor
        is moved by taken(r).
        """
        wanted = self.sense * np.asarray(angle, dtype=np.float64) + self.zero
        taken = np.zeros_like(wanted)
        for _ in range(STEPS):
            taken = np.interp(wanted + taken, self.readings, self.taken, period=TURN)
        return np.asarray(self.sense * taken, dtype=np.float64)


@dataclass(frozen=True)
class EncoderLut(Controller):
    """Firmware that corrects the reading of an encoder by a lookup table."""

    suffixes = (".h",)
    comment = Comment(".h", 0, "// {}")
    facts = Facts(
        title="Encoder lookup table",
        sign="counts, simplefoc: corrected = reading - value, so value = -(actual - commanded); "
        "servo: value = reading at even angles",
        wrap="N values per turn, the one after the last is the first",
        unit="counts: encoder counts; simplefoc: whole numbers of 1/10430.2 rad (19.8 arcsec) "
        "around 32767; servo: encoder counts",
        source="SimpleFOC Arduino-FOC-drivers (12/2025), CalibratedSensor.h and .cpp; "
        "StepperServoCAN, calibration.c",
        verified_on="the source of the firmware",
    )
    one_direction = True
    own_settings = (
        OwnSetting(
            "a table that the firmware has measured itself",
            "is replaced, and one that acted during the measurement is not in this one",
            "measure with the firmware's own table switched off, and do not calibrate again",
            "CalibratedSensor.cpp",
        ),
        OwnSetting(
            "zero_electric_angle (SimpleFOC)",
            "was found with the old table, and commutation needs the new one",
            "align the motor again after the table was put in",
            "CalibratedSensor.cpp",
        ),
    )

    form: str = setting(COUNTS, doc="what the firmware reads", choices=(COUNTS, SIMPLEFOC, SERVO))
    points: int = setting(
        0, doc="values per turn of the firmware; 0: as many as rows", minimum=0, maximum=65536
    )
    counts_per_turn: int = setting(
        1_048_576, doc="counts of the encoder in a turn of the table", minimum=256
    )
    zero_deg: float = setting(0.0, doc="deg, reading of the encoder where the table stands at 0")
    encoder_turns: str = setting(
        "forward",
        doc="whether the encoder counts with the table or against it",
        choices=("forward", "backward"),
    )

    @property
    def row_spacings_deg(self) -> tuple[float, ...]:
        """The one spacing that gives as many rows as the firmware has values."""
        return (360.0 / self.points,) if self.points else ()

    @property
    def switch_on(self) -> str:
        """Where the array goes."""
        return {
            COUNTS: "subtract the value, linear between two of them, from every reading",
            SIMPLEFOC: "CalibratedSensor(sensor, n_lut, calibrationLut), without calibrate()",
            SERVO: "write the values to the flash of the calibration table, then restart",
        }[self.form]

    def write(self, table: CompensationTable, stem: str) -> dict[str, str]:
        """Return the array; ConfigurationError unless there are as many rows as values."""
        even_interval_deg(table, "encoder_lut", 360.0 / len(table.angles))
        if self.points and len(table.angles) != self.points:
            raise ConfigurationError(
                f"encoder_lut: {len(table.angles)} rows, and the firmware has {self.points} "
                f"values per turn: choose a spacing of {360.0 / self.points:.9g} deg, or points"
            )
        mean = average_directions(table)
        zeros = np.zeros(len(table.angles))
        resting = replace(mean, correction_forward=zeros, correction_reverse=zeros)
        values = self._values(mean)
        low, high = (0, 65535) if self.form != COUNTS else (-32768, 32767)
        if np.min(values) < low or np.max(values) > high:
            raise ConfigurationError(
                f"encoder_lut: values {np.min(values)} .. {np.max(values)}, and the firmware "
                f"holds {low} .. {high}: state fewer counts_per_turn, if an encoder needs this"
            )
        if not np.any(values - self._values(resting)):
            raise ConfigurationError(
                f"encoder_lut: every value rounds to nothing, in steps of "
                f"{self._step / ARCSEC:.3g} arcsec: the table would change nothing"
            )
        kind = "int16_t" if self.form == COUNTS else "uint16_t"
        cells = [str(value) for value in values]
        rows = [", ".join(cells[k : k + IN_A_LINE]) for k in range(0, len(cells), IN_A_LINE)]
        text = f"{kind} {NAMES[self.form]}[{len(cells)}] = {{\n" + ",\n".join(rows) + "\n};\n"
        return {f"{stem}.h": text}

    def read(self, files: Mapping[str, str]) -> EncoderLookUp:
        """Read the array back; BagError unless it has all values."""
        name, text = only_file(files, ".h")
        body = re.sub(r"^//.*\n", "", text, flags=re.MULTILINE)
        match = re.fullmatch(r"u?int16_t (\w+)\[(\d+)\] = \{([-\d,\s]*)\};\n", body)
        cells = re.split(r",\s*", match[3].strip()) if match else []
        if match is None or match[1] != NAMES[self.form] or integer(match[2], name) != len(cells):
            raise BagError(
                f"{name}: expected {NAMES[self.form]}[N] = {{...}}; with N values, found "
                f"{len(cells)}"
            )
        if self.points and len(cells) != self.points:
            raise BagError(f"{name}: {len(cells)} values, expected {self.points} per turn")
        found = [integer(cell, name) for cell in cells]
        if not all(-32768 <= value <= 65535 for value in found):
            raise BagError(f"{name}: a value is none of 16 bits")
        values = np.array(found, dtype=np.int64)
        even = np.arange(len(values)) * TURN / len(values)
        readings = np.asarray(even, dtype=np.float64)
        taken = np.asarray((values - self._middle) * self._step, dtype=np.float64)
        if self.form == SERVO:
            readings, taken = taken, (taken - readings + np.pi) % TURN - np.pi
        return EncoderLookUp(readings, taken, self._sense, self.zero_deg * DEGREE)

    def resolution(self, table: CompensationTable) -> float:
        """Return the step of a value, in rad."""
        return self._step

    @property
    def _sense(self) -> int:
        return 1 if self.encoder_turns == "forward" else -1

    @property
    def _step(self) -> float:
        return 1.0 / SCALE if self.form == SIMPLEFOC else TURN / self.counts_per_turn

    @property
    def _middle(self) -> int:
        return MIDDLE if self.form == SIMPLEFOC else 0

    def _values(self, table: CompensationTable) -> Ints:
        """Return the whole numbers (n,) of the array, one for each row."""
        n = len(table.angles)
        curve, even = Correction(table), np.arange(n) * TURN / n

        def taken(readings: Floats) -> Floats:
            angles = self._sense * (readings - self.zero_deg * DEGREE)
            return self._sense * curve(angles, Approach.POSITIVE)

        if self.form != SERVO:
            return np.rint(taken(even) / self._step).astype(np.int64) + self._middle
        readings = even
        for _ in range(STEPS):
            readings = even + taken(readings)
        return np.rint(readings / self._step).astype(np.int64) % self.counts_per_turn
