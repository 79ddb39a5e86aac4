"""Fagor 8055: leadscrew error table, position and the error in each direction.

Linear between points. On a rotary axis the points 0 and 360 carry the same error, and then
the table holds in every turn. When all errors of the negative direction are zero, the
control takes those of the positive direction for both. Source: CNC 8055 Installation Manual
(V02.2x), section 7.5.7, p. 328.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from rotcal_ros.arrays import Floats
from rotcal_ros.compensation.controller import (
    Controller,
    columns_deg,
    fixed,
    number,
    only_file,
    periodic,
    require_at_most,
    require_circle,
)
from rotcal_ros.compensation.table import CompensationTable
from rotcal_ros.errors import BagError, ConfigurationError
from rotcal_ros.observations import Approach
from rotcal_ros.units import DEGREE

MAX_ROWS: Final = 1000
DECIMALS: Final = 4


@dataclass(frozen=True)
class FagorSettings:
    """``max_points``: NPOINTS (P16) of the axis, at most 1000."""

    max_points: int = MAX_ROWS

    def __post_init__(self) -> None:
        if not 2 <= self.max_points <= MAX_ROWS:
            raise ConfigurationError(
                f"fagor: max_points {self.max_points}, expected 2 .. {MAX_ROWS}"
            )


@dataclass(frozen=True, eq=False)
class LeadscrewTable:
    """Errors (n,) in degrees, actual - commanded, at rows 0 .. 360 deg."""

    rows_deg: Floats
    forward_deg: Floats
    reverse_deg: Floats


def write(table: CompensationTable, settings: FagorSettings, stem: str) -> dict[str, str]:
    """Return the table; ConfigurationError for too many points or a hidden reverse column."""
    require_circle(table, "Fagor 8055")
    angles, up, down = columns_deg(table)
    require_at_most(len(angles), settings.max_points, "fagor: points", "choose a wider spacing")
    errors = np.round(-np.column_stack([up, down]), DECIMALS)
    if not np.any(errors[:, 1]) and np.any(errors[:, 0]):
        raise ConfigurationError(
            "fagor: every error of the negative direction rounds to zero, and the control would "
            "then use the positive column for both: shift the reference angle, or export the mean"
        )
    axis = table.axis
    lines = [
        f"P{k:03d} {axis} {fixed(angle, DECIMALS)} "
        f"E{axis} {fixed(up_error, DECIMALS)} E{axis} {fixed(down_error, DECIMALS)}"
        for k, (angle, (up_error, down_error)) in enumerate(zip(angles, errors, strict=True), 1)
    ]
    return {f"{stem}.txt": "\n".join(lines) + "\n"}


def read(files: Mapping[str, str], settings: FagorSettings) -> LeadscrewTable:
    """Read the table back; BagError unless it goes from 0 to 360 deg and closes."""
    name, text = only_file(files, ".txt")
    rows = []
    for row, line in enumerate(text.splitlines(), start=1):
        match = re.fullmatch(r"P\d+ (\w+) (\S+) E\1 (\S+) E\1 (\S+)", line.strip())
        if match is None:
            raise BagError(f"{name}, line {row}: {line!r} is no line such as P001 C 0 EC 0 EC 0")
        rows.append([number(match.group(k), f"{name}, line {row}") for k in (2, 3, 4)])
    data = np.array(rows, dtype=np.float64).reshape(-1, 3)
    if len(data) < 2 or np.any(np.diff(data[:, 0]) <= 0.0):
        raise BagError(f"{name}: expected at least two points with ascending positions")
    if data[0, 0] != 0.0 or data[-1, 0] != 360.0 or np.any(data[0, 1:] != data[-1, 1:]):
        raise BagError(f"{name}: expected points from 0 to 360 deg, the first equal to the last")
    return LeadscrewTable(
        rows_deg=data[:, 0],
        forward_deg=data[:, 1],
        reverse_deg=data[:, 2] if np.any(data[:, 2]) else data[:, 1],
    )


def correction(table: LeadscrewTable, angle: Floats, approach: Approach) -> Floats:
    """Return what the control adds to the command (rad): minus the error, linear, every turn."""
    column = table.forward_deg if approach is Approach.POSITIVE else table.reverse_deg
    return -periodic(np.asarray(angle) / DEGREE, table.rows_deg, column) * DEGREE


CONTROLLER: Final = Controller(
    name="fagor",
    title="Fagor 8055",
    settings=FagorSettings,
    write=write,
    read=read,
    correction=correction,
    resolution=lambda table, settings: 10.0**-DECIMALS * DEGREE,
    position_resolution=10.0**-DECIMALS * DEGREE,
    one_direction=lambda settings: False,
    unverified=lambda settings: (
        "the text form of the file: the manual shows the table on the screen only",
        "that 'amount of error' is actual - commanded",
    ),
    sign="value = the amount of error, actual - commanded",
    wrap="points 0 and 360 with the same error: the table holds in every turn",
    unit="degrees, 4 decimals (0.36 arcsec)",
    source="CNC 8055 Installation Manual V02.2x, section 7.5.7, p. 328",
)
