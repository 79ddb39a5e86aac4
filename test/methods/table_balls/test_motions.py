"""What is stated of the table's motions: its orders, by closed forms and in drawn worlds."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from ball_world import NAMES, ONE, THREE, World
from chances import most, share

from rotcal_ros.adjust.engine import adjust, predicted
from rotcal_ros.adjust.fit import fit_model
from rotcal_ros.foundation.components import HALF_OF_95_PERCENT
from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.methods import prepare, read_configuration
from rotcal_ros.methods.configuration import parse_configuration
from rotcal_ros.methods.table_balls.method import restated as restated_of
from rotcal_ros.methods.table_balls.model import model_of
from rotcal_ros.methods.table_balls.motions import MOTION_KINDS
from rotcal_ros.methods.table_balls.settings import BallsPlanSettings, BallsSolverSettings

MOTION, NOISE = 2e-6, 1e-6
RADIUS = float(np.hypot(*ONE[:2]))
LOW = tuple(range(2, 11))
WORLDS = {
    "white": {},
    "order 2": {"radial": (2,), "axial": (2,), "tilt": (2,)},
    "order 1 axial": {"axial": (1,)},
    "2 to 4": {"radial": LOW[:3], "axial": LOW[:3], "tilt": LOW[:3]},
    "2 to 10": {"radial": LOW, "axial": LOW, "tilt": LOW},
    "two orders": {"radial": (2, 7), "axial": (1, 5), "tilt": (2, 3)},
    "smaller": {"radial": (2,), "axial": (1, 2), "tilt": (2, 4), "larger": 0.4},
}
STATED = {
    "white": {"error_motion_orders": "white"},
    "2 to 4": {
        "error_motion_orders": "stated",
        "radial_orders": (0.0, 1.0, 1.0, 1.0),
        "axial_orders": (0.0, 1.0, 1.0, 1.0),
        "tilt_orders": (0.0, 1.0, 1.0, 1.0),
    },
}
MEASURES = {
    "bar": {"measure": "bar"},
    "R-test": {"measure": "displacement"},
    "turning": {
        "measure": "displacement", "turning_deg_s": (20.0, -20.0), "closing": False,
    },
}  # fmt: skip


def planned(count=12, balls=ONE, **more):
    return BallsPlanSettings(
        balls_m=balls, axis_m=(0.0, 0.0, 0.06),
        table_step_deg=360.0 / count, table_positions=count, **more,
    )  # fmt: skip


def stated(**more):
    return BallsSolverSettings(**{"error_motion_std_m": MOTION, **more})


def covered(plan, solver, orders, runs=60):
    """Return how often intervals hold the truth: of ECC in the mean, and of the line's four.

    One world is solved; of the others motions and noise are drawn anew, which are small: what
    they do to the unknowns is linear.
    """
    rng, inside = np.random.default_rng(11), []
    world = World.drawn(plan, rng, solver)
    model = model_of(plan, solver, world.readings())
    fit = fit_model(model, np.ones(model.size[0], dtype=bool), model.std, model.first)
    count = len(world.readings().value) * (1 if plan.measure == "bar" else 3)
    unlike = fit.gain(slice(0, len(fit.x)))[:, :count] / NOISE
    read = fit.computed[:count]
    for _ in range(runs):
        world.move(rng, **orders)
        seen = world.readings(NOISE, rng)
        seen = seen.value if plan.measure == "bar" else seen.points.ravel()
        motions, line = world.truth()
        found = replace(fit, x=fit.x + unlike @ (seen - read))
        error = found.value[: len(model.outputs)]
        error -= np.append(motions[NAMES.index("ECC")], line)
        inside.append(np.abs(error) < HALF_OF_95_PERCENT * found.noise_std[: len(error)])
    found = np.mean(inside, axis=0)
    return np.append(found[:-4].mean(), found[-4:])


@pytest.mark.parametrize(
    ("orders", "measure"),
    [*((orders, "touch") for orders in WORLDS), *(("order 2", each) for each in MEASURES)],
)
def test_intervals_hold_motions_of_any_orders(orders, measure):
    found = covered(planned(**MEASURES.get(measure, {})), stated(), WORLDS[orders])
    assert (found >= share(0.95, 60)[0]).all()


@pytest.mark.parametrize("orders", STATED)
def test_intervals_of_stated_orders_are_no_larger_than_needed(orders):
    found = covered(planned(), stated(**STATED[orders]), WORLDS[orders], 150)
    low, high = share(0.95, 150)
    assert ((found >= low) & (found <= high)).all()


def line_std(count, orders):
    """Return standard uncertainties (4,) of the line, without what noise and linear axes do.

    That is the same with white motion, for which the closed form is known.
    """
    found = []
    for each in (orders, "white"):
        solver = stated(error_motion_orders=each)
        world = World(planned(count), solver)
        found.append(predicted(model_of(world.plan, solver, world.readings())).std[-4:])
    white = expected(1.0 / count, 2.0 / count, 1.0 / count)
    return np.sqrt(found[0] ** 2 - found[1] ** 2 + white**2)


def expected(radial, axial, tilt):
    """Return standard uncertainties (4,) of the line, by shares of the variances of motions."""
    place = MOTION * np.sqrt(radial)
    lean = np.sqrt(axial * (MOTION / RADIUS) ** 2 + tilt * (3.0 * ARCSEC) ** 2)
    return np.array([place, place, lean, lean])


@pytest.mark.parametrize("count", [12, 36])
@pytest.mark.parametrize("orders", ["any", "stated"])
def test_more_angles_are_no_more_witnesses_of_one_order(count, orders):
    # the second harmonic of EXC and EYC passes for a shift, of half its square along each of both
    assert line_std(count, orders) == pytest.approx(expected(0.5, 1.0, 0.5), rel=1e-2)


@pytest.mark.parametrize(("orders", "square"), [("white", 1.0 / 72), ("2 to 4", 1.0 / 6.0)])
def test_many_angles_show_how_motions_are_spread(orders, square):
    world = World(planned(72), stated())
    rng, found = np.random.default_rng(5), []
    for _ in range(3):
        world.move(rng, **WORLDS[orders])
        found.append(adjust(model_of(world.plan, world.solver, world.readings(NOISE, rng))).std)
    unlike = predicted(model_of(world.plan, world.solver, world.readings())).std[-4:-2]
    true, plan = expected(square, 1.0, 1.0)[:2], expected(0.5, 1.0, 1.0)[:2]
    assert unlike == pytest.approx(plan, rel=0.02)
    std = np.median(found, axis=0)[-4:-2]
    assert (true < 1.02 * std).all()
    assert (std < 0.6 * true + 0.4 * plan).all()


def test_sizes_fall_with_the_order():
    second = (1.0 / 4.0) / (1.0 / np.arange(2, 11) ** 2).sum()
    first = 1.0 / (1.0 / np.arange(1, 11) ** 2).sum()
    found = line_std(36, "falling")
    assert found == pytest.approx(expected(second / 2.0, first, second / 2.0), rel=1e-2)


def test_what_balls_determine_is_in_no_orders():
    world = World(planned(balls=THREE))
    model = model_of(world.plan, world.solver, world.readings())
    assert not model.correlated


def test_sizes_that_are_none(tmp_path):
    setup = tmp_path / "setup.yaml"
    setup.write_text(
        "method: table_balls\nballs_m: [[0.15, 0.0, 0.08]]\nerror_motion_orders: stated\n"
        "axial_orders: [0.0, 0.0]\n"
    )
    with pytest.raises(ConfigurationError, match=r"solver\.axial_orders"):
        prepare(read_configuration(setup))


def asked(balls=ONE, count=12):
    """Return a configuration of these balls, and a world of it without motions."""
    text = (
        f"method: table_balls\nballs_m: {np.reshape(balls, (-1, 3)).tolist()}\n"
        f"axis_m: [0.0, 0.0, 0.06]\nmeasure: centre\ntable_positions: {count}\n"
        f"table_step_deg: {360.0 / count}\nerror_motion_std_m: {MOTION}\n"
    )
    configuration = parse_configuration(text)
    return configuration, World(configuration.plan, configuration.solver)


def judged(configuration, world, seed=3):
    """Return the outputs' last four, of the line, their errors in U, and what is doubted."""
    read = world.readings(NOISE, np.random.default_rng(seed))
    found = adjust(model_of(configuration.plan, configuration.solver, read))
    restated = restated_of(configuration, read, found)
    if restated is not None:
        solver = restated.configuration.solver
        found = adjust(model_of(configuration.plan, solver, read))
    _, line = world.truth()
    error = np.abs(found.value[-4:] - line) / (2.0 * found.std[-4:])
    return error, () if restated is None else restated.doubts


def larger(world, kind, times, rng):
    world.move(rng, larger=1.0)
    world.motions[list(MOTION_KINDS[kind])] *= times


@pytest.mark.parametrize(
    ("spoil", "named"),
    [
        ("cos 2 theta", "radial"),
        ("white 3 times", "radial"),
        ("error motion 10 times", "radial"),
        ("tilt 5 times", "tilt"),
        ("squareness", "radial"),
    ],
)
def test_motions_beyond_their_statement_are_named(spoil, named):
    configuration, world = asked()
    rng = np.random.default_rng(8)
    if spoil == "cos 2 theta":
        world.motions[0] = 1e-5 * np.cos(2.0 * world.angles)
    elif spoil == "squareness":
        world.linear[0, 1] = 1.5e-4
    else:
        kind = "tilt" if "tilt" in spoil else "radial"
        larger(world, kind, float(spoil.split()[-2]), rng)
    error, doubts = judged(configuration, world)
    assert any(f"{named} motions" in each for each in doubts)
    assert (error < 1.5).all()


@pytest.mark.parametrize("orders", WORLDS)
def test_sound_motions_are_not_doubted(orders):
    rng, doubted, runs = np.random.default_rng(21), 0, 20
    configuration, world = asked()
    for _ in range(runs):
        world.move(rng, **WORLDS[orders])
        read = world.readings(NOISE, rng)
        model = model_of(configuration.plan, configuration.solver, read)
        fit = fit_model(model, np.ones(model.size[0], dtype=bool), model.std, model.first)
        doubted += (
            restated_of(configuration, read, SimpleNamespace(fit=fit, model=model)) is not None
        )
    assert doubted <= most(0.03, runs)
