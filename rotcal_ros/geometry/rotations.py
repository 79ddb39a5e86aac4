"""Rotations, angles and rigid transforms: wrapping, matrices, best fit between point sets.

Angles are radians, counter-clockwise about the axis; matrices act on column vectors.
"""

from __future__ import annotations

from math import cos, sin
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.errors import GeometryError


def wrap_angle(angle: ArrayLike) -> Floats:
    """Return ``angle`` (rad, any shape) moved by whole turns into [-pi, pi]."""
    turns = np.asarray(angle, dtype=np.float64)
    return np.asarray(np.remainder(turns + np.pi, 2.0 * np.pi) - np.pi, dtype=np.float64)


def cross_matrix(vectors: ArrayLike) -> Floats:
    """Return the matrices (..., 3, 3) with ``cross_matrix(v) @ w == cross(v, w)``."""
    v = np.asarray(vectors, dtype=np.float64)
    matrix = np.zeros((*v.shape, 3))
    matrix[..., 2, 1] = v[..., 0]
    matrix[..., 0, 2] = v[..., 1]
    matrix[..., 1, 0] = v[..., 2]
    return matrix - np.swapaxes(matrix, -1, -2)


def rotation_about_z(angle: ArrayLike) -> Floats:
    """Return the matrices (..., 3, 3) that turn by ``angle`` (rad) counter-clockwise about +z."""
    theta = np.asarray(angle, dtype=np.float64)
    matrix = np.zeros((*theta.shape, 3, 3))
    matrix[..., 0, 0] = matrix[..., 1, 1] = np.cos(theta)
    matrix[..., 1, 0] = np.sin(theta)
    matrix[..., 0, 1] = -matrix[..., 1, 0]
    matrix[..., 2, 2] = 1.0
    return matrix


def rotate_about_table_axis(
    place: tuple[float, float, float], angle: float
) -> tuple[float, float, float]:
    """Return where ``place`` (m) gets when the table turns by ``angle`` (rad) about +z."""
    x, y, z = place
    c, s = cos(angle), sin(angle)
    return c * x - s * y, s * x + c * y, z


def positions_on_table(
    mount: ArrayLike, table_angles: ArrayLike, centre: ArrayLike = (0.0, 0.0)
) -> Floats:
    """Return the places (m, 3), m, of what the table carries from ``mount`` (3,), at each angle.

    ``table_angles`` (m,), rad; ``centre`` (2,), m: where the table's axis meets the xy-plane.
    """
    angle, (x, y, z), (x0, y0) = (
        np.asarray(values, dtype=np.float64) for values in (table_angles, mount, centre)
    )
    c, s = np.cos(angle), np.sin(angle)
    return np.column_stack([x0 + c * x - s * y, y0 + s * x + c * y, np.full_like(angle, z)])


def rotation_from_vector(vectors: ArrayLike) -> Floats:
    """Return the matrices (..., 3, 3) that turn by ``|v|`` (rad) about each v (..., 3)."""
    v = np.asarray(vectors, dtype=np.float64)
    angle = np.linalg.norm(v, axis=-1)[..., None, None]
    k = cross_matrix(v)
    # sinc(x) = sin(pi x) / (pi x) stays exact where sin(angle) / angle would be 0 / 0.
    first = np.sinc(angle / np.pi)
    second = 0.5 * np.sinc(0.5 * angle / np.pi) ** 2
    result: Floats = np.eye(3) + first * k + second * (k @ k)
    return result


MIN_ASPECT: Final = 0.01
"""Points whose extent across their longest direction is below this share lie "in a line"."""


def fit_rigid_transform(source: Floats, target: Floats) -> tuple[Floats, Floats]:
    """Return rotation (..., 3, 3) and translation (..., 3) of least squares in closed form.

    ``target = rotation @ source + translation``; both sets are (..., n, 3) in metres. Never
    returns a reflection. Source: Arun, Huang and Blostein (1987), with the sign of Umeyama (1991).
    Whether the points determine the transform is not judged: see :func:`require_spread`.
    """
    share = 1.0 / source.shape[-2]
    source_mean = (share * source).sum(axis=-2, keepdims=True)
    target_mean = (share * target).sum(axis=-2, keepdims=True)
    correlation = np.swapaxes(share * (target - target_mean), -1, -2) @ (source - source_mean)
    u, _, vt = np.linalg.svd(correlation)
    u[..., :, 2] *= np.linalg.det(u @ vt)[..., None]
    rotation: Floats = u @ vt
    shift = target_mean - source_mean @ np.swapaxes(rotation, -1, -2)
    return rotation, shift[..., 0, :]


def require_spread(points: Floats, what: str) -> None:
    """Raise GeometryError unless points (n, 3), n > 2, span a plane and so fix a rotation.

    ``what`` names the points in the message, for example "the nests shared by A and B".
    """
    extent = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if extent[1] < MIN_ASPECT * extent[0] or extent[0] == 0.0:
        raise GeometryError(
            f"{what} lie in a line (within {extent[1] * 1e3:.2f} mm over "
            f"{extent[0] * 1e3:.0f} mm), so the rotation about that line is open; "
            "place at least one of them aside"
        )
