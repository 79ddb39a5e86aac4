"""Errors that come on top of a result, such as those of clocks that may still differ.

A length and the angle that it belongs to are of the same moment only as far as the clocks of
table, probe and instrument agree: a table at rest creeps from one to the other.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Final

import numpy as np

from rotcal_ros.capture.settings import CaptureSettings
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import DEGREE

SOURCE: Final = "clocks"
"""Its name in the budget of a method that has one."""
COMPONENT: Final = "ECC"
"""The deviation that a turn of the table about its axis goes into."""


def require_settled(bound_s: float, settings: CaptureSettings) -> None:
    """Raise ConfigurationError where clocks may differ by more than a table settles."""
    if bound_s > settings.settle_time_s:
        raise ConfigurationError(
            f"topics.clock_bound_s = {bound_s:g} is longer than capture.settle_time_s = "
            f"{settings.settle_time_s:g}: a length may then be of the motion before, which no "
            "uncertainty covers; let the table settle longer, or the clocks agree better"
        )


def arrival_std(bound_s: float, settings: CaptureSettings) -> float:
    """Return the standard uncertainty, rad, of one arrival by clocks that differ within a bound.

    The error is the product of the clocks' difference and the table's creep, both within bounds
    and without a favourite (rectangular: JCGM 100, 4.3.7); the creep is another at every arrival.
    """
    return bound_s * settings.velocity_tolerance_deg_s * DEGREE / 3.0


def with_clock_errors(result: Result, std: float) -> Result:
    """Return a result whose ECC has an error of ``std`` (rad) besides, at every arrival.

    An ECC that counts from the first angle has the error of that one too; where it is the mean
    from both sides, either side has its own. One creep is taken for all that was measured at an
    angle from a side: no other deviation feels it then.
    """
    if not std or COMPONENT not in result.deviations:
        return result
    mean, sides = (std * each for each in _errors(result))
    budget = {**result.budget, SOURCE: np.linalg.norm(mean, axis=1)} if result.budget else {}
    result = with_errors(result, {COMPONENT: mean}, {COMPONENT: sides})
    return replace(result, budget=budget)


def with_errors(
    result: Result, errors: Mapping[str, Floats], sides: Mapping[str, Floats] | None = None
) -> Result:
    """Return a result whose uncertainties hold p independent ``errors`` (n, p) besides.

    They are standard uncertainties, by component, m or rad; ``sides`` (2 k, p): what they do to
    the curves from both sides, of a result that has these.
    """
    both, adjacent = dict(result.directions), result.adjacent_std
    for name, by in (sides or {}).items():
        if name in both:
            both[name] = replace(both[name], covariance=both[name].covariance + by @ by.T)
    if adjacent is not None and COMPONENT in errors:
        steps = np.diff(errors[COMPONENT], axis=0)
        adjacent = np.hypot(adjacent, np.linalg.norm(steps, axis=1))
    std, covariance = dict(result.std), dict(result.covariance)
    for name, by in errors.items():
        std[name] = np.hypot(std[name], np.linalg.norm(by, axis=1))
        covariance[name] = covariance[name] + by @ by.T
    return replace(result, std=std, covariance=covariance, adjacent_std=adjacent, directions=both)


def _errors(result: Result) -> tuple[Floats, Floats]:
    """Return by how much the errors (p,) of all arrivals go into ECC (n, p) and its sides (2k, p).

    The first n errors are those of the angles, from the only side or with increasing angle, the
    other k those with decreasing angle.
    """
    n, at = len(result.angles), np.zeros(0, int)
    if (both := result.directions.get(COMPONENT)) is not None:
        at = np.argmin(np.abs(both.angles[:, None] - result.angles), axis=1)
    forward, reverse = np.eye(n + len(at))[at], np.eye(n + len(at))[n:]
    mean = np.eye(n, n + len(at))
    mean[at] = 0.5 * (forward + reverse)
    counts_from_first = n > 0 and result.covariance[COMPONENT][0, 0] == 0.0
    zero = mean[:1] if counts_from_first else np.zeros((1, n + len(at)))
    return mean - zero, np.vstack([forward, reverse]) - zero


def with_steps(result: Result) -> Result:
    """Return ``result`` with the deviations of the steps between its neighbouring angles."""
    ecc, covariance = result.deviations["ECC"], result.covariance["ECC"]
    step = np.diff(np.eye(len(ecc)), axis=0)
    variance = np.diag(step @ covariance @ step.T)
    return replace(
        result, adjacent_deviations=np.diff(ecc), adjacent_std=np.sqrt(np.maximum(variance, 0.0))
    )
