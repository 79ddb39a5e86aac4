"""Where the machine finds balls that the table carries, for the engine.

With the table at the angle theta the centre of a ball stands in the machine's coordinates at

    p = c + A (v + e x v + d),    v = Rz(theta + ECC) q,    e = (EAC, EBC, 0), d = (EXC, EYC, EZC),

and the machine shows p + S (p - c0). ``q`` is the place of the ball on the table; c = c0 + (XOC,
YOC, 0) the point of the axis average line at the height of c0, A = Ry(BOC) Rx(AOC) its direction.
c0 is a nominal point of the axis, at the height for which XOC, YOC, EXC and EYC are told. S, upper
triangular, holds the scales of x, y, z (how much more they read per length) and by how much x
reads more per y, x per z, y per z: the squareness of the linear axes. Names and signs of ISO 230-1
and 230-7; metres, radians. Products of tilts among each other (below 1e-8 of the radius) are left
out.

Where the table stands on an axis that tilts it, that is what p is with the tilt at 0, and c0 stays
where it is: :mod:`.tilting`. The motions of the table are then its own at every tilt.

What the equations leave open is a matter of definition, see :func:`definitions`. Of the motions
at one angle that no ball tells, the statement of the settings takes the place of observations.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from rotcal_ros.adjust.gathering import Words
from rotcal_ros.adjust.model import (
    Disturbing,
    Grouping,
    Model,
    Unit,
    block_rows,
    drifts,
    knocks,
)
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.foundation.units import ARCSEC, MICROMETRE
from rotcal_ros.geometry.rotations import cross_matrix, rotation_about_z, rotation_from_vector
from rotcal_ros.methods.table_balls.settings import (
    BallsPlanSettings,
    BallsSolverSettings,
    sense_of,
)
from rotcal_ros.methods.table_balls.tilting import Tilting
from rotcal_ros.planning.points import triples
from rotcal_ros.planning.readings import Readings
from rotcal_ros.planning.table_angles import table_angles

AXIS: Final = ("XOC", "YOC", "AOC", "BOC")
"""Position (m) and direction (rad) of the axis average line, named as in ISO 230-1."""
TILTING: Final = "tilting axis"
"""The block of the line of the axis below the table, see :attr:`.tilting.Tilting.line`."""
MOTIONS: Final = ("radial motion", "tangential motion", "axial motion")
"""Of a ball, in the directions that turn with it."""
ENTRIES: Final = ((0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2))
"""Rows and columns of S: the blocks ``scale`` and, behind it, ``squareness``."""
LEFT_OVER: Final = 0.05
"""A motion is told if no more than this share of its statement is left in it."""
UNSTATED_RAD: Final = 0.1
"""Nothing is stated of ECC: it may be anything up to this."""
HELD: Final = 1e-3
"""Standard deviation of a definition in those of a centre: it adds a millionth to a variance."""
WEAK: Final = 3e-4
"""Singular values below this share of the largest tell nothing that anybody could use."""
SHARED: Final = 0.01
"""Share of a definition that has to be new, beside those before it; of a variance, to be left."""
UM: Final = Unit("um", MICROMETRE)


@dataclass(frozen=True, eq=False)
class BallsOnTable:
    """Which ball is seen at which angle: ``angles`` (p,) rad; ``position``, ``ball`` (n,).

    The angles count counter-clockwise; ``sense`` times them are those that were commanded.

    ``tilting``: the axis below the table, if there is one, and ``tilt`` (n,), which of its t
    tilts; the motions (6, t p) of the table are those at all angles, tilt after tilt.
    ``origin`` (3,): c0 in the machine's coordinates. ``places`` (k, 3): nominal places of the
    balls from there, with the table at angle 0; ``stated`` (6,): standard deviations of the
    motions, m and rad; ``sigma``: that of a coordinate of a centre, m.
    """

    angles: Floats
    origin: Floats
    places: Floats
    position: Ints
    ball: Ints
    stated: Floats
    sigma: float
    sense: float
    tilting: Tilting | None
    tilt: Ints

    @classmethod
    def of(
        cls, plan: BallsPlanSettings, solver: BallsSolverSettings, read: Readings | None = None
    ) -> BallsOnTable:
        """Return those of what was read, or of one run in which every ball is seen.

        With a tilting axis the station of what was read is the tilt.

        Raises PlanError for coordinates that are no points and angles that do not ascend.
        """
        sense = sense_of(plan.chain, "C")
        angles = sense * np.array(table_angles(plan))
        balls = np.array(triples(plan.balls_m, "balls_m")).reshape(-1, 3)
        origin = np.array(plan.axis_m)
        tilting = Tilting.of(plan)
        tilts = 1 if tilting is None else len(tilting.tilts)
        tilt, position, ball = np.indices((tilts, len(angles), len(balls))).reshape(3, -1)
        if read is not None:
            position, ball = read.position, read.target
            tilt = np.zeros_like(position) if tilting is None else read.station
        shift, lean = solver.error_motion_std_m, solver.tilt_std_arcsec * ARCSEC
        stated = np.array([shift, shift, shift, lean, lean, UNSTATED_RAD])
        places = balls - origin
        sigma = solver.sigma_centre_m
        return cls(angles, origin, places, position, ball, stated, sigma, sense, tilting, tilt)

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
        table = {"axis": 4, "ball": self.places.size, **motions, "scale": 3, "squareness": 3}
        if self.tilting is None:
            return table
        return table | {TILTING: 4, **dict.fromkeys(self.tilting.motions, self.tilts)}

    @cached_property
    def first(self) -> dict[str, int]:
        """Number of the first unknown of each kind."""
        ends = np.cumsum([0, *self.blocks.values()]).tolist()
        return dict(zip(self.blocks, ends, strict=False))

    def turned(self, places: Floats) -> Floats:
        """Return where balls at ``places`` (k, 3) stand at each angle, (p, k, 3), from c0."""
        return np.asarray(places @ np.swapaxes(rotation_about_z(self.angles), -1, -2))

    def untold(self, places: Floats, seen: Floats | float) -> Floats:
        """Return rows (t p, 6, 6), per unit of a statement, of motions that no ball tells there.

        Balls at ``places`` (k, 3); ``seen`` (t p, k, 1, 1): 0 for those that are not. Rows of
        zeros are none. A motion counts as told if a centre tells more of it than its statement.
        """
        turned = np.tile(self.turned(places), (self.tilts, 1, 1))
        shifts = np.broadcast_to(np.eye(3), (*turned.shape, 3))
        moves = np.concatenate([shifts, -cross_matrix(turned)], axis=-1) * self.stated * seen
        rows = np.pad(moves.reshape(len(turned), -1, 6), ((0, 0), (0, 6), (0, 0)))
        _, size, ways = np.linalg.svd(rows, full_matrices=False)
        return np.asarray(ways * (size < self.sigma)[:, :, None])

    @cached_property
    def shown(self) -> tuple[str, ...]:
        """The motions that the balls tell at every angle where all are seen."""
        share = np.linalg.norm(self.untold(self.places, 1.0), axis=1).max(axis=0)
        return tuple(
            name for name, left in zip(COMPONENTS, share, strict=True) if left < LEFT_OVER
        )

    def started(self, points: Floats) -> Floats:
        """Return unknowns (u,) of a perfect table that fits ``points`` (n, 3) best."""
        if self.tilting is not None:
            points = self.tilting.back(points, self.tilt)
        turn = rotation_about_z(self.angles[self.position])
        design = np.zeros((*points.shape, 2 + self.places.size))
        design[:, [0, 1], [0, 1]] = 1.0
        for axis in range(3):
            column = 2 + 3 * self.ball + axis
            design[np.arange(len(points)), :, column] = turn[:, :, axis]
        away = (points - self.origin).ravel()
        found = np.linalg.lstsq(design.reshape(len(away), -1), away, rcond=None)[0]
        start = np.zeros(sum(self.blocks.values()))
        start[:2], start[4 : self.first["EXC"]] = found[:2], found[2:]
        return start

    def __call__(self, x: Floats) -> tuple[Floats, Floats]:
        """Return what the machine shows (3 n,) with unknowns ``x`` (u,), and its derivatives."""
        first = self.first
        show = np.eye(3)
        show[ENTRIES] += x[first["scale"] : first["scale"] + 6]
        if self.tilting is None:
            away, rows = self._on_table(x, show)
        else:
            away, rows = self._on_tilting(self.tilting, x, show)
        for number, (row, column) in enumerate(zip(*ENTRIES, strict=True), first["scale"]):
            rows[:, row, number] = away[:, column]
        return (self.origin + away @ show.T).ravel(), rows.reshape(-1, len(x))

    def _on_tilting(self, axis: Tilting, x: Floats, show: Floats) -> tuple[Floats, Floats]:
        """Return the same as :meth:`_on_table` where the table is tilted."""
        n, line = np.arange(len(self.tilt)), self.first[TILTING]
        away, rows = self._on_table(x, np.eye(3))
        from_point = self.origin - axis.point
        away, by_away, by_line, by_motions = axis.tilted(
            away + from_point, self.tilt, x[line : line + 4], x[line + 4 :].reshape(6, -1)
        )
        rows = show @ by_away @ rows
        rows[:, :, line : line + 4] = show @ by_line
        for number, name in enumerate(axis.motions):
            rows[n, :, self.first[name] + self.tilt] = (show @ by_motions)[:, :, number]
        return away - from_point, rows

    def _on_table(self, x: Floats, show: Floats) -> tuple[Floats, Floats]:
        """Return where the balls are (n, 3), from c0, as with a tilt of 0.

        And what unknowns of the table do to them in a machine with the S of ``show``.
        """
        first, position, n = self.first, self.position, np.arange(len(self.ball))
        stop = self.stop
        places = x[first["ball"] : first["EXC"]].reshape(-1, 3)[self.ball]
        motions = x[first["EXC"] : first["scale"]].reshape(6, -1).T[stop]
        turn = rotation_about_z(self.angles[position] + motions[:, 5])
        carried = np.einsum("nij,nj->ni", turn, places)
        tilt = np.eye(3) + cross_matrix(motions[:, 3:5] @ np.eye(2, 3))
        moved = np.einsum("nij,nj->ni", tilt, carried) + motions[:, :3]
        direction, *changes = _direction(*x[2:4])
        away = moved @ direction.T + np.append(x[:2], 0.0)
        fixed = show @ direction
        rows = np.zeros((len(n), 3, len(x)))
        rows[:, :, :2] = show[:, :2]
        for number, change in enumerate(changes, 2):
            rows[:, :, number] = moved @ (show @ change).T
        by_place, by_rotation = fixed @ tilt @ turn, fixed @ -cross_matrix(carried)
        by_rotation[:, :, 2] = np.einsum("nij,nj->ni", fixed @ tilt, np.cross([0, 0, 1], carried))
        for axis in range(3):
            rows[n, :, first["ball"] + 3 * self.ball + axis] = by_place[:, :, axis]
            rows[n, :, first[COMPONENTS[axis]] + stop] = fixed[:, axis]
            rows[n, :, first[COMPONENTS[3 + axis]] + stop] = by_rotation[:, :, axis]
        return away, rows


def _direction(about_x: float, about_y: float) -> tuple[Floats, Floats, Floats]:
    """Return A = Ry(BOC) Rx(AOC), and its derivatives by both angles, each (3, 3)."""
    x, y = rotation_from_vector([[about_x, 0.0, 0.0], [0.0, about_y, 0.0]])
    by_x, by_y = cross_matrix(np.eye(3)[:2])
    return y @ x, y @ by_x @ x, by_y @ y @ x


def definitions(angles: Floats, tilts: int = 1) -> Iterator[dict[str, Floats]]:
    """Yield what is zero by definition: sums over the ``angles`` (p,) of motions, by their names.

    No motion has a mean: that is the place and direction of the average line, of the balls along
    it and around it. EXC, EYC and EAC, EBC have no part that turns with the table: that is the
    place of the balls. Where balls tell less, fewer of these are needed. Of several ``tilts``
    each has its own means: that is the motion of what tilts.
    """
    c, s = np.tile(np.cos(angles), tilts), np.tile(np.sin(angles), tilts)
    for mean in np.repeat(np.eye(tilts), len(angles), axis=1):
        yield from ({name: mean} for name in COMPONENTS)
    for x, y in (("EXC", "EYC"), ("EAC", "EBC")):
        yield from ({x: c, y: s}, {x: -s, y: c})


def stated(balls: BallsOnTable, places: Floats, solver: BallsSolverSettings) -> Floats:
    """Return rows (k, u) of what is stated beforehand to be zero, per its standard deviation.

    Motions are stated as they are, and told by definition without their means and turning parts
    (:func:`definitions`): what is left of the untold ones scatters less, and not each by itself.
    """
    rows = _untold_rows(balls, places)
    sums = np.array([spread(balls, each) for each in definitions(balls.angles, balls.tilts)])
    taken = rows @ np.linalg.qr(sums.T)[0]
    left, ways = np.linalg.eigh(np.eye(len(rows)) - taken @ taken.T)
    kept = left > SHARED
    rows = (
        (ways[:, kept] / np.sqrt(left[kept])).T
        @ rows
        / np.repeat(balls.stated, balls.tilts * len(balls.angles))
    )
    first, end = balls.first["EXC"], balls.first["scale"]
    scale, square = solver.scale_std_um_per_m, solver.squareness_std_um_per_m
    return np.concatenate([
        np.pad(rows, ((0, 0), (first, sum(balls.blocks.values()) - end))),
        block_rows(balls.blocks, "scale") / (scale * MICROMETRE),
        block_rows(balls.blocks, "squareness") / (square * MICROMETRE),
    ])  # fmt: skip


def _untold_rows(balls: BallsOnTable, places: Floats) -> Floats:
    """Return orthonormal rows (k, 6 p), per unit of a statement, of what no ball tells."""
    count = balls.tilts * len(balls.angles)
    position, seen = np.arange(count), np.zeros((count, len(places), 1, 1))
    seen[balls.stop, balls.ball] = 1.0
    untold = balls.untold(places, seen)
    rows = np.zeros((*untold.shape, len(position)))
    rows[position, :, :, position] = untold
    flat = rows.reshape(-1, 6 * len(position))
    return np.asarray(flat[flat.any(axis=1)])


def spread(balls: BallsOnTable, sums: dict[str, Floats]) -> Floats:
    """Return factors (6 t p,) of all motions, those of ``sums`` and zeros."""
    zeros = np.zeros(balls.tilts * len(balls.angles))
    return np.concatenate([sums.get(name, zeros) for name in COMPONENTS])


def defined(balls: BallsOnTable, telling: Floats) -> Floats:
    """Return rows (d, u) of the definitions that are needed beside the ``telling`` rows (n, u).

    Per standard deviation of each; without them the unknowns that they join would be open.
    """
    scale = np.linalg.norm(telling, axis=0)
    scale = np.where(scale > 0.0, scale, 1.0)
    _, size, ways = np.linalg.svd(telling / scale, full_matrices=len(telling) < len(scale))
    size = np.pad(size, (0, len(ways) - len(size)))
    open_, chosen = ways[size <= WEAK * size[0]], np.zeros((0, len(scale)))
    known, radius = np.zeros((0, len(open_))), float(np.abs(balls.places).max())
    of_tilting = () if balls.tilting is None else balls.tilting.definitions()
    for sums in (*definitions(balls.angles, balls.tilts), *of_tilting):
        row = np.zeros(len(scale))
        for name, factors in sums.items():
            row[balls.first[name] : balls.first[name] + len(factors)] = factors
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
    up = np.array([0.0, 0.0, 1.0])
    out = place * (1.0 - up) / np.hypot(*place.T[:2])[:, None]
    for direction in (out, np.cross(up, out), np.broadcast_to(up, out.shape)):
        parts = np.concatenate([direction, np.cross(place, direction)], axis=1)
        rows = np.zeros((len(place), sum(balls.blocks.values())))
        for number, name in enumerate(COMPONENTS):
            rows += parts[:, number, None] * mean_of_tilts(balls, name)
        yield rows


def _deviation(balls: BallsOnTable, name: str) -> Floats:
    """Return rows (p, u) of a deviation: the mean of the tilts; ECC by the sense of the table."""
    return mean_of_tilts(balls, name) * (balls.sense if name == "ECC" else 1.0)


def mean_of_tilts(balls: BallsOnTable, name: str) -> Floats:
    """Return rows (p, u) of a motion of the table, the mean of all tilts."""
    rows = block_rows(balls.blocks, name)
    if balls.tilts == 1:
        return rows
    return np.asarray(rows.reshape(balls.tilts, -1, rows.shape[1]).mean(axis=0))


def _by_tilt(balls: BallsOnTable, tilting: Tilting) -> dict[str, Floats]:
    """Return rows of the table's axis and its motions at each tilt, and of the tilting axis."""
    blocks, found = balls.blocks, dict[str, Floats]()
    for number, (name, rows) in enumerate(tilting.table_axis(balls.origin).items()):
        axis = np.repeat(block_rows(blocks, "axis")[number][None], balls.tilts, axis=0)
        axis[:, balls.first[TILTING] :] += rows
        found[f"{name} by tilt"] = axis
    for name in components_of(balls):
        sense = balls.sense if name == "ECC" else 1.0
        found[f"{name} by tilt"] = sense * block_rows(blocks, name)
    return found | {name: block_rows(blocks, name) for name in tilting.motions}


def components_of(balls: BallsOnTable) -> tuple[str, ...]:
    """Return the deviations that are results: ECC, and what else the balls tell."""
    return tuple(name for name in COMPONENTS if name == "ECC" or name in balls.shown)


def model_of(plan: BallsPlanSettings, solver: BallsSolverSettings, read: Readings) -> Model:
    """Return unknowns, centres and what could spoil them.

    Outputs are the :func:`components_of` the balls at the table positions, and below them
    :data:`AXIS` at the height of the origin and the line of the tilting axis. ``also``: the
    motions of each ball where the balls do not tell all six of the table, the errors of the linear
    axes, and what happens at each tilt. Deviations are the means of the tilts.
    """
    balls = BallsOnTable.of(plan, solver, read)
    start = balls.started(read.points)
    design, places = balls(start)[1], start[4 : balls.first["EXC"]].reshape(-1, 3)
    known = stated(balls, places, solver)
    known = np.concatenate([known, defined(balls, np.concatenate([design / balls.sigma, known]))])
    blocks, axis = balls.blocks, np.tile(np.arange(3), len(read.points))
    outputs = [_deviation(balls, name) for name in components_of(balls)]
    outputs.append(block_rows(blocks, "axis"))
    also = {} if set(balls.shown) == set(COMPONENTS) else _motions(balls, places)
    for name in ("scale", "squareness"):
        also[name] = block_rows(blocks, name)
    if balls.tilting is not None:
        outputs.append(block_rows(blocks, TILTING))
        also |= _by_tilt(balls, balls.tilting)
    numbers = (balls.stop, read.position, read.target, read.station)
    stop, position, target, station = (np.repeat(number, 3) for number in numbers)
    run = "run" if balls.tilting is None else "tilt"
    when = np.repeat(read.when, 3)
    names = [
        f"{'xyz'[a]} of ball {ball} at position {at}, run {number}"
        if balls.tilting is None
        else f"{'xyz'[a]} of ball {ball} at position {at}, tilt {number}"
        for a, ball, at, number in zip(axis, target, position, station, strict=True)
    ]
    largest = solver.largest_shift_um * MICROMETRE
    model = Model(
        blocks=blocks,
        observed=read.points.ravel(),
        std=np.full(read.points.size, balls.sigma),
        equations=balls,
        outputs=np.concatenate(outputs),
        words=Words("coordinates", "dirt, heat or a loose ball", "at the balls", "at the ball"),
        unit=UM,
        start=start,
        also=also,
        components=("the centres",),
        groupings=(
            Grouping("position", stop),  # of each the start trusts the better part
            Grouping(run, station, along=when),
            Grouping("ball", target),
        ),
        effects=(
            Disturbing("drift", "machine or table drift", drifts(axis, when), largest, UM),
            Disturbing(
                "knock",
                "machine or table moved",
                _from_mean(knocks(axis, when), axis),
                largest,
                UM,
                family=True,
            ),
        ),
        row_names=names,
    )
    return model.knowing("what is stated", known * balls.sigma, np.zeros(len(known)), balls.sigma)


def _from_mean(columns: Floats, axis: Ints) -> Floats:
    """Return shifts (n, k) along each ``axis`` (n,) from their mean: that is where the axis is."""
    mean = [columns[axis == number].mean(axis=0) for number in range(3)]
    return np.asarray(columns - np.array(mean)[axis], dtype=np.float64)


def _motions(balls: BallsOnTable, places: Floats) -> dict[str, Floats]:
    """Return the rows of each motion of balls at ``places`` (k, 3), ball after ball."""
    every = [tuple(ball_motions(balls, place)) for place in places]
    return {
        name: np.concatenate(rows)
        for name, rows in zip(MOTIONS, zip(*every, strict=True), strict=True)
    }
