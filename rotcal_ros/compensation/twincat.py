"""Beckhoff TwinCAT CNC and ISG kernel: leadscrew compensation ``kw.ssfk.*`` in achskw*.lis.

Whole numbers of 0.0001 degrees, actual - commanded, one column for each direction, linear,
modulo. Sources: Beckhoff Information System TF5200, axis compensation parameters
P-COMP-00017 .. 00025 and 00059; ISG kernel documentation.
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
    require_at_most,
)
from rotcal_ros.compensation.table import CompensationTable
from rotcal_ros.errors import BagError
from rotcal_ros.observations import Approach
from rotcal_ros.units import DEGREE

UNIT_DEG: Final = 1e-4
TURN_UNITS: Final = 3_600_000


@dataclass(frozen=True)
class TwinCatSettings:
    """``max_points``: P-COMP-00059 of the machine, 1500 unless it was changed."""

    max_points: int = 1500


@dataclass(frozen=True, eq=False)
class SsfkTable:
    """Deviations (N + 1,) in 0.0001 deg at even rows 0 .. 360 deg."""

    rows_deg: Floats
    pos: Ints
    neg: Ints


def write(table: CompensationTable, settings: TwinCatSettings, stem: str) -> dict[str, str]:
    """Return the compensation list; raises ConfigurationError above ``max_points``."""
    spacing = even_interval_deg(table, "TwinCAT CNC", UNIT_DEG)
    n = len(table.angles)
    require_at_most(
        n, settings.max_points, "twincat: points", "a wider spacing, or raise P-COMP-00059"
    )
    _, up, down = columns_deg(table)
    pos = np.rint(-up[:-1] / UNIT_DEG).astype(np.int64)
    neg = np.rint(-down[:-1] / UNIT_DEG).astype(np.int64)
    bilateral = int(table.directional)
    head = {
        "unit": 1,
        "interval": round(spacing / UNIT_DEG),
        "kw_startpos": 0,
        "kw_nr_max": n,
        "bilateral": bilateral,
        "modulo": 1,
    }
    lines = [f"kw.ssfk.{key} {value}" for key, value in head.items()]
    for k in range(n):
        lines.append(f"kw.ssfk.table[{k}].pos {pos[k]}")
        if bilateral:
            lines.append(f"kw.ssfk.table[{k}].neg {neg[k]}")
    return {f"{stem}.lis": "\n".join(lines) + "\n"}


def read(files: Mapping[str, str], settings: TwinCatSettings) -> SsfkTable:
    """Read a compensation list; BagError unless it is one turn in units of 0.0001 deg."""
    name, text = only_file(files, ".lis")
    said: dict[str, int] = {}
    for row, line in enumerate(text.splitlines(), start=1):
        match = re.fullmatch(r"kw\.ssfk\.([\w\[\].]+)\s+(\S+)", line.strip())
        if match is None:
            raise BagError(f"{name}, line {row}: {line!r} is no line such as kw.ssfk.unit 1")
        said[match.group(1)] = integer(match.group(2), f"{name}, line {row}")
    n = said.get("kw_nr_max", 0)
    turn = said.get("interval", 0) * n
    if n < 2 or (said.get("unit"), said.get("modulo"), turn) != (1, 1, TURN_UNITS):
        raise BagError(
            f"{name}: unit {said.get('unit')}, modulo {said.get('modulo')} and {n} intervals that "
            f"make {turn} x 0.0001 deg; expected 1, 1 and at least 2 that make {TURN_UNITS}"
        )
    try:
        pos = [said[f"table[{k}].pos"] for k in range(n)]
        neg = [said[f"table[{k}].neg"] for k in range(n)] if said.get("bilateral") else pos
    except KeyError as error:
        raise BagError(f"{name}: {error.args[0]} is missing, of {n} points") from error
    return SsfkTable(
        rows_deg=np.linspace(0.0, 360.0, n + 1),
        pos=np.array([*pos, pos[0]], dtype=np.int64),
        neg=np.array([*neg, neg[0]], dtype=np.int64),
    )


def correction(table: SsfkTable, angle: Floats, approach: Approach) -> Floats:
    """Return what the control adds to the command (rad): minus the table, linear and modulo."""
    column = table.pos if approach is Approach.POSITIVE else table.neg
    value = periodic(np.asarray(angle) / DEGREE, table.rows_deg, column.astype(np.float64))
    return np.asarray(-value * (UNIT_DEG * DEGREE), dtype=np.float64)


CONTROLLER: Final = Controller(
    name="twincat",
    title="Beckhoff TwinCAT CNC / ISG",
    settings=TwinCatSettings,
    write=write,
    read=read,
    correction=correction,
    resolution=lambda table, settings: UNIT_DEG * DEGREE,
    position_resolution=0.0,
    one_direction=lambda settings: False,
    unverified=lambda settings: (
        "that a modulo table holds N rows 0 .. 360 - interval, without the row at 360",
    ),
    sign="value = actual - commanded",
    wrap="kw.ssfk.modulo 1, N rows from 0 to 360 - interval",
    unit="whole numbers of 0.0001 deg (0.36 arcsec)",
    source="Beckhoff TF5200 axis compensation, P-COMP-00017 .. 00025, 00059",
)
