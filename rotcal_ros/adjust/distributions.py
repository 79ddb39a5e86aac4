"""Tails of the distributions that tests use.

From scipy.special, to the last bit what scipy.stats gives; importing the latter takes longer than
to solve a bag.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from rotcal_ros.foundation.arrays import Floats


def chi2_sf(value: float, dof: float) -> float:
    """Return how probably chi-squared with ``dof`` degrees of freedom exceeds ``value``."""
    return float(special.chdtrc(dof, value))


def chi2_isf(probability: float, dof: ArrayLike) -> Floats:
    """Return what chi-squared exceeds with ``probability``, in the shape of ``dof``."""
    return np.asarray(special.chdtri(dof, probability), dtype=np.float64)


def f_isf(probability: float, dof: ArrayLike, dof_below: ArrayLike) -> Floats:
    """Return what F with ``dof`` over ``dof_below`` degrees of freedom exceeds."""
    return np.asarray(special.fdtri(dof, dof_below, 1.0 - probability), dtype=np.float64)


def f_sf(value: float, dof: float, dof_below: float) -> float:
    """Return how probably F with ``dof`` over ``dof_below`` exceeds ``value``."""
    return float(special.fdtrc(dof, dof_below, value))


def normal_sf(value: float) -> float:
    """Return how probably a standard normal number exceeds ``value``."""
    return float(special.ndtr(-value))


def normal_isf(probability: float) -> float:
    """Return what a standard normal number exceeds with ``probability``."""
    return float(-special.ndtri(probability))


def t_sf(value: float, dof: float) -> float:
    """Return how probably Student's t with ``dof`` degrees of freedom exceeds ``value``."""
    return float(special.stdtr(dof, -value))


def t_isf(probability: float, dof: float) -> float:
    """Return what Student's t with ``dof`` degrees of freedom exceeds with ``probability``."""
    return float(-special.stdtrit(dof, probability))


def binomial_quantile(probability: float, trials: int, chance: float) -> int:
    """Return the smallest number of hits that is not exceeded with ``probability``."""
    above = int(np.ceil(special.bdtrik(probability, trials, chance)))
    below = max(above - 1, 0)  # bdtrik may round up across a step of the distribution
    return below if special.bdtr(below, trials, chance) >= probability else above


@lru_cache(maxsize=256)
def detectable_size(limit: float, power: float, dof: float = np.inf) -> float:
    """Return the size, in standard deviations, that a test finds with the probability ``power``.

    ``limit``: beyond it a standard normal number is found; where the standard deviation is
    estimated with ``dof`` degrees of freedom, a number of Student's t that is as rare.
    """
    if not np.isfinite(dof):
        return limit + normal_isf(1.0 - power)
    rare = t_isf(max(normal_sf(limit), 1e-300), dof)
    return float(np.sqrt(f_noncentrality(rare**2, 1.0, dof, power)))


def sidak(significance: float, tests: int) -> float:
    """Return the significance of each of several tests that have one together (Sidak 1967)."""
    return float(-np.expm1(np.log1p(-significance) / max(tests, 1)))


def noise_growth(significance: float, power: float, dof: float) -> float:
    """Return how many times its stated variance noise is when chi-squared finds it.

    With the probability ``power``, by a test of ``significance`` with ``dof`` degrees of freedom.
    """
    return float(chi2_isf(significance, dof) / chi2_isf(power, dof))


def f_noncentrality(limit: float, dof: float, dof_below: float, power: float) -> float:
    """Return the noncentrality at which F exceeds ``limit`` with the probability ``power``."""
    return float(special.ncfdtrinc(dof, dof_below, 1.0 - power, limit))


def noncentrality(
    significance: float, power: float, dof: int = 1, dof_below: float = np.inf
) -> float:
    """Return Baarda's lambda0: what shifts chi-squared with ``dof`` enough to be found.

    A test of ``significance`` finds a noncentral chi-squared of this noncentrality with the
    probability ``power``. For one degree of freedom its root is delta0: 4.13 at 0.001 and 0.80
    (Baarda 1968, A testing procedure for use in geodetic networks). Where the noise is estimated
    with ``dof_below`` degrees of freedom, the same of F.
    """
    if np.isfinite(dof_below):
        limit = float(f_isf(significance, dof, dof_below))
        return f_noncentrality(limit, dof, dof_below, power)
    critical = float(chi2_isf(significance, dof))
    return float(special.chndtrinc(critical, dof, 1.0 - power))
