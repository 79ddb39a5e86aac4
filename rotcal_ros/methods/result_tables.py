"""Tables of a result as a reader of the papers knows them: in a report, and as CSV.

Angles are in degrees, rotations in arcseconds, places in millimetres, small lengths in
micrometres, as the heads of the columns say; uncertainties are expanded (k = 2). A file has heads
for programs (``U_x_um``), a page for people (U(x) / µm).
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.components import COVERAGE_FACTOR, unit_of
from rotcal_ros.foundation.language import phrase
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import ARCSEC, DEGREE, MICROMETRE

DIGITS: Final = {"deg": 4, "mm": 4, "um": 3, "arcsec": 3, "Hz": 3, "deg/s": 3}
"""Digits behind the point of a column, by the unit at the end of its head; else six in all."""
UNITS: Final = {
    "deg": "°", "mm": "mm", "um": "µm", "arcsec": "arcsec", "Hz": "Hz", "deg/s": "(°/s)",
}  # fmt: skip
"""Units as people know them, by the end of a head."""
EXPANDED: Final = "U_"
"""Beginning of the heads of expanded uncertainties."""
WORDED: Final = ("quantity", "used")
"""Columns whose cells are words of ours; other texts are names."""
GAUGE: Final = {
    "prior": "in the frame of all stated coordinates, which weigh (datum prior)",
    "free": "less a shift and a turn of all targets, which are not determined (datum free)",
}
"""What corrections of targets count from, by the datum of the network."""


@dataclass(frozen=True)
class ResultTable:
    """A table: ``name`` for its file, ``title`` for people, ``head`` of the columns, and rows.

    Cells are numbers in the unit that ends their head (``x_mm``), whole numbers, or texts.
    """

    name: str
    title: str
    head: tuple[str, ...]
    rows: tuple[tuple[Any, ...], ...]

    @classmethod
    def of(cls, name: str, title: str, **columns: Iterable[Any]) -> ResultTable:
        """Return the table with these columns, all of one length."""
        rows = zip(*(np.asarray(column).tolist() for column in columns.values()), strict=True)
        return cls(name, title, tuple(columns), tuple(rows))

    def heads(self) -> list[str]:
        """Return the heads as a page has them: what it is, and its unit."""
        return [_readable(head) for head in self.head]

    def shown(self) -> list[list[str]]:
        """Return the cells as a page has them."""
        return [
            [_shown(head, cell) for head, cell in zip(self.head, row, strict=True)]
            for row in self.rows
        ]

    def to_csv(self) -> str:
        """Return the table with a header line; every number keeps its last bit."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(self.head)
        writer.writerows(self.rows)
        return text.getvalue()


def _readable(head: str) -> str:
    """Return a head of a file for people.

    >>> _readable("U_projected_x_mm"), _readable("test_value")
    ('U(projected x) / mm', 'test value')
    """
    name, _, unit = head.rpartition("_")
    if unit not in UNITS:
        name = head
    words = phrase(name.removeprefix(EXPANDED).replace("_", " "))
    if name.startswith(EXPANDED):
        words = phrase("U({0})", words)
    return phrase("{0} / {1}", words, UNITS[unit]) if unit in UNITS else words


def _shown(head: str, cell: Any) -> str:
    if not isinstance(cell, float):
        return phrase(str(cell)) if head in WORDED else str(cell)
    digits = DIGITS.get(head.rpartition("_")[2])
    return f"{cell:.7g}" if digits is None else f"{cell:.{digits}f}"


def by_axis(head: str, values: Any, unit: float = 1.0) -> dict[str, Floats]:
    """Return the columns x, y, z of ``values`` (n, 3) in ``unit``; ``head`` as ``{}_mm``."""
    columns = np.asarray(values, dtype=np.float64).T / unit
    return {head.format(axis): column for axis, column in zip("xyz", columns, strict=True)}


def deviations_table(result: Result, *, stated: bool) -> ResultTable:
    """Return the deviations by angle, with U where it may be ``stated``."""
    columns: dict[str, Any] = {"angle_deg": result.angles / DEGREE}
    for name in result.components:
        factor, unit = unit_of(name)
        suffix = unit.replace("µ", "u")
        columns[f"{name}_{suffix}"] = result.deviations[name] / factor
        if stated:
            columns[f"U_{name}_{suffix}"] = COVERAGE_FACTOR * result.std[name] / factor
    return ResultTable.of("deviations", "Deviations", **columns)


def steps_table(result: Result, *, stated: bool) -> list[ResultTable]:
    """Return the deviations of the steps between neighbouring angles, if they are known."""
    if result.adjacent_deviations is None:
        return []
    columns = {
        "from_deg": result.angles[:-1] / DEGREE,
        "to_deg": result.angles[1:] / DEGREE,
        "step_arcsec": result.adjacent_deviations / ARCSEC,
    }
    if stated and result.adjacent_std is not None:
        columns["U_step_arcsec"] = COVERAGE_FACTOR * result.adjacent_std / ARCSEC
    title = "Deviations of the steps between neighbouring angles"
    return [ResultTable.of("steps", title, **columns)]


def corrections_table(details: Mapping[str, Any]) -> list[ResultTable]:
    """Return by what the self-calibration of a tracer corrected its targets, if it did.

    Estimated less stated coordinates. The title says what they count from.
    """
    if "target_corrections" not in details:
        return []
    columns: dict[str, Any] = {"target": details["target_ids"]}
    for head, key, factor in (
        ("", "target_corrections", 1.0),
        (EXPANDED, "target_corrections_std", COVERAGE_FACTOR),
    ):
        columns |= by_axis(f"{head}{{}}_um", factor * np.asarray(details[key]), MICROMETRE)
    title = phrase("Corrections of the targets, {0}", phrase(GAUGE[details["datum"]]))
    return [ResultTable.of("target_corrections", title, **columns)]
