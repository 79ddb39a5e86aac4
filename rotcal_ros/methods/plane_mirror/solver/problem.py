"""What a plane-mirror calibration is computed from, and which of its rows belong together.

:class:`PlaneMirrorProblem` is all that the user gives: points row by row, and how to use them. Its
rows are sorted into what the ways compute with: :class:`MirrorPairs` (a reflector and its image),
:class:`Nests` (fixed points that several tracker stations see) and :class:`Reflectors` (points
that the table carries). All of these hold row numbers, never coordinates, so that one layout
serves thousands of simulated measurements.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import astuple, dataclass, field, replace
from functools import cached_property
from typing import Final

import numpy as np

from rotcal_ros.adjust.gathering import Words
from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.language import Phrase, phrase
from rotcal_ros.foundation.observations import Observation, PointKind
from rotcal_ros.foundation.units import ARCSEC, DEGREE, NANOSECOND
from rotcal_ros.methods.plane_mirror.settings import (
    INCIDENCE_LIMIT_DEG,
    WAYS,
    MirrorSolverSettings,
    Way,
)

WORDS: Final = Words(
    "readings", "warm air, a person, an obstacle or a smear", "in the beams", "in its beams"
)
_DEFAULTS = MirrorSolverSettings()
_KINDS = (PointKind.DIRECT, PointKind.MIRRORED, PointKind.NEST)


@dataclass(frozen=True)
class TrackerNoise:
    """Standard deviations of a laser tracker: an ellipsoid along the beam, growing with range.

    Along the beam ``range_std + range_std_per_metre * r``, across it (two angles)
    ``transverse_std + transverse_std_per_metre * r``; metres, r the apparent distance. The
    defaults are what the makers call typical: half of 10 um + 0 and of 15 um + 6 um/m.
    ``mirror_slope_std`` is the mirror's flatness as slope (rad) seen from spot to spot.
    """

    range_std: float = _DEFAULTS.range_std_m
    range_std_per_metre: float = _DEFAULTS.range_std_relative
    transverse_std: float = _DEFAULTS.transverse_std_m
    transverse_std_per_metre: float = _DEFAULTS.transverse_std_relative
    mirror_slope_std: float = _DEFAULTS.mirror_slope_std_arcsec * ARCSEC

    def __post_init__(self) -> None:
        values = astuple(self)
        if not all(np.isfinite(v) and v >= 0.0 for v in values):
            raise DataError(f"tracker noise must be finite and not negative, found {values}")
        along = self.range_std + self.range_std_per_metre
        across = self.transverse_std + self.transverse_std_per_metre
        if min(along, across) <= 0.0:
            raise DataError("tracker noise along and across the beam must be above zero")

    def covariance(self, points: Floats) -> Floats:
        """Return the covariances (..., 3, 3) in m^2 of points (..., 3) seen from the origin."""
        distance = np.linalg.norm(points, axis=-1)[..., None, None]
        beam = points[..., :, None] * points[..., None, :] / distance**2
        along = self.range_std + self.range_std_per_metre * distance
        across = self.transverse_std + self.transverse_std_per_metre * distance
        return np.asarray(across**2 * np.eye(3) + (along**2 - across**2) * beam)


def noise_of(settings: MirrorSolverSettings) -> TrackerNoise:
    """Return the noise of the tracker that the settings state."""
    along = settings.range_std_m, settings.range_std_relative
    across = settings.transverse_std_m, settings.transverse_std_relative
    return TrackerNoise(*along, *across, settings.mirror_slope_std_arcsec * ARCSEC)


@dataclass(frozen=True)
class PlaneMirrorProblem:
    """Points of a laser tracker around a rotary table, row by row, and how to use them.

    ``angles`` (N,) are the commanded table angles in rad, one per table position; a closing
    position (0 and 360 degrees) is a position of its own. The rows are parallel arrays (n,):
    ``position`` (index into ``angles``; not used by nests), ``station`` (of the tracker),
    ``kind`` (:class:`~rotcal_ros.foundation.observations.PointKind` DIRECT, MIRRORED or NEST) and
    ``nest``. ``xyz`` (n, 3) in metres in the frame of the tracker station, origin at the tracker.

    DIRECT and MIRRORED rows with the same position, station and nest are a pair; these nests
    may be moved between positions. NEST rows are the fixed nests of the registration, known
    by the same number from every station. For the way "direct" the DIRECT rows are reflectors
    carried by the table. ``time`` (n,) states when each row was measured, in any unit; without it
    the rows stand in the order in which they were measured. Nests that are measured again before
    the tracker leaves a station show how it drifted there.

    ``tilt_std`` (rad) is how far the table may tilt (EAC, EBC), that is, how exactly the normals
    stand on one cone. ``uneven_drift_std`` (rad) is how far the tracker's azimuth may leave the
    straight line between its first and its last look at the nests from one station, see
    :func:`.drift.swings`. ``incidence_limit`` (rad) is the greatest angle between beam and mirror
    normal that is used. ``significance`` is the probability of a false alarm of each test.
    ``upward`` (N,) is the side from which the table came to each position, where it came from
    both: what differs between them is the table's reversal. ``station_names``, ``source`` and
    ``lines`` (of the file, per row) serve the messages.
    """

    angles: Floats
    position: Ints
    station: Ints
    kind: Ints
    nest: Ints
    xyz: Floats
    noise: TrackerNoise = field(default_factory=TrackerNoise)
    way: Way = _DEFAULTS.way
    tilt_std: float = _DEFAULTS.tilt_std_arcsec * ARCSEC
    uneven_drift_std: float = _DEFAULTS.uneven_drift_std_arcsec * ARCSEC
    incidence_limit: float = INCIDENCE_LIMIT_DEG * DEGREE
    significance: float = _DEFAULTS.significance
    station_names: tuple[str, ...] = ()
    source: str = "the data"
    lines: tuple[int, ...] = ()
    time: Floats | None = None
    upward: Bools | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "angles", np.asarray(self.angles, dtype=np.float64))
        object.__setattr__(self, "xyz", np.asarray(self.xyz, dtype=np.float64))
        for name in ("position", "station", "kind", "nest"):
            object.__setattr__(self, name, np.asarray(getattr(self, name), dtype=np.int64))
        if self.time is not None:
            object.__setattr__(self, "time", np.asarray(self.time, dtype=np.float64))
        _require_shapes(self)
        _require_values(self)

    @property
    def moment(self) -> Floats:
        """When each row (n,) was measured: ``time``, else the number of the row."""
        return np.arange(float(len(self.xyz))) if self.time is None else self.time

    def station_name(self, index: int) -> str:
        """Return the name of a tracker station as the data give it."""
        return self.station_names[index] if self.station_names else str(index)

    def position_name(self, index: int) -> Phrase:
        """Return a table position with its commanded angle, for messages."""
        return phrase("position {0} ({1:g} deg)", index, self.angles[index] / DEGREE)

    def row_name(self, row: int) -> Phrase:
        """Return what a row is and where it stands, for messages."""
        kind = PointKind(int(self.kind[row])).name.lower()
        where = phrase(
            "tracker station {0}, nest {1}", self.station_name(self.station[row]), self.nest[row]
        )
        if kind != "nest":
            where = phrase("{0}, {1}", self.position_name(self.position[row]), where)
        return phrase("{0} ({1}, {2})", self.place(row), phrase(kind), where)

    def place(self, row: int) -> Phrase:
        """Return the line of the file a row came from, else its number."""
        return phrase("line {0}", self.lines[row]) if self.lines else phrase("row {0}", row)


def problem_from_observations(
    observations: Iterable[Observation], angles: Floats
) -> PlaneMirrorProblem:
    """Make a problem from captured probe points; observations that were not accepted are left out.

    ``angles`` (N,) are the commanded angles in rad by ``table_position``.
    """
    used = [o for o in observations if o.accepted and o.kind in _KINDS]
    stations, station = np.unique([o.station for o in used], return_inverse=True)
    return PlaneMirrorProblem(
        angles=np.asarray(angles, dtype=np.float64),
        position=np.array([o.table_position for o in used], dtype=np.int64),
        station=station.astype(np.int64),
        kind=np.array([int(o.kind) for o in used], dtype=np.int64),
        nest=np.array([o.target for o in used], dtype=np.int64),
        xyz=np.array([o.mean for o in used], dtype=np.float64).reshape(-1, 3),
        station_names=tuple(str(s) for s in stations),
        time=_stamps(used),
    )


def _stamps(observations: list[Observation]) -> Floats | None:
    """Return when each was measured, in seconds after the first; None where that is not known."""
    stamps = np.array([o.window_start_ns for o in observations], dtype=np.int64)
    if not len(stamps) or np.all(stamps == stamps[0]):
        return None
    return np.asarray((stamps - stamps.min()) * NANOSECOND, dtype=np.float64)


def _require_shapes(problem: PlaneMirrorProblem) -> None:
    n = len(problem.xyz)
    if problem.angles.ndim != 1 or len(problem.angles) < 2:
        raise DataError(f"{problem.source}: give at least 2 commanded angles")
    if problem.xyz.shape != (n, 3) or n == 0:
        raise DataError(f"{problem.source}: points must be (n, 3), found {problem.xyz.shape}")
    for name in ("position", "station", "kind", "nest"):
        shape = getattr(problem, name).shape
        if shape != (n,):
            raise DataError(f"{problem.source}: {name} has shape {shape}, expected ({n},)")
    if problem.moment.shape != (n,) or not np.all(np.isfinite(problem.moment)):
        raise DataError(f"{problem.source}: time must be {n} finite numbers")


def _require_values(problem: PlaneMirrorProblem) -> None:
    if problem.way not in WAYS:
        raise DataError(f"unknown way {problem.way!r}; choose one of {', '.join(WAYS)}")
    if not problem.uneven_drift_std >= 0.0:
        raise DataError(f"uneven_drift_std must not be negative, found {problem.uneven_drift_std}")
    if not problem.tilt_std > 0.0 or not 0.0 < problem.incidence_limit < np.pi / 2:
        raise DataError("tilt_std must be above 0 and incidence_limit between 0 and pi/2 rad")
    if not np.all(np.isfinite(problem.angles)):
        raise DataError(f"{problem.source}: a commanded angle is not a number")
    if len(np.setdiff1d(np.arange(problem.station.max() + 1), problem.station)) or (
        problem.station.min() < 0
    ):
        found = np.unique(problem.station).tolist()
        raise DataError(f"{problem.source}: tracker stations must count from 0, found {found}")
    for row in range(len(problem.xyz)):
        if problem.kind[row] not in _KINDS:
            raise DataError(
                f"{problem.source}: {problem.place(row)} has kind {problem.kind[row]}, expected "
                "direct, mirrored or nest"
            )
        tied = problem.kind[row] != PointKind.NEST
        if tied and not 0 <= problem.position[row] < len(problem.angles):
            raise DataError(
                f"{problem.source}: {problem.place(row)} names position {problem.position[row]}, "
                f"but there are {len(problem.angles)} commanded angles (0 is the first)"
            )
        if not np.all(np.isfinite(problem.xyz[row])) or not np.any(problem.xyz[row]):
            raise DataError(
                f"{problem.source}: {problem.row_name(row)} has no valid coordinates: "
                f"{problem.xyz[row].tolist()}; measure it again or take the row out"
            )
    _require_distinct(problem)


def _require_distinct(problem: PlaneMirrorProblem) -> None:
    """Two rows of one station that agree to the last digit are one measurement copied.

    Only a nest that is measured again may come out the same: it is the same point.
    """
    times: Counter[tuple[int, int]] = Counter()
    again = np.zeros(len(problem.xyz))
    for at in np.flatnonzero(problem.kind == PointKind.NEST):
        nest = int(problem.station[at]), int(problem.nest[at])
        again[at] = times[nest]
        times[nest] += 1
    keyed = np.column_stack([problem.station, again, problem.xyz])
    _, first, inverse = np.unique(keyed, axis=0, return_index=True, return_inverse=True)
    copies = np.flatnonzero(first[inverse.ravel()] != np.arange(len(keyed)))
    if len(copies):
        row, original = int(copies[0]), int(first[inverse.ravel()[copies[0]]])
        raise DataError(
            f"{problem.source}: {problem.row_name(row)} and {problem.row_name(original)} are the "
            "same point to the last digit; measure one of them again or take it out"
        )


@dataclass(frozen=True)
class Sets:
    """Readings (m,) whose angles count about one axis, from one zero: the ``number`` of each.

    ``commanded`` (m,): where the table was sent for each, rad.
    """

    number: Ints
    commanded: Floats

    def __iter__(self) -> Iterator[tuple[Ints, Floats]]:
        """Yield which readings belong to each set, and where the table was sent for them."""
        for number in range(int(self.number.max()) + 1):
            at = np.flatnonzero(self.number == number)
            yield at, self.commanded[at]


@dataclass(frozen=True)
class MirrorPairs:
    """Direct and mirrored rows (P,) of one reflector each, sorted by group.

    A group is one table position seen from one tracker station: ``position`` and ``station``
    (G,); ``group`` (P,) is the group of each pair.
    """

    direct: Ints
    mirrored: Ints
    group: Ints
    position: Ints
    station: Ints

    @cached_property
    def start(self) -> Ints:
        """The first pair (G,) of each group."""
        return np.searchsorted(self.group, np.arange(self.n_groups)).astype(np.int64)

    @property
    def n_groups(self) -> int:
        """Number of groups, that is, of normals."""
        return len(self.position)

    def keep(self, wanted: Bools) -> MirrorPairs:
        """Return the pairs (P,) that are wanted, without the groups that become empty."""
        groups, group = np.unique(self.group[wanted], return_inverse=True)
        direct, mirrored, number = self.direct[wanted], self.mirrored[wanted], np.int64(group)
        return MirrorPairs(direct, mirrored, number, self.position[groups], self.station[groups])


@dataclass(frozen=True)
class Nests:
    """Nest rows (Q,) sorted by ``point`` (Q,), the index of the fixed nest; see ``name`` (K,).

    ``round`` (Q,) counts the rounds of nests of all stations, in the order in which they were
    measured.
    """

    row: Ints
    station: Ints
    round: Ints
    point: Ints
    name: Ints

    @classmethod
    def of(cls, row: Ints, station: Ints, rounds: Ints, point: Ints, name: Ints) -> Nests:
        """Sort readings (Q,) by their ``point``; of the ``name`` (K,) only those in use stay."""
        used, point = np.unique(point, return_inverse=True)
        order = np.lexsort([row, station, point])
        columns = row[order], station[order], rounds[order], point[order].astype(np.int64)
        return cls(*columns, name[used])

    @property
    def n_points(self) -> int:
        """Number of fixed points."""
        return len(self.name)

    def keep(self, wanted: Bools) -> Nests:
        """Return the readings (Q,) that are wanted."""
        row, station, rounds = self.row[wanted], self.station[wanted], self.round[wanted]
        return Nests.of(row, station, rounds, self.point[wanted], self.name)

    def order_of_placing(self, count: int) -> Iterator[tuple[int, Ints, list[Ints]]]:
        """Yield ``count`` stations from the first on, next the one that shares most nests.

        Each with the points (k,) that it sees, and the rows of each of these.
        """
        seen = [np.unique(self.point[self.station == station]) for station in range(count)]
        known, waiting = np.zeros(self.n_points, dtype=np.bool_), list(range(count))
        while waiting:
            shared = [known[seen[station]].sum() for station in waiting]
            station = waiting.pop(int(np.argmax(shared)))
            own = self.station == station
            yield (
                station,
                seen[station],
                [self.row[own & (self.point == k)] for k in seen[station]],
            )
            known[seen[station]] = True


@dataclass(frozen=True)
class Reflectors:
    """Direct rows (M,) of reflectors that the table carries, sorted by reflector."""

    row: Ints
    position: Ints
    station: Ints
    reflector: Ints
    name: Ints

    def keep(self, wanted: Bools) -> Reflectors:
        """Return the rows (M,) that are wanted."""
        row, position, station = self.row[wanted], self.position[wanted], self.station[wanted]
        return Reflectors(row, position, station, self.reflector[wanted], self.name)

    @classmethod
    def none(cls) -> Reflectors:
        """Return no reflectors at all."""
        nothing = np.zeros(0, dtype=np.int64)
        return cls(nothing, nothing, nothing, nothing, nothing)


@dataclass(frozen=True, eq=False)
class PointLayout:
    """Which rows of a ``problem`` are used, and for what.

    ``angles`` (N,), rad: those of the ``positions`` (N,) that were measured; pairs and reflectors
    count in these. ``pairs`` is None where the table carries ``reflectors`` and no mirror.
    ``tied``: whether nests join the stations; else a nest stands where each station saw it.
    """

    problem: PlaneMirrorProblem
    positions: Ints
    angles: Floats
    pairs: MirrorPairs | None
    reflectors: Reflectors
    nests: Nests
    tied: bool

    @property
    def stations(self) -> range:
        """The numbers of the tracker stations."""
        return range(int(self.problem.station.max()) + 1)

    @property
    def rows(self) -> Ints:
        """The rows (m,) of images or reflectors on the table, then of nests: the elements."""
        carried = self.pairs.mirrored if self.pairs else self.reflectors.row
        return np.concatenate([carried, self.nests.row])

    @property
    def group(self) -> Ints:
        """What each pair or reflector shows: a normal or, by position, a place."""
        return self.pairs.group if self.pairs else self.reflectors.position

    @property
    def position(self) -> Ints:
        """Position (P,) of each pair or reflector."""
        return self.pairs.position[self.pairs.group] if self.pairs else self.reflectors.position

    def sets(self, *, by_station: bool = False) -> Sets:
        """Return what shares a zero: normals of each station or of all, places of a reflector."""
        if self.pairs is None:
            return Sets(self.reflectors.reflector, self.angles[self.reflectors.position])
        number = np.unique(self.pairs.station, return_inverse=True)[1] * by_station
        return Sets(number.astype(np.int64), self.angles[self.pairs.position])

    def without(self, elements: Ints) -> PointLayout:
        """Return the same without some ``elements``, numbers of :attr:`rows`."""
        kept = ~np.isin(np.arange(len(self.rows)), elements)
        pairs, reflectors, count = self.pairs, self.reflectors, len(self.group)
        if pairs:
            pairs = pairs.keep(kept[:count])
        else:
            reflectors = reflectors.keep(kept[:count])
        nests = self.nests.keep(kept[count:])
        return replace(self, pairs=pairs, reflectors=reflectors, nests=nests)


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
            position, station, nest = key
            raise DataError(
                f"{problem.source}: {problem.position_name(position)}, tracker station "
                f"{problem.station_name(station)}, nest {nest}: {len(near)} direct and {len(far)} "
                "mirrored points, expected as many of both; measure the missing one or take the "
                "row out"
            )
    keys = sorted(rows)
    direct = np.array([row for key in keys for row in rows[key][0]], dtype=np.int64)
    mirrored = np.array([row for key in keys for row in rows[key][1]], dtype=np.int64)
    places = np.column_stack([problem.position[direct], problem.station[direct]])
    group_places, group = np.unique(places, axis=0, return_inverse=True)
    group = group.ravel().astype(np.int64)
    return MirrorPairs(direct, mirrored, group, group_places[:, 0], group_places[:, 1])


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
    return Nests.of(rows, problem.station[rows], rounds[rows], point, names)


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
        begins = is_nest & ~np.append(False, is_nest[:-1])  # the row before was no nest
        rounds[rows[is_nest]] = begun + np.cumsum(begins)[is_nest] - 1
        begun += int(begins.sum())
    return rounds


def find_reflectors(problem: PlaneMirrorProblem) -> Reflectors:
    """Collect the reflectors on the table; raises DataError where there are none."""
    rows = np.flatnonzero(problem.kind == PointKind.DIRECT)
    if not len(rows):
        raise DataError(f"{problem.source}: no direct points, nothing to compute")
    names, reflector = np.unique(problem.nest[rows], return_inverse=True)
    order = np.lexsort([rows, problem.position[rows], reflector])
    rows, reflector = rows[order], reflector[order]
    return Reflectors(rows, problem.position[rows], problem.station[rows], reflector, names)
