"""What lengths tell whatever stations and zeros are: the linear model behind the noise.

y = A x + T p + e: stations, zeros and offsets x are unknown, the errors p of the targets have the
machine's covariance (T holds it: p ~ N(0, 1)), the lengths' noise e ~ N(0, s^2). With
V = s^2 + T T' all that is asked is told by W = V^-1 - V^-1 A (A' V^-1 A)^-1 A' V^-1. Let
P = 1 - A (A'A)^-1 A' and T' P T = E L E' (eigenvalues L), B = P T E. Then

    W = (P - B D B') / s^2,        D = 1 / (s^2 + L)

so that one decomposition in the size of the targets serves every s. A length i that is left out is
one more unknown, of that length alone: W' = W - W i i' W / (i' W i).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NamedTuple, TypeAlias

import numpy as np
from scipy.linalg import eigh, qr

from rotcal_ros.foundation.arrays import Floats

LEAST_SHARE: Final = 0.05
"""The noise is not estimated smaller than this share of the planned: that would be made up."""
MAX_ITERATIONS: Final = 100
SETTLED: Final = 1e-10


class Moments(NamedTuple):
    """tr W, tr W^2 and y' W^2 y at one noise."""

    trace: float
    square: float
    seen: float


MomentsAt: TypeAlias = Callable[[float], Moments]
"""Moments by the variance s^2 of the noise."""


class LengthContrasts:
    """k lengths; everything in units of their planned standard deviations.

    ``design`` (k, p): A above; ``targets`` (k, q): T; ``length`` (k,): y, observed less computed;
    ``time`` (k,): when each was taken, in any unit.
    """

    def __init__(self, design: Floats, targets: Floats, length: Floats, time: Floats) -> None:
        k, p = design.shape
        sizes = np.linalg.norm(design, axis=0)
        explained = qr(design / sizes, mode="economic", check_finite=False)[0]

        def unexplained(values: Floats) -> Floats:
            return np.asarray(values - explained @ (explained.T @ values), dtype=np.float64)

        through = unexplained(targets)
        spread, axes = eigh(through.T @ through, check_finite=False)
        self.count = k - p
        """How many contrasts there are; without any nothing is known of the noise."""
        self._plain = self.count - len(spread)
        """Contrasts that no target has part in; below zero, as many eigenvalues are zero."""
        self._spread = np.maximum(spread, 0.0)
        self._length, self._slope = unexplained(length), unexplained(time - time.mean())
        self._free = 1.0 - (explained**2).sum(axis=1)
        self._by_target = through @ axes
        self._measured, self._drifted = (
            self._by_target.T @ self._length,
            self._by_target.T @ self._slope,
        )

    def __len__(self) -> int:
        return len(self._length)

    def moments(self, variance: float) -> Moments:
        """Return what the likelihood is made of, all lengths taking part."""
        known = 1.0 / (variance + self._spread)
        trace = self._plain / variance + known.sum()
        square = self._plain / variance**2 + (known**2).sum()
        left = (
            self._length @ self._length
            - (self._measured**2 * known * (2.0 - self._spread * known)).sum()
        )
        return Moments(float(trace), float(square), float(left / variance**2))

    def moments_without(self, row: int) -> MomentsAt:
        """Return the same without the length ``row``, which others check."""
        free, length, by_target = self._free[row], self._length[row], self._by_target[row]
        alone, crossed = by_target**2, by_target * self._measured

        def moments(variance: float) -> Moments:
            known = 1.0 / (variance + self._spread)
            shrunk = variance * known
            first, second = known, known * (1.0 + shrunk)
            third = known * (1.0 + shrunk + shrunk**2)
            own = (free - alone @ first) / variance
            own_2 = (free - alone @ second) / variance**2
            own_3 = (free - alone @ third) / variance**3
            pull = (length - crossed @ first) / variance
            pull_2 = (length - crossed @ second) / variance**2
            every = self.moments(variance)
            return Moments(
                every.trace - own_2 / own,
                every.square - 2.0 * own_3 / own + (own_2 / own) ** 2,
                every.seen - 2.0 * pull * pull_2 / own + pull**2 * own_2 / own**2,
            )

        return moments

    def checked(self, variance: float) -> Floats:
        """Return the diagonal of W (k,): how much the others check each length."""
        known = 1.0 / (variance + self._spread)
        return np.asarray((self._free - self._by_target**2 @ known) / variance, dtype=np.float64)

    def pull(self, variance: float) -> Floats:
        """Return W y (k,)."""
        known = 1.0 / (variance + self._spread)
        left = self._length - self._by_target @ (known * self._measured)
        return np.asarray(left / variance, dtype=np.float64)

    def drift(self, variance: float) -> float:
        """Return the change of all lengths in proportion to time, in standard deviations."""
        known = 1.0 / (variance + self._spread)
        weight = self._slope @ self._slope - (known * self._drifted**2).sum()
        value = self._slope @ self._length - (known * self._drifted * self._measured).sum()
        return float(value / np.sqrt(variance * weight)) if weight > 0.0 else 0.0


def likeliest(moments: MomentsAt) -> float:
    """Return the variance s^2 of the noise of greatest restricted likelihood.

    Fisher scoring from 1: y' W^2 y = tr W there (Patterson and Thompson, Biometrika 58 (1971)
    545).
    """
    variance = 1.0
    for _ in range(MAX_ITERATIONS):
        now = moments(variance)
        better = max(variance + (now.seen - now.trace) / now.square, LEAST_SHARE**2)
        if abs(better - variance) <= SETTLED * variance:
            return better
        variance = better
    return variance


def degrees_of_freedom(moments: MomentsAt, variance: float) -> float:
    """Return s^4 tr W^2: the number of contrasts where the targets play no part."""
    return variance**2 * moments(variance).square
