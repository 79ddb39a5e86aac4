"""The ideal plan, which may measure fractions of a length, and the bound that no plan can beat.

phi(w), the mean variance of the angles, is convex in the weights w >= 0 of the candidates, with
the slopes d = - d phi / d w. A convex function lies above its tangent, so every plan w with
phi(w) <= goal satisfies, for any w0 at all,

    sum w d >= phi(w0) + sum w0 d - goal

and so N = sum w >= that, divided by the largest d; where a pair is measured at most r times, N is
at least the number of the largest d, each taken r times, that reach it. At the optimum N and bound
agree, and all weight is where d is largest (equivalence theorem: Kiefer and Wolfowitz, *Canad. J.
Math.* 12 (1960) 363). The weights are found by the multiplicative algorithm (Silvey, Titterington
and Torsney, *Commun. Statist.* A 7 (1978) 1379); columns that have lost their weight are set
aside, and the best of them taken up again (column generation).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Bools, Floats
from rotcal_ros.foundation.components import COVERAGE_FACTOR
from rotcal_ros.foundation.errors import PlanError
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.methods.tracer.policy.exchange import Progress
from rotcal_ros.methods.tracer.policy.information import Information, Lengths, Scene

POWER: Final = 0.7
"""Exponent of the multiplicative step: 1 is quick and may swing, 0.5 is slow and sure."""
ROUNDS: Final = 40
"""Looks at all candidates before the search gives up."""
STEPS: Final = 25
"""Steps between two looks at all candidates."""
LARGEST_SCALING: Final = 0.5
"""Share by which all weights change at most in one step."""
SCALINGS: Final = 4
"""Scalings in a row that bring a plan to its goal."""
PRUNED: Final = 1e-4
"""Weight, as a share of the largest, below which a candidate is set aside."""
NEARLY: Final = 0.999
"""Share of the largest slope from which a candidate is taken up again."""


@dataclass(frozen=True, eq=False)
class Optimum:
    """The ideal plan: ``weight`` (k,) of each candidate, ``count`` lengths in all.

    ``bound``: no plan that reaches the goal has fewer lengths. ``slopes`` (k,): - d phi / d weight
    of the candidates, rad^2.
    """

    weight: Floats
    count: float
    bound: float
    slopes: Floats

    @property
    def gap(self) -> float:
        """How far the ideal plan lies above the bound, as a share of the bound."""
        return self.count / self.bound - 1.0 if self.bound > 0.0 else np.inf


def ideal_plan(
    scene: Scene,
    candidates: Lengths,
    segments: int,
    goal: float,
    *,
    repeats: int | None = None,
    gap: float = 0.03,
    progress: Progress | None = None,
) -> Optimum:
    """Return the ideal plan that reaches a mean variance ``goal`` (rad^2) of the angles.

    ``repeats``: how often a pair may be measured, None for any number. It stops at ``gap`` or
    after ROUNDS. Raises PlanError when all candidates together do not reach the goal.
    """
    search = _MultiplicativeSearch(scene, candidates, segments, goal, repeats)
    for done in range(ROUNDS):
        search.look_at_all()
        if progress is not None:
            progress(done, ROUNDS)
        if search.best is not None and search.best.gap <= gap:
            break
        for _ in range(STEPS):
            search.step()
    if progress is not None:
        progress(ROUNDS, ROUNDS)
    if search.best is None:
        raise PlanError("the ideal plan does not settle: widen the volume or the goal")
    return search.best


def least_count(
    phi: float, weight: Floats, slopes: Floats, goal: float, repeats: int | None = None
) -> float:
    """Return the bound from the design ``weight`` (k,) with ``phi`` and ``slopes``; see above."""
    needed = phi + float(weight @ slopes) - goal
    if needed <= 0.0:
        return 0.0
    if repeats is None:
        return needed / float(slopes.max())
    best = repeats * np.sort(slopes)[::-1]
    reached = np.cumsum(best)
    whole = int(np.searchsorted(reached, needed))
    if whole == len(best):
        return float(repeats * len(best))
    before = reached[whole - 1] if whole else 0.0
    return float(repeats * (whole + (needed - before) / best[whole]))


class _MultiplicativeSearch:
    """The state of the multiplicative algorithm."""

    def __init__(
        self, scene: Scene, candidates: Lengths, segments: int, goal: float, repeats: int | None
    ) -> None:
        self.scene, self.candidates, self.segments = scene, candidates, segments
        self.goal, self.repeats = goal, repeats
        self.best: Optimum | None = None
        self.bound = 0.0
        self.rounds = 0
        most = np.inf if repeats is None else float(repeats)
        ceiling = self._information(np.full(len(candidates), min(most, 1e6)))
        if ceiling.mean_variance > goal:
            raise PlanError(
                f"out of reach: all {len(candidates)} candidates together leave U(ECC) "
                f"{_expanded_arcsec(ceiling.mean_variance):.3g} arcsec (k = 2, rms), the goal "
                f"is {_expanded_arcsec(goal):.3g}: widen the volume, allow low targets, or "
                "allow repeats"
            )
        self.cap = most
        # twelve lengths per station, shared evenly among all candidates
        start = 4.0 * scene.stations.size / len(candidates)
        self.weight = np.full(len(candidates), min(start, most))

    def look_at_all(self) -> None:
        """Renew the bound, keep the best plan, and take up candidates that were set aside."""
        information = self._on_goal()
        slopes = information.slopes(self.candidates)
        phi, count = information.mean_variance, float(self.weight.sum())
        bound = least_count(phi, self.weight, slopes, self.goal, self.repeats)
        self.bound = max(self.bound, bound)
        if phi <= self.goal and (self.best is None or count < self.best.count):
            self.best = Optimum(self.weight.copy(), count, self.bound, slopes)
        elif self.best is not None:
            self.best = replace(self.best, bound=self.bound)
        level = slopes[self.weight < self.cap].max(initial=0.0)
        fresh = (self.weight == 0.0) & (slopes > NEARLY * level)
        self.weight[fresh] = 1e-3 * self.weight.max()
        self.rounds += 1

    def step(self) -> None:
        """One multiplicative step on the candidates in use, scaled towards the goal.

        Those that are measured as often as may be have slopes above the others: what is equal at
        the optimum, and what can be scaled, are the slopes and weights of the rest.
        """
        used: Bools = self.weight > 0.0
        information = self._information(self.weight)
        weight = self.weight[used]
        slopes = information.slopes(self.candidates[used])
        rest = np.where(weight < self.cap, weight, 0.0)
        if not rest.any():
            rest = weight
        felt = float(rest @ slopes)
        scaling = (information.mean_variance - self.goal) / felt
        scaling = 1.0 + min(max(scaling, -LARGEST_SCALING), LARGEST_SCALING)
        weight = scaling * weight * (slopes * rest.sum() / felt) ** POWER
        weight = np.minimum(weight, self.cap)
        pruned = PRUNED if self.rounds > 4 else 1e-3 * PRUNED
        weight[weight < pruned * weight.max()] = 0.0
        self.weight[used] = weight

    def _on_goal(self) -> Information:
        """Scale the weights until the goal is just met, where a few scalings can do that."""
        information = self._information(self.weight)
        floor = float(np.trace(self.scene.error_motion_angles)) / len(self.scene.stations)
        for _ in range(SCALINGS):
            excess = (information.mean_variance - floor) / (self.goal - floor) - 1.0
            if not 0.0 < excess < LARGEST_SCALING:
                break
            # variance falls like 1 / weight, or more slowly where targets limit it
            self.weight = np.minimum(self.weight * (1.0 + 1.5 * excess), self.cap)
            information = self._information(self.weight)
        return information

    def _information(self, weight: Floats) -> Information:
        used = weight > 0.0
        lengths = self.candidates[used].weighing(weight[used])
        return Information(self.scene, lengths, self.segments)


def _expanded_arcsec(variance: float) -> float:
    return COVERAGE_FACTOR * float(np.sqrt(variance)) / ARCSEC
