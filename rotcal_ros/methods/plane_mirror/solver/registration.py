"""Registration: fixed nests bring all tracker stations into the frame of the first.

All stations and nests are adjusted together. The paper (Muralikrishnan et al.) maps each station
to the first one; with all nests seen by both that is the same transform, and here the noise of
the first station's nests is counted once. Changes of poses are (rotation about the tracker, shift)
in the common frame, six per station with the first one fixed: p = 6 (S - 1) columns.

Whether the nests still stand where the registration has them is tested by their residuals: each
nest may have moved for good between two rounds of nests, or have stood elsewhere in one round.
The most probable move that noise cannot explain is taken as found, the nest counts as another one
after it, and the test starts again. Blunders that leave no doubt are refused with DataError.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations, pairwise
from typing import Final

import numpy as np

from rotcal_ros.adjust.distributions import chi2_isf
from rotcal_ros.adjust.effects import EffectTest, effect_test
from rotcal_ros.adjust.fit import Fit
from rotcal_ros.adjust.kernels import WholeMatrix
from rotcal_ros.adjust.model import Model, linear
from rotcal_ros.adjust.seen import seen_by
from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.errors import DataError, GeometryError
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.geometry.rotations import align, cross_matrix, require_spread, rotation_from_vector
from rotcal_ros.methods.plane_mirror.solver.drift import displaced_nests, find_drift
from rotcal_ros.methods.plane_mirror.solver.problem import (
    WORDS,
    Nests,
    PlaneMirrorProblem,
    find_nests,
    nest_rounds,
)

MIN_APART: Final = 5e-3
"""Two nests are never closer than this (m): it is less than any reflector."""
_MATCH: Final = 2e-3
"""Distances (m) that agree within this show the same two nests."""
_MIN_REDUNDANCY: Final = 1e-3
"""Share of a move of a nest that shows in the residuals; one that shows less is not tested."""
_MAX_STEPS: Final = 30  # the start is near: what has not settled then never will
_TOLERANCE: Final = 1e-14  # change (rad, m) that is rounding


@dataclass(frozen=True)
class Poses:
    """Tracker stations in the frame of the first: X = ``rotation`` x + ``translation`` (metres).

    ``rotation`` is (..., S, 3, 3), ``translation`` (..., S, 3), the place of the tracker.
    """

    rotation: Floats
    translation: Floats

    @classmethod
    def untied(cls, count: int) -> Poses:
        """Return stations that all stand in the origin of the common frame, none of them turned.

        For what is computed station by station, each in its own frame.
        """
        return cls(np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3)))

    def turned(self, points: Floats, station: Ints) -> Floats:
        """Return vectors (..., m, 3) seen from ``station`` (m,) along the common axes."""
        rotation = self.rotation[..., station, :, :]
        vectors: Floats = np.einsum("...mij,...mj->...mi", rotation, points)
        return vectors

    def placed(self, points: Floats, station: Ints) -> Floats:
        """Return points (..., m, 3) seen from ``station`` (m,) in the common frame."""
        return self.turned(points, station) + self.translation[..., station, :]

    def moved(self, change: Floats) -> Poses:
        """Return poses after a change (..., p) of all stations but the first."""
        steps = change.reshape(*change.shape[:-1], -1, 6)
        shape = np.broadcast_shapes(steps.shape[:-2], self.rotation.shape[:-3])
        rotation = np.broadcast_to(self.rotation, (*shape, *self.rotation.shape[-3:])).copy()
        translation = np.broadcast_to(
            self.translation, (*shape, *self.translation.shape[-2:])
        ).copy()
        rotation[..., 1:, :, :] = rotation_from_vector(steps[..., :3]) @ rotation[..., 1:, :, :]
        translation[..., 1:, :] += steps[..., 3:]
        return Poses(rotation, translation)


@dataclass(frozen=True, eq=False)
class NestFit:
    """Residuals (Q, 3) of nests in m along the common axes, and what the engine makes of them.

    ``fit``: of rows that ``root`` (Q, 3, 3) whitened, three for each reading. ``dof``: less what
    the drift took.
    """

    residual: Floats
    root: Floats
    fit: Fit
    dof: int

    @property
    def chi_square(self) -> float:
        """The weighted sum of squares of all residuals."""
        return self.fit.chi2

    @property
    def redundancy(self) -> Floats:
        """Share (Q,) of each nest observation that is checked by the others, 0 to 1."""
        return np.asarray(self.fit.redundancy.reshape(-1, 3).mean(axis=1))

    @property
    def test_value(self) -> Floats:
        """Normalised residual (Q,): 1 is expected, 0 where nothing checks the observation."""
        square = (self.fit.white.reshape(-1, 3) ** 2).sum(axis=1)
        share = 3.0 * self.redundancy
        value: Floats = np.sqrt(square / np.where(share > 1e-6, share, np.inf))
        return value

    def moved(self, members: Bools) -> EffectTest:
        """Test whether the readings ``members`` (Q,) show their nest shifted together (3,), m."""
        columns = (self.root * members[:, None, None]).reshape(-1, 3)
        rest = self.chi_square, self.dof
        return effect_test(seen_by(self.fit, columns), rest, 1.0, _MIN_REDUNDANCY)


@dataclass(frozen=True, eq=False)
class Moved:
    """A nest that moved: ``members`` (Q,) are the readings that show it elsewhere.

    ``round`` is the first round among these, ``text`` says it for people.
    """

    members: Bools
    round: int
    text: str


def register(
    problem: PlaneMirrorProblem, nests: Nests, taken: int = 0
) -> tuple[Poses, Nests, list[Moved]]:
    """Place and adjust all stations; returns them, the nests used, and what moved.

    ``taken`` degrees of freedom went into the drift that the points are freed of. A nest that
    moved counts as a new nest after the move. Exchanged nests and nests that stand in one place
    are refused with DataError; GeometryError as in :func:`place_stations`.
    """
    _check_apart(problem, nests)
    _check_exchanged(problem, nests)
    moved: list[Moved] = []
    while True:
        weight = problem.noise.weight(problem.xyz[nests.row])
        poses = adjust_stations(problem.xyz, nests, weight, place_stations(problem, nests))
        found = _moved_nest(problem, nests, nest_fit(problem.xyz, nests, weight, poses, taken))
        if found is None or len(moved) >= len(nests.name):
            return poses, nests, moved
        moved.append(found)
        nests = nests.split(found.members)


def check_nests(
    problem: PlaneMirrorProblem, *, newest: bool = False, drift_limit: float = np.inf
) -> list[str]:
    """Return what moved among the nests measured so far, in words; empty when all is well.

    For use while measuring: ``problem`` needs NEST rows only, and the others where nests were
    measured again to show the drift. ``newest``: only what the newest station shows, in its rounds
    behind the first if there are any. ``drift_limit`` (rad) is how far the tracker may turn there
    between two rounds of nests. Raises DataError and GeometryError as :func:`register`.
    """
    drift, last = find_drift(problem), int(problem.station.max())
    turned = [
        f"the tracker turned by {turn / ARCSEC:.1f} arcsec between two rounds of nests at station "
        f"{problem.station_name(station.station)}, allowed {drift_limit / ARCSEC:g}: let it settle"
        for station in drift.stations
        if station.station == last
        and (turn := float(np.linalg.norm(station.change[:, :3], axis=1).max())) > drift_limit
        and station.probability(problem.significance) < problem.significance
    ]
    if last == 0:
        return displaced_nests(problem, drift) + turned
    if drift.size:
        problem = replace(problem, xyz=drift.corrected(problem.xyz))
    moved = register(problem, find_nests(problem), drift.size)[2]
    own = np.unique(nest_rounds(problem)[problem.station == last])
    own = own[own >= 0]
    asked = own[-max(len(own) - 1, 1) :]
    return [m.text for m in moved if not newest or m.round in asked] + turned


def nest_fit(
    points: Floats, nests: Nests, weight: Floats, poses: Poses, taken: int = 0
) -> NestFit:
    """Return residuals and chi square of the registration at its solution.

    ``taken`` as in :func:`register`.
    """
    _, _, residual = nest_equations(points, nests, weight, poses)
    root = np.linalg.cholesky(weight).swapaxes(1, 2) @ poses.rotation[nests.station].swapaxes(1, 2)
    arm, n = poses.turned(points[nests.row], nests.station), len(nests.row)
    by_nest, axes = np.zeros((n, 3, 3 * nests.n_points)), np.arange(3)
    by_nest[np.arange(n)[:, None], axes, 3 * nests.point[:, None] + axes] = 1.0
    by_pose = -pose_jacobian(arm, nests.station, len(poses.rotation))
    design = (root @ np.concatenate([by_pose, by_nest], axis=2)).reshape(3 * n, -1)
    white, ones = (root @ residual[:, :, None]).ravel(), np.ones(3 * n)
    blocks = {"stations": by_pose.shape[2], "nests": by_nest.shape[2]}
    nothing = np.zeros((0, design.shape[1]))
    model = Model(blocks, white, ones, linear(design), nothing, WORDS)
    fit = Fit(model, np.zeros(design.shape[1]), white, ones, model.may_go, WholeMatrix(design))
    return NestFit(residual, root, fit, max(fit.dof - taken, 0))


def place_stations(problem: PlaneMirrorProblem, nests: Nests) -> Poses:
    """Place station after station from nests whose places are known already.

    Raises GeometryError naming the station that shares fewer than three nests with the others,
    or only nests in a line.
    """
    poses = Poses.untied(int(problem.station.max()) + 1)
    known = np.full((nests.n_points, 3), np.nan)
    waiting = list(range(1, len(poses.rotation)))
    _learn(known, problem, nests, 0, poses)
    while waiting:  # next is the station that shares most nests with those placed before
        shared = [_shared(known, nests, station) for station in waiting]
        station = waiting.pop(int(np.argmax([len(rows) for rows in shared])))
        rows = max(shared, key=len)
        target = known[nests.point[rows]]
        _require_nests(problem, nests, station, rows, target)
        source = problem.xyz[nests.row[rows]]
        poses.rotation[station], poses.translation[station] = align(source, target)
        _learn(known, problem, nests, station, poses)
    return poses


def adjust_stations(
    points: Floats, nests: Nests, weight: Floats, start: Poses, steps: int = _MAX_STEPS
) -> Poses:
    """Adjust all stations to the nests by Gauss-Newton; ``points`` (..., n, 3) with any trials."""
    poses = start
    for _ in range(steps):
        normal, right, _ = nest_equations(points, nests, weight, poses)
        change = np.asarray(np.linalg.solve(normal, right[..., None])[..., 0], dtype=np.float64)
        poses = poses.moved(change)
        if np.abs(change).max(initial=0.0) < _TOLERANCE:
            break
    return poses


def nest_equations(
    points: Floats, nests: Nests, weight: Floats, poses: Poses
) -> tuple[Floats, Floats, Floats]:
    """Return the normal matrix (..., p, p), its right side (..., p) and the residuals (..., Q, 3).

    The nests themselves are eliminated: each stands at the weighted mean of its observations.
    ``weight`` (Q, 3, 3) are inverse covariances along the axes of each station. Residual =
    observed - computed in the common frame, metres.
    """
    arm = poses.turned(points[..., nests.row, :], nests.station)
    rotation = poses.rotation[..., nests.station, :, :]
    turned_weight = rotation @ weight @ np.swapaxes(rotation, -1, -2)
    place = arm + poses.translation[..., nests.station, :]
    total = np.add.reduceat(turned_weight, nests.start, axis=-3)
    pulled = np.add.reduceat(
        np.einsum("...qij,...qj->...qi", turned_weight, place), nests.start, axis=-2
    )
    nest = np.linalg.solve(total, pulled[..., None])[..., 0]
    residual = place - nest[..., nests.point, :]
    jacobian = pose_jacobian(arm, nests.station, poses.rotation.shape[-3])
    weighted = turned_weight @ jacobian
    per_nest = np.add.reduceat(weighted, nests.start, axis=-3)
    flat = (*jacobian.shape[:-3], -1, jacobian.shape[-1])
    transposed = np.swapaxes(weighted.reshape(flat), -1, -2)
    eliminated = np.linalg.solve(total, per_nest).reshape(flat)
    normal = transposed @ jacobian.reshape(flat)
    normal = normal - np.swapaxes(per_nest.reshape(flat), -1, -2) @ eliminated
    # No term for the nests here: about weighted means the weighted residuals sum to zero.
    right = -transposed @ residual.reshape(*flat[:-1], 1)
    return normal, right[..., 0], residual


def pose_jacobian(arm: Floats, station: Ints, n_stations: int) -> Floats:
    """Return the change (..., Q, 3, p) of placed points per change of poses.

    ``arm`` (..., Q, 3) goes from the tracker to the points, along the common axes.
    """
    jacobian = np.zeros((*arm.shape, 6 * (n_stations - 1)))
    movable, columns = station_columns(station)
    block = np.concatenate(
        [
            -cross_matrix(arm[..., movable, :]),
            np.broadcast_to(np.eye(3), (*arm[..., movable, :].shape, 3)),
        ],
        axis=-1,
    )
    for axis in range(3):
        jacobian[..., movable[:, None], axis, columns] = block[..., axis, :]
    return jacobian


def station_columns(station: Ints) -> tuple[Ints, Ints]:
    """Return the entries (k,) that do not stand at the first station, and their columns (k, 6)."""
    movable = np.flatnonzero(station > 0)
    columns = 6 * (station[movable] - 1)[:, None] + np.arange(6)
    return movable, columns


def _shared(known: Floats, nests: Nests, station: int) -> Ints:
    """Return the entries of nests that a station sees and whose place is known, one per nest."""
    seen = (nests.station == station) & np.isfinite(known[nests.point, 0])
    _, first = np.unique(nests.point[seen], return_index=True)
    return np.flatnonzero(seen)[first]


def _learn(
    known: Floats, problem: PlaneMirrorProblem, nests: Nests, station: int, poses: Poses
) -> None:
    """Enter into ``known`` (K, 3) the places of nests that no station before has seen."""
    rotation, translation = poses.rotation[station], poses.translation[station]
    for entry in np.flatnonzero(nests.station == station):
        if np.isnan(known[nests.point[entry], 0]):
            known[nests.point[entry]] = rotation @ problem.xyz[nests.row[entry]] + translation


def _require_nests(
    problem: PlaneMirrorProblem, nests: Nests, station: int, rows: Ints, target: Floats
) -> None:
    """Raise unless the nests that a station shares with others fix it: three, not in a line."""
    names = ", ".join(str(name) for name in nests.name[nests.point[rows]])
    where = f"{problem.source}: tracker station {problem.station_name(station)}"
    if len(rows) < 3:
        raise GeometryError(
            f"{where} shares {len(rows)} nests ({names or 'none'}) with the stations placed "
            "before it, registration needs 3; measure more nests from there, or choose stitching"
        )
    require_spread(target, f"{where}: the nests {names} that it shares with the others")


def _moved_nest(problem: PlaneMirrorProblem, nests: Nests, fit: NestFit) -> Moved | None:
    """Return the most likely move, if one explains what noise cannot; else None.

    A move has three unknowns. What it leaves of chi square, where that is more than noise, is the
    yardstick; the significance is shared by all hypotheses (Bonferroni).
    """
    if fit.dof == 0 or fit.chi_square <= chi2_isf(problem.significance, fit.dof):
        return None
    hypotheses = _hypotheses(problem, nests)
    limit = chi2_isf(problem.significance / len(hypotheses), 3)
    best: tuple[float, Moved] | None = None
    for members, number, where in hypotheses:
        test = fit.moved(members)
        # of fewer axes: too few nests, the rest would not fix the stations
        if test.rank < 3 or test.squares <= limit * test.variance:
            continue
        if best is None or test.squares > best[0]:
            name = nests.name[nests.point[members][0]]
            text = f"nest {name} {where} (by {np.linalg.norm(test.size) * 1e3:.3f} mm)"
            text = f"{text}; it counts as another nest there"
            best = test.squares, Moved(members, number, text)
    return None if best is None else best[1]


def _hypotheses(problem: PlaneMirrorProblem, nests: Nests) -> list[tuple[Bools, int, str]]:
    """Each nest moved for good between two rounds of nests, or stood elsewhere in one round.

    Returns the members, the first round of them, and what happened in words.
    """
    station_of = dict(zip(nests.round.tolist(), nests.station.tolist(), strict=True))
    found = []
    for point in range(nests.n_points):
        own = nests.point == point
        seen = np.unique(nests.round[own]).tolist()
        at = [problem.station_name(station_of[number]) for number in seen]
        for before, now in pairwise(range(len(seen))):
            text = f"moved between tracker stations {at[before]} and {at[now]}"
            if at[before] == at[now]:
                text = f"moved while the tracker was at station {at[now]}"
            found.append((own & (nests.round >= seen[now]), seen[now], text))
        for now in range(1, len(seen) - 1):
            text = f"stood elsewhere at station {at[now]}"
            if at.count(at[now]) > 1:
                text = f"{text} in one of its rounds"
            found.append((own & (nests.round == seen[now]), seen[now], text))
    return found


def _check_apart(problem: PlaneMirrorProblem, nests: Nests) -> None:
    """Refuse two nests in one place: one was measured with the reflector on the other."""
    for station in np.unique(nests.station):
        at = np.flatnonzero(nests.station == station)
        points = problem.xyz[nests.row[at]]
        for i, j in combinations(range(len(at)), 2):
            apart = np.linalg.norm(points[i] - points[j])
            if nests.point[at[i]] != nests.point[at[j]] and apart < MIN_APART:
                a, b = nests.name[nests.point[at[i]]], nests.name[nests.point[at[j]]]
                raise DataError(
                    f"{problem.source}: from tracker station {problem.station_name(int(station))} "
                    f"nests {a} and {b} are {apart * 1e3:.3f} mm apart, so one of them was "
                    "measured with the reflector on the wrong nest; measure both again"
                )


def _check_exchanged(problem: PlaneMirrorProblem, nests: Nests) -> None:
    """Refuse two nests whose numbers are exchanged at a station.

    Distances between nests are the same from every station, wherever it stands; where they are
    not, and are once two nests are swapped, these were exchanged.
    """
    table = _first_places(problem, nests)
    for station in range(1, len(table)):
        for reference in range(station):
            both = np.flatnonzero(np.isfinite(table[station, :, 0] + table[reference, :, 0]))
            if len(both) < 3:
                continue
            here, there = _distances(table[station, both]), _distances(table[reference, both])
            if np.abs(here - there).max() < _MATCH:
                break
            swap = _exchange(here, there)
            if swap is not None:
                a, b = nests.name[both[list(swap)]]
                raise DataError(
                    f"{problem.source}: nests {a} and {b} are exchanged at tracker station "
                    f"{problem.station_name(station)} or {problem.station_name(reference)}: all "
                    "distances agree once they are swapped; correct the nest numbers"
                )


def _exchange(here: Floats, there: Floats) -> tuple[int, int] | None:
    """Return the two nests to swap so that all distances agree; None without a single answer."""
    answers = []
    for i, j in combinations(range(len(here)), 2):
        order = np.arange(len(here))
        order[[i, j]] = j, i
        if np.abs(here[np.ix_(order, order)] - there).max() < _MATCH:
            answers.append((i, j))
    return answers[0] if len(answers) == 1 else None


def _first_places(problem: PlaneMirrorProblem, nests: Nests) -> Floats:
    """Return the places (S, K, 3) of nests in the frame of each station, NaN where not seen."""
    table = np.full((int(problem.station.max()) + 1, nests.n_points, 3), np.nan)
    # Backwards, so that of several readings the first one stays.
    table[nests.station[::-1], nests.point[::-1]] = problem.xyz[nests.row[::-1]]
    return table


def _distances(points: Floats) -> Floats:
    """Return the distances (K, K) between points (K, 3)."""
    distances: Floats = np.linalg.norm(points[:, None] - points[None, :], axis=2)
    return distances
