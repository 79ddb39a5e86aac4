"""What a certificate states besides the numbers: one fact per entry of ISO/IEC 17025, 7.8.

``item`` of a fact is the clause of ISO/IEC 17025:2017 that requires it; a test compares the page
with the whole list.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime, timezone
from typing import Final

from rotcal_ros import __version__
from rotcal_ros.foundation.circumstances import Circumstances, Range, StepCounts
from rotcal_ros.foundation.identity import Identity
from rotcal_ros.foundation.in_force import in_words
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import NANOSECOND

NOT_STATED: Final = "not stated"
ONLY_THIS_ITEM: Final = (
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


def about_the_item(result: Result, identity: Identity) -> list[Fact]:
    """Return what was calibrated, and for whom."""
    customer = [identity.customer, identity.customer_address]
    return [
        Fact("Item", _item(identity), "7.8.2.1 g"),
        Fact("Axis", result.circumstances.axis),
        Fact("Compensation in force", in_words(result.measured_on)),
        Fact("Tolerance", _tolerance(identity)),
        Fact("Customer", _joined(customer), "7.8.2.1 e"),
        Fact("Customer's number", identity.customer_number),
        Fact("Received", identity.received, "7.8.2.1 h"),
    ]


def about_the_work(result: Result, identity: Identity, method: str, issued: str) -> list[Fact]:
    """Return who calibrated it, where, when and how."""
    laboratory = [identity.laboratory, identity.laboratory_address, identity.laboratory_country]
    return [
        Fact("Laboratory", _joined([*laboratory, identity.laboratory_email]), "7.8.2.1 b"),
        Fact("Place", identity.place, "7.8.2.1 c"),
        Fact("Date of calibration", _dates(result.circumstances), "7.8.2.1 i"),
        Fact("Date of issue", issued, "7.8.2.1 j"),
        Fact("Operator", identity.operator),
        Fact("Authorised by", "", "7.8.2.1 o"),
        Fact("Method", f"{method}; rotcal_ros {__version__}", "7.8.2.1 f"),
        Fact("Conditions", conditions(result.circumstances), "7.8.4.1 b"),
    ]


def about_the_plan(result: Result, rejected_attempts: int) -> list[Fact]:
    """Return what was sampled, what was left out, and who else contributed."""
    counts = result.circumstances.counts
    skipped = "" if counts is None else f"{counts.skipped} of {counts.planned} steps were skipped"
    return [
        Fact("Sampling", in_numbers(result, counts, rejected_attempts), "7.8.2.1 k"),
        Fact("Deviations from the method", skipped, "7.8.2.1 n"),
        Fact("External providers", "", "7.8.2.1 p"),
    ]


def in_numbers(result: Result, counts: StepCounts | None, rejected_attempts: int) -> str:
    """Return the true counts in one line."""
    rejected = f"{len(result.rejected)} rejected by the solver"
    if counts is None:
        return f"{result.n_observations} observations, {rejected}"
    return (
        f"{counts.planned} steps planned or offered, {counts.used} used, {counts.skipped} "
        f"skipped, {counts.retried} retried, {rejected}, {rejected_attempts} during the capture"
    )


def conditions(circumstances: Circumstances) -> str:
    """Return temperature, pressure and humidity with their ranges."""
    ranges = [
        _range("temperature", circumstances.temperature_c, "°C", 2),
        _range("air pressure", circumstances.pressure_pa, "hPa", 1, 1.0 / PASCAL_PER_HPA),
        _range("relative humidity", circumstances.humidity, "%", 0, 100.0),
    ]
    return "; ".join(ranges) if any(NOT_STATED not in text for text in ranges) else ""


def _range(name: str, found: Range | None, unit: str, digits: int, factor: float = 1.0) -> str:
    if found is None:
        return f"{name} {NOT_STATED}"
    mean, low, high = (
        f"{value * factor:.{digits}f}" for value in (found.mean, found.lowest, found.highest)
    )
    return f"{name} {mean} {unit} ({low} to {high})"


def _item(identity: Identity) -> str:
    serial = f"no. {identity.serial}" if identity.serial else ""
    return _joined([identity.item, identity.maker, identity.model, serial])


def _tolerance(identity: Identity) -> str:
    limits = ((identity.tolerance_arcsec, "arcsec"), (identity.tolerance_um, "µm"))
    return _joined([f"±{limit:g} {unit}" for limit, unit in limits if limit])


def _dates(circumstances: Circumstances) -> str:
    """Return when it was measured, to the minute, with a single day only once."""
    if circumstances.begun_ns is None or circumstances.ended_ns is None:
        return ""
    begun, ended = (
        datetime.fromtimestamp(ns * NANOSECOND, timezone.utc)
        for ns in (circumstances.begun_ns, circumstances.ended_ns)
    )
    last = f"{ended:%H:%M}" if begun.date() == ended.date() else f"{ended:%Y-%m-%d %H:%M}"
    return f"{begun:%Y-%m-%d %H:%M} to {last} UTC"


def _joined(texts: list[str]) -> str:
    return ", ".join(text for text in texts if text)
