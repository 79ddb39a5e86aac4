"""What the length methods are asked, and its lengths as a strip by target grid.

The flat rows of a problem come in any order and with gaps. On the grid every length has its
place, so that the order of the rows cannot change a single bit of the result; what has none is
reported, and why.

A *strip* is what a station has measured from one zero. Where every station has a zero of its own,
strips are stations; where zeros belong to segments of unbroken beam, a station has as many strips
as segments, and a segment as many as stations.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final, NamedTuple, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.errors import ConfigurationError, DataError
from rotcal_ros.foundation.language import Phrase, noted, phrase
from rotcal_ros.foundation.units import DEGREE
from rotcal_ros.methods.tracer.settings import (
    Datum,
    TracerLimits,
    TracerSolverSettings,
    Variant,
)

TOO_FAR: Final = noted(
    "{0}, target {1}: differs by {2:.4g} m from the station's median, but the targets lie at "
    "most {3:.4g} m apart"
)
REPEATS: Final = noted("repeats row {0} ({1})")
TOO_FEW: Final = noted("{0} has {1} usable lengths, {2} are needed")

_DEFAULTS: Final = TracerSolverSettings()
_LATEST: Final = 2**62


def finite_vector(name: str, values: ArrayLike, size: int | None = None) -> Floats:
    """Return ``values`` as a vector of finite numbers, of ``size`` if one is given."""
    array = np.array(values, dtype=np.float64)
    if array.ndim != 1 or (size is not None and len(array) != size):
        expected = "one dimension" if size is None else f"shape ({size},), one value per row"
        raise DataError(f"{name} has shape {array.shape}, expected {expected}")
    return require_all(np.isfinite(array), array, name, "a finite number")


def finite_matrix(name: str, values: ArrayLike) -> Floats:
    """Return ``values`` as finite numbers (n, 3)."""
    array = np.array(values, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != 3:
        raise DataError(f"{name} has shape {array.shape}, expected (n, 3)")
    return require_all(np.isfinite(array), array, name, "a finite number")


def finite_broadcast(name: str, values: ArrayLike, shape: tuple[int, ...]) -> Floats:
    """Return finite ``values``, one number or an array of that ``shape``, in that shape."""
    array = np.asarray(values, dtype=np.float64)
    if array.shape not in ((), shape):
        raise DataError(f"{name} has shape {array.shape}, expected one number or {shape}")
    return require_all(np.isfinite(array), np.full(shape, array), name, "a finite number")


def valid_indices(
    name: str, values: ArrayLike, limit: int, size: int | None = None
) -> NDArray[Any]:
    """Return ``values`` as whole numbers from 0 to below ``limit``."""
    array = np.asarray(values)
    if array.size == 0:
        raise DataError("there are no lengths: no observation was accepted")
    if (
        array.ndim != 1
        or array.dtype.kind not in "iu"
        or (size is not None and len(array) != size)
    ):
        raise DataError(
            f"{name} is {array.dtype} of shape {array.shape}, expected whole numbers, one per row"
        )
    inside = (array >= 0) & (array < limit)
    return require_all(inside, array.astype(np.int64), f"{name} index", f"0 to {limit - 1}")


def require_all(good: Bools, array: NDArray[Any], name: str, what: str) -> NDArray[Any]:
    """Return ``array`` where all is ``good``; else raise DataError naming the first bad entry."""
    good = np.broadcast_to(good, array.shape)
    if not good.all():
        place = tuple(int(i) for i in np.argwhere(~good)[0])
        row = place[0] if len(place) == 1 else place
        raise DataError(f"{name} in row {row} is {array[place]}, expected {what}")
    return array


@dataclass(frozen=True, eq=False)
class LengthProblem:
    """Lengths from a tracer on the table to targets, in any order, wherever it stood.

    ``position``, ``target`` (k,): indices into ``table_angles`` (m,) and ``targets`` (n, 3).
    ``length`` (k,): tracer readings in metres, growing with distance, from an unknown zero;
    ``length_std`` (k,) or one number: their standard deviation.
    ``targets``: positions of the reflector in the machine's frame, metres; ``target_std``: their
    standard deviation, one number, three, or (n, 3). ``datum`` "prior" weighs them by it, "free"
    uses them as start values only. ``table_angles``: commanded angles, radians, counter-clockwise
    about +z.

    ``order`` (k,), optional: when each length was taken, in any growing numbers. ``segment``
    (k,), optional: number of the unbroken beam with which each length was read, which count from
    one zero. ``moved`` (k, 3), optional: how much further along x, y, z the machine said the
    target stood when each length was measured, m; believed as far as the lengths follow it.
    ``slip``: a fringe (m) by which the counter may slip unseen where lengths share zeros, allowed
    for in the uncertainty; 0: it does not slip.

    ``speed`` (k,), optional: rad/s, at which the table turned when each length was read, negative
    back; each position is then passed at one speed. Its feedback is late by ``lag`` +-
    ``lag_std`` (s); None: not stated (:mod:`.turning`). None: the table stood.

    Raises DataError for values that are not finite, indices out of range, and standard
    deviations that are not positive; ConfigurationError for unknown names.
    """

    position: Ints
    target: Ints
    length: Floats
    length_std: Floats
    targets: Floats
    target_std: Floats
    table_angles: Floats
    datum: Datum = _DEFAULTS.datum
    order: Ints | None = None
    segment: Ints | None = None
    moved: Floats | None = None
    slip: float = _DEFAULTS.slip_m
    settings: TracerLimits = _DEFAULTS
    speed: Floats | None = None
    lag: float | None = None
    lag_std: float = 0.0

    def __post_init__(self) -> None:
        """Check and freeze the columns."""
        self._require_known("datum", get_args(Datum))
        self._require_sizes("slip")
        angles = self._store("table_angles", finite_vector("table_angles", self.table_angles))
        targets = self._store("targets", finite_matrix("targets", self.targets))
        position = self._store("position", valid_indices("position", self.position, len(angles)))
        k = len(position)
        length = self._store("length", finite_vector("length", self.length, k))
        self._store("target", valid_indices("target", self.target, len(targets), k))
        std = finite_broadcast("length_std", self.length_std, length.shape)
        self._store("length_std", require_all(std > 0.0, std, "length_std", "a positive number"))
        std = np.asarray(self.target_std, dtype=np.float64)
        std = np.broadcast_to(std, targets.shape) if std.shape == (3,) else std
        std = finite_broadcast("target_std", std, targets.shape)
        self._store("target_std", require_all(std >= 0.0, std, "target_std", "zero or more"))
        self._store_numbers("order", "segment")
        if self.speed is not None:
            speed = self._store("speed", finite_vector("speed", self.speed, k))
            require_all(speed != 0.0, speed, "speed", "a table that turns")
        if self.moved is not None:
            moved = finite_matrix("moved", self.moved)
            if moved.shape != (len(self.position), 3):
                raise DataError(f"moved has shape {moved.shape}, one row per length is expected")
            self._store("moved", moved)

    @property
    def station(self) -> Ints:
        """At which station each length (k,) was taken, from 0: here at its position."""
        return self.position

    @property
    def counted(self) -> Ints:
        """Numbers (k,) of what shares a zero: a segment, or a station."""
        return self.station if self.segment is None else self.segment

    @property
    def earlier(self) -> Ints:
        """How often the pair of each length (k,) was measured before."""
        return np.zeros_like(self.position)

    @property
    def own_zero(self) -> bool:
        """Whether each station has a zero to itself, and one length to each target."""
        return self.segment is None and not self.earlier.any()

    @property
    def free(self) -> bool:
        """Whether the targets carry no prior."""
        return self.datum == "free"

    @property
    def circle(self) -> float | None:
        """By how much, m, stations leave a common circle; None: nothing is known."""
        return None

    @property
    def station_minimum(self) -> int:
        """How many lengths a station needs, see :func:`station_minimum`."""
        return station_minimum(self.segment is None, self.circle is not None)

    def station_name(self, station: int | np.integer) -> Phrase:
        """Return what a station is, for messages."""
        return phrase("station {0}", station)

    def missing(self, positions: Ints) -> tuple[int, ...]:
        """Return the table positions that are not among those with a result."""
        every = np.arange(len(self.table_angles))
        return tuple(np.setdiff1d(every, positions).tolist())

    def _store_numbers(self, *names: str) -> None:
        """Check and freeze columns (k,) of whole numbers that may be absent."""
        for name in names:
            if (values := getattr(self, name)) is not None:
                self._store(name, valid_indices(name, values, _LATEST, len(self.position)))

    def _require_known(self, name: str, known: tuple[str, ...]) -> None:
        if getattr(self, name) not in known:
            raise ConfigurationError(
                f"{name} {getattr(self, name)!r} is unknown: expected one of {known}"
            )

    def _require_sizes(self, *names: str, positive: bool = False) -> None:
        """Refuse sizes that are negative or not finite, or zero where ``positive``."""
        expected = "a positive number" if positive else "zero or more"
        for name in names:
            value = getattr(self, name)
            large = value is None or value > 0.0 or (value == 0.0 and not positive)
            if not (large and np.isfinite(value or 0.0)):
                raise ConfigurationError(f"{name} is {value}, expected {expected}, or None")

    def _store(self, name: str, values: NDArray[Any]) -> NDArray[Any]:
        values.setflags(write=False)
        object.__setattr__(self, name, values)
        return values


@dataclass(frozen=True, eq=False)
class TracerProblem(LengthProblem):
    """One calibration run: k lengths from m table positions to n targets, in any order.

    At each position of the table the tracer has one station, whose place is unknown; its lengths
    have one zero, or those of a segment. Unequal steps, arcs and a full circle with its first
    angle repeated at the end (closure) are all welcome.

    ``variant`` "station": targets are taken as known, one small problem per station (Eq. 5-17).
    ``variant`` "joint": stations and targets are adjusted together (Eq. 1-4); the
    ``datum`` "free" fixes position and attitude of the network by inner constraints on the
    targets.

    ``error_motion_std``: standard deviation, per direction in the plane, of the table's own
    radial error motion (EXC, EYC, and tilts times the tracer's height) in metres. One tracer
    position cannot separate it from the angle; it enters the uncertainty as a type B component.
    Zero is known to be none; None: it is estimated from what the stations leave their circle by.

    ``circle_std``: standard deviation, m, by which the stations leave one circle about the table's
    axis, radially and along it; the circle is unknown. It is an observation that the lengths may
    contradict (:mod:`.circle`), and says nothing of errors along the circle: those are
    ``error_motion_std``, which is taken as large when it is None. None: nothing is said.

    ``repeated_runs``: equal table angles are separate arrivals, whose differences are the table's
    repeatability and reversal and no closure of the measurement.

    ``order`` holds the arrivals of the table and what a drift does; without it the stations are
    held to be measured one after the other, each at one arrival.

    ``segment``: all lengths of one count from the same unknown zero, at whatever table position;
    a beam that was broken begins a new segment. None: each station has a zero of its own.
    ``zero_walk_std``: with segments, the zero wanders by so much (m, standard deviation) from one
    length to the next of its segment, in their ``order``; 0: it stands, None: it is estimated.

    ``again`` (k,), optional: how often the pair of each length had been measured before, 0, 1,
    ...: what a plan repeats is a length of its own, to the same place of the target. None: every
    pair is measured once.

    ``run`` (k,), optional: an interruption begins another run, all lengths of which count from
    another zero; a target stands elsewhere then by ``position_std`` (m).

    ``start_stations`` (m, 3), optional: start values in metres; without them the start is
    found by linear multilateration. They also settle which of two mirror images is meant when
    all targets lie in one plane, and show how the positions are numbered
    (:class:`~.observability.Numbering`).

    Lengths may be missing (a blocked beam): leave the row out. A pair (position, target) has one
    length in each segment, or each time it is measured ``again``; an identical repetition is
    dropped and counted as rejected, a different one raises DataError.
    """

    variant: Variant = _DEFAULTS.variant
    error_motion_std: float | None = _DEFAULTS.error_motion_std_m
    circle_std: float | None = None
    repeated_runs: bool = False
    zero_walk_std: float | None = 0.0
    again: Ints | None = None
    run: Ints | None = None
    position_std: float = 0.0
    start_stations: Floats | None = None

    def __post_init__(self) -> None:
        """Check what is asked, too."""
        self._require_known("variant", get_args(Variant))
        self._require_sizes("error_motion_std", "zero_walk_std")
        self._require_sizes("circle_std", positive=True)
        super().__post_init__()
        self._store_numbers("again", "run")
        self._check_ties()
        if self.start_stations is not None:
            start = finite_matrix("start_stations", self.start_stations)
            if len(start) != len(self.table_angles):
                raise DataError(
                    f"start_stations has shape {start.shape}, one row per table angle "
                    f"is expected: {(len(self.table_angles), 3)}"
                )
            self._store("start_stations", start)
        if self.variant == "joint" and self.datum == "prior" and not (self.target_std > 0).all():
            raise DataError(
                "target_std holds zeros: the joint variant with a prior weighs the "
                "targets by it; give their standard deviation, or use the variant "
                "'station', which takes the targets as known"
            )

    @property
    def earlier(self) -> Ints:
        """How often the pair of each length (k,) was measured before."""
        return np.zeros_like(self.position) if self.again is None else self.again

    def station_name(self, station: int | np.integer) -> Phrase:
        """Return what a station is, for messages."""
        if self.speed is None:
            return super().station_name(station)
        run = int((self.table_angles[:station] == self.table_angles[station]).sum())
        return phrase("{0:g} deg in run {1}", float(self.table_angles[station] / DEGREE), run)

    @property
    def free(self) -> bool:
        """Whether the targets carry no prior, and are no known ones."""
        return self.variant == "joint" and self.datum == "free"

    @property
    def circle(self) -> float | None:
        """By how much, m, stations leave a common circle; None: nothing is known."""
        return self.circle_std

    @property
    def measuring_order(self) -> Ints:
        """When each length (k,) was taken: ``order``, or else station by station."""
        if self.order is not None:
            return self.order
        return np.lexsort((self.target, self.position)).argsort()

    def _check_ties(self) -> None:
        """Refuse a zero that wanders for itself, and ties for the variant 'station'."""
        if self.segment is None and self.zero_walk_std != 0.0:
            raise ConfigurationError(
                "zero_walk_std is for a zero per segment; lengths without segments have a zero "
                "per station, which does not wander: set it to 0"
            )
        if self.variant != "station":
            return
        solves = "and the variant 'station' solves each by itself: choose the variant 'joint', or"
        if self.segment is not None:
            raise ConfigurationError(
                f"segments tie all stations together, {solves} a zero per station"
            )
        if self.circle_std is not None:
            raise ConfigurationError(
                f"a stated circle ties all stations together, {solves} leave out circle_std"
            )
        if self.again is not None and self.again.any():
            raise ConfigurationError(
                "pairs measured several times share the error of their target, and the variant "
                "'station' takes a target for known: choose the variant 'joint', or average them"
            )


STATION_MINIMUM: Final = 5
"""Lengths per station that place it by themselves: (X, Y, Z, d), and one to check them."""
SEVERAL: Final = 4
"""Lengths of a strip whose median is of use."""
FREE_TARGET_MINIMUM: Final = 4
"""Lengths per target of a free network: three unknowns and one to check them."""
REACH: Final = 100.0
"""No tracer reaches further (metres): targets that lie further apart are in another unit."""
IMPOSSIBLE_SHARE: Final = 0.25
"""Share of impossible lengths from which the unit or the plan is wrong."""
MILLIMETRES: Final = 1e-3
"""Below this spread of the lengths, as a share of that of the targets, the units differ."""


def station_minimum(own_zero: bool, on_circle: bool) -> int:
    """Return how many lengths a station needs: as many as it has unknowns to itself.

    Its three coordinates, of which a stated circle leaves the one along it, and its zero unless
    that is shared.
    """
    return (1 if on_circle else 3) + int(own_zero)


@dataclass(frozen=True, eq=False)
class Grid:
    """The usable part of a problem: p strips of m stations by n targets.

    ``position_ids`` (m,), ``target_ids`` (n,): stations, which are the table positions where one
    place was measured from, and targets in the problem. ``row`` (p, n): row of the
    problem that fills the place, -1 for none. ``used`` (p, n): the length takes part.
    ``length``, ``length_std`` (p, n): metres, 0 and 1 where there is none.
    ``targets``, ``target_std`` (n, 3): metres. ``free``: the targets carry no prior.
    ``station`` (p,): station of each strip. ``zero`` (p,): its zero, from 0 to s - 1; None: every
    strip is a station and has its own. ``segment_ids`` (s,): the problem's segment of each zero.
    ``circle_std``: by how much (m) stations leave a common circle; None: nothing is known.

    Strips share zeros where these belong to segments, and where pairs are measured again.
    """

    position_ids: Ints
    target_ids: Ints
    row: Ints
    used: Bools
    length: Floats
    length_std: Floats
    targets: Floats
    target_std: Floats
    free: bool
    station: Ints
    zero: Ints | None = None
    segment_ids: Ints | None = None
    circle_std: float | None = None

    @property
    def weights(self) -> Floats:
        """Weights (p, n) of the lengths alone, 1/m^2; zero where unused."""
        return self.used / self.length_std**2

    @property
    def n_stations(self) -> int:
        """The number m of stations."""
        return len(self.position_ids)

    @property
    def n_zeros(self) -> int:
        """The number s of unknown zeros."""
        return self.n_stations if self.segment_ids is None else len(self.segment_ids)

    @property
    def station_minimum(self) -> int:
        """How many lengths a station needs, see :func:`station_minimum`."""
        own_zero = self.zero is None or (
            len(self.zero) > 0 and np.array_equal(self.zero, self.station)
        )
        return station_minimum(own_zero, self.circle_std is not None)

    @property
    def apart(self) -> bool:
        """Whether nothing but targets ties stations, and each has the lengths to find it alone."""
        tied = self.zero is not None or self.circle_std is not None
        return not tied and bool((self.used.sum(axis=1) >= STATION_MINIMUM).all())

    @cached_property
    def first_strip(self) -> Ints:
        """The first strip (m,) of each station."""
        return np.unique(self.station, return_index=True)[1]

    @cached_property
    def first_of_zero(self) -> Ints:
        """The first strip (s,) of each zero."""
        zero = self.station if self.zero is None else self.zero
        return np.unique(zero, return_index=True)[1]

    def take(self, strips: Ints, part: Bools) -> Grid:
        """Return the grid of some ``strips`` (q,), of each only the places ``part`` (q, n)."""
        used = self.used[strips] & part
        return replace(
            self,
            row=np.where(part, self.row[strips], -1),
            used=used,
            length=np.where(part, self.length[strips], 0.0),
            length_std=np.where(part, self.length_std[strips], 1.0),
            station=self.station[strips],
            zero=None if self.zero is None else self.zero[strips],
        )


@dataclass(frozen=True, eq=False)
class UnplacedRows:
    """Why lengths have no place on a grid, by row of the problem.

    ``repeated``: identical repetitions. ``unfit``: they contradict the triangle inequality, or
    their station has too few lengths left. ``spare``: of targets of a free network with too few
    lengths to place them; nothing speaks against these.
    """

    repeated: dict[int, Phrase]
    unfit: dict[int, Phrase]
    spare: dict[int, Phrase]


class _Strips(NamedTuple):
    """``station`` and ``segment`` (p,) of each strip, and the strip of each row (k,).

    ``segment`` None: strips are stations; else what each zero belongs to: a segment, or where
    there are none, the station.
    """

    station: Ints
    segment: Ints | None
    of_row: Ints


def _strips(problem: LengthProblem) -> _Strips:
    if problem.own_zero:
        count = int(problem.station.max()) + 1
        return _Strips(np.arange(count), None, problem.station)
    keys = np.column_stack([problem.station, problem.counted, problem.earlier])
    strips, of_row = np.unique(keys, axis=0, return_inverse=True)
    return _Strips(strips[:, 0], strips[:, 1], of_row.ravel())


def arrange_grid(
    problem: LengthProblem, without: Collection[int] = ()
) -> tuple[Grid, UnplacedRows]:
    """Return the grid of ``problem``, and what has no place on it; some rows are left out.

    Raises DataError for contradictory repetitions and for lengths that seem to be in another unit
    than the targets.
    """
    absent = UnplacedRows({}, {}, {})
    strips = _strips(problem)
    row = _place_rows(problem, strips, absent.repeated)
    row[np.isin(row, list(without))] = -1
    _check_unit_of_targets(problem)
    _drop_impossible(problem, row, strips.station, absent.unfit)
    _drop_undetermined(problem, row, strips, absent)
    kept, targets = (np.flatnonzero((row >= 0).any(axis=axis)) for axis in (1, 0))
    row = row[np.ix_(kept, targets)]
    used = row >= 0
    stations, station = np.unique(strips.station[kept], return_inverse=True)
    segments, zero = None, None
    if strips.segment is not None:
        segments, zero = np.unique(strips.segment[kept], return_inverse=True)
    grid = Grid(
        position_ids=stations,
        target_ids=targets,
        row=row,
        used=used,
        length=np.where(used, problem.length[row], 0.0),
        length_std=np.where(used, problem.length_std[row], 1.0),
        targets=problem.targets[targets],
        target_std=problem.target_std[targets],
        free=problem.free,
        station=station,
        zero=zero,
        segment_ids=segments,
        circle_std=problem.circle,
    )
    return grid, absent


def _place_rows(problem: LengthProblem, strips: _Strips, why: dict[int, Phrase]) -> Ints:
    """Return the row (p, n) that fills each place; the first of identical repetitions stays."""
    shape = (len(strips.station), len(problem.targets))
    place = strips.of_row * shape[1] + problem.target
    order = np.argsort(place, kind="stable")
    first = np.ones(len(order), dtype=np.bool_)
    first[1:] = np.diff(place[order]) != 0
    keeper = order[np.maximum.accumulate(np.where(first, np.arange(len(order)), 0))]
    for again, kept in zip(order[~first], keeper[~first], strict=True):
        station = problem.station_name(problem.station[kept])
        name = phrase("{0}, target {1}", station, problem.target[kept])
        a, b = problem.length[kept], problem.length[again]
        if a != b or problem.length_std[kept] != problem.length_std[again]:
            raise DataError(
                f"rows {kept} and {again} both give a length for {name}, but differ: {a} m and "
                f"{b} m; keep the accepted one, or average them before solving"
            )
        why[int(again)] = phrase(REPEATS, kept, name)
    row = np.full(shape[0] * shape[1], -1, dtype=np.int64)
    row[place[order[first]]] = order[first]
    return row.reshape(shape)


def _check_unit_of_targets(problem: LengthProblem) -> None:
    span = _diagonal(problem.targets)
    if span > REACH:
        raise DataError(
            f"the targets lie up to {span:.4g} m apart, no tracer reaches beyond {REACH:g} m: "
            "are they in millimetres? Metres are expected"
        )


def _drop_impossible(
    problem: LengthProblem, row: Ints, station: Ints, why: dict[int, Phrase]
) -> None:
    """Drop lengths that no position of the tracer can explain.

    Two lengths of one strip cannot differ by more than their targets lie apart; the strip's
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
    several = used.sum(axis=1) >= (1 if problem.own_zero else SEVERAL)
    if several.any():
        _check_unit_of_lengths(excess[several][used[several]], span)
    for j, i in np.argwhere(excess > span):
        why[int(row[j, i])] = phrase(
            TOO_FAR, problem.station_name(station[j]), i, excess[j, i], span
        )
    row[excess > span] = -1


def _check_unit_of_lengths(excess: Floats, span: float) -> None:
    # Most lengths show the unit: a few may be spikes, and a few targets lie near the median.
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


def _drop_undetermined(
    problem: LengthProblem, row: Ints, strips: _Strips, absent: UnplacedRows
) -> None:
    """Drop targets, then stations, that too few lengths reach; again until nothing changes.

    A length that no other shares its segment with says nothing of its station.
    """
    minima = {
        "target": FREE_TARGET_MINIMUM if problem.free else 1, "station": problem.station_minimum,
    }  # fmt: skip
    before = -1
    while before != (before := int((row >= 0).sum())):
        for name, minimum in minima.items():
            why = absent.unfit if name == "station" else absent.spare
            group = strips.station if name == "station" else np.arange(row.shape[1])
            table = row if name == "station" else row.T
            present = np.bincount(group, weights=(table >= 0).sum(axis=1))
            count = present if name == "target" else _determining(row >= 0, strips)
            for index in np.flatnonzero((present > 0) & (count < minimum)).tolist():
                lines = group == index
                what = phrase("target {0}", index)
                if name == "station":
                    what = problem.station_name(index)
                for dropped in table[lines][table[lines] >= 0]:
                    why[int(dropped)] = phrase(TOO_FEW, what, int(count[index]), minimum)
                table[lines] = -1


def _determining(present: Bools, strips: _Strips) -> Floats:
    """Return how many of the ``present`` (p, n) lengths of each station help to determine it.

    One that was measured again from the same zero adds nothing about the place.
    """
    if strips.segment is None:
        return np.bincount(strips.station, weights=present.sum(axis=1)).astype(np.float64)
    total = np.bincount(
        np.unique(strips.segment, return_inverse=True)[1], weights=present.sum(axis=1)
    )
    both = np.column_stack([strips.station, strips.segment])
    beams, of_strip = np.unique(both, axis=0, return_inverse=True)
    seen = np.zeros((len(beams), present.shape[1]), dtype=np.bool_)
    np.logical_or.at(seen, of_strip.ravel(), present)
    of_segment = np.unique(beams[:, 1], return_inverse=True)[1]
    count = np.where(total[of_segment] > 1, seen.sum(axis=1), 0)
    return np.bincount(beams[:, 0], weights=count).astype(np.float64)


def _diagonal(points: Floats) -> float:
    return float(np.linalg.norm(np.ptp(points, axis=0)))
