"""Whole CMM positions without a centre: the others are determined, and solved.

The reference is a dense fit written here: unit parameters through the row by row model of
``plate_data``, a pseudo-inverse, and the gauge of the curves taken off.
"""

import numpy as np
import pytest
from plate_data import PAPER_PLATE, RADIUS, Truth, in_cmm_order, measure, simulated

from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.methods.ball_plate.solver import solve

SIGMA = 5e-8
EIGHT = [0, 3, 7, 12, 18, 22, 27, 31]


def without_gauge(grid):
    """Matrix (6 N, 6 N) that takes means and the first harmonics of x, y off translations and
    rotations, both (N, 3) in a row."""
    angle = 2 * np.pi * np.arange(grid) / grid
    columns = [np.tile(np.eye(3)[axis], grid) for axis in range(3)]
    cos, sin = np.cos(angle), np.sin(angle)
    columns.append(np.column_stack([cos, sin, 0 * cos]).ravel())
    columns.append(np.column_stack([-sin, cos, 0 * cos]).ravel())
    basis, _ = np.linalg.qr(np.array(columns).T)
    return np.kron(np.eye(2), np.eye(3 * grid) - basis @ basis.T)


def dense_curves(problem):
    """Six curves and their standard deviations for unit noise, (6, N) each, and all singular
    values of the design."""
    grid, balls = problem.grid, problem.balls
    zero = Truth(np.zeros((grid, 3)), np.zeros((grid, 3)), {int(b): np.zeros(3) for b in balls},
                 np.zeros((grid, 3)))  # fmt: skip

    def seen(**changes):
        truth = Truth(**{**zero.__dict__, **changes})
        return measure(grid, balls, truth, problem.position, problem.ball_step)

    nominal, columns = seen(), []
    for field in ("translation", "rotation", "cmm"):
        for i in range(grid):
            for axis in range(3):
                unit = np.zeros((grid, 3))
                unit[i, axis] = 1.0 if field != "rotation" else 1.0 / RADIUS
                columns.append((seen(**{field: unit}) - nominal).ravel())
    for ball in balls:
        for axis in range(3):
            plate = {**zero.plate, int(ball): np.eye(3)[axis]}
            columns.append((seen(plate=plate) - nominal).ravel())
    design = np.array(columns).T
    inverse = np.linalg.pinv(design, rcond=1e-9)[: 6 * grid]
    gain = without_gauge(grid) @ inverse
    gain[3 * grid :] /= RADIUS
    curves = gain @ (problem.centres - nominal).ravel()
    std = np.linalg.norm(gain, axis=1)
    order = [v.reshape(2, grid, 3).transpose(0, 2, 1).reshape(6, grid) for v in (curves, std)]
    return *order, np.linalg.svd(design, compute_uv=False)


def without_positions(problem, missing):
    return problem.take(~np.isin(problem.cmm_index, missing))


CASES = [(36, EIGHT, [5]), (36, EIGHT, [5, 22]), (72, PAPER_PLATE, [40])] + [
    (n, [0, 1, 3, 7, 9], [4]) for n in (13, 16, 19)
]


@pytest.mark.slow
@pytest.mark.parametrize(("grid", "balls", "missing"), CASES)
def test_result_is_that_of_dense_least_squares(grid, balls, missing):
    whole, _ = simulated(grid, balls, seed=100 + grid + len(missing), noise=SIGMA, sigma=SIGMA)
    problem = in_cmm_order(without_positions(whole, missing))
    result = solve(problem)
    assert (result.verdict, result.rejected) == ("ok", ())
    curves, std, _ = dense_curves(problem)
    for row, name in enumerate(COMPONENTS):
        # products of small angles, which the exact model takes along, are the difference
        away = np.abs(result.deviations[name] - curves[row]) / (SIGMA * std[row])
        assert away.max() < 0.03, name
        np.testing.assert_allclose(result.std[name], SIGMA * std[row], rtol=2e-6, err_msg=name)


def test_design_is_well_determined_and_only_the_gauge_is_open():
    """The figures that the refusal contradicted: nothing is near to being lost."""
    whole, _ = simulated(36, EIGHT, seed=1)
    _, _, values = dense_curves(without_positions(whole, [5, 22]))
    # 19 directions less the 6 of the axis's pose, which is no unknown here; 2 positions of 3
    open_ones = np.count_nonzero(values < 1e-9 * values[0])
    assert open_ones == 13 + 6
    assert values[-open_ones - 1] > 1e-2 * values[0]
