"""Statements that are exceeded in a drawn machine: the verdict changes, or it names them."""

import numpy as np
import pytest
from ball_world import COLUMN, LEVEL, ONE, THREE, World

from rotcal_ros.foundation.protection import TOLERABLE
from rotcal_ros.methods import changed, prepare
from rotcal_ros.methods.configuration import parse_configuration

BALLS = {"ONE": ONE, "LEVEL": LEVEL, "COLUMN": COLUMN, "THREE": THREE}
MOTION, NOISE, TIMES = 2e-6, 1e-6, 5.0
LOW = {"radial": (2, 3, 4), "axial": (1, 2, 3), "tilt": (2, 3, 4)}


def prepared(balls, *changes):
    text = (
        f"method: table_balls\nballs_m: {np.reshape(BALLS[balls], (-1, 3)).tolist()}\n"
        f"axis_m: [0.0, 0.0, 0.06]\nmeasure: centre\nerror_motion_std_m: {MOTION}\n"
    )
    return prepare(changed(parse_configuration(text), changes))


def undulation(world, order, rng):
    """Return an undulation whose root mean square is 1, of a random phase."""
    return np.sqrt(2.0) * np.cos(order * world.angles + rng.uniform(0.0, 6.0))


def exceeded(world, what, rng):
    """Make something of the world five times as large as stated."""
    if what == "radial":
        world.motions[:2] = 0.0
        world.motions[0] = TIMES * MOTION * undulation(world, 2, rng)
    elif what == "axial":
        world.motions[2] = TIMES * MOTION * undulation(world, 1, rng)
    elif what == "tilt":
        world.motions[3:5] *= TIMES
    elif what == "scale":
        world.linear += np.diag(TIMES * 1e-5 * rng.choice([-1.0, 1.0], 3))
    elif what == "squareness":
        world.linear += np.triu(TIMES * 1e-5 * rng.choice([-1.0, 1.0], (3, 3)), 1)


def result_of(calibration, what, seed):
    """Return the result of a world where that is exceeded, and outputs less their truth."""
    rng = np.random.default_rng(seed)
    world = World(calibration.configuration.plan, calibration.configuration.solver)
    world.move(rng, **LOW)
    exceeded(world, what, rng)
    read = world.readings(NOISE, np.random.default_rng(seed))
    steps = {}
    for step in calibration.plan.steps:
        steps.setdefault((step.table_position, step.target), []).append(step)
    observed = []
    for position, target, point in zip(read.position, read.target, read.points, strict=True):
        mine = steps[position, target]
        step = mine.pop(0) if len(mine) > 1 else mine[0]
        observed.append(step.observed(tuple(point.tolist())))
    motions, line = world.truth()
    found = calibration.solve(observed)
    axis = found.axes[0]
    error = np.append(found.deviations["ECC"] - motions[5], axis.value - line)
    return found, error, np.append(found.std["ECC"], axis.std)


EXCEEDED = {
    ("ONE", "radial"): "error motion",
    ("ONE", "axial"): "error motion",
    ("ONE", "tilt"): "tilt",
    ("LEVEL", "tilt"): "tilt",
    ("COLUMN", "squareness"): "gauge",
    ("COLUMN", "axial"): "error motion",
}


@pytest.mark.parametrize(("balls", "what"), EXCEEDED)
def test_a_statement_that_is_exceeded_and_shows_nowhere_is_named(balls, what):
    calibration, effect = prepared(balls), EXCEEDED[balls, what]
    found, _, _ = result_of(calibration, what, 1)
    assert effect in found.unprotected


@pytest.mark.slow
@pytest.mark.parametrize("what", ["radial", "axial", "tilt", "scale", "squareness"])
@pytest.mark.parametrize("balls", BALLS)
def test_what_is_exceeded_unnoticed_and_unnamed_does_little(balls, what):
    calibration, change = prepared(balls), []
    effect = {"radial": "error motion", "axial": "error motion", "squareness": "gauge"}
    for seed in range(2):
        found, error, std = result_of(calibration, what, seed)
        if found.verdict == "ok" and effect.get(what, what) not in found.unprotected:
            _, plain, _ = result_of(calibration, "", seed)
            change.append((error - plain) / std)
    assert not change or np.sqrt(np.square(change).mean(axis=0)).max() < TOLERABLE


def test_three_balls_need_no_statement_of_motions_or_linear_axes():
    found, _, _ = result_of(prepared("THREE"), "", 0)
    assert not {"error motion", "tilt", "scale", "gauge"} & set(found.unprotected)


def test_many_angles_test_white_motion_where_it_is_known_to_be_that():
    many = ("plan.table_positions=36", "plan.table_step_deg=10.0")
    for orders, named in (("any", True), ("white", False)):
        calibration = prepared("ONE", *many, f"solver.error_motion_orders={orders}")
        found = calibration.solve(calibration.nominal_observations())
        assert ("error motion" in found.unprotected) == named
