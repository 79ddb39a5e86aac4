"""The lengths as a grid of stations by targets, and what the stations share.

A station is one arrival of the table at a position in one run. On the tracer's grid the stations
are its positions, so that its checks of units, repetitions and plausibility hold here too.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final, TypeAlias

import numpy as np
from scipy.sparse import csr_array

from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.errors import DataError, ObservabilityError
from rotcal_ros.geometry.rotations import rotation_about_z
from rotcal_ros.methods.tracer.solver.grid import Grid, arrange
from rotcal_ros.methods.tracer.solver.problem import TracerProblem
from rotcal_ros.methods.tracer_six.solver.problem import SixProblem

IN_A_LINE: Final = 0.02
"""Places whose extent across their longest direction is below this share lie in a line."""


_Arranged: TypeAlias = tuple[Grid, dict[int, str]]


@dataclass(frozen=True, eq=False)
class StationLayout:
    """V stations by n targets: ``grid``, whose positions are the stations, and what they share.

    ``position``, ``place`` (V,): indices into ``angles`` (m,) rad and ``places`` (p, 3) m, which
    are those in use; ``position_ids`` (m,), ``place_ids`` (p,): their indices in the problem.
    ``zero`` (V, n): which of ``n_zeros`` a length has, 0 where there is none; ``offset``
    (n_zeros,), m: by how much the lengths of each are longer here than in the problem, so that
    those of a place differ by centimetres only. ``tilt_std``: prior of the table's tilts, rad, or
    None; ``tilts`` (m, 2): what EAC and EBC are expected to be, rad, None: zero.
    """

    grid: Grid
    position: Ints
    place: Ints
    angles: Floats
    places: Floats
    position_ids: Ints
    place_ids: Ints
    zero: Ints
    offset: Floats
    tilt_std: float | None
    tilts: Floats | None = None

    @property
    def n_zeros(self) -> int:
        """The number of zeros."""
        return len(self.offset)

    @cached_property
    def most(self) -> Bools:
        """Tells the lengths (V, n) that have the commonest zero of their station."""
        if (self.zero == self.zero[:, :1]).all():
            return self.grid.used
        pair = np.arange(len(self.zero))[:, None] * self.n_zeros + self.zero
        count = np.bincount(pair[self.grid.used], minlength=len(self.zero) * self.n_zeros)
        commonest = np.argmax(count.reshape(len(self.zero), -1), axis=1)
        return np.asarray(self.grid.used & (self.zero == commonest[:, None]))

    @cached_property
    def by_position(self) -> Floats:
        """Adds up stations by position, (m, V)."""
        return _one_hot(self.position, len(self.angles))

    @cached_property
    def by_place(self) -> Floats:
        """Adds up stations by place, (p, V)."""
        return _one_hot(self.place, len(self.places))

    @cached_property
    def pairs(self) -> tuple[Ints, Ints, Any]:
        """Stations and zeros that have lengths together, and what adds up lengths by them."""
        station = np.repeat(np.arange(len(self.position)), self.zero.shape[1])
        key = station * self.n_zeros + self.zero.ravel()
        seen, inverse = np.unique(key, return_inverse=True)
        return seen // self.n_zeros, seen % self.n_zeros, _sums(inverse, len(seen))

    @cached_property
    def by_zero_and_target(self) -> Any:
        """Adds up lengths (V n,) by zero and target, (S n, V n)."""
        n = self.zero.shape[1]
        return _sums((self.zero * n + np.arange(n)).ravel(), self.n_zeros * n)

    @property
    def size(self) -> int:
        """The number of unknowns beside the poses: targets, places, zeros, the tilts' frame."""
        tilts = 0 if self.tilt_std is None else 4
        return 3 * len(self.grid.targets) + 3 * len(self.places) + self.n_zeros + tilts

    def station_name(self, station: int) -> str:
        """Return what a station is, for messages."""
        place = self.place_ids[self.place[station]]
        return f"place {place}, position {self.position_ids[self.position[station]]}"


def _one_hot(index: Ints, size: int) -> Floats:
    return np.asarray(index == np.arange(size)[:, None], dtype=np.float64)


def _sums(index: Ints, size: int) -> Any:
    ones = np.ones(len(index))
    return csr_array((ones, (index, np.arange(len(index)))), shape=(size, len(index)))


def lay_out(problem: SixProblem) -> tuple[StationLayout, dict[int, str]]:
    """Return the layout of ``problem``, and why rows have no place in it.

    Raises ObservabilityError when places are too few or in a line, DataError for contradictory
    lengths and wrong units.
    """
    _check_places(problem, np.unique(problem.place))
    problem, offset = _aligned(problem)
    stations, row_station = _stations(problem)
    grid, why = _arranged(problem, stations, row_station, np.arange(len(problem.length)))
    while poor := _poor(problem, grid, stations):
        why |= poor
        rows = np.setdiff1d(grid.row[grid.row >= 0], list(poor))
        grid, more = _arranged(problem, stations, row_station, rows)
        why |= more
    _check_places(problem, np.unique(stations[grid.position_ids, 0]))
    place_ids, place = np.unique(stations[grid.position_ids, 0], return_inverse=True)
    position_ids, position = np.unique(stations[grid.position_ids, 1], return_inverse=True)
    zero, offset = _zeros(problem, grid, place, offset)
    layout = StationLayout(
        grid=grid,
        position=position,
        place=place,
        angles=problem.table_angles[position_ids],
        places=problem.places[place_ids],
        position_ids=position_ids,
        place_ids=place_ids,
        zero=zero,
        offset=offset,
        tilt_std=problem.tilt_std,
    )
    return layout, why


def renamed(text: str, names: dict[int, str]) -> str:
    """Return a text of the tracer's with its stations called by their ``names``."""
    return re.sub(r"\bstation (\d+)", lambda found: names[int(found[1])], text)


def _stations(problem: SixProblem) -> tuple[Ints, Ints]:
    """Return place, position and arrival of each station (V, 3), and the station of each row."""
    arrival = np.zeros_like(problem.place) if problem.arrival is None else problem.arrival
    columns = np.column_stack([problem.place, problem.position, arrival])
    stations, row_station = np.unique(columns, axis=0, return_inverse=True)
    return stations, row_station.ravel()


def _as_tracer(
    problem: SixProblem, stations: Ints, row_station: Ints, rows: Ints
) -> TracerProblem:
    return TracerProblem(
        position=row_station[rows],
        target=problem.target[rows],
        length=problem.length[rows],
        length_std=problem.length_std[rows],
        targets=problem.targets,
        target_std=problem.target_std,
        table_angles=problem.table_angles[stations[:, 1]],
        variant="joint",
        datum=problem.datum,
        distance_std=problem.distance_std[rows],
        settings=problem.settings,
    )


def _aligned(problem: SixProblem) -> tuple[SixProblem, Floats]:
    """Return ``problem`` with all segments of a place counted from about the zero of the first.

    And by how much each length (k,) has become longer, m. A counter that starts anew may read
    metres less; the nominal places tell that to the centimetre.
    """
    offset = np.zeros(len(problem.length))
    if problem.segment is None:
        return problem, offset
    turn = rotation_about_z(problem.table_angles)[problem.position]
    station = (turn @ problem.places[problem.place][:, :, None])[:, :, 0]
    distance = np.linalg.norm(problem.targets[problem.target] - station, axis=1)
    for place in np.unique(problem.place):
        here = problem.place == place
        segments = np.unique(problem.segment[here])
        zeros = [
            float(np.median((distance - problem.length)[here & (problem.segment == segment)]))
            for segment in segments
        ]
        for segment, zero in zip(segments[1:], zeros[1:], strict=True):
            offset[here & (problem.segment == segment)] = zero - zeros[0]
    return replace(problem, length=problem.length + offset), offset


def _zeros(problem: SixProblem, grid: Grid, place: Ints, offset: Floats) -> tuple[Ints, Floats]:
    """Return the zero (V, n) of each length, and the ``offset`` (k,) of the rows by zero (s,)."""
    shape = grid.used.shape
    if problem.segment is None:
        per_station = problem.zero == "per_station"
        own = np.arange(shape[0]) if per_station else place
        return np.broadcast_to(own[:, None], shape), np.zeros(int(own.max()) + 1)
    there = grid.row >= 0
    rows = grid.row[there]
    _, first, inverse = np.unique(problem.segment[rows], return_index=True, return_inverse=True)
    zero = np.zeros(shape, dtype=np.int64)
    zero[there] = inverse
    # a place of the grid without a length belongs to a zero that its station has anyway
    some = zero[np.arange(shape[0]), np.argmax(there, axis=1)]
    return np.where(there, zero, some[:, None]), offset[rows[first]]


def _arranged(problem: SixProblem, stations: Ints, row_station: Ints, rows: Ints) -> _Arranged:
    """Return the grid of some rows of ``problem``, and why others of them have no place."""
    names = {s: f"place {k}, position {i}" for s, (k, i, _) in enumerate(stations.tolist())}
    try:
        grid, absent = arrange(_as_tracer(problem, stations, row_station, rows))
    except DataError as error:
        raise DataError(renamed(str(error), names)) from None
    grid = replace(grid, row=np.where(grid.row >= 0, rows[grid.row], -1))
    why = absent.repeated | absent.unfit | absent.spare
    return grid, {int(rows[row]): renamed(text, names) for row, text in why.items()}


def _poor(problem: SixProblem, grid: Grid, stations: Ints) -> dict[int, str]:
    """Return why rows of ``grid`` are of no use: too few places at their position."""
    why = {}
    positions = stations[grid.position_ids, 1]
    for position in np.unique(positions).tolist():
        here = positions == position
        seen = np.unique(stations[grid.position_ids[here], 0])
        if lost_direction(problem.places[seen]) is None:
            continue
        if problem.tilt_std is not None and len(seen) > 1:
            continue
        names = ", ".join(map(str, seen.tolist()))
        text = f"position {position} has usable lengths from place(s) {names} only"
        for row in grid.row[here][grid.row[here] >= 0].tolist():
            why[row] = f"{text}: three that are not in a line are needed"
    if len(why) == np.count_nonzero(grid.row >= 0):
        raise ObservabilityError(
            "no table position was measured from three places that are not in a line: repeat the "
            "run with the tracer at other places, 120 degrees apart"
        )
    return why


def lost_direction(places: Floats) -> Floats | None:
    """Return the direction (3,) about which lengths from ``places`` (p, 3) tell no turn, or None.

    c_i = s_i Rz e, with e along the line of the places and the d_i to match, moves no station.
    """
    if len(places) < 2:
        return np.array([0.0, 0.0, 1.0])
    _, extent, axes = np.linalg.svd(places - places.mean(axis=0))
    if len(places) > 2 and extent[1] > IN_A_LINE * extent[0]:
        return None
    return np.asarray(axes[0] * np.sign(axes[0][np.argmax(np.abs(axes[0]))]), dtype=np.float64)


def _check_places(problem: SixProblem, used: Ints) -> None:
    places = problem.places[used]
    lost = lost_direction(places)
    if lost is None:
        return
    if len(used) < 2:
        raise ObservabilityError(
            f"lengths from {len(used)} place on the table tell the path of a point, and no turn "
            "about it: place the tracer at three places, 120 degrees apart"
        )
    if np.ptp(places, axis=0).max() == 0.0:
        raise DataError("all places on the table are at the same coordinates: check the table")
    if problem.tilt_std is None:
        how = "two places" if len(used) == 2 else f"{len(used)} places in a line"
        x, y, z = lost
        raise ObservabilityError(
            f"{how} never tell the turn of the table about the line through them, along "
            f"({x:.2f}, {y:.2f}, {z:.2f}) in the table's frame: it moves neither; measure from a "
            "third place beside that line, or state the standard deviation of the tilts (tilt_std)"
        )
