"""Jumps of the zero that nobody reported: a slipped fringe, a beam that broke unseen.

All lengths of a segment after some moment differing by the same amount from those before it are
tested like an outlier: the score of that shift over its standard deviation, with the unexplained
scatter of the other residuals (externally studentised). It has to stand out more than any single
length does, which would be an outlier. The zero is then split there, which costs one unknown.

The size is left free. That a slip is a whole fringe helps little to find it: the best of all
tests for slips of one fringe at any moment (Neyman and Pearson: the mean of the likelihood
ratios) finds hardly more of them (``scripts/zero_coverage.py --best``).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Ints
from rotcal_ros.methods.tracer.solver.adjustment import Adjustment
from rotcal_ros.methods.tracer.solver.grid import Grid
from rotcal_ros.methods.tracer.solver.zero_shifts import Shifts, shifts_at

MOST_FRINGES: Final = 3
"""Fringes that a counter slips at once; what is more is a beam that was broken."""
AGREES: Final = 2.58
"""Standard deviations by which the size of a slip may miss a whole number of fringes; 99 %."""


@dataclass(frozen=True, slots=True)
class Jump:
    """From the problem's row ``row`` on, the lengths of ``segment`` are ``size`` (m) longer.

    ``std``: standard deviation of the size, m; ``value``: that many of them, studentised.
    """

    segment: int
    row: int
    size: float
    std: float
    value: float

    def fringes(self, fringe: float) -> int:
        """Return how many times ``fringe`` (m) it is; 0 if it is no whole number, or many."""
        number = round(self.size / fringe) if fringe else 0
        agrees = abs(self.size - number * fringe) <= AGREES * self.std
        return number if agrees and abs(number) <= MOST_FRINGES else 0


def find_jump(
    grid: Grid,
    fit: Adjustment,
    shifts: Shifts,
    significance: float,
    margin: float = 1.0,
    at: Callable[[Ints], Shifts] | None = None,
) -> Jump | None:
    """Return the jump that stands out most; None if none does.

    ``shifts``: those of ``grid`` and ``fit`` at some moments. ``significance``: of the largest of
    all moments, two-sided; the limit is ``margin`` times its quantile. ``at`` gives the shifts at
    other moments; None: of the tracer's network. The jump's segment is a number of the moments'.
    """
    if not shifts.enough.any():
        return None
    limit = margin * shifts.limit(significance)
    best = int(np.argmax(np.where(shifts.enough, shifts.squared, 0.0)))
    about = shifts.about(best)
    near = shifts_at(grid, fit, shifts.moments, about) if at is None else at(about)
    k = int(np.argmax(near.squared))
    squared = float(near.squared[k])
    left = max(1.0, (fit.chi2 - squared) / max(fit.dof - 1, 1))
    value = float(np.sqrt(squared / left))
    if value < max(limit, float(np.abs(np.where(grid.used, fit.test_value, 0.0)).max())):
        return None
    begins, moments = near.at[k], near.moments
    return Jump(
        segment=int(moments.segment[begins]),
        row=int(grid.row[moments.strip[begins], moments.target[begins]]),
        size=float(near.score[k] / near.information[k]),
        std=float(np.sqrt(left / near.information[k])),
        value=value,
    )


def split(grid: Grid, jump: Jump, order: Ints) -> tuple[Grid, Ints]:
    """Return ``grid`` with a new zero from ``jump`` on, and the old strip of each new one."""
    filled = grid.row >= 0
    time = np.where(filled, order[grid.row], -1)
    begin = int(order[jump.row])
    assert grid.zero is not None
    assert grid.segment_ids is not None
    broken = int(grid.zero[np.nonzero(grid.row == jump.row)[0][0]])
    moved = filled & (grid.zero == broken)[:, None] & (time >= begin)
    parts = [np.flatnonzero(part.any(axis=1)) for part in (filled & ~moved, moved)]
    source, stay = np.concatenate(parts), len(parts[0])
    part = np.where((np.arange(len(source)) < stay)[:, None], ~moved[source], moved[source])
    zero = grid.zero[source]
    zero[stay:] = grid.n_zeros
    return replace(
        grid.take(source, part),
        zero=zero,
        segment_ids=np.append(grid.segment_ids, grid.segment_ids[broken]),
    ), source
