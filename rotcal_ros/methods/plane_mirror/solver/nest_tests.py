"""Do the nests stand where the registration says? A nest that moved is found and named."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations, pairwise
from typing import Final

import numpy as np
from scipy.linalg import block_diag

from rotcal_ros.adjust.distributions import chi2_isf
from rotcal_ros.foundation.arrays import Bools, Floats
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.methods.plane_mirror.solver.drift import displaced_nests, find_drift
from rotcal_ros.methods.plane_mirror.solver.layout import Nests, find_nests, nest_rounds
from rotcal_ros.methods.plane_mirror.solver.problem import PlaneMirrorProblem
from rotcal_ros.methods.plane_mirror.solver.registration import (
    Poses,
    adjust_stations,
    nest_equations,
    place_stations,
    pose_jacobian,
)

MIN_APART: Final = 5e-3
"""Two nests are never closer than this (m): it is less than any reflector."""
_MATCH: Final = 2e-3  # distances that agree within this show the same two nests
_MIN_REDUNDANCY: Final = 1e-3


@dataclass(frozen=True)
class NestFit:
    """Residuals (Q, 3) of nests in m along the common axes, and their cofactors.

    ``weight`` and ``cofactor`` (3 Q, 3 Q) are the inverse covariance of the observations and the
    covariance of the residuals.
    """

    residual: Floats
    weight: Floats
    cofactor: Floats
    chi_square: float
    dof: int

    @property
    def redundancy(self) -> Floats:
        """Share (Q,) of each nest observation that is checked by the others, 0 to 1."""
        share: Floats = np.einsum("ij,ji->i", self.cofactor, self.weight).reshape(-1, 3).mean(1)
        return np.clip(share, 0.0, 1.0)

    @property
    def test_value(self) -> Floats:
        """Normalised residual (Q,): 1 is expected, 0 where nothing checks the observation."""
        v = self.residual
        square = (v * (self.weight @ v.ravel()).reshape(-1, 3)).sum(axis=1)
        share = 3.0 * self.redundancy
        value: Floats = np.sqrt(square / np.where(share > 1e-6, share, np.inf))
        return value


@dataclass(frozen=True, eq=False)
class Moved:
    """Observations (Q,) that show a nest elsewhere, the first round of them, and a text."""

    members: Bools
    round: int
    text: str


def register(
    problem: PlaneMirrorProblem, nests: Nests, taken: int = 0
) -> tuple[Poses, Nests, list[Moved]]:
    """Place and adjust all stations; returns them, the nests used, and what moved.

    ``taken`` degrees of freedom went into the drift that the points are freed of. A nest that
    moved counts as a new nest after the move. Exchanged nests and nests that stand in one place
    are refused with DataError; GeometryError as in
    :func:`~rotcal_ros.methods.plane_mirror.solver.registration.place_stations`.
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
    """Return residuals, cofactors and chi square of the registration at its solution.

    ``taken`` as in :func:`register`.
    """
    _, _, residual = nest_equations(points, nests, weight, poses)
    rotation = poses.rotation[nests.station]
    n, n_stations = len(nests.row), len(poses.rotation)
    full: Floats = block_diag(*(rotation @ weight @ np.swapaxes(rotation, 1, 2)))
    arm = poses.turned(points[nests.row], nests.station)
    design = np.zeros((n, 3, 3 * nests.n_points))
    axes = np.arange(3)
    design[np.arange(n)[:, None], axes, 3 * nests.point[:, None] + axes] = -1.0
    poses_part = pose_jacobian(arm, nests.station, n_stations)
    jacobian = np.concatenate([poses_part, design], axis=2).reshape(3 * n, -1)
    normal = jacobian.T @ full @ jacobian
    cofactor = np.linalg.inv(full) - jacobian @ np.linalg.solve(normal, jacobian.T)
    v = residual.ravel()
    dof = max(3 * n - jacobian.shape[1] - taken, 0)
    return NestFit(residual, full, cofactor, float(v @ full @ v), dof)


def _moved_nest(problem: PlaneMirrorProblem, nests: Nests, fit: NestFit) -> Moved | None:
    """Return the most likely move, if one explains what noise cannot; else None."""
    if fit.dof == 0 or fit.chi_square <= chi2_isf(problem.significance, fit.dof):
        return None
    hypotheses = _hypotheses(problem, nests)
    best: tuple[float, Moved] | None = None
    for members, number, where in hypotheses:
        drop, shift = _gain(fit, members)
        rest = max(1.0, (fit.chi_square - drop) / max(fit.dof - 3, 1))
        if drop / rest > chi2_isf(problem.significance / len(hypotheses), 3) and (
            best is None or drop > best[0]
        ):
            name = nests.name[nests.point[members][0]]
            text = f"nest {name} {where} (by {np.linalg.norm(shift) * 1e3:.3f} mm)"
            best = drop, Moved(members, number, f"{text}; it counts as another nest there")
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
            once = " in one of its rounds" if at.count(at[now]) > 1 else ""
            text = f"stood elsewhere at station {at[now]}{once}"
            found.append((own & (nests.round == seen[now]), seen[now], text))
    return found


def _gain(fit: NestFit, members: Bools) -> tuple[float, Floats]:
    """Drop of chi square and the shift (3,) when the members may stand elsewhere together."""
    select = np.kron(members[:, None].astype(float), np.eye(3))
    weighted = fit.weight @ select
    inner = weighted.T @ fit.cofactor @ weighted
    if np.linalg.eigvalsh(inner)[0] < _MIN_REDUNDANCY * np.trace(select.T @ weighted) / 3.0:
        return 0.0, np.zeros(3)  # too few nests: the rest would not fix the stations
    push = weighted.T @ fit.residual.ravel()
    shift = np.asarray(np.linalg.solve(inner, push), dtype=np.float64)
    return float(push @ shift), shift


def _check_apart(problem: PlaneMirrorProblem, nests: Nests) -> None:
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
    """Compare the distances between nests from station to station; two exchanged show at once."""
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
    """Places (S, K, 3) of nests seen from each station, NaN where not seen."""
    table = np.full((int(problem.station.max()) + 1, nests.n_points, 3), np.nan)
    table[nests.station[::-1], nests.point[::-1]] = problem.xyz[nests.row[::-1]]
    return table


def _distances(points: Floats) -> Floats:
    distances: Floats = np.linalg.norm(points[:, None] - points[None, :], axis=2)
    return distances
