"""From points to deviations, for one measurement or for thousands of trials at once.

What depends only on the layout and on the noise is prepared once; the estimates then take points
with any leading axes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from rotcal_ros.arrays import Floats
from rotcal_ros.methods.plane_mirror import cone, joint
from rotcal_ros.methods.plane_mirror.direct import direct_readings
from rotcal_ros.methods.plane_mirror.layout import Nests, Pairs, Reflectors
from rotcal_ros.methods.plane_mirror.normals import Normals, fit_normals
from rotcal_ros.methods.plane_mirror.problem import PlaneMirrorProblem
from rotcal_ros.methods.plane_mirror.registration import Poses, adjust_stations
from rotcal_ros.methods.plane_mirror.stitching import stitch

_TRIAL_STEPS: Final = 2  # Gauss-Newton from the nominal solution: noise squared, then rounding


@dataclass(frozen=True)
class Prepared:
    """A screened problem with all that does not change from trial to trial.

    ``angles`` (N,) are those of the positions that were measured; the positions of ``pairs`` and
    ``reflectors`` count in them. ``joining`` (N, readings) makes deviations of readings.
    ``poses`` are the nominal stations, or all at the origin where the way needs none.
    ``mirror`` is the nominal joint solution.
    """

    problem: PlaneMirrorProblem
    angles: Floats
    pairs: Pairs | None
    reflectors: Reflectors | None
    nests: Nests
    pair_weight: Floats
    nest_weight: Floats
    poses: Poses
    joining: Floats
    mirror: joint.Mirror | None = None


def estimate(prepared: Prepared, points: Floats) -> Floats:
    """Return the deviations (..., N) in rad, from the first position, of points (..., n, 3)."""
    if prepared.problem.way == "direct":
        readings = _direct(prepared, points)
    else:
        assert prepared.pairs is not None
        normals = fit_normals(points, prepared.pairs, prepared.pair_weight)
        if prepared.problem.way == "joint":
            return _joint(prepared, points, normals)
        if prepared.problem.way == "stitching":
            readings = stitch(normals.normal, prepared.pairs, prepared.angles)
        else:
            readings = _registered(prepared, points, normals)
    result: Floats = readings @ prepared.joining.T
    return result


def registered_readings(normals: Floats, pairs: Pairs, angles: Floats) -> Floats:
    """Return one reading (..., G) per normal (..., G, 3) in the common frame."""
    commanded = angles[pairs.position]
    axis, _ = cone.fit_cone(normals, commanded)
    return cone.deviation(cone.azimuths(normals, axis), commanded)


def stations_of(prepared: Prepared, points: Floats) -> Poses:
    """Return the adjusted stations for points (..., n, 3)."""
    if prepared.poses.rotation.shape[-3] == 1:
        return prepared.poses
    return adjust_stations(
        points, prepared.nests, prepared.nest_weight, prepared.poses, _TRIAL_STEPS
    )


def _direct(prepared: Prepared, points: Floats) -> Floats:
    reflectors = prepared.reflectors
    assert reflectors is not None
    placed = stations_of(prepared, points).placed(
        points[..., reflectors.row, :], reflectors.station
    )
    return direct_readings(placed, reflectors, prepared.angles)


def _registered(prepared: Prepared, points: Floats, normals: Normals) -> Floats:
    assert prepared.pairs is not None
    poses = stations_of(prepared, points)
    placed = poses.turned(normals.normal, prepared.pairs.station)
    return registered_readings(placed, prepared.pairs, prepared.angles)


def _joint(prepared: Prepared, points: Floats, normals: Normals) -> Floats:
    assert prepared.pairs is not None
    assert prepared.mirror is not None
    mirror, _ = joint.adjust_joint(
        points,
        normals,
        prepared.pairs,
        prepared.nests,
        prepared.nest_weight,
        prepared.problem.tilt_std,
        prepared.mirror,
        _TRIAL_STEPS,
    )
    return cone.deviation(mirror.psi, prepared.angles)
