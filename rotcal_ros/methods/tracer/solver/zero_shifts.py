"""Shifts of the zero: what it does that all lengths of a segment are longer from some moment on.

To first order, about an adjustment: how much the lengths speak for such a shift, how well they
tell its size, and by how much it moves the stations while nobody sees it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.special import erfc

from rotcal_ros.adjust.roots import root_between
from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.methods.tracer.solver.adjustment import Adjustment
from rotcal_ros.methods.tracer.solver.grid import Grid
from rotcal_ros.methods.tracer.solver.network import linearise
from rotcal_ros.methods.tracer.solver.network_gain import NetworkGain

LEAST_SIDE: Final = 4
"""Lengths on either side of a shift that is looked for: fewer are outliers."""
CANDIDATES: Final = 256
"""Moments that stand for all of them."""
PLACES: Final = 2_000_000
"""Places of the grid, of all moments of a chunk together."""


@dataclass(frozen=True, eq=False)
class TimedLengths:
    """Lengths in use in the order of time: strip and target (k,), and segment number (k,).

    ``side`` (k,): how many lengths of its segment each has before it, or from it on, if fewer.
    ``own`` (p, n): segment number of each place of the grid, strips alike or (p, 1).
    """

    strip: Ints
    target: Ints
    segment: Ints
    side: Ints
    own: Ints

    @classmethod
    def of(cls, grid: Grid, order: Ints, own: Ints | None = None) -> TimedLengths:
        """Return those of ``grid``; ``order`` (k,): when each row of the problem was taken.

        ``own``: segment of each place of the grid; None: as the grid has it.
        """
        own = grid.segment_of_strip[:, None] if own is None else own
        strip, target = np.nonzero(grid.used)
        rank = np.argsort(order[grid.row[strip, target]], kind="stable")
        strip, target = strip[rank], target[rank]
        segment = np.broadcast_to(own, grid.used.shape)[strip, target]
        before = np.zeros(len(segment), dtype=np.int64)
        total = np.bincount(segment)
        for number, count in enumerate(total.tolist()):
            before[segment == number] = np.arange(count)
        return cls(strip, target, segment, np.minimum(before, total[segment] - before), own)

    def few(self) -> Ints:
        """Return up to CANDIDATES moments, evenly among those that a shift can begin at."""
        possible = np.flatnonzero(self.side > 0)
        return np.asarray(possible[:: max(1, -(-len(possible) // CANDIDATES))])

    def later(self, grid: Grid, moments: Ints) -> Bools:
        """Return (t, p, n) the places of each moment's segment that come with or after it."""
        time = np.full(grid.used.shape, -1)
        time[self.strip, self.target] = np.arange(len(self.strip))
        own = self.own == self.segment[moments][:, None, None]
        return np.asarray((time >= moments[:, None, None]) & own, dtype=np.bool_)


@dataclass(frozen=True, eq=False)
class Shifts:
    """Shifts that begin at the moments ``at`` (t,), of all ``moments`` there are.

    ``score`` (t,): slope of half of chi-squared, 1/m; ``information`` (t,): of the size, 1/m^2.
    ``alike`` (t,): correlation with the score before, 1 for the first. ``moved`` (t, q): what a
    shift of a metre does to what is adjusted without it, the stations (3 m,) or curves (6 m,).
    """

    moments: TimedLengths
    at: Ints
    score: Floats
    information: Floats
    alike: Floats
    moved: Floats

    @property
    def enough(self) -> Bools:
        """Whether a shift (t,) has lengths enough on either side to be looked for."""
        return np.asarray(self.moments.side[self.at] >= LEAST_SIDE)

    @property
    def squared(self) -> Floats:
        """What chi-squared (t,) falls by when the size is free."""
        return np.asarray(self.score**2 / self.information)

    def about(self, k: int) -> Ints:
        """Return all moments about the one that shift ``k`` begins at, with lengths enough."""
        enough = np.flatnonzero(self.moments.side >= LEAST_SIDE)
        reach = len(enough) // len(self.at) + 1
        return np.asarray(enough[np.abs(enough - self.at[k]) <= reach])

    def limit(self, significance: float) -> float:
        """Return what the largest normalised score exceeds by chance; ``significance`` two-sided.

        By the expected number of upcrossings: acos(rho) / (2 pi) exp(-u^2 / 2) each (Rice's
        formula for a sequence), and never more than of independent scores.
        """
        alike = self.alike[self.enough][1:]
        rate = float(np.arccos(np.clip(alike, -1.0, 1.0)).sum()) / (2.0 * np.pi)

        def false_alarms(u: float) -> float:
            above = 0.5 * float(erfc(u / np.sqrt(2.0)))
            crossings = min(rate * float(np.exp(-0.5 * u * u)), len(alike) * above)
            return 2.0 * (above + crossings) - significance

        return root_between(false_alarms, 0.0, 40.0, 1e-12)


def find_shifts(grid: Grid, fit: Adjustment, order: Ints) -> Shifts:
    """Return shifts at up to CANDIDATES moments, evenly among those that one can begin at.

    ``order`` (k,): when each row of the problem was taken.
    """
    moments = TimedLengths.of(grid, order)
    return shifts_at(grid, fit, moments, moments.few())


def shifts_at(grid: Grid, fit: Adjustment, moments: TimedLengths, at: Ints) -> Shifts:
    """Return the shifts that begin ``at`` (t,) some of the ``moments`` of ``grid``."""
    network = fit.network or linearise(grid, fit.state, fit.targets)
    gain, weights, rows = NetworkGain.of(network), grid.weights, network.rows
    score, information, alike = np.zeros(len(at)), np.zeros(len(at)), np.ones(len(at))
    moved = np.zeros((len(at), 3 * grid.n_stations))
    size = max(1, PLACES // weights.size)
    for begin in range(0, len(at), size):
        part = slice(begin, begin + size)
        later = moments.later(grid, at[part])
        pull = weights * later
        by_strip = np.einsum("tpi,pia->tpa", pull, rows)
        by_target = -np.einsum("tpi,pia->tia", pull, rows[:, :, :3])
        x, y = gain.step(by_strip, by_target)
        total = pull.sum(axis=(1, 2))
        taken = (by_strip * x).sum(axis=(1, 2)) + (by_target * y).sum(axis=(1, 2))
        both = (pull[1:] * later[:-1]).sum(axis=(1, 2)) - (by_strip[:-1] * x[1:]).sum(axis=(1, 2))
        both -= (by_target[:-1] * y[1:]).sum(axis=(1, 2))
        score[part] = (later * (weights * fit.residual)).sum(axis=(1, 2))
        information[part] = np.maximum(total - taken, 1e-9 * total)
        root = np.sqrt(information[part])
        alike[part][1:] = both / (root[1:] * root[:-1])
        moved[part] = x[:, grid.first_strip, :3].reshape(len(x), -1)
    return Shifts(moments, at, score, information, alike, moved)
