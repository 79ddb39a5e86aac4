"""The lengths as a position by target grid: what can be used, and what is dropped and why.

The flat rows of a problem come in any order and with gaps. On the grid every length has its
place, so that the order of the rows cannot change a single bit of the result.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from rotcal_ros.arrays import Bools, Floats, Ints
from rotcal_ros.errors import DataError
from rotcal_ros.methods.tracer.problem import TracerProblem

STATION_MINIMUM: Final = 5
"""Lengths per station: four unknowns (X, Y, Z, d) and one to check them."""
FREE_TARGET_MINIMUM: Final = 4
"""Lengths per target of a free network: three unknowns and one to check them."""
REACH: Final = 100.0
"""No tracer reaches further (metres): targets that lie further apart are in another unit."""
IMPOSSIBLE_SHARE: Final = 0.25
"""From this share of impossible lengths on, it is the unit or the plan that is wrong."""
MILLIMETRES: Final = 1e-3
"""Below this spread of the lengths, as a share of that of the targets, the units differ."""


@dataclass(frozen=True, eq=False)
class Grid:
    """The usable part of a problem, m table positions (one station each) by n targets.

    ``position_ids`` (m,), ``target_ids`` (n,): indices in the problem. ``row`` (m, n): row of the
    problem that fills the place, -1 for none. ``used`` (m, n): the length takes part.
    ``length``, ``length_std`` (m, n): metres, 0 and 1 where there is none. ``distance_std``
    (m, n): the part of ``length_std`` that grows with the distance, m.
    ``targets``, ``target_std`` (n, 3): metres. ``free``: the targets carry no prior.
    """

    position_ids: Ints
    target_ids: Ints
    row: Ints
    used: Bools
    length: Floats
    length_std: Floats
    distance_std: Floats
    targets: Floats
    target_std: Floats
    free: bool

    @property
    def weights(self) -> Floats:
        """Weights (m, n) of the lengths alone, 1/m^2; zero where unused."""
        return self.used / self.length_std**2


@dataclass(frozen=True, eq=False)
class Absent:
    """Why lengths have no place on a grid, by row of the problem.

    ``repeated``: identical repetitions. ``unfit``: they contradict the triangle inequality, or
    their station has too few lengths left. ``spare``: of targets of a free network with too few
    lengths to place them; nothing speaks against these.
    """

    repeated: dict[int, str]
    unfit: dict[int, str]
    spare: dict[int, str]


def arrange(problem: TracerProblem) -> tuple[Grid, Absent]:
    """Return the grid of ``problem``, and what has no place on it.

    Raises DataError for contradictory repetitions and for lengths that seem to be in another unit
    than the targets.
    """
    absent = Absent({}, {}, {})
    row = _place_rows(problem, absent.repeated)
    _check_unit_of_targets(problem)
    _drop_impossible(problem, row, absent.unfit)
    _drop_undetermined(problem, row, absent)
    positions, targets = (np.flatnonzero((row >= 0).any(axis=axis)) for axis in (1, 0))
    row = row[np.ix_(positions, targets)]
    used = row >= 0
    grid = Grid(
        position_ids=positions,
        target_ids=targets,
        row=row,
        used=used,
        length=np.where(used, problem.length[row], 0.0),
        length_std=np.where(used, problem.length_std[row], 1.0),
        distance_std=np.where(used, problem.distance_std[row], 0.0),
        targets=problem.targets[targets],
        target_std=problem.target_std[targets],
        free=problem.variant == "joint" and problem.datum == "free",
    )
    return grid, absent


def _place_rows(problem: TracerProblem, why: dict[int, str]) -> Ints:
    """Return the row (m, n) that fills each place; the first of identical repetitions stays."""
    shape = (len(problem.table_angles), len(problem.targets))
    place = problem.position * shape[1] + problem.target
    order = np.argsort(place, kind="stable")
    first = np.ones(len(order), dtype=np.bool_)
    first[1:] = np.diff(place[order]) != 0
    keeper = order[np.maximum.accumulate(np.where(first, np.arange(len(order)), 0))]
    for again, kept in zip(order[~first], keeper[~first], strict=True):
        name = f"station {problem.position[kept]}, target {problem.target[kept]}"
        a, b = problem.length[kept], problem.length[again]
        if a != b or problem.length_std[kept] != problem.length_std[again]:
            raise DataError(
                f"rows {kept} and {again} both give a length for {name}, but differ: {a} m and "
                f"{b} m; keep the accepted one, or average them before solving"
            )
        why[int(again)] = f"repeats row {kept} ({name})"
    row = np.full(shape[0] * shape[1], -1, dtype=np.int64)
    row[place[order[first]]] = order[first]
    return row.reshape(shape)


def _check_unit_of_targets(problem: TracerProblem) -> None:
    span = _diagonal(problem.targets)
    if span > REACH:
        raise DataError(
            f"the targets lie up to {span:.4g} m apart, no tracer reaches beyond {REACH:g} m: "
            "are they in millimetres? Metres are expected"
        )


def _drop_impossible(problem: TracerProblem, row: Ints, why: dict[int, str]) -> None:
    """Drop lengths that no position of the tracer can explain.

    Two lengths of one station cannot differ by more than their targets lie apart; the station's
    median stands for the other length, the diagonal of all targets for the distance.
    """
    used = row >= 0
    length = np.where(used, problem.length[row], np.nan)
    measured = used.any(axis=1)
    middle = np.zeros(len(row))
    middle[measured] = np.nanmedian(length[measured], axis=1)
    seen = problem.targets[used.any(axis=0)]
    # The noise of lengths and coordinates may add to the distance; ten of it is never noise.
    span = _diagonal(seen) + 10.0 * problem.length_std.max() + 10.0 * problem.target_std.max()
    excess = np.abs(np.where(used, problem.length[row] - middle[:, None], 0.0))
    _check_unit_of_lengths(excess[used], span)
    for j, i in np.argwhere(excess > span):
        why[int(row[j, i])] = (
            f"station {j}, target {i}: differs by {excess[j, i]:.4g} m from the station's median, "
            f"but the targets lie at most {span:.4g} m apart"
        )
    row[excess > span] = -1


def _check_unit_of_lengths(excess: Floats, span: float) -> None:
    # Most lengths tell the unit: a few may be spikes, and a few targets lie near the median.
    ratio = float(np.quantile(excess, 0.9)) / span
    if np.mean(excess > span) > IMPOSSIBLE_SHARE:
        raise DataError(
            f"the lengths of one station spread over {2 * ratio * span:.4g} m, but the targets "
            f"lie at most {span:.4g} m apart: are the lengths in millimetres? Metres are expected"
        )
    if ratio < MILLIMETRES:
        raise DataError(
            f"the lengths of one station spread over {2 * ratio * span:.4g} m only, but the "
            f"targets lie {span:.4g} m apart: are the targets in millimetres, or all lengths of "
            "one target? Metres are expected"
        )


def _drop_undetermined(problem: TracerProblem, row: Ints, absent: Absent) -> None:
    """Drop targets, then stations, that too few lengths reach; again until nothing changes."""
    free = problem.variant == "joint" and problem.datum == "free"
    minima = {"target": FREE_TARGET_MINIMUM if free else 1, "station": STATION_MINIMUM}
    before = -1
    while before != (before := int((row >= 0).sum())):
        for name, minimum in minima.items():
            why = absent.unfit if name == "station" else absent.spare
            table = row if name == "station" else row.T
            count = (table >= 0).sum(axis=1)
            for index in np.flatnonzero((count > 0) & (count < minimum)):
                for dropped in table[index][table[index] >= 0]:
                    why[int(dropped)] = (
                        f"{name} {index} has {count[index]} usable lengths, {minimum} are needed"
                    )
                table[index] = -1


def _diagonal(points: Floats) -> float:
    return float(np.linalg.norm(np.ptp(points, axis=0)))
