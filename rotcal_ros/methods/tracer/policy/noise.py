"""How large the noise of the lengths really is, from the first sweep alone.

It is estimated by restricted maximum likelihood (:mod:`.contrasts`), which keeps the errors of
the targets apart; its information gives the degrees of freedom.

Stein (Ann. Math. Statist. 16 (1945) 243): a number of further lengths that depends on this
estimate alone leaves the final mean independent of it, so that Student's t with these degrees of
freedom holds for the final interval, however many lengths follow. An estimate renewed on the way
would stop where it happens to be small: intervals that promise too much.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.special import ndtr, ndtri, stdtrit

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.components import COVERAGE_FACTOR
from rotcal_ros.methods.tracer.policy.contrasts import (
    LengthContrasts,
    degrees_of_freedom,
    likeliest,
)

CHECKED: Final = 1e-6
DOUBTFUL: Final = 3
ALIKE: Final = 0.9
"""Up to three lengths whose test values are so nearly the largest are looked at one by one: where
few lengths check each other, an error shows in several."""


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
    variance = likeliest(lengths.moments)
    return _judged(lengths, variance, degrees_of_freedom(lengths.moments, variance))


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
        others = lengths.moments_without(k)
        variance = likeliest(others)
        limit = float(stdtrit(max(degrees_of_freedom(others, variance), 1.0), tail))
        value = float(lengths.pull(variance)[k] / np.sqrt(lengths.checked(variance)[k]))
        if abs(value) > limit:
            values[k] = value
    return max(values.items(), key=lambda item: abs(item[1]), default=None)
