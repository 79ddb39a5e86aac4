"""The circle through points in a plane: algebraic fit in closed form, with its derivative."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.errors import GeometryError

FLAT: Final = 1e-7
"""Points are taken for a line when the smaller principal spread is this much below the other."""


@dataclass(frozen=True, slots=True)
class Circle:
    """A circle in plane coordinates: ``centre`` (2,) and ``radius``, in metres."""

    centre: Floats
    radius: float


def fit_circle(points: ArrayLike) -> Circle:
    """Return the circle that minimises the sum of ``(|p - centre|^2 - radius^2)^2`` (Kasa).

    ``points`` has shape (k, 2). Laser tracer paper, Eq. 22-30. Slip: Eq. 29-30 subtract the mean,
    which has to be *added* to the solution in centred coordinates. The printed Cramer's rule
    (Eq. 28) is the two by two system solved here.

    Raises GeometryError for less than three points or points on one line.
    """
    centred, mean, moments = _centred(points)
    offset = np.linalg.solve(moments, 0.5 * centred.T @ (centred**2).sum(axis=1))
    radius = float(np.sqrt((centred**2).sum(axis=1).mean() + offset @ offset))
    return Circle(mean + offset, radius)


def circle_centre_jacobian(points: ArrayLike) -> Floats:
    """Return d centre / d points of :func:`fit_circle`, shape (2, k, 2).

    From the differential of ``moments @ offset = right-hand side`` in centred coordinates.
    """
    centred, mean, moments = _centred(points)
    offset = fit_circle(points).centre - mean
    half_square = 0.5 * (centred**2).sum(axis=1) - centred @ offset
    inner = centred[:, :, None] * (centred - offset)[:, None, :]
    inner += half_square[:, None, None] * np.eye(2)
    inner -= inner.mean(axis=0)  # the mean follows the points too
    jacobian = np.linalg.solve(moments, inner) + np.eye(2) / len(centred)
    return np.ascontiguousarray(jacobian.transpose(1, 0, 2))


def _centred(points: ArrayLike) -> tuple[Floats, Floats, Floats]:
    """Return the centred points (k, 2), their mean (2,) and second moments (2, 2)."""
    p = np.asarray(points, dtype=np.float64)
    if p.ndim != 2 or p.shape[1] != 2 or len(p) < 3:
        raise GeometryError(f"a circle needs at least 3 points (k, 2), found shape {p.shape}")
    mean = p.mean(axis=0)
    centred = p - mean
    moments = centred.T @ centred
    small, large = np.linalg.eigvalsh(moments)
    if not small > FLAT**2 * large:
        raise GeometryError(
            f"{len(p)} points on one line do not determine a circle: "
            "turn the table over a longer arc"
        )
    return centred, mean, moments
