"""The linear view of a mirror's points at a solution: what the engine of adjustment asks for.

Whatever way the deviations are found, the points are held against one model, that of
:mod:`~rotcal_ros.methods.plane_mirror.solver.joint` with the drift of the tracker among its
unknowns (stitching: without what ties its stations but shared positions). A pair of points is one
element: its condition e = M' - M + 2 (n.M - h) n feels an error of the mirrored point as it is,
and one of the direct point reflected, so that the two kinds cannot be told apart. A reading of a
nest is another. Each has three axes: along the beam, level across it, and upwards; whitened by the
symmetric root of its weight.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from rotcal_ros.adjust.explanations import Hypotheses
from rotcal_ros.adjust.groups import SolutionView
from rotcal_ros.adjust.sensitivity import Sensitivity
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.methods.plane_mirror.solver import joint
from rotcal_ros.methods.plane_mirror.solver.direct import (
    direct_readings,
    direct_response,
    local_axes,
)
from rotcal_ros.methods.plane_mirror.solver.drift import movement
from rotcal_ros.methods.plane_mirror.solver.layout import Nests
from rotcal_ros.methods.plane_mirror.solver.normals import (
    Normals,
    condition_jacobian,
    tangent_frame,
)
from rotcal_ros.methods.plane_mirror.solver.prepare import (
    Prepared,
    PreparedJoint,
    PreparedNormals,
    PreparedPoints,
    PreparedWay,
)
from rotcal_ros.methods.plane_mirror.solver.registration import (
    Poses,
    nest_equations,
    pose_jacobian,
)
from rotcal_ros.methods.plane_mirror.solver.stitching import station_cones
from rotcal_ros.methods.plane_mirror.solver_settings import STITCHING

CIRCLE: Final = 7
"""Unknowns of the circle of a reflector on the table: centre, three turns, radius."""
STEP: Final = 0.1
"""Standard deviations by which nests are moved to see what their errors do."""
OPEN: Final = 1e-10
"""Relative eigenvalue of the scaled normal equations below which nothing tells a direction."""


@dataclass(frozen=True, eq=False)
class Elements:
    """What may be wrong as a whole: m pairs, then readings of nests.

    ``row`` (m,): of the mirrored point or the nest in the problem. ``pairs``: how many are pairs.
    ``station``, ``position`` (-1: a nest), ``nest`` (m,), ``moment`` (m,), ``beam`` (m, 3): unit
    vectors along the axes of the station. ``direct`` (P,): rows of the direct points of pairs,
    ``reflection`` (P, 3, 3): what their errors are multiplied by in the conditions, turned round.
    """

    row: Ints
    pairs: int
    direct: Ints
    reflection: Floats
    station: Ints
    position: Ints
    nest: Ints
    moment: Floats
    beam: Floats

    def carried(self, moved: Floats) -> Floats:
        """Return by how much errors of all points (n, 3, k) change the misclosures, (m, 3, k)."""
        found = moved[self.row]
        found[: self.pairs] -= self.reflection @ moved[self.direct]
        return found


@dataclass(frozen=True, eq=False)
class Linear:
    """Whitened design (m, 3, p) and misclosure (m, 3) of all ``elements``, and what else is known.

    ``unit`` (m, 3): whitened units per m. ``root`` (m, 3, 3): makes errors along the axes of the
    station (m) whitened ones. ``outputs`` (N, p): the deviations, from the first. ``prior``
    (N, p), ``prior_misclosure`` (N,): of the tilts. ``sensitivity`` (N, m, 3): by how much the
    deviations are off per whitened unit, where that is not as of the least squares of all of it.
    """

    elements: Elements
    design: Floats
    misclosure: Floats
    unit: Floats
    root: Floats
    outputs: Floats
    prior: Floats
    prior_misclosure: Floats
    sensitivity: Floats | None = None

    @cached_property
    def view(self) -> SolutionView:
        """The view by the covariance of the unknowns; what nothing tells stays as it is."""
        return SolutionView(self._inverse[0], self.outputs)

    @property
    def dof(self) -> int:
        """Degrees of freedom of all residuals."""
        return self.misclosure.size + len(self.prior) - self._inverse[1]

    @cached_property
    def residual(self) -> Floats:
        """Whitened residuals (m, 3) of the least squares."""
        return np.asarray(self.misclosure - self.design @ self._solution)

    @cached_property
    def chi_square(self) -> float:
        """Sum of squares of all residuals, those of the tilts too."""
        tilts = self.prior_misclosure - self.prior @ self._solution
        return float((self.residual**2).sum() + (tilts**2).sum())

    def response(self, errors: Floats) -> Floats:
        """Return what errors of all points (n, 3, k) do to the deviations, (N, k)."""
        return np.asarray(self.outputs @ self._solved(self._white(errors)))

    def effect(self, errors: Floats) -> Hypotheses:
        """Return errors of all points (n, 3, k), each times a number of std 1, as an explanation.

        All of them together, along the axes that the residuals tell apart.
        """
        white = self._white(errors)
        solved = self._solved(white)
        weight = white.T @ (white - self.design.reshape(len(white), -1) @ solved)
        values, vectors = np.linalg.eigh(0.5 * (weight + weight.T))
        along = (white.T @ self.residual.ravel()) @ vectors
        sensitivity = Sensitivity.whole(np.asarray(self.outputs @ solved))
        return Hypotheses(
            np.maximum(values, 0.0)[None], along[None], lambda: vectors[:, None], sensitivity
        )

    def _white(self, errors: Floats) -> Floats:
        """Return errors of all points (n, 3, k) as whitened ones of the misclosures (3 m, k)."""
        carried = self.root @ self.elements.carried(errors)
        return carried.reshape(self.misclosure.size, errors.shape[2])

    def _solved(self, white: Floats) -> Floats:
        """Return what whitened misclosures (3 m, k) do to the unknowns (p, k)."""
        flat = self.design.reshape(len(white), -1)
        return np.asarray(self.view.covariance @ (flat.T @ white))

    @cached_property
    def _solution(self) -> Floats:
        flat = self.design.reshape(-1, self.design.shape[2])
        right = flat.T @ self.misclosure.ravel() + self.prior.T @ self.prior_misclosure
        return np.asarray(self.view.covariance @ right)

    @cached_property
    def _inverse(self) -> tuple[Floats, int]:
        """The pseudo-inverse (p, p) of the normal equations, and their rank."""
        flat = self.design.reshape(-1, self.design.shape[2])
        normal = flat.T @ flat + self.prior.T @ self.prior
        scale = np.sqrt(np.diag(normal))
        scale = np.where(scale > 0.0, scale, 1.0)
        values, vectors = np.linalg.eigh(normal / scale / scale[:, None])
        determined = values > OPEN * values[-1]
        kept = vectors[:, determined] / scale[:, None]
        return np.asarray((kept / values[determined]) @ kept.T), int(determined.sum())


def linear(prepared: PreparedWay, deviations: Floats) -> Linear:
    """Return the linear view at the ``deviations`` (N,), rad, from the first position."""
    if isinstance(prepared, PreparedPoints):
        return _of_reflectors(prepared, deviations)
    stitched = prepared.problem.way == STITCHING
    mirror = _mirror(prepared, deviations)
    normals = prepared.normals(prepared.problem.xyz)
    nests, alone = _nests(prepared)
    n, poses = len(prepared.angles), mirror.poses
    n_shared = 6 * (poses.rotation.shape[-3] - 1) + 3
    distances = prepared.pairs.n_groups if stitched else n
    first_nest = 2 * n + distances + n_shared
    first_drift = first_nest + 3 * nests.n_points
    size = first_drift + prepared.drift.size
    pairs = _pair_rows(prepared, normals, mirror, size, stitched)
    jacobian, discrepancy = _nest_rows(prepared, nests, poses, alone, (size, first_nest))
    design = np.concatenate([pairs[0], jacobian])
    misclosure = np.concatenate([pairs[1], discrepancy])
    elements = _elements(prepared, normals, nests)
    design[:, :, first_drift:] = -elements.carried(_drifted(prepared))
    root = _roots(prepared, prepared.pair_weight, elements)
    prior = np.zeros((n, size))
    prior[:, n : 2 * n] = np.eye(n) / prepared.problem.tilt_std
    outputs = np.zeros((n, size))
    outputs[:, :n] = np.eye(n)
    outputs[:, 0] -= 1.0
    return Linear(
        elements=elements,
        design=-root @ design,
        misclosure=np.einsum("mij,mj->mi", root, misclosure),
        unit=np.einsum("mii->mi", root @ np.swapaxes(_frames(elements.beam), 1, 2)).copy(),
        root=root,
        outputs=outputs,
        prior=prior,
        prior_misclosure=-mirror.eps / prepared.problem.tilt_std,
    )


def _of_reflectors(prepared: PreparedPoints, deviations: Floats) -> Linear:
    """Return the view of reflectors on the table, each with a circle of its own.

    Unknowns: the deviations; of each reflector centre, turns and radius of its circle; stations,
    three of a mirror that is not there, nests, drift. The way takes the mean of its readings,
    whatever their noise is along the circle: what errors do is that of the way itself.
    """
    seen, poses, problem = prepared.reflectors, prepared.poses, prepared.problem
    nests, alone = _nests(prepared)
    n, m, n_stations = len(prepared.angles), len(seen.row), poses.rotation.shape[-3]
    first_pose = n + CIRCLE * len(seen.name)
    first_nest = first_pose + 6 * (n_stations - 1) + 3
    first_drift = first_nest + 3 * nests.n_points
    size = first_drift + prepared.drift.size
    points, off = _circle_rows(prepared, deviations, size)
    arm = poses.turned(problem.xyz[seen.row], seen.station)
    points[:, :, first_pose : first_nest - 3] = pose_jacobian(arm, seen.station, n_stations)
    back = np.swapaxes(poses.rotation[seen.station], 1, 2)
    jacobian, discrepancy = _nest_rows(prepared, nests, poses, alone, (size, first_nest))
    design = np.concatenate([back @ points, jacobian])
    misclosure = np.concatenate([np.einsum("mij,mj->mi", back, off), discrepancy])
    row = np.concatenate([seen.row, nests.row])
    elements = Elements(
        row=row,
        pairs=m,
        direct=seen.row,
        reflection=np.zeros((m, 3, 3)),
        station=problem.station[row],
        position=np.append(seen.position, np.full(len(nests.row), -1)),
        nest=problem.nest[row],
        moment=problem.moment[row],
        beam=problem.xyz[row] / np.linalg.norm(problem.xyz[row], axis=1)[:, None],
    )
    design[:, :, first_drift:] = -elements.carried(_drifted(prepared))
    root = _roots(prepared, problem.noise.weight(problem.xyz[seen.row]), elements)
    outputs = np.zeros((n, size))
    outputs[:, :n] = np.eye(n)
    outputs[:, 0] -= 1.0
    return Linear(
        elements=elements,
        design=-root @ design,
        misclosure=np.einsum("mij,mj->mi", root, misclosure),
        unit=np.einsum("mii->mi", root @ np.swapaxes(_frames(elements.beam), 1, 2)).copy(),
        root=root,
        outputs=outputs,
        prior=np.zeros((0, size)),
        prior_misclosure=np.zeros(0),
        sensitivity=_sensitivity(prepared, elements, root),
    )


def _circle_rows(prepared: PreparedPoints, deviations: Floats, size: int) -> tuple[Floats, Floats]:
    """Return how deviations and circles change the misclosures (M, 3, size), and these, m.

    In the common frame.
    """
    seen, n = prepared.reflectors, len(prepared.angles)
    every = np.arange(len(seen.row))
    placed = prepared.poses.placed(prepared.problem.xyz[seen.row], seen.station)
    axes, radii, off_circle = local_axes(placed, seen, prepared.angles)
    readings = direct_readings(placed, seen, prepared.angles)
    along = radii * (readings - deviations[seen.position])
    arm = radii[:, None] * axes[:, 1]
    first = n + CIRCLE * seen.reflector
    rows = np.zeros((len(every), 3, size))
    rows[every, :, seen.position] = -radii[:, None] * axes[:, 0]
    for k, unit in enumerate(np.eye(3)):
        rows[every, :, first + k] = -unit
        rows[every, :, first + 3 + k] = -np.cross(unit, arm)
    rows[every, :, first + 6] = -axes[:, 1]
    return rows, np.einsum("maj,ma->mj", axes, np.column_stack([along, off_circle]))


def _sensitivity(prepared: PreparedPoints, elements: Elements, root: Floats) -> Floats:
    """Return what whitened errors of the elements do to the estimate (N, m, 3).

    Those of the nests, by way of stations and drift, by differences.
    """
    seen, poses, m = prepared.reflectors, prepared.poses, elements.pairs
    step = np.swapaxes(np.linalg.inv(root), 1, 2)  # (m, axis, 3), m
    placed = poses.placed(prepared.problem.xyz[seen.row], seen.station)
    axes, radii, _ = local_axes(placed, seen, prepared.angles)
    gain = prepared.joining @ direct_response(seen, prepared.angles, radii)
    moved = np.einsum("mbj,mjk,mak->mab", axes, poses.rotation[seen.station], step[:m])
    found = np.zeros((len(prepared.angles), *root.shape[:2]))
    found[:, :m] = gain[:, :m, None] * moved[:, :, 0] + gain[:, m:, None] * moved[:, :, 1]
    for nest, row in enumerate(elements.row[m:].tolist(), start=m):
        aside = np.zeros((2, 3, *prepared.problem.xyz.shape))
        aside[0, :, row], aside[1, :, row] = STEP * step[nest], -STEP * step[nest]
        ahead, behind = prepared.estimate(prepared.problem.xyz + aside)
        found[:, nest] = (ahead - behind).T / (2.0 * STEP)
    return found


def _mirror(prepared: PreparedNormals, deviations: Floats) -> joint.Mirror:
    """Return the unknowns of the model that fit the deviations; the rest is linear."""
    if isinstance(prepared, PreparedJoint):
        return prepared.mirror
    normals, pairs = prepared.normals(prepared.problem.xyz), prepared.pairs
    if prepared.problem.way != STITCHING:
        return joint.start_mirror(normals, pairs, prepared.poses, prepared.angles)
    axes, height = station_cones(normals.normal, pairs, prepared.angles)
    psi, n = prepared.angles + deviations, len(prepared.angles)
    rotation = np.tile(np.eye(3), (int(pairs.station.max()) + 1, 1, 1))
    for station, at, _ in pairs.stations(prepared.angles):
        axis, here = axes[at[0]], psi[pairs.position[at[0]]]
        side = np.cross(axis, normals.normal[at[0]])
        side = side / np.linalg.norm(side)
        front = np.cross(side, axis)
        c, s = np.cos(here), np.sin(here)
        rotation[station] = [c * front - s * side, s * front + c * side, axis]
    poses = Poses(rotation, np.zeros((len(rotation), 3)))
    flat = np.zeros(n)
    return joint.Mirror(poses, np.eye(3), np.asarray(np.arcsin(height)), psi, flat, flat.copy())


def _pair_rows(
    prepared: PreparedNormals, normals: Normals, mirror: joint.Mirror, size: int, stitched: bool
) -> tuple[Floats, Floats]:
    """Return how the unknowns change the conditions (P, 3, size), and these at the model, m.

    Along the axes of the stations. Stitching: each group has a distance of its own.
    """
    pairs, n = prepared.pairs, len(prepared.angles)
    local, shared, discrepancy, _ = joint.group_terms(normals, pairs, mirror)
    each, at = np.arange(pairs.n_groups), pairs.position
    distance = each if stitched else at
    planes = np.zeros((pairs.n_groups, 3, size))
    planes[each, :, at], planes[each, :, n + at] = local[..., 0], local[..., 1]
    planes[each, :, 2 * n + distance] = local[..., 2]
    first = 2 * n + (pairs.n_groups if stitched else n)
    planes[:, :, first : first + shared.shape[-1]] = shared
    if stitched:
        planes[:, 2], discrepancy = 0.0, discrepancy * [1.0, 1.0, 0.0]
        planes[each, 2, 2 * n + distance] = 1.0
    elevation = (mirror.beta + mirror.eps)[at]
    n_model, psi = mirror.frame, mirror.psi[at]
    ce, se = np.cos(elevation), np.sin(elevation)
    normal = np.column_stack([ce * np.cos(psi), ce * np.sin(psi), se]) @ n_model.T
    t, b = tangent_frame(normal, np.broadcast_to(n_model[:, 2], normal.shape))
    rotation = mirror.poses.rotation[pairs.station]
    basis = np.zeros((pairs.n_groups, 4, 3))
    basis[:, :3, :2] = np.swapaxes(rotation, 1, 2) @ np.stack([t, b], axis=-1)
    basis[:, 3, 2] = 1.0
    points = prepared.problem.xyz[pairs.direct]
    change = condition_jacobian(points, normals.normal, normals.offset, pairs) @ basis[pairs.group]
    conditions = np.einsum("pij,pj->pi", change, discrepancy[pairs.group])
    return change @ planes[pairs.group], normals.misclosure - conditions


def _nests(prepared: Prepared) -> tuple[Nests, bool]:
    """Return the nests in the fit; where none tie stations, those of the drift, each alone."""
    if len(prepared.nests.row):
        return prepared.nests, False
    problem, none = prepared.problem, np.zeros(0, dtype=np.int64)
    rows = np.concatenate([none, *(s.rows[~s.suspects] for s in prepared.drift.stations)])
    key = np.column_stack([problem.station[rows], problem.nest[rows]])
    names, point = np.unique(key, axis=0, return_inverse=True)
    order = np.argsort(point.ravel(), kind="stable")
    point = point.ravel()[order].astype(np.int64)
    start = np.searchsorted(point, np.arange(len(names))).astype(np.int64)
    rows = rows[order]
    return Nests(rows, problem.station[rows], none, point, start, names[:, 1]), True


def _nest_rows(
    prepared: Prepared, nests: Nests, poses: Poses, alone: bool, columns: tuple[int, int]
) -> tuple[Floats, Floats]:
    """Return how the unknowns change the misclosures (Q, 3, size) of nests, and these, m."""
    size, first_nest = columns
    points, q = prepared.problem.xyz, len(nests.row)
    design = np.zeros((q, 3, size))
    if not q:
        return design, np.zeros((0, 3))
    n_stations = poses.rotation.shape[-3]
    axes = np.arange(3)
    at = first_nest + 3 * nests.point[:, None] + axes
    if alone:
        mean = np.add.reduceat(points[nests.row], nests.start, axis=0)
        mean = mean / np.bincount(nests.point)[:, None]
        design[np.arange(q)[:, None], axes, at] = -1.0
        return design, points[nests.row] - mean[nests.point]
    weight = prepared.problem.noise.weight(points[nests.row])
    _, _, residual = nest_equations(points, nests, weight, poses)
    back = np.swapaxes(poses.rotation[nests.station], 1, 2)
    arm = poses.turned(points[nests.row], nests.station)
    first_pose = first_nest - 3 - 6 * (n_stations - 1)
    design[:, :, first_pose : first_nest - 3] = back @ pose_jacobian(
        arm, nests.station, n_stations
    )
    design[np.arange(q)[:, None, None], axes[:, None], at[:, None, :]] = -back
    return design, np.einsum("qij,qj->qi", back, residual)


def _drifted(prepared: Prepared) -> Floats:
    """Return how the changes of the tracker's frame move all points (n, 3, size of the drift)."""
    xyz, course = prepared.problem.xyz, prepared.drift.course
    by_part = movement(xyz)[:, :, None, :] * course[:, None, :, None]
    return np.asarray(by_part.reshape(*xyz.shape, -1))


def _elements(prepared: PreparedNormals, normals: Normals, nests: Nests) -> Elements:
    problem, pairs = prepared.problem, prepared.pairs
    row = np.concatenate([pairs.mirrored, nests.row])
    n = normals.normal[pairs.group]
    return Elements(
        row=row,
        pairs=len(pairs.mirrored),
        direct=pairs.direct,
        reflection=np.eye(3) - 2.0 * n[:, :, None] * n[:, None, :],
        station=problem.station[row],
        position=np.append(pairs.position[pairs.group], np.full(len(nests.row), -1)),
        nest=problem.nest[row],
        moment=problem.moment[row],
        beam=problem.xyz[row] / np.linalg.norm(problem.xyz[row], axis=1)[:, None],
    )


def _roots(prepared: Prepared, weight: Floats, elements: Elements) -> Floats:
    """Return W^(1/2) F (m, 3, 3): symmetric in the frame F of the beam.

    ``weight`` (pairs, 3, 3): of all but the nests.
    """
    nests = prepared.problem.xyz[elements.row[elements.pairs :]]
    weight = np.concatenate([weight, prepared.problem.noise.weight(nests)])
    frame = _frames(elements.beam)
    values, vectors = np.linalg.eigh(frame @ weight @ np.swapaxes(frame, 1, 2))
    root = (vectors * np.sqrt(values)[:, None, :]) @ np.swapaxes(vectors, 1, 2)
    return np.asarray(root @ frame)


def _frames(beam: Floats) -> Floats:
    """Return unit vectors (m, 3, 3) along beams (m, 3), level across them, and upwards."""
    level = np.cross([0.0, 0.0, 1.0], beam)
    length = np.linalg.norm(level, axis=1)[:, None]
    level = np.where(length > 1e-6, level / np.maximum(length, 1e-6), [0.0, 1.0, 0.0])
    return np.stack([beam, level, np.cross(beam, level)], axis=1)
