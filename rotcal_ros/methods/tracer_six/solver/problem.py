"""What the six-deviations method is asked: lengths of a tracer that stood at several places."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, get_args

import numpy as np
from numpy.typing import NDArray

from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.errors import ConfigurationError, DataError
from rotcal_ros.methods.columns import broadcast, indices, matrix, require, vector
from rotcal_ros.methods.tracer.solver.effects import share_gone
from rotcal_ros.methods.tracer.solver.grid import Grid
from rotcal_ros.methods.tracer.solver_settings import Datum, TracerLimits
from rotcal_ros.methods.tracer_six.solver_settings import TracerSixSolverSettings, Zero

_DEFAULTS: Final = TracerSixSolverSettings()
_LATEST: Final = 2**62


@dataclass(frozen=True, eq=False)
class SixProblem:
    """Lengths of a tracer on the table, one run for each place where it stood.

    Row r is the length ``length[r]`` (k,) to ``target[r]`` (k,), an index into ``targets``
    (n, 3), while the table stood at ``position[r]`` (k,), an index into ``table_angles`` (m,),
    and the tracer at ``place[r]`` (k,), an index into ``places`` (p, 3). Rows come in any order.

    ``length``: readings in m, growing with distance, from an unknown zero; ``length_std`` (k,) or
    one number, m: its standard deviation; ``distance_std`` (k,) or one number, below it: the part
    that grows with the distance, m, which joins the rest in squares.
    ``targets``: places of the reflector in the machine's frame, m, the same in all runs;
    ``target_std``: their standard deviation, one number, three, or (n, 3). ``datum`` "prior"
    weighs them by it, "free" takes them as start values only.
    ``table_angles``: commanded, rad, counter-clockwise about +z. ``upward`` (m,): from which side
    the table came to each position, where it came from both.
    ``places``: where the tracer stands on the table, m, in the frame that turns with it and
    coincides with the machine's at angle zero: good to ``place_tolerance``, m; start values, and
    what tells how the positions are numbered (the tracer's ``Numbering``).
    Machine z along the table axis, origin near it (10 mrad and 10 mm are taken exactly); the
    deviations are those of the point of the axis at z = 0.

    ``zero`` tells which lengths share a zero: those of a run ("per_run"), of a station, which is
    a place at a position ("per_station"), or of equal ``segment`` (k,), whole numbers
    ("per_segment", and only then).

    ``scatter_translation_std`` (m) and ``scatter_rotation_std`` (rad): how differently the table
    arrives at the same angle, run by run; zero: known to repeat; None: estimated. ``arrival``
    (k,): numbers that tell the arrivals at one angle in one run; lengths of different arrivals
    have their own scatter. ``tilt_std`` (rad): prior knowledge of EAC and EBC, which two
    places, or three in a line, need. ``order`` (k,): when each length was taken, in any growing
    numbers; without it run follows run and angle follows angle. ``slip``: a fringe (m) by which
    the counter may slip unseen, which the uncertainty allows for; 0: no jump of a zero is looked
    for.

    A pair of station and target has one length in each arrival. Raises DataError for values that
    are not finite, indices out of range and standard deviations that are not positive,
    ConfigurationError for unknown names.
    """

    position: Ints
    place: Ints
    target: Ints
    length: Floats
    length_std: Floats
    targets: Floats
    target_std: Floats
    table_angles: Floats
    places: Floats
    datum: Datum = _DEFAULTS.datum
    zero: Zero = "per_run"
    segment: Ints | None = None
    scatter_translation_std: float | None = _DEFAULTS.scatter_translation_std_m
    scatter_rotation_std: float | None = _DEFAULTS.scatter_rotation_std_rad
    arrival: Ints | None = None
    tilt_std: float | None = _DEFAULTS.tilt_std_rad
    distance_std: Floats = 0.0  # type: ignore[assignment]
    order: Ints | None = None
    slip: float = _DEFAULTS.slip_m
    place_tolerance: float = 0.01
    upward: Bools | None = None
    settings: TracerLimits = _DEFAULTS

    def __post_init__(self) -> None:
        self._check_names()
        angles = self._store("table_angles", vector("table_angles", self.table_angles))
        if self.upward is not None and np.shape(self.upward) != angles.shape:
            raise DataError(
                f"upward has shape {np.shape(self.upward)}, expected a side for each of the "
                f"{len(angles)} table_angles"
            )
        places = self._store("places", matrix("places", self.places))
        targets = self._store("targets", matrix("targets", self.targets))
        position = self._store("position", indices("position", self.position, len(angles)))
        k = len(position)
        self._store("place", indices("place", self.place, len(places), k))
        self._store("target", indices("target", self.target, len(targets), k))
        length = self._store("length", vector("length", self.length, k))
        std = broadcast("length_std", self.length_std, length.shape)
        self._store("length_std", require(std > 0.0, std, "length_std", "a positive number"))
        std = broadcast("distance_std", self.distance_std, length.shape)
        inside = (std >= 0.0) & (std < self.length_std)
        self._store("distance_std", require(inside, std, "distance_std", "0 to below length_std"))
        std = np.asarray(self.target_std, dtype=np.float64)
        std = np.broadcast_to(std, targets.shape) if std.shape == (3,) else std
        std = broadcast("target_std", std, targets.shape)
        self._store("target_std", require(std > 0.0, std, "target_std", "a positive number"))
        for name in ("segment", "arrival", "order"):
            if getattr(self, name) is not None:
                self._store(name, indices(name, getattr(self, name), _LATEST, k))

    @property
    def measuring_order(self) -> Ints:
        """When each length (k,) was taken: ``order``, or else run by run and angle by angle."""
        if self.order is not None:
            return self.order
        arrival = np.zeros_like(self.place) if self.arrival is None else self.arrival
        return np.lexsort((self.target, self.position, arrival, self.place)).argsort()

    def _check_names(self) -> None:
        names = {"datum": get_args(Datum), "zero": get_args(Zero)}
        for name, known in names.items():
            if getattr(self, name) not in known:
                raise ConfigurationError(
                    f"{name} {getattr(self, name)!r} is unknown: expected one of {known}"
                )
        if (self.zero == "per_segment") != (self.segment is not None):
            raise DataError(
                f"zero is {self.zero!r} and segment is "
                f"{'given' if self.segment is not None else 'missing'}: the numbers of the "
                "segments belong to zero='per_segment', and to nothing else"
            )
        for name in ("scatter_translation_std", "scatter_rotation_std", "tilt_std"):
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and value >= 0.0):
                raise ConfigurationError(f"{name} is {value}, expected zero or more, or None")
        if not (np.isfinite(self.slip) and self.slip >= 0.0):
            raise ConfigurationError(f"slip is {self.slip}, expected zero or more metres")
        if not (np.isfinite(self.place_tolerance) and self.place_tolerance > 0.0):
            raise ConfigurationError(
                f"place_tolerance is {self.place_tolerance}, expected a positive number of metres"
            )
        if self.tilt_std == 0.0:
            raise ConfigurationError("tilt_std is 0, expected a positive number, or None")

    def _store(self, name: str, values: NDArray[Any]) -> NDArray[Any]:
        values.setflags(write=False)
        object.__setattr__(self, name, values)
        return values


@dataclass(frozen=True, eq=False)
class NetworkTiming:
    """Shares (V, n), 0 to 1, that had gone of all runs, and of the own run."""

    whole: Floats
    own: Floats


def timing(problem: SixProblem, grid: Grid) -> NetworkTiming:
    """Return when the lengths of ``grid`` were taken; see SixProblem.order."""
    order = problem.measuring_order
    own = np.zeros(len(order))
    for place in np.unique(problem.place):
        here = problem.place == place
        own[here] = share_gone(order[here])
    return NetworkTiming(grid.placed(share_gone(order)), grid.placed(own))
