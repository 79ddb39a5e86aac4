"""Numbers in the options of plans."""

from __future__ import annotations

from math import inf
from typing import Final

import click

from rotcal_ros.foundation.errors import PlanError

positive: Final = click.FloatRange(min=0.0, min_open=True)


def numbers(text: str, option: str) -> tuple[float, ...]:
    """Return the numbers in the text of an option, which commas separate; raises PlanError."""
    try:
        return tuple(float(part) for part in text.replace(",", " ").split())
    except ValueError:
        raise PlanError(f"{option} {text}: expected numbers separated by commas") from None


def whole_numbers(text: str, option: str) -> list[int]:
    """Return the whole numbers in the text of an option; raises PlanError."""
    found = numbers(text, option)
    if not all(map(float.is_integer, found)):
        raise PlanError(f"{option} {text}: expected whole numbers")
    return [int(number) for number in found]


def positive_whole_numbers(text: str, option: str) -> list[int]:
    """Return positive whole numbers separated by commas."""
    positive_numbers(text, option)
    return whole_numbers(text, option)


def positive_numbers(text: str, option: str) -> tuple[float, ...]:
    """Return positive numbers separated by commas."""
    found = numbers(text, option)
    if not found or not all(0.0 < number < inf for number in found):
        raise PlanError(f"{option} {text}: expected positive numbers separated by commas")
    return found
