"""Which unit the numbers of an instrument seem to have, and how often it sends.

Each function returns what is implausible, in words that follow the name of a topic, or None.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from math import isfinite, sqrt
from typing import Final

import numpy as np

from rotcal_ros.bags import names
from rotcal_ros.bags.settings import ANGLE_UNITS, LENGTH_UNITS, TopicSettings
from rotcal_ros.foundation.units import MICROMETRE, NANOSECOND, TURN
from rotcal_ros.planning.plan import Plan

_NEAR_M: Final = 1.0
"""A smaller plan counts as this large: before a calibration the probe may be parked."""
_THOUSAND: Final = 1e3
_NEARLY: Final = 3.0
"""Before a plan begins, a reading may be this many times shorter or longer than in the plan."""
_AIR: Final = {
    names.TEMPERATURE: ("temperature_unit", -20.0, 60.0, "degrees Celsius"),
    names.AIR_PRESSURE: ("pressure_unit", 50e3, 120e3, "pascal"),
    names.RELATIVE_HUMIDITY: ("humidity_unit", 0.0, 1.0, "a share from 0 to 1"),
}
"""Setting of the unit, lowest and highest plausible value, and their unit."""
_OTHERS: Final = {
    names.TEMPERATURE: (("K", 253.0, 333.0), ("degF", 60.0, 140.0)),
    names.AIR_PRESSURE: (("hPa", 500.0, 1200.0), ("kPa", 50.0, 120.0)),
    names.RELATIVE_HUMIDITY: (("percent", 1.0, 100.0),),
}
"""Other units, with the lowest and highest plausible value in each."""


def likely_unit(
    value: float, largest: float, stated: str, units: Mapping[str, float]
) -> str | None:
    """Return the unit in which a ``value`` in SI, read as ``stated``, is at most ``largest``.

    None if it is plausible as it stands, or in none of them.
    """
    if abs(value) <= largest:
        return None
    raw = abs(value) / units[stated]
    fitting = (name for name, unit in units.items() if raw * unit <= largest)
    return next(fitting, None)


def implausible_length(value: float, largest: float, settings: TopicSettings) -> str | None:
    """Return why a length (m) is implausible, and which unit it may have."""
    if not isfinite(value) or abs(value) <= largest:
        return None
    unit = likely_unit(value, largest, settings.length_unit, LENGTH_UNITS)
    return (
        f"says {value:.6g} m, plausible are {largest:g} m (capture.max_length_m)"
        f"{_instead('topics.length_unit', unit)}"
    )


def implausible_angle(value: float, settings: TopicSettings) -> str | None:
    """Return a text if the table's angle (rad) is more than a turn away from zero."""
    if not isfinite(value) or abs(value) <= TURN:
        return None
    unit = likely_unit(value, TURN, settings.angle_unit, ANGLE_UNITS)
    return (
        f"says {value:.6g} rad, {abs(value) / TURN:.1f} turns from zero"
        f"{_instead('topics.angle_unit', unit)}"
    )


def implausible_position(
    position: tuple[float, float, float], plan: Plan, settings: TopicSettings
) -> str | None:
    """Return a text if the probe is far outside the plan."""
    far = max(map(abs, position))
    largest = 10.0 * max(_NEAR_M, *(abs(x) for step in plan.steps for x in step.position))
    if not isfinite(far) or far <= largest:
        return None
    unit = likely_unit(far, largest, settings.position_unit, LENGTH_UNITS)
    return (
        f"says {far:.6g} m, more than ten times as far as the plan goes"
        f"{_instead('topics.position_unit', unit)}"
    )


def thousandth_of_plan(
    value: float, plan_m: tuple[float, float], stated: str, setting: str
) -> str | None:
    """Return a text if a number (m) is a thousand times too small or too large for the plan.

    ``plan_m`` is its least and largest value in the plan. Zero is always plausible: the probe may
    be parked there, or the instrument set to zero.
    """
    least, largest = plan_m
    if isfinite(value) and abs(value) > largest * _NEARLY:
        unit = likely_unit(value, largest * _NEARLY, stated, LENGTH_UNITS)
        return (
            (
                f"says {value:.6g} m, {abs(value) / largest:.3g} times the longest of the plan"
                f"{_instead(setting, unit)}"
            )
            if unit
            else None
        )
    if not isfinite(value) or not least / _NEARLY <= abs(value) * _THOUSAND <= largest * _NEARLY:
        return None
    larger = LENGTH_UNITS[stated] * _THOUSAND
    unit = next((name for name, factor in LENGTH_UNITS.items() if factor == larger), None)
    twice = _instead(setting, unit) or ": is it converted to metres twice?"
    return (
        f"says {value:.6g} m, a thousand times less than the {least:.3g} to {largest:.3g} m of "
        f"the plan{twice}"
    )


_FINEST_M: Final = 1e-9
"""No instrument scatters by less in metres: its lengths are not a thousand times too small."""


def reading_scatter(values: Sequence[float]) -> float | None:
    """Return the standard deviation of single readings, None of too few.

    It is taken from second differences: a slow motion does not count, nor does a jump.
    """
    if len(values) < _LEAST_SCATTER:
        return None
    return float(np.median(np.abs(np.diff(values, 2)))) / (_MEDIAN * sqrt(6.0))


_LEAST_SCATTER: Final = 10
_MEDIAN: Final = 0.6744897501960817
"""Median of the absolute value of a standard normal variable."""


def scatters_at_rest(scatter: float, allowed: float, stated: str, setting: str) -> str | None:
    """Return a text if readings at rest scatter by more (m) than a window ``allowed``."""
    if not scatter > allowed:
        return None
    unit = likely_unit(scatter, allowed, stated, LENGTH_UNITS)
    return (
        f"scatters by {scatter / MICROMETRE:.3g} um from reading to reading, allowed "
        f"{allowed / MICROMETRE:g} um (capture.max_std_m){_instead(setting, unit)}"
    )


def can_be_a_thousandth(scatter: float | None) -> bool:
    """Return whether readings that ``scatter`` so (m) may be a thousand times too small."""
    return scatter is None or scatter < _FINEST_M


def implausible_air(values: Mapping[str, float]) -> Iterator[tuple[str, str]]:
    """Yield the roles of the air whose ``values`` (SI, by role) are implausible, and why."""
    for role, value in values.items():
        name, low, high, unit = _AIR[role]
        if low <= value <= high:
            continue
        others = " or ".join(u for u, first, last in _OTHERS[role] if first <= value <= last)
        hint = f": {others}? topics.{name} says in which unit it is" if others else ""
        yield role, f"says {value:.6g}; {unit} are expected{hint}"


def _instead(setting: str, unit: str | None) -> str:
    """Return a clause that asks for another unit, if there is one that fits."""
    return f": is it in {unit}? Then set {setting}: {unit}" if unit else ""


_REMEMBERED: Final = 500
"""Stamps of a stream over which its rate is taken."""
_LEAST: Final = 5
"""Messages from which on there is a rate."""
_LONGEST_NS: Final = 60_000_000_000
"""After a longer pause, or a clock that was set, the rate is counted anew."""


class Rates:
    """The mean rate (Hz) of each stream over its latest messages, pauses of bursts included."""

    def __init__(self) -> None:
        self._stamps: dict[str, deque[int]] = {}

    def note(self, role: str, stamp_ns: int) -> None:
        """Take the stamp of a message."""
        stamps = self._stamps.setdefault(role, deque(maxlen=_REMEMBERED))
        if stamps and not 0 <= stamp_ns - stamps[-1] < _LONGEST_NS:
            stamps.clear()
        stamps.append(stamp_ns)

    def forget(self, role: str) -> None:
        """Count a stream anew."""
        self._stamps.pop(role, None)

    def rates_hz(self) -> dict[str, float]:
        """Return the rates of the streams with enough messages; 0 where the stamps stand still."""
        rates = {}
        for role, stamps in self._stamps.items():
            span_ns = stamps[-1] - stamps[0]
            if len(stamps) >= _LEAST:
                rates[role] = (len(stamps) - 1) / (span_ns * NANOSECOND) if span_ns > 0 else 0.0
        return rates
