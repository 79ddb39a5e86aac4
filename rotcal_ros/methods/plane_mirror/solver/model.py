"""What a laser tracker sees around a rotary table, as a model of the engine.

In the frame of the first station the table axis is a, with e1 and e2 across it, and a station sees
x = R'(X - t). A mirror on the table is at position i the plane n_i.X = d_i,

    n_i = cos(beta + eps_i) (cos psi_i e1 + sin psi_i e2) + sin(beta + eps_i) a,
    psi_i = command_i + ECC_i + tan(beta) tau_i,

where eps_i and tau_i, how the table tilts across and along the normal, are N(0, tilt_std^2). A
reflector M and its image M' are one element, the condition

    e = M' - M + 2 (n.M - h) n = 0,    h = d - n.t,

which feels an error of the image as it is and one of M reflected by H = I - 2 n n'; its
covariance is C' + H C H and what the slopes of the glass do. Reflectors on the table instead of a
mirror stand at X = o + c + Rz(psi_i) q about the axis, which o + c is on.

Every nest stands still. While the tracker stands at a station its frame turns by w, shifts by s
and its range grows by r, so that a point at x appears at

    x + k(t) (w x x + s + r x / |x|) + (a1 sin(pi t) + a2 sin(2 pi t)) z x x,

k linear from one round of nests to the next, and t from 0 to 1 between them. A station that does
not see its nests again after its positions has none of that. The swings a1 and a2, the first terms
of a random walk that is tied at both ends (Karhunen-Loeve), are N(0, s^2) with the stated
``uneven_drift_std`` s for rounds a whole station apart, less by the root of the time for closer
ones. Stations that no nests join have a turn alone, and each of their normals a distance of its
own.

Each element is three rows, in m: along the beam, level across it, and upwards, by the symmetric
root of its weight, which of all roots turns errors least.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from scipy.sparse import coo_array, csr_array

from rotcal_ros.adjust.diagnosis import Limits
from rotcal_ros.adjust.model import (
    CurveModel,
    Disturbing,
    Grouping,
    Model,
    Steps,
    Unit,
    block_rows,
    drifts,
)
from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.language import phrase
from rotcal_ros.foundation.observations import PointKind
from rotcal_ros.foundation.units import ARCSEC, MICROMETRE
from rotcal_ros.geometry.rotations import cross_matrix, rotation_about_z, rotation_from_vector
from rotcal_ros.methods.plane_mirror.solver.printed import (
    Poses,
    azimuths,
    circle_readings,
    cone_axes,
    connected_islands,
    fit_circle,
    joining_map,
    mean_normals,
    placed_stations,
)
from rotcal_ros.methods.plane_mirror.solver.problem import WORDS, PointLayout, nest_rounds

PARTS: Final = 7
"""Turns about x, y, z (rad), shifts along x, y, z (m) and range (m) from one knot to the next."""
SWINGS: Final = 2
"""Half sines between two knots that a swing is made of."""
LARGEST: Final = 1000.0 * ARCSEC
"""Turn of a mirror or a tracker that nobody would overlook."""
NEST_MOVED: Final = "a nest moved"
FAR: Final = 5e-3
"""Move of a nest (m) that nobody would overlook."""
UM: Final = Unit("um", MICROMETRE)
MIN_NESTS: Final = 3
"""Nests seen twice that show how a frame turned and shifted."""
REACH: Final = 3.0
"""A round reaches so many times as far to one side of its median as to the other, not more."""
WEAKEST: Final = 1e-3
"""Smallest singular value of the scaled equations, to the largest: below, nests show no drift."""
LEANING: Final = np.array([[0.0, -1.0], [1.0, 0.0], [0.0, 0.0]])
"""The turn of the frame by which the axis leans by u along e1 and v along e2: (-v, u, 0)."""
SPARSE: Final = 400
"""Unknowns from which on the design is written by its entries alone."""


@dataclass(frozen=True, eq=False)
class Span:
    """From one round of nests to the next while the tracker stands at a ``station``.

    ``begin`` and ``end`` are moments; ``course`` (n,) is how much of the way each row of the
    station has come, from the mean of its nests. ``share`` (n,): the same from 0 to 1, ``std``
    (rad) that of its swings.
    """

    station: int
    begin: float
    end: float
    course: Floats
    share: Floats
    std: float


def spans_of(layout: PointLayout) -> tuple[list[Span], list[int]]:
    """Return the spans of all stations, and the stations that have none."""
    found, open_ = list[Span](), list[int]()
    for station in layout.stations:
        mine = list(_spans_at(layout, station))
        found += mine
        open_ += [station] * (not mine)
    return found, open_


def _spans_at(layout: PointLayout, station: int) -> Iterator[Span]:
    problem, nests, moment = layout.problem, layout.nests, layout.problem.moment
    own = problem.station == station
    here = nests.station == station
    rows, others = nests.row[here], moment[own & (problem.kind != PointKind.NEST)]
    if not len(rows) or not len(others):
        return
    if moment[rows].min() >= others.min() or moment[rows].max() <= others.max():
        return  # no nest before the first position, or none behind the last
    knots = _knots(layout, rows)
    # how much of the way from each knot to the next is done
    shares = np.clip((moment[:, None] - knots[:-1]) / np.diff(knots), 0.0, 1.0)
    to_mean = nests.point[here][:, None] == nests.point[here]
    contrast = np.eye(len(rows)) - to_mean / to_mean.sum(axis=1)[:, None]
    if len(np.unique(nests.point[here][to_mean.sum(axis=1) > 1])) < MIN_NESTS:
        return
    design = (
        drift_movement(problem.xyz[rows])[:, :, None] * (contrast @ shares[rows])[:, None, :, None]
    )
    design = design.reshape(3 * len(rows), -1)
    length = np.linalg.norm(design, axis=0)
    size = np.linalg.svd(design / np.where(length > 0.0, length, 1.0), compute_uv=False)
    if len(size) < design.shape[1] or size[-1] < WEAKEST * size[0]:
        return
    for k, lasts in enumerate((np.diff(knots) / np.ptp(knots)).tolist()):
        share = shares[:, k] * own
        course = (share - share[rows].mean()) * own
        std = problem.uneven_drift_std * np.sqrt(lasts)
        yield Span(station, knots[k], knots[k + 1], course, share, std)


def _knots(layout: PointLayout, rows: Ints) -> Floats:
    """Return the times between which the drift is linear: first nest, inner rounds, last nest.

    A nest that stands alone, long before the others of the first round or long after those of the
    last one (an interrupted run), does not stretch the time: it counts as measured with them.
    """
    problem, when = layout.problem, layout.problem.moment[rows]
    rounds = nest_rounds(problem)[rows]
    inner = [
        when[rounds == number].mean()
        for number in np.unique(rounds)[1:-1]
        if len(np.unique(problem.nest[rows[rounds == number]])) >= MIN_NESTS
    ]
    first, last = when[rounds == rounds.min()], when[rounds == rounds.max()]
    middle, end = np.median(first), np.median(last)
    begun = max(first.min(), middle - REACH * (first.max() - middle))
    done = min(last.max(), end + REACH * (end - last.min()))
    return np.unique([begun, *inner, done])


def drift_movement(places: Floats) -> Floats:
    """Return how the seven parts of a drift move points (k, 3): (k, 3, 7)."""
    beam = places / np.linalg.norm(places, axis=1, keepdims=True)
    shift = np.broadcast_to(np.eye(3), (len(places), 3, 3))
    return np.concatenate([-cross_matrix(places), shift, beam[:, :, None]], axis=2)


@dataclass(frozen=True, eq=False)
class StartValues:
    """A first solution, from which the unknowns count.

    ``frame`` (3, 3): e1, e2, a as columns; ``lean`` beta (rad), ``distance`` (D,) of a mirror, or
    the ``origin`` o (3,) on the axis and the ``reflectors`` q (R, 3); ``nests`` (K, 3).
    """

    poses: Poses
    frame: Floats
    psi: Floats
    lean: float
    distance: Floats
    origin: Floats
    reflectors: Floats
    nests: Floats

    @classmethod
    def of(cls, layout: PointLayout) -> StartValues:
        """Return what the points show without any weights."""
        problem, count = layout.problem, len(layout.stations)
        poses = Poses.untied(count)
        if layout.tied and count > 1:
            poses = placed_stations(problem.xyz, layout.nests, count)
        seen = poses.placed(problem.xyz[layout.nests.row], layout.nests.station)
        point = layout.nests.point
        nests = np.array(
            [np.median(seen[point == k], axis=0) for k in range(int(point.max(initial=-1)) + 1)]
        )
        nests, none = nests.reshape(-1, 3), np.zeros((0, 3))
        if layout.pairs is None:
            frame, psi, origin, q = _of_circles(layout, poses)
            return cls(poses, frame, psi, 0.0, np.zeros(0), origin, q, nests)
        poses, frame, psi, lean = _of_normals(layout, poses)
        psi = layout.angles + np.angle(np.exp(1j * (psi - layout.angles)).mean())
        pairs, n = layout.pairs, mean_normals(problem.xyz, layout.pairs)
        middle = 0.5 * (problem.xyz[pairs.direct] + problem.xyz[pairs.mirrored])
        own = poses.placed(middle, pairs.station[pairs.group])
        offset = np.einsum("pi,pi->p", own, poses.turned(n, pairs.station)[pairs.group])
        which = pairs.position[pairs.group] if layout.tied else pairs.group
        distance = np.array([np.median(offset[which == k]) for k in range(int(which.max()) + 1)])
        return cls(poses, frame, psi, lean, distance, np.zeros(3), none, nests)


def _of_normals(layout: PointLayout, poses: Poses) -> tuple[Poses, Floats, Floats, float]:
    """Return poses, frame, psi (N,) and lean from the mirror's normals.

    Stations that nests do not join are turned so that their axes agree, and so do the azimuths.
    """
    pairs = layout.pairs
    assert pairs is not None
    seen = mean_normals(layout.problem.xyz, pairs)
    sets = layout.sets(by_station=not layout.tied)
    axes, height = cone_axes(poses.turned(seen, pairs.station), sets)
    if layout.tied:
        placed = poses.turned(seen, pairs.station)
        turned, first = azimuths(placed, axes[0]), np.unique(pairs.position, return_index=True)[1]
        frame = _frame(axes[0], placed[0])
        return poses, frame, turned[first], float(np.arcsin(height))
    readings = np.zeros(len(seen))
    for at, _ in sets:
        readings[at] = azimuths(seen[at], axes[at[0]])
    error = np.angle(np.exp(1j * (readings - sets.commanded)))
    joining = joining_map(pairs.position, sets.number, len(layout.angles))
    psi = layout.angles + joining @ error
    rotation = poses.rotation.copy()
    for at, _ in sets:
        own, back = _frame(axes[at[0]], seen[at[0]]), rotation_about_z(-psi[pairs.position[at[0]]])
        rotation[pairs.station[at[0]]] = (own @ back).T
    first = rotation[0].copy()  # the common frame is that of the first station
    poses = Poses(first.T @ rotation, poses.place)
    return poses, first.T, psi, float(np.arcsin(height))


def _frame(axis: Floats, towards: Floats) -> Floats:
    """Return e1, e2, a as columns (3, 3), e1 as near to ``towards`` as can be."""
    side = np.cross(axis, towards)
    side /= np.linalg.norm(side)
    return np.column_stack([np.cross(side, axis), side, axis])


def _of_circles(layout: PointLayout, poses: Poses) -> tuple[Floats, Floats, Floats, Floats]:
    """Return frame, psi (N,), origin (3,) and places (R, 3) of reflectors on the table."""
    own, sets = layout.reflectors, layout.sets()
    if not len(own.row):
        return np.eye(3), np.zeros(0), np.zeros(3), np.zeros((0, 3))
    placed = poses.placed(layout.problem.xyz[own.row], own.station)
    joining = joining_map(own.position, sets.number, len(layout.angles))
    turned = layout.angles - layout.angles[0] + joining @ circle_readings(placed, sets)
    circles = [fit_circle(placed[at], commanded) for at, commanded in sets]
    axis = np.mean([axis for axis, _, _ in circles], axis=0)
    axis /= np.linalg.norm(axis)
    origin = np.mean([centre for _, centre, _ in circles], axis=0)
    frame = _frame(axis, placed[0] - origin)
    arms = (placed - origin) @ frame
    back = rotation_about_z(-turned)[own.position]
    at_zero = np.einsum("mij,mj->mi", back, arms)
    return (
        frame,
        layout.angles - layout.angles[0],
        origin,
        np.stack([np.median(at_zero[at], axis=0) for at, _ in sets]),
    )


@dataclass(frozen=True, eq=False)
class TrackerModel:
    """The equations of a ``layout`` about a ``start``, and what could spoil the points."""

    layout: PointLayout
    start: StartValues
    spans: list[Span]

    @classmethod
    def of(cls, layout: PointLayout) -> TrackerModel:
        """Return the model of a layout."""
        return cls(layout, StartValues.of(layout), spans_of(layout)[0])

    @property
    def pairs(self) -> int:
        """How many elements are no nests."""
        return len(self.layout.group)

    @cached_property
    def station(self) -> Ints:
        """Station (m,) of each element."""
        return self.layout.problem.station[self.layout.rows]

    @cached_property
    def blocks(self) -> dict[str, int]:
        """The unknowns."""
        layout, start, n = self.layout, self.start, len(self.layout.angles)
        each = 6 if layout.tied else 3
        mirror = layout.pairs is not None
        return {
            "deviation": n,
            **({"tilt across": n, "tilt along": n} if mirror else {}),
            **({"distance": len(start.distance), "lean": 1} if mirror else {}),
            **({} if mirror else {"reflector": start.reflectors.size, "centre": 2}),
            "axis": 2,
            "station": each * (len(layout.stations) - 1),
            "nest": start.nests.size,
            "drift": PARTS * len(self.spans),
            "swing": SWINGS * len([span for span in self.spans if span.std > 0.0]),
        }

    @cached_property
    def part(self) -> dict[str, slice]:
        """Where the unknowns of each block are."""
        ends = np.cumsum([0, *self.blocks.values()]).tolist()
        return dict(zip(self.blocks, map(slice, ends[:-1], ends[1:]), strict=True))

    @cached_property
    def judged(self) -> Bools:
        """Which readings of nests (Q,) may be left out: three alone hold a station."""
        nests = self.layout.nests
        key = np.unique(np.column_stack([nests.station, nests.point]), axis=0)
        enough = np.bincount(key[:, 0], minlength=len(self.layout.stations)) > MIN_NESTS
        return np.asarray(enough[nests.station])

    @cached_property
    def reflection(self) -> Floats:
        """H (P, 3, 3) of each pair at the start; zero of reflectors on the table."""
        if self.layout.pairs is None:
            return np.zeros((self.pairs, 3, 3))
        n = mean_normals(self.layout.problem.xyz, self.layout.pairs)[self.layout.pairs.group]
        return np.asarray(np.eye(3) - 2.0 * n[:, :, None] * n[:, None, :])

    def carried(self, moved: Floats) -> Floats:
        """Return by how much errors of all points (n, 3, k) change the conditions, (m, 3, k)."""
        found = moved[self.layout.rows]
        if self.layout.pairs is not None:
            found[: self.pairs] -= self.reflection @ moved[self.layout.pairs.direct]
        return found

    @cached_property
    def frames(self) -> Floats:
        """Unit vectors (m, 3, 3): rows along the beam, level across it, and upwards."""
        beam = self.layout.problem.xyz[self.layout.rows]
        beam = beam / np.linalg.norm(beam, axis=1)[:, None]
        level = np.cross([0.0, 0.0, 1.0], beam)
        length = np.linalg.norm(level, axis=1)[:, None]
        # a beam straight up has no level direction of its own: +y serves
        level = np.where(length > 1e-6, level / np.maximum(length, 1e-6), [0.0, 1.0, 0.0])
        return np.stack([beam, level, np.cross(beam, level)], axis=1)

    @cached_property
    def covariance(self) -> Floats:
        """Covariance (m, 3, 3) of the conditions, m^2, by the stated noise."""
        problem, pairs = self.layout.problem, self.layout.pairs
        total = problem.noise.covariance(problem.xyz[self.layout.rows])
        if pairs is not None:
            direct = problem.noise.covariance(problem.xyz[pairs.direct])
            slope = problem.noise.mirror_slope_std * self.by_slope
            total[: self.pairs] += self.reflection @ direct @ self.reflection
            total[: self.pairs] += slope @ np.swapaxes(slope, 1, 2)
        return total

    @cached_property
    def by_slope(self) -> Floats:
        """How images (P, 3, 3) move per change of their normal about the spot that is struck."""
        pairs, xyz = self.layout.pairs, self.layout.problem.xyz
        assert pairs is not None
        direct, mirrored = xyz[pairs.direct], xyz[pairs.mirrored]
        normal = mean_normals(xyz, pairs)[pairs.group]
        offset = 0.5 * np.einsum("pi,pi->p", direct + mirrored, normal)
        # the beam from the tracker (origin) to the image strikes the glass at M' h / (n.M')
        spot = mirrored * (offset / np.einsum("pi,pi->p", mirrored, normal))[:, None]
        arm = direct - spot
        height = np.einsum("pi,pi->p", arm, normal)[:, None, None]
        across = np.eye(3) - normal[:, :, None] * normal[:, None, :]
        along = (across @ arm[:, :, None])[:, None, :, 0]
        return np.asarray(-2.0 * (normal[:, :, None] * along + height * across))

    @cached_property
    def std(self) -> Floats:
        """Standard deviations (m, 3) of the rows, m."""
        within = self.frames @ self.covariance @ np.swapaxes(self.frames, 1, 2)
        return np.asarray(np.sqrt(np.einsum("mii->mi", within)))

    @cached_property
    def root(self) -> Floats:
        """By what conditions along the axes of a station become rows (m, 3, 3)."""
        within = self.frames @ self.covariance @ np.swapaxes(self.frames, 1, 2)
        values, vectors = np.linalg.eigh(within)
        whitened = (vectors / np.sqrt(values)[:, None, :]) @ np.swapaxes(vectors, 1, 2)
        return np.asarray(self.std[:, :, None] * whitened @ self.frames)

    @cached_property
    def drifting(self) -> tuple[Floats, Floats]:
        """How the unknowns of drift and swings move all points: (n, 3, 7 K) and (n, 3, 2 K)."""
        xyz = self.layout.problem.xyz
        courses = np.zeros((len(xyz), 0)), np.zeros((len(xyz), 0))
        course = np.column_stack([courses[0], *(span.course for span in self.spans)])
        drift = (drift_movement(xyz)[:, :, None, :] * course[:, None, :, None]).reshape(
            *xyz.shape, -1
        )
        swings = [
            np.sin(term * np.pi * span.share)
            for span in self.spans
            if span.std > 0.0
            for term in range(1, SWINGS + 1)
        ]
        sideways = np.cross([0.0, 0.0, 1.0], xyz)  # per rad of azimuth
        swung = sideways[:, :, None] * np.column_stack([courses[1], *swings])[:, None, :]
        return drift, np.asarray(swung)

    def misclosures(self, x: Floats) -> tuple[Floats, csr_array]:
        """Return the conditions (m, 3) at the unknowns, and their derivatives (3 m, p)."""
        drift, swing = self.drifting
        of_time = np.concatenate([drift, swing], axis=2)
        columns = slice(self.part["drift"].start, self.part["swing"].stop)
        xyz = self.layout.problem.xyz - of_time @ x[columns]
        entries = _Entries(3 * len(self.layout.rows))
        every = np.arange(len(self.layout.rows))
        if of_time.shape[2]:
            here = np.arange(columns.start, columns.stop)
            entries.add(every, here, -self.carried(of_time))
        poses = self.poses(x)
        parts = self._mirror if self.layout.pairs is not None else self._reflectors
        found = np.concatenate(
            [parts(x, xyz, poses, entries), self._nests(x, xyz, poses, entries)]
        )
        return found, entries.design(len(x))

    def poses(self, x: Floats) -> Poses:
        """Return where the stations stand by the unknowns."""
        start, change = self.start.poses, self._pose_change(x)
        turn = rotation_from_vector(change[:, :3])
        return Poses(turn @ start.rotation, start.place + change[:, 3:])

    def _pose_change(self, x: Floats) -> Floats:
        each = 6 if self.layout.tied else 3
        change = np.zeros((len(self.layout.stations), 6))
        change[1:, :each] = x[self.part["station"]].reshape(-1, each)
        return change

    def frame(self, x: Floats) -> Floats:
        """Return e1, e2, a as columns (3, 3): a leans by u along e1, v along e2."""
        return np.asarray(self.start.frame @ rotation_from_vector(LEANING @ x[self.part["axis"]]))

    def _by_axis(self, x: Floats, own: Floats) -> Floats:
        """Return how vectors ``own`` (m, 3) to the frame move with u and v, (m, 3, 2)."""
        right = np.eye(3) - 0.5 * cross_matrix(LEANING @ x[self.part["axis"]])
        return np.asarray(-self.frame(x) @ cross_matrix(own) @ right @ LEANING)

    def psi(self, x: Floats) -> Floats:
        """Return the azimuths (N,) of a mirror's normals, or by which reflectors are turned."""
        n = self.blocks["deviation"]
        psi = self.start.psi + x[:n]
        if self.layout.pairs is None:
            return psi
        return np.asarray(psi + np.tan(self.start.lean) * x[self.part["tilt along"]])

    def _by_station(self, x: Floats, arm: Floats, poses: Poses, station: Ints) -> Floats:
        """Return how what a station sees at ``arm`` (m, 3) from it moves with its turn, (m, 3, 3).

        ``arm`` along the common axes. The turn counts from the start: by halves of it.
        """
        w = self._pose_change(x)[station, :3]
        left = np.eye(3) + 0.5 * cross_matrix(w)
        back = np.swapaxes(poses.rotation[station], 1, 2)
        return np.asarray(back @ cross_matrix(arm) @ left)

    def _station_columns(self, station: Ints) -> Ints:
        each = 6 if self.layout.tied else 3
        first = int(self.part["station"].start)
        return np.asarray(first + each * (station[:, None] - 1) + np.arange(each))

    def _mirror(self, x: Floats, xyz: Floats, poses: Poses, entries: _Entries) -> Floats:
        """Return the conditions (P, 3) of pairs."""
        pairs, part, tied = self.layout.pairs, self.part, self.layout.tied
        assert pairs is not None
        at, station = self.layout.position, pairs.station[pairs.group]
        lean = self.start.lean + x[part["lean"]]
        el, psi = (lean + x[part["tilt across"]])[at], self.psi(x)[at]
        ce, se, cp, sp, zero = np.cos(el), np.sin(el), np.cos(psi), np.sin(psi), 0.0 * psi
        frame = self.frame(x)
        n = np.column_stack([ce * cp, ce * sp, se]) @ frame.T
        which = at if tied else pairs.group
        d = (self.start.distance + x[part["distance"]])[which]
        back, t = np.swapaxes(poses.rotation[station], 1, 2), poses.place[station]
        own = np.einsum("pij,pj->pi", back, n)
        h = d - np.einsum("pi,pi->p", n, t)
        direct, image = xyz[pairs.direct], xyz[pairs.mirrored]
        height = np.einsum("pi,pi->p", own, direct) - h
        # along the axes of the station, by n and by h
        by_n = 2.0 * (own[:, :, None] * direct[:, None, :] + height[:, None, None] * np.eye(3))
        by_h = -2.0 * own
        by_common = by_n @ back - by_h[:, :, None] * t[:, None, :]
        every = np.arange(len(at))

        def enter(columns: Ints, moved: Floats) -> None:
            """Enter what movements (P, 3, k) of n do."""
            entries.add(every, columns, by_common @ moved)

        along = (np.column_stack([-ce * sp, ce * cp, zero]) @ frame.T)[:, :, None]
        up = (np.column_stack([-se * cp, -se * sp, ce]) @ frame.T)[:, :, None]
        enter(at[:, None], along)
        enter((part["tilt along"].start + at)[:, None], np.tan(self.start.lean) * along)
        enter((part["tilt across"].start + at)[:, None], up)
        enter(np.array([part["lean"].start]), up)
        own_frame = np.column_stack([ce * cp, ce * sp, se])
        enter(np.arange(part["axis"].start, part["axis"].stop), self._by_axis(x, own_frame))
        entries.add(every, (part["distance"].start + which)[:, None], by_h[:, :, None])
        movable = np.flatnonzero(station > 0)
        columns = self._station_columns(station[movable])
        turned = by_n[movable] @ self._by_station(x, n[movable], poses, station[movable])
        shifted = -by_h[movable, :, None] * n[movable, None, :]
        both = np.concatenate([turned, shifted], axis=2)[:, :, : columns.shape[1]]
        entries.add(movable, columns, both)
        return np.asarray(image - direct + 2.0 * height[:, None] * own)

    def _reflectors(self, x: Floats, xyz: Floats, poses: Poses, entries: _Entries) -> Floats:
        """Return how far reflectors on the table (M, 3) are from where they should be."""
        seen, part, frame = self.layout.reflectors, self.part, self.frame(x)
        q = (self.start.reflectors + x[part["reflector"]].reshape(-1, 3))[seen.reflector]
        turn = rotation_about_z(self.psi(x))[seen.position]
        arm = np.einsum("mij,mj->mi", turn, q) + np.append(x[part["centre"]], 0.0)
        place = self.start.origin + arm @ frame.T
        back = np.swapaxes(poses.rotation[seen.station], 1, 2)
        by = -back @ frame
        every = np.arange(len(q))
        aside = np.einsum("mij,mj->mi", turn, np.column_stack([-q[:, 1], q[:, 0], 0.0 * q[:, 2]]))
        entries.add(every, seen.position[:, None], by @ aside[:, :, None])
        entries.add(
            every, part["reflector"].start + 3 * seen.reflector[:, None] + np.arange(3), by @ turn
        )
        entries.add(every, np.arange(part["centre"].start, part["centre"].stop), by[:, :, :2])
        leaning = -back @ self._by_axis(x, arm)
        entries.add(every, np.arange(part["axis"].start, part["axis"].stop), leaning)
        return xyz[seen.row] - self._seen(x, place, poses, seen.station, every, entries)

    def _nests(self, x: Floats, xyz: Floats, poses: Poses, entries: _Entries) -> Floats:
        """Return how far nests (Q, 3) are from where they should be."""
        nests, every = self.layout.nests, self.pairs + np.arange(len(self.layout.nests.row))
        place = (self.start.nests + x[self.part["nest"]].reshape(-1, 3))[nests.point]
        columns = self.part["nest"].start + 3 * nests.point[:, None] + np.arange(3)
        if not self.layout.tied:
            entries.add(every, columns, np.tile(-np.eye(3), (len(every), 1, 1)))
            return xyz[nests.row] - place
        entries.add(every, columns, -np.swapaxes(poses.rotation[nests.station], 1, 2))
        return xyz[nests.row] - self._seen(x, place, poses, nests.station, every, entries)

    def _seen(
        self, x: Floats, place: Floats, poses: Poses, station: Ints, rows: Ints, entries: _Entries
    ) -> Floats:
        """Return places (m, 3) as their stations see them; enters what the poses do."""
        arm = place - poses.place[station]
        back = np.swapaxes(poses.rotation[station], 1, 2)
        movable = np.flatnonzero(station > 0)
        turned = self._by_station(x, arm[movable], poses, station[movable])
        both = np.concatenate([-turned, back[movable]], axis=2)
        columns = self._station_columns(station[movable])
        entries.add(rows[movable], columns, both[:, :, : columns.shape[1]])
        return np.asarray(np.einsum("mij,mj->mi", back, arm))

    def equations(self, x: Floats) -> tuple[Floats, Floats | csr_array]:
        """Return the rows (3 m,) as computed, which are observed to be zero, and their design."""
        found, design = self.misclosures(x)
        root = self.root
        computed = -np.einsum("mij,mj->mi", root, found).ravel()
        m = len(root)
        if len(x) < SPARSE:
            whole = design.toarray().reshape(m, 3, -1)
            return computed, np.asarray(-(root @ whole).reshape(3 * m, -1))
        rows = 3 * np.arange(m)[:, None, None] + np.arange(3)[:, None] + np.zeros(3, dtype=int)
        columns = 3 * np.arange(m)[:, None, None] + np.arange(3) + np.zeros((3, 1), dtype=int)
        mixing = csr_array((root.ravel(), (rows.ravel(), columns.ravel())))
        return computed, csr_array(-(mixing @ design))

    @property
    def limits(self) -> Limits:
        """The probability of a false alarm, as stated."""
        return Limits(significance=self.layout.problem.significance)

    def model(self) -> Model:
        """Return the model of the engine; its outputs are the deviations (N,) from the first."""
        layout, problem, blocks = self.layout, self.layout.problem, self.blocks
        m, count = len(layout.rows), sum(blocks.values())
        element = np.arange(m)
        outputs = block_rows(blocks, "nest")  # nests alone: where they stand
        if self.pairs:
            label = connected_islands(*tied_positions(layout), len(layout.angles))[0]
            first = np.unique(label, return_index=True)[1][label]
            outputs = np.eye(len(first), count) - np.eye(len(first), count)[first]
        kinds = np.where(element < self.pairs, 0, 1)
        model = Model(
            blocks=blocks,
            observed=np.zeros(3 * m),
            std=self.std.ravel(),
            equations=self.equations,
            outputs=outputs,
            words=WORDS,
            unit=UM,
            components=("the points",),
            groupings=tuple(self._groupings(kinds)),
            effects=tuple(self._effects()),
            row_names=lambda row: problem.row_name(int(layout.rows[row // 3])),
            element=np.repeat(element, 3),
            judged=np.repeat(np.append(kinds[: self.pairs] == 0, self.judged), 3),
        )
        if layout.pairs is not None:
            tilts = np.concatenate(
                [block_rows(blocks, f"tilt {way}") for way in ("across", "along")]
            )
            model = model.with_prior(
                "the tilts of the table", tilts, np.zeros(len(tilts)), problem.tilt_std
            )
        if blocks["swing"]:
            stds = np.repeat([span.std for span in self.spans if span.std > 0.0], SWINGS)
            swings = block_rows(blocks, "swing") / stds[:, None]
            model = model.with_prior(
                "the swings of the tracker", swings, np.zeros(len(swings)), 1.0
            )
        return model

    def _groupings(self, kinds: Ints) -> Iterator[Grouping]:
        layout, problem = self.layout, self.layout.problem
        moment = np.repeat(problem.moment[layout.rows], 3)

        def rows(number: Ints, wanted: Floats) -> Ints:
            return np.repeat(np.where(wanted, number, -1), 3)

        position = np.append(layout.position, np.full(len(layout.nests.row), -1))
        nest, beam = problem.nest[layout.rows], np.repeat(self.frames[:, 0], 3, axis=0)
        along = np.repeat(nest.astype(np.float64), 3)
        yield Grouping("position", rows(position, kinds == 0), along, beam)
        yield Grouping("station", rows(self.station, kinds == 0), moment, beam)
        yield Grouping("reflector", rows(nest, kinds == 0))
        yield Grouping("nests of station", rows(self.station, kinds == 1), moment, beam)
        yield Grouping("nest", rows(nest, kinds == 1), moment)

    def _effects(self) -> Iterator[Disturbing]:
        """Yield what could spoil the points: a nest moves, the mirror or the tracker turns.

        A mirror that turned or leans does so at all positions that come after.
        """
        layout, problem, nests = self.layout, self.layout.problem, self.layout.nests
        moment = np.repeat(problem.moment[layout.rows], 3)
        station = np.repeat(self.station, 3)
        point = np.append(np.full(self.pairs, -1), np.where(self.judged, nests.point, -1))
        back = np.swapaxes(self.start.poses.rotation[self.station], 1, 2)
        placed = (self.root @ back).reshape(-1, 3)
        if (point >= 0).any():
            moves = Steps(np.repeat(point, 3), moment, placed)
            yield Disturbing("knock", NEST_MOVED, moves, FAR, UM, family=True)
        turned = self.root @ self.carried(drift_movement(problem.xyz)[:, :, :3])
        turned = turned.reshape(len(moment), 3)
        drifting = drifts(station, moment) * turned[:, 2:]
        yield Disturbing("drift", "the tracker turns slowly", drifting, LARGEST, family=True)
        moves = Steps(station, moment, turned)
        yield Disturbing("knock", "the tracker turned", moves, LARGEST, family=True)
        if not self.pairs:
            return
        n, design = len(layout.angles), self.equations(np.zeros(sum(self.blocks.values())))[1]
        dense = design if isinstance(design, np.ndarray) else design.toarray()
        several = 2 if layout.pairs is not None else 1  # a reflector on the table leans no way
        turns = dense[:, : several * n].reshape(-1, several, n).sum(axis=2)
        once = np.repeat(np.where(np.arange(len(layout.rows)) < self.pairs, 0, -1), 3)
        what = phrase("the mirror") if layout.pairs is not None else phrase("the reflector")
        slowly, moves = drifts(once, moment) * turns, Steps(once, moment, turns)
        yield Disturbing("drift", phrase("{0} turns slowly on the table", what), slowly, LARGEST)
        yield Disturbing(
            "knock", phrase("{0} turned on the table", what), moves, LARGEST, family=True
        )


def tied_positions(layout: PointLayout) -> tuple[Ints, Ints]:
    """Return positions, and what ties those of one number: a mirror all of them."""
    sets = layout.sets()
    return (
        layout.reflectors.position if layout.pairs is None else layout.pairs.position,
        sets.number,
    )


def curve_model(layout: PointLayout) -> CurveModel:
    """Return the points over ECC, to be solved with what other instruments saw."""
    tracker = TrackerModel.of(layout)
    return CurveModel(
        tracker.model(), layout.angles, {"ECC": block_rows(tracker.blocks, "deviation")}
    )


class _Entries:
    """Collects derivatives of conditions by unknowns."""

    def __init__(self, rows: int) -> None:
        self._rows = rows
        self._parts: list[tuple[Ints, Ints, Floats]] = []

    def add(self, elements: Ints, columns: Ints, values: Floats) -> None:
        """Add ``values`` (m, 3, k) of ``elements`` (m,), by unknowns (m, k) or (k,)."""
        rows = 3 * elements[:, None, None] + np.arange(3)[:, None]
        columns = np.broadcast_to(columns, (len(elements), values.shape[2]))[:, None, :]
        rows, columns = np.broadcast_arrays(rows, columns)
        if rows.shape != values.shape:
            values = np.broadcast_to(values, rows.shape)
        self._parts.append((rows.ravel(), columns.ravel(), values.ravel()))

    def design(self, size: int) -> csr_array:
        """Return the derivatives (3 m, size)."""
        rows, columns, values = (np.concatenate(part) for part in zip(*self._parts, strict=True))
        return csr_array(coo_array((values, (rows, columns)), shape=(self._rows, size)))
