"""Which rows belong together: pairs, the groups that give one normal each, and nests."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.observations import PointKind
from rotcal_ros.methods.plane_mirror.solver.problem import PlaneMirrorProblem


@dataclass(frozen=True)
class MirrorPairs:
    """Direct and mirrored rows (P,) of one reflector each, sorted by group.

    A group is one table position seen from one tracker station: ``position`` and ``station``
    (G,); ``group`` (P,) tells the group of each pair and ``start`` (G,) its first pair.
    """

    direct: Ints
    mirrored: Ints
    group: Ints
    start: Ints
    position: Ints
    station: Ints

    @property
    def n_groups(self) -> int:
        """Number of groups, that is, of normals."""
        return len(self.position)

    def stations(self, angles: Floats) -> Iterator[tuple[int, Ints, Floats]]:
        """Yield each station, its groups, and where ``angles`` (N,) send the table for them."""
        for station in np.unique(self.station):
            at = np.flatnonzero(self.station == station)
            yield int(station), at, angles[self.position[at]]

    def keep(self, wanted: Bools) -> MirrorPairs:
        """Return the pairs (P,) that are wanted, without the groups that become empty."""
        groups, group = np.unique(self.group[wanted], return_inverse=True)
        return MirrorPairs(
            direct=self.direct[wanted],
            mirrored=self.mirrored[wanted],
            group=group.astype(np.int64),
            start=_starts(group, len(groups)),
            position=self.position[groups],
            station=self.station[groups],
        )


@dataclass(frozen=True)
class Nests:
    """Nest rows (Q,) sorted by ``point`` (Q,), the index of the fixed nest; see ``name`` (K,).

    A nest that was moved in between counts as two points of the same name. ``round`` (Q,) counts
    the rounds of nests of all stations in the order in which they were measured.
    """

    row: Ints
    station: Ints
    round: Ints
    point: Ints
    start: Ints
    name: Ints

    @property
    def n_points(self) -> int:
        """Number of fixed points."""
        return len(self.name)

    def split(self, moved: Bools) -> Nests:
        """Return nests in which the rows (Q,) marked as moved belong to a new point."""
        point = np.where(moved, self.n_points, self.point)
        name = np.append(self.name, self.name[self.point[moved][0]])
        return _nests(self.row, self.station, self.round, point, name)


@dataclass(frozen=True)
class Reflectors:
    """Direct rows (M,) of reflectors that the table carries, sorted by reflector."""

    row: Ints
    position: Ints
    station: Ints
    reflector: Ints
    name: Ints

    def circles(self, angles: Floats) -> Iterator[tuple[Ints, Floats]]:
        """Yield which entries belong to each reflector, and where ``angles`` (N,) send them."""
        for reflector in range(len(self.name)):
            at = np.flatnonzero(self.reflector == reflector)
            yield at, angles[self.position[at]]


def find_pairs(problem: PlaneMirrorProblem) -> MirrorPairs:
    """Match direct and mirrored rows; repeated measurements are matched in their order.

    Raises DataError when one of a pair is missing, naming position, station and nest.
    """
    rows: defaultdict[tuple[int, int, int], tuple[list[int], list[int]]]
    rows = defaultdict(lambda: ([], []))
    for row in np.flatnonzero(problem.kind != PointKind.NEST):
        key = (problem.position[row], problem.station[row], problem.nest[row])
        rows[key][int(problem.kind[row] == PointKind.MIRRORED)].append(int(row))
    if not rows:
        raise DataError(f"{problem.source}: no direct and mirrored points, nothing to compute")
    for key, (near, far) in rows.items():
        if len(near) != len(far):
            raise DataError(_unpaired(problem, key, len(near), len(far)))
    keys = sorted(rows)
    direct = np.array([row for key in keys for row in rows[key][0]], dtype=np.int64)
    mirrored = np.array([row for key in keys for row in rows[key][1]], dtype=np.int64)
    places = np.column_stack([problem.position[direct], problem.station[direct]])
    group_places, group = np.unique(places, axis=0, return_inverse=True)
    group = group.ravel().astype(np.int64)
    return MirrorPairs(
        direct=direct,
        mirrored=mirrored,
        group=group,
        start=_starts(group, len(group_places)),
        position=group_places[:, 0],
        station=group_places[:, 1],
    )


def find_nests(problem: PlaneMirrorProblem) -> Nests:
    """Collect the nest rows; a nest of one round only joins nothing and is left out."""
    rows, rounds = np.flatnonzero(problem.kind == PointKind.NEST), nest_rounds(problem)
    seen = {
        int(name): set(rounds[rows[problem.nest[rows] == name]].tolist())
        for name in np.unique(problem.nest[rows])
    }
    joined = [len(seen[int(name)]) > 1 for name in problem.nest[rows]]
    rows = rows[np.array(joined, dtype=np.bool_)]
    names, point = np.unique(problem.nest[rows], return_inverse=True)
    return _nests(rows, problem.station[rows], rounds[rows], point, names)


def nest_rounds(problem: PlaneMirrorProblem) -> Ints:
    """Return the number (n,) of the round of nests that each row belongs to, -1 if to none.

    Rounds count from 0 over all stations. Nests of one station with nothing else measured in
    between are one round.
    """
    rounds = np.full(len(problem.xyz), -1, dtype=np.int64)
    begun = 0
    for station in range(int(problem.station.max()) + 1):
        rows = np.flatnonzero(problem.station == station)
        rows = rows[np.argsort(problem.moment[rows], kind="stable")]
        is_nest = problem.kind[rows] == PointKind.NEST
        begins = is_nest & ~np.append(False, is_nest[:-1])
        rounds[rows[is_nest]] = begun + np.cumsum(begins)[is_nest] - 1
        begun += int(begins.sum())
    return rounds


def find_reflectors(problem: PlaneMirrorProblem) -> Reflectors:
    """Collect the reflectors on the table for the direct way.

    Raises DataError when there are mirrored rows, which this way has no use for.
    """
    mirrored = np.flatnonzero(problem.kind == PointKind.MIRRORED)
    if len(mirrored):
        raise DataError(
            f"{problem.source}: {problem.row_name(int(mirrored[0]))} in the direct way; here the "
            "table carries the reflectors and there is no mirror: choose stitching, registration "
            "or joint"
        )
    rows = np.flatnonzero(problem.kind == PointKind.DIRECT)
    if not len(rows):
        raise DataError(f"{problem.source}: no direct points, nothing to compute")
    names, reflector = np.unique(problem.nest[rows], return_inverse=True)
    order = np.lexsort([rows, problem.position[rows], reflector])
    rows, reflector = rows[order], reflector[order]
    return Reflectors(rows, problem.position[rows], problem.station[rows], reflector, names)


def _nests(row: Ints, station: Ints, rounds: Ints, point: Ints, name: Ints) -> Nests:
    used, point = np.unique(point, return_inverse=True)
    order = np.lexsort([row, station, point])
    point = point[order].astype(np.int64)
    return Nests(
        row=row[order],
        station=station[order],
        round=rounds[order],
        point=point,
        start=_starts(point, len(used)),
        name=name[used],
    )


def _starts(sorted_index: Ints, count: int) -> Ints:
    return np.searchsorted(sorted_index, np.arange(count)).astype(np.int64)


def _unpaired(
    problem: PlaneMirrorProblem, key: tuple[int, int, int], n_direct: int, n_mirrored: int
) -> str:
    position, station, nest = key
    return (
        f"{problem.source}: {problem.position_name(position)}, tracker station "
        f"{problem.station_name(station)}, nest {nest}: {n_direct} direct and {n_mirrored} "
        "mirrored points, expected as many of both; measure the missing one or take the row out"
    )
