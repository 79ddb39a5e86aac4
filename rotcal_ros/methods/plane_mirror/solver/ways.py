"""What each of the four ways makes of a screened problem: deviations, covariance, fit.

Every way takes the same steps: fit what is measured (normals of the mirror, or circles), turn it
into readings of angles, join these to deviations, and carry the noise along in closed form. The
chi square is the sum over all that is fitted apart from each other: pairs about the plane of their
group, normals about their cone, readings about the deviations, nests. The joint way has one least
squares instead. Residuals of single points are entered on the way.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.results import Residuals
from rotcal_ros.methods.plane_mirror.solver import joint
from rotcal_ros.methods.plane_mirror.solver.normals import (
    Normals,
    angle_deviation,
    circle_design,
    condition_jacobian,
    fit_cone,
    reflection,
    tangent_basis,
)
from rotcal_ros.methods.plane_mirror.solver.prepare import (
    Prepared,
    PreparedJoint,
    PreparedNormals,
    PreparedPoints,
    PreparedWay,
)
from rotcal_ros.methods.plane_mirror.solver.problem import PlaneMirrorProblem
from rotcal_ros.methods.plane_mirror.solver.readings import (
    direct_readings,
    direct_response,
    from_first,
    local_axes,
    normal_covariance,
    point_covariance,
    reading_design,
    registered_readings,
    registered_response,
    station_cones,
    stitch,
    stitch_response,
    stitched_covariance,
    tilt_crosstalk,
)
from rotcal_ros.methods.plane_mirror.solver.registration import NestFit, nest_equations, nest_fit
from rotcal_ros.methods.plane_mirror.solver_settings import STITCHING

_CERTAIN: Final = 1e-300
"""Smallest variance (m^2) that is divided by: exact points leave rounding over nothing."""


@dataclass(frozen=True)
class AdjustedCurve:
    """Deviations (N,) in rad from the first position, covariance (N, N), chi square and dof.

    ``details`` are plain values for the result.
    """

    deviations: Floats
    covariance: Floats
    chi_square: float
    dof: int
    details: Mapping[str, Any]


@dataclass(frozen=True)
class _Fit:
    """Chi square and degrees of freedom of what was fitted, and plain values for the result."""

    chi_square: float = 0.0
    dof: int = 0
    details: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class _Cones:
    """Normals (G, 3) and the axes (G, 3) of their cones; those of one ``zero`` (G,) share one.

    ``covariance`` (2 G, 2 G): of all tau, then all eta. ``height``: of the cones, their sine.
    """

    normals: Floats
    axes: Floats
    zero: Ints
    covariance: Floats
    height: float


def empty_residuals(problem: PlaneMirrorProblem) -> Residuals:
    """Return residuals in which no row is used yet (all zero)."""
    n = len(problem.xyz)
    return Residuals(
        table_position=problem.position.copy(),
        target=problem.nest.copy(),
        residual=np.zeros(n),
        redundancy=np.zeros(n),
        test_value=np.zeros(n),
        used=np.zeros(n, dtype=np.bool_),
        std=np.sqrt(np.trace(problem.noise.covariance(problem.xyz), axis1=1, axis2=2) / 3.0),
        coordinates=3,
    )


def adjusted_curve(prepared: PreparedWay, residuals: Residuals) -> AdjustedCurve:
    """Return the curve of the way that ``prepared`` belongs to; enters the residuals."""
    if isinstance(prepared, PreparedPoints):
        return _direct(prepared, residuals)
    if isinstance(prepared, PreparedJoint):
        return _joined(prepared, residuals)
    if prepared.problem.way == STITCHING:
        return _stitched(prepared, residuals)
    return _registered(prepared, residuals)


def _stitched(prepared: PreparedNormals, residuals: Residuals) -> AdjustedCurve:
    """Stitching: a plane per station, zeros tied by shared positions."""
    pairs, angles = prepared.pairs, prepared.angles
    normals, groups = _groups(prepared, residuals)
    axes, height = station_cones(normals.normal, pairs, angles)
    covariance = stitched_covariance(normals, pairs, axes, prepared.problem.tilt_std)
    _, zero = np.unique(pairs.station, return_inverse=True)
    cones = _Cones(normals.normal, axes, zero, covariance, float(height))
    readings = stitch(normals.normal, pairs, angles)
    response = stitch_response(normals.normal, pairs, angles)
    details = {"lean_rad": float(np.arcsin(height))}
    return _of_readings(prepared, readings, response, cones, groups, _Fit(details=details))


def _registered(prepared: PreparedNormals, residuals: Residuals) -> AdjustedCurve:
    """Registration: one plane for all normals in the frame of the first station."""
    pairs, angles, poses = prepared.pairs, prepared.angles, prepared.poses
    normals, groups = _groups(prepared, residuals)
    nests = _nests(prepared, residuals)
    placed = poses.turned(normals.normal, pairs.station)
    axis, height = fit_cone(placed, angles[pairs.position])
    covariance = normal_covariance(
        normals, pairs, poses, axis, _pose_covariance(prepared), prepared.problem.tilt_std
    )
    axes, zero = np.broadcast_to(axis, placed.shape), np.zeros_like(pairs.station)
    cones = _Cones(placed, axes, zero, covariance, float(height))
    readings = registered_readings(placed, pairs, angles)
    response = registered_response(pairs, angles, float(height))
    details = {"axis": axis, "lean_rad": float(np.arcsin(height)), **nests.details}
    rest = _Fit(nests.chi_square, nests.dof, details)
    return _of_readings(prepared, readings, response, cones, groups, rest)


def _joined(prepared: PreparedJoint, residuals: Residuals) -> AdjustedCurve:
    """Joint: the least squares of everything at once; the nests are in its chi square."""
    problem, pairs, mirror = prepared.problem, prepared.pairs, prepared.mirror
    normals, groups = _groups(prepared, residuals)
    nests = _nests(prepared, residuals)
    equations = joint.joint_equations(problem.xyz, normals, prepared.adjusted_together, mirror)
    n, taken = len(prepared.angles), prepared.drift.size if len(prepared.nests.row) else 0
    contrast = from_first(n)
    covariance = contrast @ joint.angle_covariance(equations) @ contrast.T
    # Three equations of each pair and each reading of a nest, less three for the place of a nest,
    # and less three for psi, eps and d of a position, of which eps is observed itself.
    n_known = len(pairs.direct) + len(prepared.nests.row) - prepared.nests.n_points
    return AdjustedCurve(
        deviations=angle_deviation(mirror.psi, prepared.angles),
        covariance=covariance + tilt_crosstalk(problem, float(np.sin(mirror.beta)), n),
        chi_square=float(equations.chi_square) + groups.chi_square,
        dof=3 * n_known - equations.shared.shape[0] - 2 * n - taken,
        details={
            "axis": mirror.frame[:, 2],
            "lean_rad": float(mirror.beta),
            "tilts_rad": mirror.eps,
            **nests.details,
        },
    )


def _direct(prepared: PreparedPoints, residuals: Residuals) -> AdjustedCurve:
    """Direct: plane and circle through the places of reflectors on the table."""
    reflectors, angles, problem = prepared.reflectors, prepared.angles, prepared.problem
    nests = _nests(prepared, residuals)
    placed = prepared.poses.placed(problem.xyz[reflectors.row], reflectors.station)
    axes, radii, off_circle = local_axes(placed, reflectors, angles)
    covariance = point_covariance(
        problem, reflectors, prepared.poses, axes, _pose_covariance(prepared)
    )
    m = len(radii)
    circles = _circles(prepared, residuals, off_circle, covariance[m:, m:])
    gain = prepared.joining @ direct_response(reflectors, angles, radii)
    return AdjustedCurve(
        deviations=prepared.joining @ direct_readings(placed, reflectors, angles),
        covariance=gain @ covariance[: 2 * m, : 2 * m] @ gain.T,
        chi_square=circles.chi_square + nests.chi_square,
        dof=circles.dof + nests.dof,
        details={
            "axis": axes[0, 2],
            "radii_m": [float(r) for r in dict.fromkeys(radii)],
            **nests.details,
        },
    )


def _of_readings(
    prepared: PreparedNormals,
    readings: Floats,
    response: Floats,
    cones: _Cones,
    groups: _Fit,
    rest: _Fit,
) -> AdjustedCurve:
    """Join readings; chi square of groups, cones, positions seen repeatedly, and the rest."""
    pairs, angles = prepared.pairs, prepared.angles
    n, zero = pairs.n_groups, cones.zero
    reading_covariance = response @ cones.covariance @ response.T
    # Fewer than three normals have no plane of their own that they could leave.
    known = np.isin(zero, np.flatnonzero(np.bincount(zero) >= 3))
    about_cones = _cone_misfit(
        cones.normals[known],
        cones.axes[known],
        zero[known],
        angles[pairs.position[known]],
        cones.covariance[n:, n:][np.ix_(known, known)],
    )
    design = reading_design(pairs.position, zero, len(angles))
    overlaps = _misfit(readings, design, reading_covariance)
    gain = prepared.joining
    crosstalk = tilt_crosstalk(prepared.problem, cones.height, len(angles))
    return AdjustedCurve(
        deviations=gain @ readings,
        covariance=gain @ reading_covariance @ gain.T + crosstalk,
        chi_square=groups.chi_square + about_cones[0] + overlaps[0] + rest.chi_square,
        dof=groups.dof + about_cones[1] + overlaps[1] + rest.dof,
        details=rest.details,
    )


def _circles(
    prepared: PreparedPoints, residuals: Residuals, off_circle: Floats, covariance: Floats
) -> _Fit:
    """Fit of the points about their circles, radially and axially; enters the residuals.

    ``covariance`` (2 M, 2 M): of all radial, then all axial movements, m^2.
    """
    m, reflectors = len(off_circle), prepared.reflectors
    design = circle_design(prepared.angles[reflectors.position], reflectors.reflector)
    both = np.asarray(np.kron(np.eye(2), design), dtype=np.float64)
    chi_square, dof = _misfit(off_circle.T.ravel(), both, covariance)
    leverage: Floats = np.einsum("ij,ji->i", design, np.linalg.pinv(design))
    spread = np.diag(covariance).reshape(2, m).T * (1.0 - leverage)[:, None]
    test = np.sqrt((off_circle**2 / np.maximum(spread, _CERTAIN)).mean(axis=1))
    length = np.linalg.norm(off_circle, axis=1)
    # Two of a point's three coordinates are checked by its circle; the third is the angle.
    _enter(residuals, reflectors.row, length, 2.0 / 3.0 * (1.0 - leverage), test)
    return _Fit(chi_square, dof)


def _groups(prepared: PreparedNormals, residuals: Residuals) -> tuple[Normals, _Fit]:
    """Return the normals, and the fit of the pairs about the plane of their group."""
    pairs, weight = prepared.pairs, prepared.pair_weight
    normals = prepared.normals(prepared.problem.xyz)
    _enter_pairs(residuals, prepared, normals)
    e = normals.misclosure
    chi_square = float(np.einsum("pi,pij,pj->", e, weight, e))
    return normals, _Fit(chi_square, 3 * (len(pairs.direct) - pairs.n_groups))


def _nests(prepared: Prepared, residuals: Residuals) -> _Fit:
    """Return the fit of the fixed nests, if there are any; enters the residuals."""
    nests, problem = prepared.nests, prepared.problem
    if not len(nests.row):
        return _Fit()
    taken = prepared.drift.size
    fit = nest_fit(problem.xyz, nests, prepared.nest_weight, prepared.poses, taken)
    length = np.linalg.norm(fit.residual, axis=1)
    _enter(residuals, nests.row, length, fit.redundancy, fit.test_value)
    return _Fit(fit.chi_square, fit.dof, {"nests": _nest_entries(prepared, fit)})


def _nest_entries(prepared: Prepared, fit: NestFit) -> list[dict[str, Any]]:
    """Return each reading of a nest for the details of a result."""
    nests, problem = prepared.nests, prepared.problem
    placed = prepared.poses.placed(problem.xyz[nests.row], nests.station)
    return [
        {
            "nest": nests.name[nests.point[q]],
            "station": problem.station_name(int(nests.station[q])),
            "position_m": placed[q],
            "residual_m": fit.residual[q],
            "test_value": fit.test_value[q],
        }
        for q in range(len(nests.row))
    ]


def _pose_covariance(prepared: Prepared) -> Floats:
    """Return the covariance (p, p) of the registered stations; (0, 0) where there are none."""
    if not len(prepared.nests.row):
        return np.zeros((0, 0))
    normal, _, _ = nest_equations(
        prepared.problem.xyz, prepared.nests, prepared.nest_weight, prepared.poses
    )
    return np.asarray(np.linalg.inv(normal), dtype=np.float64)


def _enter(residuals: Residuals, rows: Ints, length: Floats, share: Floats, test: Floats) -> None:
    """Write the residual lengths (m), redundancies and test values of ``rows`` as used."""
    residuals.residual[rows] = length
    residuals.redundancy[rows] = np.clip(share, 0.0, 1.0)
    residuals.test_value[rows] = test
    residuals.used[rows] = True


def _enter_pairs(residuals: Residuals, prepared: PreparedNormals, normals: Normals) -> None:
    """Write direct and mirrored rows: distance of each from where its group's plane wants it.

    A single pair fits its plane exactly; it is checked by the cone and the overlaps alone and has
    redundancy 0 here.
    """
    problem, pairs, weight = prepared.problem, prepared.pairs, prepared.pair_weight
    jacobian = condition_jacobian(problem.xyz[pairs.direct], normals.normal, normals.offset, pairs)
    basis = tangent_basis(normals.normal)[pairs.group]
    reduced = jacobian @ basis
    information = np.swapaxes(basis, 1, 2) @ normals.information[pairs.group] @ basis
    cofactor = np.linalg.inv(weight) - reduced @ np.linalg.solve(
        information, np.swapaxes(reduced, 1, 2)
    )
    pull = (weight @ normals.misclosure[..., None])[..., 0]
    share = np.trace(weight @ cofactor, axis1=1, axis2=2)
    square = np.einsum("pi,pi->p", normals.misclosure, pull)
    test = np.sqrt(square / np.where(share > 1e-6, share, np.inf))
    # The condition feels an error of a direct point reflected, that of a mirrored point as it is.
    turned = reflection(normals.normal[pairs.group])
    for rows, factor in ((pairs.direct, turned), (pairs.mirrored, np.eye(3))):
        covariance = problem.noise.covariance(problem.xyz[rows])
        spread = covariance @ factor @ weight
        length = np.linalg.norm(np.einsum("pij,pj->pi", covariance @ factor, pull), axis=1)
        own = np.trace(spread @ cofactor @ weight @ factor, axis1=1, axis2=2) / 3.0
        _enter(residuals, rows, length, own, test)


def _cone_misfit(
    normals: Floats, axes: Floats, zero: Ints, azimuth: Floats, covariance: Floats
) -> tuple[float, int]:
    """Return chi square and dof of the normals (G, 3) about their cones, one per set ``zero``."""
    values = np.einsum("gi,gi->g", normals, axes)
    values = values / np.sqrt(1.0 - values.mean() ** 2)  # of a.n, as an angle: over cos(beta)
    return _misfit(values, circle_design(azimuth, zero), covariance)


def _misfit(values: Floats, design: Floats, covariance: Floats) -> tuple[float, int]:
    """Return the chi square and its degrees of freedom of ``values`` (m,) about a fit.

    ``design`` (m, k) spans what the unweighted fit takes away, ``covariance`` (m, m) is that of
    the values before. The statistic weighs the remainder by its own covariance, so that it is
    chi-square distributed although the fit is not weighted.
    """
    basis, size, _ = np.linalg.svd(design, full_matrices=True)
    rank = int((size > 1e-9 * size.max()).sum())
    rest = basis[:, rank:]  # combinations of the values that the fit leaves alone
    if rest.shape[1] == 0:
        return 0.0, 0
    part = rest.T @ values
    chi_square = part @ np.linalg.solve(rest.T @ covariance @ rest, part)
    return float(chi_square), rest.shape[1]
