"""Errors that come on top of a result, such as those of clocks that may still differ.

A length and the angle that it belongs to are of the same moment only as far as the clocks of
table, probe and instrument agree: a table at rest creeps from one to the other.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Final

import numpy as np
from scipy.sparse import csr_array, identity, vstack

from rotcal_ros.capture.settings import CaptureSettings
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.compact import (
    FULL,
    CompactCovariance,
    Covariances,
    Spread,
    difference_variance,
    kept,
    variances_of,
)
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
    budget = {**result.budget, SOURCE: _sizes(mean)} if result.budget else {}
    result = with_errors(result, {COMPONENT: mean}, {COMPONENT: sides})
    return replace(result, budget=budget)


def with_errors(
    result: Result,
    errors: Mapping[str, Floats | csr_array],
    sides: Mapping[str, Floats | csr_array] | None = None,
) -> Result:
    """Return a result whose uncertainties hold p independent ``errors`` (n, p) besides.

    They are standard uncertainties, by component, m or rad; ``sides`` (2 k, p): what they do to
    the curves from both sides, of a result that has these.
    """
    both, adjacent = dict(result.directions), result.adjacent_std
    for name, by in (sides or {}).items():
        if name in both:
            both[name] = replace(both[name], spread=_spoiled(both[name].spread, by))
    if adjacent is not None and COMPONENT in errors:
        by = errors[COMPONENT]
        adjacent = np.hypot(adjacent, _sizes(by[1:] - by[:-1]))
    std, covariance = dict(result.std), dict(kept(result.covariance))
    for name, each in errors.items():
        std[name] = np.hypot(std[name], _sizes(each))
        covariance[name] = _spoiled(covariance[name], each)
    return replace(
        result,
        std=std,
        covariance=Covariances(covariance),
        adjacent_std=adjacent,
        directions=both,
    )


def _spoiled(covariance: Spread, by: Floats | csr_array) -> Spread:
    """Return that of values which independent errors spoil besides, each one ``by`` (n, p)."""
    if isinstance(covariance, CompactCovariance):
        return covariance.plus(CompactCovariance.alone(np.ones(by.shape[1])).mapped(csr_array(by)))
    more = by @ by.T
    return np.asarray(covariance + (more if isinstance(more, np.ndarray) else more.toarray()))


def _sizes(errors: Floats | csr_array) -> Floats:
    """Return the length (n,) of each row of ``errors`` (n, p)."""
    if isinstance(errors, np.ndarray):
        return np.asarray(np.linalg.norm(errors, axis=1))
    return np.asarray(np.sqrt(np.asarray((errors * errors).sum(axis=1)).ravel()))


def as_small(to: csr_array) -> Floats | csr_array:
    """Return ``to`` (k, m) written out where it is small."""
    return np.asarray(to.toarray()) if to.shape[1] <= FULL else to


def from_zero(to: Floats | csr_array, zero: Floats | csr_array) -> Floats | csr_array:
    """Return ``to`` (k, m), each row less the row ``zero`` (1, m)."""
    if isinstance(to, np.ndarray):
        return np.asarray(to - zero)
    return csr_array(to - csr_array(np.ones((to.shape[0], 1))) @ zero)


def _errors(result: Result) -> tuple[Floats | csr_array, Floats | csr_array]:
    """Return by how much the errors (p,) of all arrivals go into ECC (n, p) and its sides (2k, p).

    The first n errors are those of the angles, from the only side or with increasing angle, the
    other k those with decreasing angle.
    """
    n, at = len(result.angles), np.zeros(0, int)
    if (both := result.directions.get(COMPONENT)) is not None:
        at = np.argmin(np.abs(both.angles[:, None] - result.angles), axis=1)
    every = csr_array(identity(n + len(at), format="csr"))
    forward, reverse = every[at], every[n:]
    share = np.ones(n)
    share[at] = 0.5
    other = csr_array(
        (np.full(len(at), 0.5), (at, n + np.arange(len(at)))), shape=(n, n + len(at))
    )
    mean = csr_array(every[:n] * share[:, None] + other)
    mean, sides = as_small(mean), as_small(csr_array(vstack([forward, reverse], format="csr")))
    if n > 0 and variances_of(kept(result.covariance)[COMPONENT])[0] == 0.0:
        return from_zero(mean, mean[:1]), from_zero(sides, mean[:1])
    return mean, sides


def with_steps(result: Result) -> Result:
    """Return ``result`` with the deviations of the steps between its neighbouring angles."""
    ecc, at = result.deviations["ECC"], np.arange(len(result.angles) - 1)
    covariance = kept(result.covariance)["ECC"]
    if isinstance(covariance, CompactCovariance):
        variance = difference_variance(covariance, at, at + 1)
    else:
        step = np.diff(np.eye(len(ecc)), axis=0)
        variance = np.maximum(np.diag(step @ covariance @ step.T), 0.0)
    return replace(result, adjacent_deviations=np.diff(ecc), adjacent_std=np.sqrt(variance))
