"""The direct way: reflectors carried by the table, angles about the centre of their circle."""

from __future__ import annotations

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.errors import DataError, GeometryError
from rotcal_ros.methods.plane_mirror.solver import cone
from rotcal_ros.methods.plane_mirror.solver.layout import Reflectors
from rotcal_ros.methods.plane_mirror.solver.problem import PlaneMirrorProblem


def direct_readings(placed: Floats, reflectors: Reflectors, angles: Floats) -> Floats:
    """Return one reading (..., M) per row: deviation in rad from its reflector's first row.

    ``placed`` (..., M, 3) in the common frame, ``angles`` (N,) commanded. Plane and circle are
    fitted to all rows of one reflector.
    """
    readings = np.zeros(placed.shape[:-1])
    for at, commanded in reflectors.circles(angles):
        axis, centre, _ = fit_circle(placed[..., at, :], commanded)
        arms = placed[..., at, :] - centre[..., None, :]
        readings[..., at] = cone.deviation(cone.azimuths(arms, axis), commanded)
    return readings


def fit_circle(points: Floats, commanded: Floats) -> tuple[Floats, Floats, Floats]:
    """Return axis (..., 3), centre (..., 3) and radius (...) of the circle through (..., m, 3).

    Plane by singular values, circle by Kasa's algebraic fit in it, about the centre of mass and
    in units of the spread, so that no digits are lost.
    """
    middle = points.mean(axis=-2, keepdims=True)
    arms = points - middle
    scale = np.sqrt((arms**2).sum(axis=-1).mean(axis=-1))[..., None, None]
    _, _, vt = np.linalg.svd(arms, full_matrices=False)
    axis = vt[..., 2, :] * cone.sense(arms, vt[..., 2, :], commanded)[..., None]
    plane = vt[..., :2, :]
    flat = arms @ np.swapaxes(plane, -1, -2) / scale
    design = np.concatenate([2.0 * flat, np.ones((*flat.shape[:-1], 1))], axis=-1)
    squares = (flat**2).sum(axis=-1)[..., None]
    transposed = np.swapaxes(design, -1, -2)
    solution = np.linalg.solve(transposed @ design, transposed @ squares)[..., 0]
    radius = np.sqrt(solution[..., 2] + (solution[..., :2] ** 2).sum(axis=-1))
    shift = (solution[..., None, :2] * scale) @ plane
    return axis, (middle + shift)[..., 0, :], radius * scale[..., 0, 0]


def local_axes(
    placed: Floats, reflectors: Reflectors, angles: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return axes, radii (M,), and distances (M, 2) from the circle, radial and axial, metres.

    The axes (M, 3, 3) are unit vectors; rows tangential, radial, axial.
    """
    axes = np.zeros((len(placed), 3, 3))
    radii, off_circle = np.zeros(len(placed)), np.zeros((len(placed), 2))
    for at, commanded in reflectors.circles(angles):
        axis, centre, radii[at] = fit_circle(placed[at], commanded)
        arms = placed[at] - centre
        tangent = np.cross(axis, arms)
        tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
        axes[at] = np.stack(
            [tangent, np.cross(tangent, axis), np.broadcast_to(axis, tangent.shape)], axis=1
        )
        off_circle[at, 0] = np.einsum("mi,mi->m", arms, axes[at, 1]) - radii[at]
        off_circle[at, 1] = np.einsum("mi,mi->m", arms, axes[at, 2])
    return axes, radii, off_circle


def direct_response(reflectors: Reflectors, angles: Floats, radii: Floats) -> Floats:
    """Return the derivative (M, 2 M) of the readings by tangential and radial movements (m)."""
    azimuth = angles[reflectors.position]
    centre = np.zeros((len(azimuth), 3 * len(reflectors.name)))
    rows = np.arange(len(azimuth))
    centre[rows, 3 * reflectors.reflector] = np.sin(azimuth)
    centre[rows, 3 * reflectors.reflector + 1] = -np.cos(azimuth)
    radial = centre @ np.linalg.pinv(cone.circle_design(azimuth, reflectors.reflector))
    return np.hstack([np.eye(len(azimuth)), radial]) / radii[:, None]


def require_circles(problem: PlaneMirrorProblem, reflectors: Reflectors) -> None:
    """Raise unless every reflector has at least three different places on its circle."""
    circles = reflectors.circles(problem.angles)
    for name, (at, azimuth) in zip(reflectors.name, circles, strict=True):
        places = len(np.unique(reflectors.position[at]))
        if places < 3:
            raise DataError(
                f"{problem.source}: reflector {name} was measured at {places} table positions, "
                "its circle needs 3"
            )
        if np.linalg.svd(cone.circle_columns(azimuth), compute_uv=False)[-1] < 1e-3:
            raise GeometryError(
                f"{problem.source}: the places of reflector {name} span too small an arc to fit "
                "a circle; measure around the whole circle"
            )
