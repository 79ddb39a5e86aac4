"""How large the noise of the lengths really is, from the first sweep alone.

y = A x + T p + e: stations, zeros and offsets x are unknown, the errors p of the targets have the
machine's covariance (T holds it: p ~ N(0, 1)), the lengths' noise e ~ N(0, s^2). What A cannot
explain, z = V' K' y with K orthogonal to A and V the eigenvectors of K' T T' K, has independent
values of variance s^2 + lambda. Restricted maximum likelihood (Patterson and Thompson, Biometrika
58 (1971) 545) is then one equation in s^2, sum w^2 (z^2 - lambda - s^2) = 0 with
w = 1 / (s^2 + lambda); its information sum w^2 / 2 gives the degrees of freedom s^4 sum w^2, which
is the number of contrasts where the targets play no part.

Stein (Ann. Math. Statist. 16 (1945) 243): a number of further lengths that depends on this
estimate alone leaves the final mean independent of it, so that Student's t with these degrees of
freedom holds for the final interval, however many lengths follow. An estimate renewed on the way
would stop where it happens to be small: intervals that promise too much.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.special import ndtr, ndtri, stdtrit

from rotcal_ros.arrays import Floats
from rotcal_ros.components import COVERAGE_FACTOR

Rows: TypeAlias = tuple[Floats, Floats, Floats, Floats]
"""The arguments of :func:`estimate_noise`."""
LEAST_SHARE: Final = 0.05
"""The estimate is not smaller than this share of the planned noise: that would be made up."""
CHECKED: Final = 1e-6
DOUBTFUL: Final = 3
ALIKE: Final = 0.9
"""Up to three lengths whose test values are so nearly the largest are looked at one by one: where
few lengths check each other, an error shows in several."""
MAX_ITERATIONS: Final = 100
SETTLED: Final = 1e-10


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

    @property
    def coverage_factor(self) -> float:
        """Student's t for the probability that k = 2 has for a normal distribution."""
        return student_factor(self.dof)


def student_factor(dof: float) -> float:
    """Return the t that holds as often with ``dof`` degrees of freedom as k = 2 with infinite."""
    return float(stdtrit(dof, ndtr(COVERAGE_FACTOR)))


def estimate_noise(design: Floats, targets: Floats, length: Floats, time: Floats) -> LengthNoise:
    """Return the noise of k lengths; everything in units of their planned standard deviations.

    ``design`` (k, p): A above; ``targets`` (k, q): T; ``length`` (k,): y, observed less computed;
    ``time`` (k,): when each was taken, in any unit. Without a contrast the factor is 1 with zero
    degrees of freedom.
    """
    k, p = design.shape
    scaled = design / np.linalg.norm(design, axis=0)
    kernel = np.linalg.qr(scaled, mode="complete")[0][:, p:]
    if not kernel.shape[1]:
        return LengthNoise(1.0, 0.0, np.zeros(k), 0.0)
    through = kernel.T @ targets
    spread, axes = np.linalg.eigh(through @ through.T)
    spread = np.maximum(spread, 0.0)
    contrasts = kernel @ axes
    z = contrasts.T @ length
    variance = _restricted_likelihood(z**2, spread)
    weight = 1.0 / (variance + spread)
    pull = (contrasts * weight) @ z
    checked = (contrasts**2 * weight).sum(axis=1)
    seen = checked * variance > CHECKED
    test = np.where(seen, pull / np.sqrt(np.where(seen, checked, 1.0)), 0.0)
    slope = contrasts.T @ (time - time.mean())
    known = float((slope**2 * weight).sum())
    drift = float((slope * weight * z).sum()) / np.sqrt(known) if known > 0.0 else 0.0
    dof = variance**2 * float((weight**2).sum())
    return LengthNoise(float(np.sqrt(variance)), dof, test, float(drift))


def judge_lengths(
    design: Floats, targets: Floats, length: Floats, time: Floats, factor: float
) -> LengthNoise:
    """Return the tests of :func:`estimate_noise` with a ``factor`` that is known; zero dof.

    With W = V^-1 - V^-1 A (A' V^-1 A)^-1 A' V^-1 and V = factor^2 + T T', without eigenvectors.
    """
    covariance = targets @ targets.T
    covariance.flat[:: len(length) + 1] += factor**2
    root = cholesky(covariance, lower=True, check_finite=False)
    scaled = design / np.linalg.norm(design, axis=0)
    known = np.column_stack([length, time - time.mean(), np.eye(len(length))])
    known = solve_triangular(root, known, lower=True, check_finite=False)
    explained = np.linalg.qr(solve_triangular(root, scaled, lower=True, check_finite=False))[0]
    known -= explained @ (explained.T @ known)
    y, slope, each = known[:, 0], known[:, 1], known[:, 2:]
    checked = (each**2).sum(axis=0)
    seen = checked * factor**2 > CHECKED
    test = np.where(seen, (each.T @ y) / np.sqrt(np.where(seen, checked, 1.0)), 0.0)
    weight = float(slope @ slope)
    drift = float(slope @ y) / np.sqrt(weight) if weight > 0.0 else 0.0
    return LengthNoise(factor, 0.0, test, float(drift))


def suspect_length(
    rows: Rows, noise: LengthNoise, significance: float
) -> tuple[int, float] | None:
    """Return which of the lengths is the most suspect, and its test value; None: none is.

    The test is against the noise that the
    others show; ``significance``: probability of suspecting any when all are good.
    """
    tail = 1.0 - 0.5 * significance / len(noise.test_value)
    size = np.abs(noise.test_value)
    worst = int(np.argmax(size))
    if noise.dof <= 1.0:
        value = float(noise.test_value[worst])
        return (worst, value) if abs(value) > ndtri(tail) else None
    alike = [k for k in np.argsort(-size)[:DOUBTFUL].tolist() if size[k] >= ALIKE * size[worst]]
    values = {}
    for k in alike:
        others = estimate_noise(*(np.delete(row, k, axis=0) for row in rows))
        limit = float(stdtrit(max(others.dof, 1.0), tail))
        value = float(judge_lengths(*rows, others.factor).test_value[k])
        if abs(value) > limit:
            values[k] = value
    return max(values.items(), key=lambda item: abs(item[1]), default=None)


def _restricted_likelihood(squares: Floats, spread: Floats) -> float:
    """Return the variance that fits ``squares`` (c,) best, by Fisher scoring from 1."""
    variance = 1.0
    for _ in range(MAX_ITERATIONS):
        weight = 1.0 / (variance + spread) ** 2
        better = float((weight * (squares - spread)).sum() / weight.sum())
        better = max(better, LEAST_SHARE**2)
        if abs(better - variance) <= SETTLED * variance:
            return better
        variance = better
    return variance
