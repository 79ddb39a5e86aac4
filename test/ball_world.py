"""A machine tool with balls on its table, by homogeneous transforms, without the method."""

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from rotcal_ros.methods.table_balls.settings import BallsPlanSettings, BallsSolverSettings
from rotcal_ros.planning.readings import Readings

NAMES = ("EXC", "EYC", "EZC", "EAC", "EBC", "ECC")
ONE = (0.14, 0.03, 0.06)
LEVEL = (*ONE, -0.1, 0.05, 0.06)
COLUMN = (*ONE, 0.14, 0.03, 0.21)
THREE = (*ONE, -0.1, 0.08, 0.02, -0.02, -0.13, 0.11)
AS_DRAWN = BallsSolverSettings(error_motion_orders="white")
"""The statement of which :meth:`World.drawn` draws: each motion at each angle for itself."""


def shifted(vector):
    """Return the transform (4, 4) that shifts."""
    found = np.eye(4)
    found[:3, 3] = vector
    return found


def turned(*angles):
    """Return the transform (4, 4) that turns about the fixed x, then y, then z, rad."""
    found = np.eye(4)
    found[:3, :3] = Rotation.from_euler("xyz", angles).as_matrix()
    return found


def without(motions, angles, pairs):
    """Return motions (6, n) without what pairs of them have that turns with the angles (n,)."""
    found = motions.copy()
    for x, y in pairs:
        plane = (motions[x] + 1j * motions[y]) * np.exp(-1j * angles)
        plane = (plane - plane.mean()) * np.exp(1j * angles)
        found[x], found[y] = plane.real, plane.imag
    return found


def in_orders(orders, angles, rng):
    """Return a motion (n,) of size 1 that has these orders alike; white without any."""
    if not orders:
        return rng.standard_normal(len(angles))
    phase, size = np.outer(angles, orders), 1.0 / np.sqrt(len(orders))
    a, b = size * rng.standard_normal((2, len(orders)))
    return np.cos(phase) @ a + np.sin(phase) @ b


@dataclass
class World:
    """Truth: ``axis`` (4,) place and lean, ``motions`` (6, p), ``linear`` (3, 3), balls as found.

    The machine reads p + linear (p - foot), the axis and its motions refer to the foot; ``bars``
    (k b,) is how much too long a ball bar is in each set-up. The probe triggers later by
    the real part of ``lobing`` times the cosine of three times the direction, by the imaginary one
    times the sine: of four touches that shifts x and y; ``play`` is the whole way that an
    axis loses where it turns round. On a
    tilting axis (``plan.chain``) ``motions`` are (6, t p), tilt after tilt; ``line`` (4,) is the
    place and direction of that axis, ``tilting`` (6, t) its motions.
    """

    plan: BallsPlanSettings
    solver: BallsSolverSettings = field(default_factory=BallsSolverSettings)
    axis: tuple = (4e-5, -3e-5, 2e-5, -5e-5)
    motions: np.ndarray = None
    linear: np.ndarray = None
    missed: np.ndarray = None
    line: tuple = (6e-5, -4e-5, 3e-5, -2e-5)
    tilting: np.ndarray = None
    bars: np.ndarray = None
    lobing: complex = 0.0
    play: float = 0.0

    def __post_init__(self):
        self.angles = np.radians(
            self.plan.table_angles_deg
            or self.plan.table_start_deg
            + self.plan.table_step_deg * np.arange(self.plan.table_positions)
        )
        if self.plan.chain.endswith("-C"):
            self.angles = -self.angles
        self.balls = np.reshape(self.plan.balls_m, (-1, 3)) - self.plan.axis_m
        tilts = max(1, len(self.plan.tilts_deg))
        if self.motions is None:
            self.motions = np.zeros((6, tilts * len(self.angles)))
        if self.tilting is None:
            self.tilting = np.zeros((6, tilts))
        if self.linear is None:
            self.linear = np.zeros((3, 3))
        if self.bars is None:
            self.bars = np.zeros(len(self.balls) * len(self.plan.bars_m) // 3)
        if self.missed is None:
            self.missed = np.zeros(self.balls.shape)

    @classmethod
    def drawn(cls, plan, rng, solver=None, placing=3e-4):
        """Return a world whose truth is drawn from what is stated of it."""
        solver = solver or BallsSolverSettings()
        world = cls(plan, solver)
        shift, tilt = solver.error_motion_std_m, np.radians(solver.tilt_std_arcsec / 3600)
        moves = np.array([shift, shift, shift, tilt, tilt, 3e-5])
        world.motions = moves[:, None] * rng.standard_normal(world.motions.shape)
        scale, square = solver.scale_std_um_per_m, solver.squareness_std_um_per_m
        size = np.triu(np.full((3, 3), square)) + (scale - square) * np.eye(3)
        world.linear = 1e-6 * size * rng.standard_normal((3, 3))
        world.axis = tuple(1e-4 * rng.standard_normal(4))
        world.missed = placing * rng.standard_normal(world.balls.shape)
        if plan.measure == "bar":
            world.bars = solver.bar_std_m * rng.standard_normal(len(world.bars))
        if plan.chain.strip("-") != "C":
            world.line = tuple(1e-4 * rng.standard_normal(4))
            world.tilting = moves[:, None] * rng.standard_normal(world.tilting.shape)
            world.obey_the_definitions()
        return world

    def move(self, rng, radial=(), axial=(), tilt=(), larger=1.0):
        """Draw motions in orders anew, of the stated sizes or ``larger`` than these."""
        orders = (radial, radial, axial, tilt, tilt)
        shift, lean = (
            self.solver.error_motion_std_m,
            np.radians(self.solver.tilt_std_arcsec / 3600),
        )
        for k, size in enumerate((shift, shift, shift, lean, lean)):
            self.motions[k] = larger * size * in_orders(orders[k], self.angles, rng)

    def obey_the_definitions(self):
        """Take from the motions what belongs to lines, to balls, and to the motions below.

        At each tilt the table's have no mean, over all tilts no part that turns with the table;
        those of the tilting axis have neither.
        """
        count, sense = len(self.angles), -1 if self.plan.chain[0] == "-" else 1
        turns, tilts = np.tile(self.angles, len(self.plan.tilts_deg)), self.plan.tilts_deg
        along, alpha = "AB".index(self.plan.chain.strip("-")[0]), sense * np.radians(tilts)
        across = (along + 1) % 3, (along + 2) % 3
        pairs = [across, tuple(3 + k for k in across)]
        for _ in range(200):  # both at once: each spoils the other a little
            each = self.motions.reshape(6, -1, count)
            self.motions = (each - each.mean(axis=2, keepdims=True)).reshape(6, -1)
            self.motions = without(self.motions, turns, [(0, 1), (3, 4)])
            self.tilting = self.tilting - self.tilting.mean(axis=1, keepdims=True)
            self.tilting = without(self.tilting, alpha, pairs)

    def tilted(self, tilt):
        """Return what the tilting axis does (4, 4) to all that stands on it, from the foot."""
        if self.plan.chain.strip("-") == "C":
            return np.eye(4)
        along = "AB".index(self.plan.chain.strip("-")[0])
        across = [k for k in range(3) if k != along]
        place, lean, turn = np.zeros((3, 3))
        place[across], lean[across] = self.line[:2], self.line[2:]
        sense = -1 if self.plan.chain[0] == "-" else 1
        turn[along] = sense * np.radians(self.plan.tilts_deg[tilt])
        shift, tip = self.tilting[:3, tilt], self.tilting[3:, tilt]
        to = shifted(np.subtract(self.plan.tilting_axis_m, self.plan.axis_m) + place)
        there = to @ turned(*lean)
        return (
            to
            @ shifted(shift)
            @ turned(*tip)
            @ turned(*lean)
            @ turned(*turn)
            @ np.linalg.inv(there)
        )

    def carried(self, place, position, tilt=0):
        """Return where the table takes a ``place`` (3,), m, both from the foot."""
        x, y, a, b = self.axis
        exc, eyc, ezc, eac, ebc, ecc = self.motions[:, tilt * len(self.angles) + position]
        chain = (
            self.tilted(tilt) @ shifted((x, y, 0.0)) @ turned(a, b, 0.0) @ shifted((exc, eyc, ezc))
            @ turned(eac, ebc, 0.0) @ turned(0.0, 0.0, self.angles[position] + ecc)
        )  # fmt: skip
        return (chain @ np.append(place, 1.0))[:3]

    def centre(self, position, ball, tilt=0):
        """Return where the machine finds a ball (3,), m."""
        place = self.carried(self.balls[ball] + self.missed[ball], position, tilt)
        return np.array(self.plan.axis_m) + (np.eye(3) + self.linear) @ place

    def length(self, position, target, tilt=0):
        """Return the length (1,), m, from a ball to the spindle, sent where it would be best."""
        bars = np.reshape(self.plan.bars_m, (-1, 3))
        ball, bar = divmod(target, len(bars))
        x, y, _ = self.balls[ball]
        aim = self.balls[ball] + turned(0.0, 0.0, np.arctan2(y, x))[:3, :3] @ bars[bar]
        shown = World(self.plan, axis=(0,) * 4, line=(0,) * 4).carried(aim, position, tilt)
        spindle = np.linalg.solve(np.eye(3) + self.linear, shown)
        place = self.carried(self.balls[ball] + self.missed[ball], position, tilt)
        return [np.linalg.norm(spindle - place) + self.bars[target]]

    def readings(self, noise=0.0, rng=None, keep=slice(None)):
        """Return all readings of the plan, run by run, the first position again at the end."""
        count, bar = len(self.angles), self.plan.measure == "bar"
        targets, tilts = len(self.bars) if bar else len(self.balls), len(self.plan.tilts_deg)
        rows = [
            (position, target, run)
            for run in range(tilts or self.plan.runs)
            for position in range(count)
            for target in range(targets)
        ]
        if self.plan.closing:
            last = range(tilts) if tilts else [self.plan.runs - 1]
            rows += [(0, target, run) for run in last for target in range(targets)]
        see = self.length if bar else self.centre
        points = np.array([see(p, target, run if tilts else 0) for p, target, run in rows])
        points = points if bar else self.probed(points)
        if rng is not None:
            points = points + noise * rng.standard_normal(points.shape)
        columns = (*np.array(rows).T, points[:, 0], np.arange(len(rows)), points)
        return Readings(*(np.ascontiguousarray(column[keep]) for column in columns))

    def probed(self, points):
        """Return centres (n, 3) as touched one after the other, with lobes and play."""
        ways = [np.ones(3)]
        for moved in np.diff(points, axis=0):
            ways.append(np.where(np.abs(moved) > 1e-5, np.sign(moved), ways[-1]))
        return points + self.touched() - 0.5 * self.play * np.array(ways)

    def touched(self):
        """Return the centre (3,) of the sphere through touches of a ball from above and aside."""
        sides = np.radians([0.0, 90.0, 180.0, 270.0])
        flat = np.column_stack([np.cos(sides), np.sin(sides), np.ones(4)]) / np.sqrt(2.0)
        away = np.vstack([[0.0, 0.0, 1.0], flat])
        lobes = (self.lobing * np.exp(-3j * sides)).real
        reach = 0.014 + np.append(0.0, lobes)
        seen = reach[:, None] * away
        design = np.column_stack([2.0 * seen, np.ones(5)])
        return np.linalg.lstsq(design, reach**2, rcond=None)[0][:3]

    def truth(self):
        """Return motions (6, p) about the axis average line, and that line (4,), by definition.

        What is constant in a pair of motions belongs to the line, what turns with the table to
        the balls: least squares over the angles.
        """
        own, line = self.motions.copy(), np.array(self.axis)
        basis = np.column_stack([np.ones(len(self.angles)), np.exp(1j * self.angles)])
        for first, place in ((0, 0), (3, 2)):
            plane = own[first] + 1j * own[first + 1]
            part = np.linalg.lstsq(basis, plane, rcond=None)[0]
            plane = plane - basis @ part
            own[first], own[first + 1] = plane.real, plane.imag
            line[place : place + 2] += part[0].real, part[0].imag
        for alone in (2, 5):
            own[alone] -= own[alone].mean()
        return own, line
