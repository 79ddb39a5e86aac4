"""Heidenhain, newer form: a .COM table of axis errors, assigned to the axis by a .CMA table.

Columns AXISPOS, BACKLASH (values for the negative direction) and one column named after the
axis. Sources: Technical Manual MANUALplus 620 pp. 716-718; TNC 407/415/425 Technical Manual
pp. 4-26 .. 4-31 (256 entries, a rotary axis uses the entries 0 .. 360).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from rotcal_ros.arrays import Floats
from rotcal_ros.compensation.controller import (
    Controller,
    columns_deg,
    fixed,
    only_file,
    parse_rows,
    periodic,
    require_at_most,
    require_circle,
)
from rotcal_ros.compensation.table import CompensationTable
from rotcal_ros.errors import BagError, ConfigurationError
from rotcal_ros.observations import Approach
from rotcal_ros.units import DEGREE

MAX_ROWS: Final = 256
DECIMALS: Final = 5


@dataclass(frozen=True)
class HeidenhainSettings:
    """``backlash``: what the column BACKLASH holds, "absolute" errors or the "difference"."""

    backlash: str = "absolute"

    def __post_init__(self) -> None:
        if self.backlash not in ("absolute", "difference"):
            raise ConfigurationError(
                f"heidenhain: backlash {self.backlash!r}, expected absolute or difference"
            )


@dataclass(frozen=True, eq=False)
class ComTable:
    """Errors (n,) in degrees, actual - commanded, at rows 0 .. 360 deg."""

    rows_deg: Floats
    forward_deg: Floats
    reverse_deg: Floats


def write(table: CompensationTable, settings: HeidenhainSettings, stem: str) -> dict[str, str]:
    """Return the .COM table and its .CMA table; ConfigurationError above 256 rows."""
    require_circle(table, "Heidenhain")
    angles, up, down = columns_deg(table)
    require_at_most(len(angles), MAX_ROWS, "heidenhain: rows", "choose a wider spacing")
    reverse = -down if settings.backlash == "absolute" else up - down
    name = f"{stem}.COM"
    lines = [f"BEGIN {name}", f"NR AXISPOS BACKLASH {table.axis}"]
    for k, row in enumerate(zip(angles, reverse, -up, strict=True)):
        lines.append(" ".join([str(k), *(fixed(value, DECIMALS) for value in row)]))
    assignment = [f"BEGIN {stem}.CMA", f"NR ACTIVE {table.axis}", f"0 * {stem}", "[END]"]
    return {
        name: "\n".join([*lines, "[END]"]) + "\n",
        f"{stem}.CMA": "\n".join(assignment) + "\n",
    }


def read(files: Mapping[str, str], settings: HeidenhainSettings) -> ComTable:
    """Read the .COM table back; BagError unless it is complete and closes."""
    name, text = only_file(files, ".COM")
    _, assignment = only_file(files, ".CMA")
    lines = text.splitlines()
    if len(lines) < 4 or not lines[0].startswith("BEGIN ") or lines[-1] != "[END]":
        raise BagError(f"{name}: expected BEGIN in the first line and [END] in the last")
    if name.rsplit(".", 1)[0] not in assignment:
        raise BagError(f"the .CMA table does not name {name}")
    data = parse_rows(name, lines[2:-1], 4, None)[:, 1:]
    if data[0, 0] != 0.0 or data[-1, 0] != 360.0 or np.any(data[0, 1:] != data[-1, 1:]):
        raise BagError(f"{name}: expected rows from 0 to 360 deg, the first equal to the last")
    down = data[:, 1] + (0.0 if settings.backlash == "absolute" else data[:, 2])
    return ComTable(rows_deg=data[:, 0], forward_deg=data[:, 2], reverse_deg=down)


def correction(table: ComTable, angle: Floats, approach: Approach) -> Floats:
    """Return what the control adds to the command (rad): minus the error, linear."""
    column = table.forward_deg if approach is Approach.POSITIVE else table.reverse_deg
    return -periodic(np.asarray(angle) / DEGREE, table.rows_deg, column) * DEGREE


CONTROLLER: Final = Controller(
    name="heidenhain",
    title="Heidenhain (.COM/.CMA)",
    settings=HeidenhainSettings,
    write=write,
    read=read,
    correction=correction,
    resolution=lambda table, settings: 2.0 * 10.0**-DECIMALS * DEGREE,
    position_resolution=10.0**-DECIMALS * DEGREE,
    one_direction=lambda settings: False,
    unverified=lambda settings: (
        "the sign of the axis column: read off a diagram named 'error', not stated in words",
        "whether BACKLASH holds the error itself or the difference to the other direction",
        "the text form of the files (BEGIN, NR, [END])",
        "how the table continues beyond 360 deg",
    ),
    sign="value = actual - commanded (inferred)",
    wrap="rows 0 .. 360, the last equal to the first",
    unit="degrees, 5 decimals",
    source="Technical Manual MANUALplus 620 pp. 716-718; TNC 407/415/425 pp. 4-26 .. 4-31",
)
