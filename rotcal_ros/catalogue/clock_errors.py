"""What clocks that may still differ make uncertain: a table at rest creeps from one to the other.

A length and the angle that it belongs to are of the same moment only as far as the clocks of
table, probe and instrument agree.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final

import numpy as np

from rotcal_ros.arrays import Floats
from rotcal_ros.capture.settings import CaptureSettings
from rotcal_ros.errors import ConfigurationError
from rotcal_ros.results import Directions, Result
from rotcal_ros.units import DEGREE

SOURCE: Final = "clocks"
"""Its name in the budget of a method that has one."""
_COMPONENT: Final = "ECC"
"""The one deviation that a turn of the table about its axis goes into."""


def require_settled(bound_s: float, settings: CaptureSettings) -> None:
    """Raise ConfigurationError where clocks may differ by more than the table settles."""
    if bound_s > settings.settle_time_s:
        raise ConfigurationError(
            f"topics.clock_bound_s = {bound_s:g} is longer than capture.settle_time_s = "
            f"{settings.settle_time_s:g}: a window may then be of the motion before, which no "
            "uncertainty covers; let the table settle longer, or the clocks agree better"
        )


def angle_std(bound_s: float, settings: CaptureSettings) -> float:
    """Return the standard uncertainty, rad, of one angle by clocks that differ within a bound.

    The error is the product of the clocks' difference and the table's creep, both within bounds
    and without a favourite (rectangular: JCGM 100, 4.3.7), of unknown sign at every position.
    """
    return bound_s * settings.velocity_tolerance_deg_s * DEGREE / 3.0


def with_clock_errors(result: Result, std: float) -> Result:
    """Return a result whose ECC is uncertain by ``std`` (rad) at every angle besides.

    An ECC that counts from the first angle has the error of that one too.
    """
    if not std or _COMPONENT not in result.deviations:
        return result
    share = std**2 * _unit_covariance(result.covariance[_COMPONENT])
    covariance = result.covariance[_COMPONENT] + share
    adjacent = result.adjacent_std
    return replace(
        result,
        std={**result.std, _COMPONENT: np.sqrt(covariance.diagonal())},
        covariance={**result.covariance, _COMPONENT: covariance},
        adjacent_std=None if adjacent is None else np.hypot(adjacent, np.sqrt(2.0) * std),
        directions={n: _both(d, n, std) for n, d in result.directions.items()},
        details=_with_source(result.details, np.sqrt(share.diagonal())),
    )


def _unit_covariance(covariance: Floats) -> Floats:
    """Return the covariance (n, n) of ECC where every angle has an error of its own, of size 1."""
    n = len(covariance)
    errors = np.eye(n)
    if n and covariance[0, 0] == 0.0:
        errors[:, 0] -= 1.0
    return np.asarray(errors @ errors.T, dtype=np.float64)


def _both(sides: Directions, name: str, std: float) -> Directions:
    """Return the directions of ECC, each with an error of its own and that of their zero."""
    if name != _COMPONENT:
        return sides
    size = len(sides.covariance)
    return replace(sides, covariance=sides.covariance + std**2 * (np.eye(size) + 1.0))


def _with_source(details: Mapping[str, Any], std: Floats) -> Mapping[str, Any]:
    budget = details.get("budget")
    return details if budget is None else {**details, "budget": {**budget, SOURCE: std}}
