"""The rigid transform between two sets of matched points, weighted, with covariance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from rotcal_ros.arrays import Floats
from rotcal_ros.errors import GeometryError
from rotcal_ros.geometry.rotations import cross_matrix, rotation_from_vector

MIN_ASPECT: Final = 0.01
"""Points whose extent across their longest direction is below this share lie "in a line"."""
_MAX_STEPS: Final = 20


@dataclass(frozen=True)
class RigidFit:
    """``target = rotation @ source + translation`` and how well it is known.

    ``rotation`` (3, 3), ``translation`` (3,) in metres, ``residual`` (n, 3) = target - image of
    source. ``covariance`` (6, 6) belongs to a small rotation (rad, axes of the target frame,
    about the image of the source's origin) followed by a shift (m). ``chi_square`` is the
    weighted sum of squares with ``dof`` = 3 n - 6.
    """

    rotation: Floats
    translation: Floats
    covariance: Floats
    residual: Floats
    chi_square: float
    dof: int

    def apply(self, points: Floats) -> Floats:
        """Return points (..., 3) of the source frame in the target frame."""
        image: Floats = points @ self.rotation.T + self.translation
        return image


def align(source: Floats, target: Floats, weights: Floats | None = None) -> tuple[Floats, Floats]:
    """Return rotation (..., 3, 3) and translation (..., 3) of least squares in closed form.

    ``source`` and ``target`` are (..., n, 3) in metres, ``weights`` (n,) one number per point.
    Never returns a reflection. Source: Arun, Huang and Blostein (1987), with Umeyama's (1991)
    sign. Does not judge whether the points determine the transform: see :func:`require_spread`.
    """
    w = np.ones(source.shape[-2]) if weights is None else weights
    w = (w / w.sum())[:, None]
    source_mean = (w * source).sum(axis=-2, keepdims=True)
    target_mean = (w * target).sum(axis=-2, keepdims=True)
    correlation = np.swapaxes(w * (target - target_mean), -1, -2) @ (source - source_mean)
    u, _, vt = np.linalg.svd(correlation)
    u[..., :, 2] *= np.linalg.det(u @ vt)[..., None]
    rotation: Floats = u @ vt
    shift = target_mean - source_mean @ np.swapaxes(rotation, -1, -2)
    return rotation, shift[..., 0, :]


def require_spread(points: Floats, what: str) -> None:
    """Raise GeometryError unless points (n, 3) span a plane well enough to fix a rotation.

    ``what`` names the points in the message, for example "the nests shared by A and B".
    """
    if len(points) < 3:
        raise GeometryError(f"{what}: {len(points)} points, a rigid transform needs at least 3")
    extent = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if extent[1] < MIN_ASPECT * extent[0] or extent[0] == 0.0:
        raise GeometryError(
            f"{what} lie in a line (within {extent[1] * 1e3:.2f} mm over "
            f"{extent[0] * 1e3:.0f} mm), so the rotation about that line is open; "
            "place at least one of them aside"
        )


def fit_rigid(
    source: Floats,
    target: Floats,
    source_covariance: Floats | None = None,
    target_covariance: Floats | None = None,
) -> RigidFit:
    """Fit the rigid transform that maps ``source`` to ``target``, both (n, 3) in metres.

    The covariances are (n, 3, 3), each in the frame of its points; an absent one is zero, and
    without any the points have unit variance. Gauss-Newton from :func:`align`; points in a
    line or fewer than three raise GeometryError.
    """
    require_spread(source, "the points of the rigid transform")
    rotation, translation = align(source, target)
    for _ in range(_MAX_STEPS):
        turned = source @ rotation.T
        weight = _weights(rotation, source_covariance, target_covariance, len(source))
        residual = target - turned - translation
        jacobian = np.concatenate(
            [-cross_matrix(turned), np.broadcast_to(np.eye(3), (len(source), 3, 3))], axis=-1
        )
        weighted = np.swapaxes(jacobian, -1, -2) @ weight
        normal = (weighted @ jacobian).sum(axis=0)
        step = np.linalg.solve(normal, np.einsum("nij,nj->i", weighted, residual))
        rotation = rotation_from_vector(step[:3]) @ rotation
        translation = translation + step[3:]
        if np.abs(step).max() < 1e-13:
            break
    residual = target - source @ rotation.T - translation
    return RigidFit(
        rotation=rotation,
        translation=translation,
        covariance=np.linalg.inv(normal),
        residual=residual,
        chi_square=float(np.einsum("ni,nij,nj->", residual, weight, residual)),
        dof=3 * len(source) - 6,
    )


def _weights(rotation: Floats, source: Floats | None, target: Floats | None, n: int) -> Floats:
    """Inverse covariance (n, 3, 3) of target - image, in the target frame."""
    if source is None and target is None:
        return np.broadcast_to(np.eye(3), (n, 3, 3))
    total = np.zeros((n, 3, 3)) if target is None else target
    if source is not None:
        total = total + rotation @ source @ rotation.T
    return np.asarray(np.linalg.inv(total), dtype=np.float64)
