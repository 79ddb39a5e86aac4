"""Numbers as people write them: decimal commas, thousands, degrees, minutes and seconds, units.

All is computed in decimal, so that 312.5 mm are the very bits of 0.3125 m.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import datetime, timezone
from decimal import Decimal
from typing import Final

from rotcal_ros.foundation.table_columns import ANGLE, TIME, UNITS, plain, quantity_of
from rotcal_tables.sheets.files import Cell
from rotcal_tables.sheets.words import units_of, units_of_quantity

_SPACES: Final = " '’"
_WHOLE: Final = rf"\d{{1,3}}(?:[{_SPACES}]\d{{3}})+|\d+"
_PLACES: Final = rf"\d{{3}}(?:[{_SPACES}]\d{{3}})*(?:[{_SPACES}]\d{{1,3}})?|\d*"
_NUMBER: Final = re.compile(rf"[-+]?(?:(?:{_WHOLE})(?:\.(?:{_PLACES}))?|\.\d+)(?:[eEdD][-+]?\d+)?")
_GROUPED: Final = {
    mark: re.compile(rf"[-+]?\d{{1,3}}(?:{re.escape(other)}\d{{3}})+(?:{re.escape(mark)}\d*)?")
    for mark, other in ((".", ","), (",", "."))
}
_SEXAGESIMAL: Final = {
    mark: re.compile(
        r"""([-+]?)\s*(\d+)\s*([°d:\s])\s*(?:(\d+(?:M\d*)?)\s*['′m:\s]?\s*"""
        r"""(?:(\d+(?:M\d*)?)\s*(?:"{1,2}|''|′′|s)?)?)?""".replace("M", re.escape(mark))
    )
    for mark in (".", ",")
}
_SIGN_APART: Final = re.compile(r"^([-+])\s+")
_MINUTES_FIRST: Final = re.compile(r"^([-+]?)(?=\d+['′])")
_MEASURE: Final = re.compile(r"(.*?\d\.?)\s*([^\d\s.,+-].*)", re.DOTALL)


@dataclass(frozen=True, slots=True)
class Measure:
    """A number, with the unit that its cell states itself; empty if it states none."""

    value: Decimal
    unit: str = ""


def to_si(measure: Measure, unit: str) -> Decimal:
    """Return a measure in metres, radians or seconds; ``unit`` holds where the cell has none."""
    used = measure.unit or unit
    return measure.value * UNITS[quantity_of(used)][used]


def parse_measure(cell: Cell, mark: str, quantity: str = "") -> Measure | None:
    """Return the number in a cell whose decimal mark is ``mark``; None if there is none.

    For an angle 12°30'15" is a number too, and 12:30:15, which may be a time, has the unit dms;
    for a time 12:30:15 and a date of ISO 8601 are.
    """
    if not isinstance(cell, str):
        return Measure(Decimal(repr(cell))) if cell - cell == 0.0 else None
    text = plain(cell)
    if (value := _decimal(text, mark)) is not None:
        return Measure(value)
    if quantity in (ANGLE, TIME) and (found := _sexagesimal(text, mark)):
        value, sure = found
        return Measure(value, "h" if quantity == TIME else "deg" if sure else "dms")
    if quantity == TIME and (value := _moment(text)) is not None:
        return Measure(value, "s")
    apart = _MEASURE.fullmatch(text)
    units = units_of_quantity(units_of(apart[2]), quantity) if apart and quantity else ()
    value = _decimal(apart[1], mark) if apart and len(units) == 1 else None
    if value is None or quantity_of(units[0]) != quantity:
        return None
    return Measure(value, units[0])


def decimal_marks(cells: Iterable[Cell]) -> frozenset[str]:
    """Return the decimal marks, point or comma, in which all numbers of ``cells`` can be read.

    Both where it is open, as for 1,234 alone; none where some contradict each other.
    """
    marks = {".", ","}
    for cell in cells:
        if isinstance(cell, str) and ("," in cell or "." in cell):
            text = plain(cell)
            able = {mark for mark in (".", ",") if _sexagesimal(text, mark)} or {
                mark for mark in (".", ",") if _decimal(_number_in(text), mark) is not None
            }
            marks &= able or marks
    return frozenset(marks)


def _number_in(text: str) -> str:
    apart = _MEASURE.fullmatch(text)
    return text if _NUMBER.fullmatch(text) or apart is None else apart[1]


def _decimal(text: str, mark: str) -> Decimal | None:
    other = "," if mark == "." else "."
    if other in text:
        grouped = _GROUPED[mark].fullmatch(text)
        if grouped is None or text.lstrip("+-").startswith("0"):
            return None
        text = text.replace(other, "")
    text = _SIGN_APART.sub(r"\1", text.replace(mark, "."))
    if not _NUMBER.fullmatch(text):
        return None
    return Decimal(re.sub(f"[{_SPACES}]", "", text).lower().replace("d", "e"))


def _sexagesimal(text: str, mark: str) -> tuple[Decimal, bool] | None:
    """Return a number in 60ths, and whether signs of degrees tell so; None if it is none."""
    found = _SEXAGESIMAL[mark].fullmatch(_MINUTES_FIRST.sub(r"\g<1>0°", text))
    if found is None:
        return None
    minutes, seconds = (Decimal((part or "0").replace(mark, ".")) for part in found.group(4, 5))
    if minutes >= 60 or seconds >= 60:
        return None
    value = Decimal(found[2]) + minutes / 60 + seconds / 3600
    return -value if found[1] == "-" else value, found[3] in "°d"


def _moment(text: str) -> Decimal | None:
    try:
        moment = datetime.fromisoformat(text)
    except ValueError:
        return None
    aware = moment if moment.tzinfo else moment.replace(tzinfo=timezone.utc)
    return Decimal(repr(aware.timestamp()))
