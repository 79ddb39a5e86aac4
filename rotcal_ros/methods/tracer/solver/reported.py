"""How far lengths follow the places that the machine reports: each is moved by that share of them.

A machine comes to a target anew for every length and reports where it stands. What it reports
beside the mean of the target is a move of the probe, of standard deviation p, and noise of the
report, q. The lengths feel the move alone. The best guess of a move is therefore the report times
w = p^2 / (p^2 + q^2), and p q / sqrt(p^2 + q^2) of it remains: with S^2 = p^2 + q^2 along the
beams, w (1 - w) S^2 in squares.

w is a slope: of the lengths over what the reports say along the beams, with stations, targets
and zeros free. It needs no statement about the machine, and costs one degree of freedom; what a
machine states of its points is mostly an error that stays, and says nothing here. A slope that 1
explains within CONSISTENT standard deviations is 1: the reports are believed; one that 0 explains
alone, or with less noise beyond what is stated of the lengths, is 0: the machine stood still, and
the lengths stay as they are, to the last bit.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from math import sqrt
from typing import Final, Generic, TypeVar

import numpy as np

from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.errors import RotcalError
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import MICROMETRE

CONSISTENT: Final = 3.0
"""Standard deviations within which a weight of 1, or of 0, is what the lengths say."""
MOST_STEPS: Final = 4
"""Gauss-Newton steps of the weight, in which the lengths are nearly linear."""
SETTLED: Final = 0.1
"""Step of the weight, in its standard deviations, that is the last."""
NOISELESS: Final = 1e-2
"""Chi-squared over its mean below which lengths are without noise, made up."""
UNNOTICED: Final = 0.01
"""Shift of a target, in standard deviations of a length, that does not matter."""

S = TypeVar("S")


@dataclass(frozen=True, slots=True)
class Slope:
    """What the residuals of a solution say of a column of errors, whose size they do not hold.

    ``score``: half the slope of chi-squared in the size; ``information``: half its curvature, both
    in the standard deviations of the solution, whose ``chi2`` has mean ``dof``. ``excess``: what
    the lengths scatter beyond their statement, m, where they contradict it.
    """

    score: float
    information: float
    chi2: float
    dof: int
    excess: float = 0.0

    @property
    def step(self) -> float:
        """The size that fits best."""
        return self.score / self.information

    @property
    def std(self) -> float:
        """The standard deviation of :attr:`step`, by what is left of chi-squared at that size."""
        left = max(self.chi2 - self.score * self.step, 0.0) / (self.dof - 1)
        return sqrt(max(left, NOISELESS) / self.information)

    @property
    def distance(self) -> float:
        """How many standard deviations the best size is away."""
        return abs(self.step) / self.std

    @property
    def known(self) -> bool:
        """Whether the lengths say anything about the size."""
        return self.dof > 1 and self.information > 0.0

    def spoiled(self, along: float) -> bool:
        """Whether noise of the reports, which scatter by ``along`` (m), may be the excess.

        As much noise in believed reports turns the slope by its share of their variance.
        """
        share = (self.excess / along) ** 2
        return 0.0 < share < 1.0 and abs(self.step + share) < CONSISTENT * self.std


@dataclass(frozen=True, slots=True)
class Reported:
    """The ``weight`` of the reported places, 0 to 1, with its standard deviation ``std``.

    ``along``: by how much the reports of one target scatter along the beams, m (standard
    deviation); ``left``: what stays unknown of a length for it, m, which has joined its standard
    deviation. ``estimated``: neither 1 nor 0 explains the lengths. ``spoils``: the lengths scatter
    beyond their statement by so much (m), and noise of the believed reports would explain it.
    """

    weight: float
    std: float
    along: float
    left: float
    estimated: bool = False
    spoils: float = 0.0

    @property
    def warning(self) -> str | None:
        """What to say where the reports are not believed, or should not be; None: all is well."""
        if self.weight == 1.0 and not self.estimated:
            return self._doubt() if self.spoils else None
        text = (
            f"reported places: what the machine reports of the probe scatters by "
            f"{self.along / MICROMETRE:.2g} um along the beams, and the lengths "
        )
        if not self.estimated:
            return f"{text}do not follow it: it is noise of the reports, and was not used"
        return (
            f"{text}follow {100 * self.weight:.0f} % of it (standard deviation "
            f"{100 * self.std:.0f} %): the rest is noise of the reports; the lengths were reduced "
            f"by that share, and {self.left / MICROMETRE:.2g} um joined their standard deviation"
        )

    def _doubt(self) -> str:
        return (
            f"reported places: the lengths were reduced by what the machine reports of the probe, "
            f"{self.along / MICROMETRE:.2g} um along the beams; if {self.spoils / MICROMETRE:.2g} "
            "um of that is noise of the reports, it is what makes the lengths scatter: compare "
            "with what the machine reports while it stands still"
        )


@dataclass(frozen=True)
class WeighedSolution(Generic[S]):
    """A solution and the weight that it gives the reported places; None: none had to be found."""

    solution: S
    reported: Reported | None


def noticed(shift: Floats, length_std: Floats) -> bool:
    """Return whether any length feels what was reported beside the mean place, (k, 3), m."""
    return bool(np.abs(shift).max(initial=0.0) >= UNNOTICED * length_std.min())


def scatter_along(along: Floats, target: Ints) -> float:
    """Return the standard deviation of ``along`` (k,) about the mean of each target (k,), m."""
    free = len(along) - len(np.unique(target))
    return float(np.sqrt((along**2).sum() / max(free, 1)))


def weigh(
    unmoved: S, moved: Callable[[float, float], S], slope: Callable[[S], Slope], along: float
) -> WeighedSolution[S]:
    """Return the solution with the weight that the lengths give the reported places.

    ``unmoved``: the solution with weight 0; ``moved``: makes the one with a weight and with what
    is left of the reports (m) joined to the lengths; ``slope``: of a solution, over the reports
    along the beams, which scatter by ``along`` (m).
    """
    at_none = slope(unmoved)
    try:
        believed = moved(1.0, 0.0)
    except RotcalError:
        if not at_none.known:
            raise
        return WeighedSolution(unmoved, Reported(0.0, at_none.std, along, 0.0))
    at_all = slope(believed)
    if not (at_none.known and at_all.known):
        return WeighedSolution(believed, Reported(1.0, 0.0, along, 0.0))
    spoils = at_all.excess if at_all.spoiled(along) else 0.0
    calmer = at_none.distance < CONSISTENT and at_none.excess < spoils
    if at_all.distance < CONSISTENT and not calmer:
        return WeighedSolution(believed, Reported(1.0, at_all.std, along, 0.0, spoils=spoils))
    if at_none.distance < CONSISTENT:
        return WeighedSolution(unmoved, Reported(0.0, at_none.std, along, 0.0))
    nearer = (0.0, at_none) if at_none.distance < at_all.distance else (1.0, at_all)
    return _between(moved, slope, along, *nearer)


def _between(
    moved: Callable[[float, float], S],
    slope: Callable[[S], Slope],
    along: float,
    weight: float,
    here: Slope,
) -> WeighedSolution[S]:
    """Return the solution with the weight that fits best, from a ``weight`` and its slope."""
    for _ in range(MOST_STEPS):
        step = min(max(weight + here.step, 0.0), 1.0) - weight
        weight, std = weight + step, here.std
        left = along * sqrt(weight * (1.0 - weight) + std**2)
        solution = moved(weight, left)
        if abs(step) < SETTLED * std:
            break
        here = slope(solution)
    return WeighedSolution(solution, Reported(weight, std, along, left, estimated=True))


def with_reported(result: Result, reported: Reported | None) -> Result:
    """Return a result that says what was made of the reported places."""
    if reported is None:
        return result
    warning = reported.warning
    warnings = () if warning is None else (warning,)
    return replace(
        result,
        warnings=(*result.warnings, *warnings),
        details={**result.details, "reported_places": asdict(reported)},
    )
