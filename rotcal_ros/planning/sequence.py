"""The order of the lengths of a plan: the shortest way over table and machine.

An open travelling-salesman path over the pairs (table position, target). The times are not
symmetric, because a table that comes from above passes its angle and returns. Improved by
reversing a stretch (2-opt, Croes 1958) and by moving up to three lengths elsewhere (Or 1976), the
best move of all at a time; then kicked by double bridges (Martin, Otto and Felten 1991) and
improved again.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.sparse.csgraph import minimum_spanning_tree

from rotcal_ros.arrays import Floats, Ints
from rotcal_ros.planning.sequence_time import duration

LONGEST_MOVED: Final = 3
"""Lengths in a row that are moved elsewhere at once."""
LEAST_GAIN: Final = 1e-5
"""Gain (s) that is none: below it is the rounding of sums with FORBIDDEN."""
FORBIDDEN: Final = 1e5
"""Time (s) of a step that leaves its sweep too early."""


def nearest_next(costs: Floats, first: int = 0) -> Ints:
    """Return the path (k,) that always goes to the nearest length left; ``costs`` (k, k)."""
    left = np.ones(len(costs), dtype=np.bool_)
    order = np.empty(len(costs), dtype=np.int64)
    order[0] = first
    for number in range(1, len(costs)):
        left[order[number - 1]] = False
        order[number] = np.argmin(np.where(left, costs[order[number - 1]], np.inf))
    return order


def improved(costs: Floats, order: Ints, kicks: int = 0, seed: int = 0) -> Ints:
    """Return a shorter path than ``order`` (k,), or itself; ``kicks`` say how long to try."""
    best = _settled(costs, np.array(order))
    shortest, rng = duration(costs, best), np.random.default_rng(seed)
    if len(order) < 8:
        return best
    for _ in range(kicks):
        a, b, c = np.sort(rng.choice(np.arange(1, len(best)), 3, replace=False))
        kicked = np.concatenate([best[:a], best[b:c], best[a:b], best[c:]])
        kicked = _settled(costs, kicked)
        if (time := duration(costs, kicked)) < shortest - LEAST_GAIN:
            best, shortest = kicked, time
    return best


def shortest_possible(costs: Floats) -> float:
    """Return what no path through all lengths can beat, s: the lightest spanning tree.

    Of the smaller one of both directions; each path is a spanning tree.
    """
    both = np.minimum(costs, costs.T)
    least = both.min()
    # a weight of zero would be no edge
    tree = minimum_spanning_tree(both - least + 1.0)
    return float(tree.sum() + (least - 1.0) * (len(costs) - 1))


def in_sweeps(costs: Floats, sweep: Ints) -> Floats:
    """Return ``costs`` (k, k) for paths that take the blocks ``sweep`` (k,) in their order."""
    step = sweep - sweep[:, None]
    return np.asarray(costs + FORBIDDEN * ((step < 0) | (step > 1)), dtype=np.float64)


def _settled(costs: Floats, order: Ints) -> Ints:
    """Return the path after the best moves, until none gains."""
    while True:
        gain, changed = _best_reversal(costs, order)
        for count in range(1, LONGEST_MOVED + 1):
            other, moved = _best_shift(costs, order, count)
            if other > gain:
                gain, changed = other, moved
        if gain <= LEAST_GAIN:
            return order
        order = changed


def _best_reversal(costs: Floats, order: Ints) -> tuple[float, Ints]:
    """Return the gain (s) and the path with the best stretch reversed."""
    k = len(order)
    c = costs[order[:, None], order]
    forth = np.append(0.0, np.cumsum(np.diagonal(c, 1)))
    back = np.append(0.0, np.cumsum(np.diagonal(c, -1)))
    padded = np.zeros((k + 2, k + 2))  # to leave and to come costs nothing at the ends
    padded[1:-1, 1:-1] = c
    i, j = np.triu_indices(k, 1)
    before = padded[i, i + 1] + forth[j] - forth[i] + padded[j + 1, j + 2]
    after = padded[i, j + 1] + back[j] - back[i] + padded[i + 1, j + 2]
    best = int(np.argmax(before - after))
    a, b = int(i[best]), int(j[best])
    changed = np.concatenate([order[:a], order[a : b + 1][::-1], order[b + 1 :]])
    return float(before[best] - after[best]), changed


def _best_shift(costs: Floats, order: Ints, count: int) -> tuple[float, Ints]:
    """Return the gain (s) and the path with the best ``count`` lengths moved elsewhere."""
    k = len(order)
    if k <= count + 1:
        return 0.0, order
    padded = np.zeros((k + 2, k + 2))
    padded[1:-1, 1:-1] = costs[order[:, None], order]
    start = np.arange(1, k - count + 2)[:, None]  # of the row, in padded indices
    end = start + count - 1
    gap = np.arange(k + 1)[None]  # between gap and gap + 1
    taken = padded[start - 1, start] + padded[end, end + 1] - padded[start - 1, end + 1]
    put = padded[gap, start] + padded[end, gap + 1] - padded[gap, gap + 1]
    gain = np.where((gap >= start - 1) & (gap <= end), -np.inf, taken - put)
    row, place = np.unravel_index(int(np.argmax(gain)), gain.shape)
    moved = order[row : row + count]
    rest = np.concatenate([order[:row], order[row + count :]])
    at = int(place) if place <= row else int(place) - count
    changed = np.concatenate([rest[:at], moved, rest[at:]])
    return float(gain[row, place]), changed
