"""Where the machine finds balls that the table carries, for the engine.

With the table at the angle theta the centre of a ball stands in the machine's coordinates at

    p = c + A (v + e x v + d),    v = Rz(theta + ECC) q,    e = (EAC, EBC, 0), d = (EXC, EYC, EZC),

and the machine shows p + S (p - c0). ``q`` is the place of the ball on the table; c = c0 + (XOC,
YOC, 0) the point of the axis average line at the height of c0, A = Ry(BOC) Rx(AOC) its direction.
c0 is a nominal point of the axis, at the height for which XOC, YOC, EXC and EYC are stated. S,
upper triangular, holds the scales of x, y, z (how much more they read per length) and by how much
x reads more per y, x per z, y per z: the squareness of the linear axes. Names and signs of ISO
230-1 and 230-7; metres, radians. Products of tilts among each other (below 1e-8 of the radius) are
left out.

Where the table stands on an axis A or B that tilts it, w is what p is with the tilt at 0, and c0
stays where it is. The motions of the table are then its own at every tilt. At the tilt alpha

    p = t + R u + (q + e) x R u - R (q x u) + d,    u = w - t,    R = Rx(alpha) (B: Ry)

t = t0 + the place of the axis average line (YOA and ZOA; B: XOB and ZOB), q its direction (BOA,
COA; AOB, COB), d and e the motions (EXA, EYA, EZA) and (EAA, EBA, ECA) at that tilt. Products of
small turns are left out.

Where the table turns on while it is read, the linear axes may be late by a time tau: the nest that
follows a ball is behind by tau times the speed, and shows the ball so much farther on. The tip of
the probe is off by a constant that joins p.

A ball bar reads the length |p - s| + b from the ball to another one in the spindle, which the
machine shows at s + S (s - c0); b is how much longer the bar is than it says.

What the equations leave open is a matter of definition, see :func:`definitions`. Of the motions at
one angle that no ball determines, the statement of the settings takes the place of observations.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from math import inf, isfinite
from typing import Final, NamedTuple

import numpy as np
from scipy.sparse import coo_array, csr_array, hstack

from rotcal_ros.adjust.bordered import SparseDesign
from rotcal_ros.adjust.gathering import Words
from rotcal_ros.adjust.kernels import DenseKernel
from rotcal_ros.adjust.model import (
    MOST_MOMENTS,
    Disturbing,
    Grouping,
    Model,
    Steps,
    Unit,
    block_rows,
    drifts,
    recurring,
)
from rotcal_ros.adjust.outputs import Outputs
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.foundation.language import Phrase, phrase
from rotcal_ros.foundation.units import ARCSEC, DEGREE, MICROMETRE
from rotcal_ros.geometry.rotations import cross_matrix, rotation_about_z, rotation_from_vector
from rotcal_ros.methods.table_balls.motions import StatedMotions, possible_spectra
from rotcal_ros.methods.table_balls.settings import (
    BAR,
    BallsPlanSettings,
    BallsSolverSettings,
    below_the_table,
    sense_of,
)
from rotcal_ros.planning.points import parse_points
from rotcal_ros.planning.readings import Readings, pass_numbers
from rotcal_ros.planning.table_angles import table_angles


@dataclass(frozen=True, eq=False)
class Tilting:
    """The axis ``letter`` through ``point`` (3,), m, at the ``tilts`` (t,), rad.

    They count counter-clockwise; ``degrees`` (t,) are the commanded ones.
    """

    letter: str
    point: Floats
    tilts: Floats
    degrees: tuple[float, ...]

    @classmethod
    def of(cls, plan: BallsPlanSettings) -> Tilting | None:
        """Return that of a plan; None: the table stands on no other."""
        letter = below_the_table(plan.chain)
        if not letter:
            return None
        tilts = sense_of(plan.chain, letter) * np.array(plan.tilts_deg) * DEGREE
        return cls(letter, np.array(plan.tilting_axis_m), tilts, plan.tilts_deg)

    @property
    def along(self) -> int:
        """The direction of the axis: 0 for x, 1 for y."""
        return "AB".index(self.letter)

    @property
    def across(self) -> tuple[int, int]:
        """The other two, so that the three are right-handed."""
        return (self.along + 1) % 3, (self.along + 2) % 3

    @property
    def line(self) -> tuple[str, ...]:
        """Names of the unknowns of its line: two places, then two turns, in the order of x y z."""
        axes = sorted(self.across)
        return tuple(f"{'XYZABC'[part + k]}O{self.letter}" for part in (0, 3) for k in axes)

    @property
    def motions(self) -> tuple[str, ...]:
        """Names of its motions, such as EXA to ECA."""
        return tuple(f"E{part}{self.letter}" for part in "XYZABC")

    @cached_property
    def turns(self) -> Floats:
        """The nominal rotations (t, 3, 3)."""
        return rotation_from_vector(self.tilts[:, None] * np.eye(3)[self.along])

    def remove_tilt(self, points: Floats, tilt: Ints) -> Floats:
        """Return points (n, 3) as a perfect axis would have them at a tilt of 0."""
        inverse = np.swapaxes(self.turns, -1, -2)[tilt]
        return np.asarray(self.point + np.einsum("nij,nj->ni", inverse, points - self.point))

    def apply_tilt(self, points: Floats, tilt: int) -> Floats:
        """Return where a perfect axis takes ``points`` (..., 3) at a tilt."""
        return np.asarray(self.point + (points - self.point) @ self.turns[tilt].T)

    def of_line(self, four: Floats) -> tuple[Floats, Floats]:
        """Return the vectors (3,) of place and of direction that the unknowns of the line are."""
        place, turn = np.zeros(3), np.zeros(3)
        axes = sorted(self.across)
        place[axes], turn[axes] = four[:2], four[2:]
        return place, turn

    def tilted(
        self, away: Floats, tilt: Ints, line: Floats, motions: Floats
    ) -> tuple[Floats, Floats, Floats, Floats]:
        """Return ``away`` (n, 3), from t0, after the tilt; its derivatives.

        ``line`` (4,), ``motions`` (n, 6). The derivatives are by ``away`` (n, 3, 3), by the line
        (n, 3, 4), and by the motions at that tilt (n, 3, 6).
        """
        place, turn = self.of_line(line)
        d, e = motions[:, :3], motions[:, 3:]
        nominal, u = self.turns[tilt], away - place
        by_away = nominal + cross_matrix(turn + e) @ nominal - nominal @ cross_matrix(turn)
        carried = np.einsum("nij,nj->ni", nominal, u)
        by_turn = nominal @ cross_matrix(u) - cross_matrix(carried)
        axes = sorted(self.across)
        by_line = np.concatenate([(np.eye(3) - by_away)[:, :, axes], by_turn[:, :, axes]], axis=2)
        shift = np.broadcast_to(np.eye(3), by_away.shape)
        by_motions = np.concatenate([shift, -cross_matrix(carried)], axis=2)
        moved = place + np.einsum("nij,nj->ni", by_away, u) + d
        return moved, by_away, by_line, by_motions

    def definitions(self) -> Iterator[dict[str, Floats]]:
        """Yield what is zero by definition, as of the table's own motions.

        No motion has a mean; the pairs across the axis have no part that turns with it: that is
        where it stands, and where the table's axis stands on it.
        """
        mean, c, s = np.ones(len(self.tilts)), np.cos(self.tilts), np.sin(self.tilts)
        yield from ({name: mean} for name in self.motions)
        for part in (0, 3):
            x, y = (self.motions[part + k] for k in self.across)
            yield from ({x: c, y: s}, {x: -s, y: c})

    def table_axis(self, origin: Floats) -> dict[str, Floats]:
        """Return how the table's axis at ``origin`` (3,) feels the line (4) and the motions.

        By name of AXIS rows (t, 4 + 6 t), seen as with the tilt at 0.
        """
        count = len(self.tilts)
        inverse = np.swapaxes(self.turns, -1, -2)
        away = np.repeat((origin - self.point)[None], count, axis=0)
        _, _, by_line, by_motions = self.tilted(
            away, np.arange(count), np.zeros(4), np.zeros((count, 6))
        )
        line_turn = (inverse - np.eye(3))[:, :, sorted(self.across)]
        shift = np.concatenate([inverse @ by_line, np.zeros((count, 3, 6 * count))], axis=2)
        turn = np.concatenate(
            [np.zeros((count, 3, 2)), line_turn, np.zeros((count, 3, 6 * count))], axis=2
        )
        for k in range(6):
            column = 4 + k * count + np.arange(count)
            shift[np.arange(count), :, column] = (inverse @ by_motions)[:, :, k]
            if k >= 3:
                turn[np.arange(count), :, column] = inverse[:, :, k - 3]
        return {"XOC": shift[:, 0], "YOC": shift[:, 1], "AOC": turn[:, 0], "BOC": turn[:, 1]}


AXIS: Final = ("XOC", "YOC", "AOC", "BOC")
"""Position (m) and direction (rad) of the axis average line, named as in ISO 230-1."""
MOTIONS: Final = ("radial motion", "tangential motion", "axial motion")
"""Of a ball, in the directions that turn with it."""
ALSO: Final = ("scale", "squareness", "lag")
"""What is found beside the table, of that which is stated."""
SUMS: Final = "defined part"
"""Block of what statements do not count of motions, since it is a matter of definition."""
ENTRIES: Final = ((0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2))
"""Rows and columns of S: the blocks ``scale`` and, behind it, ``squareness``."""
LEFT_OVER: Final = 0.05
"""A motion is determined if no more than this share of its statement is left in it."""
UNSTATED_RAD: Final = 0.1
"""Nothing is stated of ECC: it may be anything up to this."""
HELD: Final = 1e-3
"""Standard deviation of a definition in those of a centre: it adds a millionth to a variance."""
WEAK: Final = 3e-4
"""Share of the length of an unknown's column, beside the others, that is of no use."""
SHARED: Final = 0.01
"""Share of a definition that has to be new, beside those before it; of a variance, to be left."""
WORDS: Final = {
    3: Words("coordinates", "dirt, heat or a loose ball", "at the balls", "at the ball"),
    1: Words("lengths", "dirt, heat or a loose ball", "at the bar", "at the bar"),
}
"""What readings of so many values are called."""
UM: Final = Unit("um", MICROMETRE)
AGAIN: Final = "machine or table drift in each run alike"


@dataclass(frozen=True, eq=False)
class BallsOnTable:
    """Which target is seen at which angle: ``angles`` (p,) rad; ``position``, ``target`` (n,).

    The angles count counter-clockwise; ``sense`` times them are those that were commanded.

    ``tilting``: the axis below the table, if there is one, and ``tilt`` (n,), which of its t
    tilts; the motions (6, t p) of the table are those at all angles, tilt after tilt.
    ``origin`` (3,): c0 in the machine's coordinates. ``places`` (k, 3): nominal places of the
    balls from there, with the table at angle 0; ``bars`` (b, 3): the set-ups of a bar at each of
    them, outward, along its way and up, m; none: centres are seen, target is the ball.
    ``stated`` (6,): standard deviations of the motions, m and rad; ``sigma``: that of a coordinate
    of a centre or of a length, m. ``speed``: rad/s at which the table turns, of each run or,
    where something was read, at each reading (n,); none: it stands.
    ``known``: blocks of what else is stated to be zero, with its standard deviation, SI; infinite:
    the readings alone determine it. ``sums``: columns of :attr:`StatedRows.sums`.
    """

    angles: Floats
    origin: Floats
    places: Floats
    bars: Floats
    position: Ints
    target: Ints
    stated: Floats
    sigma: float
    sense: float
    tilting: Tilting | None
    tilt: Ints
    speed: Floats
    known: Mapping[str, float]
    sums: int = 0

    @classmethod
    def of(
        cls, plan: BallsPlanSettings, solver: BallsSolverSettings, read: Readings | None = None
    ) -> BallsOnTable:
        """Return those of what was read, or of one run in which every target is seen.

        With a tilting axis the station of what was read is the tilt.

        Raises PlanError for coordinates that are no points and angles that do not ascend.
        """
        sense = sense_of(plan.chain, "C")
        angles = sense * np.array(table_angles(plan))
        balls = np.array(parse_points(plan.balls_m, "balls_m")).reshape(-1, 3)
        origin = np.array(plan.axis_m)
        tilting = Tilting.of(plan)
        tilts = 1 if tilting is None else len(tilting.tilts)
        bars = np.array(parse_points(plan.bars_m * (plan.measure == BAR), "bars_m")).reshape(-1, 3)
        targets = len(balls) * max(1, len(bars))
        tilt, position, target = np.indices((tilts, len(angles), targets)).reshape(3, -1)
        turning = runs = sense * np.array(plan.turning_deg_s) * DEGREE
        if read is not None:
            position, target = read.position, read.target
            tilt = np.zeros_like(position) if tilting is None else read.station
            turning = runs[read.station] if len(runs) else runs
        shift, lean = solver.error_motion_std_m, solver.tilt_std_arcsec * ARCSEC
        stated = np.array([shift, shift, shift, lean, lean, UNSTATED_RAD])
        known = {
            "scale": solver.scale_std_um_per_m * MICROMETRE,
            "squareness": solver.squareness_std_um_per_m * MICROMETRE,
            "lag": _lag_std(turning, solver),
            "tip": solver.tip_std_m,
            "bar": solver.bar_std_m * bool(len(bars)),
        }
        return cls(
            angles, origin, balls - origin, bars, position, target,
            stated, solver.sigma_centre_m, sense, tilting, tilt,
            turning,
            {name: std for name, std in known.items() if std},
        )  # fmt: skip

    @property
    def ball(self) -> Ints:
        """Which ball is seen (n,)."""
        return self.target // max(1, len(self.bars))

    @property
    def coordinates(self) -> int:
        """How many values a reading has: those of a centre, or a length."""
        return 1 if len(self.bars) else 3

    @cached_property
    def arms(self) -> Floats:
        """From the ball of each target to that in the spindle (k b, 3), m, at angle 0."""
        return np.asarray(self.bars @ local_directions(self.places)).reshape(-1, 3)

    @cached_property
    def aims(self) -> Floats:
        """Where the spindle goes for each target (k,) or (k b, 3), from c0, at angle 0."""
        return self.places if not len(self.bars) else self._of_targets(self.places) + self.arms

    def _of_targets(self, balls: Floats) -> Floats:
        """Return what is said of balls (k, ...) for each of the targets."""
        return np.repeat(balls, max(1, len(self.bars)), axis=0)

    @property
    def sent(self) -> Floats:
        """Where the spindle goes for each target at each angle of each tilt (t, p, k b, 3), m."""
        flat = self.turned(self.aims) + self.origin
        if self.tilting is None:
            return flat[None]
        return np.array([self.tilting.apply_tilt(flat, tilt) for tilt in range(self.tilts)])

    @property
    def tilts(self) -> int:
        """How many tilts there are; 1 without a tilting axis."""
        return 1 if self.tilting is None else len(self.tilting.tilts)

    @property
    def stop(self) -> Ints:
        """Which of the motions (6, t p) is seen (n,)."""
        return self.tilt * len(self.angles) + self.position

    @cached_property
    def blocks(self) -> dict[str, int]:
        """How many unknowns there are of each kind; ``ball`` are three coordinates of each."""
        motions = {name: self.tilts * len(self.angles) for name in COMPONENTS}
        found = {**dict.fromkeys(AXIS, 1), "ball": self.places.size, **motions}
        found |= {"scale": 3, "squareness": 3}
        if (axis := self.tilting) is not None:
            found |= dict.fromkeys(axis.line, 1) | dict.fromkeys(axis.motions, self.tilts)
        last = {"lag": 1, "tip": 3, "bar": len(self.arms)}
        found |= {name: count for name, count in last.items() if name in self.known}
        return found | ({SUMS: self.sums} if self.sums else {})

    @cached_property
    def first(self) -> dict[str, int]:
        """Number of the first unknown of each kind."""
        ends = np.cumsum([0, *self.blocks.values()]).tolist()
        return dict(zip(self.blocks, ends, strict=False))

    @property
    def motions(self) -> slice:
        """Where the motions are among the unknowns."""
        return slice(self.first["EXC"], self.first["scale"])

    def turned(self, places: Floats) -> Floats:
        """Return where balls at ``places`` (k, 3) stand at each angle, (p, k, 3), from c0."""
        return np.asarray(places @ np.swapaxes(rotation_about_z(self.angles), -1, -2))

    def unstated_motions(self, places: Floats, seen: Floats | float) -> Floats:
        """Return rows (t p, 6, 6), per unit of a statement, of motions that are open there.

        Balls at ``places`` (k, 3); ``seen`` (t p, k b, 1, 1): 0 for targets that are not. Rows of
        zeros are none. A motion counts as determined if a reading says more of it than its
        statement.
        """
        turned = np.tile(self.turned(self._of_targets(places)), (self.tilts, 1, 1))
        shifts = np.broadcast_to(np.eye(3), (*turned.shape, 3))
        moves = np.concatenate([shifts, -cross_matrix(turned)], axis=-1) * self.stated * seen
        if len(self.bars):  # what a shift does to a length
            along = self.arms / np.linalg.norm(self.arms, axis=1)[:, None]
            moves = np.tile(self.turned(along), (self.tilts, 1, 1))[:, :, None] @ moves
        rows = np.pad(moves.reshape(len(turned), -1, 6), ((0, 0), (0, 6), (0, 0)))
        _, size, ways = np.linalg.svd(rows, full_matrices=False)
        return np.asarray(ways * (size < self.sigma)[:, :, None])

    @cached_property
    def shown(self) -> tuple[str, ...]:
        """The motions that the targets determine at every angle where all are seen."""
        share = np.linalg.norm(self.unstated_motions(self.places, 1.0), axis=1).max(axis=0)
        return tuple(
            name for name, left in zip(COMPONENTS, share, strict=True) if left < LEFT_OVER
        )

    def started(self, points: Floats) -> Floats:
        """Return unknowns (u,) of a perfect table that fits centres at ``points`` (n, 3) best.

        With a bar, those of perfect axes and balls at their places.
        """
        start = np.zeros(sum(self.blocks.values()))
        start[4 : self.first["EXC"]] = self.places.ravel()
        if len(self.bars):
            return start
        if self.tilting is not None:
            points = self.tilting.remove_tilt(points, self.tilt)
        turn = rotation_about_z(self.angles[self.position])
        design = np.zeros((*points.shape, 2 + self.places.size))
        design[:, [0, 1], [0, 1]] = 1.0
        for axis in range(3):
            column = 2 + 3 * self.ball + axis
            design[np.arange(len(points)), :, column] = turn[:, :, axis]
        away = (points - self.origin).ravel()
        found = np.linalg.lstsq(design.reshape(len(away), -1), away, rcond=None)[0]
        start[:2], start[4 : self.first["EXC"]] = found[:2], found[2:]
        return start

    @cached_property
    def columns(self) -> Ints:
        """Numbers of the unknowns that each reading feels (n, f), by kind as in ``blocks``."""
        own = {"ball": 3 * self.ball[:, None] + np.arange(3), "bar": self.target[:, None]}
        own[SUMS] = np.zeros((1, 0), dtype=np.int64)  # no reading feels them
        own |= dict.fromkeys(COMPONENTS, self.stop[:, None])
        if self.tilting is not None:
            own |= dict.fromkeys(self.tilting.motions, self.tilt[:, None])
        rows = [
            np.broadcast_to(first + at, (len(self.tilt), at.shape[1]))
            for name, first in self.first.items()
            for at in (own.get(name, np.arange(self.blocks[name])[None]),)
        ]
        return np.concatenate(rows, axis=1)

    def _at(self, kind: str, count: int) -> slice:
        """Return where ``count`` unknowns from a kind on are among those that a reading feels."""
        first = int(np.searchsorted(self.columns[0], self.first[kind]))
        return slice(first, first + count)

    def __call__(self, x: Floats) -> tuple[Floats, csr_array]:
        """Return what is read (3 n,) or (n,) with unknowns ``x`` (u,), and its derivatives.

        Link by link of the chain: where a ball is from c0, away (n, 3), and what the unknowns that
        its reading feels, own (n, f), do to it: rows (n, 3, f).
        """
        own, show, linear = x[self.columns], np.eye(3), self._at("scale", len(ENTRIES[0]))
        away, rows = self._on_table(own)
        if self.tilting is not None:
            away, rows = self._on_tilting(self.tilting, own, away, rows)
        if "lag" in self.known:
            lag = self._at("lag", 1).start
            ahead, rows[:, :, lag] = self._ahead_of_nest(float(own[0, lag]))
            away = away + ahead
        if "tip" in self.known:
            at = self._at("tip", 3)
            rows[:, :, at] = np.eye(3)
            away = away + own[:, at]
        show[ENTRIES] += own[0, linear]
        seen = np.linalg.solve(show, self._spindle.T).T if len(self.bars) else away
        rows = show @ rows
        rows[:, ENTRIES[0], np.arange(linear.start, linear.stop)] = seen[:, ENTRIES[1]]
        read = self.origin + away @ show.T
        if len(self.bars):
            arm = seen - away
            length = np.linalg.norm(arm, axis=1)
            along = np.linalg.solve(show.T, (arm / length[:, None]).T).T
            rows = -along[:, None] @ rows
            rows[:, 0, -1] = 1.0
            read = length + own[:, -1]
        return read.ravel(), csr_array((rows.ravel(), *self._felt), shape=(read.size, len(x)))

    @cached_property
    def _spindle(self) -> Floats:
        """Where the machine shows the spindle's ball at each reading (n, 3), from c0."""
        return np.asarray(self.sent[self.tilt, self.position, self.target] - self.origin)

    @cached_property
    def _felt(self) -> tuple[Ints, Ints]:
        """Columns of the entries of all rows, and where each row begins."""
        columns = np.repeat(self.columns, self.coordinates, axis=0)
        return columns.ravel(), np.arange(0, columns.size + 1, columns.shape[1])

    def _ahead_of_nest(self, lag: float) -> tuple[Floats, Floats]:
        """Return how much farther (n, 3) balls are from a nest that is ``lag`` (s) late.

        And its derivative by the lag.
        """
        turned = rotation_about_z(-self.speed * lag)
        nest = np.einsum("nij,nj->ni", turned, self._spindle)
        return self._spindle - nest, self.speed[:, None] * np.cross([0.0, 0.0, 1.0], nest)

    def _on_tilting(
        self, axis: Tilting, own: Floats, away: Floats, rows: Floats
    ) -> tuple[Floats, Floats]:
        """Return the same as :meth:`_on_table` where the table is tilted."""
        line, motions = self._at(axis.line[0], 4), self._at(axis.motions[0], 6)
        from_point = self.origin - axis.point
        away, by_away, by_line, by_motions = axis.tilted(
            away + from_point, self.tilt, own[0, line], own[:, motions]
        )
        rows = by_away @ rows
        rows[:, :, line], rows[:, :, motions] = by_line, by_motions
        return away - from_point, rows

    def _on_table(self, own: Floats) -> tuple[Floats, Floats]:
        """Return where the balls are (n, 3), from c0, as with a tilt of 0.

        And what the unknowns ``own`` (n, f) do to them: those of axis, balls and motions.
        """
        places, motions = own[:, 4:7], own[:, 7:13]
        turn = rotation_about_z(self.angles[self.position] + motions[:, 5])
        carried = np.einsum("nij,nj->ni", turn, places)
        tilt = np.eye(3) + cross_matrix(motions[:, 3:5] @ np.eye(2, 3))
        moved = np.einsum("nij,nj->ni", tilt, carried) + motions[:, :3]
        direction, *changes = _direction(*own[0, 2:4])
        rows = np.zeros((len(own), 3, own.shape[1]))
        rows[:, [0, 1], [0, 1]] = 1.0
        for number, change in enumerate(changes, 2):
            rows[:, :, number] = moved @ change.T
        leaning = direction @ tilt
        rows[:, :, 4:7] = leaning @ turn
        rows[:, :, 7:10] = direction
        rows[:, :, 10:12] = (direction @ -cross_matrix(carried))[:, :, :2]
        rows[:, :, 12] = np.einsum("nij,nj->ni", leaning, np.cross([0, 0, 1], carried))
        return moved @ direction.T + np.append(own[0, :2], 0.0), rows


def _lag_std(speeds: Floats, solver: BallsSolverSettings) -> float:
    """Return what is stated of the lag of a table that turns at ``speeds`` (r,); 0: there is none.

    Runs of several speeds determine it themselves; to know it far better than it was stated would
    look like a contradiction.
    """
    if not len(speeds):
        return 0.0
    return solver.lag_std_s if len(set(speeds.tolist())) == 1 else inf


def local_directions(places: Floats) -> Floats:
    """Return the directions outward, along its way, and up (k, 3, 3) of balls at ``places``."""
    flat = places * [1.0, 1.0, 0.0]
    radius = np.linalg.norm(flat, axis=1)[:, None]
    out = np.where(radius > 0.0, flat, [1.0, 0.0, 0.0]) / np.where(radius > 0.0, radius, 1.0)
    up = np.broadcast_to([0.0, 0.0, 1.0], out.shape)
    return np.stack([out, np.cross(up, out), up], axis=1)


def _direction(about_x: float, about_y: float) -> tuple[Floats, Floats, Floats]:
    """Return A = Ry(BOC) Rx(AOC), and its derivatives by both angles, each (3, 3)."""
    x, y = rotation_from_vector([[about_x, 0.0, 0.0], [0.0, about_y, 0.0]])
    by_x, by_y = cross_matrix(np.eye(3)[:2])
    return y @ x, y @ by_x @ x, by_y @ y @ x


def definitions(angles: Floats, tilts: int = 1) -> Iterator[dict[str, Floats]]:
    """Yield what is zero by definition: sums over the ``angles`` (p,) of motions, by their names.

    No motion has a mean: that is the place and direction of the average line, of the balls along
    it and around it. EXC, EYC and EAC, EBC have no part that turns with the table: that is the
    place of the balls. Where balls determine less, fewer of these are needed. Of several ``tilts``
    each has its own means: that is the motion of what tilts.
    """
    c, s = np.tile(np.cos(angles), tilts), np.tile(np.sin(angles), tilts)
    for mean in np.repeat(np.eye(tilts), len(angles), axis=1):
        yield from ({name: mean} for name in COMPONENTS)
    for x, y in (("EXC", "EYC"), ("EAC", "EBC")):
        yield from ({x: c, y: s}, {x: -s, y: c})


class StatedRows(NamedTuple):
    """Rows of motions that are stated to be zero, per standard deviation, of the motions alone.

    Motions are stated as they are, and by definition without their means and turning parts
    (:func:`definitions`). ``each`` (k, 6 t p) are the open ones stop by stop; ``sums`` (k, d) is
    what those parts are of them, which they do not count. What is open of a part counts for
    itself, and with the less scatter the more of it is definition: ``parts`` (l, 6 t p).
    """

    each: csr_array
    sums: Floats
    parts: Floats

    @classmethod
    def of(cls, balls: BallsOnTable, places: Floats, *, whole: bool) -> StatedRows:
        """Return that of open motions of balls at ``places`` (k, 3), or of the whole."""
        each = _open_motions(balls, places, whole=whole)
        along, share, _ = np.linalg.svd(
            each @ np.linalg.qr(_sums(balls).T)[0], full_matrices=False
        )
        along, left = along[:, share > SHARED], 1.0 - share[share > SHARED] ** 2
        kept, stated = left > SHARED, np.repeat(balls.stated, balls.tilts * len(balls.angles))
        parts = (along[:, kept] / np.sqrt(left[kept])).T @ each
        scaled = csr_array(
            (each.data / stated[each.indices], each.indices, each.indptr), each.shape
        )
        return cls(scaled, along, parts / stated)

    @property
    def whole(self) -> Floats:
        """All rows (k + l, 6 t p)."""
        return np.concatenate([self.each.toarray(), self.parts])

    def known(self, balls: BallsOnTable, design: csr_array) -> tuple[csr_array, Floats]:
        """Return all that is known beside the ``design`` (n, u) of readings, per its deviation.

        Rows (k, u) stop by stop; others (l, u): of parts, of what else is stated, and definitions.
        """
        at, k, unknowns = balls.motions, self.each.shape[0], sum(balls.blocks.values())
        before, between = (k, at.start), (k, unknowns - balls.sums - at.stop)
        each = csr_array(
            hstack([csr_array(before), self.each, csr_array(between), csr_array(self.sums)])
        )
        rows = np.zeros((len(self.parts), unknowns))
        rows[:, at] = self.parts
        stated = ((name, std) for name, std in balls.known.items() if isfinite(std))
        rows = np.concatenate([rows, *(block_rows(balls.blocks, n) / std for n, std in stated)])
        telling = (
            SparseDesign(design / balls.sigma, np.zeros((0, unknowns))).beside(each).beside(rows)
        )
        return each, np.concatenate([rows, needed_definitions(balls, telling)])


def _sums(balls: BallsOnTable) -> Floats:
    """Return the definitions (d, 6 t p), of the motions alone."""
    every = definitions(balls.angles, balls.tilts)
    return np.array([_row(balls, each)[balls.motions] for each in every])


def _open_motions(balls: BallsOnTable, places: Floats, *, whole: bool) -> csr_array:
    """Return orthonormal rows (k, 6 t p), per unit of a statement, of open motions or of all."""
    count = balls.tilts * len(balls.angles)
    seen = np.zeros((count, len(balls.aims), 1, 1))
    seen[balls.stop, balls.target] = 1.0
    untold = (
        np.broadcast_to(np.eye(6), (count, 6, 6))
        if whole
        else balls.unstated_motions(places, seen)
    )
    stop, row = np.nonzero(untold.any(axis=2))
    at = np.arange(6) * count + stop[:, None]  # of each stop, its six
    entries = untold[stop, row].ravel(), (np.repeat(np.arange(len(stop)), 6), at.ravel())
    return csr_array(coo_array(entries, shape=(len(stop), 6 * count)))


def _row(balls: BallsOnTable, sums: Mapping[str, Floats]) -> Floats:
    """Return the row (u,) of ``sums`` of unknowns of some kinds."""
    row = np.zeros(sum(balls.blocks.values()))
    for name, factors in sums.items():
        row[balls.first[name] : balls.first[name] + len(factors)] = factors
    return row


def needed_definitions(balls: BallsOnTable, telling: SparseDesign) -> Floats:
    """Return rows (d, u) of the definitions that are needed beside the ``telling`` rows (n, u).

    Per standard deviation of each; without them the unknowns that they join would be open.
    """
    kernel = telling.kernel(WEAK) or DenseKernel.of(telling, np.zeros(0, np.int64), WEAK)
    scale = np.where(telling.lengths > 0.0, telling.lengths, 1.0)
    open_ = np.linalg.qr(scale[:, None] * kernel.directions)[0].T
    chosen = np.zeros((0, len(scale)))
    known, radius = np.zeros((0, len(open_))), float(np.abs(balls.places).max())
    of_tilting = () if balls.tilting is None else balls.tilting.definitions()
    for sums in (*definitions(balls.angles, balls.tilts), *of_tilting):
        row = _row(balls, sums)
        felt = open_ @ (row / scale)
        new = felt - known.T @ (known @ felt)
        if np.linalg.norm(new) > SHARED * np.linalg.norm(row / scale):
            known = np.concatenate([known, new[None] / np.linalg.norm(new)])
            lever = 1.0 if all(name[1] in "XYZ" for name in sums) else radius
            chosen = np.concatenate([chosen, row[None] * lever / len(balls.angles)])
    return chosen / (HELD * balls.sigma)


def ball_motions(balls: BallsOnTable, place: Floats) -> Iterator[Floats]:
    """Yield rows (p, u) of the :data:`MOTIONS` of a ball at ``place`` (3,), m, at each angle."""
    place = balls.turned(place[None])[:, 0]
    for direction in np.swapaxes(local_directions(place), 0, 1):
        parts = np.concatenate([direction, np.cross(place, direction)], axis=1)
        rows = np.zeros((len(place), sum(balls.blocks.values())))
        for number, name in enumerate(COMPONENTS):
            rows += parts[:, number, None] * mean_of_tilts(balls, name)
        yield rows


def _sense(balls: BallsOnTable, name: str) -> float:
    """Return the sign of a deviation beside the motion: ECC goes by the sense of the table."""
    return balls.sense if name == "ECC" else 1.0


def _deviation(balls: BallsOnTable, name: str) -> Floats:
    """Return rows (p, u) of a deviation, the mean of the tilts."""
    return mean_of_tilts(balls, name) * _sense(balls, name)


def mean_of_tilts(balls: BallsOnTable, name: str) -> Floats:
    """Return rows (p, u) of a motion of the table, the mean of all tilts."""
    rows = block_rows(balls.blocks, name)
    return np.asarray(rows.reshape(balls.tilts, -1, rows.shape[1]).mean(axis=0))


def _by_tilt(balls: BallsOnTable, tilting: Tilting) -> dict[str, Floats]:
    blocks, found = balls.blocks, dict[str, Floats]()
    line = balls.first[tilting.line[0]]
    for name, rows in tilting.table_axis(balls.origin).items():
        axis = np.repeat(block_rows(blocks, name), balls.tilts, axis=0)
        axis[:, line : line + rows.shape[1]] += rows
        found[f"{name} by tilt"] = axis
    for name in components_of(balls):
        found[f"{name} by tilt"] = _sense(balls, name) * block_rows(blocks, name)
    return found | {name: block_rows(blocks, name) for name in tilting.motions}


def untold_of(balls: BallsOnTable) -> dict[str, Floats]:
    """Return rows (p, u) of the deviations that are no results."""
    return {
        name: _deviation(balls, name) for name in COMPONENTS if name not in components_of(balls)
    }


def components_of(balls: BallsOnTable) -> tuple[str, ...]:
    """Return the deviations that are results: ECC, and what else the balls determine."""
    return tuple(name for name in COMPONENTS if name == "ECC" or name in balls.shown)


def model_of(
    plan: BallsPlanSettings, solver: BallsSolverSettings, read: Readings, *, whole: bool = False
) -> Model:
    """Return unknowns, centres or lengths, and what could spoil them.

    Outputs are the :func:`components_of` the balls at the table positions, and below them
    :data:`AXIS` at the height of the origin and the line of the tilting axis. ``also``: the
    motions of each ball where the balls do not determine all six of the table, the errors of the
    linear axes, and what happens at each tilt. Deviations are the means of the tilts. ``whole``:
    what is stated holds of all motions, not only of those that the balls leave open.
    """
    balls = BallsOnTable.of(plan, solver, read)
    start, count = balls.started(read.points), balls.coordinates
    places = start[4 : balls.first["EXC"]].reshape(-1, 3)
    motions = StatedRows.of(balls, places, whole=whole)
    balls = replace(balls, sums=motions.sums.shape[1])
    design = balls(np.append(start, np.zeros(balls.sums)))[1]
    each, known = motions.known(balls, design)
    zero = read.target if count == 1 else np.tile(np.arange(3), len(read.target))
    stop, station, target = (np.repeat(k, count) for k in (balls.stop, read.station, read.target))
    when, largest = np.repeat(read.when, count), solver.largest_shift_um * MICROMETRE
    shifts = Steps(zero, when, centred=True).thinned(
        MOST_MOMENTS
    )  # their mean is the axis's place
    model = Model(
        blocks=balls.blocks,
        observed=read.value if count == 1 else read.points.ravel(),
        std=np.full(len(zero), balls.sigma),
        equations=balls,
        outputs=_outputs(balls),
        words=WORDS[count],
        unit=UM,
        start=np.append(start, np.zeros(balls.sums)),
        further=_also(balls, places),
        # arrivals of the table scatter in tangential lengths, and not in others
        components=[phrase("lengths of set-up {0}", k) for k in range(len(balls.bars))]
        or ["the centres"],
        component=read.target % len(balls.bars) if len(balls.bars) else None,
        groupings=(
            Grouping("position", stop),  # of each the start trusts the better part
            Grouping("run" if balls.tilting is None else "tilt", station, along=when),
            Grouping("ball" if count == 3 else "bar", target),
        ),
        effects=(
            Disturbing("drift", "machine or table drift", drifts(zero, when), largest, UM),
            Disturbing("recurring drift", AGAIN, _returning(balls, read, zero), largest, UM),
            Disturbing("knock", "machine or table moved", shifts, largest, UM, family=True),
        ),
        row_names=partial(_row_name, balls, read),
    )
    for rows in (each, known):
        zeros = np.zeros(rows.shape[0])
        model = model.with_prior("what is stated", rows * balls.sigma, zeros, balls.sigma)
    if not each.shape[0]:
        return model
    together = StatedMotions.of(
        motions.whole, len(zero), _sums(balls), balls.stated, balls.angles,
        balls.tilts, possible_spectra(solver), balls.first["EXC"],
    )  # fmt: skip
    return replace(model, correlated=(together,))


def _returning(balls: BallsOnTable, read: Readings, zero: Ints) -> Floats:
    """Return drifts that come back (n, k), each counted from the mean of a ``zero`` (n,).

    Of the machine along x, y and z, and of all lengths of a bar. What is seen at one stop of the
    table drifts alike: balls that are touched one after the other would tell of the time between
    them, and of nothing else.
    """
    run = pass_numbers(read.station, read.position, read.order)
    _, stop = np.unique(np.stack([run, read.position]), axis=1, return_inverse=True)
    shapes = recurring(run, (np.bincount(stop, read.when) / np.bincount(stop))[stop])
    felt = np.broadcast_to(np.eye(3), (len(run), 3, 3))
    if len(balls.bars):
        alone = replace(balls, bars=balls.bars[:0])
        arm = balls.sent[balls.tilt, balls.position, balls.target]
        arm = alone.sent[balls.tilt, balls.position, balls.ball] - arm
        along = arm / np.linalg.norm(arm, axis=1)[:, None]
        felt = np.insert(along, 3, 1.0, axis=1)[:, None]
    columns = np.einsum("nca,ns->ncas", felt, shapes).reshape(len(zero), -1)
    for mine in (zero == number for number in np.unique(zero)):
        columns[mine] -= columns[mine].mean(axis=0)  # that is where the axis is
    return np.asarray(columns)


def _outputs(balls: BallsOnTable) -> Outputs:
    outputs = [_deviation(balls, name) for name in components_of(balls)]
    lines = AXIS if balls.tilting is None else (*AXIS, *balls.tilting.line)
    rows = np.concatenate([*outputs, *(block_rows(balls.blocks, name) for name in lines)])
    return Outputs.alone(csr_array(rows))


def _also(balls: BallsOnTable, places: Floats) -> dict[str, Outputs]:
    found = {} if set(balls.shown) == set(COMPONENTS) else _motions(balls, places)
    found |= {name: block_rows(balls.blocks, name) for name in balls.known if name in ALSO}
    if balls.tilting is not None:
        found |= _by_tilt(balls, balls.tilting)
    return {name: Outputs.alone(csr_array(rows)) for name, rows in found.items()}


def _row_name(balls: BallsOnTable, read: Readings, row: int) -> Phrase:
    reading, axis = (row, 0) if len(balls.bars) else divmod(row, 3)
    run = phrase("run") if balls.tilting is None else phrase("tilt")
    where = read.target[reading], read.position[reading], run, read.station[reading]
    if len(balls.bars):
        return phrase("bar {0} at position {1}, {2} {3}", *where)
    return phrase("{0} of ball {1} at position {2}, {3} {4}", "xyz"[axis], *where)


def _motions(balls: BallsOnTable, places: Floats) -> dict[str, Floats]:
    """Return the rows of each motion of balls at ``places`` (k, 3), ball after ball."""
    every = [tuple(ball_motions(balls, place)) for place in places]
    return {
        name: np.concatenate(rows)
        for name, rows in zip(MOTIONS, zip(*every, strict=True), strict=True)
    }
