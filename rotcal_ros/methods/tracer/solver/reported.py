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
from dataclasses import dataclass
from math import sqrt
from typing import Final, Protocol, TypeVar

import numpy as np

from rotcal_ros.adjust.engine import Adjusted
from rotcal_ros.adjust.fit import Fit, fit_model
from rotcal_ros.adjust.model import Model
from rotcal_ros.adjust.observable import observe_columns
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.language import Phrase, noted, phrase
from rotcal_ros.foundation.units import MICROMETRE
from rotcal_ros.methods.tracer.solver.carried_lengths import CarriedLengths

NOT_FOLLOWED: Final = noted("{0}do not follow it: it is noise of the reports, and was not used")

CONSISTENT: Final = 3.0
"""Standard deviations within which a weight of 1, or of 0, is what the lengths say."""
NOISELESS: Final = 1e-2
"""Chi-squared over its mean below which lengths are without noise, made up."""
UNNOTICED: Final = 0.01
"""Shift of a target, in standard deviations of a length, that does not matter."""


class SolvedLengths(Protocol):
    """A solution of lengths."""

    @property
    def found(self) -> Adjusted:
        """What the engine found."""


S = TypeVar("S", bound=SolvedLengths)


@dataclass(frozen=True, slots=True)
class ReportedPlaceWeight:
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
    def warning(self) -> Phrase | None:
        """What to say where the reports are not believed, or should not be; None: all is well."""
        if self.weight == 1.0 and not self.estimated:
            return self._doubt() if self.spoils else None
        text = phrase(
            "reported places: what the machine reports of the probe scatters by {0:.2g} um along "
            "the beams, and the lengths ", self.along / MICROMETRE
        )  # fmt: skip
        if not self.estimated:
            return phrase(NOT_FOLLOWED, text)
        return phrase(
            "{0}follow {1:.0f} % of it (standard deviation {2:.0f} %): the rest is noise of the "
            "reports; the lengths were reduced by that share, and {3:.2g} um joined their "
            "standard deviation", text, 100 * self.weight, 100 * self.std, self.left / MICROMETRE
        )  # fmt: skip

    def _doubt(self) -> Phrase:
        return phrase(
            "reported places: the lengths were reduced by what the machine reports of the probe, "
            "{0:.2g} um along the beams; if {1:.2g} um of that is noise of the reports, it is "
            "what makes the lengths scatter: compare with what the machine reports while it "
            "stands still", self.along / MICROMETRE, self.spoils / MICROMETRE
        )  # fmt: skip


def along_beams(lengths: CarriedLengths, moved: Floats | None) -> Floats | None:
    """Return by how much the reported moves (n, 3), m, of its target make each length longer.

    (k,), m; None where no length feels them. ``moved``: by row of the problem.
    """
    if moved is None or np.abs(moved).max(initial=0.0) < UNNOTICED * lengths.std.min():
        return None
    return np.asarray((lengths.toward * moved[lengths.row]).sum(axis=1))


def nearest_weight(model: Model, along: Floats) -> float:
    """Return 0 or 1, the nearest to what all lengths follow of what is reported ``along`` (k,).

    ``model``: of the lengths as they were read.
    """
    every = np.ones(model.size[0], dtype=np.bool_)
    return float(_slope(fit_model(model, every, model.std, model.first), along)[0] > 0.5)


def weigh_reported_places(
    solution: S, weight: float, lengths: CarriedLengths, along: Floats | None,
    again: Callable[[float, float], S],
) -> tuple[S, ReportedPlaceWeight | None]:  # fmt: skip
    """Return the solution with the weight that the lengths give what is reported, and that.

    ``solution``: with a ``weight``. By one more column; it is solved ``again``, with a weight and
    with what is left of the reports (m) joined to the lengths, where 1 or 0 does not explain them.
    """
    if along is None:
        return solution, None
    fit = solution.found.fit
    free = len(along) - len(np.unique(lengths.target))
    scatter = float(np.sqrt((along**2).sum() / max(free, 1)))
    beyond, information = _slope(fit, along)
    if not information or fit.dof < 2:
        return solution, ReportedPlaceWeight(weight, 0.0, scatter, 0.0)
    squares = max(fit.chi2 - information * beyond**2, 0.0) / (fit.dof - 1)
    std = sqrt(max(squares, NOISELESS) / information)
    best = weight + beyond

    def at(other: float) -> S:
        return solution if other == weight else again(other, 0.0)

    unmoved = at(0.0) if abs(best) < CONSISTENT * std else None
    if abs(best - 1.0) < CONSISTENT * std:
        believed = at(1.0)
        excess = _excess(believed, lengths)
        # as much noise in believed reports turns the slope by its share of their variance
        share = (excess / scatter) ** 2
        spoiled = 0.0 < share < 1.0 and abs(best - 1.0 + share) < CONSISTENT * std
        spoils = excess if spoiled else 0.0
        if unmoved is None or _excess(unmoved, lengths) >= spoils:
            return believed, ReportedPlaceWeight(1.0, std, scatter, 0.0, spoils=spoils)
    if unmoved is not None:
        return unmoved, ReportedPlaceWeight(0.0, std, scatter, 0.0)
    best = min(max(best, 0.0), 1.0)
    left = scatter * sqrt(best * (1.0 - best) + std**2)
    return again(best, left), ReportedPlaceWeight(best, std, scatter, left, estimated=True)


def _slope(fit: Fit, along: Floats) -> tuple[float, float]:
    """Return how much more of the reported moves the lengths follow, and its information."""
    seen = observe_columns(fit, np.pad(along, (0, fit.model.size[0] - len(along)))[:, None])
    information = float(seen.information[0, 0])
    if information <= 1e-9 * float(seen.whole[0]):
        return 0.0, 0.0
    return float(seen.score[0]) / information, information


def _excess(solution: SolvedLengths, lengths: CarriedLengths) -> float:
    """Return what lengths scatter beyond their statement, m; 0 where they do not contradict it."""
    noise, limits = solution.found.diagnosis.noise, solution.found.diagnosis.limits
    factor = float(noise.factors[0])
    if noise.estimated is None or factor <= 1.0:
        return 0.0
    if not noise.estimated.contradicted(limits.significance)[0]:
        return 0.0
    return float(lengths.std.mean()) * sqrt(factor**2 - 1.0)
