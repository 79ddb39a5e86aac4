"""Balls on the table: signs, truth of another generator, uncertainty, what cannot be told."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from ball_world import AS_DRAWN, COLUMN, LEVEL, NAMES, ONE, THREE, World
from chances import LONG, share
from click.testing import CliRunner
from scipy.optimize import brentq
from scipy.stats import binom, chi2, ncx2

from rotcal_ros.adjust import designs
from rotcal_ros.adjust.engine import adjust
from rotcal_ros.adjust.fit import fit_model
from rotcal_ros.adjust.look import LARGEST_GROUP, split_group
from rotcal_ros.adjust.model import members_by_group
from rotcal_ros.cli.main import rotcal
from rotcal_ros.foundation.errors import ConfigurationError, DataError, PlanError
from rotcal_ros.foundation.protection import EFFECTS
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.methods import changed, prepare, prepare_to_measure, read_configuration
from rotcal_ros.methods.measurements import read_measurements
from rotcal_ros.methods.simulated_run import simulated_run
from rotcal_ros.methods.simulation.table import deviations
from rotcal_ros.methods.table_balls.model import (
    MOTIONS,
    BallsOnTable,
    ball_motions,
    components_of,
    model_of,
)
from rotcal_ros.methods.table_balls.settings import BallsPlanSettings, BallsSolverSettings
from rotcal_ros.planning.readings import Readings

CONFIG = Path(__file__).parents[3] / "config"
SIGMA = 1e-6
TOLD = {
    "ONE": ("ECC",),
    "LEVEL": ("EXC", "EYC", "ECC"),
    "COLUMN": ("EZC", "EAC", "EBC", "ECC"),
    "THREE": NAMES,
}
BALLS = {"ONE": ONE, "LEVEL": LEVEL, "COLUMN": COLUMN, "THREE": THREE}


def planned(name="THREE", **more):
    """Return settings of a plan; the axis is told at the height of the first balls."""
    return BallsPlanSettings(balls_m=BALLS[name], axis_m=(0.0, 0.0, 0.06), **more)


def modelled(world, read=None):
    return model_of(world.plan, world.solver, world.readings() if read is None else read)


def solved(model):
    """Return the least-squares solution without any judgement."""
    return fit_model(model, np.ones(len(model.observed), dtype=bool), model.std, model.first)


def curves(world, values):
    """Return values (o,) of outputs by component, and those of the axis."""
    names = components_of(BallsOnTable.of(world.plan, world.solver))
    count = len(world.angles)
    return dict(zip(names, values[: len(names) * count].reshape(len(names), -1), strict=True)), (
        values[len(names) * count : len(names) * count + 4]
    )


def perfect_machine(name="THREE", seed=3, **more):
    """Return a world whose linear axes have no errors."""
    world = World.drawn(planned(name, **more), np.random.default_rng(seed))
    return replace(world, linear=np.zeros((3, 3)))


@pytest.mark.parametrize("name", TOLD)
def test_what_the_balls_tell_follows_from_their_places(name):
    assert components_of(BallsOnTable.of(planned(name), BallsSolverSettings())) == TOLD[name]


@pytest.mark.parametrize(
    ("more", "keep"),
    [
        ({}, slice(None)),
        ({"table_angles_deg": (0, 20, 50, 90, 140, 200, 270, 330)}, slice(None)),
        ({"table_start_deg": 200.0, "table_step_deg": 10.0}, slice(None)),
        ({"runs": 1, "closing": False}, slice(None, None, -1)),
    ],
)
def test_three_balls_tell_the_truth_exactly(more, keep):
    world = perfect_machine(**more)
    model = modelled(world, world.readings(keep=keep))
    found, line = curves(world, solved(model).value)
    motions, axis = world.truth()
    for name, true in zip(NAMES, motions, strict=True):
        # second order: products of tilts, and of these with the motions' means
        assert found[name] == pytest.approx(true, abs=5e-9), name
    assert line == pytest.approx(axis, abs=5e-9)


def test_each_motion_has_its_own_sign():
    """Of a table that errs at one angle, in one way, by a part that no definition takes away."""
    for number, name in enumerate(NAMES):
        world = World(planned())
        world.motions[number, 4] = 5e-6
        found, _ = curves(world, solved(modelled(world)).value)
        assert found[name][4] - found[name][5] == pytest.approx(5e-6, rel=0.3)
        assert found[name].argmax() == 4


def test_the_axis_stands_and_leans_where_it_does():
    for number in range(4):
        axis = np.zeros(4)
        axis[number] = 3e-4
        world = World(planned("ONE"), axis=tuple(axis))
        _, line = curves(world, solved(modelled(world)).value)
        assert line == pytest.approx(axis, abs=1e-10)


def test_the_height_of_the_axis_is_the_stated_one():
    world = World(planned(), axis=(0.0, 0.0, 1e-4, 2e-4))
    higher = replace(world.plan, axis_m=(0.0, 0.0, 0.16))
    model = model_of(higher, world.solver, world.readings())
    _, line = curves(world, solved(model).value)
    assert line == pytest.approx([0.1 * 2e-4, -0.1 * 1e-4, 1e-4, 2e-4], abs=1e-9)


def test_derivatives_are_those_of_differences():
    world = World.drawn(planned(), np.random.default_rng(2))
    model = modelled(world)
    x = model.first + 1e-4 * np.random.default_rng(3).standard_normal(model.size[1])
    step = 1e-5 * np.eye(len(x))
    by_difference = [(model.equations(x + h)[0] - model.equations(x - h)[0]) / 2e-5 for h in step]
    assert model.equations(x)[1].dense() == pytest.approx(np.array(by_difference).T, abs=1e-9)


def test_derivatives_of_a_nest_that_is_late_are_those_of_differences():
    plan = turning(speeds=(20.0, -30.0))
    balls = BallsOnTable.of(plan, BallsSolverSettings(), World(plan).readings())
    x = 1e-3 * np.random.default_rng(3).standard_normal(sum(balls.blocks.values()))
    x[balls.first["lag"]] = 5e-3
    step = 1e-5 * np.eye(len(x))
    by_difference = [(balls(x + h)[0] - balls(x - h)[0]) / 2e-5 for h in step]
    assert balls(x)[1].toarray() == pytest.approx(np.array(by_difference).T, abs=1e-9)


@pytest.mark.parametrize("chain", ["C", "AC"])
def test_the_six_motions_of_an_angle_are_a_block_of_their_own(chain, monkeypatch):
    """Each step is solved so, and says what one whole matrix says, to 1e-12 of the uncertainty."""
    monkeypatch.setattr(designs, "FEW", 0)
    tilts = (-40.0, 50.0) if chain == "AC" else ()
    world = World.drawn(planned(chain=chain, tilts_deg=tilts), np.random.default_rng(2))
    model = modelled(world, world.readings(SIGMA, np.random.default_rng(3)))
    x = solved(model).x + 1e-7
    computed, design = model.equations(x)
    kernel = design.weighted(1.0 / model.std).kernel()
    balls = BallsOnTable.of(world.plan, world.solver)
    motions = balls.first["EXC"] + np.arange(6 * 12 * balls.tilts).reshape(6, -1)
    assert sorted(map(sorted, kernel.groups.own.tolist())) == sorted(motions.T.tolist())
    white = (model.observed - computed) / model.std
    whole = design.dense() / model.std[:, None]
    scale = np.linalg.norm(whole, axis=0)
    root = np.linalg.inv(np.linalg.qr(whole / scale)[1]) / scale[:, None]
    step = np.linalg.lstsq(whole / scale, white, rcond=None)[0] / scale
    found = kernel.solve(white)
    assert np.abs((found - step) / np.linalg.norm(root, axis=1)).max() < 1e-12


def test_one_ball_moves_as_it_does_out_along_and_up():
    """Against the distance, the turn and the height of the ball itself."""
    world = perfect_machine("ONE", closing=False, runs=1)
    own, line = world.truth()
    world = replace(world, motions=own, axis=(*line[:2], 0.0, 0.0))
    found = adjust(modelled(world)).further
    places = world.readings().points - world.plan.axis_m - [*world.axis[:2], 0.0]
    radius, height = np.hypot(*places.T[:2]), places[:, 2]
    turn = np.unwrap(np.arctan2(places[:, 1], places[:, 0])) - world.angles
    told = dict(zip(MOTIONS, (radius, radius.mean() * turn, height), strict=True))
    basis = np.column_stack([np.ones(12), np.cos(world.angles), np.sin(world.angles)])

    def own_of(values):
        return values - basis @ np.linalg.lstsq(basis, values, rcond=None)[0]

    for name, true in told.items():
        value, std = found[name]
        assert own_of(value) == pytest.approx(own_of(true), abs=5e-9), name
        assert (std > 0.0).all()


def test_rows_of_motions_are_displacements_of_the_ball():
    balls = BallsOnTable.of(planned(), BallsSolverSettings())
    x = 1e-6 * np.random.default_rng(1).standard_normal(sum(balls.blocks.values()))
    motions = x[balls.first["EXC"] : balls.first["scale"]].reshape(6, -1).T
    for ball in range(3):
        place = balls.turned(balls.places)[:, ball]
        moved = motions[:, :3] + np.cross(motions[:, 3:], place)
        rows = [row @ x for row in ball_motions(balls, balls.places[ball])]
        out = place[:, :2] / np.linalg.norm(place[:, :2], axis=1)[:, None]
        assert rows[0] == pytest.approx((moved[:, :2] * out).sum(axis=1))
        assert rows[1] == pytest.approx(moved[:, 1] * out[:, 0] - moved[:, 0] * out[:, 1])
        assert rows[2] == pytest.approx(moved[:, 2])


def test_the_same_as_another_least_squares():
    """Written down with all definitions as hard constraints, in the small motions."""
    world = perfect_machine(seed=5)
    read = world.readings(SIGMA, np.random.default_rng(6))
    model = modelled(world, read)
    fit = solved(model)
    rows = len(read.points) * 3
    design, known = fit.design[:rows], fit.design[rows:] / fit.std[rows:, None]
    prior, constraints = known[:-10], known[-10:]
    u = design.shape[1]
    normal = design.T @ design / SIGMA**2 + prior.T @ prior
    scale = 1.0 / np.sqrt(normal.diagonal() + 1e-12)
    tied = constraints * scale
    tied /= np.linalg.norm(tied, axis=1)[:, None]
    whole = np.block([[normal * scale * scale[:, None], tied.T], [tied, np.zeros((10, 10))]])
    inverse = np.linalg.inv(whole)[:u, :u] * scale * scale[:, None]
    outputs = model.outputs.times(np.eye(u))
    assert (outputs @ inverse @ outputs.T).diagonal() == pytest.approx(
        (fit.response**2).sum(axis=1)[: len(outputs)], rel=1e-4
    )


def test_turning_the_world_turns_the_motions():
    """The same table and balls in a machine whose x axis points along its y axis."""
    world = World(planned(), motions=World.drawn(planned(), np.random.default_rng(8)).motions)
    found, line = curves(world, solved(modelled(world)).value)
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    read = world.readings()
    plan = replace(
        world.plan, balls_m=tuple((np.reshape(world.plan.balls_m, (-1, 3)) @ quarter.T).ravel())
    )
    points = read.points @ quarter.T
    other = model_of(plan, world.solver, replace(read, points=points, value=points[:, 0]))
    again, leans = curves(world, solved(other).value)
    for x, y in (("EXC", "EYC"), ("EAC", "EBC")):
        assert again[x] == pytest.approx(-found[y], abs=1e-13)
        assert again[y] == pytest.approx(found[x], abs=1e-13)
    for name in ("EZC", "ECC"):
        assert again[name] == pytest.approx(found[name], abs=1e-13)
    assert leans[[1, 3]] == pytest.approx(line[[0, 2]], abs=1e-12)


def test_another_first_angle_and_another_order_change_nothing():
    world = World.drawn(planned(closing=False), np.random.default_rng(9))
    read = world.readings(SIGMA, np.random.default_rng(1))
    found, line = curves(world, solved(modelled(world, read)).value)
    turns = {"table_angles_deg": tuple(30.0 * k for k in range(3, 15))}
    shifted = Readings(
        (read.position - 3) % 12, read.target, read.station, read.value, read.order, read.points
    )
    plan = replace(world.plan, **turns)
    back = curves(world, solved(model_of(plan, world.solver, shifted)).value)
    for name in NAMES:
        assert np.roll(back[0][name], 3) == pytest.approx(found[name], abs=1e-12)
    assert back[1] == pytest.approx(line, abs=1e-12)
    reverse = world.readings(SIGMA, np.random.default_rng(1), keep=slice(None, None, -1))
    again, _ = curves(world, solved(modelled(world, reverse)).value)
    assert again["EAC"] == pytest.approx(found["EAC"], abs=1e-12)


def test_the_uncertainty_of_one_ball_by_hand():
    """A circle of n points: its centre has 2 s^2 / n; ECC has 1 - 1/n of a point at the radius."""
    solver = BallsSolverSettings(
        error_motion_std_m=1e-9, tilt_std_arcsec=1e-3, squareness_std_um_per_m=1e-3,
        scale_std_um_per_m=1e-3, sigma_centre_m=1e-5,
    )  # fmt: skip
    world = World(planned("ONE", closing=False, runs=2), solver)
    fit = solved(modelled(world))
    ecc, axis = curves(world, np.linalg.norm(fit.response, axis=1))
    radius = np.hypot(*ONE[:2])
    # nothing else is free: motions are stated to be nothing
    assert ecc["ECC"] == pytest.approx(1e-5 / radius / np.sqrt(2) * np.sqrt(1 - 1 / 12), rel=0.2)
    assert axis[:2] == pytest.approx(1e-5 * np.sqrt(2 / 24), rel=0.2)
    assert axis[2:] == pytest.approx(1e-5 / radius * np.sqrt(2 / 24), rel=0.2)


def test_squareness_that_is_not_told_is_in_the_uncertainty_and_that_which_is_less_so():
    def found(name, square):
        solver = BallsSolverSettings(squareness_std_um_per_m=square)
        fit = adjust(modelled(World(planned(name), solver)))
        return fit, fit.further["squareness"][1][0] * 1e6

    one, left = found("ONE", 30.0)
    assert left == pytest.approx(30.0, rel=0.05)  # a second harmonic of the motions
    less, _ = found("ONE", 1.0)
    assert one.std[0] > 1.05 * less.std[0]
    three, left = found("THREE", 30.0)
    assert left < 5.0
    assert three.std[-4] < one.std[-4]


@pytest.mark.parametrize("name", ["ONE", "THREE"])
def test_lobes_of_the_probe_move_the_axis_and_nothing_else_tells_of_them(name):
    """The same touches of all balls at all angles are off by the same: only a statement helps."""
    world = World.drawn(planned(name), np.random.default_rng(3))
    lobed = replace(world, lobing=4e-6)
    shift = lobed.touched()
    assert np.hypot(*shift[:2]) > 1e-6
    one, two = (solved(modelled(each)) for each in (world, lobed))
    moved = two.value - one.value
    count = len(one.model.outputs)
    assert moved[count - 4 : count - 2] == pytest.approx(shift[:2], rel=1e-3)
    assert moved[: count - 4] == pytest.approx(0.0, abs=1e-9)
    assert moved[count - 2 : count] == pytest.approx(0.0, abs=1e-9)
    told = replace(world, solver=BallsSolverSettings(tip_std_m=2e-6))
    std, wider = (np.linalg.norm(f.response, axis=1) for f in (one, solved(modelled(told))))
    more = np.where(np.isin(np.arange(count), [count - 4, count - 3]), 2e-6, 0.0)
    assert wider[:count] == pytest.approx(np.hypot(std[:count], more), rel=1e-3)


@pytest.mark.parametrize(
    ("tip", "treatment"), [(0.0, "not protected"), (1e-7, "bounded"), (2e-6, "not protected")]
)
def test_an_offset_of_the_tip_is_named_until_it_is_stated_to_be_small(tip, treatment):
    demo = read_configuration(CONFIG / "table_balls.yaml")
    calibration = prepare_to_measure(changed(demo, (f"solver.tip_std_m={tip}",)))
    result = calibration.solve(calibration.nominal_observations())
    assert [p.treatment for p in result.protections if p.effect == "probe tip"] == [treatment]
    assert ("probe tip" in result.unprotected) == (treatment == "not protected")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "passes", "sigma"), [("ONE", 2, SIGMA), ("THREE", 1, np.hypot(SIGMA, 0.5e-6))]
)
def test_intervals_hold_the_truth_beside_lobes_and_play_that_are_stated(name, passes, sigma):
    """Play of 1 um: one ball takes it for motions of the table, three need it as noise.

    Only some of it is: what is the same in all runs is in the places of the balls, and intervals
    that hold it as well hold the truth a little more often.
    """
    rng, inside, runs = np.random.default_rng(22), [], 1000 if LONG else 300
    solver = replace(AS_DRAWN, tip_std_m=2e-6, sigma_centre_m=sigma)
    unit = np.abs(replace(World(planned(name)), lobing=1e-6).touched()[0]) / 1e-6
    for _ in range(runs):
        world = World.drawn(planned(name, runs=passes), rng, solver)
        world.lobing = complex(*(solver.tip_std_m / unit * rng.standard_normal(2)))
        world.play = 1e-6
        fit = solved(modelled(world, world.readings(SIGMA, rng)))
        std = np.linalg.norm(fit.response, axis=1)[: len(fit.model.outputs)]
        motions, line = world.truth()
        true = np.append([motions[NAMES.index(c)] for c in TOLD[name]], line)
        inside.append(np.abs(fit.value[: len(std)] - true) < 1.96 * std)
    found = np.mean(inside, axis=0)
    assert 0.93 < found[:-4].mean() < 0.97
    assert (found[-4:] > binom.ppf(1e-4, runs, 0.95) / runs).all(), found
    assert (found[-4:-2] < share(0.95, runs)[1]).all(), found  # lobes as large as stated


def test_a_ball_that_was_touched_wrongly_is_left_out():
    world = World.drawn(planned(), np.random.default_rng(4))
    read = world.readings(SIGMA, np.random.default_rng(2))
    points = read.points.copy()
    points[17] += [0.0, 4e-5, 0.0]
    found = adjust(modelled(world, replace(read, points=points)))
    assert list(found.why) == [3 * 17 + 1]
    assert "y of ball 2 at position 5, run 0" in found.why[52]
    motions, line = world.truth()
    assert curves(world, (found.value - np.append(motions.ravel(), line)) / found.std)[
        1
    ] == pytest.approx(0.0, abs=4.0)


def test_a_drift_is_found_by_the_second_run():
    world = World.drawn(planned("ONE"), np.random.default_rng(4))
    read = world.readings(SIGMA, np.random.default_rng(2))
    slope = np.linspace(-1.0, 1.0, len(read.points))[:, None]
    found = adjust(modelled(world, replace(read, points=read.points + slope * [1e-5, 0.0, 0.0])))
    assert found.verdict == "suspect"
    assert [e.effect.effect for e in found.found_effects] == ["drift"]
    assert found.found_effects[0].sizes[0] == pytest.approx(2e-5, abs=3e-6)


def test_missing_centres_are_made_up_by_the_statement():
    world = World.drawn(planned(), np.random.default_rng(4))
    read = world.readings(SIGMA, np.random.default_rng(2))
    whole = adjust(modelled(world, read))
    seen = ~((read.position == 5) & (read.target > 0))
    some = adjust(modelled(world, world.readings(SIGMA, np.random.default_rng(2), keep=seen)))
    place = [k * 12 + 5 for k in range(6)]
    assert (some.std[place[3:5]] > 2.0 * whole.std[place[3:5]]).all()
    motions, _ = world.truth()
    error = (some.value[:72] - motions.ravel()) / some.std[:72]
    assert np.abs(error).max() < 4.5


@pytest.mark.slow
@pytest.mark.parametrize("name", TOLD)
def test_intervals_hold_the_truth_in_93_to_97_percent(name):
    """Of 1000 worlds that are drawn from what is stated; every value, and the axis."""
    rng, inside = np.random.default_rng(20), []
    for _ in range(1000):
        world = World.drawn(planned(name), rng, AS_DRAWN)
        model = modelled(world, world.readings(SIGMA, rng))
        fit = solved(model)
        std = np.linalg.norm(fit.response, axis=1)[: len(model.outputs)]
        motions, line = world.truth()
        true = np.append([motions[NAMES.index(c)] for c in TOLD[name]], line)
        inside.append(np.abs(fit.value[: len(std)] - true) < 1.96 * std)
    found = np.mean(inside, axis=0)
    odds = 1e-3 / len(found)  # of so many values, by chance
    assert (found > binom.ppf(odds, 1000, 0.95) / 1000).all(), found
    assert (found < binom.isf(odds, 1000, 0.95) / 1000).all(), found
    curves = found[:-4].reshape(len(TOLD[name]), -1).mean(axis=1)
    assert ((np.append(curves, found[-4:]) > 0.93) & (np.append(curves, found[-4:]) < 0.97)).all()


@pytest.mark.slow
def test_the_whole_engine_holds_them_too():
    rng, inside, alarms, runs = np.random.default_rng(21), [], 0, 1000 if LONG else 200
    for _ in range(runs):
        world = World.drawn(planned("ONE"), rng, AS_DRAWN)
        found = adjust(modelled(world, world.readings(SIGMA, rng)))
        alarms += found.verdict != "ok"
        motions, line = world.truth()
        true = np.append(motions[5], line)
        inside.append(np.abs(found.value - true) < 1.96 * found.std)
    assert 0.93 < np.mean(inside) < 0.97
    assert alarms <= 0.06 * runs


def test_what_cannot_be_is_refused(tmp_path):
    demo = read_configuration(CONFIG / "table_balls_demo.yaml")
    with pytest.raises(PlanError, match="within 1 mm of the axis"):
        prepare_to_measure(changed(demo, ("plan.balls_m=[0.001, 0.0, 0.08]",)))
    with pytest.raises(ConfigurationError, match="state at least one ball"):
        prepare(changed(demo, ("plan.balls_m=[]",)))
    with pytest.raises(PlanError, match="expected x y z"):
        prepare(changed(demo, ("plan.balls_m=[0.1, 0.2]",)))
    calibration = prepare_to_measure(demo)
    backwards = [
        replace(o, mean=(o.mean[0], -o.mean[1], o.mean[2]))
        for o in calibration.nominal_observations()
    ]
    with pytest.raises(DataError, match="the table turns the other way"):
        calibration.solve(backwards)


def test_the_default_plan_of_one_ball_takes_less_than_eight_minutes():
    """25 stops: 30 degrees at 20 deg/s with 1 s to settle, 3 s to the ball, 2 s for each touch."""
    plan = prepare_to_measure(read_configuration(CONFIG / "table_balls.yaml")).plan
    angles = np.degrees([step.table_angle for step in plan.steps])
    assert len(plan.steps) == 25
    assert sum(step.n_points for step in plan.steps) == 125
    seconds = np.abs(np.diff(angles)).sum() / 20.0 + 25 * (1.0 + 3.0) + 125 * 2.0
    assert seconds < 8 * 60


@pytest.mark.parametrize(
    "changes",
    [
        (),
        (
            f"plan.balls_m={[*THREE]}", f"simulation.balls.balls_m={[*THREE]}",
            "plan.axis_m=[0.0, 0.0, 0.0]",
        ),
    ],
)  # fmt: skip
def test_the_simulated_cell_is_solved_to_its_truth(changes):
    configuration = changed(read_configuration(CONFIG / "table_balls_demo.yaml"), changes)
    calibration = prepare_to_measure(configuration)
    seen = [o for event in simulated_run(calibration) for o in event.observed if o.accepted]
    result = calibration.solve(seen)
    assert result.verdict == "ok", result.warnings
    true = calibration.method.gauge(
        result.angles, deviations(configuration.simulation.table, result.angles)
    )
    for name in result.components:
        assert np.abs((result.deviations[name] - true[name]) / result.std[name]).max() < 4.0, name
    axis = result.axes[0]
    x, y, _ = configuration.simulation.table.axis_offset_m
    a, b = np.array(configuration.simulation.table.axis_tilt_arcsec) * ARCSEC
    height = configuration.plan.axis_m[2]
    line = [x + height * b, y - height * a, a, b]
    assert np.abs((axis.value - line) / axis.std).max() < 3.5
    assert [p.effect for p in result.protections if p.effect in EFFECTS] == list(EFFECTS)
    assert len(calibration.method.figures(result, None)) == 5
    drawn = calibration.trials(seen)(np.random.default_rng(1), 4000)
    std = np.concatenate([result.std[name] for name in result.components])
    assert drawn.std(axis=0) == pytest.approx(std, rel=0.06)
    assert calibration.method.tables(result)[0].rows[0][0] == "XOC"


def test_a_table_of_centres_in_millimetres_is_read(tmp_path):
    world = World.drawn(planned("ONE"), np.random.default_rng(2))
    read = world.readings(SIGMA, np.random.default_rng(1))
    rows = zip(read.position, read.target, *(1e3 * read.points.T), strict=True)
    path = tmp_path / "centres.csv"
    lines = ["position,ball,x [mm],y [mm],z [mm]"]
    path.write_text(
        "\n".join([*lines, *(",".join(f"{cell:.13g}" for cell in row) for row in rows)]) + "\n"
    )
    demo = read_configuration(CONFIG / "table_balls.yaml")
    configuration = changed(
        demo, (f"plan.balls_m={[*ONE]}", "plan.axis_m=[0.0, 0.0, 0.06]", "plan.measure=centre")
    )
    result = read_measurements(path, configuration).solve()
    found = adjust(modelled(world, read))
    assert result.deviations["ECC"] == pytest.approx(found.value[:12], abs=1e-12)
    assert result.n_observations == 25
    assert result.residuals.coordinates == 3
    assert result.raw_data.influence.deviations["ECC"].shape == (12, 75 + 56)


def test_the_plan_says_what_a_wrong_centre_could_do():
    """By ``rotcal plan reliability``: the second run checks half of every centre."""
    run = CliRunner().invoke(rotcal, ["plan", "reliability", str(CONFIG / "table_balls.yaml")])
    assert run.exit_code == 0, run.output
    assert "not tested for: " in run.stderr.splitlines()[-1]
    first = run.stderr.splitlines()[0]
    head, *rows = run.stdout.splitlines()
    assert first == "25 observations, mean redundancy 0.52, 0 checked by no other"
    assert head == "position,target,redundancy,error/um,error/std,effect/std"
    # Baarda: a point of three coordinates, with a significance of 0.001 and a power of 0.8
    limit = chi2.isf(0.001, 3)
    least = brentq(lambda noncentrality: ncx2.sf(limit, 3, noncentrality) - 0.8, 1.0, 60.0)
    assert float(rows[1].split(",")[3]) == pytest.approx(np.sqrt(least / 0.5), rel=0.01)


def test_displacements_from_a_nest_that_follows_the_ball_tell_the_same(tmp_path):
    """An R-test: the spindle goes to the nominal place, the nest shows how far the ball is off."""
    world = World.drawn(planned("ONE"), np.random.default_rng(2))
    read = world.readings(SIGMA, np.random.default_rng(1))
    turn = np.exp(1j * world.angles[read.position])
    x, y, _ = world.balls[0]
    nominal = np.column_stack(
        [((x + 1j * y) * turn).real, ((x + 1j * y) * turn).imag, 0 * turn.real]
    )
    off = read.points - nominal - [0.0, 0.0, ONE[2]]
    path = tmp_path / "rtest.csv"
    rows = zip(read.position, read.target, *off.T, strict=True)
    lines = ["position,ball,dx_m,dy_m,dz_m"]
    lines += [",".join(f"{cell:.13g}" for cell in row) for row in rows]
    path.write_text("\n".join(lines) + "\n")
    configuration = changed(
        read_configuration(CONFIG / "table_balls.yaml"),
        (f"plan.balls_m={[*ONE]}", "plan.axis_m=[0.0, 0.0, 0.06]"),
    )
    result = read_measurements(path, configuration).solve()
    found = adjust(modelled(world, read))
    assert np.abs(off).max() < 2e-3
    assert result.deviations["ECC"] == pytest.approx(found.value[:12], abs=1e-12)
    assert result.axes[0].value == pytest.approx(found.value[12:], abs=1e-12)


def test_displacements_that_are_spoiled_on_purpose_are_displacements():
    demo = changed(
        read_configuration(CONFIG / "table_balls_demo.yaml"), ("plan.measure=displacement",)
    )
    calibration = prepare_to_measure(demo)
    good = calibration.measured({}, seed=3)
    assert np.abs([o.mean for o in good.observations]).max() < 1e-3
    result = calibration.solve(good.observations)
    assert result.verdict == "ok", result.warnings
    assert np.abs((result.deviations["ECC"] - good.truth["ECC"]) / result.std["ECC"]).max() < 4.0


def test_a_simulated_nest_finds_the_axis():
    configuration = changed(
        read_configuration(CONFIG / "table_balls_demo.yaml"), ("plan.measure=displacement",)
    )
    calibration = prepare_to_measure(configuration)
    seen = [o for event in simulated_run(calibration) for o in event.observed if o.accepted]
    assert len(seen) == 25
    assert np.abs([o.mean for o in seen]).max() < 2e-3
    axis = calibration.solve(seen).axes[0]
    line = [4.2e-5 - 0.08 * 6.0 * ARCSEC, -2.8e-5 - 0.08 * 9.0 * ARCSEC, 9 * ARCSEC, -6 * ARCSEC]
    assert np.abs((axis.value - line) / axis.std).max() < 3.5


def turning(name="ONE", speeds=(20.0, -20.0), **more):
    """Return settings of displacements that are read while the table turns."""
    return planned(
        name, measure="displacement", runs=len(speeds), closing=False, turning_deg_s=speeds, **more
    )


def passing_table(path, world, lag, rate_hz=50.0):
    """Write what a nest reads that follows ``lag`` late; curves between the angles."""
    rng, lines = np.random.default_rng(4), ["run,ball,passing [deg],dx_m,dy_m,dz_m"]
    ideal = replace(world, axis=(0.0,) * 4, missed=0.0 * world.missed)
    for run, speed in enumerate(world.plan.turning_deg_s):
        for angle in np.arange(-2.0, 333.0, abs(speed) / rate_hz)[:: 1 if speed > 0 else -1]:
            for ball in range(len(world.balls)):
                seen, sent = (
                    replace(
                        each, plan=replace(each.plan, table_angles_deg=(at,)), motions=moves
                    ).centre(0, ball)
                    for each, at, moves in (
                        (world, angle, smooth(np.radians(angle))),
                        (ideal, angle - speed * lag, np.zeros((6, 1))),
                    )
                )
                off = seen - sent + 1e-6 * rng.standard_normal(3)
                lines.append(f"{run},{ball},{angle:.6f}," + ",".join(f"{x:.12f}" for x in off))
    path.write_text("\n".join(lines) + "\n")
    return path


def smooth(angle):
    """Return motions (6, 1) of a table that deviates by harmonics."""
    waves = np.array([[2.0, 0.5], [3.0, 1.5], [2.0, -1.0], [4.0, 0.3], [3.0, 2.0], [5.0, 1.0]])
    size = np.array([1e-6, 1e-6, 1e-6, 5e-6, 5e-6, 2e-5])
    return (size * np.cos(waves[:, 0] * angle + waves[:, 1]))[:, None]


@pytest.mark.parametrize(
    ("speeds", "treatment"), [((20.0, -20.0), "estimated"), ((20.0, 20.0), "harmless")]
)
def test_a_nest_that_is_late_while_the_table_turns_is_found_out(tmp_path, speeds, treatment):
    """By 2 ms, at 20 deg/s 144 arcsec: both directions tell it, one is not spoiled by it."""
    world = World(turning(speeds=speeds), missed=np.array([[2e-4, -1e-4, 1e-4]]))
    path = passing_table(tmp_path / "turning.csv", world, lag=2e-3)
    configuration = changed(
        read_configuration(CONFIG / "table_balls.yaml"),
        (
            f"plan.balls_m={[*ONE]}", "plan.axis_m=[0.0, 0.0, 0.06]", "plan.closing=false",
            "plan.measure=displacement", f"plan.turning_deg_s={[*speeds]}",
            f"solver.lag_std_s={5e-3}",
        ),
    )  # fmt: skip
    result = read_measurements(path, configuration).solve()
    assert result.verdict == "ok", result.warnings
    assert [p.treatment for p in result.protections if p.effect == "lag"] == [treatment]
    angles = np.array(result.angles)
    true = np.array([smooth(angle)[5, 0] for angle in angles])
    away = result.deviations["ECC"] - true + true.mean()
    assert np.abs(away / result.std["ECC"]).max() < 3.5
    axis = result.axes[0]
    assert np.abs((axis.value - world.axis) / axis.std).max() < 3.5
    lag = result.details["also"]["lag"]
    if treatment == "estimated":
        assert lag["std"][0] < 1e-4
        assert lag["value"][0] == pytest.approx(2e-3, abs=3.5 * lag["std"][0])
    else:
        assert lag["std"][0] == pytest.approx(5e-3, rel=0.01)


def test_tables_that_turn_are_refused_where_they_do_not_fit(tmp_path):
    demo = changed(
        read_configuration(CONFIG / "table_balls.yaml"),
        ("plan.measure=displacement", "plan.closing=false"),
    )
    with pytest.raises(ConfigurationError, match="1 speeds, expected 2"):
        prepare(changed(demo, ("plan.turning_deg_s=[5.0]",)))
    with pytest.raises(ConfigurationError, match="takes plan"):
        prepare(changed(demo, ("plan.turning_deg_s=[5.0, -5.0]", "plan.closing=true")))
    turns = changed(demo, ("plan.turning_deg_s=[5.0, -5.0]",))
    with pytest.raises(ConfigurationError, match="run_up_deg: 1 leaves the table no way"):
        prepare(changed(turns, ("plan.run_up_deg=1.0",)))
    with pytest.raises(PlanError, match="takes 310 s to table position 1, target 0, longer than"):
        prepare_to_measure(
            changed(turns, ("plan.turning_deg_s=[0.1, -0.1]", "capture.step_timeout_s=200.0"))
        )
    with pytest.raises(PlanError, match="table_adapter moves the table from rest"):
        prepare_to_measure(changed(turns, ("table_adapter.speed_deg_s=10.0",)))
    path = tmp_path / "turning.csv"
    path.write_text("run,ball,passing_rad,dx_m,dy_m,dz_m\n0,0,0.01,0.0,0.0,0.0\n")
    with pytest.raises(DataError, match="run 0 has no readings of ball 0 on both sides of 0 deg"):
        read_measurements(path, turns)
    with pytest.raises(DataError, match="was read while the table turned: state"):
        read_measurements(path, demo)


def test_what_is_enumerated_of_many_angles_stays_bounded():
    """Work, not time: groups of which all pairs are looked at, and moments of a knock."""
    few, many = (
        World.drawn(planned(table_step_deg=360 / n, table_positions=n), np.random.default_rng(1))
        for n in (36, 144)
    )
    for world in (few, many):
        model = modelled(world, world.readings(SIGMA, np.random.default_rng(2)))
        knock = next(effect for effect in model.effects if effect.effect == "knock")
        assert knock.at(model.observed).shape[1] < 2000
        for grouping in model.groupings:
            for members in members_by_group(grouping, model.rejectable).values():
                parts = split_group(grouping, members)
                assert max(len(part) for part in parts) <= LARGEST_GROUP
                np.testing.assert_array_equal(np.sort(np.concatenate(parts)), members)
