"""The laser tracer paper's own way: each station by itself, its targets taken as known.

Section 3.1 (Eq. 5-17): a station has four unknowns (X, Y, Z, d). All are solved at once, by
undamped Gauss-Newton steps as long as these contract (:func:`locate_by_contraction`), else by
damped ones (:func:`locate_damped`). The paper damps all steps and searches along each (Eq. 8-17,
by Levenberg and Marquardt); from a fair start undamped steps converge quadratically, and the
minimum is the same. The normal equations lose digits of a step, not of the answer: that is where
the gradient of the residuals vanishes, which each step works out anew in full precision.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Bools, Floats

FLOOR: Final = 1e-13
"""Damping, as a share of the weights, that only a singular normal matrix feels."""
EPSILON: Final = 1e-5
"""Step (m) at which undamped steps, which converge quadratically, take over."""
MAX_ITERATIONS: Final = 100
"""Damped steps after which a station is said not to settle."""
FAIR: Final = 1.0
"""Length (m) that the first step is compared with, as the others are with the one before."""
CONTRACTION: Final = 0.5
"""Share of the step before that a step may have; else the start was too far away."""
SETTLED: Final = 1e-13
"""Step (m) that no longer needs to be done."""
MAX_STEPS: Final = 12
"""Undamped steps after which a station is left to the damped ones."""


def distances_and_directions(stations: Floats, targets: Floats) -> tuple[Floats, Floats]:
    """Return distances (m, n) and unit vectors (m, n, 3) from ``targets`` to ``stations``."""
    difference = stations[:, None, :] - targets
    distance = np.sqrt(np.einsum("jia,jia->ji", difference, difference))
    return distance, difference / distance[:, :, None]


def locate_stations(
    targets: Floats, length: Floats, weights: Floats, start: Floats
) -> tuple[Floats, Bools]:
    """Return (X, Y, Z, d) of all stations (m, 4), and which have settled (m,); Eq. 5-17.

    ``targets`` (n, 3), ``length`` and ``weights`` (m, n; weight zero for a missing length),
    ``start`` (m, 4), in metres.
    """
    state, settled = locate_by_contraction(targets, length, weights, start)
    if not settled.all():
        rest = ~settled
        state, parts = state.copy(), (length[rest], weights[rest], start[rest])
        state[rest], settled[rest] = locate_damped(targets, *parts)
    return state, settled


def locate_damped(
    targets: Floats, length: Floats, weights: Floats, start: Floats
) -> tuple[Floats, Bools]:
    """Return what :func:`locate_stations` returns, from a start that is far away.

    Levenberg's steps: damped tenfold where the objective F of Eq. 6 would rise, and ten times less
    where it fell. Weights count relative to the largest one, so that objective and first damping
    mu = |f(x_0)| keep the paper's dimension, a length. The last steps are undamped, so that
    damping leaves no trace.
    """
    relative = weights / weights.max()
    misfit, floor = Misfit(targets, length, relative), FLOOR * relative.sum(axis=1)
    state, active, products = start.copy(), np.ones(len(start), dtype=np.bool_), misfit(start)
    damping = np.maximum(np.sqrt(products[:, 4, 4]), floor)
    # a range r carries a rounding error of r times eps into f, and twice sum(f df) into f'f
    reach = np.abs(start[:, 3:] + length).max()
    grain = 8.0 * np.finfo(np.float64).eps * reach * np.sqrt(length.shape[1])
    for _ in range(MAX_ITERATIONS):
        normal = products[:, :4, :4] + damping[:, None, None] * np.eye(4)
        h = -np.linalg.solve(normal, products[:, :4, 4:])[:, :, 0]
        after, before = misfit(state + h), products[:, 4, 4]
        falls = after[:, 4, 4] <= before + grain * np.sqrt(before)
        state[falls] += h[falls]
        products[falls] = after[falls]
        active &= ~falls | ((h * h).sum(axis=1) > EPSILON**2)
        if not active.any():
            break
        damping = np.maximum(np.where(falls, 0.1, 10.0) * damping, floor)
    polished, contracts = locate_by_contraction(targets, length, weights, state)
    return np.where(contracts[:, None], polished, state), ~active


class Misfit:
    """Eq. 5 and its derivative at a state (m, 4): called, it returns [J f]'[J f], (m, 5, 5).

    That one product holds the normal matrix J'J, the gradient J'f (last column) and twice the
    objective f'f (last corner); f is computed - observed, every row times the root of its weight.
    """

    def __init__(self, targets: Floats, length: Floats, weights: Floats) -> None:
        self._points, self._length = np.ascontiguousarray(targets.T)[:, None], length
        self._root, self._rows = np.sqrt(weights), np.empty((5, *length.shape))
        np.negative(self._root, out=self._rows[3])
        self._slopes, self._errors = self._rows[:3], self._rows[4]

    def __call__(self, state: Floats) -> Floats:
        """Return the products (m, 5, 5) at ``state`` (m, 4)."""
        slopes = self._slopes
        np.subtract(state.T[:3, :, None], self._points, out=slopes)
        distance = np.sqrt(np.einsum("aji,aji->ji", slopes, slopes))
        slopes *= self._root / distance
        distance -= state[:, 3:]
        distance -= self._length
        np.multiply(distance, self._root, out=self._errors)
        return np.asarray(self._rows.transpose(1, 0, 2) @ self._rows.transpose(1, 2, 0))


def locate_by_contraction(
    targets: Floats, length: Floats, weights: Floats, start: Floats
) -> tuple[Floats, Bools]:
    """Return (X, Y, Z, d) of all stations (m, 4), and for which of them (m,) the steps contract.

    Arguments as for :func:`locate_stations`; where the steps do not contract, the
    state is of no use.
    """
    misfit, state = Misfit(targets, length, weights), start
    contracts = np.ones(len(start), dtype=np.bool_)
    limit: Floats | float = CONTRACTION * FAIR
    settled: Floats | float = SETTLED**2
    for _ in range(MAX_STEPS):
        products = misfit(state)
        try:
            h = np.linalg.solve(products[:, :4, :4], products[:, :4, 4:])[:, :, 0]
        except np.linalg.LinAlgError:
            # one singular station fails the whole stack: all are left to the damped steps
            return start, np.zeros_like(contracts)
        state = state - h
        size = np.maximum.reduce(np.abs(h), axis=1)
        if not (size <= limit).all():
            contracts &= size <= limit
            state = np.where(contracts[:, None], state, start)
            size[~contracts] = 0.0
        moving = size * size > settled
        if not moving.any():
            return state, contracts
        # the share by which a step shrinks does not grow: so the one to come is foreseen
        limit, settled = CONTRACTION * size + SETTLED, SETTLED * size
    return state, contracts & ~moving
