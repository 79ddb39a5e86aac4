"""How many runs a statistical test makes, and what chance alone may bring in so many.

Without ROTCAL_LONG_TESTS the runs are few; their bounds follow from the number of runs.
"""

import os

import numpy as np
from scipy.stats import binom, chi2

LONG = bool(os.environ.get("ROTCAL_LONG_TESTS"))
ODDS = 1e-3
"""How often a sound program leaves such bounds, both sides together."""
ODDS_BY_CLOCK = 1e-6
"""The same of a run that no seed repeats, since its noise goes by the clock."""
KNOWN = 1e-9
"""Share of the largest variance below which another is the rounding of zero: a gauge."""


def share(probability, runs):
    """Return the bounds of the share of independent runs in which that happens."""
    low, high = binom.ppf(ODDS / 2, runs, probability), binom.isf(ODDS / 2, runs, probability)
    return low / runs, high / runs


def most(probability, runs):
    """Return the largest number of runs in which something of that probability happens."""
    return int(binom.isf(ODDS / 2, runs, probability))


def squares(error, covariance):
    """Return e' C^-1 e of one run: chi-square, the sharpest look at a stated covariance."""
    return error @ np.linalg.solve(covariance, error)


def chance(error, covariance):
    """Return how probably a sound run errs as much, by all that the covariance knows of."""
    variance, axes = np.linalg.eigh(covariance)
    known = variance > KNOWN * variance[-1]
    along = axes[:, known].T @ error
    return float(chi2.sf((along**2 / variance[known]).sum(), known.sum()))


def scatter(dof):
    """Return the bounds of a mean of ``dof`` independent squares of standard deviation 1."""
    return chi2.ppf(ODDS / 2, dof) / dof, chi2.isf(ODDS / 2, dof) / dof
