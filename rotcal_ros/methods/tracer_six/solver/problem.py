"""What the six-deviations method is asked, and its lengths as a grid of stations by targets.

A tracer stood at several places. A station is one arrival of the table at a position in one run.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final, get_args

import numpy as np

from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.errors import DataError, ObservabilityError
from rotcal_ros.foundation.language import Phrase, noted, phrase
from rotcal_ros.methods.tracer.solver.problem import (
    Grid,
    LengthProblem,
    arrange_grid,
    finite_matrix,
    require_all,
    station_minimum,
    valid_indices,
)
from rotcal_ros.methods.tracer_six.settings import TracerSixSolverSettings, Zero

FEW_PLACES: Final = noted(
    "position {0} has usable lengths from place(s) {1} only: three that are not in a line are "
    "needed"
)

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
    arrivals have their own scatter. Where the table turns, they tell how often the same length was
    measured before. ``tilt_std`` (rad): prior knowledge of EAC and EBC, which two
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
        require_all(std > 0.0, std, "target_std", "a positive number")
        places = self._store("places", finite_matrix("places", self.places))
        self._store("place", valid_indices("place", self.place, len(places), k))
        self._store_numbers("arrival")

    @cached_property
    def _stations(self) -> tuple[Ints, Ints]:
        """Place, position and arrival of each station (v, 3), and the station of each row (k,)."""
        arrival = self.arrival
        if arrival is None or self.speed is not None:  # a table that passes does not arrive
            arrival = np.zeros_like(self.place)
        columns = np.column_stack([self.place, self.position, arrival])
        stations, row = np.unique(columns, axis=0, return_inverse=True)
        return stations, row.ravel()

    @property
    def stations(self) -> Ints:
        """Place, position and arrival of each station (v, 3)."""
        return self._stations[0]

    @property
    def station(self) -> Ints:
        """At which station each length (k,) was taken."""
        return self._stations[1]

    @property
    def earlier(self) -> Ints:
        """How often the same was measured before each length (k,): the number of its arrival."""
        arrival = np.zeros_like(self.place) if self.arrival is None else self.arrival
        return np.unique(arrival, return_inverse=True)[1].ravel()

    @property
    def counted(self) -> Ints:
        """Numbers (k,) of what shares a zero: a segment, a station or a run."""
        if self.segment is not None:
            return self.segment
        return self.station if self.zero == "per_station" else self.place

    @property
    def own_zero(self) -> bool:
        """Whether each station has a zero to itself."""
        return self.zero == "per_station"

    @property
    def station_minimum(self) -> int:
        """How many lengths a station needs: as many as one that stands alone has unknowns.

        The zero of a turn is known from its other angles.
        """
        return station_minimum(own_zero=self.speed is None, on_circle=False)

    def station_name(self, station: int | np.integer) -> Phrase:
        """Return what a station is, for messages."""
        place, position, _ = self.stations[station]
        return phrase("place {0}, position {1}", place, position)

    @property
    def measuring_order(self) -> Ints:
        """When each length (k,) was taken: ``order``, or else run by run and angle by angle."""
        if self.order is not None:
            return self.order
        arrival = np.zeros_like(self.place) if self.arrival is None else self.arrival
        return np.lexsort((self.target, self.position, arrival, self.place)).argsort()


IN_A_LINE: Final = 0.02
"""Places whose extent across their longest direction is below this share lie in a line."""


@dataclass(frozen=True, eq=False)
class StationLayout:
    """A ``grid`` of a problem, and where its V stations are.

    ``position``, ``place`` (V,): indices into ``angles`` (m,) rad and ``places`` (p, 3) m, which
    are those in use; ``position_ids`` (m,), ``place_ids`` (p,): their indices in the problem.
    """

    grid: Grid
    position: Ints
    place: Ints
    angles: Floats
    places: Floats
    position_ids: Ints
    place_ids: Ints


def lay_out(problem: SixProblem) -> tuple[StationLayout, dict[int, Phrase]]:
    """Return the layout of ``problem``, and why rows have no place in it.

    Raises ObservabilityError when places are too few or in a line, DataError for contradictory
    lengths and wrong units.
    """
    _check_places(problem, np.unique(problem.place))
    why, poor = dict[int, Phrase](), dict[int, Phrase]()
    while True:
        grid, absent = arrange_grid(problem, poor)
        why |= absent.repeated | absent.unfit | absent.spare
        if not (more := _poor(problem, grid)):
            break
        poor |= more
    stations = problem.stations[grid.position_ids]
    place_ids, place = np.unique(stations[:, 0], return_inverse=True)
    position_ids, position = np.unique(stations[:, 1], return_inverse=True)
    _check_places(problem, place_ids)
    layout = StationLayout(
        grid=grid,
        position=position,
        place=place,
        angles=problem.table_angles[position_ids],
        places=problem.places[place_ids],
        position_ids=position_ids,
        place_ids=place_ids,
    )
    return layout, why | poor


def _poor(problem: SixProblem, grid: Grid) -> dict[int, Phrase]:
    """Return why rows of ``grid`` are of no use: too few places at their position."""
    why = {}
    place, positions, _ = problem.stations[grid.position_ids][grid.station].T
    for position in np.unique(positions).tolist():
        here = positions == position
        seen = np.unique(place[here])
        if lost_direction(problem.places[seen]) is None:
            continue
        if problem.tilt_std is not None and len(seen) > 1:
            continue
        names = ", ".join(map(str, seen.tolist()))
        text = phrase(FEW_PLACES, position, names)
        for row in grid.row[here][grid.row[here] >= 0].tolist():
            why[row] = text
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
