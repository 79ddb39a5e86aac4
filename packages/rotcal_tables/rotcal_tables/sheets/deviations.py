"""Deviations of a table: actual - commanded, as a column of their own or of both angles.

What stands there twice is held against each other; what may have either sign, or may be positions
in place of deviations, is asked.
"""

from __future__ import annotations

import re
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from itertools import pairwise
from typing import Final

from rotcal_ros.foundation.errors import UndecidedError
from rotcal_ros.foundation.language import phrase
from rotcal_ros.foundation.table_columns import ANGLE, UNITS, meaning, undecided
from rotcal_ros.foundation.units import DEGREE
from rotcal_tables.sheets.words import ACTUAL, REVERSED, TABLE_ANGLE

NEAR: Final = 0.25
"""Share of the smallest step of commanded angles within which an actual one belongs to it."""
_BY_ONE: Final = 0.2
"""By how much the slope of positions over commanded angles may differ from 1."""
_DIGITS: Final = 9
"""Digits behind the point of a number that a program has computed."""
_FRACTION: Final = re.compile(r"[.,](\d+)\D*$")
BY_BOTH: Final = phrase("deviation = actual - commanded")
TURNED: Final = phrase("commanded - actual, turned")
_TURN: Final = 360 * UNITS[ANGLE]["deg"]


@dataclass(frozen=True)
class Angles:
    """A column of angles: its heading ``text``, its ``cells``, and their ``values`` in rad.

    ``unit`` is that of the cells.
    """

    text: str
    cells: Sequence[str]
    values: Sequence[Decimal]
    unit: str

    @property
    def fractions(self) -> list[str]:
        """Return the digits behind the point of each value."""
        return [found[1] if (found := _FRACTION.search(cell)) else "" for cell in self.cells]

    @property
    def rounding(self) -> Decimal:
        """By how much (rad) a value may be rounded, and as much again."""
        sixtieths = any(":" in cell or "°" in cell for cell in self.cells)
        digits = min(max(map(len, self.fractions)), _DIGITS)
        return UNITS[ANGLE]["arcsec" if sixtieths else self.unit] * Decimal(10) ** -digits

    def is_rounder(self, other: Angles) -> bool:
        """Return whether the values need fewer digits than others, which have no even step."""
        own, theirs = (max(len(f.rstrip("0")) for f in a.fractions) for a in (self, other))
        values = sorted({*other.values})
        steps = [b - a for a, b in pairwise(values) if b - a > 2 * other.rounding]
        off = [abs(s - min(steps) * (s / min(steps)).to_integral_value()) for s in steps]
        return own < theirs and max(off, default=0) > 4 * other.rounding


@dataclass(frozen=True)
class StatedDeviations:
    """What a table says of its deviations: ``columns`` by what they are, in ``rows`` of a file.

    ``where`` names it; ``values`` is what a person said: deviations, corrections or positions;
    ``stated``: of what columns that is known. ``others`` are angles of no known name: where they
    follow the commanded ones, within NEAR of the smallest ``step`` (rad), the deviation is
    held against them. ``proposal`` shows the columns side by side.
    """

    where: str
    rows: Sequence[int]
    columns: Mapping[str, Angles]
    proposal: Sequence[str]
    step: float
    others: Sequence[Angles] = ()
    values: str = ""
    stated: Container[str] = ()

    def read(self) -> tuple[Sequence[Decimal], str]:
        """Return the deviations (rad) and how they were understood; a question where it is open.

        The table has measured angles beside commanded ones, or a column of differences.
        """
        columns = self.columns
        commanded, measured = columns.get(TABLE_ANGLE), columns.get(ACTUAL)
        stated = columns.get("deviation")
        if self.values == "positions" and stated and not measured:
            stated, measured = None, stated
        if commanded and stated and not measured:
            measured = next(
                (each for each in self.others if self._is_beside(commanded, each)), None
            )
        if commanded and measured:
            pairs = zip(measured.values, commanded.values, strict=True)
            found = [_wrapped(actual - angle) for actual, angle in pairs]
            self._require_positions(found, measured, commanded)
            if TABLE_ANGLE not in self.stated and measured.is_rounder(commanded):
                raise self._asked(
                    f"{measured.text!r} is rounder than {commanded.text!r}, as commanded angles "
                    f"are: {measured.cells[-1]} and {commanded.cells[-1]} in row {self.rows[-1]}",
                    {meaning(TABLE_ANGLE, each.text): f"{each.text} was commanded"
                     for each in (measured, commanded)},
                )  # fmt: skip
            if stated is None and REVERSED not in columns:
                return found, BY_BOTH
            return self._agreed(found, measured, commanded, stated or columns[REVERSED])
        if stated:
            if commanded and self.values not in ("deviations", "corrections"):
                self._require_small(stated, commanded)
            if self.values == "corrections":
                return [-value for value in stated.values], TURNED
            return stated.values, ""
        either = columns[REVERSED]
        if REVERSED in self.stated:
            return [-value for value in either.values], TURNED
        raise self._asked(
            f"{either.text!r} may be actual - commanded, or commanded - actual",
            {
                meaning("deviation", either.text): "actual - commanded: taken as it stands",
                meaning(REVERSED, either.text): "commanded - actual: its sign is turned",
            },
        )

    def _is_beside(self, commanded: Angles, other: Angles) -> bool:
        pairs = zip(other.values, commanded.values, strict=True)
        off = [abs(_wrapped(actual - angle)) for actual, angle in pairs]
        return 0 < max(off) <= NEAR * self.step and len({*other.values}) > 1

    def _asked(
        self, found: str, answers: Mapping[str, str], setting: str = "sheet.columns"
    ) -> UndecidedError:
        return undecided(f"{self.where}{found}", setting, tuple(answers.items()), self.proposal)

    def _require_positions(
        self, found: Sequence[Decimal], measured: Angles, commanded: Angles
    ) -> None:
        """Raise a question where measured angles are none of the positions beside them."""
        k = max(range(len(found)), key=lambda row: abs(found[row]))
        if abs(found[k]) > NEAR * self.step:
            cell, angle = measured.cells[k], commanded.cells[k]
            raise self._asked(
                f"{measured.text!r} is {cell} in row {self.rows[k]}, where {angle} was commanded: "
                "too far off for an actual position",
                {meaning("deviation", measured.text): f"the deviation at {angle} is {cell}"},
            )

    def _require_small(self, stated: Angles, commanded: Angles) -> None:
        """Raise a question where deviations grow with the angle by 1: they are positions."""
        x, y = ([float(value) for value in each.values] for each in (commanded, stated))
        middle = sum(x) / len(x)
        spread = sum((a - middle) ** 2 for a in x)
        slope = sum((a - middle) * b for a, b in zip(x, y, strict=True)) / (spread or 1.0)
        if spread and abs(abs(slope) - 1.0) < _BY_ONE:
            last = (y[-1] - x[-1]) / DEGREE
            raise self._asked(
                f"{stated.text!r} grows with the table angle by {slope:.2f}, as positions do and "
                "deviations do not",
                {"positions": f"actual positions: the last deviation is {last:.6g} degrees"},
                "sheet.values",
            )

    def _agreed(
        self, found: Sequence[Decimal], measured: Angles, commanded: Angles, beside: Angles
    ) -> tuple[Sequence[Decimal], str]:
        """Return a stated difference that is ``found`` as actual - commanded too; else ask.

        They agree within the last digits that stand there.
        """
        noise = beside.rounding + measured.rounding  # what was commanded is exact
        same = [abs(a - b) for a, b in zip(beside.values, found, strict=True)]
        opposite = max(abs(a + b) for a, b in zip(beside.values, found, strict=True)) <= noise
        checked = phrase("{0} is checked: actual - commanded", repr(beside.text))
        if max(same) <= noise and opposite and max(map(abs, beside.values)) > beside.rounding:
            return beside.values, phrase("{0} is finer than its angles", repr(beside.text))
        if max(same) <= noise:
            return beside.values, checked
        if opposite and REVERSED in self.columns:
            return found, checked
        k = max(range(len(same)), key=same.__getitem__)
        how = "commanded - actual" if opposite else "not actual - commanded"
        raise self._asked(
            f"{beside.text!r} is {how}: "
            f"{beside.cells[k]} in row {self.rows[k]}, with actual {measured.cells[k]} and "
            f"commanded {commanded.cells[k]}",
            {
                meaning(ACTUAL, measured.text): f"{measured.text} - {commanded.text}",
                meaning("deviation", beside.text): f"{beside.text} as it stands",
            },
        )


def _wrapped(angle: Decimal) -> Decimal:
    """Return an angle (rad) less whole turns, exactly where it has none."""
    return angle - _TURN * (angle / _TURN).to_integral_value()
