"""The plane through points in space, and the circle through points in a plane."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.errors import GeometryError

COLLINEAR: Final = 1e-7
"""Points are taken for collinear when their second singular value is smaller by this factor."""


@dataclass(frozen=True, slots=True)
class Plane:
    """The plane ``normal . x + offset = 0`` with a unit normal (3,), in metres.

    ``centroid`` (3,) is the mean of the fitted points; ``singular_values`` (3,) are those of
    the centred points, largest first.
    """

    normal: Floats
    offset: float
    centroid: Floats
    singular_values: Floats

    def distances(self, points: ArrayLike) -> Floats:
        """Return the signed distances (k,) of ``points`` (k, 3), positive along the normal.

        Laser tracer paper, Eq. 18-21. Slip of Eq. 21: its lambda is printed with the projected
        points P', which are not known yet and lie on the plane; it needs the unprojected P.
        """
        relative = np.asarray(points, dtype=np.float64) - self.centroid
        return relative @ self.normal

    def basis(self) -> Floats:
        """Return two unit vectors (2, 3) in the plane; with the normal they are right-handed.

        The first is the part of +x that lies in the plane (of +y where the normal is along x).
        """
        seed = (
            np.array([1.0, 0.0, 0.0]) if abs(self.normal[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
        )
        first = seed - (seed @ self.normal) * self.normal
        first /= np.linalg.norm(first)
        (a, b, c), (x, y, z) = self.normal.tolist(), first.tolist()
        return np.array([[x, y, z], [b * z - c * y, c * x - a * z, a * y - b * x]])


def fit_plane(points: ArrayLike, up: ArrayLike = (0.0, 0.0, 1.0)) -> Plane:
    """Return the plane of least perpendicular distances to ``points`` (k, 3).

    The normal is the right singular vector of the smallest singular value of the centred points
    (laser tracer paper, section 3.2); of its two signs the one along ``up`` is taken, so that
    angles in the plane count counter-clockwise about ``up``.

    Raises GeometryError for less than three points, points that are not finite, and points on
    one line.
    """
    p = np.asarray(points, dtype=np.float64)
    if p.ndim != 2 or p.shape[1] != 3 or len(p) < 3:
        raise GeometryError(f"a plane needs at least 3 points (k, 3), found shape {p.shape}")
    if not np.isfinite(p).all():
        row = int(np.flatnonzero(~np.isfinite(p).all(axis=1))[0])
        raise GeometryError(f"a plane needs finite points, found {p[row].tolist()} in row {row}")
    centroid = p.mean(axis=0)
    _, singular, vt = np.linalg.svd(p - centroid, full_matrices=False)
    if not singular[1] > COLLINEAR * singular[0]:
        raise GeometryError(
            f"{len(p)} points on one line (second singular value {singular[1]:.3g} m, first "
            f"{singular[0]:.3g} m) do not determine a plane: add points beside the line"
        )
    normal = vt[2] if vt[2] @ np.asarray(up, dtype=np.float64) >= 0.0 else -vt[2]
    return Plane(normal, -float(normal @ centroid), centroid, singular)


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
