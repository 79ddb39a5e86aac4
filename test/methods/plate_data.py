"""Simulated ball plate measurements: exact physics of Eq. 12, written here once more."""

from dataclasses import dataclass, replace

import numpy as np

from rotcal_ros.foundation.settings import load
from rotcal_ros.methods.ball_plate.settings import Plate, checked
from rotcal_ros.methods.ball_plate.solver.problem import BallPlateProblem

PAPER_PLATE = [0, 8, 12, 18, 21, 28, 32, 37, 42, 50, 58, 62]
RADIUS = 0.185


def parse_plate(entries, where):
    """Return the plate with these entries, or raise ConfigurationError."""
    return checked(load(Plate, entries, where), where)


@dataclass(frozen=True)
class Truth:
    """What is injected; table errors obey Eq. 17 and 18 (zero mean, no first harmonic)."""

    translation: np.ndarray
    rotation: np.ndarray
    plate: dict
    cmm: np.ndarray

    def component(self, name):
        field = self.translation if name in ("EXC", "EYC", "EZC") else self.rotation
        return field[
            :, "XYZ".index(name[1]) if field is self.translation else "ABC".index(name[1])
        ]


def grid_rows(grid, balls):
    ball = np.repeat(np.asarray(balls), grid)
    return np.tile(np.arange(grid), len(balls)), ball


def make_truth(grid, balls, seed, size=2e-6):
    rng = np.random.default_rng(seed)
    angle = 2 * np.pi * np.arange(grid) / grid

    def reduced(sequence):
        sequence = sequence - sequence.mean(axis=0)
        plane = sequence[:, 0] + 1j * sequence[:, 1]
        plane = plane - np.mean(plane * np.exp(-1j * angle)) * np.exp(1j * angle)
        return np.column_stack([plane.real, plane.imag, sequence[:, 2]])

    return Truth(
        translation=reduced(size * rng.normal(size=(grid, 3))),
        rotation=reduced(size / RADIUS * rng.normal(size=(grid, 3))),
        plate={int(b): 20e-6 * rng.normal(size=3) for b in balls},
        cmm=size * rng.normal(size=(grid, 3)),
    )


def rotate_z(vectors, angles):
    cos, sin = np.cos(angles), np.sin(angles)
    return np.column_stack(
        [
            cos * vectors[:, 0] - sin * vectors[:, 1],
            sin * vectors[:, 0] + cos * vectors[:, 1],
            vectors[:, 2],
        ]
    )


def measure(grid, balls, truth, table, ball, axis=(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)):
    """Linear model of Eq. 12 with plain cross products, row by row in NumPy."""
    k = (table + ball) % grid
    angle = 2 * np.pi * k / grid
    place = RADIUS * np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    plate = np.array([truth.plate[int(b)] for b in ball])
    turned = rotate_z(plate, 2 * np.pi * table / grid)
    return (
        place
        + np.cross(truth.rotation[table], place)
        + turned
        + truth.translation[table]
        + truth.cmm[k]
        + np.cross(np.array(axis[:3]), place)
        + np.array(axis[3:])
    )


def simulated(grid=72, balls=PAPER_PLATE, seed=0, noise=5e-8, **fields):
    truth = make_truth(grid, balls, seed)
    table, ball = grid_rows(grid, balls)
    rng = np.random.default_rng([seed, 1])
    centres = measure(grid, balls, truth, table, ball, (3e-6, -2e-6, 4e-6, 5e-6, -6e-6, 7e-6))
    centres = centres + noise * rng.normal(size=centres.shape)
    return BallPlateProblem(grid, RADIUS, table, ball, centres, **fields), truth


def in_cmm_order(problem):
    """Number the rows CMM position by CMM position, as the paper measures."""
    order = np.lexsort((problem.position, problem.cmm_index))
    row = np.empty(len(order), dtype=int)
    row[order] = np.arange(len(order))
    return replace(problem, row=row)
