"""Deviations of a table: actual - commanded, as a column of their own or of both angles.

What stands there twice is held against each other; what may have either sign, or may be positions
in place of deviations, is asked.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from itertools import pairwise
from typing import Final

from rotcal_ros.foundation.errors import UndecidedError
from rotcal_ros.foundation.language import phrase
from rotcal_ros.foundation.table_columns import (
    ANGLE,
    AS_IT_STANDS,
    COUNTS,
    UNITS,
    SheetSettings,
    meaning,
    undecided,
)
from rotcal_ros.foundation.units import ARCSEC, DEGREE, TURN
from rotcal_tables.sheets.counters import (
    COUNTER_BITS,
    counter_period,
    fits_counter,
    usual_counts_near,
)
from rotcal_tables.sheets.words import ACTUAL, REVERSED, TABLE_ANGLE

NEAR_COMMANDED: Final = 0.25
"""Share of the smallest step of commanded angles within which an actual one belongs to it."""
_OF_A_WRAP: Final = 0.125
"""Share of the counts of a counter within which deviations show that it is this one."""
_BY_ONE: Final = 0.2
"""By how much the slope of positions over commanded angles may differ from 1."""
_MOST_OF_A_TURN: Final = 0.8 * TURN
_ALL: Final = 0.99
"""Share of the spread that a trend explains where nothing else is left."""
_DIGITS: Final = 9
"""Digits behind the point of a number that a program has computed."""
_FRACTION: Final = re.compile(r"[.,](\d+)\D*$")
ACTUAL_MINUS_COMMANDED: Final = phrase("deviation = actual - commanded")
COMMANDED_MINUS_ACTUAL: Final = phrase("commanded - actual, turned")
_TURN: Final = 360 * UNITS[ANGLE]["deg"]


@dataclass(frozen=True)
class AngleColumn:
    """A column of angles: its heading ``text``, its ``cells``, and their ``values`` in rad.

    ``unit`` is that of the cells, ``size`` what one of it is (rad).
    """

    text: str
    cells: Sequence[str]
    values: Sequence[Decimal]
    unit: str
    size: Decimal

    @property
    def fractions(self) -> list[str]:
        """Return the digits behind the point of each value."""
        return [found[1] if (found := _FRACTION.search(cell)) else "" for cell in self.cells]

    @property
    def rounding(self) -> Decimal:
        """By how much (rad) a value may be rounded, and as much again."""
        sixtieths = any(":" in cell or "°" in cell for cell in self.cells)
        digits = min(max(map(len, self.fractions)), _DIGITS)
        size = UNITS[ANGLE]["arcsec"] if sixtieths else self.size
        return size * Decimal(10) ** -digits

    def is_rounder(self, other: AngleColumn) -> bool:
        """Return whether the values need fewer digits than others, which have no even step."""
        own, theirs = (max(len(f.rstrip("0")) for f in a.fractions) for a in (self, other))
        values = sorted({*other.values})
        steps = [b - a for a, b in pairwise(values) if b - a > 2 * other.rounding]
        off = [abs(s - min(steps) * (s / min(steps)).to_integral_value()) for s in steps]
        return own < theirs and max(off, default=0) > 4 * other.rounding


@dataclass(frozen=True)
class StatedDeviations:
    """What a table says of its deviations: ``columns`` by what they are, in ``rows`` of a file.

    ``where`` names it; ``settings`` are what a person said of it, ``others`` angles of no known
    name: where they follow the commanded ones, within NEAR of the smallest ``step`` (rad), the
    deviation is held against them. ``proposal`` shows the columns side by side.
    """

    where: str
    rows: Sequence[int]
    columns: Mapping[str, AngleColumn]
    proposal: Sequence[str]
    step: float
    others: Sequence[AngleColumn] = ()
    settings: SheetSettings = AS_IT_STANDS

    def read(self) -> tuple[Sequence[Decimal], str]:
        """Return the deviations (rad) and how they were understood; a question where it is open.

        The table has measured angles beside commanded ones, or a column of differences.
        """
        columns = self.columns
        commanded, measured = columns.get(TABLE_ANGLE), columns.get(ACTUAL)
        stated = columns.get("deviation")
        if self.settings.values == "positions" and stated and not measured:
            stated, measured = None, stated
        if commanded and stated and not measured:
            measured = next(
                (each for each in self.others if self._is_beside(commanded, each)), None
            )
        if commanded and measured:
            found = self._differences(
                measured, commanded, self.settings.counter, self.settings.zero
            )
            if measured.unit == COUNTS:
                self._require_counts_of_a_turn(found, measured, commanded)
            self._require_positions(found, measured, commanded)
            self._require_finer(measured, commanded)
            if stated is None and REVERSED not in columns:
                return found, ACTUAL_MINUS_COMMANDED
            return self._agreed(found, measured, commanded, stated or columns[REVERSED])
        if stated:
            if commanded and self.settings.values not in ("deviations", "corrections"):
                self._require_small(stated, commanded)
            if self.settings.values == "corrections":
                return [-value for value in stated.values], COMMANDED_MINUS_ACTUAL
            return stated.values, ""
        return self._of_either_sign(columns[REVERSED])

    def _of_either_sign(self, either: AngleColumn) -> tuple[Sequence[Decimal], str]:
        """Return differences whose sign a person has stated; else raise the question."""
        if REVERSED in self.settings.named() or self.settings.values == "corrections":
            return [-value for value in either.values], COMMANDED_MINUS_ACTUAL
        if self.settings.values == "deviations":
            return either.values, ""
        k = max(range(len(self.rows)), key=lambda row: abs(either.values[row]))
        raise ask_sign(
            f"{self.where}row {self.rows[k]}, {either.text!r}", float(either.values[k]),
            self.proposal,
        )  # fmt: skip

    def _differences(
        self, measured: AngleColumn, commanded: AngleColumn, counter: str, zero: str
    ) -> list[Decimal]:
        """Return actual - commanded (rad), less whole turns and what a ``counter`` loses.

        From row to row a counter has gone as far as was commanded, but for the deviations.
        """
        pairs = list(zip(measured.values, commanded.values, strict=True))
        found = [actual - angle for actual, angle in pairs]
        if counter:
            period = measured.size * counter_period(counter)
            for k, ((a, x), (b, y)) in enumerate(pairwise(pairs), start=1):
                found[k] = found[k - 1] + _wrapped(b - a - _wrapped(y - x), period)
        first = found[0] if zero == "first" else Decimal(0)
        return [_wrapped(each - first) for each in found]

    def _is_beside(self, commanded: AngleColumn, other: AngleColumn) -> bool:
        pairs = zip(other.values, commanded.values, strict=True)
        off = [abs(_wrapped(actual - angle)) for actual, angle in pairs]
        return 0 < max(off) <= NEAR_COMMANDED * self.step and len({*other.values}) > 1

    def _asked(
        self, found: str, answers: Mapping[str, str], setting: str = "sheet.columns"
    ) -> UndecidedError:
        return undecided(f"{self.where}{found}", setting, tuple(answers.items()), self.proposal)

    def _require_positions(
        self, found: Sequence[Decimal], measured: AngleColumn, commanded: AngleColumn
    ) -> None:
        """Raise a question where measured angles are none of the positions beside them."""
        k = max(range(len(found)), key=lambda row: abs(found[row]))
        if abs(found[k]) > NEAR_COMMANDED * self.step:
            ways = {way: off for way, off in self._ways(measured, commanded)
                    if off <= NEAR_COMMANDED * self.step}  # fmt: skip
            if self.settings.zero == "table" and (self.settings.counter, "first") in ways:
                return
            if ways:
                raise self._other_way(ways, measured, found[0])
            cell, angle = measured.cells[k], commanded.cells[k]
            place = f"{measured.text!r} is {cell} in row {self.rows[k]}, where {angle} was"
            if measured.unit == COUNTS:
                raise self._asked(
                    f"{place} commanded: not by {round(float(_TURN / measured.size))} counts in a "
                    "turn, nor by a counter that wraps at a power of two",
                    {"N": "the counts after which the counter begins anew"},
                    "sheet.counter",
                )
            raise self._asked(
                f"{place} commanded: too far off for an actual position",
                {meaning("deviation", measured.text): f"the deviation at {angle} is {cell}"},
            )

    def _require_finer(self, measured: AngleColumn, commanded: AngleColumn) -> None:
        """Raise a question where commanded and measured angles seem to stand the other way."""
        sure = measured.unit == COUNTS or TABLE_ANGLE in self.settings.named()
        if not sure and measured.is_rounder(commanded):
            raise self._asked(
                f"{measured.text!r} is rounder than {commanded.text!r}, as commanded angles "
                f"are: {measured.cells[-1]} and {commanded.cells[-1]} in row {self.rows[-1]}",
                {meaning(TABLE_ANGLE, each.text): f"{each.text} was commanded"
                 for each in (measured, commanded)},
            )  # fmt: skip

    def _ways(
        self, measured: AngleColumn, commanded: AngleColumn
    ) -> Iterator[tuple[tuple[str, str], float]]:
        """Yield counter and zero that may be meant, with the largest deviation then (rad)."""
        cells = [float(value / measured.size) for value in measured.values]
        counters = [self.settings.counter]
        if measured.unit == COUNTS and not self.settings.counter:
            counters += [bits for bits in COUNTER_BITS if fits_counter(cells, bits)]
        for counter in counters:
            for zero in (self.settings.zero, "first"):
                found = self._differences(measured, commanded, counter, zero)
                off = float(max(map(abs, found)))
                if not counter or off <= _OF_A_WRAP * counter_period(counter) * float(
                    measured.size
                ):
                    yield (counter, zero), off

    def _other_way(
        self, ways: Mapping[tuple[str, str], float], measured: AngleColumn, first: Decimal
    ) -> UndecidedError:
        """Return the question where a counter wraps, or where its zero is."""
        plain = {counter for counter, _ in ways}
        if self.settings.counter not in plain:
            off = {counter: min(ways[way] for way in ways if way[0] == counter)
                   for counter, _ in ways}  # fmt: skip
            return self._asked(
                f"{measured.text!r} follows the commanded angles only if its counter wraps",
                {bits: f"a counter of {bits} bits: then no deviation is more than "
                 f"{off[bits] / DEGREE:.6g} degrees" for bits in off},
                "sheet.counter",
            )  # fmt: skip
        offset = float(first) / DEGREE
        return self._asked(
            f"{measured.text!r} is {offset:.6g} degrees off in row {self.rows[0]}, and follows "
            "the commanded angles from there",
            {
                "first": "its zero is another one than the table's: deviations from that row",
                "table": f"its zero is the table's, which stands {offset:.6g} degrees off",
            },
            "sheet.zero",
        )

    def _require_counts_of_a_turn(
        self, found: Sequence[Decimal], measured: AngleColumn, commanded: AngleColumn
    ) -> None:
        """Raise a question where nothing but a trend over a turn is left: a wrong scale.

        A table comes back to where it was, so a deviation cannot grow evenly all around.
        """
        x, y = ([float(value) for value in each] for each in (commanded.values, found))
        if max(x) - min(x) < _MOST_OF_A_TURN:
            return
        slope, share = _trend(x, y)
        now = round(float(_TURN / measured.size))
        about = now * (1.0 + slope)
        if share > _ALL and abs(about - now) >= 1.0:
            raise self._asked(
                f"the deviations grow evenly to {slope * 360.0:.6g} degrees in a turn, as they do "
                f"where a turn has {about:.9g} counts and not {now}",
                {str(n): f"{n} counts" for n in usual_counts_near(about) or [round(about)]},
                "sheet.counts_per_turn",
            )

    def _require_small(self, stated: AngleColumn, commanded: AngleColumn) -> None:
        """Raise a question where deviations grow with the angle by 1: they are positions."""
        x, y = ([float(value) for value in each.values] for each in (commanded, stated))
        slope, _ = _trend(x, y)
        if abs(abs(slope) - 1.0) < _BY_ONE:
            last = (y[-1] - x[-1]) / DEGREE
            raise self._asked(
                f"{stated.text!r} grows with the table angle by {slope:.2f}, as positions do and "
                "deviations do not",
                {"positions": f"actual positions: the last deviation is {last:.6g} degrees"},
                "sheet.values",
            )

    def _agreed(
        self,
        found: Sequence[Decimal],
        measured: AngleColumn,
        commanded: AngleColumn,
        beside: AngleColumn,
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


def ask_sign(place: str, value: float, proposal: Sequence[str] = ()) -> UndecidedError:
    """Return the question whether a ``value`` (rad) is a deviation or a correction.

    Its answers say what both would do at one angle.
    """
    arcsec = value / ARCSEC
    far, short = ("too far", "too little") if arcsec > 0.0 else ("too little", "too far")
    ways = {"deviations": (far, -arcsec), "corrections": (short, arcsec)}
    return undecided(
        f"{place}: {arcsec:.6g} arcsec may be a deviation (actual - commanded) or a correction "
        "(commanded - actual)",
        "sheet.values",
        [
            (meant, f"there the axis stands {abs(arcsec):.6g} arcsec {where}; the control will "
             f"add {added:+.6g} arcsec to the command")
            for meant, (where, added) in ways.items()
        ],
        proposal,
    )  # fmt: skip


def _wrapped(angle: Decimal, period: Decimal = _TURN) -> Decimal:
    """Return an angle (rad) less whole periods, exactly where it has none."""
    return angle - period * (angle / period).to_integral_value()


def _trend(x: Sequence[float], y: Sequence[float]) -> tuple[float, float]:
    """Return the slope of y over x, and the share of the spread of y that it explains."""
    count = len(x)
    x, y = ([value - sum(each) / count for value in each] for each in (x, y))
    xx, yy = (sum(value**2 for value in each) for each in (x, y))
    xy = sum(a * b for a, b in zip(x, y, strict=True))
    return xy / (xx or 1.0), xy**2 / ((xx * yy) or 1.0)
