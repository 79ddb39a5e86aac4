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

from rotcal_ros.arrays import Floats, Ints
from rotcal_ros.compensation.controller import (
    Controller,
    columns_deg,
    even_interval_deg,
    integer,
    only_file,
    periodic,
    require_zero_at_start,
)
from rotcal_ros.compensation.table import CompensationTable
from rotcal_ros.errors import BagError, ConfigurationError
from rotcal_ros.observations import Approach
from rotcal_ros.units import DEGREE

FRACTION: Final = 16


@dataclass(frozen=True)
class PmacSettings:
    """``motor`` number and ``counts_per_turn`` of its position."""

    motor: int = 1
    counts_per_turn: int = 360_000

    def __post_init__(self) -> None:
        if not 1 <= self.motor <= 32 or self.counts_per_turn < 360:
            raise ConfigurationError(
                f"pmac: motor {self.motor} (1 .. 32), counts_per_turn {self.counts_per_turn} (at "
                "least 360): out of range"
            )


@dataclass(frozen=True, eq=False)
class PmacTables:
    """Correction and backlash (N + 1,) in 1/16 count at even rows 0 .. 360 deg."""

    rows_deg: Floats
    comp: Ints
    backlash: Ints
    unit_deg: float


def write(table: CompensationTable, settings: PmacSettings, stem: str) -> dict[str, str]:
    """Return the on-line commands; ConfigurationError unless zero stays zero."""
    spacing = even_interval_deg(table, "PMAC", 360.0 / settings.counts_per_turn)
    unit_deg = _unit_deg(settings)
    require_zero_at_start(table, "PMAC", unit_deg * DEGREE)
    n = round(360.0 / spacing)
    _, up, down = (np.rint(column / unit_deg).astype(np.int64) for column in columns_deg(table))
    up = up - up[0]
    backlash = up - down
    turn, motor = settings.counts_per_turn, settings.motor
    lines = [f"#{motor} DEFINE COMP {n},{turn}", " ".join(map(str, up[1:]))]
    if table.directional:
        lines += [f"#{motor} DEFINE BLCOMP {n},{turn}"]
        lines += [" ".join(map(str, backlash[1:] - backlash[0])), f"I{motor}86={backlash[0]}"]
    return {f"{stem}.pmc": "\n".join([*lines, "I51=1"]) + "\n"}


def read(files: Mapping[str, str], settings: PmacSettings) -> PmacTables:
    """Read the commands back; BagError unless both tables are complete and end with zero."""
    name, text = only_file(files, ".pmc")
    comp = _entries(name, text, "COMP", settings)
    if comp is None:
        raise BagError(f"{name}: no DEFINE COMP for motor {settings.motor}")
    varying = _entries(name, text, "BLCOMP", settings)
    constant = re.search(rf"^I{settings.motor}86=(-?\d+)$", text, re.MULTILINE)
    backlash = np.zeros_like(comp) if varying is None else varying
    if constant is not None:
        backlash = backlash + integer(constant.group(1), f"{name}, I{settings.motor}86")
    if len(backlash) != len(comp):
        raise BagError(f"{name}: {len(comp) - 1} entries in COMP, {len(backlash) - 1} in BLCOMP")
    rows = np.linspace(0.0, 360.0, len(comp))
    return PmacTables(rows, comp, backlash, _unit_deg(settings))


def correction(tables: PmacTables, angle: Floats, approach: Approach) -> Floats:
    """Return what is added to the motor (rad): linear, rolled over, less backlash in reverse."""
    value = tables.comp if approach is Approach.POSITIVE else tables.comp - tables.backlash
    counts = periodic(np.asarray(angle) / DEGREE, tables.rows_deg, value.astype(np.float64))
    return np.asarray(counts * (tables.unit_deg * DEGREE), dtype=np.float64)


def _entries(name: str, text: str, kind: str, settings: PmacSettings) -> Ints | None:
    """Return 0 and the entries of one table, or None when it is not there."""
    head = rf"^#{settings.motor} DEFINE {kind} (\d+),(\d+)\n([^\n]*)$"
    match = re.search(head, text, re.MULTILINE)
    if match is None:
        return None
    values = [integer(cell, f"{name}, {kind}") for cell in match.group(3).split()]
    found = (len(values), int(match.group(2)), values[-1] if values else None)
    expected = (int(match.group(1)), settings.counts_per_turn, 0)
    if found != expected:
        raise BagError(
            f"{name}, {kind}: entries, counts per turn and last entry are {found}, "
            f"expected {expected}"
        )
    return np.array([0, *values], dtype=np.int64)


def _unit_deg(settings: PmacSettings) -> float:
    return 360.0 / settings.counts_per_turn / FRACTION


CONTROLLER: Final = Controller(
    name="pmac",
    title="Delta Tau PMAC",
    settings=PmacSettings,
    write=write,
    read=read,
    correction=correction,
    resolution=lambda table, settings: 2.0 * _unit_deg(settings) * DEGREE,
    position_resolution=0.0,
    one_direction=lambda settings: False,
    unverified=lambda settings: (
        "that the correction is added to the command, not to the measured position",
        "that the constant part of the reversal belongs into Ixx86, in 1/16 count",
    ),
    sign="entry = -(actual - commanded), added to the motor",
    wrap="automatic roll-over; entry N = entry at 0 = 0",
    unit="whole numbers of 1/16 count",
    source="PMAC User's Manual pp. 79-80; Software Reference pp. 207-211",
)
