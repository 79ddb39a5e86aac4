"""What each of the four ways makes of a screened problem: deviations, covariance, fit."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from rotcal_ros.arrays import Floats, Ints
from rotcal_ros.methods.plane_mirror import cone, joint, stitching
from rotcal_ros.methods.plane_mirror import uncertainty as unc
from rotcal_ros.methods.plane_mirror.direct import (
    circle_design,
    direct_readings,
    direct_response,
    fit_circle,
    local_axes,
)
from rotcal_ros.methods.plane_mirror.estimate import Prepared, registered_readings
from rotcal_ros.methods.plane_mirror.nest_tests import NestFit, nest_fit
from rotcal_ros.methods.plane_mirror.normals import Normals, fit_normals
from rotcal_ros.methods.plane_mirror.registration import nest_equations
from rotcal_ros.methods.plane_mirror.residuals import enter, enter_nests, enter_pairs
from rotcal_ros.results import Residuals


@dataclass(frozen=True)
class Outcome:
    """Deviations (N,) in rad from the first position, covariance (N, N), chi square and dof.

    ``details`` are plain values for the result.
    """

    deviations: Floats
    covariance: Floats
    chi_square: float
    dof: int
    details: dict[str, Any]


def stitched(prepared: Prepared, residuals: Residuals) -> Outcome:
    """Stitching: a plane per station, zeros tied by shared positions."""
    pairs, angles = prepared.pairs, prepared.angles
    assert pairs is not None
    normals = _pairs_fit(prepared, residuals)
    covariance, axes = unc.stitched_covariance(normals, pairs, angles, prepared.problem.tilt_std)
    readings = stitching.stitch(normals.normal, pairs, angles)
    response = stitching.stitch_response(normals.normal, pairs, angles)
    height = float(stitching.cone_height(normals.normal, pairs, angles))
    _, zero = np.unique(pairs.station, return_inverse=True)
    outcome = _from_readings(prepared, normals, readings, response, covariance, axes, zero)
    outcome.details["lean_rad"] = float(np.arcsin(height))
    return _with_crosstalk(prepared, outcome, height)


def registered(prepared: Prepared, residuals: Residuals) -> Outcome:
    """Registration: one plane for all normals in the frame of the first station."""
    pairs, angles = prepared.pairs, prepared.angles
    assert pairs is not None
    normals = _pairs_fit(prepared, residuals)
    nests = _nests_fit(prepared, residuals)
    placed = prepared.poses.turned(normals.normal, pairs.station)
    axis, height = cone.fit_cone(placed, angles[pairs.position])
    covariance = unc.normal_covariance(
        normals,
        pairs,
        prepared.poses,
        axis,
        _pose_covariance(prepared),
        prepared.problem.tilt_std,
    )
    readings = registered_readings(placed, pairs, angles)
    response = unc.registered_response(pairs, angles, float(height))
    zero = np.zeros_like(pairs.station)
    axes = np.broadcast_to(axis, placed.shape)
    outcome = _from_readings(prepared, normals, readings, response, covariance, axes, zero, placed)
    outcome.details.update(axis=axis, lean_rad=float(np.arcsin(height)))
    return _with_crosstalk(prepared, _with_nests(prepared, outcome, nests), float(height))


def joined(prepared: Prepared, residuals: Residuals) -> Outcome:
    """Joint: the least squares of everything at once."""
    pairs, mirror = prepared.pairs, prepared.mirror
    assert pairs is not None
    assert mirror is not None
    normals = _pairs_fit(prepared, residuals)
    nests = _nests_fit(prepared, residuals)
    equations = joint.joint_equations(
        prepared.problem.xyz,
        normals,
        pairs,
        prepared.nests,
        prepared.nest_weight,
        prepared.problem.tilt_std,
        mirror,
    )
    n = len(prepared.angles)
    contrast = np.eye(n)
    contrast[:, 0] -= 1.0
    n_nests, n_points = len(prepared.nests.row), prepared.nests.n_points
    dof = 3 * (len(pairs.direct) + n_nests - n_points) - equations.shared.shape[0] - 2 * n
    outcome = Outcome(
        deviations=cone.deviation(mirror.psi, prepared.angles),
        covariance=contrast @ joint.angle_covariance(equations) @ contrast.T,
        chi_square=float(equations.chi_square) + _groups_fit(prepared, normals)[0],
        dof=dof,
        details={
            "axis": mirror.frame[:, 2],
            "lean_rad": float(mirror.beta),
            "tilts_rad": mirror.eps,
        },
    )
    return _with_crosstalk(
        prepared, _with_nests(prepared, outcome, nests, count=False), float(np.sin(mirror.beta))
    )


def direct(prepared: Prepared, residuals: Residuals) -> Outcome:
    """Direct: plane and circle through the places of reflectors on the table."""
    reflectors, angles, problem = prepared.reflectors, prepared.angles, prepared.problem
    assert reflectors is not None
    nests = _nests_fit(prepared, residuals)
    placed = prepared.poses.placed(problem.xyz[reflectors.row], reflectors.station)
    axes, radii = local_axes(placed, reflectors, angles)
    covariance = unc.point_covariance(
        problem, reflectors, prepared.poses, axes, _pose_covariance(prepared)
    )
    m = len(radii)
    gain = prepared.joining @ direct_response(reflectors, angles, radii)
    readings = direct_readings(placed, reflectors, angles)
    design = circle_design(reflectors, angles)
    off_circle: Floats = _off_circle(prepared, placed, axes, radii)
    both = np.asarray(np.kron(np.eye(2), design), dtype=np.float64)
    chi_square, dof = unc.misfit(off_circle.T.ravel(), both, covariance[m:, m:])
    leverage: Floats = np.einsum("ij,ji->i", design, np.linalg.pinv(design))
    spread = np.diag(covariance)[m:].reshape(2, m).T * (1.0 - leverage)[:, None]
    test = np.sqrt((off_circle**2 / np.maximum(spread, 1e-300)).mean(axis=1))
    length = np.linalg.norm(off_circle, axis=1)
    enter(residuals, reflectors.row, length, 2.0 / 3.0 * (1.0 - leverage), test)
    axis = axes[0, 2]
    outcome = Outcome(
        deviations=prepared.joining @ readings,
        covariance=gain @ covariance[: 2 * m, : 2 * m] @ gain.T,
        chi_square=chi_square,
        dof=dof,
        details={"axis": axis, "radii_m": [float(r) for r in dict.fromkeys(radii)]},
    )
    return _with_nests(prepared, outcome, nests)


def _from_readings(
    prepared: Prepared,
    normals: Normals,
    readings: Floats,
    response: Floats,
    covariance: Floats,
    axes: Floats,
    zero: Ints,
    placed: Floats | None = None,
) -> Outcome:
    """Deviations from readings; chi square of groups, cones and positions seen repeatedly."""
    pairs, angles = prepared.pairs, prepared.angles
    assert pairs is not None
    n = pairs.n_groups
    reading_covariance = response @ covariance @ response.T
    seen = normals.normal if placed is None else placed
    known = np.isin(zero, np.flatnonzero(np.bincount(zero) >= 3))
    cones = unc.cone_misfit(
        seen[known],
        axes[known],
        zero[known],
        angles[pairs.position[known]],
        covariance[n:, n:][np.ix_(known, known)],
    )
    design = np.zeros((n, len(angles) + zero.max() + 1))
    design[np.arange(n), pairs.position] = 1.0
    design[np.arange(n), len(angles) + zero] = 1.0
    overlaps = unc.misfit(readings, design, reading_covariance)
    groups = _groups_fit(prepared, normals)
    gain = prepared.joining
    return Outcome(
        deviations=gain @ readings,
        covariance=gain @ reading_covariance @ gain.T,
        chi_square=groups[0] + cones[0] + overlaps[0],
        dof=groups[1] + cones[1] + overlaps[1],
        details={},
    )


def _off_circle(prepared: Prepared, placed: Floats, axes: Floats, radii: Floats) -> Floats:
    """Radial and axial distance (M, 2) of each point from its reflector's circle, metres."""
    reflectors = prepared.reflectors
    assert reflectors is not None
    off = np.zeros((len(placed), 2))
    for reflector in range(len(reflectors.name)):
        at = np.flatnonzero(reflectors.reflector == reflector)
        commanded = prepared.angles[reflectors.position[at]]
        _, centre, _ = fit_circle(placed[at], commanded)
        arms = placed[at] - centre
        off[at, 0] = np.einsum("mi,mi->m", arms, axes[at, 1]) - radii[at]
        off[at, 1] = np.einsum("mi,mi->m", arms, axes[at, 2])
    return off


def _pairs_fit(prepared: Prepared, residuals: Residuals) -> Normals:
    assert prepared.pairs is not None
    normals = fit_normals(prepared.problem.xyz, prepared.pairs, prepared.pair_weight)
    enter_pairs(residuals, prepared.problem, prepared.pairs, normals, prepared.pair_weight)
    return normals


def _nests_fit(prepared: Prepared, residuals: Residuals) -> NestFit | None:
    if not len(prepared.nests.row):
        return None
    fit = nest_fit(prepared.problem.xyz, prepared.nests, prepared.nest_weight, prepared.poses)
    enter_nests(residuals, prepared.nests, fit)
    return fit


def _groups_fit(prepared: Prepared, normals: Normals) -> tuple[float, int]:
    """Chi square and dof of the pairs about the plane of their group."""
    e, pairs = normals.misclosure, prepared.pairs
    assert pairs is not None
    chi_square = float(np.einsum("pi,pij,pj->", e, prepared.pair_weight, e))
    return chi_square, 3 * (len(pairs.direct) - pairs.n_groups)


def _pose_covariance(prepared: Prepared) -> Floats:
    if not len(prepared.nests.row):
        return np.zeros((0, 0))
    normal, _, _ = nest_equations(
        prepared.problem.xyz, prepared.nests, prepared.nest_weight, prepared.poses
    )
    return np.asarray(np.linalg.inv(normal), dtype=np.float64)


def _with_nests(
    prepared: Prepared, outcome: Outcome, fit: NestFit | None, count: bool = True
) -> Outcome:
    """Add the nests to the details and, unless the way has counted them, to chi square."""
    if fit is None:
        return outcome
    nests, problem = prepared.nests, prepared.problem
    placed = prepared.poses.placed(problem.xyz[nests.row], nests.station)
    outcome.details["nests"] = [
        {
            "nest": nests.name[nests.point[q]],
            "station": problem.station_name(int(nests.station[q])),
            "position_m": placed[q],
            "residual_m": fit.residual[q],
            "test_value": fit.test_value[q],
        }
        for q in range(len(nests.row))
    ]
    if not count:
        return outcome
    return Outcome(
        outcome.deviations,
        outcome.covariance,
        outcome.chi_square + fit.chi_square,
        outcome.dof + fit.dof,
        outcome.details,
    )


def _with_crosstalk(prepared: Prepared, outcome: Outcome, height: float) -> Outcome:
    extra = unc.tilt_crosstalk(prepared.problem, height, len(prepared.angles))
    return Outcome(
        outcome.deviations,
        outcome.covariance + extra,
        outcome.chi_square,
        outcome.dof,
        outcome.details,
    )
