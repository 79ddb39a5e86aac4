"""Siemens SINUMERIK 840D, 840D sl, 828D, 808D: ENC_COMP, or a pair of CEC tables.

``$AA_ENC_COMP`` is evenly spaced, applied to the actual value, and the same in both
directions: a positive value moves the axis in the negative direction, so the value is actual -
commanded. With IS_MODULO the value at MAX is followed by the value at MIN, both are
written and equal. Two directions take two CEC tables on the axis itself. Sources: Function
Manual Extended Functions K3, 6FC5397-1BP40-3BA1 (03/2013) pp. 237-264; 808D Function Manual
(01/2017) pp. 106-109; 802D sl Function Manual 6FC5397-1CP10-5BA0 (11/2012) p. 222.
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
    even_interval_deg,
    fixed,
    integer,
    mean_deg,
    number,
    only_file,
    periodic,
    require_at_most,
)
from rotcal_ros.compensation.table import CompensationTable, check_axis
from rotcal_ros.errors import BagError, ConfigurationError
from rotcal_ros.observations import Approach
from rotcal_ros.units import DEGREE

DECIMALS: Final = 7
STEP_DEG: Final = 1e-6


@dataclass(frozen=True)
class SinumerikSettings:
    """``tables``: "enc_comp" (one column, mean of both directions) or "cec" (two directions).

    ``axis_name`` is the machine axis identifier in the file (empty: the axis of the table),
    ``measuring_system`` 0 or 1, ``max_points`` the value of MD38000 (ENC_COMP) or MD18342 (CEC);
    200 is what the smallest control, 808D, holds. ``first_cec_table`` is the index of the first
    of two CEC tables. ``cec_adds`` tells that a CEC value is added to the set-point.
    """

    tables: str = "enc_comp"
    axis_name: str = ""
    measuring_system: int = 0
    max_points: int = 200
    first_cec_table: int = 0
    cec_adds: bool = True

    def __post_init__(self) -> None:
        if self.tables not in ("enc_comp", "cec") or self.measuring_system not in (0, 1):
            raise ConfigurationError(
                f"sinumerik: tables {self.tables!r} (enc_comp or cec), measuring_system "
                f"{self.measuring_system} (0 or 1): out of range"
            )
        if self.axis_name:
            check_axis(self.axis_name)


@dataclass(frozen=True, eq=False)
class SinumerikTables:
    """Rows (deg) and the correction (deg, added to the command) in each direction."""

    rows_deg: Floats
    forward_deg: Floats
    reverse_deg: Floats


def write(table: CompensationTable, settings: SinumerikSettings, stem: str) -> dict[str, str]:
    """Return one archive file; raises ConfigurationError when the points are too many."""
    spacing = even_interval_deg(table, "SINUMERIK", STEP_DEG)
    count = len(table.angles) + 1
    setting = "MD38000" if settings.tables == "enc_comp" else "MD18342"
    require_at_most(
        count,
        settings.max_points,
        f"sinumerik: points at {spacing:g} deg",
        f"a wider spacing, or set max_points to {setting} of the machine",
    )
    axis = settings.axis_name or table.axis
    if settings.tables == "enc_comp":
        lines = [f"%_N_{axis}_EEC_INI", "CHANDATA(1)"]
        lines += _enc_comp(table, axis, settings.measuring_system, spacing)
    else:
        lines = ["%_N_NC_CEC_INI", "CHANDATA(1)"]
        sign = 1.0 if settings.cec_adds else -1.0
        _, up, down = columns_deg(table)
        lines += _cec(settings.first_cec_table, axis, sign * up, spacing, 1)
        lines += _cec(settings.first_cec_table + 1, axis, sign * down, spacing, -1)
    return {f"{stem}.ini": "\n".join([*lines, "M17"]) + "\n"}


def read(files: Mapping[str, str], settings: SinumerikSettings) -> SinumerikTables:
    """Read ENC_COMP or a pair of CEC tables back; BagError when something is missing."""
    said = _assignments(files)
    if settings.tables == "enc_comp":
        rows, value = _rows(said, "AA_ENC_COMP", str(settings.measuring_system))
        return SinumerikTables(rows, -value, -value)
    sign = 1.0 if settings.cec_adds else -1.0
    columns: dict[str, tuple[Floats, Floats]] = {}
    for index in (settings.first_cec_table, settings.first_cec_table + 1):
        direction = said.get(("AN_CEC_DIRECTION", str(index)), "missing")
        columns[direction] = _rows(said, "AN_CEC", str(index))
    if set(columns) != {"1", "-1"}:
        raise BagError(
            f"the CEC tables act in the directions {', '.join(columns)}, expected 1 and -1"
        )
    return SinumerikTables(columns["1"][0], sign * columns["1"][1], sign * columns["-1"][1])


def correction(tables: SinumerikTables, angle: Floats, approach: Approach) -> Floats:
    """Return what the control adds to the command (rad) at ``angle`` (rad), linear and modulo."""
    column = tables.forward_deg if approach is Approach.POSITIVE else tables.reverse_deg
    return periodic(np.asarray(angle) / DEGREE, tables.rows_deg, column) * DEGREE


def _enc_comp(table: CompensationTable, axis: str, system: int, spacing: float) -> list[str]:
    errors = -mean_deg(table)
    lines = [
        f"$AA_ENC_COMP[{system},{k},{axis}]={fixed(value, DECIMALS)}"
        for k, value in enumerate(errors)
    ]
    return [
        *lines,
        f"$AA_ENC_COMP_STEP[{system},{axis}]={fixed(spacing, DECIMALS)}",
        f"$AA_ENC_COMP_MIN[{system},{axis}]=0.0",
        f"$AA_ENC_COMP_MAX[{system},{axis}]=360.0",
        f"$AA_ENC_COMP_IS_MODULO[{system},{axis}]=1",
    ]


def _cec(index: int, axis: str, values: Floats, spacing: float, direction: int) -> list[str]:
    return [
        *(f"$AN_CEC[{index},{k}]={fixed(value, DECIMALS)}" for k, value in enumerate(values)),
        f"$AN_CEC_INPUT_AXIS[{index}]=({axis})",
        f"$AN_CEC_OUTPUT_AXIS[{index}]=({axis})",
        f"$AN_CEC_STEP[{index}]={fixed(spacing, DECIMALS)}",
        f"$AN_CEC_MIN[{index}]=0.0",
        f"$AN_CEC_MAX[{index}]=360.0",
        f"$AN_CEC_DIRECTION[{index}]={direction}",
        f"$AN_CEC_MULT_BY_TABLE[{index}]=0",
        f"$AN_CEC_IS_MODULO[{index}]=1",
    ]


def _assignments(files: Mapping[str, str]) -> dict[tuple[str, ...], str]:
    """Return {(variable, index, ...): value} of all ``$NAME[i,...]=value`` lines."""
    said: dict[tuple[str, ...], str] = {}
    name, text = only_file(files, ".ini")
    for row, line in enumerate(text.splitlines(), start=1):
        match = re.fullmatch(r"\$(\w+)\[([\w,]+)\]=\(?([^()]*)\)?", line.strip())
        if match:
            name_and_indices = (match.group(1), *match.group(2).split(","))
            said[name_and_indices] = match.group(3)
        elif not re.fullmatch(r"%_N_\w+_INI|CHANDATA\(1\)|M17|", line.strip()):
            raise BagError(
                f"{name}, line {row}: {line!r} is not an assignment such as "
                "$AA_ENC_COMP[0,1,C1]=0.005"
            )
    return said


def _rows(said: Mapping[tuple[str, ...], str], variable: str, first: str) -> tuple[Floats, Floats]:
    """Return rows and values (deg) of the table ``first`` of ``variable``, checked for closure."""
    points = {
        integer(k[2], f"${variable} index"): v
        for k, v in said.items()
        if k[:2] == (variable, first) and len(k) > 2
    }
    single = {k[0].removeprefix(variable): v for k, v in said.items() if k[1] == first}
    step, low, high = (
        number(single.get(name, "nothing"), f"${variable}{name}")
        for name in ("_STEP", "_MIN", "_MAX")
    )
    count = len(points)
    whole = abs(step * (count - 1) - 360.0) < 1e-3 and (low, high) == (0.0, 360.0)
    if count < 3 or sorted(points) != list(range(count)) or not whole:
        raise BagError(
            f"${variable}: {count} points from {low:g} to {high:g} deg every {step:g}, "
            "expected all points 0, 1, ... from 0 to 360 deg"
        )
    value = np.array([number(points[k], f"${variable} point {k}") for k in range(count)])
    if single.get("_IS_MODULO") != "1" or value[0] != value[-1]:
        raise BagError(
            f"${variable} does not close: IS_MODULO is {single.get('_IS_MODULO')}, the values at "
            f"0 and 360 deg are {value[0]} and {value[-1]}; expected 1 and equal values"
        )
    return np.linspace(low, high, count), value


def _unverified(settings: SinumerikSettings) -> tuple[str, ...]:
    if settings.tables == "enc_comp":
        return ()
    return (
        "the sign of $AN_CEC: the manual's pages at hand do not state it; test with one point",
        "the activation of a CEC table by setting data SD41300",
    )


CONTROLLER: Final = Controller(
    name="sinumerik",
    title="Siemens SINUMERIK",
    settings=SinumerikSettings,
    write=write,
    read=read,
    correction=correction,
    resolution=lambda table, settings: 10.0**-DECIMALS * DEGREE,
    position_resolution=10.0**-DECIMALS * DEGREE,
    one_direction=lambda settings: bool(settings.tables == "enc_comp"),
    unverified=_unverified,
    sign="ENC_COMP value = actual - commanded (positive moves the axis in negative direction)",
    wrap="IS_MODULO = 1, MIN 0, MAX 360, both end points written and equal",
    unit="degrees, 7 decimals",
    source="6FC5397-1BP40-3BA1 (03/2013) pp. 237-264; 808D Function Manual (01/2017) pp. 106-109",
)
