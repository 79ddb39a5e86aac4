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
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from rotcal_controllers.machine_files import MachineData, backlash_note
from rotcal_ros.compensation.axis_location import rounded_lengths
from rotcal_ros.compensation.controller import Comment, Controller, Facts, Located, OwnSetting
from rotcal_ros.compensation.controller_files import (
    PeriodicTable,
    columns_deg,
    even_interval_deg,
    fixed,
    integer,
    mean_deg,
    only_file,
    parse_number,
    require_at_most,
)
from rotcal_ros.compensation.table import CompensationTable
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.components import check_axis
from rotcal_ros.foundation.errors import BagError, ConfigurationError, DataError
from rotcal_ros.foundation.results import AxisLine
from rotcal_ros.foundation.settings import setting
from rotcal_ros.foundation.units import DEGREE

DECIMALS: Final = 7
STEP_DEG: Final = 1e-6
ENC_COMP: Final = "enc_comp"
AXIS_DECIMALS: Final = 9
CHAIN_SOURCE: Final = "6FC5397-1DP40-6BA1 (12/2017) pp. 571, 572, 581"
CHAIN_OPEN: Final = (
    "that the vectors count from the machine's zero, and the sign of MD24570 and MD24572: compare "
    "with what the machine holds, the difference has to be small",
)


@dataclass(frozen=True)
class Sinumerik(Controller):
    """Siemens SINUMERIK with one ENC_COMP table, or two CEC tables for two directions."""

    suffixes = (".ini",)
    comment = Comment(".ini", 2, "; {}")
    facts = Facts(
        title="Siemens SINUMERIK",
        sign="ENC_COMP value = actual - commanded (positive moves the axis in negative direction)",
        wrap="IS_MODULO = 1, MIN 0, MAX 360, both end points written and equal",
        unit="degrees, 7 decimals",
        source="6FC5397-1BP40-3BA1 (03/2013) pp. 237-264; 6FC5397-1CP10-5BA0 (11/2012) p. 222; "
        "808D Function Manual (01/2017) pp. 106-109",
    )
    position_resolution = 10.0**-DECIMALS * DEGREE
    value_resolution = position_resolution
    own_settings = (
        OwnSetting(
            "MD32450 BACKLASH",
            "adds to the table, for each measuring system, once the axis is referenced",
            "read from machine_file and held against backlash_deg; leave it as it was during the "
            "measurement: nothing of it is in the table",
            "6FC5397-1BP40-3BA1 (03/2013) p. 234; 6FC5397-8EP40-0BA0 (08/2013) p. 228",
        ),
        OwnSetting(
            "MD32700 ENC_COMP_ENABLE",
            "locks ENC_COMP against writing while it is 1",
            "read from machine_file: a table in force that was not measured on is refused; set it "
            "to 0 before the file is loaded, and to 1 after it",
            "6FC5397-1BP40-3BA1 (03/2013) pp. 237-264",
        ),
        OwnSetting(
            "measuring system of the axis",
            "a table acts only with the measuring system that it is for",
            "state the active one: measuring_system",
            "6FC5397-1BP40-3BA1 (03/2013) p. 238",
        ),
        OwnSetting(
            "MD32710 CEC_ENABLE, SD41300",
            "switch a CEC table off while either is 0",
            "set both to 1 for tables: cec",
            "6FC5397-1BP40-3BA1 (03/2013) p. 245",
        ),
        OwnSetting(
            "SD41310 CEC_TABLE_WEIGHT",
            "multiplies the values of a CEC table",
            "read from machine_file, another weight is refused; set it to 1 for tables: cec",
            "",
        ),
        OwnSetting(
            "MD32720 CEC_MAX_SUM",
            "limits the sum of all CEC tables of the axis",
            "read from machine_file, a smaller one is refused; keep it above the largest value in "
            "the file",
            "",
        ),
    )

    tables: str = setting(
        ENC_COMP,
        doc="one column, the mean of both directions, or two directions",
        choices=(ENC_COMP, "cec"),
    )
    axis_name: str = setting("", doc="machine axis identifier; empty: the axis of the table")
    measuring_system: int = setting(0, doc="measuring system of the axis", minimum=0, maximum=1)
    max_points: int = setting(
        200, doc="MD38000 (ENC_COMP) or MD18342 (CEC); an 808D holds 200", minimum=3
    )
    first_cec_table: int = setting(0, doc="index of the first of two CEC tables", minimum=0)
    cec_adds: bool = setting(True, doc="whether a CEC value is added to the set-point")
    backlash_deg: float | None = setting(
        None, doc="deg, MD32450 during the measurement; none: as in machine_file"
    )
    machine_file: str = setting(
        "", doc="archive with machine data (initial.ini), in lines as N32450 $MA_BACKLASH[0,AX4]=0"
    )

    def __post_init__(self) -> None:
        if self.axis_name:
            check_axis(self.axis_name)

    @property
    def one_direction(self) -> bool:
        """Whether it is ENC_COMP, which has one column."""
        return self.tables == ENC_COMP

    @property
    def unverified(self) -> tuple[str, ...]:
        """What has not been confirmed yet: the sign of CEC."""
        if self.tables == ENC_COMP:
            return ()
        return (
            "the sign of $AN_CEC: the manual's pages at hand do not state it; test with one point",
        )

    @property
    def switch_on(self) -> str:
        """What has to be set, and that the axis has to be referenced."""
        if self.tables == ENC_COMP:
            return "MD32700 ENC_COMP_ENABLE = 1 of the measuring system, then reference the axis"
        return (
            "SD41300 $SN_CEC_TABLE_ENABLE of both tables = 1, MD32710 CEC_ENABLE of the axis = 1, "
            "then reference the axis"
        )

    def write(self, table: CompensationTable, stem: str) -> dict[str, str]:
        """Return one archive file; raises ConfigurationError when the points are too many."""
        spacing = even_interval_deg(table, "SINUMERIK", STEP_DEG)
        count = len(table.angles) + 1
        machine_data = "MD38000" if self.tables == ENC_COMP else "MD18342"
        require_at_most(
            count,
            self.max_points,
            f"sinumerik: points at {spacing:g} deg",
            f"choose a wider spacing, or set max_points to {machine_data} of the machine",
        )
        axis = self.axis_name or table.axis
        if self.tables == ENC_COMP:
            lines = ["%_N_AX_EEC_INI", "CHANDATA(1)"]
            lines += _enc_comp(table, axis, self.measuring_system, spacing)
        else:
            lines = ["%_N_NC_CEC_INI", "CHANDATA(1)"]
            _, up, down = columns_deg(table)
            lines += _cec(self.first_cec_table, axis, self._cec_sign * up, spacing, 1)
            lines += _cec(self.first_cec_table + 1, axis, self._cec_sign * down, spacing, -1)
        return {f"{stem}.ini": "\n".join([*lines, "M17"]) + "\n"}

    def replaced(self, table: CompensationTable) -> str:
        """Hold the machine data of ``machine_file`` against what the table assumes.

        Return what stays beside the table; ConfigurationError for what contradicts it.
        """
        if not self.machine_file:
            return ""
        data, system = MachineData.read(self.machine_file), self.measuring_system
        axis = data.axis(self.axis_name or table.axis)
        if self.tables == ENC_COMP:
            in_force = data.number("MA_ENC_COMP_ENABLE", f"{system},{axis}")
            if in_force and not table.adds_to:
                raise ConfigurationError(
                    f"{data.path}: MD32700 ENC_COMP_ENABLE[{system}] of {axis} is 1, so that a "
                    "table is in force, and the measurement is not on top of one: set it to 0, "
                    "measure and save the archive again, or add to that table (--add-to)"
                )
        else:
            self._require_cec(data, axis, table)
        backlash = data.number("MA_BACKLASH", f"{system},{axis}")
        name = f"MD32450 BACKLASH[{system}] of {axis}"
        return backlash_note(name, backlash, self.backlash_deg, "deg")

    def _require_cec(self, data: MachineData, axis: str, table: CompensationTable) -> None:
        """Raise ConfigurationError for weights and limits that would change the tables."""
        for index in (self.first_cec_table, self.first_cec_table + 1):
            weight = data.number("SN_CEC_TABLE_WEIGHT", f"{index}")
            if weight not in (None, 1.0):
                raise ConfigurationError(
                    f"{data.path}: SD41310 CEC_TABLE_WEIGHT[{index}] is {weight:g} and would "
                    "multiply the table: set it to 1"
                )
        limit = data.number("MA_CEC_MAX_SUM", axis)
        largest = max(float(np.max(np.abs(column))) for column in columns_deg(table)[1:])
        if limit is not None and largest > limit:
            raise ConfigurationError(
                f"{data.path}: MD32720 CEC_MAX_SUM of {axis} is {limit:g} deg, and the table "
                f"holds {largest:.6g}: raise it"
            )

    def locate(self, lines: Sequence[AxisLine], stem: str, head: Sequence[str]) -> Located:
        """Return machine data of a five-axis transformation with a swivel table (type 40).

        I2 leads from the machine's zero to the first axis, I3 from there to the table's, and I4 =
        -(I2 + I3) back. V1 and V2 are the vectors about which the axes turn right-handed for
        growing angles: where an axis moves the work by the rule of ISO 841, that is clockwise, and
        its vector is reversed (pp. 571, 572). Raises DataError where the sense is not known.
        """
        table, *tilting = lines
        if unknown := [line.letter for line in lines if not line.sense]:
            raise DataError(
                f"the result does not say which way {' and '.join(unknown)} turns, so that the "
                "sign of its vector is open: solve the measurement again, with plan.chain stated"
            )
        vectors = {"MD24500 $MC_TRAFO5_PART_OFFSET_1": rounded_lengths(-table.point)}
        if tilting:
            first = tilting[0].point
            vectors |= {
                "MD24550 $MC_TRAFO5_BASE_TOOL_1": rounded_lengths(first),
                "MD24558 $MC_TRAFO5_JOINT_OFFSET_PART_1": rounded_lengths(table.point - first),
                "MD24570 $MC_TRAFO5_AXIS1_1": np.round(
                    tilting[0].sense * tilting[0].direction, AXIS_DECIMALS
                ),
            }
        turning = table.sense * table.direction
        vectors["MD24572 $MC_TRAFO5_AXIS2_1"] = np.round(turning, AXIS_DECIMALS)
        values = {
            f"{name.split()[1]}[{k}]": float(x) + 0.0
            for name, vector in sorted(vectors.items())
            for k, x in enumerate(vector)
        }
        rows = [f"{name}={fixed(x, AXIS_DECIMALS)}" for name, x in values.items()]
        notes = () if tilting else (
            "the tilting axis was not measured: MD24558 $MC_TRAFO5_JOINT_OFFSET_PART_1 has to be "
            "-(MD24500 + MD24550), so that the vectors close",
        )  # fmt: skip
        text = "\n".join([*(f"; {line}" for line in head), "CHANDATA(1)", *rows, "M17"]) + "\n"
        return Located({f"{stem}.ini": text}, values, CHAIN_SOURCE, notes, CHAIN_OPEN)

    def read(self, files: Mapping[str, str]) -> PeriodicTable:
        """Read ENC_COMP or a pair of CEC tables back; BagError when something is missing."""
        name, values = _assignments(files)
        if self.tables == ENC_COMP:
            rows, errors = _rows(values, "AA_ENC_COMP", str(self.measuring_system))
            return PeriodicTable(name, rows, errors, errors, -DEGREE)
        columns: dict[str, tuple[Floats, Floats]] = {}
        for index in (self.first_cec_table, self.first_cec_table + 1):
            direction = values.get(("AN_CEC_DIRECTION", str(index)), "missing")
            columns[direction] = _rows(values, "AN_CEC", str(index))
        if set(columns) != {"1", "-1"}:
            raise BagError(
                f"the CEC tables act in the directions {', '.join(columns)}, expected 1 and -1"
            )
        rows, up = columns["1"]
        return PeriodicTable(name, rows, up, columns["-1"][1], self._cec_sign * DEGREE)

    @property
    def _cec_sign(self) -> float:
        return 1.0 if self.cec_adds else -1.0


def _enc_comp(table: CompensationTable, axis: str, system: int, spacing: float) -> list[str]:
    return [
        *(
            f"$AA_ENC_COMP[{system},{k},{axis}]={fixed(value, DECIMALS)}"
            for k, value in enumerate(-mean_deg(table))
        ),
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


def _assignments(files: Mapping[str, str]) -> tuple[str, dict[tuple[str, ...], str]]:
    """Return the file's name and {(variable, i, ...): value} of ``$NAME[i,...]=value`` lines."""
    values: dict[tuple[str, ...], str] = {}
    name, text = only_file(files, ".ini")
    for row, line in enumerate(text.splitlines(), start=1):
        match = re.fullmatch(r"\$(\w+)\[([\w,]+)\]=\(?([^()]*)\)?", line.strip())
        if match:
            name_and_indices = (match.group(1), *match.group(2).split(","))
            values[name_and_indices] = match.group(3)
        elif not re.fullmatch(r"%_N_\w+_INI|CHANDATA\(1\)|M17|;.*|", line.strip()):
            raise BagError(
                f"{name}, line {row}: {line!r} is not an assignment such as "
                "$AA_ENC_COMP[0,1,C1]=0.005"
            )
    return name, values


def _rows(
    values: Mapping[tuple[str, ...], str], variable: str, first: str
) -> tuple[Floats, Floats]:
    """Return rows and values (deg) of the table ``first`` of ``variable``, a whole turn."""
    points = {
        integer(k[2], f"${variable} index"): v
        for k, v in values.items()
        if k[:2] == (variable, first) and len(k) > 2
    }
    single = {k[0].removeprefix(variable): v for k, v in values.items() if k[1] == first}
    step, low, high = (
        parse_number(single.get(name, "nothing"), f"${variable}{name}")
        for name in ("_STEP", "_MIN", "_MAX")
    )
    count = len(points)
    whole = abs(step * (count - 1) - 360.0) < 1e-3 and (low, high) == (0.0, 360.0)
    if count < 3 or sorted(points) != list(range(count)) or not whole:
        raise BagError(
            f"${variable}: {count} points from {low:g} to {high:g} deg every {step:g}, "
            "expected all points 0, 1, ... from 0 to 360 deg"
        )
    if single.get("_IS_MODULO") != "1":
        raise BagError(
            f"${variable} does not close: IS_MODULO is {single.get('_IS_MODULO')}, expected 1"
        )
    column = np.array([parse_number(points[k], f"${variable} point {k}") for k in range(count)])
    return np.linspace(low, high, count), column
