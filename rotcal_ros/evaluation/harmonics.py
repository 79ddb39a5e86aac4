"""Harmonic content of a deviation curve: amplitude and phase per order, with uncertainty.

deviation(t) = constant + sum over k of amplitude_k * cos(k t - phase_k). The constant is ignored:
no method knows the zero of an angle.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.curves.interpolation import harmonic_basis, harmonic_estimator
from rotcal_ros.foundation.curves.measured import MeasuredCurve
from rotcal_ros.foundation.errors import DataError

CHI2_95: Final = 5.991464547107979
"""95 % quantile of chi-square with the two degrees of freedom of one harmonic."""


@dataclass(frozen=True, eq=False)
class HarmonicContent:
    """Arrays (orders,) for the orders 1, 2, ...; amplitudes in the unit of the curve, phases rad.

    ``amplitude_std`` and ``phase_std`` are standard uncertainties (k = 1). ``significant``: the
    order differs from zero at the 95 % level; otherwise its phase is meaningless. ``residual_rms``
    is what all orders together leave over.
    """

    orders: Ints
    cosine: Floats
    sine: Floats
    amplitude: Floats
    amplitude_std: Floats
    phase: Floats
    phase_std: Floats
    significant: Bools
    residual_rms: float


def harmonic_content(curve: MeasuredCurve, max_order: int | None = None) -> HarmonicContent:
    """Split ``curve`` into harmonics by weighted least squares with its full covariance.

    ``max_order`` defaults to what the angles can resolve, at most 12. Raises DataError for an
    arc, where harmonics are not independent, for more orders than the angles allow, and for a
    curve of parts with unconnected zeros: their offsets would look like harmonics.
    """
    if curve.open_zeros:
        raise DataError(f"{curve.open_zeros}: it would look like harmonics; use a spline")
    if curve.period == 0.0:
        raise DataError(
            "the curve covers an arc only: harmonics need the full circle; use a spline"
        )
    n = len(curve.angles)
    top = min(12, (n - 1) // 2) if max_order is None else max_order
    estimator = harmonic_estimator(curve.angles, top, curve.covariance)
    coefficients = estimator @ curve.deviation
    covariance = estimator @ curve.covariance @ estimator.T
    fit = harmonic_basis(curve.angles, top) @ coefficients
    a, b = coefficients[1::2], coefficients[2::2]
    pairs = np.array([covariance[k : k + 2, k : k + 2] for k in range(1, 2 * top + 1, 2)])
    pairs = pairs.reshape(top, 2, 2)
    amplitude, phase = np.hypot(a, b), np.arctan2(b, a)
    along = np.stack([np.cos(phase), np.sin(phase)], axis=1)
    across = np.stack([-np.sin(phase), np.cos(phase)], axis=1)
    spread = np.sqrt(np.maximum(np.einsum("ki,kij,kj->k", across, pairs, across), 0.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        turn = np.where(spread == 0.0, 0.0, spread / amplitude)
    return HarmonicContent(
        orders=np.arange(1, top + 1),
        cosine=a,
        sine=b,
        amplitude=amplitude,
        amplitude_std=np.sqrt(np.maximum(np.einsum("ki,kij,kj->k", along, pairs, along), 0.0)),
        phase=phase,
        phase_std=np.minimum(turn, np.pi / np.sqrt(3.0)),
        significant=_significant(np.stack([a, b], axis=1), pairs),
        residual_rms=float(np.std(curve.deviation - fit)),
    )


def _significant(vectors: Floats, pairs: Floats) -> Bools:
    """Return whether v' C^-1 v is above the 95 % quantile; never without an uncertainty."""
    size = np.maximum(np.linalg.det(pairs), 0.0)
    adjugate = np.stack(
        [
            np.stack([pairs[:, 1, 1], -pairs[:, 0, 1]], axis=1),
            np.stack([-pairs[:, 1, 0], pairs[:, 0, 0]], axis=1),
        ],
        axis=1,
    )
    return np.asarray(
        np.einsum("ki,kij,kj->k", vectors, adjugate, vectors) > CHI2_95 * size, dtype=np.bool_
    )
