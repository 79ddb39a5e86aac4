"""Page one: what was calibrated and what came out, in one sentence, one figure and one table.

Beside the numbers a certificate states one fact per entry of ISO/IEC 17025, 7.8. ``item`` of a
fact is the clause of ISO/IEC 17025:2017 that requires it; a test holds the page against the whole
list.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from typing import Final

import numpy as np

from rotcal_ros import __version__
from rotcal_ros.evaluation.iso230 import iso230, runs_of
from rotcal_ros.evaluation.marks import RULE, conformities, further_statements, uncovered_effects
from rotcal_ros.foundation.circumstances import Circumstances, Range, StepCounts
from rotcal_ros.foundation.components import COVERAGE_FACTOR, unit_of
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.gum_numbers import (
    last_digit_place,
    typeset_minus,
    uncertainty,
    value,
    value_to_place,
    value_with_uncertainty,
)
from rotcal_ros.foundation.identity import Identity
from rotcal_ros.foundation.in_force import describe
from rotcal_ros.foundation.language import join_texts, noted, phrase
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import ARCSEC, DEGREE, NANOSECOND

NOT_STATED: Final = phrase("not stated")
ONLY_THIS_ITEM: Final = phrase(
    "The results relate only to the item calibrated, in the state and under the conditions named."
)
PASCAL_PER_HPA: Final = 100.0


@dataclass(frozen=True, slots=True)
class Fact:
    """One line of a certificate; an empty ``text`` is shown as not stated."""

    name: str
    text: str
    item: str = ""

    @property
    def stated(self) -> bool:
        """Whether anything is known."""
        return bool(self.text)

    @property
    def shown(self) -> str:
        """The text, or that there is none."""
        return self.text or NOT_STATED


def item_facts(result: Result, identity: Identity) -> list[Fact]:
    """Return what was calibrated, and for whom."""
    customer = [identity.customer, identity.customer_address]
    return [
        Fact(phrase("Item"), _item(identity), "7.8.2.1 g"),
        Fact(phrase("Axis"), result.circumstances.axis),
        Fact(phrase("Compensation in force"), describe(result.measured_on)),
        Fact(phrase("Tolerance"), _tolerance(identity)),
        Fact(phrase("Customer"), _joined(customer), "7.8.2.1 e"),
        Fact(phrase("Customer's number"), identity.customer_number),
        Fact(phrase("Received"), identity.received, "7.8.2.1 h"),
    ]


def calibration_facts(result: Result, identity: Identity, method: str, issued: str) -> list[Fact]:
    """Return who calibrated it, where, when and how."""
    how = phrase("{0}; rotcal_ros {1}", phrase(method), __version__)
    laboratory = [identity.laboratory, identity.laboratory_address, identity.laboratory_country]
    return [
        Fact(phrase("Laboratory"), _joined([*laboratory, identity.laboratory_email]), "7.8.2.1 b"),
        Fact(phrase("Place"), identity.place, "7.8.2.1 c"),
        Fact(phrase("Date of calibration"), _dates(result.circumstances), "7.8.2.1 i"),
        Fact(phrase("Date of issue"), issued, "7.8.2.1 j"),
        Fact(phrase("Operator"), identity.operator),
        Fact(phrase("Authorised by"), "", "7.8.2.1 o"),
        Fact(phrase("Method"), how, "7.8.2.1 f"),
        Fact(phrase("Conditions"), ambient_conditions(result.circumstances), "7.8.4.1 b"),
    ]


def plan_facts(result: Result, rejected_attempts: int) -> list[Fact]:
    """Return what was sampled, what was left out, and who else had a part in it."""
    counts = result.circumstances.counts
    skipped = (
        ""
        if counts is None
        else phrase("{0} of {1} steps were skipped", counts.skipped, counts.planned)
    )
    return [
        Fact(phrase("Sampling"), count_summary(result, counts, rejected_attempts), "7.8.2.1 k"),
        Fact(phrase("Deviations from the method"), skipped, "7.8.2.1 n"),
        Fact(phrase("External providers"), "", "7.8.2.1 p"),
    ]


def count_summary(result: Result, counts: StepCounts | None, rejected_attempts: int) -> str:
    """Return the true counts in one line."""
    rejected = phrase("{0} rejected by the solver", len(result.rejected))
    if counts is None:
        return phrase("{0} observations, {1}", result.n_observations, rejected)
    return phrase(
        "{0} steps planned or offered, {1} used, {2} skipped, {3} retried, {4}, {5} "
        "during the capture",
        counts.planned, counts.used, counts.skipped, counts.retried, rejected, rejected_attempts,
    )  # fmt: skip


def ambient_conditions(circumstances: Circumstances) -> str:
    """Return temperature, pressure and humidity with their ranges."""
    ranges = [
        _ranged(phrase("temperature"), circumstances.temperature_c, "°C", 2),
        _ranged(phrase("air pressure"), circumstances.pressure_pa, "hPa", 1, 1.0 / PASCAL_PER_HPA),
        _ranged(phrase("relative humidity"), circumstances.humidity, "%", 0, 100.0),
    ]
    return join_texts(ranges) if any(NOT_STATED not in text for text in ranges) else ""


def _ranged(name: str, found: Range | None, unit: str, digits: int, factor: float = 1.0) -> str:
    if found is None:
        return phrase("{0} {1}", name, NOT_STATED)
    mean, low, high = (
        f"{value * factor:.{digits}f}" for value in (found.mean, found.lowest, found.highest)
    )
    if found.lowest == found.highest:  # such as a value that the configuration states
        return phrase("{0} {1} {2}", name, mean, unit)
    return phrase("{0} {1} {2} ({3} to {4})", name, mean, unit, low, high)


def _item(identity: Identity) -> str:
    serial = phrase("no. {0}", identity.serial) if identity.serial else ""
    return _joined([identity.item, identity.maker, identity.model, serial])


def _tolerance(identity: Identity) -> str:
    limits = ((identity.tolerance_arcsec, "arcsec"), (identity.tolerance_um, "µm"))
    return _joined([f"±{limit:g} {unit}" for limit, unit in limits if limit])


def _dates(circumstances: Circumstances) -> str:
    """Return when it was measured, to the minute; the day once where it is one.

    Without stamps it is what the identity states. A simulated clock may run ahead of ours: so
    its times are called its own.
    """
    if circumstances.begun_ns is None or circumstances.ended_ns is None:
        return circumstances.identity.measured.replace("T", " ")
    begun, ended = (
        datetime.fromtimestamp(ns * NANOSECOND, timezone.utc)
        for ns in (circumstances.begun_ns, circumstances.ended_ns)
    )
    last = f"{ended:%H:%M}" if begun.date() == ended.date() else f"{ended:%Y-%m-%d %H:%M}"
    dates = phrase("{0} to {1} UTC", f"{begun:%Y-%m-%d %H:%M}", last)
    return phrase("{0}, simulated time", dates) if circumstances.simulated else dates


def _joined(texts: list[str]) -> str:
    return join_texts([text for text in texts if text], ", ")


_RANGES: Final = (noted("Deviation"), noted("lowest"), noted("highest"), noted("range"))
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


def result_sentences(result: Result, withheld: str | None) -> list[str]:
    """Return the result in words: ranges with U, axis, reversals, figures of ISO 230-2 of runs."""
    few = len(result.components) <= FEW_SENTENCES
    texts = [_range(result, name, withheld) for name in result.components if few]
    texts += further_statements(result, valid=not withheld)
    if figures := _positioning(result, withheld):
        texts.append(figures)
    return texts


def component_ranges(result: Result, withheld: str | None) -> ValueBlock | None:
    """Return lowest, highest, range and largest U of many components; None for few."""
    if len(result.components) <= FEW_SENTENCES:
        return None
    rows = []
    for name in result.components:
        ends = _ends(result, name)
        largest = NO_U if withheld else f"{ends.largest_u} {ends.unit}"
        texts = (ends.low, ends.high, ends.span)
        rows.append([name, *(f"{text} {ends.unit}" for text in texts), largest])
    return ValueBlock([*map(phrase, _RANGES), phrase("U {0}, at most", K)], rows)


def uncertainty_statement(result: Result, withheld: str | None) -> str:
    """Return the definition of U, or the reason for which it is not stated."""
    if withheld:
        return phrase("U: not stated, because {0}.", withheld)
    text = phrase(
        "U is the expanded uncertainty, the standard uncertainty multiplied by the coverage "
        "factor k = {0} (about 95 % for a normal distribution), JCGM 100:2008.",
        f"{COVERAGE_FACTOR:g}",
    )
    missing = join_texts([phrase(effect) for effect in uncovered_effects(result)], ", ")
    return phrase("{0} It does not cover: {1}.", text, missing) if missing else text


def conformity_statements(result: Result, withheld: str | None) -> list[str]:
    """Return within, beyond or undecided for every component that has a tolerance."""
    every = conformities(result, result.circumstances.identity)
    if not every:
        return []
    if withheld:
        return [phrase("No statement of conformity, because U is not stated.")]
    return [phrase("{0} (decision rule: {1}).", found.describe(result), RULE) for found in every]


def value_blocks(result: Result, withheld: str | None) -> list[ValueBlock]:
    """Return the table of values, in blocks side by side if it is long and narrow."""
    if len(result.components) > 1:
        head = [
            phrase("Angle / °"),
            *(f"{name} ± U / {unit_of(name)[1]}" for name in result.components),
        ]
        return [ValueBlock(head, _wide_rows(result, withheld))]
    (name,) = result.components
    unit = unit_of(name)[1]
    rows = _narrow_rows(result, name, withheld)
    size = len(rows) if len(rows) <= FEW_ROWS else -(-len(rows) // BLOCKS)
    head = [phrase("Angle / °"), f"{name} / {unit}", f"U / {unit}"]
    return [ValueBlock(head, rows[i : i + size]) for i in range(0, len(rows), size)]


def degrees(angle: float) -> str:
    """Return an angle (rad) in degrees, with at most four decimals."""
    text = f"{angle / DEGREE:.4f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else typeset_minus(text)


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
    low, high = (typeset_minus(value(float(end), largest)) for end in (values.min(), values.max()))
    span = float(np.ptp(values))
    whole = value_to_place(span, last_digit_place(largest)) if largest else f"{span:.6g}"
    return _Ends(low, high, whole, uncertainty(largest), label)


def _range(result: Result, name: str, withheld: str | None) -> str:
    """Return lowest, highest and range of one component in one sentence."""
    ends = _ends(result, name)
    text = phrase("{0} lies between {1} and {2} {3}, a range of {4} {3}",
                  name, ends.low, ends.high, ends.unit, ends.span)  # fmt: skip
    if withheld:
        return phrase("{0}; U is not stated.", text)
    return phrase("{0}, with U ≤ {1} {2} {3}.", text, ends.largest_u, ends.unit, K)


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
    return phrase("After ISO 230-2, from {0} runs in each direction: {1}{2}",
                  count, ", ".join(texts), probability)  # fmt: skip


def _narrow_rows(result: Result, name: str, withheld: str | None) -> list[list[str]]:
    unit, _ = unit_of(name)
    rows = []
    for angle, deviation, std in zip(
        result.angles, result.deviations[name] / unit, result.std[name] / unit, strict=True
    ):
        expanded = COVERAGE_FACTOR * float(std)
        stated = NO_U if withheld else uncertainty(expanded)
        rows.append([degrees(angle), typeset_minus(value(float(deviation), expanded)), stated])
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
            cells.append(typeset_minus(write(number, expanded)))
        rows.append([degrees(angle), *cells])
    return rows
