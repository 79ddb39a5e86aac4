"""LinuxCNC: ``[JOINT_n] COMP_FILE``, read by usrmotLoadComp, applied by the motion controller.

Lines ``nominal forward reverse`` in degrees. Type 0 holds the measured actual angle, type 1 the
trim that is added to the motor command. The real program stops in silence at the first line
that is not three numbers, takes 256 rows, and does not know that an axis is round: the rows
are repeated for every turn of the travel. Source: LinuxCNC 2.9, src/emc/motion (usrmotintf.cc,
command.c, control.c) and docs/src/config/ini-config.adoc.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from rotcal_ros.arrays import Floats
from rotcal_ros.compensation.controller import (
    Controller,
    columns_deg,
    fixed,
    only_file,
    require_at_most,
)
from rotcal_ros.compensation.table import CompensationTable
from rotcal_ros.curves.interpolation import TURN
from rotcal_ros.errors import BagError, ConfigurationError
from rotcal_ros.observations import Approach
from rotcal_ros.units import DEGREE

MAX_ROWS: Final = 256
DECIMALS: Final = 9


@dataclass(frozen=True)
class LinuxCncSettings:
    """``file_type`` 0 (actual angles) or 1 (trims), and the turns that the travel covers.

    The table is written for ``turns`` turns, the first of which starts at 360 * ``first_turn``
    degrees. ``joint`` is the number in ``[JOINT_n]``.
    """

    file_type: int = 1
    joint: int = 0
    first_turn: int = 0
    turns: int = 1

    def __post_init__(self) -> None:
        if self.file_type not in (0, 1) or self.turns < 1 or not 0 <= self.joint < 16:
            raise ConfigurationError(
                f"linuxcnc: file_type {self.file_type} (0 or 1), turns {self.turns} (at least 1), "
                f"joint {self.joint} (0 .. 15): out of range"
            )


@dataclass(frozen=True, eq=False)
class LoadedComp:
    """What LinuxCNC holds after loading: degrees, trims in single precision, and its messages."""

    nominal_deg: Floats
    forward_deg: NDArray[np.float32]
    reverse_deg: NDArray[np.float32]
    messages: tuple[str, ...]


def write(table: CompensationTable, settings: LinuxCncSettings, stem: str) -> dict[str, str]:
    """Return the table and the two ini lines that must go with it.

    Raises ConfigurationError when the rows of all turns are more than LinuxCNC holds.
    """
    angles, up, down = (np.round(column, DECIMALS) for column in columns_deg(table))
    if table.closed:
        rows = len(angles) - 1
        total = rows * settings.turns + 1
        fit = (MAX_ROWS - 1) // rows if rows < MAX_ROWS else 0
        require_at_most(
            total,
            MAX_ROWS,
            f"linuxcnc: {rows} rows x {settings.turns} turns + 1",
            f"a spacing of at least {360 * settings.turns / (MAX_ROWS - 1):.3g} deg"
            + (f", or at most {fit} turns at this spacing" if fit else ""),
        )
        turn = np.repeat(np.arange(settings.turns) + settings.first_turn, rows)
        angles = np.append(
            np.tile(angles[:-1], settings.turns) + 360.0 * turn,
            360.0 * (settings.first_turn + settings.turns),
        )
        up = np.append(np.tile(up[:-1], settings.turns), up[-1])
        down = np.append(np.tile(down[:-1], settings.turns), down[-1])
    elif settings.turns != 1 or settings.first_turn != 0:
        raise ConfigurationError("linuxcnc: an arc cannot be repeated, set turns 1, first_turn 0")
    require_at_most(len(angles), MAX_ROWS, "linuxcnc: rows", "choose a wider spacing")
    if settings.file_type == 0:
        up, down = angles - up, angles - down
    lines = [
        " ".join(fixed(x, DECIMALS) for x in row) for row in zip(angles, up, down, strict=True)
    ]
    ini = [
        f"[JOINT_{settings.joint}]",
        f"COMP_FILE = {stem}.comp",
        f"COMP_FILE_TYPE = {settings.file_type}",
    ]
    return {f"{stem}.comp": "\n".join(lines) + "\n", f"{stem}.ini": "\n".join(ini) + "\n"}


def read(files: Mapping[str, str], settings: LinuxCncSettings) -> LoadedComp:
    """Read a table and its ini lines; BagError for all that LinuxCNC would swallow in silence."""
    _, ini = only_file(files, ".ini")
    name, text = only_file(files, ".comp")
    kind = re.search(r"^\s*COMP_FILE_TYPE\s*=\s*([01])\s*$", ini, re.MULTILINE)
    if kind is None:
        raise BagError(
            "the ini lines hold no COMP_FILE_TYPE = 0 or 1: LinuxCNC would take the default 0 and "
            "read trims as positions"
        )
    loaded = load(text, int(kind.group(1)))
    lines = text.count("\n") + (not text.endswith("\n"))
    if loaded.messages or len(loaded.nominal_deg) != lines or lines == 0:
        raise BagError(
            f"{name}: {lines} lines, of which LinuxCNC uses {len(loaded.nominal_deg)}; expected "
            f"all; {'; '.join(loaded.messages) or 'a line is not three numbers'}"
        )
    numbers = (loaded.nominal_deg, loaded.forward_deg, loaded.reverse_deg)
    if not all(np.all(np.isfinite(column)) for column in numbers):
        raise BagError(f"{name}: a number is too large")
    return loaded


def load(text: str, file_type: int) -> LoadedComp:
    """Load a table as LinuxCNC does, silent stops and skipped rows included."""
    rows: list[tuple[float, float, float]] = []
    messages: list[str] = []
    for line in text.split("\n"):
        values = _three_numbers(line[:254])
        if values is None:
            break
        nominal, up, down = values
        if file_type == 0:
            up, down = nominal - up, nominal - down
        if len(rows) >= MAX_ROWS:
            messages.append("too many compensation entries")
        elif rows and nominal <= rows[-1][0]:
            messages.append("compensation values must increase")
        else:
            rows.append((nominal, up, down))
    data = np.array(rows, dtype=np.float64).reshape(-1, 3)
    return LoadedComp(
        nominal_deg=data[:, 0],
        forward_deg=data[:, 1].astype(np.float32),
        reverse_deg=data[:, 2].astype(np.float32),
        messages=tuple(messages),
    )


def correction(loaded: LoadedComp, angle: Floats, approach: Approach) -> Floats:
    """Return the trim (rad) at the joint position ``angle`` (rad, not wrapped).

    Linear, with slopes in single precision; before the first and after the last row the trim
    of that row is held.
    """
    trims = loaded.forward_deg if approach is Approach.POSITIVE else loaded.reverse_deg
    at = np.asarray(angle, dtype=np.float64) / DEGREE
    if len(trims) == 0:
        return np.zeros_like(at)
    rise = np.diff(trims.astype(np.float64)) / np.diff(loaded.nominal_deg)
    slopes = np.append(rise.astype(np.float32), np.float32(0.0)).astype(np.float64)
    row = np.clip(np.searchsorted(loaded.nominal_deg, at, side="right") - 1, 0, None)
    beyond = np.maximum(at - loaded.nominal_deg[row], 0.0)
    return np.asarray((trims[row] + slopes[row] * beyond) * DEGREE, dtype=np.float64)


def _three_numbers(line: str) -> tuple[float, float, float] | None:
    """Return what ``sscanf("%lf %lf %lf")`` finds: three leading numbers, blanks between."""
    number = r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)"
    match = re.match(number + r"(?=\s)" + number + r"(?=\s)" + number, line)
    if match is None:
        return None
    return float(match.group(1)), float(match.group(2)), float(match.group(3))


def _resolution(table: CompensationTable, settings: LinuxCncSettings) -> float:
    """Return twice the rounding: nine decimals, and single precision of trim and slope."""
    largest = max(
        np.max(np.abs(table.correction_forward)), np.max(np.abs(table.correction_reverse))
    )
    return float(2.0 * 10.0**-DECIMALS * DEGREE + 8.0 * np.finfo(np.float32).eps * largest)


def _travel(settings: LinuxCncSettings) -> tuple[float, float]:
    return settings.first_turn * TURN, (settings.first_turn + settings.turns) * TURN


CONTROLLER: Final = Controller(
    name="linuxcnc",
    title="LinuxCNC",
    settings=LinuxCncSettings,
    write=write,
    read=read,
    correction=correction,
    resolution=_resolution,
    position_resolution=10.0**-DECIMALS * DEGREE,
    one_direction=lambda settings: False,
    unverified=lambda settings: (),
    sign="type 1: trim = -(actual - commanded), added to the motor; type 0: the actual angle",
    wrap="none: rows repeated for each turn, beyond them the end row is held",
    unit="degrees, 9 decimals; held in single precision",
    source="LinuxCNC 2.9 source (usrmotintf.cc, command.c, control.c) and runs of the program",
    travel=_travel,
)
