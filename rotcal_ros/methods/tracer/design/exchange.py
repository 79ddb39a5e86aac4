"""Whole plans: which lengths to measure so that the goal is met and each length is checked.

What a plan lacks of its demands is a penalty (:mod:`.penalty`); lengths are taken away while there
is none, and exchanged while there is (tabu search: Glover, *ORSA J. Comput.* 1 (1989) 190).
"""

from __future__ import annotations

from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Ints
from rotcal_ros.methods.tracer.design.optimum import Progress
from rotcal_ros.methods.tracer.design.penalty import Demands, LengthSelection
from rotcal_ros.methods.tracer.design.scene import Lengths, Scene

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
            self.choice.renew()
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
