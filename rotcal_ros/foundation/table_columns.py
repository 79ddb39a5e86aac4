"""Columns of tables: their names and units, and what a person says of them."""

from __future__ import annotations

import re
import shlex
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from typing import Final

import yaml

from rotcal_ros.foundation.errors import ConfigurationError, Question, UndecidedError
from rotcal_ros.foundation.settings import expert, setting

LENGTH: Final = "length"
ANGLE: Final = "angle"
TIME: Final = "time"
COUNTS: Final = "counts"
"""Unit of an encoder: a turn has as many as a person says."""
SMALL_ANGLES: Final = ("deviation", "u", "expanded", "uncertainty", "reading", "reversed")
"""Columns of angles whose unit is another than that of the table angles."""
_PI: Final = Decimal("3.14159265358979323846264338327950288")
UNITS: Final[Mapping[str, Mapping[str, Decimal]]] = {
    LENGTH: {
        "m": Decimal(1), "cm": Decimal("1e-2"), "mm": Decimal("1e-3"), "um": Decimal("1e-6"),
        "nm": Decimal("1e-9"), "in": Decimal("25.4e-3"), "ft": Decimal("0.3048"),
    },
    ANGLE: {
        "rad": Decimal(1), "mrad": Decimal("1e-3"), "urad": Decimal("1e-6"), "deg": _PI / 180,
        "mdeg": _PI / 180_000, "arcmin": _PI / 10_800, "arcsec": _PI / 648_000, "gon": _PI / 200,
        "mgon": _PI / 200_000, "dms": _PI / 180, "m:s": _PI / 10_800, COUNTS: 2 * _PI,
    },
    TIME: {
        "s": Decimal(1), "ms": Decimal("1e-3"), "us": Decimal("1e-6"), "ns": Decimal("1e-9"),
        "min": Decimal(60), "h": Decimal(3600),
    },
}  # fmt: skip
"""Quantity -> unit -> size in metres, radians, seconds; that of counts is a turn."""
_SUFFIXES: Final = {"_m": LENGTH, "_rad": ANGLE, "_s": TIME}
_APART: Final = re.compile(r"[\W_]+")
IN_BRACKETS: Final = re.compile(r"(.*\S)\s*[\[({【]\s*([^\[\](){}【】]+?)\s*[\])}】]", re.S)
"""A name with a unit, or something else, behind it."""
BEHIND: Final = re.compile(r"(.*\S)(?:\s+in\s+|\s*[/,]\s*|[_\s]+)(\S+)", re.DOTALL)


@dataclass(frozen=True, slots=True)
class TableColumn:
    """A column of ours: ``name`` without unit, what it measures; empty: a number or a text."""

    header: str
    name: str
    quantity: str

    @classmethod
    def of(cls, header: str) -> TableColumn:
        """Return the column with the name ``header``, as length_m."""
        suffix = next((suffix for suffix in _SUFFIXES if header.endswith(suffix)), "")
        return cls(header, header.removesuffix(suffix), _SUFFIXES.get(suffix, ""))


@dataclass(frozen=True)
class SheetSettings:
    """How a table of numbers is read, where the table does not say so itself."""

    length_unit: str = setting(
        "", doc="unit of lengths whose column states none", choices=("", *UNITS[LENGTH])
    )
    angle_unit: str = setting(
        "", doc="unit of table angles whose column states none", choices=("", *UNITS[ANGLE])
    )
    reading_unit: str = expert(
        "", doc="unit of deviations and other readings of angles whose column states none",
        choices=("", *UNITS[ANGLE]),
    )  # fmt: skip
    angles: str = expert(
        "", doc="table angles that count where table and plan differ: those of table or plan",
        choices=("", "table", "plan"),
    )  # fmt: skip
    values: str = expert(
        "", doc="what stands beside commanded angles: deviations (actual - commanded), "
        "corrections (commanded - actual), or positions (actual angles)",
        choices=("", "deviations", "corrections", "positions"),
    )  # fmt: skip
    counts_per_turn: int = expert(
        0, doc="counts of the encoder in a turn of the table, negative where it counts down while "
        "the angle grows; 0: asked",
    )  # fmt: skip
    commanded_counts: int = expert(
        0, doc="counts in a turn of what was commanded, as steps of a motor; 0: as counts_per_turn"
    )
    counter: str = expert(
        "", doc="bits of a counter that wraps elsewhere than at a turn, or, beyond 64, the counts "
        "after which it does",
    )  # fmt: skip
    zero: str = expert(
        "", doc="where actual angles count from: the zero of the table, or the first row",
        choices=("", "table", "first"),
    )  # fmt: skip
    up: str = expert("", doc="direction in which the table angle grows, as the table calls it")
    time_unit: str = expert(
        "", doc="unit of times whose column states none", choices=("", *UNITS[TIME])
    )
    decimal: str = expert(
        "", doc="decimal mark, a point or a comma; empty: as the numbers show",
        choices=("", ".", ","),
    )  # fmt: skip
    counted_from: str = expert(
        "", doc="number of the first position and of the first target; empty: as the numbers show",
        choices=("", "0", "1"),
    )  # fmt: skip
    columns: tuple[str, ...] = setting(
        (), doc="columns by the text at their head where that says nothing, as length=Messwert"
    )
    names: str = expert(
        "", doc="what the names of points say, as P{position}_N{ball}; empty: nothing"
    )
    name: str = expert("", doc="sheet of a workbook that is read; empty: the one that fits")
    table: str = expert("", doc="which of several tables side by side on a sheet, from 1")

    def named(self) -> dict[str, str]:
        """Return column of ours -> text at its head; ConfigurationError for an entry without."""
        found = {}
        for entry in self.columns:
            name, _, text = (part.strip() for part in entry.partition("="))
            if not name or not text:
                raise ConfigurationError(
                    f"sheet.columns: {entry!r}: expected COLUMN=TEXT, as length=Weg"
                )
            found[TableColumn.of(name).name] = text
        return found


AS_IT_STANDS: Final = SheetSettings()
"""For a table that states everything itself."""


def meaning(column: str, text: str) -> str:
    """Return the entry of sheet.columns that says that a heading means a column.

    A heading may have an ``address`` by which it is named in place of its text.
    """
    return f"{column}={getattr(text, 'address', text)}"


def option(setting: str, value: str, *more: str) -> str:
    """Return the option that gives a setting a value; sheet.columns is a list, with ``more``.

    >>> print(option("sheet.decimal", ","))
    --set sheet.decimal=,
    """
    if setting == "sheet.columns":
        value = yaml.safe_dump(
            [value, *more], default_flow_style=True, default_style='"', allow_unicode=True,
            width=float("inf"),
        ).strip()  # fmt: skip
    return f"--set {shlex.quote(f'{setting}={value}')}"


def undecided(
    found: str, setting: str, answers: Sequence[tuple[str, str]], proposal: Sequence[str] = ()
) -> UndecidedError:
    """Return the error that asks a person: ``found``, and each answer with its option.

    ``answers`` are values of ``setting`` with what they would mean, ``proposal`` lines below it.
    """
    options = [option(setting, value) for value, _ in answers]
    meant = [f"{way}: {words}" for way, (_, words) in zip(options, answers, strict=True)]
    advice, log = f"say which: {' or '.join(options)}", "\n".join([*proposal, *meant])
    return UndecidedError(found, advice, log, Question(setting, tuple(answers)))


def unit_setting(name: str, quantity: str) -> str:
    """Return the setting of the unit of a column that states none."""
    if quantity == ANGLE:
        return "sheet.reading_unit" if name in SMALL_ANGLES else "sheet.angle_unit"
    return f"sheet.{quantity}_unit"


def quantity_of(unit: str) -> str:
    """Return what a unit measures; ``min`` is a time, ``arcmin`` an angle."""
    return next(name for name, units in UNITS.items() if unit in units)


def folded(text: str) -> str:
    """Return a name without capitals, accents and signs.

    >>> folded("Länge, gemessen"), folded("Zielpunkt-Nr.")
    ('langegemessen', 'zielpunktnr')
    """
    return "".join(words_of(text)) or text.strip()


def plain(text: str) -> str:
    """Return a text in the plain form of each character: one kind of minus, space, digit."""
    return unicodedata.normalize("NFKC", text).replace("\u2212", "-").strip()


def words_of(text: str) -> list[str]:
    """Return the words of a name, each folded."""
    return [part for part in _APART.split(without_accents(plain(text)).casefold()) if part]


def without_accents(text: str) -> str:
    """Return a text without the accents of Latin letters; other scripts keep their marks."""
    if text.isascii():
        return text
    apart, kept, latin = unicodedata.normalize("NFD", text), list[str](), False
    for character in apart:
        if not unicodedata.combining(character):
            latin = character.isascii()
        elif latin:
            continue
        kept.append(character)
    return unicodedata.normalize("NFC", "".join(kept))
