"""Smoothieware with the module PitchCompensation: points ``letter position multiplier``.

The motor goes to C(x), the integral of the multiplier from 0 to the commanded x; the multiplier is
linear between the points, and constant beyond the ends. So the correction C(x) - x is a straight
line where the multiplier stays the same: here between two rows, and it changes within a hundredth
of a degree around each. Positions and multipliers are in single precision. Only X, Y and Z have
points, the same in both directions, for every turn of the travel. Source: ``Smoothieware.facts``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from rotcal_ros.compensation.controller import EveryTurnController, Facts
from rotcal_ros.compensation.controller_files import (
    columns_deg,
    fixed,
    match_lines,
    mean_deg,
    only_file,
    parse_number,
    repeat_for_turns,
    require_circle,
    require_zero_at_start,
)
from rotcal_ros.compensation.table import CompensationTable
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.errors import BagError, ConfigurationError
from rotcal_ros.foundation.observations import Approach
from rotcal_ros.foundation.settings import setting
from rotcal_ros.foundation.units import ARCSEC, DEGREE

BEND_DEG: Final = 0.01
"""Half the stretch around a row in which the multiplier changes."""
PLACES: Final = 6
SMALLEST, LARGEST = 0.5, 1.5
"""The control skips multipliers beyond these."""
ROUNDINGS: Final = 4.0
"""Number of roundings by half a step, within one interval, in the control's sum."""
Singles = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class PitchPoints:
    """Positions (n,) in degrees, multipliers, and the integrals that the control makes of them."""

    positions: Singles
    multipliers: Singles
    integrals: Floats

    def correction(self, angle: Floats, approach: Approach) -> Floats:
        """Return the radians that are added to the command at ``angle`` (rad, not wrapped)."""
        at = np.asarray(angle, dtype=np.float64) / DEGREE
        moved = self.integral(at.astype(np.float32)) - self.integral(np.zeros(1, dtype=np.float32))
        return np.asarray((moved.astype(np.float32) - at) * DEGREE, dtype=np.float64)

    def integral(self, at: Singles) -> Floats:
        """Return the integral of the multiplier from the first point to ``at``, degrees."""
        position, multiplier = self.positions, self.multipliers
        row = np.clip(np.searchsorted(position, at, side="right") - 1, 0, len(position) - 1)
        beyond = at - position[row]
        after = np.minimum(row + 1, len(position) - 1)
        width = np.where(after > row, position[after] - position[row], np.float32(1.0))
        rise = np.where(beyond > 0.0, (multiplier[after] - multiplier[row]) / width, 0.0)
        line = (multiplier[row] * beyond).astype(np.float64)
        bend = 0.5 * rise.astype(np.float64) * beyond.astype(np.float64) ** 2
        return np.asarray(self.integrals[row] + line + bend, dtype=np.float64)


@dataclass(frozen=True)
class Smoothieware(EveryTurnController):
    """Smoothieware of the Carvera, for a table that is driven as X, Y or Z."""

    suffixes = (".dat",)
    facts = Facts(
        title="Smoothieware PitchCompensation",
        sign="multiplier = 1 + slope of -(actual - commanded); the motor goes to its integral",
        wrap="none: rows repeated for each turn",
        unit="single precision, about 0.1 arcsec up to 512 deg",
        source="Carvera_Community_Firmware, proposal 221 (02/2026): PitchCompensation.cpp, "
        "Robot.cpp",
        verified_on="the source of the firmware",
    )
    switch_on = "copy the points to /sd/pitch_compensation.dat, then M381.3"
    one_direction = True
    unverified = (
        "that the firmware of the machine has the module: proposal 221 of January 2026, which "
        "adds it, was closed without being merged, and the released firmware does not have it",
    )

    letter: str = setting(
        "X", doc="axis of the control that drives the table", choices=("X", "Y", "Z")
    )

    def write(self, table: CompensationTable, stem: str) -> dict[str, str]:
        """Return the points; ConfigurationError unless the table is zero at 0 and holds 0."""
        require_circle(table, "Smoothieware")
        require_zero_at_start(table, "Smoothieware", self.resolution(table))
        if not self.first_turn <= 0 <= self.first_turn + self.turns:
            raise ConfigurationError(
                f"smoothieware: the turns {self.first_turn} .. {self.first_turn + self.turns} "
                "leave out 0 deg, from where the control counts: choose first_turn and turns so "
                "that it is included"
            )
        angles, added = repeat_for_turns(
            self.first_turn, self.turns, columns_deg(table)[0], mean_deg(table)
        )
        lines = [
            f"{self.letter} {fixed(position, PLACES)} {multiplier:.9g}"
            for position, multiplier in _points(angles, added)
        ]
        return {f"{stem}.dat": "\n".join(lines) + "\n"}

    def read(self, files: Mapping[str, str]) -> PitchPoints:
        """Read the points of the axis back; BagError for one that the control would skip."""
        name, text = only_file(files, ".dat")
        cells = []
        for where, match in match_lines(name, text, r"([XYZ]) (\S+) (\S+)", "X 10.5 1.00034"):
            values = [parse_number(match[k], where) for k in (2, 3)]
            if not SMALLEST <= values[1] <= LARGEST:
                raise BagError(
                    f"{where}: the multiplier {match[3]} is not in {SMALLEST} .. {LARGEST}, the "
                    "control would skip the point"
                )
            if match[1] == self.letter:
                cells.append(values)
        data = np.array(cells, dtype=np.float64).reshape(-1, 2).astype(np.float32)
        position, multiplier = data.T
        if len(data) < 2 or not np.all(np.isfinite(data)) or np.any(np.diff(position) <= 0.0):
            raise BagError(
                f"{name}: {len(data)} points of {self.letter}, expected at least 2 that ascend"
            )
        return PitchPoints(position, multiplier, _integrals(position, multiplier))

    def resolution(self, table: CompensationTable) -> float:
        """Return twice the error left by bends and single precision, in rad."""
        angles, added = columns_deg(table)[0], mean_deg(table)
        slopes = np.diff(added) / np.diff(angles)
        bend = np.max(np.abs(np.diff(np.append(slopes, slopes[0])))) * BEND_DEG / 4.0
        widest = np.spacing(np.float32(np.max(np.diff(angles))))
        target = np.spacing(np.float32(np.max(np.abs(self.travel)) / DEGREE))
        return float(2.0 * (2.0 * bend + ROUNDINGS * widest + target) * DEGREE)


def _points(angles: Floats, added: Floats) -> list[tuple[float, float]]:
    """Return positions and multipliers that take the motor to ``angles`` + ``added``, degrees.

    Each multiplier compensates for what the earlier ones left, in the control's own arithmetic.
    """
    points: list[tuple[float, float]] = []
    total = 0.0
    for k in range(len(angles) - 1):
        ends = (angles[k] + BEND_DEG * (k > 0), angles[k + 1] - BEND_DEG * (k + 2 < len(angles)))
        low, high = (np.float32(fixed(end, PLACES)) for end in ends)
        position, before = points[-1] if points else (low, np.float32(0.0))
        bend, line = low - np.float32(position), high - low
        goal = float(high) - angles[0] + np.interp(high, angles, added) - added[0]
        multiplier = (goal - total - float(bend) * before / 2.0) / (
            float(bend) / 2.0 + float(line)
        )
        if not SMALLEST <= multiplier <= LARGEST:
            slope = (multiplier - 1.0) * DEGREE / ARCSEC
            raise ConfigurationError(
                f"smoothieware: from {low:g} to {high:g} deg the correction changes by "
                f"{slope:.4g} arcsec per degree, and a multiplier is {SMALLEST} .. {LARGEST}: "
                "choose a wider spacing"
            )
        rounded = np.float32(multiplier)
        total += float(_trapezium(bend, np.float32(before), rounded))
        total += float(_trapezium(line, rounded, rounded))
        points += [(float(low), float(rounded)), (float(high), float(rounded))]
    return points


def _integrals(position: Singles, multiplier: Singles) -> Floats:
    """Return the integral of the multiplier from the first point to each, degrees."""
    parts = _trapezium(np.diff(position), multiplier[:-1], multiplier[1:])
    return np.concatenate([[0.0], np.cumsum(parts)])


def _trapezium(width: Singles, before: Singles, after: Singles) -> Floats:
    """Return the area as the control computes it: the product in single precision."""
    return np.asarray((width * (before + after)).astype(np.float64) / 2.0, dtype=np.float64)
