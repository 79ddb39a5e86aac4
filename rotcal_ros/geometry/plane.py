"""The plane through points in space, by singular value decomposition."""

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
