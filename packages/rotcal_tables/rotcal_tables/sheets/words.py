"""The words of tables of numbers: columns and units, in the languages of ``words.yaml``."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path
from typing import Any, Final

import yaml

from rotcal_ros.foundation.table_columns import (
    ANGLE,
    BEHIND,
    COUNTS,
    IN_BRACKETS,
    LENGTH,
    SMALL_ANGLES,
    TIME,
    UNITS,
    folded,
    meaning,
    option,
    plain,
    quantity_of,
    without_accents,
    words_of,
)

TABLE_ANGLE: Final = "angle"
"""A column of table angles, which stand for numbers of positions."""
DIRECTION: Final = "direction"
RUN: Final = "run"
"""Columns that say which visit of a table angle it was."""
NOTHING: Final = "nothing"
"""What a person says of a column that is no matter."""
SETTING: Final = "setting"
"""A column of settings of a reference beside the table."""
ACTUAL: Final = "actual"
"""A column of angles that were measured: its deviation is actual - commanded."""
REVERSED: Final = "reversed"
"""A column of commanded - actual, or of either sign."""
REFERENCE: Final = "reference"
"""A column of angles that may be the commanded or the measured ones."""
_QUANTITIES: Final = {
    **dict.fromkeys(("length", "d", "x", "y", "z", "sx", "sy", "sz"), LENGTH),
    **dict.fromkeys((TABLE_ANGLE, ACTUAL, REFERENCE, *SMALL_ANGLES), ANGLE),
    "time": TIME,
}
"""TableColumn -> what it measures; all others are numbers from 0, or words."""
_LABEL: Final = re.compile(r"(?:(\D*[^\W\d_])[\W_]*|#\s*)?([0-9]{1,9})(?:\.0*)?")
_AXES: Final = frozenset("abc")
"""Letters of rotary axes, where a word for what was commanded or measured stands beside them."""


@dataclass(frozen=True, slots=True)
class Heading:
    """The text at the head of a column: its name and the units that it may state."""

    text: str
    name: str = ""
    units: tuple[str, ...] = ()

    @classmethod
    def of(cls, text: str) -> Heading:
        """Return name and unit of a text.

        >>> Heading.of("Länge [mm]")
        Heading(text='Länge [mm]', name='Länge', units=('mm',))
        >>> Heading.of("length_m").units, Heading.of("angle_deg").units
        (('m',), ('deg',))
        """
        for pattern in (IN_BRACKETS, BEHIND):
            found = pattern.fullmatch(plain(text))
            if found and (units := units_of(found[2])):
                return cls(text, found[1].removesuffix(" in").strip(), units)
        return cls(text, plain(text))


@lru_cache(4096)
def heading_columns(head: Heading) -> tuple[str, ...]:
    """Return the columns that a heading may be the name of; none if it is no name of any.

    A nominal length or place is none: it was not measured. A position in degrees is an angle, of
    the table where it was commanded, ACTUAL where it was measured.

    >>> [heading_columns(Heading.of(t)) for t in ("Tgt_pos [deg]", "Istwert [°]", "Ist - Soll")]
    [('angle',), ('actual',), ('deviation',)]
    """
    parts = _apart(head.name)
    role = _role(parts)
    found = _named(parts)
    if role in ("deviation", REVERSED):
        found = (role,)
    elif role and {TABLE_ANGLE, "position"}.intersection(found):
        rest = tuple(name for name in found if name != TABLE_ANGLE)
        found = (TABLE_ANGLE if role == "commanded" else role, *rest)
    elif role and not set(parts) - _roles().keys() - _fillers() - _AXES:  # nothing else is said
        found = (*found, TABLE_ANGLE if role == "commanded" else role)
    elif role == "commanded":
        found = tuple(name for name in found if _QUANTITIES.get(name) in (None, ANGLE))
    quantities = {quantity_of(unit) for unit in head.units}
    if not quantities:
        return found
    if head.units == (COUNTS,) and not found:
        return (ACTUAL,)  # whatever it is called, an encoder has counted them
    if ANGLE in quantities and found and set(found) <= {"position", "target"}:
        return (TABLE_ANGLE,)
    return tuple(name for name in found if _QUANTITIES.get(name) in quantities)


def is_commanded(text: str) -> bool:
    """Return whether a heading says that something was commanded."""
    return _role(_apart(Heading.of(text).name)) == "commanded"


def _named(parts: Sequence[str]) -> tuple[str, ...]:
    """Return the columns that the parts of a heading name, with and without words of no use."""
    bare = [part for part in parts if part not in _fillers()]
    rest = [part for part in bare if part not in _roles()]
    names = (
        "".join(parts),
        "".join(bare),
        "".join(rest),
        "".join(p for p in rest if p not in _AXES),
    )
    return next((_columns()[name] for each in names for name in (each, _without_fillers(each))
                 if name in _columns()), ())  # fmt: skip


def _role(parts: Sequence[str]) -> str:
    """Return what a heading says of its angles: commanded, ACTUAL, REFERENCE or a difference."""
    roles = dict.fromkeys(_roles()[part] for part in parts if part in _roles())
    first, *others = roles or [""]
    if not others:
        return first
    return "deviation" if first == ACTUAL or others == ["commanded"] else REVERSED


def _apart(text: str) -> list[str]:
    """Return the words of a heading; Sollwinkel and TargetAngle are two."""
    return [word for part in words_of(text) for word in _compound(part)]


def _compound(part: str) -> Sequence[str]:
    """Return a word as one for what was ordered or measured, and the name of a column."""
    if part in _columns() or part in _roles():
        return (part,)
    for role in _roles():
        first, last = part.removeprefix(role), part.removesuffix(role)
        for rest, words in ((first, (role, first)), (last, (last, role))):
            if 1 < len(rest) < len(part) and (_columns().keys() & {rest, _without_fillers(rest)}):
                return words if len(rest) > 2 or not rest.isascii() else (part,)
    return (part,)


def column_option(column: str, text: str) -> str:
    """Return the setting by which a person says that a heading means a column.

    >>> print(column_option("length", "Weg [mm]"))
    --set 'sheet.columns=["length=Weg [mm]"]'
    """
    return option("sheet.columns", meaning(column, text))


def known_columns() -> tuple[str, ...]:
    """Return the columns that have names in our words."""
    return (*_words()["columns"], ACTUAL, REVERSED, NOTHING)


def units_of(text: str) -> tuple[str, ...]:
    """Return the units that ``text`` may be, by the names of UNITS; none if it is no unit.

    >>> units_of("Grad"), units_of("inch"), units_of("furlong")
    (('deg', 'gon'), ('in',), ())
    """
    return _units().get(_unit(text), ())


def parse_label(text: str) -> tuple[str, int] | None:
    """Return word and number of a label, whose word may be empty; None for a text that is none.

    >>> parse_label("SMR-07"), parse_label("#3"), parse_label("12.0"), parse_label("-5")
    (('SMR', 7), ('', 3), ('', 12), None)
    """
    found = _LABEL.fullmatch(plain(text))
    return (found[1] or "", int(found[2])) if found else None


def units_of_quantity(units: Sequence[str], quantity: str) -> tuple[str, ...]:
    """Return those of the units that measure a quantity, as sec of angles; all where none does."""
    return tuple(unit for unit in units if quantity_of(unit) == quantity) or tuple(units)


def is_summary_word(text: str) -> bool:
    """Return whether a text begins a line about other lines, as Mean or Mittelwert do."""
    return folded(text) in _summaries()


def is_blank_word(text: str) -> bool:
    """Return whether a text stands where nothing was measured."""
    return text.strip().lower() in _nothing()


def point_kind(text: str) -> str:
    """Return the kind of a tracker's point in our word, or the text as it stands."""
    return _kinds().get(folded(text), text)


def is_descending(text: str) -> bool | None:
    """Return whether a direction is that of shrinking angles; None for a text that says neither.

    >>> is_descending("Rück"), is_descending("+"), is_descending("left")
    (True, False, None)
    """
    return _directions().get(_way(text))


def is_direction_word(text: str) -> bool:
    """Return whether a text says a direction, perhaps one of either sign, as clockwise."""
    return _way(text) in _directions()


def _way(text: str) -> str:
    return folded(text) if any(map(str.isalpha, text)) else _unit(text)


def _without_fillers(name: str) -> str:
    """Return a name in a script without spaces less the words that say nothing at its ends."""
    for filler in sorted(_fillers(), key=len, reverse=True):
        if not filler.isascii():
            name = name.removeprefix(filler).removesuffix(filler)
    return name


def _unit(text: str) -> str:
    return without_accents(plain(text)).strip(" .:").casefold().replace("\u03bc", "u")


@cache
def _words() -> dict[str, Any]:
    text = Path(__file__).with_name("words.yaml").read_text(encoding="utf-8")
    words: dict[str, Any] = yaml.safe_load(text)
    return words


def _listed(languages: Mapping[str, str]) -> Iterator[str]:
    for words in languages.values():
        yield from (word.strip() for word in words.split(";"))


@cache
def _columns() -> dict[str, tuple[str, ...]]:
    found: dict[str, dict[str, None]] = {}
    for column, languages in _words()["columns"].items():
        for name in (column, *_listed(languages)):
            found.setdefault(folded(name), {})[column] = None
    return {name: tuple(columns) for name, columns in found.items()}


@cache
def _units() -> dict[str, tuple[str, ...]]:
    found: dict[str, list[str]] = {}
    for units in UNITS.values():
        for unit in units:
            for name in (unit, *_words()["units"].get(unit, "").split(";")):
                found.setdefault(_unit(name), []).append(unit)
    return {name: tuple(dict.fromkeys(units)) for name, units in found.items() if name}


@cache
def _kinds() -> dict[str, str]:
    kinds = _words()["kinds"]
    return {folded(word): kind for kind, languages in kinds.items() for word in _listed(languages)}


@cache
def _directions() -> dict[str, bool | None]:
    directions = _words()["directions"]
    return {
        _way(word): {"up": False, "down": True}.get(direction)
        for direction, languages in directions.items()
        for word in _listed(languages)
    }


@cache
def _fillers() -> frozenset[str]:
    return frozenset(map(folded, _listed(_words()["fillers"])))


@cache
def _roles() -> dict[str, str]:
    """Return the words that say whether an angle was commanded or measured."""
    groups = {"nominal": "commanded", "actual": ACTUAL, "reference": REFERENCE}
    return {
        folded(word): role for group, role in groups.items() for word in _listed(_words()[group])
    }


@cache
def _summaries() -> frozenset[str]:
    return frozenset(map(folded, _listed(_words()["summaries"])))


@cache
def _nothing() -> frozenset[str]:
    return frozenset(word.lower() for word in _listed(_words()["nothing"])) | {""}
