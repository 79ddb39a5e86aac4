"""Tails of the distributions that tests use.

From scipy.special, to the last bit what scipy.stats gives; importing the latter takes longer than
to solve a bag.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import chdtrc, chdtri, fdtri, ndtri

from rotcal_ros.arrays import Floats


def chi2_sf(value: float, dof: float) -> float:
    """Return how probably chi-squared with ``dof`` degrees of freedom exceeds ``value``."""
    return float(chdtrc(dof, value))


def chi2_isf(probability: float, dof: ArrayLike) -> Floats:
    """Return what chi-squared exceeds with ``probability``, in the shape of ``dof``."""
    return np.asarray(chdtri(dof, probability), dtype=np.float64)


def f_isf(probability: float, dof: ArrayLike, dof_below: ArrayLike) -> Floats:
    """Return what F with ``dof`` over ``dof_below`` degrees of freedom exceeds."""
    return np.asarray(fdtri(dof, dof_below, 1.0 - probability), dtype=np.float64)


def normal_isf(probability: float) -> float:
    """Return what a standard normal number exceeds with ``probability``."""
    return float(-ndtri(probability))
