"""Rotation matrices from rotation vectors, for stacks of any shape."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]


def skew(vectors: ArrayLike) -> Floats:
    """Return the cross-product matrices (..., 3, 3): ``skew(a) @ b == np.cross(a, b)``."""
    v = np.asarray(vectors, dtype=np.float64)
    matrices = np.zeros((*v.shape[:-1], 3, 3))
    matrices[..., 2, 1], matrices[..., 1, 2] = v[..., 0], -v[..., 0]
    matrices[..., 0, 2], matrices[..., 2, 0] = v[..., 1], -v[..., 1]
    matrices[..., 1, 0], matrices[..., 0, 1] = v[..., 2], -v[..., 2]
    return matrices


def rotation_from_vector(vectors: ArrayLike) -> Floats:
    """Return the rotations (..., 3, 3) about rotation vectors (..., 3) in rad (Rodrigues).

    The direction of a vector is the axis and its length the angle, counter-clockwise about it.
    Exact to rounding for every angle, the smallest included.
    """
    v = np.asarray(vectors, dtype=np.float64)
    angle = np.linalg.norm(v, axis=-1)[..., None, None]
    cross = skew(v)
    half = np.sinc(angle / (2.0 * np.pi))  # sin(angle / 2) / (angle / 2)
    rotation: Floats = np.eye(3) + np.sinc(angle / np.pi) * cross + 0.5 * half**2 * cross @ cross
    return rotation
