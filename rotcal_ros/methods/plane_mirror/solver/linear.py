"""The linear view of a mirror's points at a solution: what the engine of adjustment needs.

Whatever way the deviations are found, the points are held against one model, that of
:mod:`~rotcal_ros.methods.plane_mirror.solver.joint` with the drift of the tracker among its
unknowns (stitching: without what ties its stations but shared positions). Reflectors on the table
are held against circles, one of each. A pair of points is one element: its condition
e = M' - M + 2 (n.M - h) n feels an error of the mirrored point as it is, and one of the direct
point reflected, so that the two kinds cannot be separated. A reading of a nest is another. Each
has three axes: along the beam, level across it, and upwards; whitened by the symmetric root of its
weight.

The unknowns stand in this order: the deviations (psi) of N positions; what belongs to the kind of
measurement (tilts and distances of the mirror, or circles); stations, six each but the first;
axis and lean of the mirror, three; nests, three each; drift.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np

from rotcal_ros.adjust.groups import SolutionView
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.methods.plane_mirror.settings import STITCHING
from rotcal_ros.methods.plane_mirror.solver import joint
from rotcal_ros.methods.plane_mirror.solver.drift import movement
from rotcal_ros.methods.plane_mirror.solver.normals import (
    Normals,
    condition_jacobian,
    reflection,
    tangent_frame,
)
from rotcal_ros.methods.plane_mirror.solver.problem import Nests, nest_rounds
from rotcal_ros.methods.plane_mirror.solver.readings import (
    cones,
    direct_readings,
    direct_response,
    from_first,
    local_axes,
)
from rotcal_ros.methods.plane_mirror.solver.registration import (
    Poses,
    nest_equations,
    pose_jacobian,
)
from rotcal_ros.methods.plane_mirror.solver.ways import (
    Prepared,
    PreparedJoint,
    PreparedNormals,
    PreparedPoints,
    PreparedWay,
)

_CIRCLE: Final = 7
"""Unknowns of the circle of a reflector on the table: centre, three turns, radius."""
_STEP: Final = 0.1
"""Standard deviations by which nests are moved to see what their errors do."""
_OPEN: Final = 1e-10
"""Relative eigenvalue of the scaled normal equations below which a direction is not determined."""


@dataclass(frozen=True, eq=False)
class Elements:
    """What may be wrong as one group: m pairs, then readings of nests.

    ``row`` (m,): of the mirrored point or the nest in the problem. ``pairs``: how many are pairs.
    ``station``, ``position`` (-1: a nest), ``nest`` (m,), ``moment`` (m,), ``beam`` (m, 3): unit
    vectors along the axes of the station. ``direct`` (P,): rows of the direct points of pairs,
    ``reflection`` (P, 3, 3): what their errors are multiplied by in the conditions, with the sign
    reversed. Without a mirror a "pair" is one reflector on the table, and ``reflection`` is zero.
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

    @cached_property
    def axes(self) -> Floats:
        """Unit vectors (m, 3, 3): rows along the beam, level across it, and upwards."""
        level = np.cross([0.0, 0.0, 1.0], self.beam)
        length = np.linalg.norm(level, axis=1)[:, None]
        # A beam straight up has no level direction of its own: +y serves.
        level = np.where(length > 1e-6, level / np.maximum(length, 1e-6), [0.0, 1.0, 0.0])
        return np.stack([self.beam, level, np.cross(self.beam, level)], axis=1)


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
        """The view by the covariance of the unknowns; what is not determined stays as it is."""
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
        carried = self.root @ self.elements.carried(errors)
        white = carried.reshape(self.misclosure.size, errors.shape[2])
        flat = self.design.reshape(len(white), -1)
        return np.asarray(self.outputs @ (self.view.covariance @ (flat.T @ white)))

    @cached_property
    def _solution(self) -> Floats:
        """The changes (p,) of the unknowns from the model, by least squares."""
        flat = self.design.reshape(-1, self.design.shape[2])
        right = flat.T @ self.misclosure.ravel() + self.prior.T @ self.prior_misclosure
        return np.asarray(self.view.covariance @ right)

    @cached_property
    def _inverse(self) -> tuple[Floats, int]:
        """The pseudo-inverse (p, p) of the normal equations, and their rank."""
        flat = self.design.reshape(-1, self.design.shape[2])
        normal = flat.T @ flat + self.prior.T @ self.prior
        # Unknowns are radians and metres: their columns are scaled to length one before the
        # eigenvalues are compared.
        scale = np.sqrt(np.diag(normal))
        scale = np.where(scale > 0.0, scale, 1.0)
        values, vectors = np.linalg.eigh(normal / scale / scale[:, None])
        determined = values > _OPEN * values[-1]
        kept = vectors[:, determined] / scale[:, None]
        return np.asarray((kept / values[determined]) @ kept.T), int(determined.sum())


class _Unknowns(NamedTuple):
    """Where the unknowns of stations, nests and drift begin, and how many unknowns there are."""

    stations: int
    nests: int
    drift: int
    size: int

    @classmethod
    def of(cls, prepared: Prepared, before: int, poses: Poses, nests: Nests) -> _Unknowns:
        """Return the columns behind the first ones, of which there are ``before``."""
        first_nest = before + 6 * (poses.rotation.shape[-3] - 1) + 3
        first_drift = first_nest + 3 * nests.n_points
        return cls(before, first_nest, first_drift, first_drift + prepared.drift.size)


_Rows = tuple[Floats, Floats]
"""How all unknowns change misclosures (m, 3, size), and these (m, 3) at the model."""


def linear(prepared: PreparedWay, deviations: Floats) -> Linear:
    """Return the linear view at the ``deviations`` (N,), rad, from the first position."""
    if isinstance(prepared, PreparedPoints):
        return _of_reflectors(prepared, deviations)
    return _of_mirror(prepared, deviations)


def _of_mirror(prepared: PreparedNormals, deviations: Floats) -> Linear:
    """Return the view of a mirror. Stitching: each group has a distance of its own."""
    problem, pairs, n = prepared.problem, prepared.pairs, len(prepared.angles)
    mirror, normals = _mirror(prepared, deviations), prepared.normals(problem.xyz)
    nests, alone = _nests(prepared)
    stitched, each = problem.way == STITCHING, np.arange(pairs.n_groups, dtype=np.int64)
    distance = each if stitched else pairs.position
    before = 2 * n + int(distance.max()) + 1
    columns = _Unknowns.of(prepared, before, mirror.poses, nests)
    elements = _elements(
        prepared,
        nests,
        row=pairs.mirrored,
        direct=pairs.direct,
        reflected=reflection(normals.normal[pairs.group]),
        position=pairs.position[pairs.group],
    )
    rows = (
        _pair_rows(prepared, normals, mirror, distance, columns),
        _nest_rows(prepared, nests, mirror.poses, alone, columns),
    )
    prior = np.zeros((n, columns.size))
    prior[:, n : 2 * n] = np.eye(n) / problem.tilt_std
    tilts = prior, -mirror.eps / problem.tilt_std
    return _view(prepared, elements, rows, prepared.pair_weight, tilts, columns)


def _of_reflectors(prepared: PreparedPoints, deviations: Floats) -> Linear:
    """Return the view of reflectors on the table, each with a circle of its own.

    Three unknowns are those of a mirror that is not there. The way takes the mean of its readings,
    whatever their noise is along the circle: what errors do is that of the way itself.
    """
    seen, poses, problem = prepared.reflectors, prepared.poses, prepared.problem
    nests, alone = _nests(prepared)
    before = len(prepared.angles) + _CIRCLE * len(seen.name)
    columns = _Unknowns.of(prepared, before, poses, nests)
    elements = _elements(
        prepared,
        nests,
        row=seen.row,
        direct=seen.row,
        reflected=np.zeros((len(seen.row), 3, 3)),
        position=seen.position,
    )
    rows = (
        _circle_rows(prepared, deviations, columns),
        _nest_rows(prepared, nests, poses, alone, columns),
    )
    weight = problem.noise.weight(problem.xyz[seen.row])
    no_tilts = np.zeros((0, columns.size)), np.zeros(0)
    view = _view(prepared, elements, rows, weight, no_tilts, columns)
    return replace(view, sensitivity=_sensitivity(prepared, elements, view.root))


def _elements(
    prepared: Prepared, nests: Nests, *, row: Ints, direct: Ints, reflected: Floats, position: Ints
) -> Elements:
    """Return the pairs with the points ``row`` (P,), then the readings of ``nests``."""
    problem, pairs = prepared.problem, len(row)
    row = np.concatenate([row, nests.row])
    return Elements(
        row=row,
        pairs=pairs,
        direct=direct,
        reflection=reflected,
        station=problem.station[row],
        position=np.append(position, np.full(len(nests.row), -1)),
        nest=problem.nest[row],
        moment=problem.moment[row],
        beam=problem.xyz[row] / np.linalg.norm(problem.xyz[row], axis=1)[:, None],
    )


def _view(
    prepared: Prepared,
    elements: Elements,
    rows: tuple[_Rows, _Rows],
    weight: Floats,
    tilts: _Rows,
    columns: _Unknowns,
) -> Linear:
    """Return the whitened view of the ``rows`` of pairs and of nests, with those of the ``tilts``.

    Only the drift is missing in the rows. ``weight`` (P, 3, 3): of all but the nests.
    """
    n, design = len(prepared.angles), np.concatenate([rows[0][0], rows[1][0]])
    misclosure = np.concatenate([rows[0][1], rows[1][1]])
    design[:, :, columns.drift :] = -elements.carried(_drifted(prepared))
    root = _roots(prepared, weight, elements)
    outputs = np.zeros((n, columns.size))
    outputs[:, :n] = from_first(n)
    return Linear(
        elements=elements,
        design=-root @ design,  # rows are of misclosures, a design is of computed values
        misclosure=np.einsum("mij,mj->mi", root, misclosure),
        unit=np.einsum("mii->mi", root @ np.swapaxes(elements.axes, 1, 2)).copy(),
        root=root,
        outputs=outputs,
        prior=tilts[0],
        prior_misclosure=tilts[1],
    )


def _pair_rows(
    prepared: PreparedNormals,
    normals: Normals,
    mirror: joint.Mirror,
    distance: Ints,
    columns: _Unknowns,
) -> _Rows:
    """Return the rows of the conditions of pairs, in m along the axes of the stations.

    ``distance`` (G,): the number of the unknown distance of each group's plane.
    """
    pairs, n = prepared.pairs, len(prepared.angles)
    local, shared, discrepancy, _ = joint.group_terms(normals, pairs, mirror)
    each, at = np.arange(pairs.n_groups), pairs.position
    planes = np.zeros((pairs.n_groups, 3, columns.size))
    planes[each, :, at], planes[each, :, n + at] = local[..., 0], local[..., 1]
    planes[each, :, 2 * n + distance] = local[..., 2]
    planes[:, :, columns.stations : columns.nests] = shared
    if prepared.problem.way == STITCHING:  # the offset of each group is free, and shows nothing
        planes[:, 2], discrepancy = 0.0, discrepancy * [1.0, 1.0, 0.0]
        planes[each, 2, 2 * n + distance] = 1.0
    elevation, psi = (mirror.beta + mirror.eps)[at], mirror.psi[at]
    ce, se = np.cos(elevation), np.sin(elevation)
    normal = np.column_stack([ce * np.cos(psi), ce * np.sin(psi), se]) @ mirror.frame.T
    t, b = tangent_frame(normal, np.broadcast_to(mirror.frame[:, 2], normal.shape))
    basis = joint.plane_basis(mirror.poses, pairs.station, t, b)
    # From the planes as they are fitted to those of the model: conditions are linear in (n, h).
    points = prepared.problem.xyz[pairs.direct]
    change = condition_jacobian(points, normals.normal, normals.offset, pairs) @ basis[pairs.group]
    conditions = np.einsum("pij,pj->pi", change, discrepancy[pairs.group])
    return change @ planes[pairs.group], normals.misclosure - conditions


def _circle_rows(prepared: PreparedPoints, deviations: Floats, columns: _Unknowns) -> _Rows:
    """Return the rows of places on their circles, in m along the axes of the stations."""
    seen, n, poses = prepared.reflectors, len(prepared.angles), prepared.poses
    xyz = prepared.problem.xyz[seen.row]
    every = np.arange(len(seen.row))
    placed = poses.placed(xyz, seen.station)
    axes, radii, off_circle = local_axes(placed, prepared.sets)
    readings = direct_readings(placed, prepared.sets)
    along = radii * (readings - deviations[seen.position])
    arm = radii[:, None] * axes[:, 1]
    first = n + _CIRCLE * seen.reflector
    rows = np.zeros((len(every), 3, columns.size))
    rows[every, :, seen.position] = -radii[:, None] * axes[:, 0]
    for k, unit in enumerate(np.eye(3)):
        rows[every, :, first + k] = -unit
        rows[every, :, first + 3 + k] = -np.cross(unit, arm)
    rows[every, :, first + 6] = -axes[:, 1]
    rows[:, :, columns.stations : columns.nests - 3] = pose_jacobian(
        poses.turned(xyz, seen.station), seen.station, len(poses.rotation)
    )
    off = np.einsum("maj,ma->mj", axes, np.column_stack([along, off_circle]))
    back = np.swapaxes(poses.rotation[seen.station], 1, 2)  # from the common axes to the station's
    return back @ rows, np.einsum("mij,mj->mi", back, off)


def _nest_rows(
    prepared: Prepared, nests: Nests, poses: Poses, alone: bool, columns: _Unknowns
) -> _Rows:
    """Return the rows of readings of nests, in m along the axes of the stations."""
    points, q = prepared.problem.xyz, len(nests.row)
    design = np.zeros((q, 3, columns.size))
    if not q:
        return design, np.zeros((0, 3))
    axes = np.arange(3)
    at = columns.nests + 3 * nests.point[:, None] + axes
    if alone:
        mean = np.add.reduceat(points[nests.row], nests.start, axis=0)
        mean = mean / np.bincount(nests.point)[:, None]
        design[np.arange(q)[:, None], axes, at] = -1.0
        return design, points[nests.row] - mean[nests.point]
    weight = prepared.problem.noise.weight(points[nests.row])
    _, _, residual = nest_equations(points, nests, weight, poses)
    back = np.swapaxes(poses.rotation[nests.station], 1, 2)
    arm = poses.turned(points[nests.row], nests.station)
    jacobian = pose_jacobian(arm, nests.station, len(poses.rotation))
    design[:, :, columns.stations : columns.nests - 3] = back @ jacobian
    design[np.arange(q)[:, None, None], axes[:, None], at[:, None, :]] = -back
    return design, np.einsum("qij,qj->qi", back, residual)


def _drifted(prepared: Prepared) -> Floats:
    """Return how the changes of the tracker's frame move all points (n, 3, size of the drift)."""
    xyz, course = prepared.problem.xyz, prepared.drift.course
    by_part = movement(xyz)[:, :, None, :] * course[:, None, :, None]
    return np.asarray(by_part.reshape(*xyz.shape, -1))


def _roots(prepared: Prepared, weight: Floats, elements: Elements) -> Floats:
    """Return W^(1/2) F (m, 3, 3) with the axes F of the beam, and W the weight along these.

    Of all roots of W the symmetric one turns errors least: an axis keeps its meaning.
    ``weight`` (pairs, 3, 3): of all but the nests.
    """
    nests = prepared.problem.xyz[elements.row[elements.pairs :]]
    weight = np.concatenate([weight, prepared.problem.noise.weight(nests)])
    frame = elements.axes
    values, vectors = np.linalg.eigh(frame @ weight @ np.swapaxes(frame, 1, 2))
    root = (vectors * np.sqrt(values)[:, None, :]) @ np.swapaxes(vectors, 1, 2)
    return np.asarray(root @ frame)


def _mirror(prepared: PreparedNormals, deviations: Floats) -> joint.Mirror:
    """Return the unknowns of the model that fit the deviations; the rest is linear."""
    if isinstance(prepared, PreparedJoint):
        return prepared.mirror
    normals, pairs = prepared.normals(prepared.problem.xyz), prepared.pairs
    if prepared.problem.way != STITCHING:
        return joint.start_mirror(normals, pairs, prepared.poses, prepared.angles)
    # Each station gets a frame of its own with the table axis as z, turned about it so that the
    # azimuth of its first normal is what the deviations say.
    axes, height = cones(normals.normal, prepared.sets)
    psi, n = prepared.angles + deviations, len(prepared.angles)
    rotation = np.tile(np.eye(3), (int(pairs.station.max()) + 1, 1, 1))
    for at, _ in prepared.sets:
        axis, here = axes[at[0]], psi[pairs.position[at[0]]]
        side = np.cross(axis, normals.normal[at[0]])
        side = side / np.linalg.norm(side)
        front = np.cross(side, axis)
        c, s = np.cos(here), np.sin(here)
        rotation[pairs.station[at[0]]] = [c * front - s * side, s * front + c * side, axis]
    poses = Poses(rotation, np.zeros((len(rotation), 3)))
    flat = np.zeros(n)  # distances are free in each group, tilts start at none
    return joint.Mirror(poses, np.eye(3), np.asarray(np.arcsin(height)), psi, flat, flat.copy())


def _nests(prepared: Prepared) -> tuple[Nests, bool]:
    """Return the nests in the fit; where none tie stations, those of the drift, each alone.

    Alone: a nest seen from two stations is two nests.
    """
    if len(prepared.nests.row):
        return prepared.nests, False
    problem, none = prepared.problem, np.zeros(0, dtype=np.int64)
    rows = np.concatenate([none, *(s.rows[~s.suspects] for s in prepared.drift.stations)])
    key = np.column_stack([problem.station[rows], problem.nest[rows]])
    names, point = np.unique(key, axis=0, return_inverse=True)
    rounds = nest_rounds(problem)[rows]
    return Nests.of(rows, problem.station[rows], rounds, point.ravel(), names[:, 1]), True


def _sensitivity(prepared: PreparedPoints, elements: Elements, root: Floats) -> Floats:
    """Return what whitened errors of the elements do to the estimate (N, m, 3).

    Those of the nests, by way of stations and drift, by differences.
    """
    seen, poses, m = prepared.reflectors, prepared.poses, elements.pairs
    step = np.swapaxes(np.linalg.inv(root), 1, 2)  # (m, axis, 3): one whitened unit, in m
    placed = poses.placed(prepared.problem.xyz[seen.row], seen.station)
    axes, radii, _ = local_axes(placed, prepared.sets)
    gain = prepared.joining @ direct_response(prepared.sets, radii)
    moved = np.einsum("mbj,mjk,mak->mab", axes, poses.rotation[seen.station], step[:m])
    found = np.zeros((len(prepared.angles), *root.shape[:2]))
    found[:, :m] = gain[:, :m, None] * moved[:, :, 0] + gain[:, m:, None] * moved[:, :, 1]
    for nest, row in enumerate(elements.row[m:].tolist(), start=m):
        aside = np.zeros((2, 3, *prepared.problem.xyz.shape))
        aside[0, :, row], aside[1, :, row] = _STEP * step[nest], -_STEP * step[nest]
        ahead, behind = prepared.estimate(prepared.problem.xyz + aside)
        found[:, nest] = (ahead - behind).T / (2.0 * _STEP)
    return found
