"""A plate measured in an order of rows, with knocks and drift as displacements of its rows."""

import numpy as np
from plate_data import RADIUS, grid_rows, in_cmm_order, make_truth, measure, rotate_z

from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.foundation.units import ARCSEC, MICROMETRE
from rotcal_ros.methods.ball_plate.measuring_order import plan_measurement
from rotcal_ros.methods.ball_plate.solver.problem import BallPlateProblem

DEMO_PLATE = [0, 2, 5, 9, 11, 15, 17, 21, 24, 26, 29, 33]
NOISE = 5e-8
SHIFT = MICROMETRE * np.array([5.0, -3.0, 2.0])
TURN = ARCSEC * np.array([4.0, -2.0, 6.0])
ORDERS = {
    "interleaved": {},
    "table_once": {"order": "table_once"},
    "probe_rests": {"order": "probe_rests"},
}


def on_plate(grid, ball):
    angle = 2 * np.pi * ball / grid
    return RADIUS * np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])


def knocked(grid, table, ball, moment, shift=SHIFT, turn=TURN):
    """Displacements when plate and balls move on the table before row ``moment``."""
    moved = shift + np.cross(turn, on_plate(grid, ball))
    later = np.arange(len(table)) >= moment
    return np.where(later[:, None], rotate_z(moved, 2 * np.pi * table / grid), 0.0)


def drifted(n, amount):
    """Displacements when the origin of the CMM moves by ``amount`` (3,) over the run."""
    return np.linspace(0.0, 1.0, n)[:, None] * np.asarray(amount)


def measured(grid, balls, seed, order=None, noise=NOISE, displaced=None, **fields):
    """Return a problem in the rows of a plan; ``displaced`` takes (table, ball) to metres."""
    plan = plan_measurement(grid, balls, **(order or {}))
    table, ball = plan.position, plan.ball_step
    truth = make_truth(grid, balls, seed)
    centres = measure(grid, balls, truth, table, ball)
    if displaced is not None:
        centres = centres + displaced(table, ball)
    rng = np.random.default_rng([seed, 7])
    centres = centres + noise * rng.normal(size=centres.shape)
    row = np.arange(len(table))
    return BallPlateProblem(grid, RADIUS, table, ball, centres, row=row, **fields), truth


EIGHT = [0, 3, 7, 12, 18, 22, 27, 31]


def at_one_place(seed, which=(), size=0.0, at=11, column="position", stated=True):
    """A plate of which the balls ``which`` at one of 36 positions are off by ``size`` (m)."""
    truth = make_truth(36, EIGHT, seed)
    table, ball = grid_rows(36, EIGHT)
    rng = np.random.default_rng([seed, 5])
    centres = measure(36, EIGHT, truth, table, ball)
    centres = centres + NOISE * rng.normal(size=centres.shape)
    place = table if column == "position" else (table + ball) % 36
    direction = rng.normal(size=3)
    there = (place == at) & np.isin(ball, which)
    centres[there] += size * direction / np.linalg.norm(direction)
    sigma = NOISE if stated else None
    return in_cmm_order(BallPlateProblem(36, RADIUS, table, ball, centres, sigma=sigma)), truth


def errors(result, truth):
    """Largest error of each curve, in stated standard deviations (6,)."""
    return np.array(
        [
            np.max(np.abs(result.deviations[n] - truth.component(n)) / result.std[n])
            for n in COMPONENTS
        ]
    )


def caused(disturbed, clean):
    """Largest error that the disturbance alone causes, in stated standard deviations."""
    return max(
        np.max(np.abs(disturbed.deviations[n] - clean.deviations[n]) / clean.std[n])
        for n in COMPONENTS
    )


def by_pseudo_inverse(problem, degree=0):
    """Deviations and unit standard deviations (6, N) in metres, by a pseudo-inverse.

    With a drift of the CMM as powers of time up to ``degree``. The gauge is brought to zero mean
    and no first harmonic afterwards, by a projection of the solution.
    """
    grid, table, ball = problem.grid, problem.position, problem.ball_step
    n = len(table)
    place = on_plate(grid, (table + ball) % grid) / RADIUS
    time = np.linspace(-0.5, 0.5, problem.rows.max() + 1)[problem.rows]
    axes = np.eye(3)

    def where(mask, displacements):
        return [np.where(mask[:, None], d, 0.0) for d in displacements]

    turned = [rotate_z(np.tile(axis, (n, 1)), 2 * np.pi * table / grid) for axis in axes]
    columns = []
    for i in range(grid):
        columns += where(table == i, [*axes, *(np.cross(axis, place) for axis in axes)])
    for b in np.unique(ball):
        columns += where(ball == b, turned)
    for k in range(grid):
        columns += where((table + ball) % grid == k, axes)
    for power in range(1, degree + 1):
        columns += [(time**power)[:, None] * axis for axis in axes]
    design = np.array(columns).reshape(len(columns), -1).T
    inverse = np.linalg.pinv(design, rcond=1e-9)
    gauge = table_gauge(grid) @ inverse[: 6 * grid]
    values = (gauge @ problem.deviations.ravel()).reshape(grid, 6).T
    spread = np.sqrt(np.sum(gauge**2, axis=1)).reshape(grid, 6).T
    return values, spread


def table_gauge(grid):
    """Projector (6 N, 6 N) that takes off means, and what turns with the table in x and y."""
    angle = 2 * np.pi * np.arange(grid) / grid
    taken = []
    for start in (0, 3):
        for axis in range(3):
            mean = np.zeros((grid, 6))
            mean[:, start + axis] = 1.0
            taken.append(mean.ravel())
        for x, y in ((np.cos(angle), np.sin(angle)), (-np.sin(angle), np.cos(angle))):
            turning = np.zeros((grid, 6))
            turning[:, start], turning[:, start + 1] = x, y
            taken.append(turning.ravel())
    basis, _ = np.linalg.qr(np.array(taken).T)
    return np.eye(6 * grid) - basis @ basis.T
