"""The uncertainty of a table between the measured angles, and which gaps are too wide for one.

How far a curve may deviate there follows from its own values. A deviation repeats after a turn.
Its harmonics k = 1, 2, ... are taken for independent, with a variance S^2 r^k of cosine and sine
that falls off geometrically. S and r are estimated from the values and their covariance; what
these leave open is averaged over (marginal likelihood, MacKay, Information Theory, chapters 28 and
45). The sum over all harmonics is a kernel in closed form, and with it the variance of what any
line through the values misses.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Bools, Floats
from rotcal_ros.foundation.curves.directional import DirectionalCurve
from rotcal_ros.foundation.curves.interpolation import regularised_cholesky
from rotcal_ros.foundation.curves.measured import gaps_of
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.units import ARCSEC, DEGREE

POINTS: Final = 8
"""Parts into which every gap is divided; the curve is evaluated at their ends."""
CERTAIN: Final = 4.0
"""Standard uncertainties that bound what was not measured."""
GAP: Final = 1.5
"""A distance above this multiple of the median distance of the angles is a gap."""

Weights = Callable[[DirectionalCurve, Floats], Floats]
"""Returns for a curve and angles (m,), rad, the weights (m, n) of a table on its n values."""


def cut_at_wide_gaps(
    curve: DirectionalCurve, weights: Weights, reference: float
) -> tuple[DirectionalCurve, float]:
    """Return ``curve``, an arc where it does not go round, and its :func:`interpolation_std`, rad.

    A gap is too wide when the uncertainty inside it exceeds half the range of the curve. At the
    ends of the measured angles it makes them an arc; DataError for one between them.
    """
    gaps, std = gaps_of(curve.angles, curve.period), interpolation_std(curve, weights, reference)
    wide = (gaps > GAP * np.median(gaps)) & (std * CERTAIN > np.ptp(curve.stacked) / 2.0)
    if curve.period and wide[-1] and not np.any(wide[:-1]):
        return cut_at_wide_gaps(replace(curve, period=0.0), weights, reference)
    if np.any(wide):
        raise DataError(_too_wide(curve, gaps, std, wide))
    return curve, float(np.max(std))


def interpolation_std(curve: DirectionalCurve, weights: Weights, reference: float) -> Floats:
    """Return the additional uncertainty inside each gap (n or n - 1,).

    It is the largest standard uncertainty, rad, on top of the largest at the measured angles: from
    the covariance of interpolated values, and from harmonics that the sampling cannot see. The
    values are zero at ``reference`` (rad); the uncertainty of this zero is common to all.
    """
    gaps = gaps_of(curve.angles, curve.period)
    at = curve.angles[: len(gaps), None] + gaps[:, None] * (np.arange(1, POINTS) / POINTS)
    here = np.array([reference])
    inside, zero = weights(curve, at.ravel()), weights(curve, here)
    rows = weights(curve, curve.angles)
    centring = np.eye(len(curve.angles)) - 1.0 / len(curve.angles)
    sides = [(curve.forward, curve.forward_covariance)]
    if curve.both:
        sides.append((curve.reverse, curve.reverse_covariance))
    variance = np.zeros(at.shape)
    for values, covariance in sides:
        content = fit_harmonic_kernels(curve.angles, values, covariance)
        missed = np.sqrt(content.interpolation_variance(inside, curve.angles, at.ravel()))
        missed += np.sqrt(content.interpolation_variance(zero, curve.angles, here))
        # An error common to all values shifts the curve, and bends it nowhere between them.
        bending = centring @ covariance @ centring
        gained = propagated_variances(inside, bending) - np.max(
            propagated_variances(rows, bending)
        )
        total = (missed**2 + np.maximum(gained, 0.0)).reshape(at.shape)
        variance = np.maximum(variance, total)
    return np.asarray(np.sqrt(variance.max(axis=1)), dtype=np.float64)


def propagated_variances(weights: Floats, covariance: Floats) -> Floats:
    """Return the variances (m,) of ``weights`` (m, n) @ values with ``covariance`` (n, n)."""
    return np.asarray(np.sum((weights @ covariance) * weights, axis=1), dtype=np.float64)


def _too_wide(curve: DirectionalCurve, gaps: Floats, std: Floats, wide: Bools) -> str:
    worst = int(np.argmax(np.where(wide, std, 0.0)))
    first = curve.angles[worst] / DEGREE
    return (
        f"nothing was measured between {first:.6g} and {first + gaps[worst] / DEGREE:.6g} deg, "
        f"and the curve (range {np.ptp(curve.stacked) / ARCSEC:.3g} arcsec) may differ there by "
        f"{CERTAIN * std[worst] / ARCSEC:.3g} arcsec from any line drawn across: measure angles "
        "in between, or leave out the angles beyond the gap, so that the rest is an arc"
    )


SHORTEST, LONGEST, LENGTHS = 0.3, 3.0, 20
"""Orders over which the variance falls by e: from the first, to the second times the values."""
SIZES: Final = np.geomspace(1e-3, 30.0, 46)
"""Sizes S that are tried, in ranges of the values."""
NOTHING: Final = 1e-20
"""Range (rad or m) of values below any meaning."""
QUIET: Final = 1e-3
"""A range of values is taken as at least this share of their uncertainty."""
EXACT: Final = 1e-6
"""Values count as exact only to this share of their range, even without an uncertainty."""


@dataclass(frozen=True, eq=False)
class HarmonicKernels:
    """Kernels that fall by ``decay`` (m,) from order to order, of ``variance`` (m,) S^2."""

    decay: Floats
    variance: Floats

    def covariance(self, apart: Floats) -> Floats:
        """Return the covariance of the curve at two angles that are ``apart`` (rad), any shape."""
        cosine = np.cos(apart)
        kinds = zip(self.decay, self.variance, strict=True)
        total = (size * damped_cosine_sum(cosine, decay) for decay, size in kinds if size > 0.0)
        return np.asarray(sum(total, np.zeros_like(cosine)), dtype=np.float64)

    def interpolation_variance(self, weights: Floats, nodes: Floats, at: Floats) -> Floats:
        """Return the variance (m,) of the curve at ``at`` (m,) less ``weights`` @ its nodes.

        ``weights`` (m, n), whose rows add up to 1, are a line through exact values at ``nodes``
        (n,) rad: the rest is what the sampling cannot see.
        """
        variance = float(self.covariance(np.zeros(1))[0])
        across = np.sum(weights * self.covariance(at[:, None] - nodes), axis=1)
        of_the_line = np.sum((weights @ self.covariance(nodes[:, None] - nodes)) * weights, axis=1)
        return np.asarray(np.maximum(variance - 2.0 * across + of_the_line, 0.0), dtype=np.float64)


def fit_harmonic_kernels(nodes: Floats, values: Floats, covariance: Floats) -> HarmonicKernels:
    """Return the content of a curve with ``values`` (n,) at ``nodes`` (n,) rad.

    ``covariance`` (n, n) is that of the values; their common part says nothing, nor does a
    constant. Raises DataError if it is not a covariance.
    """
    size, n = float(np.ptp(values)), len(values)
    if size < NOTHING:
        return HarmonicKernels(np.zeros(1), np.zeros(1))
    size = max(size, QUIET * float(np.sqrt(np.trace(covariance) / n)))
    root = regularised_cholesky(covariance / size**2 + EXACT**2 * np.eye(n))
    white = np.linalg.solve(root, np.column_stack([np.ones(n), values / size, np.eye(n)]))
    without_constant = np.linalg.qr(white[:, :1], mode="complete")[0][:, 1:].T
    seen, into = without_constant @ white[:, 1], without_constant @ white[:, 2:]
    decay = np.exp(-1.0 / np.geomspace(SHORTEST, LONGEST * n, LENGTHS))
    cosine = np.cos(nodes[:, None] - nodes)
    evidence = np.array(
        [_evidence(into @ damped_cosine_sum(cosine, r) @ into.T, seen) for r in decay]
    )
    share = np.exp(evidence - evidence.max())
    return HarmonicKernels(decay, share @ SIZES**2 / share.sum() * size**2)


def damped_cosine_sum(cosine: Floats, decay: float) -> Floats:
    """Return sum over k = 1, 2, ... of decay^k cos(k t), from the ``cosine`` of t."""
    return np.asarray(
        (decay * cosine - decay**2) / (1.0 - 2.0 * decay * cosine + decay**2), dtype=np.float64
    )


def _evidence(kernel: Floats, seen: Floats) -> Floats:
    """Return the log likelihood of ``seen`` (n,), white but for SIZES^2 times the ``kernel``."""
    spread, turn = np.linalg.eigh((kernel + kernel.T) / 2.0)
    variance = 1.0 + SIZES[:, None] ** 2 * np.maximum(spread, 0.0)
    return np.asarray(
        -0.5 * np.sum((turn.T @ seen) ** 2 / variance + np.log(variance), axis=1), dtype=np.float64
    )
