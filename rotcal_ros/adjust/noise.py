"""How large the noise really is: variance components by restricted maximum likelihood.

Observations fall into components, each with a factor s on its stated standard deviations. Of
component k the residuals give a weighted sum of squares q, which is expected to be its redundancy
r; H, the squared sums of the redundancy matrix by pairs of components, is half of the covariance
of q. Where q does not fit r the statement is *contradicted*. That costs nearly nothing, and while
no component is contradicted the statements stand as they are, to the last bit.

Otherwise ln s is found by Fisher scoring: slope q - r, information 2 H (Koch, *Parameter
Estimation and Hypothesis Testing in Linear Models*, 1999, section 3.6). The statements remain as
priors, normal about ln s = 0, so that a component that nothing checks keeps its statement.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from rotcal_ros.adjust.distributions import chi2_sf, normal_isf
from rotcal_ros.foundation.arrays import Bools, Floats

PRIOR: Final = 1.5
"""Standard deviation of ln s: a statement is off by more than a factor of 20 in 5 % of cases."""
UNKNOWN: Final = 100.0
"""The same where nothing was stated."""
BEND: Final = 2.5
"""Normalised residual from which one counts no more, while outliers are about."""
BENT_SQUARE: Final = 0.97756
"""Mean of min(w^2, BEND^2) for a standard normal w."""
LEAST_REDUNDANCY: Final = 0.5
"""A component that the others check less than this cannot be contradicted."""
LEAST_FACTOR: Final = 0.1
"""Observations that scatter even less are without noise, made up: the statements stay."""
LARGEST_STEP: Final = 1.1
SETTLED: Final = 1e-4
"""Squared last step of the factors, in their standard deviations."""
NEARLY_SETTLED: Final = 1e-2
"""The same while outliers are still looked for."""
MAX_ITERATIONS: Final = 40


@dataclass(frozen=True, eq=False)
class NoiseEvidence:
    """What the residuals say about the components ``present`` (c,) at their factors of now.

    ``squares`` (c,): weighted sums of squared residuals, ``redundancy`` (c,): what these are
    expected to be, ``information`` (c, c): half of their covariance; zero where absent.
    ``average`` (c, c): the mean of it and of what these residuals show of it (Gilmour, Thompson
    and Cullis, Biometrics 51, 1440, 1995), if that is known.
    """

    present: Bools
    squares: Floats
    redundancy: Floats
    information: Floats
    average: Floats | None = None

    def probabilities(self) -> Floats:
        """Return (c,) how probably chance explains each component's sum, both sides; 1: absent."""
        found = np.ones(len(self.present))
        for k in np.flatnonzero(self.present & (self.redundancy > LEAST_REDUNDANCY)):
            # q is r / d times chi-squared of d = r^2 / H degrees of freedom: same mean, variance
            spread = self.information[k, k] / self.redundancy[k]
            above = chi2_sf(self.squares[k] / spread, self.redundancy[k] / spread)
            found[k] = 2.0 * min(above, 1.0 - above)
        return found


class EstimatedFactors(NamedTuple):
    """Factors (c,) on the stated standard deviations, and the std (c,) of their logarithms.

    The latter is NaN where a component is absent.
    """

    factors: Floats
    log_std: Floats

    def contradicted(self, significance: float) -> Bools:
        """Return (c,) the components whose factor cannot be one, two-sided."""
        limit = normal_isf(0.5 * significance)
        return np.asarray(np.abs(np.log(self.factors)) > limit * self.log_std, dtype=np.bool_)


def robust_squares(squares: Floats, redundancy: Floats, least: float) -> Floats:
    """Return squared whitened residuals whose normalised value counts no more than BEND.

    Their sum is expected to be that of the ``redundancy``; rows with less than ``least`` of it
    count nothing.
    """
    bent = np.minimum(squares, BEND**2 * redundancy) / BENT_SQUARE
    return np.where(redundancy > least, bent, squares)


def estimate_factors(
    at: Callable[[Floats], NoiseEvidence],
    factors: Floats,
    prior: Floats,
    settled: float = SETTLED,
    lowest: Floats | float = LEAST_FACTOR,
) -> EstimatedFactors:
    """Return the factors that fit the residuals best, from such ``factors`` (c,) on.

    ``at(factors)`` adjusts anew. ``prior`` (c, c): information of the statements on ln s.
    ``settled``: squared last step in standard deviations, see NEARLY_SETTLED. No factor is found
    below the ``lowest``.
    """
    logs = np.log(factors)
    for _ in range(MAX_ITERATIONS):
        evidence = at(np.exp(logs))
        slope = evidence.squares - evidence.redundancy - prior @ logs
        known = 2.0 * evidence.information + prior
        least = (logs <= np.log(lowest)) & (slope < 0.0)  # these stay where they are
        free = np.flatnonzero(evidence.present & ~least)
        step = np.zeros(len(logs))
        step[free] = np.linalg.solve(_steeper(known, evidence)[np.ix_(free, free)], slope[free])
        step *= min(1.0, LARGEST_STEP / float(np.abs(step).max(initial=LARGEST_STEP)))
        step = np.maximum(logs + step, np.log(lowest)) - logs
        if float(step @ known @ step) < settled:
            break
        logs = logs + step
    log_std = np.full(len(logs), np.nan)
    log_std[evidence.present] = np.sqrt(np.linalg.inv(known).diagonal())[evidence.present]
    return EstimatedFactors(np.exp(logs), log_std)


def _steeper(known: Floats, evidence: NoiseEvidence) -> Floats:
    """Return the information (c, c) that is expected, or more where the residuals show more.

    Steps by less go too far, and to and fro.
    """
    if evidence.average is None:
        return known
    values, vectors = np.linalg.eigh(evidence.average - evidence.information)
    return np.asarray(known + 4.0 * (vectors * np.maximum(values, 0.0)) @ vectors.T)
