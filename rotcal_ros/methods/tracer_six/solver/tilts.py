"""Prior knowledge of the table's tilts, for places that cannot tell them.

The tilt c_i of each position, less what both frames contribute, u + Rz w with four unknowns
(u, w), is an observation of zero with the standard deviation ``tilt_std``; in a trial it is one of
what chance has drawn.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.geometry.rotations import rotation_about_z
from rotcal_ros.methods.tracer_six.solver.curves import gauge_design, log_slope, rotation_vector
from rotcal_ros.methods.tracer_six.solver.layout import StationLayout


class TiltSlopes(NamedTuple):
    """What the prior adds to chi-squared and to half its slopes, poses (m, 6) and lean (4,)."""

    chi2: float
    poses: Floats
    lean: Floats


def _tilts(rotation: Floats, angles: Floats) -> Floats:
    return rotation_vector(rotation @ rotation_about_z(-angles))


def slopes(rotation: Floats, lean: Floats, layout: StationLayout) -> TiltSlopes:
    """Return what the prior adds at poses ``rotation`` (m, 3, 3) and ``lean`` (4,) rad."""
    std = layout.tilt_std
    assert std is not None
    design, _ = gauge_design(layout.angles)
    vector = _tilts(rotation, layout.angles)
    expected = (design @ lean).reshape(-1, 2)
    if layout.tilts is not None:
        expected = expected + layout.tilts
    error = (vector[:, :2] - expected) / std
    slope = log_slope(vector)[:, :2]
    poses = np.zeros((len(vector), 6))
    poses[:, :3] = (error[:, None] @ slope)[:, 0] / std
    return TiltSlopes(float((error**2).sum()), poses, -design.T @ error.ravel() / std)


def add(
    poses: Floats, cross: Floats, matrix: Floats, rotation: Floats, layout: StationLayout
) -> tuple[Floats, Floats]:
    """Return the normal matrices of poses (m, 6, 6) and (m, 6, K) with the prior.

    ``matrix`` (K, K), whose last four are the lean, is changed in place.
    """
    assert layout.tilt_std is not None
    weight = layout.tilt_std**-2
    design, _ = gauge_design(layout.angles)
    slope = log_slope(_tilts(rotation, layout.angles))[:, :2]
    back = weight * slope.swapaxes(1, 2)
    poses, cross = poses.copy(), cross.copy()
    poses[:, :3, :3] += back @ slope
    cross[:, :3, -4:] -= back @ design.reshape(-1, 2, 4)
    matrix[-4:, -4:] += weight * design.T @ design
    return poses, cross
