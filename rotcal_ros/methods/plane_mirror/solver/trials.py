"""Monte Carlo trials of the plane-mirror method, vectorised: a thousand solutions in one go."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.methods.plane_mirror.solver.cone import fit_cone
from rotcal_ros.methods.plane_mirror.solver.gathering import settled
from rotcal_ros.methods.plane_mirror.solver.normals import image_response, tangent_frame
from rotcal_ros.methods.plane_mirror.solver.prepare import (
    PreparedNormals,
    PreparedPoints,
    PreparedWay,
)
from rotcal_ros.methods.plane_mirror.solver.problem import PlaneMirrorProblem
from rotcal_ros.methods.plane_mirror.solver.stitching import station_cones
from rotcal_ros.methods.plane_mirror.solver.swing import swings

_CHUNK: Final = 250  # trials at a time keep the arrays small enough for the cache


@dataclass(frozen=True)
class MirrorTrials:
    """Draws measurements like the given one and solves them; made by :func:`mirror_trials`.

    ``factor`` (n, 3, 3) are Cholesky factors of the points' covariances, ``tilt`` (2 N, 3 n) the
    movement of all coordinates per tilt (rad) of the table across and along the normal, ``swing``
    (K, 3 n) the same per standard deviation of the tracker's :mod:`.swing`.
    """

    prepared: PreparedWay
    factor: Floats
    tilt: Floats
    swing: Floats

    def __call__(self, rng: np.random.Generator, count: int) -> Floats:
        """Return the deviations (count, N) in rad of ``count`` simulated measurements."""
        parts = [
            self.prepared.estimate(self.draw(rng, min(_CHUNK, count - done)))
            for done in range(0, count, _CHUNK)
        ]
        return np.concatenate(parts)

    def draw(self, rng: np.random.Generator, count: int) -> Floats:
        """Return points (count, n, 3): the measured ones with fresh noise and table tilts."""
        xyz = self.prepared.problem.xyz
        noise = rng.standard_normal((count, *xyz.shape))
        tilts = self.prepared.problem.tilt_std * rng.standard_normal((count, len(self.tilt)))
        points: Floats = xyz + (self.factor @ noise[..., None])[..., 0]
        points += (tilts @ self.tilt).reshape(points.shape)
        if len(self.swing):
            amplitudes = rng.standard_normal((count, len(self.swing)))
            points += (amplitudes @ self.swing).reshape(points.shape)
        return points


def mirror_trials(problem: PlaneMirrorProblem) -> MirrorTrials:
    """Prepare Monte Carlo trials about a measured problem; refuses what ``solve`` refuses."""
    prepared = settled(problem).screened.prepared
    swing = swings(prepared).reshape(problem.xyz.size, -1).T
    covariance = problem.noise.covariance(problem.xyz)
    if isinstance(prepared, PreparedPoints):
        none = np.zeros((0, problem.xyz.size))
        return MirrorTrials(prepared, _factor(covariance), none, none)
    pairs, normals = prepared.pairs, prepared.normals(problem.xyz)
    response = image_response(
        problem.xyz[pairs.direct],
        problem.xyz[pairs.mirrored],
        normals.normal[pairs.group],
        normals.offset[pairs.group],
    )
    slope = problem.noise.mirror_slope_std * response
    covariance[pairs.mirrored] += slope @ np.swapaxes(slope, 1, 2)
    axes, height = _axes(prepared, normals.normal)
    t, b = tangent_frame(normals.normal, axes)
    tilt = np.zeros((len(prepared.angles), 2, *problem.xyz.shape))
    for which, change in enumerate((b, height * t)):
        moved = (response @ change[pairs.group][..., None])[..., 0]
        tilt[pairs.position[pairs.group], which, pairs.mirrored] = moved
    tilt = tilt.reshape(-1, problem.xyz.size)
    return MirrorTrials(prepared, _factor(covariance), tilt, swing)


def _factor(covariance: Floats) -> Floats:
    return np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)


def _axes(prepared: PreparedNormals, normals: Floats) -> tuple[Floats, float]:
    """Table axis (G, 3) as each group's station sees it, and the height of the cone."""
    angles, pairs = prepared.angles, prepared.pairs
    if prepared.problem.way == "stitching":
        axes, height = station_cones(normals, pairs, angles)
        return axes, float(height)
    placed = prepared.poses.turned(normals, pairs.station)
    axis, common = fit_cone(placed, angles[pairs.position])
    return axis @ prepared.poses.rotation[pairs.station], float(common)
