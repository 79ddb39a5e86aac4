"""A drift that comes back with each run: seen where runs differ in order, else named."""

import numpy as np
import pytest
from ball_world import ONE, THREE, World

from rotcal_ros.adjust.engine import adjust
from rotcal_ros.adjust.model import recurring
from rotcal_ros.methods.table_balls.model import model_of
from rotcal_ros.methods.table_balls.settings import BallsPlanSettings, BallsSolverSettings
from rotcal_ros.planning.readings import Readings, pass_numbers

SIGMA = 0.5e-6
SAME = np.tile(np.arange(12), 2)
THERE_AND_BACK = np.append(np.arange(12), np.arange(12)[::-1])
ANOTHER_START = np.append(np.arange(12), np.roll(np.arange(12), 5))


def drifted(balls, positions, swing, seed=3):
    """Return what two runs in an order of ``positions`` find, z off once a run by ``swing``."""
    plan = BallsPlanSettings(balls_m=balls, axis_m=(0.0, 0.0, 0.06), measure="centre")
    rng = np.random.default_rng(seed)
    world = World.drawn(plan, rng, BallsSolverSettings(error_motion_std_m=1e-6))
    count = len(balls) // 3
    rows = [
        (position, ball, k // 12) for k, position in enumerate(positions) for ball in range(count)
    ]
    points = np.array([world.centre(position, ball) for position, ball, _ in rows])
    points += SIGMA * rng.standard_normal(points.shape)
    moment = np.arange(len(rows)) % (12 * count) / (12 * count)
    points[:, 2] += swing * np.sin(2.0 * np.pi * moment)
    read = Readings(*np.array(rows).T, points[:, 0], np.arange(len(rows)), points)
    return adjust(model_of(plan, BallsSolverSettings(sigma_centre_m=SIGMA), read))


def treatment(found):
    return next(p.treatment for p in found.protections() if p.effect == "recurring drift")


@pytest.mark.parametrize("balls", [ONE, THREE])
def test_runs_of_one_order_do_not_show_it_and_it_is_named(balls):
    for swing in (0.0, 3e-6):
        found = drifted(balls, SAME, swing)
        assert found.verdict == "ok"
        assert treatment(found) == "not protected"


@pytest.mark.parametrize("balls", [ONE, THREE])
@pytest.mark.parametrize("positions", [THERE_AND_BACK, ANOTHER_START])
def test_runs_of_several_orders_show_it(balls, positions):
    assert drifted(balls, positions, 0.0).verdict == "ok"
    found = drifted(balls, positions, 3e-6)
    assert found.verdict == "suspect"
    assert [e.effect.effect for e in found.found_effects] == ["recurring drift"]


def test_another_start_tests_all_of_it_and_there_and_back_what_is_not_the_same_from_both_ends():
    assert treatment(drifted(ONE, THERE_AND_BACK, 0.0)) == "not protected"
    assert treatment(drifted(ONE, ANOTHER_START, 0.0)) == "tested"


def test_a_pass_begins_with_a_station_and_where_a_position_comes_again():
    position = np.array([0, 0, 1, 1, 2, 2, 0, 1, 2, 2, 1, 0, 0])
    station = np.array([0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 1, 1, 1])
    order = np.arange(13)
    expected = [0, 0, 0, 0, 0, 0, 1, 1, 1, 2, 2, 2, 2]
    assert pass_numbers(station, position, order).tolist() == expected
    backwards = order[::-1]
    assert (
        pass_numbers(station[backwards], position[backwards], backwards)[::-1].tolist() == expected
    )


def test_a_warm_up_is_nearly_a_sum_of_its_shapes():
    run, when = np.repeat([0, 1], 24), np.arange(48.0)
    shapes = recurring(run, when)
    warm = np.tile(np.exp(-np.arange(24) / 12.0), 2)
    design = np.column_stack([shapes, np.ones(48)])
    left = warm - design @ np.linalg.lstsq(design, warm, rcond=None)[0]
    assert np.abs(left).max() < 0.06 * np.ptp(warm)
    assert np.abs(recurring(np.full(48, -1), when)).max() == 0.0
