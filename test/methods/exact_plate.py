"""Centres of a rigid plate on a rotary table by full rotation matrices; nothing linearised.

Physics written down once more: the table turns about its axis and deviates; the axis stands
tilted and shifted in the machine's frame, the plate shifted, tilted and turned on the table; the
machine errs by a field over its own positions, in the frame of the axis. EAC and EBC are where the
table's axis points, ECC the turn about it.
"""

from dataclasses import dataclass, field

import numpy as np

from rotcal_ros.methods.ball_plate.solver.problem import BallPlateProblem

RADIUS = 0.185


def rotation(vector):
    """Rotation by |vector| about vector, as the exponential series."""
    x, y, z = vector
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]], dtype=float)
    term, total = np.eye(3), np.eye(3)
    for order in range(1, 25):
        term = term @ k / order
        total = total + term
    return total


def about_z(angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def in_gauge(sequence, angle):
    """Take off the parts 1, cos, sin of x and y that a shifted plate or axis would cause."""
    c, s, one, nil = np.cos(angle), np.sin(angle), np.ones_like(angle), np.zeros_like(angle)
    plane = np.concatenate([sequence[:, 0], sequence[:, 1]])
    causes = np.array(
        [np.r_[one, nil], np.r_[nil, one], np.r_[c, s], np.r_[-s, c]]  # shift; shift on the plate
    ).T
    plane = plane - causes @ np.linalg.lstsq(causes, plane, rcond=None)[0]
    return np.column_stack([np.split(plane, 2)[0], np.split(plane, 2)[1],
                            sequence[:, 2] - sequence[:, 2].mean()])  # fmt: skip


def free_of_pose(field_, angle):
    """Take shift, rotation and scale off a field of the machine at the CMM positions."""
    place = np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    causes = [np.tile(e, (len(angle), 1)).ravel() for e in np.eye(3)]
    causes += [np.cross(e, place).ravel() for e in np.eye(3)] + [place.ravel()]
    causes = np.array(causes).T
    flat = field_.ravel() - causes @ np.linalg.lstsq(causes, field_.ravel(), rcond=None)[0]
    return flat.reshape(-1, 3)


@dataclass
class ExactPlate:
    """What stands on the machine; lengths in metres, angles in radians."""

    grid: int
    balls: list
    tilt: tuple = (0.0, 0.0)  # of the axis in the machine
    shift: tuple = (0.0, 0.0, 0.0)  # of the axis in the machine
    eccentric: tuple = (0.0, 0.0)  # plate on the table
    plate_turn: tuple = (0.0, 0.0, 0.0)
    table: float = 0.0  # size of the table's deviations
    machine: float = 0.0
    made: float = 0.0  # errors of manufacture
    seed: int = 0
    present: np.ndarray | None = None  # table positions that were measured
    translation: np.ndarray = field(init=False)
    rotation: np.ndarray = field(init=False)

    def __post_init__(self):
        rng = np.random.default_rng(self.seed)
        self.angle = 2 * np.pi * np.arange(self.grid) / self.grid
        if self.present is None:
            self.present = np.arange(self.grid)
        seen = self.angle[self.present]
        self.translation = np.zeros((self.grid, 3))
        self.rotation = np.zeros((self.grid, 3))
        size = (len(self.present), 3)
        self.translation[self.present] = in_gauge(self.table * rng.normal(size=size), seen)
        self.rotation[self.present] = in_gauge(self.table / RADIUS * rng.normal(size=size), seen)
        self.machine_error = free_of_pose(
            self.machine * rng.normal(size=(self.grid, 3)), self.angle
        )
        self.ball_error = {b: self.made * rng.normal(size=3) for b in self.balls}

    def true(self, name):
        """The deviation ``name`` at the table positions that were measured."""
        if name[0] == "E" and name[1] in "XYZ":
            return self.translation[self.present, "XYZ".index(name[1])]
        return self.rotation[self.present, "ABC".index(name[1])]

    def centres(self):
        """Table positions, balls and centres, ball by ball."""
        axis = rotation((*self.tilt, 0.0))
        mounted = rotation(self.plate_turn)
        rows, places = [], {}
        for b in self.balls:
            on_plate = RADIUS * np.array([np.cos(self.angle[b]), np.sin(self.angle[b]), 0.0])
            places[b] = mounted @ (on_plate + self.ball_error[b]) + (*self.eccentric, 0.0)
        height = np.mean([place[2] for place in places.values()])
        for b, on_table in places.items():
            on_table = on_table - np.array([0.0, 0.0, height])  # the origin's height
            for i in self.present:
                lean, turn = rotation(self.rotation[i] * [1, 1, 0]), self.rotation[i, 2]
                turned = lean @ about_z(self.angle[i] + turn) @ on_table
                turned = turned + self.translation[i]
                turned = turned + self.machine_error[(i + b) % self.grid]
                rows.append((i, b, *(axis @ turned + self.shift)))
        table = np.array(rows)
        return table[:, 0].astype(int), table[:, 1].astype(int), table[:, 2:]

    def problem(self, noise=0.0, **entries):
        table, ball, centres = self.centres()
        rng = np.random.default_rng([self.seed, 7])
        centres = centres + np.asarray(noise) * rng.normal(size=centres.shape)
        return BallPlateProblem(self.grid, RADIUS, table, ball, centres, **entries)
