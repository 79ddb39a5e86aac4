"""How large the noise of the lengths really is, from the first sweep alone.

It is estimated by restricted maximum likelihood (:class:`LengthContrasts`), which keeps the errors
of the targets apart; its information gives the degrees of freedom.

Stein (Ann. Math. Statist. 16 (1945) 243): a number of further lengths that depends on this
estimate alone leaves the final mean independent of it, so that Student's t with these degrees of
freedom holds for the final interval, however many lengths follow. An estimate renewed on the way
would stop where it happens to be small: intervals that promise too much.

What lengths tell whatever stations and zeros are follows from a linear model:

y = A x + T p + e: stations, zeros and offsets x are unknown, the errors p of the targets have the
machine's covariance (T holds it: p ~ N(0, 1)), the lengths' noise e ~ N(0, s^2). With
V = s^2 + T T' everything that is asked is told by W = V^-1 - V^-1 A (A' V^-1 A)^-1 A' V^-1. Let
P = 1 - A (A'A)^-1 A' and T' P T = E L E' (eigenvalues L), B = P T E. Then

    W = (P - B D B') / s^2,        D = 1 / (s^2 + L)

so that one decomposition in the size of the targets serves every s.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from scipy.linalg import eigh, qr
from scipy.special import ndtr, ndtri, stdtrit

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.components import COVERAGE_FACTOR

LEAST_SHARE: Final = 0.05
"""The noise is not estimated smaller than this share of the planned: that would be made up."""
MAX_ITERATIONS: Final = 100
"""Scoring steps after which the last variance stands."""
SETTLED: Final = 1e-10
"""Last step, as a share of the variance."""
CHECKED: Final = 1e-6
"""Redundancy from which a length is checked by others."""
DOUBTFUL: Final = 3
ALIKE: Final = 0.9
"""Up to three lengths whose test values are so nearly the largest are looked at one by one: where
few lengths check each other, an error shows in several."""


class Moments(NamedTuple):
    """tr W, tr W^2 and y' W^2 y at one noise."""

    trace: float
    square: float
    seen: float


class LengthContrasts:
    """k lengths; everything in units of their planned standard deviations.

    ``design`` (k, p): A above; ``targets`` (k, q): T; ``length`` (k,): y, observed less computed;
    ``time`` (k,): when each was taken, in any unit.
    """

    def __init__(self, design: Floats, targets: Floats, length: Floats, time: Floats) -> None:
        self._design, self._given = design, (targets, length, time)
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
        """Return what the likelihood is made of."""
        known = 1.0 / (variance + self._spread)
        trace = self._plain / variance + known.sum()
        square = self._plain / variance**2 + (known**2).sum()
        left = (
            self._length @ self._length
            - (self._measured**2 * known * (2.0 - self._spread * known)).sum()
        )
        return Moments(float(trace), float(square), float(left / variance**2))

    def without(self, row: int) -> LengthContrasts:
        """Return the lengths but the one in ``row``, which becomes one more unknown."""
        alone = np.eye(len(self), 1, -row)
        return LengthContrasts(np.hstack([self._design, alone]), *self._given)

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


def likeliest(lengths: LengthContrasts) -> float:
    """Return the variance s^2 of the noise of greatest restricted likelihood.

    Fisher scoring from 1: y' W^2 y = tr W there (Patterson and Thompson, Biometrika 58 (1971)
    545).
    """
    variance = 1.0
    for _ in range(MAX_ITERATIONS):
        now = lengths.moments(variance)
        better = max(variance + (now.seen - now.trace) / now.square, LEAST_SHARE**2)
        if abs(better - variance) <= SETTLED * variance:
            return better
        variance = better
    return variance


def degrees_of_freedom(lengths: LengthContrasts, variance: float) -> float:
    """Return s^4 tr W^2: the number of contrasts where the targets play no part."""
    return variance**2 * lengths.moments(variance).square


@dataclass(frozen=True, eq=False)
class LengthNoise:
    """Factor on the planned standard deviation of the lengths, its degrees of freedom, and tests.

    ``test_value`` (k,): normalised residual of each length in standard deviations, 0 where no
    other length checks it; ``drift_value``: the same for a change of all lengths in proportion to
    time.
    """

    factor: float
    dof: float
    test_value: Floats
    drift_value: float


def student_factor(dof: float) -> float:
    """Return the t that holds as often with ``dof`` degrees of freedom as k = 2 with infinite."""
    return float(stdtrit(dof, ndtr(COVERAGE_FACTOR)))


def estimated_noise(lengths: LengthContrasts) -> LengthNoise:
    """Return the noise of the lengths; without a contrast 1 with zero degrees of freedom."""
    if lengths.count <= 0:
        return LengthNoise(1.0, 0.0, np.zeros(len(lengths)), 0.0)
    variance = likeliest(lengths)
    return _judged(lengths, variance, degrees_of_freedom(lengths, variance))


def judged_lengths(lengths: LengthContrasts, factor: float) -> LengthNoise:
    """Return the tests of :func:`estimated_noise` with a ``factor`` that is known; zero dof."""
    return _judged(lengths, factor**2, 0.0)


def _judged(lengths: LengthContrasts, variance: float, dof: float) -> LengthNoise:
    checked = lengths.checked(variance)
    seen = checked * variance > CHECKED
    test = np.where(seen, lengths.pull(variance) / np.sqrt(np.where(seen, checked, 1.0)), 0.0)
    return LengthNoise(float(np.sqrt(variance)), dof, test, lengths.drift(variance))


def suspect_length(
    lengths: LengthContrasts, noise: LengthNoise, significance: float
) -> tuple[int, float] | None:
    """Return which of the lengths is the most suspect, and its test value; None: none is.

    The test is against the noise that the others show; ``significance``: probability of suspecting
    any when all are good.
    """
    tail = 1.0 - 0.5 * significance / len(noise.test_value)
    size = np.abs(noise.test_value)
    worst = int(np.argmax(size))
    if noise.dof <= 1.0:
        value = float(noise.test_value[worst])
        return (worst, value) if abs(value) > ndtri(tail) else None
    values = {}
    for k in np.argsort(-size)[:DOUBTFUL].tolist():
        if size[k] == 0.0 or size[k] < ALIKE * size[worst]:
            break
        others = lengths.without(k)
        variance = likeliest(others)
        limit = float(stdtrit(max(degrees_of_freedom(others, variance), 1.0), tail))
        value = float(lengths.pull(variance)[k] / np.sqrt(lengths.checked(variance)[k]))
        if abs(value) > limit:
            values[k] = value
    return max(values.items(), key=lambda item: abs(item[1]), default=None)
