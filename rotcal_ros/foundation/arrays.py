"""Types of arrays by their elements; docstrings state their shapes."""

from __future__ import annotations

from typing import Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

Floats: TypeAlias = NDArray[np.float64]
Ints: TypeAlias = NDArray[np.int64]
Bools: TypeAlias = NDArray[np.bool_]
Complexes: TypeAlias = NDArray[np.complex128]
Bytes: TypeAlias = NDArray[np.uint8]
Stamps: TypeAlias = NDArray[np.int64]
"""Times in integer nanoseconds."""

_Numbers = TypeVar("_Numbers", bound=NDArray[Any])


def std_of(covariance: Floats) -> Floats:
    """Return the standard deviations (n,) that a covariance (n, n) states."""
    return np.asarray(np.sqrt(np.maximum(np.diag(covariance), 0.0)), dtype=np.float64)


def rms_about_mean(covariance: Floats) -> float:
    """Return the rms standard deviation of values less their mean, of ``covariance`` (n, n)."""
    about_mean = np.trace(covariance - covariance.mean(axis=0))
    return float(np.sqrt(about_mean / len(covariance)))


def differences_from(before: float, values: _Numbers) -> _Numbers:
    """Return the steps (n,) of ``values`` (n,), the first of them from ``before``.

    It is ``np.diff`` with ``prepend``, which takes several times as long for a few values.
    """
    steps: _Numbers = np.empty_like(values)
    steps[:1] = values[:1] - before
    np.subtract(values[1:], values[:-1], out=steps[1:])
    return steps
