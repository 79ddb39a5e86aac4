"""Page one: what was calibrated and what came out, in one sentence, one figure and one table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from rotcal_ros.evaluation.bidirectional import runs_of
from rotcal_ros.evaluation.conformity import RULE, conformities
from rotcal_ros.evaluation.iso230 import iso230
from rotcal_ros.evaluation.marks import not_covered
from rotcal_ros.foundation.components import COVERAGE_FACTOR, unit_of
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.gum_numbers import (
    place_of,
    uncertainty,
    value,
    value_to,
    value_with_uncertainty,
)
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import ARCSEC, DEGREE

FEW_SENTENCES: Final = 2
"""Up to this many components have a sentence each; more of them a table of ranges."""
FEW_ROWS: Final = 8
"""Up to this many angles the values of one component stand in a single block."""
BLOCKS: Final = 3
NO_U: Final = "–"
K: Final = f"(k\N{NO-BREAK SPACE}=\N{NO-BREAK SPACE}{COVERAGE_FACTOR:g})"


@dataclass(frozen=True, slots=True)
class ValueBlock:
    """A part of the table of values: headings of its columns, and its rows as text."""

    head: Sequence[str]
    rows: Sequence[Sequence[str]]


def sentences(result: Result, withheld: str | None) -> list[str]:
    """Return the result in words: ranges with U, and figures of ISO 230-2 if there are runs."""
    few = len(result.components) <= FEW_SENTENCES
    texts = [_range(result, name, withheld) for name in result.components if few]
    if figures := _positioning(result, withheld):
        texts.append(figures)
    return texts


def ranges(result: Result, withheld: str | None) -> ValueBlock | None:
    """Return lowest, highest, range and largest U of many components; None for few."""
    if len(result.components) <= FEW_SENTENCES:
        return None
    rows = []
    for name in result.components:
        ends = _ends(result, name)
        largest = NO_U if withheld else f"{ends.largest_u} {ends.unit}"
        texts = (ends.low, ends.high, ends.span)
        rows.append([name, *(f"{text} {ends.unit}" for text in texts), largest])
    return ValueBlock(["Deviation", "lowest", "highest", "range", f"U {K}, at most"], rows)


def statement_of_u(result: Result, withheld: str | None) -> str:
    """Return the definition of U, or the reason for which it is not stated."""
    if withheld:
        return f"U: not stated, because {withheld}."
    text = (
        "U is the expanded uncertainty, the standard uncertainty multiplied by the coverage "
        f"factor k = {COVERAGE_FACTOR:g} (about 95 % for a normal distribution), JCGM 100:2008."
    )
    missing = not_covered(result)
    return f"{text} It does not cover: {', '.join(missing)}." if missing else text


def statements_of_conformity(result: Result, withheld: str | None) -> list[str]:
    """Return within, beyond or undecided for every component that has a tolerance."""
    found = conformities(result, result.circumstances.identity)
    if not found:
        return []
    if withheld:
        return ["No statement of conformity, because U is not stated."]
    return [f"{conformity.in_words(result)} (decision rule: {RULE})." for conformity in found]


def value_blocks(result: Result, withheld: str | None) -> list[ValueBlock]:
    """Return the table of values, in blocks side by side if it is long and narrow."""
    if len(result.components) > 1:
        head = ["Angle / °", *(f"{name} ± U / {unit_of(name)[1]}" for name in result.components)]
        return [ValueBlock(head, _wide_rows(result, withheld))]
    (name,) = result.components
    unit = unit_of(name)[1]
    rows = _narrow_rows(result, name, withheld)
    size = len(rows) if len(rows) <= FEW_ROWS else -(-len(rows) // BLOCKS)
    head = ["Angle / °", f"{name} / {unit}", f"U / {unit}"]
    return [ValueBlock(head, rows[i : i + size]) for i in range(0, len(rows), size)]


def degrees(angle: float) -> str:
    """Return an angle (rad) in degrees, with at most four decimals."""
    text = f"{angle / DEGREE:.4f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else minus(text)


def minus(number: str) -> str:
    """Return a number as typeset: with a minus sign instead of a hyphen."""
    return number.replace("-", "\N{MINUS SIGN}")


@dataclass(frozen=True, slots=True)
class _Ends:
    """Lowest and highest value of a component as text, with the digits for its largest U."""

    low: str
    high: str
    span: str
    largest_u: str
    unit: str


def _ends(result: Result, name: str) -> _Ends:
    unit, label = unit_of(name)
    values = result.deviations[name] / unit
    largest = COVERAGE_FACTOR * float(result.std[name].max()) / unit
    low, high = (minus(value(float(end), largest)) for end in (values.min(), values.max()))
    span = float(np.ptp(values))
    whole = value_to(span, place_of(largest)) if largest else f"{span:.6g}"
    return _Ends(low, high, whole, uncertainty(largest), label)


def _range(result: Result, name: str, withheld: str | None) -> str:
    """Return lowest, highest and range of one component in one sentence."""
    ends = _ends(result, name)
    text = (
        f"{name} lies between {ends.low} and {ends.high} {ends.unit}, a range of {ends.span} "
        f"{ends.unit}"
    )
    if withheld:
        return f"{text}; U is not stated."
    return f"{text}, with U ≤ {ends.largest_u} {ends.unit} {K}."


def _positioning(result: Result, withheld: str | None) -> str | None:
    """Return E, A and R after ISO 230-2; None without runs in both directions."""
    try:
        runs = runs_of(result)
    except DataError:
        return None
    if runs is None:
        return None
    found = iso230(runs)
    texts = []
    for name, key in (("E", "systematic"), ("A", "accuracy"), ("R", "repeatability")):
        number = getattr(found, key) / ARCSEC
        expanded = found.uncertainties[key].expanded / ARCSEC
        shown = value_with_uncertainty(number, expanded).lstrip("+")
        texts.append(f"{name} = {shown.split(' ')[0] if withheld else shown} arcsec")
    count = runs.forward.shape[1]
    probability = "." if withheld else " (95 %)."
    return f"After ISO 230-2, from {count} runs in each direction: {', '.join(texts)}{probability}"


def _narrow_rows(result: Result, name: str, withheld: str | None) -> list[list[str]]:
    unit, _ = unit_of(name)
    rows = []
    for angle, deviation, std in zip(
        result.angles, result.deviations[name] / unit, result.std[name] / unit, strict=True
    ):
        expanded = COVERAGE_FACTOR * float(std)
        stated = NO_U if withheld else uncertainty(expanded)
        rows.append([degrees(angle), minus(value(float(deviation), expanded)), stated])
    return rows


def _wide_rows(result: Result, withheld: str | None) -> list[list[str]]:
    rows = []
    for i, angle in enumerate(result.angles):
        cells = []
        for name in result.components:
            unit, _ = unit_of(name)
            number = float(result.deviations[name][i]) / unit
            expanded = COVERAGE_FACTOR * float(result.std[name][i]) / unit
            write = value if withheld else value_with_uncertainty
            cells.append(minus(write(number, expanded)))
        rows.append([degrees(angle), *cells])
    return rows
