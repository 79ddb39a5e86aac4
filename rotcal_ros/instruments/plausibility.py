"""Which unit an instrument seems to speak in, when it is not the stated one."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from math import isfinite, pi
from typing import Final

from rotcal_ros.bags import names
from rotcal_ros.bags.settings import ANGLE_UNITS, LENGTH_UNITS, TopicSettings
from rotcal_ros.planning.plan import Plan

_FULL_TURN: Final = 2.0 * pi
_NEAR_M: Final = 1.0
"""Nothing at rest before a calibration is much further than this from the plan's own size."""
_THOUSAND: Final = 1e3
_NEARLY: Final = 3.0
"""So many times shorter or longer than in the plan a reading may be before it begins."""
_AIR: Final = {
    names.TEMPERATURE: ("temperature_unit", -20.0, 60.0, "degrees Celsius"),
    names.AIR_PRESSURE: ("pressure_unit", 50e3, 120e3, "pascal"),
    names.RELATIVE_HUMIDITY: ("humidity_unit", 0.0, 1.0, "a share from 0 to 1"),
}
"""Setting, plausible values, and what they are in."""
_OTHERS: Final = {
    names.TEMPERATURE: (("K", 253.0, 333.0), ("degF", 60.0, 140.0)),
    names.AIR_PRESSURE: (("hPa", 500.0, 1200.0), ("kPa", 50.0, 120.0)),
    names.RELATIVE_HUMIDITY: (("percent", 1.0, 100.0),),
}
"""Other units, and what is plausible in them."""


def likely_unit(
    value: float, largest: float, stated: str, units: Mapping[str, float]
) -> str | None:
    """Return the unit in which a ``value`` in SI, read as ``stated``, is at most ``largest``.

    None: it is as it stands, or is in none of them.
    """
    if abs(value) <= largest:
        return None
    raw = abs(value) / units[stated]
    fitting = (name for name, unit in units.items() if raw * unit <= largest)
    return next(fitting, None)


def length_in_words(value: float, largest: float, settings: TopicSettings) -> str:
    """Say that a length (m) is implausible, and which unit it may be in; empty: it is not."""
    if not isfinite(value) or abs(value) <= largest:
        return ""
    unit = likely_unit(value, largest, settings.length_unit, LENGTH_UNITS)
    return (
        f"says {value:.6g} m, plausible are {largest:g} m (capture.max_length_m)"
        f"{_instead('topics.length_unit', unit)}"
    )


def angle_in_words(value: float, settings: TopicSettings) -> str:
    """Say that the table's angle (rad) is turns away from zero; empty: it is not."""
    if not isfinite(value) or abs(value) <= _FULL_TURN:
        return ""
    unit = likely_unit(value, _FULL_TURN, settings.angle_unit, ANGLE_UNITS)
    return (
        f"says {value:.6g} rad, {abs(value) / _FULL_TURN:.1f} turns from zero"
        f"{_instead('topics.angle_unit', unit)}"
    )


def position_in_words(
    position: tuple[float, float, float], plan: Plan, settings: TopicSettings
) -> str:
    """Say that the probe is far outside the plan; empty: it is not."""
    far = max(map(abs, position))
    largest = 10.0 * max(_NEAR_M, *(abs(x) for step in plan.steps for x in step.position))
    if not isfinite(far) or far <= largest:
        return ""
    unit = likely_unit(far, largest, settings.position_unit, LENGTH_UNITS)
    return (
        f"says {far:.6g} m, more than ten times as far as the plan goes"
        f"{_instead('topics.position_unit', unit)}"
    )


def small_in_words(value: float, plan_m: tuple[float, float], stated: str, setting: str) -> str:
    """Say that a number (m) is a thousand times too small for the plan; empty: it is not.

    ``plan_m`` is the least and the largest that the plan makes of it. Zero says nothing: anything
    may stand there, or have been set to zero.
    """
    least, largest = plan_m
    if not isfinite(value) or not least / _NEARLY <= abs(value) * _THOUSAND <= largest * _NEARLY:
        return ""
    larger = LENGTH_UNITS[stated] * _THOUSAND
    unit = next((name for name, factor in LENGTH_UNITS.items() if factor == larger), None)
    twice = _instead(setting, unit) or ": is it converted to metres twice?"
    return (
        f"says {value:.6g} m, a thousand times less than the {least:.3g} to {largest:.3g} m of "
        f"the plan{twice}"
    )


def air_in_words(values: Mapping[str, float]) -> Iterator[tuple[str, str]]:
    """Yield role and what is implausible of the air's ``values`` in SI, by role."""
    for role, value in values.items():
        name, low, high, unit = _AIR[role]
        if low <= value <= high:
            continue
        others = " or ".join(u for u, first, last in _OTHERS[role] if first <= value <= last)
        hint = f": {others}? topics.{name} says in which unit it is" if others else ""
        yield role, f"says {value:.6g}; {unit} are expected{hint}"


def _instead(setting: str, unit: str | None) -> str:
    return f": is it in {unit}? Then set {setting}: {unit}" if unit else ""
