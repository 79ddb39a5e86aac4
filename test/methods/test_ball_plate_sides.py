"""A ball plate from both sides: mean and difference fall apart, and each has an answer of its own.

With all balls at all positions from both sides and equal noise, the mean of both is a measurement
from one side with half the variance, and the difference at a position is a rigid motion of its
balls, whatever plate and machine are.
"""

import numpy as np
import pytest

from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.foundation.errors import DataError, PlanError
from rotcal_ros.geometry.rotations import rotation_about_z, rotation_from_vector
from rotcal_ros.methods.ball_plate.solver import BallPlateProblem, closed_form, select, solve

N, BALLS, RADIUS, SIGMA = 12, np.array([0, 1, 3, 5, 8, 9]), 0.2, 5e-8


def centres(rng, position, ball, down):
    """Of a table with errors of its own from either side, 1 um and 5 urad."""
    rotation = 5e-6 * rng.standard_normal((2, N, 3))
    shift = 1e-6 * rng.standard_normal((2, N, 3))
    plate = 5e-6 * rng.standard_normal((N, 3))
    machine = 5e-7 * rng.standard_normal((N, 3))
    angle = 2 * np.pi * np.arange(N) / N
    place = RADIUS * np.column_stack([np.cos(angle), np.sin(angle), 0 * angle]) + plate
    turned = np.einsum("nij,nj->ni", rotation_about_z(angle[position]), place[ball])
    moved = np.einsum("nij,nj->ni", rotation_from_vector(rotation[down, position]), turned)
    noise = SIGMA * rng.standard_normal(moved.shape)
    return moved + shift[down, position] + machine[(position + ball) % N] + noise


@pytest.fixture(scope="module")
def both():
    step, ball, down = (a.ravel() for a in np.mgrid[:N, : len(BALLS), :2])
    ball = BALLS[ball]
    measured = centres(np.random.default_rng(2), step, ball, down)
    position = np.where(down, 2 * N - 1 - step, step)
    problem = BallPlateProblem(N, RADIUS, position, ball, measured, SIGMA, bidirectional=True)
    return problem, step[::2], ball[::2], measured[::2], measured[1::2]


def test_the_mean_is_that_of_the_mean_centres(both):
    problem, step, ball, up, down = both
    result = solve(problem)
    half = SIGMA / np.sqrt(2)
    once = solve(BallPlateProblem(N, RADIUS, step, ball, (up + down) / 2, half))
    for name in COMPONENTS:
        found = result.deviations[name]
        mean = (found[:N] + found[: N - 1 : -1]) / 2
        np.testing.assert_allclose(mean, once.deviations[name], atol=1e-3 * once.std[name].min())
        average = np.hstack([np.eye(N), np.eye(N)[:, ::-1]]) / 2
        covariance = average @ result.covariance[name] @ average.T
        np.testing.assert_allclose(
            np.sqrt(np.diag(covariance)), once.std[name], rtol=1e-3, err_msg=name
        )


def test_the_reversal_is_a_rigid_motion_at_each_angle(both):
    problem, step, ball, up, down = both
    result = solve(problem)
    for i in range(N):
        here = step == i
        angle = 2 * np.pi * (i + ball[here]) / N
        place = RADIUS * np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
        turns = np.stack([np.cross(axis, place) for axis in np.eye(3)], axis=2)
        shifts = np.broadcast_to(np.eye(3), turns.shape)
        design = np.concatenate([shifts, turns], axis=2).reshape(-1, 6)
        motion = np.linalg.lstsq(design, (up - down)[here].ravel(), rcond=None)[0]
        std = np.sqrt(2) * SIGMA * np.sqrt(np.diag(np.linalg.inv(design.T @ design)))
        for k, name in enumerate(COMPONENTS):
            pair = [i, 2 * N - 1 - i]
            found = result.deviations[name][pair]
            assert found[0] - found[1] == pytest.approx(motion[k], abs=2e-3 * std[k]), name
            spread = result.covariance[name][np.ix_(pair, pair)]
            variance = spread[0, 0] + spread[1, 1] - 2 * spread[0, 1]
            assert np.sqrt(variance) == pytest.approx(std[k], rel=1e-3), name


def test_a_coarser_grid_keeps_the_sides_apart(both):
    problem = both[0]
    part = select(problem, balls=[0, 8], coarser=2)
    assert part.grid == 6
    assert np.unique(part.position).tolist() == list(range(12))
    was = problem.centres[(problem.ball_step == 8) & (problem.position == 23 - 4)]
    np.testing.assert_array_equal(
        part.centres[(part.ball_step == 4) & (part.position == 11 - 2)], was
    )


def test_what_does_not_fit_is_refused(both):
    problem = both[0]
    with pytest.raises(DataError, match=r"table position 24 is outside 0\.\.23"):
        BallPlateProblem(N, RADIUS, [24], [0], [[0.2, 0, 0]], bidirectional=True)
    with pytest.raises(DataError, match=r"table position 12 is outside 0\.\.11"):
        BallPlateProblem(N, RADIUS, [12], [0], [[0.2, 0, 0]])
    with pytest.raises(PlanError, match="all 144 centres once"):
        closed_form(problem)
