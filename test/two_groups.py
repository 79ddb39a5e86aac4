"""Centres of a ball plate whose ball steps share the factor 2 with the grid, without the solver.

Every ball is carried by the table's own motion, exactly, and seen through the errors of the CMM at
the place where it stands: rotations and sums of vectors, nothing of the adjustment.
"""

import numpy as np

from rotcal_ros.methods.ball_plate.solver import BallPlateProblem

GRID, RADIUS = 12, 0.185
ARCSEC = np.pi / 180.0 / 3600.0
ALTERNATING = 2.0 * ARCSEC * (-1.0) ** np.arange(GRID)
"""ECC, rad: odd positions 4 arcsec behind the even ones."""
ANGLES = 2.0 * np.pi * np.arange(GRID) / GRID


def turned(angle, points):
    """Points (n, 3) turned about z by angle (n,)."""
    c, s = np.cos(angle), np.sin(angle)
    x, y, z = points.T
    return np.column_stack([c * x - s * y, s * x + c * y, z])


def plate_problem(
    balls=range(0, GRID, 2), ecc=ALTERNATING, shift=None, noise=1e-8, seed=0, sigma=1e-8, **more
):
    """A problem of a table with ECC (rad) and EXC, EYC, EZC ``shift`` (GRID, 3), m."""
    rng = np.random.default_rng(seed)
    plate, cmm = rng.normal(0.0, 1e-6, (GRID, 3)), rng.normal(0.0, 5e-7, (GRID, 3))
    position = np.repeat(np.arange(GRID), len(balls))
    ball = np.tile(np.array(balls), GRID)
    place = RADIUS * np.column_stack([np.cos(ANGLES), np.sin(ANGLES), 0.0 * ANGLES]) + plate
    centres = turned(ANGLES[position] + ecc[position], place[ball])
    if shift is not None:
        centres = centres + shift[position]
    centres = centres + cmm[(position + ball) % GRID] + rng.normal(0.0, noise, centres.shape)
    more.setdefault("separate_groups", all(b % 2 == 0 for b in balls))
    return BallPlateProblem(GRID, RADIUS, position, ball, centres, sigma=sigma, **more)
