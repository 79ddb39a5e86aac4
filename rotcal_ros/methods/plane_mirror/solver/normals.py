"""Mirror normals: the plane of the mirror at each table position, and the cone of all of them.

*Planes.* A reflector at M is seen through the plane n.x = h at its image M' = M - 2 (n.M - h) n,
so n is along M - M' (Muralikrishnan et al., section 2.2). Several reflectors of one position share
the plane and are fitted together by least squares. The true place of a reflector is an unknown
that is eliminated in closed form: the condition e = M' - M + 2 (n.M - h) n has the covariance
C' + H C H with H = I - 2 n n'.

*Cone.* Brought to one foot, the normals end on a circle about the table axis (figure 5). Its plane
a.n = s gives the axis a; projected on it, the normals give the angles. beta is the elevation of
the normals above the plane of rotation, s = sin(beta). A normal that is moved by tau along t
(rotation) and by eta along b (tilt) changes its own angle by tau / cos(beta) and, through the
axis, all angles by tan(beta) [sin psi, -cos psi] times the tilt of the axis; psi is the azimuth of
a normal about the axis. Directions from the centre of a circle to its points are the cone with
beta = 0: the functions serve reflectors on the table too.

All lengths are metres, all angles radians; "..." are leading axes of trials.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.geometry.rotations import wrap_angle
from rotcal_ros.methods.plane_mirror.solver.problem import MirrorPairs, TrackerNoise

_STEPS: Final = 2  # from the mean of M - M': the first leaves noise squared, the second rounding


@dataclass(frozen=True)
class Normals:
    """Planes n.x = h of the groups in the frame of their tracker station.

    ``normal`` (..., G, 3) unit vectors towards the tracker, ``offset`` (..., G) in metres,
    ``misclosure`` (..., P, 3) the condition e of each pair in metres, ``information``
    (..., G, 4, 4) the inverse covariance of changes of (n, h), of rank 3: n keeps its length.
    """

    normal: Floats
    offset: Floats
    misclosure: Floats
    information: Floats


def fit_normals(points: Floats, pairs: MirrorPairs, weight: Floats) -> Normals:
    """Fit the plane of every group by weighted least squares.

    ``points`` (..., n, 3) in metres, any leading axes (trials); ``weight`` (P, 3, 3) from
    :func:`pair_weights`.
    """
    direct, mirrored = points[..., pairs.direct, :], points[..., pairs.mirrored, :]
    normal, offset = _start(direct, mirrored, pairs)
    for _ in range(_STEPS):
        misclosure = _condition(direct, mirrored, normal, offset, pairs)
        jacobian = condition_jacobian(direct, normal, offset, pairs)
        basis = tangent_basis(normal)
        reduced = jacobian @ basis[..., pairs.group, :, :]
        weighted = np.swapaxes(reduced, -1, -2) @ weight
        information = _sum(weighted @ reduced, pairs, -3)
        gradient = _sum(np.einsum("...pij,...pj->...pi", weighted, misclosure), pairs, -2)
        step = np.linalg.solve(information, -gradient[..., None])
        change = (basis @ step)[..., 0]
        normal = normal + change[..., :3]
        normal = normal / np.linalg.norm(normal, axis=-1, keepdims=True)
        offset = offset + change[..., 3]
    misclosure = _condition(direct, mirrored, normal, offset, pairs)
    # In (n, h), so that every user can choose the directions across n that its model has.
    jacobian = condition_jacobian(direct, normal, offset, pairs)
    information = _sum(np.swapaxes(jacobian, -1, -2) @ weight @ jacobian, pairs, -3)
    return Normals(normal, offset, misclosure, information)


def pair_weights(points: Floats, pairs: MirrorPairs, noise: TrackerNoise) -> Floats:
    """Return the inverse covariances (P, 3, 3) of the conditions at ``points`` (n, 3)."""
    direct, mirrored = points[pairs.direct], points[pairs.mirrored]
    normal, offset = _start(direct, mirrored, pairs)
    n, h = normal[pairs.group], offset[pairs.group]
    turned = reflection(n)
    total = noise.covariance(mirrored) + turned @ noise.covariance(direct) @ turned
    if noise.mirror_slope_std > 0.0:
        slope = noise.mirror_slope_std * image_response(direct, mirrored, n, h)
        total = total + slope @ np.swapaxes(slope, 1, 2)
    return np.asarray(np.linalg.inv(total), dtype=np.float64)


def reflection(normal: Floats) -> Floats:
    """Return H = I - 2 n n' (m, 3, 3), which reflects vectors in planes with ``normal`` (m, 3)."""
    mirrored: Floats = np.eye(3) - 2.0 * normal[:, :, None] * normal[:, None, :]
    return mirrored


def condition_jacobian(
    direct: Floats, normal: Floats, offset: Floats, pairs: MirrorPairs
) -> Floats:
    """Return the derivative (..., P, 3, 4) of the conditions by (n, h) of their groups."""
    n = normal[..., pairs.group, :]
    height = _heights(direct, normal, offset, pairs)
    by_normal = n[..., :, None] * direct[..., None, :] + height[..., None, None] * np.eye(3)
    return 2.0 * np.concatenate([by_normal, -n[..., :, None]], axis=-1)


def tangent_frame(normal: Floats, axis: Floats) -> tuple[Floats, Floats]:
    """Return unit vectors (..., 3) across normals: t along axis x n, and b = n x t.

    A rotation of the mirror about ``axis`` moves n along t, a tilt out of the cone along b.
    """
    t = np.cross(axis, normal)
    t = t / np.linalg.norm(t, axis=-1, keepdims=True)
    return t, np.cross(normal, t)


def tangent_basis(normal: Floats) -> Floats:
    """Return the basis (..., 4, 3) of changes of (n, h) that keep the length of n."""
    # Any axis that is well off the normal serves; the smallest component of n is the safest.
    aside = np.eye(3)[np.argmin(np.abs(normal), axis=-1)]
    t, b = tangent_frame(normal, aside)
    basis = np.zeros((*normal.shape[:-1], 4, 3))
    basis[..., :3, 0], basis[..., :3, 1], basis[..., 3, 2] = t, b, 1.0
    return basis


def incidence(points: Floats, pairs: MirrorPairs, normal: Floats) -> Floats:
    """Return the angle (P,) in rad between each mirrored beam and its normal (G, 3)."""
    beam = points[pairs.mirrored]
    cosine = -np.einsum("pi,pi->p", beam, normal[pairs.group]) / np.linalg.norm(beam, axis=-1)
    angle: Floats = np.arccos(np.clip(cosine, -1.0, 1.0))
    return angle


def image_response(direct: Floats, mirrored: Floats, normal: Floats, offset: Floats) -> Floats:
    """Return the movement (P, 3, 3) of images per change of their normal about the beam's spot.

    All arguments per pair: points (P, 3), ``normal`` (P, 3), ``offset`` (P,).
    """
    # The beam from the tracker (origin) to the image strikes the glass at M' h / (n.M').
    height_of_image = np.einsum("pi,pi->p", mirrored, normal)
    arm = direct - mirrored * (offset / height_of_image)[:, None]
    height = np.einsum("pi,pi->p", arm, normal)[:, None, None]
    across = np.eye(3) - normal[:, :, None] * normal[:, None, :]
    along = (across @ arm[:, :, None])[:, None, :, 0]
    response: Floats = -2.0 * (normal[:, :, None] * along + height * across)
    return response


def _start(direct: Floats, mirrored: Floats, pairs: MirrorPairs) -> tuple[Floats, Floats]:
    """Return approximate planes: the mean over the pairs of a group; exact for a single one.

    The plane of one pair bisects the way from M to M' at right angles.
    """
    normal = _sum(direct - mirrored, pairs, -2)
    normal = normal / np.linalg.norm(normal, axis=-1, keepdims=True)
    height = 0.5 * np.einsum("...pi,...pi->...p", direct + mirrored, normal[..., pairs.group, :])
    return normal, _sum(height, pairs, -1) / np.bincount(pairs.group)


def _condition(
    direct: Floats, mirrored: Floats, normal: Floats, offset: Floats, pairs: MirrorPairs
) -> Floats:
    """Return the condition e = M' - M + 2 (n.M - h) n (..., P, 3) in metres."""
    height = _heights(direct, normal, offset, pairs)
    misclosure: Floats = mirrored - direct + 2.0 * height[..., None] * normal[..., pairs.group, :]
    return misclosure


def _heights(direct: Floats, normal: Floats, offset: Floats, pairs: MirrorPairs) -> Floats:
    """Return the heights n.M - h (..., P) of reflectors above the planes of their groups."""
    heights: Floats = np.einsum("...pi,...pi->...p", direct, normal[..., pairs.group, :])
    return heights - offset[..., pairs.group]


def _sum(values: Floats, pairs: MirrorPairs, axis: int) -> Floats:
    """Return the sums over the pairs of each group; the pairs stand along ``axis``."""
    return np.add.reduceat(values, pairs.start, axis=axis)


def fit_cone(normals: Floats, commanded: Floats) -> tuple[Floats, Floats]:
    """Return axis (..., 3) and height s (...) of the plane through normals (..., m, 3), m >= 3.

    The axis points so that the normals turn the same way as the ``commanded`` angles (m,).
    """
    centre = normals.mean(axis=-2)
    # The direction of least spread is across the plane; its sign is open.
    _, _, vt = np.linalg.svd(normals - centre[..., None, :], full_matrices=False)
    axis = vt[..., -1, :]
    axis = axis * turning_sense(normals, axis, commanded)[..., None]
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
    front, side = axis_frame(normals[..., 0, :], axis)
    along = np.einsum("...mi,...i->...m", normals, front)
    across = np.einsum("...mi,...i->...m", normals, side)
    angles: Floats = np.arctan2(across, along)
    return angles


def axis_frame(normal: Floats, axis: Floats) -> tuple[Floats, Floats]:
    """Return unit vectors (..., 3) across an ``axis``: where the azimuth is 0, and where pi/2.

    Azimuths count from the ``normal`` (..., 3).
    """
    side = np.cross(axis, normal)
    side = side / np.linalg.norm(side, axis=-1, keepdims=True)
    return np.cross(side, axis), side


def angle_deviation(azimuth: Floats, commanded: Floats) -> Floats:
    """Return azimuth - commanded, both from their first entry, wrapped to [-pi, pi]."""
    return wrap_angle(azimuth - azimuth[..., :1] - (commanded - commanded[0]))


def turning_sense(vectors: Floats, axis: Floats, commanded: Floats) -> Floats:
    """Return +1 where vectors (..., m, 3) turn about the axis as the command does, else -1.

    Each step from one of the ``commanded`` angles (m,) to the next has a vote, by its sine.
    """
    cross = np.cross(vectors[..., :-1, :], vectors[..., 1:, :])
    turned = np.einsum("...mi,...i->...m", cross, axis)
    votes = np.einsum("...m,m->...", turned, np.sin(np.diff(commanded)))
    return np.where(votes < 0.0, -1.0, 1.0)


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
