"""Whole plans: which lengths to measure so that the goal is met and each length is checked.

What a plan lacks of its demands is a penalty. Lengths are taken away while there is none, and
exchanged while there is (tabu search: Glover, *ORSA J. Comput.* 1 (1989) 190).

The penalty follows from three quantities of the lengths that may be chosen (the *pool*): the
covariance C = g' F^-1 g of the computed lengths, their effect A = G F^-1 g on the angles, and the
angles' variances. One length more or less changes each in closed form (Sherman and Morrison):

    C -= c c' / b,   A -= c a' / b,   variances -= a^2 / b,      b = v + c_ii, or c_ii - v

with c, a its column of C and its row of A, v its own variance. So every choice that differs by one
length is judged at once, without another adjustment.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.components import COVERAGE_FACTOR
from rotcal_ros.methods.tracer.policy.information import (
    Information,
    Lengths,
    Scene,
    Spread,
    detectable_in_std,
)

Progress = Callable[[int, int], None]

SMALLEST: Final = 0.02
"""Redundancy below which effects are no longer distinguished, to keep the penalty finite."""
UNCHECKED: Final = 1e-3
"""Redundancy of a length without which something is undetermined."""
MISSING: Final = 1.0
"""Penalty of each length that a station has too few."""
FLAT: Final = 1.0
"""Penalty of a station whose targets lie in a plane."""
GOAL_WEIGHT: Final = 10.0
REDUNDANCY_WEIGHT: Final = 40.0
"""Factors that make penalties of a lacking share of the goal and a squared lack of redundancy."""
ENOUGH: Final = 1e-12
"""Penalty that is none."""
NEARLY: Final = 1e-9
"""Penalty, with the rounding of many exchanges, from which it is worked out anew."""
RENEWED: Final = 100
"""Exchanges after which the rounding is taken away."""
LOOKED_AT: Final = 40_000
"""Candidates judged at a time, times lengths in the plan."""
TABU: Final = (2, 10)
"""For how many exchanges a length that went or came stays where it is: short, for the best plans
lie close to each other."""


@dataclass(frozen=True)
class Demands:
    """What a plan has to meet: variances in rad^2, of the angles less their mean.

    ``mean`` and ``largest`` variance, with error motion; ``redundancy`` of each length; ``share``:
    effect of an undetected error in expanded uncertainties; ``per_station``: lengths each station
    has at least; ``significance``, ``power``: of the test of single lengths; ``depth``: of the
    targets of each station, see :class:`~.information.Spread`. ``checked`` False: neither
    redundancy nor share counts.
    """

    mean: float
    largest: float
    redundancy: float = 0.25
    share: float = 1.0
    per_station: int = 5
    significance: float = 0.01
    power: float = 0.8
    checked: bool = True
    depth: float = 0.0


class LengthSelection:
    """The lengths ``chosen`` (N,), indices into the ``pool``, and how they meet the demands.

    An index may come more than once. ``add`` and ``remove`` change the choice; ``renew`` takes
    away the rounding that they gather.
    """

    def __init__(
        self, scene: Scene, pool: Lengths, segments: int, demands: Demands, chosen: Ints
    ) -> None:
        self.scene, self.pool, self.segments, self.demands = scene, pool, segments, demands
        self.chosen = np.array(chosen, dtype=np.int64)
        self.recompute()

    def recompute(self) -> None:
        """Work all out anew from the chosen lengths."""
        known = Information(self.scene, self.pool[self.chosen], self.segments)
        beams = known.beams(self.pool)
        self._covariance = known.between(self.pool, self.pool)
        self._angles, self._own, self.variances = beams.angles, beams.variance, known.variances()

    def add(self, index: int) -> None:
        """Take in the length ``index``."""
        self._change(index, self._own[index] + self._covariance[index, index])
        self.chosen = np.append(self.chosen, index)

    def remove(self, number: int) -> None:
        """Take away the length that stands at place ``number`` of the chosen ones."""
        index = int(self.chosen[number])
        self._change(index, self._covariance[index, index] - self._own[index])
        self.chosen = np.delete(self.chosen, number)

    def _change(self, index: int, base: float) -> None:
        column, angles = self._covariance[index].copy(), self._angles[index].copy()
        self._covariance -= np.outer(column, column / base)
        self._angles -= np.outer(column, angles / base)
        self.variances = self.variances - angles**2 / base

    @property
    def missing(self) -> Ints:
        """How many lengths each station (m,) has too few."""
        found = np.bincount(self.pool.position[self.chosen], minlength=len(self.scene.stations))
        return np.asarray(np.maximum(self.demands.per_station - found, 0), dtype=np.int64)

    @property
    def least(self) -> bool:
        """Whether no choice of fewer lengths has enough of them at every station."""
        return len(self.chosen) <= self.demands.per_station * len(self.scene.stations)

    @property
    def penalty(self) -> float:
        """Zero when all demands are met."""
        nothing = np.zeros((1, len(self.chosen)))
        found = self._with(nothing, np.zeros((1, len(self.variances))), np.ones(1))[0]
        return float(found) + MISSING * float(self.missing.sum()) + float(self._flat.sum())

    @property
    def _flat(self) -> Floats:
        """What the depth of each station's targets (m,) lacks."""
        if not self.demands.depth:
            return np.zeros(len(self.scene.stations))
        return self._lacking_depth(Spread.of(self.scene, self.pool[self.chosen]).depth)

    def _flat_after(self, changes: Ints, sign: float) -> Floats | float:
        """Return what depths lack (c,) with one length more or less: ``sign`` 1 or -1."""
        if not self.demands.depth:
            return 0.0
        now = Spread.of(self.scene, self.pool[self.chosen])
        flat, lengths = self._lacking_depth(now.depth), self.pool[changes]
        after = self._lacking_depth(now.depth_after(self.scene, lengths, sign))
        return np.asarray(flat.sum() - flat[lengths.position] + after, dtype=np.float64)

    def _lacking_depth(self, depth: Floats) -> Floats:
        return np.asarray(FLAT * np.maximum(1.0 - depth / self.demands.depth, 0.0))

    def with_each(self, candidates: Ints) -> Floats:
        """Return the penalties (c,) with one more length, for each of the ``candidates`` (c,)."""
        own, angles = self._own[candidates], self._angles[candidates]
        base = own + self._covariance[candidates, candidates]
        ours = self._with(self._covariance[np.ix_(candidates, self.chosen)], angles, base)
        left = own / base
        variances = self.variances - angles**2 / base[:, None]
        effect = (angles**2 / variances).max(axis=1) * left**2
        missing = self.missing
        short = MISSING * (missing.sum() - (missing[self.pool.position[candidates]] > 0))
        lacking = ours + self._of_lengths(effect, left, own) + short
        lacking += self._flat_after(candidates, 1.0)
        return np.asarray(lacking, dtype=np.float64)

    def without_each(self) -> Floats:
        """Return the penalties (N,) without one length, infinite where it cannot be missed."""
        chosen = self.chosen
        own = self._own[chosen]
        redundant = own - self._covariance[chosen, chosen]
        base = np.maximum(redundant, UNCHECKED * own)
        cross = self._covariance[np.ix_(chosen, chosen)]
        penalties = self._with(cross, self._angles[chosen], -base, gone=True)
        penalties += MISSING * self.missing.sum()  # none goes where one is missing
        penalties += self._flat_after(chosen, -1.0)
        position = self.pool.position[chosen]
        needed = np.bincount(position)[position] <= self.demands.per_station
        needed |= redundant <= UNCHECKED * own
        return np.where(needed, np.inf, penalties)

    def _with(self, cross: Floats, angles: Floats, base: Floats, *, gone: bool = False) -> Floats:
        """Return the penalties (c,) of goal and chosen lengths after each of c changes.

        ``cross`` (c, N): covariance with the chosen lengths; ``angles`` (c, m); ``base`` (c,).
        ``gone``: change i is the loss of the chosen length i, which counts no more.
        """
        own, ours = self._own[self.chosen], self._angles[self.chosen]
        share = cross / base[:, None]
        variances = self.variances - angles**2 / base[:, None]
        penalties = self._of_goal(variances)
        if not self.demands.checked:
            return penalties
        spread = self._covariance[self.chosen, self.chosen] - share * cross
        inverse = 1.0 / np.sqrt(variances)
        largest = np.zeros_like(share)
        for angle in range(angles.shape[1]):  # one at a time fits the cache
            effect = share * angles[:, angle, None]
            np.subtract(ours[:, angle], effect, out=effect)
            effect *= inverse[:, angle, None]
            np.maximum(largest, np.abs(effect, out=effect), out=largest)
        lacking = self._of_lengths(largest**2, 1.0 - spread / own, own)
        if gone:
            np.fill_diagonal(lacking, 0.0)
        return np.asarray(penalties + lacking.sum(axis=1), dtype=np.float64)

    def _of_goal(self, variances: Floats) -> Floats:
        """Return what variances (..., m) lack of the goal."""
        mean = np.maximum(variances.mean(axis=-1) / self.demands.mean - 1.0, 0.0)
        largest = np.maximum(variances.max(axis=-1) / self.demands.largest - 1.0, 0.0)
        return np.asarray(GOAL_WEIGHT * (mean + largest), dtype=np.float64)

    def _of_lengths(self, effect: Floats, redundancy: Floats, own: Floats) -> Floats:
        """Return what each length lacks.

        ``effect``: the largest square of its effect on an angle by that angle's variance, m^-2.
        """
        demands = self.demands
        if not demands.checked:
            return np.zeros(redundancy.shape)
        count = max(len(self.chosen), 1)
        delta0 = detectable_in_std(count, demands.significance, demands.power)
        safe = np.maximum(redundancy, SMALLEST)
        share = np.sqrt(effect / (own * safe)) * (delta0 / COVERAGE_FACTOR)
        too_much = np.maximum(share / demands.share - 1.0, 0.0) ** 2
        too_little = np.maximum(demands.redundancy - redundancy, 0.0) ** 2
        return np.asarray(too_much + REDUNDANCY_WEIGHT * too_little, dtype=np.float64)


def fewest_lengths(
    scene: Scene,
    pool: Lengths,
    segments: int,
    demands: Demands,
    start: Ints,
    *,
    repeats: int = 1,
    seed: int = 0,
    exchanges: int = 300,
    progress: Progress | None = None,
) -> Ints | None:
    """Return the indices into ``pool`` of the fewest lengths found that meet the ``demands``.

    An index may come up to ``repeats`` times. ``start``: indices to begin with, rather too many
    than too few. None when no plan was found within the ``exchanges``.
    """
    search = _ExchangeSearch(LengthSelection(scene, pool, segments, demands, start), repeats, seed)
    while search.exchanges < exchanges and not search.least:
        search.proceed()
        if progress is not None:
            progress(search.exchanges, exchanges)
    return search.best


class _ExchangeSearch:
    """The state of the search."""

    def __init__(self, choice: LengthSelection, repeats: int, seed: int) -> None:
        self.choice, self.repeats = choice, repeats
        self.best: Ints | None = None
        self.exchanges = 0
        self.least = False
        self._tabu = np.zeros(len(choice.pool), dtype=np.int64)
        self._rng = np.random.default_rng(seed)

    def proceed(self) -> None:
        """Take a length away where all demands are met, else exchange one."""
        if self._met():
            self.best, self.least = self.choice.chosen, self.choice.least
            penalties = self.choice.without_each()
            gone = int(np.argmin(penalties))
            if not np.isfinite(penalties[gone]):
                self.exchanges += 1  # none can be missed: an exchange of what is needed follows
            self._remove(gone)
            return
        self.exchanges += 1
        free = self._candidates()
        if not len(free):
            return  # all that could come has just gone, or is there already
        came = int(free[np.argmin(self.choice.with_each(free))])
        self.choice.add(came)
        self._hold(came)
        if self.best is None and self.exchanges % 2:
            return  # too few so far
        penalties = self.choice.without_each()
        penalties[self._tabu[self.choice.chosen] > self.exchanges] = np.inf
        self._remove(int(np.argmin(penalties)))

    def _met(self) -> bool:
        """Whether all demands are met, without the rounding that exchanges gather."""
        if self.choice.penalty < NEARLY or self.exchanges % RENEWED == RENEWED - 1:
            self.choice.recompute()
        return self.choice.penalty < ENOUGH

    def _remove(self, number: int) -> None:
        self._hold(int(self.choice.chosen[number]))
        self.choice.remove(number)

    def _hold(self, index: int) -> None:
        self._tabu[index] = self.exchanges + int(self._rng.integers(*TABU))

    def _candidates(self) -> Ints:
        """Return the lengths of the pool that may come, as indices."""
        count = np.bincount(self.choice.chosen, minlength=len(self.choice.pool))
        free = np.flatnonzero((count < self.repeats) & (self._tabu <= self.exchanges))
        most = LOOKED_AT // max(len(self.choice.chosen), 1)
        if len(free) > most:
            free = self._rng.choice(free, most, replace=False)
        return np.asarray(free, dtype=np.int64)
