"""What the six-deviations method is asked, and its lengths as a grid of stations by targets.

A tracer stood at several places. A station is one arrival of the table at a position in one run.
On the tracer's grid the stations are its positions, so that its checks of units, repetitions and
plausibility hold here too.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, TypeAlias, get_args

import numpy as np

from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.errors import DataError, ObservabilityError
from rotcal_ros.geometry.rotations import rotation_about_z
from rotcal_ros.methods.columns import indices, matrix, require
from rotcal_ros.methods.tracer.solver.problem import (
    Grid,
    LengthProblem,
    TracerProblem,
    arrange,
)
from rotcal_ros.methods.tracer_six.settings import TracerSixSolverSettings, Zero

_DEFAULTS: Final = TracerSixSolverSettings()


@dataclass(frozen=True, eq=False, kw_only=True)
class SixProblem(LengthProblem):
    """Lengths of a tracer on the table, one run for each place where it stood.

    ``place`` (k,): where the tracer stood, an index into ``places`` (p, 3): where that is on the
    table, m, in the frame that turns with it and coincides with the machine's at angle zero: good
    to ``place_tolerance``, m; start values, and what shows how the positions are numbered (the
    tracer's ``Numbering``). Targets are the same in all runs. ``upward`` (m,): from which side the
    table came to each position, where it came from both.
    Machine z along the table axis, origin near it (10 mrad and 10 mm are taken exactly); the
    deviations are those of the point of the axis at z = 0.

    ``zero`` says which lengths share a zero: those of a run ("per_run"), of a station, which is
    a place at a position ("per_station"), or of equal ``segment`` ("per_segment", and only then).

    ``scatter_translation_std`` (m) and ``scatter_rotation_std`` (rad): how differently the table
    arrives at the same angle, run by run; zero: known to repeat; None: estimated. ``arrival``
    (k,): numbers that distinguish the arrivals at one angle in one run; lengths of different
    arrivals have their own scatter. ``tilt_std`` (rad): prior knowledge of EAC and EBC, which two
    places, or three in a line, need. Without ``order`` run follows run and angle follows angle.
    ``slip`` 0: no jump of a zero is searched for.

    A pair of station and target has one length in each arrival.
    """

    place: Ints
    places: Floats
    zero: Zero = "per_run"
    scatter_translation_std: float | None = _DEFAULTS.scatter_translation_std_m
    scatter_rotation_std: float | None = _DEFAULTS.scatter_rotation_std_rad
    arrival: Ints | None = None
    tilt_std: float | None = _DEFAULTS.tilt_std_rad
    place_tolerance: float = 0.01
    upward: Bools | None = None

    def __post_init__(self) -> None:
        """Check places, arrivals and zeros, too."""
        self._require_known("zero", get_args(Zero))
        self._require_sizes("scatter_translation_std", "scatter_rotation_std")
        self._require_sizes("place_tolerance", "tilt_std", positive=True)
        if (self.zero == "per_segment") != (self.segment is not None):
            raise DataError(
                f"zero is {self.zero!r} and segment is "
                f"{'given' if self.segment is not None else 'missing'}: the numbers of the "
                "segments belong to zero='per_segment', and to nothing else"
            )
        super().__post_init__()
        if self.upward is not None and np.shape(self.upward) != self.table_angles.shape:
            raise DataError(
                f"upward has shape {np.shape(self.upward)}, expected a side for each of the "
                f"{len(self.table_angles)} table_angles"
            )
        std, k = self.target_std, len(self.position)
        require(std > 0.0, std, "target_std", "a positive number")
        places = self._store("places", matrix("places", self.places))
        self._store("place", indices("place", self.place, len(places), k))
        self._store_numbers("arrival")

    @property
    def measuring_order(self) -> Ints:
        """When each length (k,) was taken: ``order``, or else run by run and angle by angle."""
        if self.order is not None:
            return self.order
        arrival = np.zeros_like(self.place) if self.arrival is None else self.arrival
        return np.lexsort((self.target, self.position, arrival, self.place)).argsort()


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
    those of a place differ by centimetres only.
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

    @property
    def n_zeros(self) -> int:
        """The number of zeros."""
        return len(self.offset)

    @cached_property
    def most(self) -> Bools:
        """The lengths (V, n) that have the commonest zero of their station."""
        if (self.zero == self.zero[:, :1]).all():
            return self.grid.used
        pair = np.arange(len(self.zero))[:, None] * self.n_zeros + self.zero
        count = np.bincount(pair[self.grid.used], minlength=len(self.zero) * self.n_zeros)
        most_frequent = np.argmax(count.reshape(len(self.zero), -1), axis=1)
        return np.asarray(self.grid.used & (self.zero == most_frequent[:, None]))

    @cached_property
    def by_place(self) -> Floats:
        """Adds up stations by place, (p, V)."""
        return np.asarray(self.place == np.arange(len(self.places))[:, None], dtype=np.float64)

    def station_name(self, station: int) -> str:
        """Return what a station is, for messages."""
        place = self.place_ids[self.place[station]]
        return f"place {place}, position {self.position_ids[self.position[station]]}"

    def named(self, text: str) -> str:
        """Return a text with the stations called by their names."""
        return renamed(text, dict(enumerate(map(self.station_name, range(len(self.position))))))


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
        settings=problem.settings,
    )


def _aligned(problem: SixProblem) -> tuple[SixProblem, Floats]:
    """Return ``problem`` with all segments of a place counted from about the zero of the first.

    And by how much each length (k,) has become longer, m. A counter that starts anew may read
    metres less; the nominal places show that to the centimetre.
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
    """Return the direction (3,) about which lengths from ``places`` (p, 3) show no turn, or None.

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
            f"lengths from {len(used)} place on the table show the path of a point, and no turn "
            "about it: place the tracer at three places, 120 degrees apart"
        )
    if np.ptp(places, axis=0).max() == 0.0:
        raise DataError("all places on the table are at the same coordinates: check the table")
    if problem.tilt_std is None:
        how = "two places" if len(used) == 2 else f"{len(used)} places in a line"
        x, y, z = lost
        raise ObservabilityError(
            f"{how} never show the turn of the table about the line through them, along "
            f"({x:.2f}, {y:.2f}, {z:.2f}) in the table's frame: it moves neither; measure from a "
            "third place beside that line, or state the standard deviation of the tilts (tilt_std)"
        )
