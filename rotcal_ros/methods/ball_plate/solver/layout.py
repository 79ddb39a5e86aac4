"""The centres of a plate as a model of the engine (Eq. 12 to 19 of the paper), and its exact form.

    m = p_k + c_i x p_k + B_i a_j + d_i + b_k + u x p_k + v,      i = k - j (mod N)

B_i turns by the table angle 2 pi i / N about z, p_k is the nominal place of a ball at the CMM
position k. Each centre is written in the frame that turns with its CMM position (radial,
tangential, axial); d'_i = B_-i d_i, c'_i = B_-i c_i, b'_k = B_-k b_k and a'_j = B_-j B_j a_j turn
likewise with the table, the CMM position and the ball:

    B_-k (m - p_k) = B_-j d'_i + (B_-j c'_i) x p_0 + b'_k + a'_j

B_-j does not depend on k: every ball reads shifted copies of the same nine circles of places,
which the engine solves order by order. The pose u, v of the axis is what a rigid motion explains
of the b_k (Eq. 15). Rotations are multiplied by the radius of the ball circle.

Thirteen directions leave all centres where they are: a plate shifted (3) or turned (3) on a table
that makes up for it; a table with a constant shift (3) or rotation (3), taken back by the CMM; a
CMM circle and a plate that are larger and smaller (1). Eq. 16 to 19 define what is meant. Groups
of table positions that no ball connects have each a plate, a CMM and such directions of their own.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from scipy.sparse import csr_array, vstack

from rotcal_ros.adjust.bordered import Groups, SparseDesign
from rotcal_ros.adjust.circles import CircleTurns, CircularDesign
from rotcal_ros.adjust.kernels import ConstrainedKernel, Design
from rotcal_ros.adjust.outputs import Outputs
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.foundation.errors import ObservabilityError
from rotcal_ros.geometry.rotations import rotation_about_z, rotation_from_vector
from rotcal_ros.methods.ball_plate.solver.problem import (
    BallPlateProblem,
    grid_step,
    on_circle,
    position_of,
)

ACROSS = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""What a rotation w does to a ball on the x axis, w x (1, 0, 0) = ACROSS w."""
ROUNDING = 1e6 * np.finfo(np.float64).eps
"""Standard deviation below which a coordinate has no noise, as part of the radius."""
FREE = 13
"""Directions that leave all centres where they are, of each group of table positions."""


class PlateLayout:
    """Which place of the table, of the CMM and of the plate each of n centres belongs to.

    Places are numbered group by group. ``row`` (n,): the rows of the problem in the order of
    measurement. ``at``, ``cmm``, ``ball`` (n,): numbers among the places in use.
    """

    def __init__(self, problem: BallPlateProblem, groups: int = 1) -> None:
        self.problem, self.groups = problem, groups
        self.size = problem.grid // groups
        self.row = np.argsort(problem.rows, kind="stable")
        position, ball = problem.position[self.row], problem.ball_step[self.row]
        self.start = int(ball[0] % groups)
        step = grid_step(position, problem.grid)
        group, side = step % groups, (position >= problem.grid).astype(np.int64)
        self.sides = int(problem.bidirectional) + 1
        spot = (group * self.sides + side) * self.size + step // groups
        k = (step + ball) % problem.grid
        place = group * self.size + (k - group - self.start) % problem.grid // groups
        seat = group * problem.grid + ball
        self.spots, self.at = np.unique(spot, return_inverse=True)
        self.places, self.cmm = np.unique(place, return_inverse=True)
        self.seats, self.ball = np.unique(seat, return_inverse=True)
        self.radial: Floats = rotation_about_z(-problem.angles[k])
        """From the machine's frame to radial, tangential, axial (n, 3, 3)."""

    @cached_property
    def table_steps(self) -> Ints:
        """Grid steps (M,) of the places of the table."""
        group, within = np.divmod(self.spots // self.size, self.sides)[0], self.spots % self.size
        return np.asarray(within * self.groups + group)

    @cached_property
    def table_positions(self) -> Ints:
        """Table positions (M,)."""
        upward = self.spots // self.size % self.sides == 0
        return position_of(self.table_steps, upward, self.problem.grid)

    @cached_property
    def cmm_steps(self) -> Ints:
        """Grid steps (S,) of the CMM positions."""
        group, within = np.divmod(self.places, self.size)
        return np.asarray((within * self.groups + group + self.start) % self.problem.grid)

    @cached_property
    def ball_steps(self) -> Ints:
        """Ball steps (R,)."""
        return np.asarray(self.seats % self.problem.grid)

    @cached_property
    def group(self) -> tuple[Ints, Ints, Ints]:
        """The group of each place of the table (M,), of the CMM (S,) and of the plate (R,)."""
        table = self.spots // self.size // self.sides
        return table, self.places // self.size, self.seats // self.problem.grid

    @cached_property
    def counts(self) -> tuple[int, int, int]:
        """Numbers M, S, R of places of the table, of the CMM and of the plate."""
        return len(self.spots), len(self.places), len(self.seats)

    @property
    def unknowns(self) -> int:
        """The number of unknowns."""
        table, cmm, ball = self.counts
        return 6 * table + 3 * cmm + 3 * ball

    @cached_property
    def turned(self) -> tuple[Floats, Floats, Floats]:
        """Rotations (., 3, 3) from frames that turn with table, CMM position and ball."""
        angles = self.problem.angles
        steps = (self.table_steps, self.cmm_steps, self.ball_steps)
        return tuple(rotation_about_z(angles[each]) for each in steps)  # type: ignore[return-value]

    def packed(self, d: Floats, c: Floats, b: Floats, a: Floats) -> Floats:
        """Return unknowns (p, ...) from those of the parts (M, 3, ...), (S, 3, ...), (R, 3, ...).

        Those of the circles one after the other, axis by axis.
        """
        each = [np.moveaxis(part, 1, 0).reshape(-1, *part.shape[2:]) for part in (d, c, b)]
        return np.concatenate([*each, a.reshape(-1, *a.shape[2:])])

    @cached_property
    def rows(self) -> csr_array:
        """The design (3 n, p): radial, tangential and axial of each centre."""
        table, cmm, _ = self.counts
        n, theta = len(self.row), self.problem.angles[self.ball_steps][self.ball]
        cos, sin, unit = np.cos(theta), np.sin(theta), np.ones(len(self.row))
        d = [axis * table + self.at for axis in range(3)]
        c = [column + 3 * table for column in d]
        b = [6 * table + axis * cmm + self.cmm for axis in range(3)]
        a = [6 * table + 3 * cmm + 3 * self.ball + axis for axis in range(3)]
        entries = (  # B_-j = [[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]]
            (0, d[0], cos), (0, d[1], sin), (0, b[0], unit), (0, a[0], unit),
            (1, d[0], -sin), (1, d[1], cos), (1, c[2], unit), (1, b[1], unit), (1, a[1], unit),
            (2, d[2], unit), (2, c[0], sin), (2, c[1], -cos), (2, b[2], unit), (2, a[2], unit),
        )  # fmt: skip
        row = np.concatenate([3 * np.arange(n) + axis for axis, _, _ in entries])
        column = np.concatenate([each for _, each, _ in entries])
        value = np.concatenate([each for _, _, each in entries])
        found = csr_array((value, (row, column)), shape=(3 * n, self.unknowns))
        found.sort_indices()
        return found

    @cached_property
    def circular(self) -> CircularDesign | None:
        """The design as circles; None where places are missing."""
        table, cmm, ball = self.counts
        if table != self.problem.n_positions or cmm != self.problem.grid:
            return None
        circles = (6 * self.sides + 3) * self.groups
        theta, group = self.problem.angles[self.ball_steps], self.group[2]
        turns = 3 * ball * self.sides
        sign = np.zeros((ball, self.sides, 3, circles))
        shift = np.zeros((ball, self.sides, 3, circles), dtype=np.int64)
        tied = np.zeros((ball, self.sides, 3, 3 * ball))
        each = np.arange(ball)
        cos, sin, unit = np.cos(theta), np.sin(theta), np.ones(ball)
        for side in range(self.sides):

            def of_table(number: int, side: int = side) -> Ints:
                return (number * self.groups + group) * self.sides + side

            first = 6 * self.sides * self.groups
            for axis, number, value in (
                (0, 0, cos), (0, 1, sin), (1, 0, -sin), (1, 1, cos), (1, 5, unit),
                (2, 2, unit), (2, 3, sin), (2, 4, -cos),
            ):  # fmt: skip
                sign[each, side, axis, of_table(number)] = value
                shift[each, side, axis, of_table(number)] = -(self.ball_steps // self.groups)
            for axis in range(3):
                sign[each, side, axis, first + axis * self.groups + group] = 1.0
                tied[each, side, axis, 3 * each + axis] = 1.0
        side = self.spots[self.at] // self.size % self.sides
        turn = 3 * (self.ball * self.sides + side)[:, None] + np.arange(3)
        shift = np.where(sign == 0.0, 0, shift % self.size)
        found = CircleTurns(
            self.size, sign.reshape(turns, -1), shift.reshape(turns, -1),
            tied.reshape(turns, -1), turn.ravel(),
            np.repeat(self.places[self.cmm] % self.size, 3),
        )  # fmt: skip
        n = len(found.turn)
        return CircularDesign(
            self.rows, found, np.ones(n), np.zeros((n, 0)), self.by_place(self.rows)
        )

    def _by_group(self, mine: Ints, values: Floats) -> Floats:
        """Return ``values`` (m, 3, k) of places as columns of their groups, (m, 3, g, k)."""
        chosen = mine[:, None] == np.arange(self.groups)
        return np.asarray(chosen[:, None, :, None] * values[:, :, None])

    @cached_property
    def free(self) -> Floats:
        """The directions (p, 13 g) that leave all centres where they are."""
        table, cmm, ball = (np.swapaxes(each, 1, 2) for each in self.turned)
        same, none = np.broadcast_to(np.eye(3), table.shape), np.zeros((*table.shape[:2], 6))
        radial = np.zeros((1, 3, 1))
        radial[0, 0] = 1.0
        nothing = np.zeros((len(table), 3, 1))
        d = np.concatenate([same, none[:, :, :3], table, none[:, :, :3], nothing], axis=2)
        c = np.concatenate([none[:, :, :3], same, none[:, :, :3], table, nothing], axis=2)
        b = np.concatenate(
            [np.zeros((len(cmm), 3, 6)), -cmm, -ACROSS @ cmm,
             np.broadcast_to(radial, (len(cmm), 3, 1))], axis=2,
        )  # fmt: skip
        a = np.concatenate(
            [-ball, -ACROSS @ ball, np.zeros((len(ball), 3, 6)),
             np.broadcast_to(-radial, (len(ball), 3, 1))], axis=2,
        )  # fmt: skip
        groups = self.group
        parts = [self._by_group(groups[k], part) for k, part in ((0, d), (0, c), (1, b), (2, a))]
        return self.packed(*parts).reshape(self.unknowns, -1)

    @cached_property
    def definitions(self) -> Floats:
        """The conditions (13 g, p), zero for what is meant (Eq. 16 to 19)."""
        table = self.turned[0]
        same = np.broadcast_to(np.eye(3)[:, :2], (len(table), 3, 2))
        back = np.swapaxes(table, 1, 2)  # columns: the sum of B_i d'_i
        none, zero = np.zeros((len(table), 3, 3)), np.zeros((len(table), 3, 8))
        d = np.concatenate([back, none, same, zero[:, :, :5]], axis=2)
        c = np.concatenate([none, back, zero[:, :, :2], same, zero[:, :, :3]], axis=2)
        b, a = np.zeros((self.counts[1], 3, FREE)), np.zeros((self.counts[2], 3, FREE))
        b[:, 0, 10] = a[:, 1, 11] = a[:, 2, 12] = 1.0
        groups = self.group
        parts = [self._by_group(groups[k], part) for k, part in ((0, d), (0, c), (1, b), (2, a))]
        return np.asarray(self.packed(*parts).reshape(self.unknowns, -1).T)

    @cached_property
    def _pose(self) -> Floats:
        """What a rigid motion of the axis does to the b' (S, 3, 6): shifts v, then turns u."""
        back = np.swapaxes(self.turned[1], 1, 2)
        return np.concatenate([back, ACROSS @ back], axis=2)

    @cached_property
    def _posing(self) -> Floats:
        """From b' (S, 3) to the pose of each group, (g, 6, S, 3)."""
        found = np.zeros((self.groups, 6, len(self._pose), 3))
        for group in range(self.groups):
            mine = np.flatnonzero(self.group[1] == group)
            found[group][:, mine] = np.linalg.pinv(self._pose[mine].reshape(-1, 6)).reshape(
                6, -1, 3
            )
        return found

    def computed(self, x: Floats) -> Floats:
        """Return the centres (n, 3), radial, tangential and axial, of the exact model.

        m = v + R_u [ E(c_i) B_i E_z(u_z) (p_j + a_j) + d_i + b_k ] with E(c) the rotation about c
        by |c|, R_u the shortest one that takes z to the axis.
        """
        problem, x = self.problem, x[: self.unknowns]
        ball, cmm, axis, shift = (o.times(x).reshape(-1, 3) for o in self.others.values())
        moved, turn = ((rows @ x).reshape(-1, 3) for rows in self._of_table)
        of_table, of_cmm, of_ball = self.group
        yaw = rotation_about_z(axis[:, 2])[of_ball]
        places = problem.radius * on_circle(problem.angles[self.ball_steps]) + ball
        places = _turned(yaw, places)[self.ball]
        tilt = rotation_from_vector(axis * [1.0, 1.0, 0.0])
        table = rotation_from_vector(turn * [1.0, 1.0, 0.0])
        table = table @ rotation_about_z(problem.angles[self.table_steps] + turn[:, 2])
        table, moved = tilt[of_table] @ table, _turned(tilt[of_table], moved) + shift[of_table]
        there = _turned(table[self.at], places) + moved[self.at]
        there += _turned(tilt[of_cmm], cmm)[self.cmm]
        return _turned(self.radial, there)

    def neglected(self, x: Floats) -> float:
        """Return what centres without noise leave of any coordinate, m: no less is noise.

        Their last bits, and the products of the errors of plate and CMM over the radius: the model
        takes the CMM's error to be the same wherever around its position a ball stands.
        """
        ball, cmm = (self.others[name].times(x) for name in ("plate_errors", "cmm_errors"))
        back = np.swapaxes(self.turned[2], 1, 2)
        mounting = np.concatenate([back, ACROSS @ back], axis=2).reshape(-1, 6)
        plate = (back @ ball.reshape(-1, 3, 1)).ravel()
        plate = plate - mounting @ np.linalg.lstsq(mounting, plate, rcond=None)[0]
        radius = self.problem.radius
        products = 10.0 * float(np.sqrt(np.mean(plate**2) * np.mean(cmm**2))) / radius
        return float(max(ROUNDING * radius, products))

    @cached_property
    def _of_table(self) -> tuple[csr_array, csr_array]:
        """What takes unknowns to shifts, m, and turns, rad, at places of the table (3 M, p)."""
        table = self.counts[0]
        column = np.arange(table)[:, None] + table * np.arange(3)
        shift, turn = self.turned[0], self.turned[0] / self.problem.radius
        p = self.unknowns
        return _blocks(shift, column, p), _blocks(turn, 3 * table + column, p)

    def curves(self) -> csr_array:
        """Return what takes unknowns to the six deviations (6 M, p), m and rad.

        At all table positions in use, in their order, one component after the other.
        """
        row = 3 * np.argsort(self.table_positions) + np.arange(3)[:, None]
        return csr_array(vstack([rows[row.ravel()] for rows in self._of_table], format="csr"))

    @cached_property
    def others(self) -> dict[str, Outputs]:
        """What takes unknowns to the places of the balls (3 R, p) and to all of the CMM.

        That are its errors (3 S, p) and the pose of the axis in each group, turns and shifts of
        it (3 g, p), rad and m.
        """
        (table, cmm, ball), poses = self.counts, 6 * self.groups
        first = 6 * table + cmm * np.arange(3)[:, None]
        posing = np.zeros((poses, self.unknowns))
        every = self._posing.transpose(0, 1, 3, 2).reshape(poses, -1)
        posing[:, 6 * table : 6 * table + 3 * cmm] = every
        at = 6 * self.group[1][:, None, None] + np.arange(6)
        share = np.zeros((cmm, 3, poses))
        np.put_along_axis(share, np.repeat(at, 3, axis=1), -self.turned[1] @ self._pose, axis=2)
        own = _blocks(self.turned[1], (first + np.arange(cmm)).T, self.unknowns)
        seat = 6 * table + 3 * cmm + np.arange(3 * ball).reshape(-1, 3)
        nothing = csr_array((3 * self.groups, self.unknowns))
        pick = np.eye(poses).reshape(self.groups, 2, 3, poses).swapaxes(0, 1)
        pick = pick.reshape(2, -1, poses)
        return {
            "plate_errors": Outputs.alone(_blocks(self.turned[2], seat, self.unknowns)),
            "cmm_errors": Outputs(own, posing, share.reshape(-1, poses)),
            "axis_rotation": Outputs(nothing, posing, pick[1] / self.problem.radius),
            "axis_shift": Outputs(nothing, posing, pick[0]),
        }

    def unit_std(self) -> dict[str, Floats]:
        """Return the standard deviations (M,) of the six deviations for unit noise of a centre.

        Raises ObservabilityError where these centres leave one open.
        """
        std = np.sqrt(self._kernel.variances_of(Outputs.alone(self.curves())))
        return dict(zip(COMPONENTS, std.reshape(len(COMPONENTS), -1), strict=True))

    def linear(self, deviations: Floats) -> Floats:
        """Return the six deviations (6 M,) by linear least squares of what centres are off.

        ``deviations`` (n, 3), m, in the order of the problem; all weigh the same.
        """
        read = (self.radial @ deviations[self.row][:, :, None]).ravel()
        return np.asarray(self.curves() @ self._kernel.solve(read))

    def by_place(self, rows: csr_array) -> Groups | None:
        """Return how the unknowns of ``rows`` fall into places of the table; others are shared."""
        return Groups.of(rows, np.arange(6 * self.counts[0], self.unknowns))

    @cached_property
    def _kernel(self) -> ConstrainedKernel:
        none = np.zeros((0, self.unknowns))
        design: Design = SparseDesign(self.rows, none, groups=self.by_place(self.rows))
        kernel = (self.circular or design).kernel()
        if kernel is None or kernel.directions.shape[1] != FREE * self.groups:
            raise ObservabilityError("these balls and CMM positions do not separate the errors")
        return ConstrainedKernel.of(kernel, self.definitions)


def _turned(rotations: Floats, points: Floats) -> Floats:
    """Return ``points`` (m, 3) turned by a rotation (m, 3, 3) each."""
    return np.asarray(np.einsum("mij,mj->mi", rotations, points))


def _blocks(values: Floats, columns: Ints, unknowns: int) -> csr_array:
    """Return rows (3 m, p) of blocks ``values`` (m, 3, 3) at ``columns`` (m, 3) each."""
    m = len(values)
    row = np.repeat(np.arange(3 * m), 3)
    at = np.repeat(columns, 3, axis=0).ravel()
    found = csr_array((values.ravel(), (row, at)), shape=(3 * m, unknowns))
    found.eliminate_zeros()
    return found
