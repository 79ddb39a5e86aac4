"""Angles of mirror normals that stand on one cone about the table axis.

Brought to one foot, the normals end on a circle (Muralikrishnan et al., figure 5). Its plane
a.n = s gives the axis a; projected on it, the normals give the angles. A normal moved by tau
along t (rotation) and by eta along b (tilt) changes its own angle by tau / cos(beta), and, through
the axis, all angles by tan(beta) [sin psi, -cos psi] times the tilt of the axis. beta is the
elevation of the normals above the plane of rotation, s = sin(beta).
"""

from __future__ import annotations

import numpy as np

from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.geometry.rotations import wrap_angle


def fit_cone(normals: Floats, commanded: Floats) -> tuple[Floats, Floats]:
    """Return axis (..., 3) and height s (...) of the plane through normals (..., m, 3), m >= 3.

    The axis points so that the normals turn the same way as the ``commanded`` angles (m,).
    """
    centre = normals.mean(axis=-2)
    _, _, vt = np.linalg.svd(normals - centre[..., None, :], full_matrices=False)
    axis = vt[..., -1, :]
    axis = axis * sense(normals, axis, commanded)[..., None]
    return axis, np.einsum("...i,...i->...", centre, axis)


def axis_of_two(normals: Floats, height: Floats, commanded: Floats) -> Floats:
    """Return the axis (..., 3) about which two normals (..., 2, 3) lean by a known ``height`` s.

    With a.n1 = a.n2 = s the axis has the part s (n1 + n2) / (1 + n1.n2) in their plane; the rest
    is along n1 x n2, turned as the ``commanded`` angles (2,) say.
    """
    first, second = normals[..., 0, :], normals[..., 1, :]
    cosine = np.einsum("...i,...i->...", first, second)
    in_plane = (height / (1.0 + cosine))[..., None] * (first + second)
    across = np.cross(first, second)
    across = across / np.linalg.norm(across, axis=-1, keepdims=True)
    rest = np.sqrt(1.0 - np.einsum("...i,...i->...", in_plane, in_plane))
    sense = np.sign(np.sin(commanded[1] - commanded[0]))
    axis: Floats = in_plane + sense * rest[..., None] * across
    return axis


def azimuths(normals: Floats, axis: Floats) -> Floats:
    """Return the angles (..., m) in (-pi, pi] about ``axis`` (..., 3), from the first normal."""
    side = np.cross(axis, normals[..., 0, :])
    side = side / np.linalg.norm(side, axis=-1, keepdims=True)
    front = np.cross(side, axis)
    along = np.einsum("...mi,...i->...m", normals, front)
    across = np.einsum("...mi,...i->...m", normals, side)
    angles: Floats = np.arctan2(across, along)
    return angles


def axis_response(azimuth: Floats) -> Floats:
    """Return the change (3, m) of (axis tilt along e1, along e2, s / cos beta) per eta.

    e1 and e2 are the directions of azimuth 0 and pi/2; least squares over all normals.
    """
    design = np.column_stack([np.cos(azimuth), np.sin(azimuth), -np.ones_like(azimuth)])
    return -np.linalg.pinv(design)


def two_axis_response(azimuth: Floats) -> tuple[Floats, Floats]:
    """Return the tilt of the axis (2, 2) per eta of two normals, and (2,) per s / cos beta."""
    inverse = np.linalg.inv(np.column_stack([np.cos(azimuth), np.sin(azimuth)]))
    return -inverse, inverse.sum(axis=1)


def azimuth_response(azimuth: Floats, tan_beta: float) -> Floats:
    """Return the change (m, 2) of the azimuths per tilt of the axis along e1 and e2."""
    return tan_beta * np.column_stack([np.sin(azimuth), -np.cos(azimuth)])


def circle_columns(azimuth: Floats) -> Floats:
    """Return (m, 3): how centre and radius of a circle move its points radially.

    The same columns say how two tilts and the height of its plane move them axially.
    """
    return np.column_stack([np.cos(azimuth), np.sin(azimuth), np.ones_like(azimuth)])


def circle_design(azimuth: Floats, circle: Ints) -> Floats:
    """Return (m, 3 K): the columns of K circles; point i is on the one with number circle[i]."""
    design = np.zeros((len(azimuth), 3 * (int(circle.max()) + 1)))
    rows = np.arange(len(azimuth))[:, None]
    design[rows, 3 * circle[:, None] + np.arange(3)] = circle_columns(azimuth)
    return design


def deviation(azimuth: Floats, commanded: Floats) -> Floats:
    """Return azimuth - commanded, both from their first entry, wrapped to [-pi, pi]."""
    return wrap_angle(azimuth - azimuth[..., :1] - (commanded - commanded[0]))


def sense(normals: Floats, axis: Floats, commanded: Floats) -> Floats:
    """Return +1 where the normals turn about the axis as the command does, else -1."""
    cross = np.cross(normals[..., :-1, :], normals[..., 1:, :])
    turned = np.einsum("...mi,...i->...m", cross, axis)
    votes = np.einsum("...m,m->...", turned, np.sin(np.diff(commanded)))
    return np.where(votes < 0.0, -1.0, 1.0)
