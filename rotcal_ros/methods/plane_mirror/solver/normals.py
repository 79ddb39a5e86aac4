"""The mirror's plane at each table position from direct and mirrored points.

A reflector at M is seen through the plane n.x = h at its image M' = M - 2 (n.M - h) n, so n is
along M - M' (Muralikrishnan et al., section 2.2). Several reflectors of one position share the
plane and are fitted together by least squares. The true place of a reflector is an unknown that is
eliminated in closed form: the condition e = M' - M + 2 (n.M - h) n has the covariance
C' + H C H with H = I - 2 n n'.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.methods.plane_mirror.solver.layout import MirrorPairs
from rotcal_ros.methods.plane_mirror.solver.problem import TrackerNoise

_STEPS: Final = 2  # from the mean of M - M': first noise squared, then rounding


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
    jacobian = condition_jacobian(direct, normal, offset, pairs)
    information = _sum(np.swapaxes(jacobian, -1, -2) @ weight @ jacobian, pairs, -3)
    return Normals(normal, offset, misclosure, information)


def pair_weights(points: Floats, pairs: MirrorPairs, noise: TrackerNoise) -> Floats:
    """Return the inverse covariances (P, 3, 3) of the conditions at ``points`` (n, 3)."""
    direct, mirrored = points[pairs.direct], points[pairs.mirrored]
    normal, offset = _start(direct, mirrored, pairs)
    n, h = normal[pairs.group], offset[pairs.group]
    reflection = np.eye(3) - 2.0 * n[:, :, None] * n[:, None, :]
    total = noise.covariance(mirrored) + reflection @ noise.covariance(direct) @ reflection
    if noise.mirror_slope_std > 0.0:
        slope = noise.mirror_slope_std * image_response(direct, mirrored, n, h)
        total = total + slope @ np.swapaxes(slope, 1, 2)
    return np.asarray(np.linalg.inv(total), dtype=np.float64)


def tangent_frame(normal: Floats, axis: Floats) -> tuple[Floats, Floats]:
    """Return unit vectors (..., 3) across normals: t along axis x n, and b = n x t.

    A rotation of the mirror about ``axis`` moves n along t, a tilt out of the cone along b.
    """
    t = np.cross(axis, normal)
    t = t / np.linalg.norm(t, axis=-1, keepdims=True)
    return t, np.cross(normal, t)


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
    height_of_image = np.einsum("pi,pi->p", mirrored, normal)
    arm = direct - mirrored * (offset / height_of_image)[:, None]
    height = np.einsum("pi,pi->p", arm, normal)[:, None, None]
    across = np.eye(3) - normal[:, :, None] * normal[:, None, :]
    along = (across @ arm[:, :, None])[:, None, :, 0]
    response: Floats = -2.0 * (normal[:, :, None] * along + height * across)
    return response


def _start(direct: Floats, mirrored: Floats, pairs: MirrorPairs) -> tuple[Floats, Floats]:
    """Exact for one pair: the perpendicular bisector of M and M'; else the mean over pairs."""
    normal = _sum(direct - mirrored, pairs, -2)
    normal = normal / np.linalg.norm(normal, axis=-1, keepdims=True)
    height = 0.5 * np.einsum("...pi,...pi->...p", direct + mirrored, normal[..., pairs.group, :])
    return normal, _sum(height, pairs, -1) / np.bincount(pairs.group)


def condition_jacobian(
    direct: Floats, normal: Floats, offset: Floats, pairs: MirrorPairs
) -> Floats:
    """Return the derivative (..., P, 3, 4) of the conditions by (n, h) of their groups."""
    n = normal[..., pairs.group, :]
    height = np.einsum("...pi,...pi->...p", direct, n) - offset[..., pairs.group]
    by_normal = n[..., :, None] * direct[..., None, :] + height[..., None, None] * np.eye(3)
    return 2.0 * np.concatenate([by_normal, -n[..., :, None]], axis=-1)


def _condition(
    direct: Floats, mirrored: Floats, normal: Floats, offset: Floats, pairs: MirrorPairs
) -> Floats:
    """Condition e = M' - M + 2 (n.M - h) n (..., P, 3) in metres."""
    n = normal[..., pairs.group, :]
    height = np.einsum("...pi,...pi->...p", direct, n) - offset[..., pairs.group]
    misclosure: Floats = mirrored - direct + 2.0 * height[..., None] * n
    return misclosure


def tangent_basis(normal: Floats) -> Floats:
    """Basis (..., 4, 3) of changes of (n, h) that keep the length of n."""
    # Any axis that is well off the normal serves; the smallest component of n is the safest.
    aside = np.eye(3)[np.argmin(np.abs(normal), axis=-1)]
    t, b = tangent_frame(normal, aside)
    basis = np.zeros((*normal.shape[:-1], 4, 3))
    basis[..., :3, 0], basis[..., :3, 1], basis[..., 3, 2] = t, b, 1.0
    return basis


def _sum(values: Floats, pairs: MirrorPairs, axis: int) -> Floats:
    return np.add.reduceat(values, pairs.start, axis=axis)
