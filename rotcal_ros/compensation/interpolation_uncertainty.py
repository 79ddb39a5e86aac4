"""The uncertainty of a table between the measured angles, and gaps that are too wide for one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Bools, Floats
from rotcal_ros.foundation.curves.content import content_of
from rotcal_ros.foundation.curves.directional import DirectionalCurve
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
"""For a curve and m angles (rad): the matrix (m, n) that a table applies to its n values."""


def without_gaps(
    curve: DirectionalCurve, weights: Weights, reference: float
) -> tuple[DirectionalCurve, float]:
    """Return ``curve``, as an arc where it does not go round, and its :func:`between_std`, rad.

    A gap is too wide when the uncertainty inside it exceeds half the range of the curve. At the
    ends of the measured angles it makes them an arc; DataError for one between them.
    """
    gaps, std = gaps_of(curve.angles, curve.period), between_std(curve, weights, reference)
    wide = (gaps > GAP * np.median(gaps)) & (std * CERTAIN > np.ptp(curve.stacked) / 2.0)
    if curve.period and wide[-1] and not np.any(wide[:-1]):
        return without_gaps(replace(curve, period=0.0), weights, reference)
    if np.any(wide):
        raise DataError(_too_wide(curve, gaps, std, wide))
    return curve, float(np.max(std))


def between_std(curve: DirectionalCurve, weights: Weights, reference: float) -> Floats:
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
        content = content_of(curve.angles, values, covariance)
        missed = np.sqrt(content.missed(inside, curve.angles, at.ravel()))
        missed += np.sqrt(content.missed(zero, curve.angles, here))
        # An error common to all values shifts the curve, and bends it nowhere between them.
        bending = centring @ covariance @ centring
        gained = variances(inside, bending) - np.max(variances(rows, bending))
        total = (missed**2 + np.maximum(gained, 0.0)).reshape(at.shape)
        variance = np.maximum(variance, total)
    return np.asarray(np.sqrt(variance.max(axis=1)), dtype=np.float64)


def variances(weights: Floats, covariance: Floats) -> Floats:
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
