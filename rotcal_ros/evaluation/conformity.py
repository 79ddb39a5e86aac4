"""Conformity with a tolerance after JCGM 106:2012, with a guard band w = U on either side.

Within: every deviation lies inside the tolerance by more than U (guarded acceptance, 8.3.2).
Beyond: one lies outside by more than U (guarded rejection, 8.3.3). Otherwise undecided. The
conformance probability (7) is that of a normal distribution about the measured values.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from scipy.special import ndtr

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.components import COVERAGE_FACTOR, TRANSLATIONS, unit_of
from rotcal_ros.foundation.identity import Identity
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import ARCSEC, DEGREE, MICROMETRE

Decision = Literal["within", "beyond", "undecided"]
DRAWS: Final = 20_000
"""Curves drawn for the probability of a whole curve; one of 0.5 is then known to 0.004."""
RULE: Final = "JCGM 106:2012, guard band w = U (k = 2)"


@dataclass(frozen=True, slots=True)
class Conformity:
    """One component against its tolerance, SI.

    ``probability`` is that of the whole curve, all angles at once; ``worst`` is the index of the
    deciding angle, where |deviation| + U is largest. With ``open_zeros`` U is unbounded, nothing
    is decided, and the probability is NaN.
    """

    component: str
    tolerance: float
    decision: Decision
    probability: float
    worst: int
    open_zeros: str = ""

    def in_words(self, result: Result) -> str:
        """Return the statement of conformity in one sentence."""
        unit, label = unit_of(self.component)
        limit = f"±{self.tolerance / unit:g} {label}"
        if self.open_zeros:
            return (
                f"{self.component} is undecided against the tolerance {limit}: {self.open_zeros}"
            )
        place = f"{result.angles[self.worst] / DEGREE:g}°"
        verb = {
            "within": f"within the tolerance {limit}",
            "beyond": f"beyond the tolerance {limit}, by more than U at {place}",
            "undecided": f"undecided against the tolerance {limit}: U goes beyond it at {place}",
        }[self.decision]
        return f"{self.component} is {verb}; conformance probability {_percent(self.probability)}"


def conformance_probability(value: float, std: float, lower: float, upper: float) -> float:
    """Return the probability that a normal quantity lies in a tolerance interval.

    >>> round(conformance_probability(0.0, 1.0, -1.96, 1.96), 3)
    0.95
    """
    if std == 0.0:
        return float(lower <= value <= upper)
    return float(ndtr((upper - value) / std) - ndtr((lower - value) / std))


def decide(values: Floats, stds: Floats, tolerance: float) -> Decision:
    """Return the decision about ``values`` (n,) with ``stds`` (n,) against +-``tolerance``."""
    size, guard = np.abs(values), COVERAGE_FACTOR * stds
    if np.all(size <= tolerance - guard):
        return "within"
    return "beyond" if np.any(size > tolerance + guard) else "undecided"


def conformities(result: Result, identity: Identity) -> tuple[Conformity, ...]:
    """Return the conformity of each measured component for which ``identity`` has a tolerance."""
    found = []
    for name in result.components:
        tolerance = tolerance_of(name, identity)
        if tolerance:
            values, std = result.deviations[name], result.std[name]
            if words := result.zeros.in_words([name]):
                worst = int(np.argmax(np.abs(values)))
                found.append(Conformity(name, tolerance, "undecided", np.nan, worst, words))
                continue
            worst = int(np.argmax(np.abs(values) + COVERAGE_FACTOR * std))
            probability = _whole_curve(
                values, result.covariance.get(name, np.diag(std**2)), tolerance
            )
            decision = decide(values, std, tolerance)
            found.append(Conformity(name, tolerance, decision, probability, worst))
    return tuple(found)


def tolerance_of(component: str, identity: Identity) -> float:
    """Return the tolerance of a component in SI; 0 if none is agreed."""
    if component in TRANSLATIONS:
        return identity.tolerance_um * MICROMETRE
    return identity.tolerance_arcsec * ARCSEC


def _whole_curve(values: Floats, covariance: Floats, tolerance: float) -> float:
    """Return the probability that all values (n,) conform at once; equal input, equal output."""
    eigenvalues, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(eigenvalues, 0.0))
    drawn = np.random.default_rng(106).standard_normal((DRAWS, len(values))) @ root.T
    return float(np.mean(np.all(np.abs(values + drawn) <= tolerance, axis=1)))


def _percent(probability: float) -> str:
    """Return a probability in percent, not closer to 0 or 100 than the draws can resolve."""
    if probability > 0.999:
        return "above 99.9 %"
    return "below 0.1 %" if probability < 0.001 else f"{100.0 * probability:.1f} %"
