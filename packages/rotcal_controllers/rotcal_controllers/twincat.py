"""Beckhoff TwinCAT CNC and ISG kernel: leadscrew compensation ``kw.ssfk.*`` in achskw*.lis.

Whole numbers of 0.0001 degrees, actual - commanded, one column for each direction, linear. In a
modulo list the first and the last entry are the same: it ends with the row at 360. Sources:
``TwinCat.facts``, and the ISG kernel's documentation.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from rotcal_controllers import isg_volumetric
from rotcal_controllers.machine_files import machine_text, parse_finite
from rotcal_ros.compensation.controller import (
    Comment,
    ComponentErrors,
    Controller,
    Facts,
    OwnSetting,
    Volumetric,
)
from rotcal_ros.compensation.controller_files import (
    PeriodicTable,
    backlash_note,
    columns_deg,
    even_interval_deg,
    integer,
    match_lines,
    only_file,
    require_at_most,
)
from rotcal_ros.compensation.table import CompensationTable
from rotcal_ros.foundation.errors import BagError, ConfigurationError
from rotcal_ros.foundation.observations import Approach
from rotcal_ros.foundation.settings import setting
from rotcal_ros.foundation.units import DEGREE

UNIT_DEG: Final = 1e-4
TURN_UNITS: Final = 3_600_000
NOT_KNOWN: Final = (
    "P-AXIS-00103 during the measurement is not known: whether a backlash compensation acts "
    "beside a list of both directions is not documented: state --set backlash_deg=DEG, 0 for "
    "none, or --set machine_file=FILE"
)


@dataclass(frozen=True)
class TwinCat(Controller):
    """Beckhoff TwinCAT CNC and the ISG kernel."""

    suffixes = (".lis",)
    comment = Comment(".lis", 0, "# {}")
    facts = Facts(
        title="Beckhoff TwinCAT CNC / ISG",
        sign="value = actual - commanded",
        wrap="kw.ssfk.modulo 1, rows from 0 to 360, the last equal to the first",
        unit="whole numbers of 0.0001 deg (0.36 arcsec)",
        source="Beckhoff TF5200 axis compensation, P-COMP-00017 .. 00025, 00059",
    )
    value_resolution = UNIT_DEG * DEGREE
    switch_on = "P-AXIS-00175 lr_param.ssfk 1, the list named in the start-up list, axis homed"
    own_settings = (
        OwnSetting(
            "P-AXIS-00021, P-AXIS-00103",
            "are unnecessary beside a list of both directions; whether they still act is not said",
            "what P-AXIS-00103 was during the measurement goes into such a list: read from "
            "machine_file, or stated by backlash_deg; P-AXIS-00021 has to be 0 from then on",
            "Beckhoff TF5200, 308683659, 308651403",
        ),
        OwnSetting(
            "P-AXIS-00243 n_backlash_cyc",
            "spreads the jump at a reversal over so many cycles",
            "let the axis come to rest before it is measured",
            "Beckhoff TF5200, 308693899",
        ),
        OwnSetting(
            "kw.ssfk.manual_activation",
            "leaves the table off until the program switches it on",
            "is not in the list, so that the control switches the table on",
            "Beckhoff TF5200, 308687883",
        ),
    )

    max_points: int = setting(
        1500, doc="P-COMP-00059 of the machine; the list has fewer rows", minimum=4
    )

    axis_number: int = setting(
        0,
        minimum=0,
        maximum=65535,
        doc="logical number of the axis, for the list header (kopf.achs_nr); 0: no header, the "
        "System Manager writes it",
    )
    backlash_deg: float | None = setting(
        None,
        minimum=0.0,
        doc="deg, P-AXIS-00103 during a measurement without table; 0: none, or P-AXIS-00021 is 0; "
        "none: that of machine_file",
    )
    machine_file: str = setting(
        "", doc="parameter list of the axis, in lines as getriebe[0].lose 1000"
    )

    def for_axis(self, axis: str) -> TwinCat:
        """Return the controller with the backlash of the machine's list; 0 while it is not chosen.

        Raises ConfigurationError for a list without it, and for one that is negative: that lies
        between drive and measuring system (P-AXIS-00021).
        """
        if not self.machine_file or self.backlash_deg is not None:
            return self
        text = machine_text(self.machine_file)
        lost, chosen = (
            re.search(rf"^\s*{name}\s+([-\d.]+)", text, re.MULTILINE)
            for name in (r"getriebe\[0\]\.lose", r"lr_param\.\s*anwahl_losekomp")
        )
        if lost is None or chosen is None:
            raise ConfigurationError(
                f"{self.machine_file}: expected lines getriebe[0].lose and "
                "lr_param.anwahl_losekomp; add them, or state backlash_deg"
            )
        found = parse_finite(self.machine_file, "getriebe[0].lose", lost[1]) * UNIT_DEG
        if found < 0.0:
            raise ConfigurationError(
                f"{self.machine_file}: getriebe[0].lose is negative, a backlash between drive and "
                "measuring system: state what it does at the table by backlash_deg"
            )
        return replace(self, backlash_deg=found if chosen[1] != "0" else 0.0)

    def without_table(self, approach: Approach) -> float:
        """Return the backlash, taken off from above."""
        lost = (self.backlash_deg or 0.0) * DEGREE
        return 0.0 if approach is Approach.POSITIVE else -lost

    def replaced(self, table: CompensationTable) -> str:
        """Say what became of the backlash compensation beside a list of both directions.

        Raises ConfigurationError where it would be lost, since nobody states it.
        """
        if self.backlash_deg is None:
            if table.directional:
                raise ConfigurationError(NOT_KNOWN)
            return ""
        about = f"P-AXIS-00103 = {self.backlash_deg:g} deg (set P-AXIS-00021 to 0)"
        return backlash_note(about, self.backlash_deg * DEGREE, table)

    def write(self, table: CompensationTable, stem: str) -> dict[str, str]:
        """Return the compensation list; raises ConfigurationError above ``max_points``."""
        spacing = even_interval_deg(table, "TwinCAT CNC", UNIT_DEG)
        _, up, down = columns_deg(table)
        n = len(up)
        require_at_most(
            n,
            self.max_points - 1,
            "twincat: points",
            "choose a wider spacing, or raise P-COMP-00059",
        )
        pos, neg = (np.rint(-column / UNIT_DEG).astype(np.int64) for column in (up, down))
        bilateral = int(table.directional)
        head = {
            "unit": 1,
            "interval": round(spacing / UNIT_DEG),
            "kw_startpos": 0,
            "kw_nr_max": n,
            "bilateral": bilateral,
            "modulo": 1,
        }
        lines = [f"kopf.achs_nr {self.axis_number}", f"kopf.log_achs_name {table.axis}"]
        lines = lines if self.axis_number else []
        lines += [f"kw.ssfk.{key} {value}" for key, value in head.items()]
        for k in range(n):
            lines.append(f"kw.ssfk.table[{k}].pos {pos[k]}")
            if bilateral:
                lines.append(f"kw.ssfk.table[{k}].neg {neg[k]}")
        return {f"{stem}.lis": "\n".join(lines) + "\n"}

    def read(self, files: Mapping[str, str]) -> PeriodicTable:
        """Read a compensation list; BagError unless it is one turn in units of 0.0001 deg."""
        name, text = only_file(files, ".lis")
        line = r"kw\.ssfk\.([\w\[\].]+)\s+(\S+)|kopf\.(achs_nr\s+\d+|log_achs_name\s+\S+)|#.*"
        found = match_lines(name, text, line, "kw.ssfk.unit 1")
        values = {match[1]: integer(match[2], where) for where, match in found if match[1]}
        n = values.get("kw_nr_max", 0)
        covered = values.get("interval", 0) * max(n - 1, 0)
        head = (values.get("unit"), values.get("modulo"), covered)
        if n < 3 or head != (1, 1, TURN_UNITS):
            raise BagError(
                f"{name}: unit {head[0]}, modulo {head[1]} and {n} rows that cover {head[2]} "
                f"x 0.0001 deg; expected 1, 1 and at least 3 that cover {TURN_UNITS}"
            )
        try:
            pos = [values[f"table[{k}].pos"] for k in range(n)]
            neg = [values[f"table[{k}].neg"] for k in range(n)] if values.get("bilateral") else pos
        except KeyError as error:
            raise BagError(f"{name}: {error.args[0]} is missing, of {n} points") from error
        up, down = (np.array(column, dtype=np.int64) for column in (pos, neg))
        return PeriodicTable(name, np.linspace(0.0, 360.0, n), up, down, -UNIT_DEG * DEGREE)

    def write_components(
        self, errors: ComponentErrors, stem: str, head: Sequence[str]
    ) -> Volumetric:
        """Return a parameter file of the volumetric compensation."""
        return isg_volumetric.write(errors, stem, head, self.axis_number)

    def read_components(self, files: Mapping[str, str]) -> ComponentErrors:
        """Read such a file back."""
        return isg_volumetric.read(files)
