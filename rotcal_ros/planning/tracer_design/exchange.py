"""Whole plans: which lengths to measure so that the goal is met and each length is checked.

All further lengths, and all removals, are judged at once: by Sherman and Morrison one length more
or less changes every variance, redundancy and effect in closed form. What a plan lacks of its
demands is a penalty; lengths are taken away while there is none, and exchanged while there is
(tabu search: Glover, *ORSA J. Comput.* 1 (1989) 190).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from rotcal_ros.arrays import Floats, Ints
from rotcal_ros.components import COVERAGE_FACTOR
from rotcal_ros.planning.tracer_design.checks import detectable_in_std
from rotcal_ros.planning.tracer_design.information import Information
from rotcal_ros.planning.tracer_design.optimum import Progress
from rotcal_ros.planning.tracer_design.scene import Lengths, Scene

ENOUGH: Final = 1e-12
"""Penalty that is none."""
SMALLEST: Final = 0.02
"""Redundancy below which effects are no longer told apart, to keep the penalty finite."""
UNCHECKED: Final = 1e-3
"""Redundancy of a length without which something is undetermined."""
GOAL_WEIGHT: Final = 10.0
REDUNDANCY_WEIGHT: Final = 40.0
LOOKED_AT: Final = 350
"""Candidates judged at a time: of the targets in use, and others by chance."""
BY_CHANCE: Final = 150
TABU: Final = (5, 30)
"""For how many exchanges a length that went or came stays where it is."""


@dataclass(frozen=True)
class Demands:
    """What a plan has to meet: variances in rad^2, of the angles less their mean.

    ``mean`` and ``largest`` variance, with error motion; ``redundancy`` of each length; ``share``:
    effect of an undetected error in expanded uncertainties; ``per_station``: lengths each station
    has at least; ``significance``, ``power``: of the test of single lengths. ``checked`` False:
    only the variances count.
    """

    mean: float
    largest: float
    redundancy: float = 0.25
    share: float = 1.0
    per_station: int = 5
    significance: float = 0.01
    power: float = 0.8
    checked: bool = True


class Plan:
    """One choice of lengths and how far it is from the demands."""

    def __init__(self, known: Information, demands: Demands) -> None:
        self.known, self.demands = known, demands
        count = max(len(known.lengths), 1)
        self._delta0 = detectable_in_std(count, demands.significance, demands.power)
        self._beams = known.beams(known.lengths)
        self._variances = known.variances()

    @property
    def penalty(self) -> float:
        """Zero when all demands are met."""
        beams = self._beams
        redundancy = 1.0 - beams.spread / beams.variance
        own = self._of_lengths(self._variances, beams.angles, redundancy, beams.variance)
        return float(self._of_goal(self._variances) + own.sum())

    def with_each(self, candidates: Lengths) -> Floats:
        """Return the penalties (c,) with one more length, for each of the ``candidates``."""
        new, old = self.known.beams(candidates), self._beams
        base = new.variance + new.spread
        share = self.known.between(candidates, self.known.lengths) / base[:, None]
        variances = self._variances - new.angles**2 / base[:, None]
        angles = old.angles - share[:, :, None] * new.angles[:, None]
        spread = old.spread - share**2 * base[:, None]
        ours = self._of_lengths(
            variances[:, None], angles, 1.0 - spread / old.variance, old.variance
        )
        left = new.variance / base
        its = self._of_lengths(variances, new.angles * left[:, None], left, new.variance)
        return np.asarray(self._of_goal(variances) + ours.sum(axis=1) + its, dtype=np.float64)

    def without_each(self) -> Floats:
        """Return the penalties (N,) without one length, infinite where it cannot be missed."""
        old, lengths = self._beams, self.known.lengths
        base = np.maximum(old.variance - old.spread, UNCHECKED * old.variance)
        share = self.known.between(lengths, lengths) / base[:, None]
        variances = self._variances + old.angles**2 / base[:, None]
        angles = old.angles + share[:, :, None] * old.angles[:, None]
        spread = old.spread + share**2 * base[:, None]
        ours = self._of_lengths(
            variances[:, None], angles, 1.0 - spread / old.variance, old.variance
        )
        np.fill_diagonal(ours, 0.0)
        penalties = self._of_goal(variances) + ours.sum(axis=1)
        at_station = np.bincount(lengths.position)[lengths.position]
        needed = at_station <= self.demands.per_station
        needed |= base <= UNCHECKED * old.variance
        return np.where(needed, np.inf, penalties)

    def _of_goal(self, variances: Floats) -> Floats:
        """Return what variances (..., m) lack of the goal."""
        mean = np.maximum(variances.mean(axis=-1) / self.demands.mean - 1.0, 0.0)
        largest = np.maximum(variances.max(axis=-1) / self.demands.largest - 1.0, 0.0)
        return np.asarray(GOAL_WEIGHT * (mean + largest), dtype=np.float64)

    def _of_lengths(
        self, variances: Floats, angles: Floats, redundancy: Floats, variance: Floats
    ) -> Floats:
        """Return what each length (...) lacks; ``angles`` (..., m), ``variances`` (..., m)."""
        demands = self.demands
        if not demands.checked:
            return np.zeros(redundancy.shape)
        safe = np.maximum(redundancy, SMALLEST)
        effect = (angles**2 / variances).max(axis=-1) * self._delta0**2 / (variance * safe)
        share = np.sqrt(effect) / COVERAGE_FACTOR
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
    search = _Search(scene, pool, segments, demands, start, repeats, seed)
    while search.exchanges < exchanges:
        search.proceed()
        if progress is not None:
            progress(search.exchanges, exchanges)
    return search.best


class _Search:
    """The state of the search."""

    def __init__(
        self,
        scene: Scene,
        pool: Lengths,
        segments: int,
        demands: Demands,
        start: Ints,
        repeats: int,
        seed: int,
    ) -> None:
        self.scene, self.pool, self.segments, self.demands = scene, pool, segments, demands
        self.chosen, self.repeats = start, repeats
        self.best: Ints | None = None
        self.exchanges = 0
        self._tabu = np.zeros(len(pool), dtype=np.int64)
        self._rng = np.random.default_rng(seed)

    def proceed(self) -> None:
        """Take a length away where all demands are met, else exchange one."""
        plan = self._plan(self.chosen)
        if plan.penalty < ENOUGH:
            self.best = self.chosen
            penalties = plan.without_each()
            gone = int(np.argmin(penalties))
            if not np.isfinite(penalties[gone]):
                self.exchanges += 1  # none can be missed: an exchange of what is needed follows
            self._hold(self.chosen[gone])
            self.chosen = np.delete(self.chosen, gone)
            return
        self.exchanges += 1
        free = self._candidates()
        if not len(free):
            return  # all that could come has just gone, or is there already
        came = int(free[np.argmin(plan.with_each(self.pool[free]))])
        more = np.append(self.chosen, came)
        self._hold(came)
        if self.best is None and self.exchanges % 2:
            self.chosen = more  # too few so far
            return
        penalties = self._plan(more).without_each()
        penalties[self._tabu[more] > self.exchanges] = np.inf
        gone = int(np.argmin(penalties))
        self._hold(more[gone])
        self.chosen = np.delete(more, gone)

    def _plan(self, chosen: Ints) -> Plan:
        return Plan(Information(self.scene, self.pool[chosen], self.segments), self.demands)

    def _hold(self, index: int) -> None:
        self._tabu[index] = self.exchanges + int(self._rng.integers(*TABU))

    def _candidates(self) -> Ints:
        """Return candidates that may come: of the targets in use, and some by chance."""
        count = np.bincount(self.chosen, minlength=len(self.pool))
        free = np.flatnonzero((count < self.repeats) & (self._tabu <= self.exchanges))
        in_use = np.isin(self.pool.target[free], self.pool.target[self.chosen])
        by_chance = self._rng.random(len(free)) < BY_CHANCE / len(self.pool)
        free = free[in_use | by_chance]
        if len(free) > LOOKED_AT:
            free = self._rng.choice(free, LOOKED_AT, replace=False)
        return np.asarray(free, dtype=np.int64)
