"""What the lengths of a plan check of each other: Baarda's reliability, and what slips through.

A length with redundancy r shows an error in it with power beta when the error is delta0 sigma /
sqrt(r); delta0 is the limit of the solver's test of single lengths plus the quantile of beta. An
error just below, undetected, moves the angles by F^-1 g / v times it. Source: Baarda, W. (1968), A
testing procedure for use in geodetic networks.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from rotcal_ros.adjust.distributions import normal_isf
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.components import COVERAGE_FACTOR
from rotcal_ros.methods.tracer.design.information import Information

ROUNDING: Final = 1e-6
"""Redundancy that is none: an error of that length shows nowhere, however large."""
UNCHECKED: Final = 1e-3
"""Redundancy of which is said that nothing checks the length: it takes an error of 150 times its
noise to show."""


@dataclass(frozen=True, eq=False)
class Checks:
    """Of N lengths: ``redundancy`` (N,), ``detectable`` (N,) error in m, ``effect`` (N, m) in rad.

    ``effect``: what the smallest detectable error does to the angles less their mean. ``share``
    (N,): the largest effect of each length in expanded uncertainties (k = 2) of the same angle.
    """

    redundancy: Floats
    detectable: Floats
    effect: Floats
    share: Floats


def detectable_in_std(count: int, significance: float, power: float) -> float:
    """Return delta0: the two-sided limit shared among ``count`` lengths, plus that of power."""
    return normal_isf(0.5 * significance / count) + normal_isf(1.0 - power)


def checks_of(known: Information, significance: float, power: float) -> Checks:
    """Return what the lengths in ``known`` check of each other."""
    beams = known.beams(known.lengths)
    delta0 = detectable_in_std(len(known.lengths), significance, power)
    redundancy = np.clip(1.0 - beams.spread / beams.variance, 0.0, 1.0)
    redundancy[redundancy < ROUNDING] = 0.0
    with np.errstate(divide="ignore"):
        detectable = delta0 * np.sqrt(beams.variance / redundancy)
    effect = beams.angles * (detectable / beams.variance)[:, None]
    expanded = COVERAGE_FACTOR * np.sqrt(known.variances())
    share = (np.abs(effect) / expanded).max(axis=1)
    return Checks(redundancy, detectable, effect, share)
