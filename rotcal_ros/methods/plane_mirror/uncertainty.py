"""From the tracker's noise to the covariance of the angle readings, in closed form.

The mirror ways feel two movements of each normal: tau along t (rotation) and eta along b (tilt),
in that order 2 G numbers; the direct way feels tangential, radial and axial movements.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from rotcal_ros.arrays import Floats, Ints
from rotcal_ros.methods.plane_mirror import cone
from rotcal_ros.methods.plane_mirror.joint import plane_weight
from rotcal_ros.methods.plane_mirror.layout import Pairs, Reflectors
from rotcal_ros.methods.plane_mirror.normals import Normals, tangent_frame
from rotcal_ros.methods.plane_mirror.problem import PlaneMirrorProblem
from rotcal_ros.methods.plane_mirror.registration import Poses, station_columns


def normal_covariance(
    normals: Normals,
    pairs: Pairs,
    poses: Poses,
    axes: Floats,
    pose_covariance: Floats,
    tilt_std: float,
) -> Floats:
    """Return the covariance (2 G, 2 G) in rad^2 of all tau, then all eta.

    ``axes`` (3,) or (G, 3) is the table axis along the common axes of ``poses``;
    ``pose_covariance`` (p, p) is zero where stations are not brought together.
    """
    n = pairs.n_groups
    t, b = tangent_frame(poses.turned(normals.normal, pairs.station), axes)
    own = np.linalg.inv(plane_weight(normals, pairs, poses, t, b))[:, :2, :2]
    total = _independent(own)
    same = pairs.position[:, None] == pairs.position[None, :]
    total[1, :, 1, :] += tilt_std**2 * same
    by_pose = np.zeros((2, n, len(pose_covariance)))
    movable, columns = station_columns(pairs.station)
    by_pose[0, movable[:, None], columns[:, :3]] = b[movable]
    by_pose[1, movable[:, None], columns[:, :3]] = -t[movable]
    flat = by_pose.reshape(2 * n, -1)
    covariance: Floats = total.reshape(2 * n, 2 * n) + flat @ pose_covariance @ flat.T
    return covariance


def registered_response(pairs: Pairs, angles: Floats, height: float) -> Floats:
    """Return the derivative (G, 2 G) of angles about one common axis by tau and eta."""
    azimuth = angles[pairs.position]
    cos_beta = float(np.sqrt(1.0 - height**2))
    turn = cone.azimuth_response(azimuth, height / cos_beta)
    by_eta = turn @ cone.axis_response(azimuth)[:2]
    return np.hstack([np.eye(len(azimuth)) / cos_beta, by_eta])


def point_covariance(
    problem: PlaneMirrorProblem,
    reflectors: Reflectors,
    poses: Poses,
    axes: Floats,
    pose_covariance: Floats,
) -> Floats:
    """Return the covariance (3 M, 3 M) in m^2: all tangential, all radial, all axial movements.

    ``axes`` (M, 3, 3) are the local directions as rows.
    """
    n = len(reflectors.row)
    points = problem.xyz[reflectors.row]
    local = axes @ poses.rotation[reflectors.station]
    own = local @ problem.noise.covariance(points) @ np.swapaxes(local, 1, 2)
    total = _independent(own)
    arm = poses.turned(points, reflectors.station)
    by_pose = np.zeros((3, n, len(pose_covariance)))
    movable, columns = station_columns(reflectors.station)
    for k in range(3):
        direction = axes[movable, k]
        by_pose[k, movable[:, None], columns[:, :3]] = np.cross(arm[movable], direction)
        by_pose[k, movable[:, None], columns[:, 3:]] = direction
    flat = by_pose.reshape(3 * n, -1)
    covariance: Floats = total.reshape(3 * n, 3 * n) + flat @ pose_covariance @ flat.T
    return covariance


def _independent(own: ArrayLike) -> Floats:
    """Return the covariance (k, n, k, n) of n independent places with their ``own`` (n, k, k)."""
    n, k, _ = np.shape(own)
    total = np.zeros((k, n, k, n))
    total[:, np.arange(n), :, np.arange(n)] = own
    return total


def tilt_crosstalk(problem: PlaneMirrorProblem, height: float, n: int) -> Floats:
    """Return the covariance (n, n): a tilt about the normal's own direction turns it by sin(beta).

    Relative to the first position.
    """
    lean = height**2 / (1.0 - height**2)
    contrast = np.eye(n)
    contrast[:, 0] -= 1.0
    covariance: Floats = lean * problem.tilt_std**2 * contrast @ contrast.T
    return covariance


def misfit(values: Floats, design: Floats, covariance: Floats) -> tuple[float, int]:
    """Return the chi square and its degrees of freedom of ``values`` (m,) about a fit.

    ``design`` (m, k) spans what the unweighted fit takes away, ``covariance`` (m, m) is that of
    the values before. The statistic weighs the remainder by its own covariance, so that it is
    chi-square distributed although the fit is not weighted.
    """
    basis, size, _ = np.linalg.svd(design, full_matrices=True)
    rank = int((size > 1e-9 * size.max()).sum())
    rest = basis[:, rank:]
    if rest.shape[1] == 0:
        return 0.0, 0
    part = rest.T @ values
    chi_square = part @ np.linalg.solve(rest.T @ covariance @ rest, part)
    return float(chi_square), rest.shape[1]


def cone_misfit(
    normals: Floats, axes: Floats, zero: Ints, azimuth: Floats, covariance: Floats
) -> tuple[float, int]:
    """Return chi square and dof of the normals (G, 3) about their cones, one per set ``zero``."""
    values = np.einsum("gi,gi->g", normals, axes)
    values = values / np.sqrt(1.0 - values.mean() ** 2)
    return misfit(values, cone.circle_design(azimuth, zero), covariance)


def stitched_covariance(normals: Normals, pairs: Pairs, axes: Floats, tilt_std: float) -> Floats:
    """Return the covariance (2 G, 2 G) of the normals in their stations; ``axes`` (G, 3)."""
    n_stations = int(pairs.station.max()) + 1
    own = Poses(np.tile(np.eye(3), (n_stations, 1, 1)), np.zeros((n_stations, 3)))
    none = np.zeros((6 * (n_stations - 1),) * 2)
    return normal_covariance(normals, pairs, own, axes, none, tilt_std)
