"""The four ways: what each makes of a problem that is screened and laid out.

Every way takes the same steps: it frees points of the drift, brings the stations together, fits
what is measured (normals of the mirror, or circles), makes readings of angles of it, and joins
these to deviations. What depends only on the layout and on the noise is prepared once, for one
solution or for thousands of trials: estimates take points (..., n, 3) with any leading axes.

One solution has a curve with its covariance, the noise carried along in closed form. Its chi
square is the sum over all that is fitted apart from each other: pairs about the plane of their
group, normals about their cone, readings about the deviations, nests. The joint way has one least
squares instead. Residuals of single points are entered on the way.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.results import Residuals
from rotcal_ros.methods.plane_mirror.settings import STITCHING
from rotcal_ros.methods.plane_mirror.solver import joint
from rotcal_ros.methods.plane_mirror.solver.drift import NestDrift
from rotcal_ros.methods.plane_mirror.solver.normals import (
    Normals,
    angle_deviation,
    circle_design,
    condition_jacobian,
    fit_normals,
    reflection,
    tangent_basis,
)
from rotcal_ros.methods.plane_mirror.solver.problem import (
    MirrorPairs,
    Nests,
    PlaneMirrorProblem,
    Reflectors,
    Sets,
)
from rotcal_ros.methods.plane_mirror.solver.readings import (
    cone_readings,
    cone_response,
    cones,
    direct_readings,
    direct_response,
    from_first,
    local_axes,
    normal_covariance,
    point_covariance,
    reading_design,
    tilt_crosstalk,
)
from rotcal_ros.methods.plane_mirror.solver.registration import (
    NestFit,
    Poses,
    adjust_stations,
    nest_equations,
    nest_fit,
)

_DRIFT_STEP: Final = 1e-6
"""Turn (rad), shift and range (m) that the response to a drift is found with."""
_TRIAL_STEPS: Final = 2  # Gauss-Newton from the nominal solution: noise squared, then rounding
_CERTAIN: Final = 1e-300
"""Smallest variance (m^2) that is divided by: exact points leave rounding over nothing."""


@dataclass(frozen=True)
class WayFit:
    """Chi square and degrees of freedom of what was fitted, and plain values for the result."""

    chi_square: float = 0.0
    dof: int = 0
    details: Mapping[str, Any] = field(default_factory=dict)

    def __add__(self, other: WayFit) -> WayFit:
        """Return both together, which are fitted apart from each other."""
        return WayFit(
            self.chi_square + other.chi_square,
            self.dof + other.dof,
            {**self.details, **other.details},
        )


@dataclass(frozen=True)
class AdjustedCurve:
    """Deviations (N,) in rad from the first position, covariance (N, N), and how all fits."""

    deviations: Floats
    covariance: Floats
    fit: WayFit


@dataclass(frozen=True, eq=False)
class Prepared(ABC):
    """A screened problem with all that does not change from trial to trial.

    ``problem`` has its points without the ``drift`` of the tracker. ``angles`` (N,) are those of
    the ``positions`` (N,) that were measured; those of pairs and reflectors count in them.
    ``poses`` are the nominal stations, or all at the origin where no nests bring them together.
    ``sets`` says which readings count about one axis, ``joining`` (N, readings) makes deviations
    of them.
    """

    problem: PlaneMirrorProblem
    drift: NestDrift
    positions: Ints
    angles: Floats
    nests: Nests
    poses: Poses
    sets: Sets
    joining: Floats

    @property
    def nest_weight(self) -> Floats:
        """Inverse covariances (Q, 3, 3) of the nests, along the axes of each station."""
        return self.problem.noise.weight(self.problem.xyz[self.nests.row])

    def estimate(self, points: Floats) -> Floats:
        """Return deviations (..., N) in rad, from the first position, of points (..., n, 3).

        The drift of each trial is estimated from its own points.
        """
        return self.deviations(self.drift.corrected(points))

    def deviations(self, points: Floats) -> Floats:
        """Return the deviations (..., N) of points (..., n, 3) that have no drift."""
        return np.asarray(self.readings(points) @ self.joining.T, dtype=np.float64)

    @abstractmethod
    def readings(self, points: Floats) -> Floats:
        """Return the readings of angles (..., m) that points (..., n, 3) make, see ``sets``."""

    @abstractmethod
    def curve(self, residuals: Residuals) -> AdjustedCurve:
        """Return the curve with its covariance and fit; enters the residuals of single points."""

    def drift_response(self) -> Floats:
        """Return the derivative (N, size) of the deviations by the changes that the drift made.

        By central differences of the estimate itself, so that it is the same for every way; a
        step moves points by micrometres, where the estimate is linear to 1e-6.
        """
        if not self.drift.size:
            return np.zeros((len(self.angles), 0))
        steps = _DRIFT_STEP * np.eye(self.drift.size)
        moved = self.drift.displacement(self.problem.xyz, np.concatenate([steps, -steps]))
        ahead, behind = np.split(self.deviations(self.problem.xyz - moved), 2)
        return np.asarray((ahead - behind).T / (2.0 * _DRIFT_STEP), dtype=np.float64)

    def stations_of(self, points: Floats) -> Poses:
        """Return the adjusted stations for points (..., n, 3)."""
        if not len(self.nests.row):
            return self.poses
        return adjust_stations(points, self.nests, self.nest_weight, self.poses, _TRIAL_STEPS)


@dataclass(frozen=True, eq=False)
class PreparedPoints(Prepared):
    """The way "direct": reflectors that the table carries."""

    reflectors: Reflectors

    def readings(self, points: Floats) -> Floats:
        """Return the readings about the circles of the reflectors."""
        own = points[..., self.reflectors.row, :]
        return direct_readings(
            self.stations_of(points).placed(own, self.reflectors.station), self.sets
        )

    def curve(self, residuals: Residuals) -> AdjustedCurve:
        """Return the curve of the readings about the circles, joined."""
        reflectors, sets, problem = self.reflectors, self.sets, self.problem
        nests = _nests(self, residuals)
        placed = self.poses.placed(problem.xyz[reflectors.row], reflectors.station)
        axes, radii, off_circle = local_axes(placed, sets)
        covariance = point_covariance(
            problem, reflectors, self.poses, axes, _pose_covariance(self)
        )
        m = len(radii)
        circles = _circles(self, residuals, off_circle, covariance[m:, m:])
        gain = self.joining @ direct_response(sets, radii)
        details = {"axis": axes[0, 2], "radii_m": [float(r) for r in dict.fromkeys(radii)]}
        return AdjustedCurve(
            deviations=self.joining @ direct_readings(placed, sets),
            covariance=gain @ covariance[: 2 * m, : 2 * m] @ gain.T,
            fit=WayFit(details=details) + circles + nests,
        )


@dataclass(frozen=True, eq=False)
class PreparedNormals(Prepared):
    """The ways "stitching" and "registration": a mirror, seen in pairs of points.

    Stitching has a set of normals for each station, registration one of all.
    """

    pairs: MirrorPairs
    pair_weight: Floats

    def normals(self, points: Floats) -> Normals:
        """Return the mirror's planes that points (..., n, 3) show."""
        return fit_normals(points, self.pairs, self.pair_weight)

    def readings(self, points: Floats) -> Floats:
        """Return the readings about the cones of the normals."""
        normal, station = self.normals(points).normal, self.pairs.station
        return cone_readings(self.stations_of(points).turned(normal, station), self.sets)

    def curve(self, residuals: Residuals) -> AdjustedCurve:
        """Return the curve of the readings about the cones, joined."""
        problem, pairs, sets = self.problem, self.pairs, self.sets
        n, gain, poses = len(self.angles), self.joining, self.poses
        normals, groups = _groups(self, residuals)
        nests = _nests(self, residuals)
        placed = poses.turned(normals.normal, pairs.station)
        axes, height = cones(placed, sets)
        lean = float(height)
        covariance = normal_covariance(
            normals, pairs, poses, axes, _pose_covariance(self), problem.tilt_std
        )
        readings, response = cone_readings(placed, sets), cone_response(sets, lean)
        reading_covariance = response @ covariance @ response.T
        about_cones = _about_cones(placed, axes, sets, covariance[len(placed) :, len(placed) :])
        design = reading_design(pairs.position, sets.number, n)
        overlaps = _misfit(readings, design, reading_covariance)
        details: dict[str, Any] = {} if problem.way == STITCHING else {"axis": axes[0]}
        details["lean_rad"] = float(np.arcsin(height))
        return AdjustedCurve(
            deviations=gain @ readings,
            covariance=gain @ reading_covariance @ gain.T + tilt_crosstalk(problem, lean, n),
            fit=WayFit(details=details) + groups + about_cones + overlaps + nests,
        )

    @property
    def adjusted_together(self) -> joint.Together:
        """What the way "joint" adjusts together."""
        return joint.Together(self.pairs, self.nests, self.nest_weight, self.problem.tilt_std)


@dataclass(frozen=True, eq=False)
class PreparedJoint(PreparedNormals):
    """The way "joint", with its nominal solution ``mirror``."""

    mirror: joint.Mirror

    def deviations(self, points: Floats) -> Floats:
        """Return the deviations by the least squares of everything at once."""
        mirror = joint.adjust_joint(
            points, self.normals(points), self.adjusted_together, self.mirror, _TRIAL_STEPS
        )
        return angle_deviation(mirror.psi, self.angles)

    def curve(self, residuals: Residuals) -> AdjustedCurve:
        """Return the curve of the least squares, in whose chi square the nests are."""
        problem, pairs, mirror = self.problem, self.pairs, self.mirror
        normals, groups = _groups(self, residuals)
        nests = _nests(self, residuals)
        equations = joint.joint_equations(problem.xyz, normals, self.adjusted_together, mirror)
        n, taken = len(self.angles), self.drift.size if len(self.nests.row) else 0
        contrast = from_first(n)
        covariance = contrast @ joint.angle_covariance(equations) @ contrast.T
        # Three equations of each pair and each reading of a nest, less three for the place of a
        # nest, and less three for psi, eps and d of a position, of which eps is observed itself.
        n_known = len(pairs.direct) + len(self.nests.row) - self.nests.n_points
        fit = WayFit(
            chi_square=float(equations.chi_square) + groups.chi_square,
            dof=3 * n_known - equations.shared.shape[0] - 2 * n - taken,
            details={
                "axis": mirror.frame[:, 2],
                "lean_rad": float(mirror.beta),
                "tilts_rad": mirror.eps,
                **nests.details,
            },
        )
        return AdjustedCurve(
            deviations=angle_deviation(mirror.psi, self.angles),
            covariance=covariance + tilt_crosstalk(problem, float(np.sin(mirror.beta)), n),
            fit=fit,
        )


PreparedWay = PreparedPoints | PreparedNormals
"""A prepared problem of any way; that of "joint" is one of normals."""


def _circles(
    prepared: PreparedPoints, residuals: Residuals, off_circle: Floats, covariance: Floats
) -> WayFit:
    """Fit of the points about their circles, radially and axially; enters the residuals.

    ``covariance`` (2 M, 2 M): of all radial, then all axial movements, m^2.
    """
    m, sets = len(off_circle), prepared.sets
    design = circle_design(sets.commanded, sets.number)
    both = np.asarray(np.kron(np.eye(2), design), dtype=np.float64)
    leverage: Floats = np.einsum("ij,ji->i", design, np.linalg.pinv(design))
    spread = np.diag(covariance).reshape(2, m).T * (1.0 - leverage)[:, None]
    test = np.sqrt((off_circle**2 / np.maximum(spread, _CERTAIN)).mean(axis=1))
    length = np.linalg.norm(off_circle, axis=1)
    # Two of a point's three coordinates are checked by its circle; the third is the angle.
    rows = prepared.reflectors.row
    _enter(residuals, rows, length, 2.0 / 3.0 * (1.0 - leverage), test)
    return _misfit(off_circle.T.ravel(), both, covariance)


def _groups(prepared: PreparedNormals, residuals: Residuals) -> tuple[Normals, WayFit]:
    """Return the normals, and the fit of the pairs about the plane of their group."""
    pairs, weight = prepared.pairs, prepared.pair_weight
    normals = prepared.normals(prepared.problem.xyz)
    _enter_pairs(residuals, prepared, normals)
    e = normals.misclosure
    chi_square = float(np.einsum("pi,pij,pj->", e, weight, e))
    return normals, WayFit(chi_square, 3 * (len(pairs.direct) - pairs.n_groups))


def _nests(prepared: Prepared, residuals: Residuals) -> WayFit:
    """Return the fit of the fixed nests, if there are any; enters the residuals."""
    nests, problem = prepared.nests, prepared.problem
    if not len(nests.row):
        return WayFit()
    taken = prepared.drift.size
    fit = nest_fit(problem.xyz, nests, prepared.nest_weight, prepared.poses, taken)
    length = np.linalg.norm(fit.residual, axis=1)
    _enter(residuals, nests.row, length, fit.redundancy, fit.test_value)
    return WayFit(fit.chi_square, fit.dof, {"nests": _nest_entries(prepared, fit)})


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
    """Return the covariance (p, p) of the stations; zero where no nests bring them together."""
    if not len(prepared.nests.row):
        return np.zeros((6 * (len(prepared.poses.rotation) - 1),) * 2)
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
    """Write direct and mirrored rows: distance of each from where its group's plane puts it.

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


def _about_cones(normals: Floats, axes: Floats, sets: Sets, covariance: Floats) -> WayFit:
    """Return the fit of normals (G, 3) about their cones; ``covariance`` (G, G): of all eta."""
    # Fewer than three normals have no plane of their own that they could leave.
    known = np.isin(sets.number, np.flatnonzero(np.bincount(sets.number) >= 3))
    values = np.einsum("gi,gi->g", normals[known], axes[known])
    values = values / np.sqrt(1.0 - values.mean() ** 2)  # of a.n, as an angle: over cos(beta)
    design = circle_design(sets.commanded[known], sets.number[known])
    return _misfit(values, design, covariance[np.ix_(known, known)])


def _misfit(values: Floats, design: Floats, covariance: Floats) -> WayFit:
    """Return the fit of ``values`` (m,).

    ``design`` (m, k) spans what the unweighted fit takes away, ``covariance`` (m, m) is that of
    the values before. The statistic weighs the remainder by its own covariance, so that it is
    chi-square distributed although the fit is not weighted.
    """
    basis, size, _ = np.linalg.svd(design, full_matrices=True)
    rank = int((size > 1e-9 * size.max()).sum())
    rest = basis[:, rank:]  # combinations of the values that the fit leaves alone
    if rest.shape[1] == 0:
        return WayFit()
    part = rest.T @ values
    chi_square = part @ np.linalg.solve(rest.T @ covariance @ rest, part)
    return WayFit(float(chi_square), rest.shape[1])
