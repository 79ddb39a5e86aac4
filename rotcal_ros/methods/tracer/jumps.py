"""Jumps of the zero that nobody reported: a slipped fringe, a beam that broke unseen.

All lengths of a segment after some moment differing by the same amount from those before it are
tested like an outlier: the score of that shift over its standard deviation, with the unexplained
scatter of the other residuals (externally studentised). It has to stand out more than any single
length does, which would be an outlier. The zero is then split there, which costs one unknown.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.special import erfc

from rotcal_ros.arrays import Bools, Floats, Ints
from rotcal_ros.methods.roots import root_between
from rotcal_ros.methods.tracer.adjustment import Adjustment
from rotcal_ros.methods.tracer.gain import NetworkGain
from rotcal_ros.methods.tracer.grid import Grid
from rotcal_ros.methods.tracer.network import Network, linearise

LEAST_SIDE: Final = 4
"""Lengths that a segment keeps on either side of a jump: fewer are outliers."""
CANDIDATES: Final = 256
"""Moments that are tried first; then all those about the best one."""
PLACES: Final = 2_000_000
"""Places of the grid, of all candidates of a chunk together."""


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


@dataclass(frozen=True, eq=False)
class _Moments:
    """Lengths in use in the order of time: strip and target (k,), and segment number (k,)."""

    strip: Ints
    target: Ints
    segment: Ints

    def later(self, grid: Grid, moments: Ints) -> Bools:
        """Return (t, p, n) the places of each moment's segment that come with or after it."""
        time = np.full(grid.used.shape, -1)
        time[self.strip, self.target] = np.arange(len(self.strip))
        own = grid.segment_of_strip == self.segment[moments][:, None]
        return np.asarray((time >= moments[:, None, None]) & own[:, :, None], dtype=np.bool_)


def find_jump(
    grid: Grid, fit: Adjustment, order: Ints, significance: float, margin: float = 1.0
) -> Jump | None:
    """Return the jump that stands out most; None if none does.

    ``order`` (k,): when each row of the problem was taken. ``significance``: of the largest of all
    moments, two-sided; the limit is ``margin`` times its quantile.
    """
    moments = _in_time(grid, order)
    possible = _possible(moments)
    if not len(possible):
        return None
    network = fit.network or linearise(grid, fit.state, fit.targets)
    gain = NetworkGain.of(network)
    few = possible[:: max(1, -(-len(possible) // CANDIDATES))]
    score, information, alike = _scores(grid, fit, network, gain, moments, few)
    limit = margin * _limit(alike, significance)
    best = few[int(np.argmax(score**2 / information))]
    near = possible[np.abs(possible - best) <= len(possible) // len(few) + 1]
    score, information, _ = _scores(grid, fit, network, gain, moments, near)
    k = int(np.argmax(score**2 / information))
    squared = float(score[k] ** 2 / information[k])
    left = max(1.0, (fit.chi2 - squared) / max(fit.dof - 1, 1))
    value = float(np.sqrt(squared / left))
    if value < max(limit, float(np.abs(np.where(grid.used, fit.test_value, 0.0)).max())):
        return None
    at = near[k]
    return Jump(
        segment=int(grid.segment_numbers[moments.segment[at]]),
        row=int(grid.row[moments.strip[at], moments.target[at]]),
        size=float(score[k] / information[k]),
        std=float(np.sqrt(left / information[k])),
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


def _in_time(grid: Grid, order: Ints) -> _Moments:
    strip, target = np.nonzero(grid.used)
    rank = np.argsort(order[grid.row[strip, target]], kind="stable")
    strip, target = strip[rank], target[rank]
    return _Moments(strip, target, grid.segment_of_strip[strip])


def _possible(moments: _Moments) -> Ints:
    """Return the moments (t,) that have enough lengths of their segment before and after."""
    count = np.zeros(len(moments.segment), dtype=np.int64)
    total = np.bincount(moments.segment)
    for segment in range(len(total)):
        own = moments.segment == segment
        count[own] = np.arange(total[segment])
    after = total[moments.segment] - count
    return np.flatnonzero((count >= LEAST_SIDE) & (after >= LEAST_SIDE))


def _scores(
    grid: Grid, fit: Adjustment, network: Network, gain: NetworkGain, moments: _Moments, at: Ints
) -> tuple[Floats, Floats, Floats]:
    """Return scores (t,) and information (t,) of a shift that begins at each moment.

    The third array (t - 1,) is the correlation of neighbouring scores.
    """
    weights = grid.weights
    pulled, rows = weights * fit.residual, network.rows
    size = max(1, PLACES // weights.size)
    scores, informations, shared = [], [], []
    for begin in range(0, len(at), size):
        later = moments.later(grid, at[begin : begin + size])
        pull = weights * later
        by_strip = np.einsum("tpi,pia->tpa", pull, rows)
        by_target = -np.einsum("tpi,pia->tia", pull, rows[:, :, :3])
        x, y = gain.step(by_strip, by_target)
        taken = (by_strip * x).sum(axis=(1, 2)) + (by_target * y).sum(axis=(1, 2))
        total = pull.sum(axis=(1, 2))
        scores.append((later * pulled).sum(axis=(1, 2)))
        informations.append(np.maximum(total - taken, 1e-9 * total))
        both = (pull[1:] * later[:-1]).sum(axis=(1, 2))
        both -= (by_strip[:-1] * x[1:]).sum(axis=(1, 2)) + (by_target[:-1] * y[1:]).sum(
            axis=(1, 2)
        )
        shared.append(both / np.sqrt(informations[-1][1:] * informations[-1][:-1]))
    return np.concatenate(scores), np.concatenate(informations), np.concatenate(shared)


def _limit(alike: Floats, significance: float) -> float:
    """Return the limit of the largest of normal scores whose neighbours are ``alike`` (t - 1,).

    By the expected number of upcrossings, two-sided: acos(rho) / (2 pi) exp(-u^2 / 2) each (Rice's
    formula for a sequence), and never more than of independent ones.
    """
    rate = float(np.arccos(np.clip(alike, -1.0, 1.0)).sum()) / (2.0 * np.pi)

    def false_alarms(u: float) -> float:
        above = 0.5 * float(erfc(u / np.sqrt(2.0)))
        crossings = min(rate * float(np.exp(-0.5 * u * u)), len(alike) * above)
        return 2.0 * (above + crossings) - significance

    return root_between(false_alarms, 0.0, 40.0, 1e-12)
