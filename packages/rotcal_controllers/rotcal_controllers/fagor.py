"""Fagor 8055: leadscrew error table, position and the error in each direction.

Linear between points. On a rotary axis the points 0 and 360 carry the same error, and then
the table holds in every turn. When all errors of the negative direction are zero, the
control takes those of the positive direction for both. Source: ``Fagor.facts``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from rotcal_ros.compensation.controller import Controller, Facts, OwnSetting
from rotcal_ros.compensation.controller_files import (
    PeriodicTable,
    columns_deg,
    fixed,
    match_lines,
    only_file,
    parse_number,
    require_at_most,
    require_circle,
)
from rotcal_ros.compensation.table import CompensationTable
from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.settings import setting
from rotcal_ros.foundation.units import DEGREE

MAX_ROWS: Final = 1000
DECIMALS: Final = 4


@dataclass(frozen=True)
class Fagor(Controller):
    """Fagor 8055; ``resolution`` and positions have four decimals of a degree."""

    suffixes = (".txt",)
    facts = Facts(
        title="Fagor 8055",
        sign="value = the amount of error, actual - commanded",
        wrap="points 0 and 360 with the same error: the table holds in every turn",
        unit="degrees, 4 decimals (0.36 arcsec)",
        source="CNC 8055 Installation Manual V02.2x, section 7.5.7, p. 328",
    )
    position_resolution = 10.0**-DECIMALS * DEGREE
    value_resolution = position_resolution
    switch_on = "LSCRWCOM (P15) = ON and NPOINTS (P16) of the axis"
    own_settings = (
        OwnSetting(
            "BACKLASH (P14)",
            "acts at every reversal; the manual does not say that a table ends this",
            "leave it as it was during the measurement: nothing of it is in the table",
            "CNC 8055 Installation Manual V02.2x, section 7.5.6, p. 327",
        ),
    )
    unverified = (
        "the text form of the file: the manual shows the table on the screen only",
        "that 'amount of error' is actual - commanded",
    )

    max_points: int = setting(
        MAX_ROWS, doc="NPOINTS (P16) of the axis", minimum=2, maximum=MAX_ROWS
    )

    def write(self, table: CompensationTable, stem: str) -> dict[str, str]:
        """Return the table; ConfigurationError for too many points or a hidden reverse column."""
        require_circle(table, "Fagor 8055")
        angles, up, down = columns_deg(table)
        require_at_most(len(angles), self.max_points, "fagor: points", "choose a wider spacing")
        errors = np.round(-np.column_stack([up, down]), DECIMALS)
        if not np.any(errors[:, 1]) and np.any(errors[:, 0]):
            raise ConfigurationError(
                "fagor: every error of the negative direction rounds to zero, and the control "
                "would then use the positive column for both: shift the reference angle, or "
                "export the mean"
            )
        axis = table.axis
        lines = [
            f"P{k:03d} {axis} {fixed(angle, DECIMALS)} "
            f"E{axis} {fixed(forward, DECIMALS)} E{axis} {fixed(reverse, DECIMALS)}"
            for k, (angle, forward, reverse) in enumerate(np.column_stack([angles, errors]), 1)
        ]
        return {f"{stem}.txt": "\n".join(lines) + "\n"}

    def read(self, files: Mapping[str, str]) -> PeriodicTable:
        """Read the table back; BagError unless it goes from 0 to 360 deg and closes."""
        name, text = only_file(files, ".txt")
        line = r"P\d+ (\w+) (\S+) E\1 (\S+) E\1 (\S+)"
        rows = [
            [parse_number(match.group(k), where) for k in (2, 3, 4)]
            for where, match in match_lines(name, text, line, "P001 C 0 EC 0 EC 0")
        ]
        angles, up, down = np.array(rows, dtype=np.float64).reshape(-1, 3).T
        return PeriodicTable(name, angles, up, down if np.any(down) else up, -DEGREE)
