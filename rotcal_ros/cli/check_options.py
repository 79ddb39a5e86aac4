"""The options that planning and judging of a quick check share."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any, TypeVar

import click

if TYPE_CHECKING:
    from rotcal_ros.planning.check_rule import CheckRule

Function = TypeVar("Function", bound=Callable[..., Any])

risk = click.FloatRange(0.0, 0.5, min_open=True, max_open=True)
shown_option = partial(click.option, show_default=True)

_OPTIONS = (
    click.option(
        "--within",
        type=click.FloatRange(0.0, min_open=True),
        required=True,
        help="arcsec or um: by how much the earlier curve may be off at any angle.",
    ),
    shown_option(
        "--ageing",
        type=click.FloatRange(0.0),
        default=0.0,
        help="arcsec or um a month, usual change of an angle (k = 1).",
    ),
    shown_option(
        "--months",
        type=click.FloatRange(0.0),
        default=0.0,
        help="Since the earlier measurement.",
    ),
    shown_option(
        "--miss",
        type=risk,
        default=0.05,
        help="Risk of 'still valid' although some angle is off by more.",
    ),
    shown_option(
        "--false-alarm",
        type=risk,
        default=0.05,
        help="Risk of 'changed' although the table only aged as stated.",
    ),
)


def rule_options(function: Function) -> Function:
    """Add ``--within``, ``--ageing``, ``--months``, ``--miss`` and ``--false-alarm``."""
    for option in reversed(_OPTIONS):
        function = option(function)
    return function


def rule_of(
    unit: float, *, within: float, ageing: float, months: float, miss: float, false_alarm: float
) -> CheckRule:
    """Return the rule of these options; ``unit`` (m or rad) is that of limit and ageing.

    The usual change grows in proportion to the time.
    """
    from rotcal_ros.planning.check_rule import CheckRule

    if ageing > 0.0 and months == 0.0:
        raise click.UsageError("--ageing is per month: give the number of months with --months")
    return CheckRule(within * unit, miss, false_alarm, ageing * months * unit)
