"""The uncertainty of the figures of ISO 230-2, by the law of propagation (JCGM 100).

Every figure is piecewise linear in the means and standard deviations of the targets that decide
it. Two parts are told apart: *sampling*, how far the figures of as many other runs would lie
off, from the scatter of the runs (a mean s / sqrt(n), s itself s / sqrt(2 (n - 1)), JCGM 100,
E.4.3); and *measurement*, errors that all runs share and that no repetition shows. They cancel
in the reversal and leave the repeatability alone. Noise of the measurement is in the scatter.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import hypot, inf, sqrt
from typing import Any, Final

import numpy as np
from scipy.special import stdtrit

from rotcal_ros.arrays import Floats

PROBABILITY: Final = 0.95
"""Coverage of the expanded uncertainty."""


@dataclass(frozen=True, slots=True)
class FigureUncertainty:
    """Standard uncertainties of one figure in rad; ``dof`` after Welch and Satterthwaite."""

    sampling: float
    measurement: float
    dof: float

    @property
    def std(self) -> float:
        """The combined standard uncertainty, rad."""
        return hypot(self.sampling, self.measurement)

    @property
    def expanded(self) -> float:
        """The expanded uncertainty of 95 % with Student's factor, rad (JCGM 100, G.4)."""
        # Beyond so many degrees of freedom the factor is the normal one; stdtrit knows no inf.
        factor = float(stdtrit(min(self.dof, 1e9), 0.5 + 0.5 * PROBABILITY))
        return factor * self.std

    def to_dict(self) -> dict[str, Any]:
        """Return plain types for JSON; rad, ``dof`` null when it is unlimited."""
        return {
            "sampling": self.sampling,
            "measurement": self.measurement,
            "std": self.std,
            "dof": None if self.dof == inf else self.dof,
            "expanded": self.expanded,
        }


@dataclass(frozen=True, eq=False)
class TargetStatistics:
    """Means and standard deviations (2, m) in rad of both directions, each of ``n`` runs.

    ``common`` (m, m) is the covariance of the errors that all runs share, rad^2.
    """

    mean: Floats
    s: Floats
    n: int
    common: Floats


def figure_uncertainties(statistics: TargetStatistics) -> dict[str, FigureUncertainty]:
    """Return the uncertainty of every figure under the name that it has in Iso230."""
    return {
        name: _propagated(statistics, *weights) for name, weights in _weights(statistics).items()
    }


def _propagated(statistics: TargetStatistics, of_mean: Floats, of_s: Floats) -> FigureUncertainty:
    """Return the uncertainty of sum(of_mean * mean) + sum(of_s * s)."""
    n = statistics.n
    terms = statistics.s**2 * (of_mean**2 / n + of_s**2 / (2.0 * (n - 1)))
    shared = of_mean.sum(axis=0)
    sampling = float(terms.sum())
    measurement = max(float(shared @ statistics.common @ shared), 0.0)
    share = float(np.sum(terms**2)) / (n - 1)
    dof = (sampling + measurement) ** 2 / share if share > 0.0 else inf
    return FigureUncertainty(sqrt(sampling), sqrt(measurement), dof)


def _weights(statistics: TargetStatistics) -> Mapping[str, tuple[Floats, Floats]]:
    """Return for every figure its derivatives (2, m) by the means and by the s."""
    mean, s = statistics.mean, statistics.s
    reversal = np.array([[1.0], [-1.0]])
    gap, none = mean[0] - mean[1], np.zeros_like(mean)
    middle = np.repeat(_ends(mean.mean(axis=0)[None, :]) / 2.0, 2, axis=0)
    both, up, down = slice(None), slice(0, 1), slice(1, 2)
    figures = {
        "reversal": (reversal * _at(np.abs(gap)) * np.sign(gap), none),
        "mean_reversal": (reversal * np.full(len(gap), 1.0 / len(gap)), none),
        "mean_range": (middle, none),
        "repeatability": _repeatability(gap, s),
    }
    for name, side in (("", both), ("_forward", up), ("_reverse", down)):
        width = none.copy()
        width[side] = _ends(mean[side])
        figures[f"systematic{name}"] = (width, none)
        figures[f"accuracy{name}"] = _accuracy(mean, s, side)
        if name:
            scatter = none.copy()
            scatter[side] = 4.0 * _at(s[side])
            figures[f"repeatability{name}"] = (none, scatter)
    return figures


def _at(values: Floats) -> Floats:
    """Return one at the largest value and zero elsewhere."""
    found = np.zeros_like(values)
    found[np.unravel_index(np.argmax(values), values.shape)] = 1.0
    return found


def _ends(values: Floats) -> Floats:
    """Return the derivatives of the range of ``values``."""
    return _at(values) - _at(-values)


def _accuracy(mean: Floats, s: Floats, side: slice) -> tuple[Floats, Floats]:
    of_mean, of_s = np.zeros_like(mean), np.zeros_like(mean)
    high, low = _at(mean[side] + 2.0 * s[side]), _at(2.0 * s[side] - mean[side])
    of_mean[side], of_s[side] = high - low, 2.0 * (high + low)
    return of_mean, of_s


def _repeatability(gap: Floats, s: Floats) -> tuple[Floats, Floats]:
    """Return the derivatives of the largest R_i: of one direction, or of both with B_i."""
    ways = np.array([2.0 * s.sum(axis=0) + np.abs(gap), 4.0 * s[0], 4.0 * s[1]])
    way, target = np.unravel_index(np.argmax(ways), ways.shape)
    of_mean, of_s = np.zeros_like(s), np.zeros_like(s)
    if way == 0:
        of_mean[:, target] = np.sign(gap[target]) * np.array([1.0, -1.0])
        of_s[:, target] = 2.0
    else:
        of_s[way - 1, target] = 4.0
    return of_mean, of_s
