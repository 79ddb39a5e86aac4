"""Aerotech Automation1, A3200, Ensemble, Soloist: a 1D axis calibration table (``.cal``).

A block ``:START axis``, evenly spaced corrections from position 0 on, ``:END``; linear between
them, the same in both directions, and the end values beyond. Axes count from 1. The pages at hand
name no wrap: the rows are repeated for every turn of the travel. Sources: ``Aerotech.facts``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from rotcal_ros.compensation.controller import Comment, EveryTurnController, Facts, OwnSetting
from rotcal_ros.compensation.controller_files import (
    UnrolledTable,
    columns_deg,
    even_interval_deg,
    fixed,
    integer,
    mean_deg,
    only_file,
    parse_number,
    repeat_for_turns,
)
from rotcal_ros.compensation.table import CompensationTable
from rotcal_ros.foundation.errors import BagError, ConfigurationError
from rotcal_ros.foundation.settings import setting
from rotcal_ros.foundation.units import ARCSEC, DEGREE

DECIMALS: Final = 4
PLACES: Final = 6
IN_A_LINE: Final = 6
BLOCK: Final = re.compile(
    r":START (\d+) SAMPLEDIST=(\S+) POSUNIT=PRIMARY CORUNIT=PRIMARY/3600\n"
    r"((?:[-\d. ]+\n)+):END\n"
)


@dataclass(frozen=True)
class Aerotech(EveryTurnController):
    """A rotary axis of an Aerotech controller, its primary unit in degrees."""

    suffixes = (".cal",)
    comment = Comment(".cal", 0, "; {}")
    facts = Facts(
        title="Aerotech (.cal)",
        sign="value = -(actual - commanded)",
        wrap="none: rows from 0 on, repeated for each turn, beyond them the end row is held",
        unit="arcseconds (CORUNIT=PRIMARY/3600), 4 decimals",
        source="help.aerotech.com, Automation1, Axis Calibration; a program of Aerotech's tests "
        "of rotary stages that writes such files, on GitHub",
        verified_on="page, and a program that writes the file",
    )
    position_resolution = 10.0**-PLACES * DEGREE
    value_resolution = 10.0**-DECIMALS * ARCSEC
    switch_on = "name the file below Configure, Calibration, or load it by CalibrationLoad()"
    one_direction = True
    unverified = (
        "the sign: that program writes minus the measured error, and the page does not say",
        "that the first value is the one at position 0 (HOMEOFFSET is left out)",
    )
    own_settings = (
        OwnSetting(
            "other calibration tables of the axis",
            "are added to this one, tables of two axes too",
            "leave those in force that were so during the measurement",
            "help.aerotech.com, Automation1, Axis Calibration",
        ),
        OwnSetting(
            "ReverseMotionDirection",
            "does not turn the table: it follows the sign of the encoder",
            "if it is set, positions and values have to be turned by hand",
            "help.aerotech.com, Automation1, Axis Calibration",
        ),
        OwnSetting(
            "backlash compensation of the axis",
            "acts beside the table",
            "leave it as it was during the measurement: the table has one column",
            "",
        ),
    )

    axis_number: int = setting(1, doc="number of the axis, from 1 on", minimum=1)

    def __post_init__(self) -> None:
        if self.first_turn != 0:
            raise ConfigurationError(
                f"aerotech: first_turn {self.first_turn}: the table begins at position 0, choose 0"
            )

    def write(self, table: CompensationTable, stem: str) -> dict[str, str]:
        """Return the file; ConfigurationError for an arc or uneven rows."""
        spacing = even_interval_deg(table, "Aerotech", 10.0**-PLACES)
        _, added = repeat_for_turns(0, self.turns, columns_deg(table)[0], mean_deg(table))
        cells = [fixed(value, DECIMALS) for value in added * DEGREE / ARCSEC]
        lines = [
            f":START {self.axis_number} SAMPLEDIST={fixed(spacing, PLACES)} POSUNIT=PRIMARY "
            "CORUNIT=PRIMARY/3600",
            *(" ".join(cells[k : k + IN_A_LINE]) for k in range(0, len(cells), IN_A_LINE)),
            ":END",
        ]
        return {f"{stem}.cal": "\n".join(lines) + "\n"}

    def read(self, files: Mapping[str, str]) -> UnrolledTable:
        """Read the block back; BagError unless it is whole, and covers the travel."""
        name, text = only_file(files, ".cal")
        body = re.sub(r"^;.*\n", "", text, flags=re.MULTILINE)
        match = BLOCK.fullmatch(body)
        if match is None or integer(match[1], name) != self.axis_number:
            raise BagError(
                f"{name}: expected one block :START {self.axis_number} SAMPLEDIST=... "
                "POSUNIT=PRIMARY CORUNIT=PRIMARY/3600, values, :END"
            )
        values = np.array(
            [parse_number(cell, name) for cell in match[3].split()], dtype=np.float64
        )
        even = (0.0, parse_number(match[2], f"{name}, SAMPLEDIST"))
        return UnrolledTable.evenly(name, even, (values, values), self.travel, ARCSEC)
