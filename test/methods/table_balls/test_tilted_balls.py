"""A table on a tilting axis: both lines and all motions, against transforms without the method."""

from pathlib import Path

import numpy as np
import pytest
from ball_world import AS_DRAWN, ONE, THREE, World, shifted, turned
from chances import LONG
from scipy.stats import binom

from rotcal_ros.adjust.fit import fit_model
from rotcal_ros.foundation.errors import ConfigurationError, DataError, PlanError
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.methods import changed, prepare, prepare_to_measure, read_configuration
from rotcal_ros.methods.measurements import read_measurements
from rotcal_ros.methods.simulated_run import simulated_run
from rotcal_ros.methods.table_balls.model import AXIS, model_of
from rotcal_ros.methods.table_balls.settings import BallsPlanSettings

CONFIG = Path(__file__).parents[3] / "config" / "table_balls.yaml"
TILTS = (-60.0, 0.0, 50.0, 90.0)
POINT = (0.02, 0.01, -0.1)
SIGMA = 1e-6
LINES = {"AC": ("YOA", "ZOA", "BOA", "COA"), "-B-C": ("XOB", "ZOB", "AOB", "COB")}


def planned(chain="AC", balls=THREE, **more):
    return BallsPlanSettings(
        balls_m=balls, axis_m=(0.0, 0.0, 0.06), chain=chain, tilts_deg=TILTS,
        tilting_axis_m=POINT, table_step_deg=45.0, table_positions=8, runs=1,
        **more,
    )  # fmt: skip


def solved(world, read=None):
    """Return the least-squares solution, and where the outputs of the lines begin."""
    model = model_of(world.plan, world.solver, world.readings() if read is None else read)
    used = np.ones(len(model.observed), dtype=bool)
    return fit_model(model, used, model.std, model.first), len(model.outputs) - 8, model


@pytest.mark.parametrize("chain", LINES)
@pytest.mark.parametrize("balls", [ONE, THREE])
def test_both_lines_are_where_they_are(chain, balls):
    world = World(planned(chain, balls))
    fit, first, model = solved(world)
    assert fit.value[first : first + 4] == pytest.approx(world.axis, abs=1e-9)
    assert fit.value[first + 4 : first + 8] == pytest.approx(world.line, abs=1e-9)
    x = fit.x + 1e-5 * np.random.default_rng(3).standard_normal(len(fit.x))
    step = 1e-5 * np.eye(len(x))[:: len(x) // 40 + 1]
    by_difference = [(model.equations(x + h)[0] - model.equations(x - h)[0]) / 2e-5 for h in step]
    columns = model.equations(x)[1].dense().T[:: len(x) // 40 + 1]
    assert columns == pytest.approx(np.array(by_difference), abs=1e-9)


@pytest.mark.parametrize("chain", LINES)
def test_motions_of_both_axes_and_the_table_s_axis_at_each_tilt(chain):
    world = World.drawn(planned(chain), np.random.default_rng(4))
    world.linear = np.zeros((3, 3))
    fit, first, model = solved(world)
    told = dict(zip(model.further, np.split(fit.value[first + 8 :], _ends(model)), strict=True))
    letter, turns = chain.strip("-")[0], -1 if chain.endswith("-C") else 1
    for number, part in enumerate("XYZABC"):
        found = told[f"E{part}{letter}"]
        assert found == pytest.approx(world.tilting[number], abs=2e-8)
        by_tilt, true = told[f"E{part}C by tilt"], world.motions[number]
        true = true * (turns if number == 5 else 1)  # actual less commanded
        assert by_tilt == pytest.approx(true, abs=2e-8)
        mean = true.reshape(len(TILTS), -1).mean(axis=0)
        assert fit.value[8 * number : 8 * number + 8] == pytest.approx(mean, abs=2e-8)
    seen = np.array([told[f"{name} by tilt"] for name in AXIS]).T
    along, sense = "AB".index(letter), -1 if chain[0] == "-" else 1
    for tilt, degrees in enumerate(TILTS):
        turn = np.zeros(3)
        turn[along] = -sense * np.radians(degrees)
        nominal = _about(np.subtract(POINT, world.plan.axis_m), turn)
        there = nominal @ world.tilted(tilt) @ _line(world.axis)
        foot, along_c = there[:3, 3], there[:3, 2]
        foot = foot - foot[2] * along_c / along_c[2]
        assert seen[tilt] == pytest.approx([*foot[:2], -along_c[1], along_c[0]], abs=4e-8)


def test_a_table_that_turns_clockwise_has_its_own_sense():
    """With C alone: commanded angles grow, ECC is how far the table turns too much."""
    plan = BallsPlanSettings(balls_m=THREE, axis_m=(0.0, 0.0, 0.06), chain="-C")
    world = World(plan, axis=(4e-5, -3e-5, 2e-5, -5e-5))
    world.motions[5] = 1e-5 * np.cos(3.0 * world.angles)
    model = model_of(plan, world.solver, world.readings())
    fit = fit_model(model, np.ones(len(model.observed), dtype=bool), model.std, model.first)
    assert fit.value[60:72] == pytest.approx(-world.motions[5], abs=5e-9)
    assert fit.value[72:76] == pytest.approx(world.axis, abs=5e-9)
    assert (world.angles[1:] < 0.0).all()


def _ends(model):
    return np.cumsum([len(rows) for rows in model.further.values()])[:-1]


def _about(point, turn):
    return shifted(point) @ turned(*turn) @ shifted(-np.asarray(point))


def _line(axis):
    return shifted((*axis[:2], 0.0)) @ turned(*axis[2:], 0.0)


@pytest.mark.slow
@pytest.mark.parametrize("balls", [ONE, THREE])
def test_intervals_of_both_lines_hold_the_truth(balls):
    rng, inside, runs = np.random.default_rng(20), [], 1000 if LONG else 300
    for _ in range(runs):
        world = World.drawn(planned("AC", balls), rng, AS_DRAWN)
        fit, first, _ = solved(world, world.readings(SIGMA, rng))
        std = np.linalg.norm(fit.response, axis=1)[first : first + 8]
        away = fit.value[first : first + 8] - [*world.axis, *world.line]
        inside.append(np.abs(away) < 1.96 * std)
    found = np.mean(inside, axis=0)
    assert (found > binom.ppf(1e-4, runs, 0.95) / runs).all(), found
    assert (found < binom.isf(1e-4, runs, 0.95) / runs).all(), found


def setup(*more):
    return changed(
        read_configuration(CONFIG),
        (
            f"plan.balls_m={[*ONE]}", "plan.axis_m=[0.0, 0.0, 0.06]", "plan.measure=centre",
            "plan.chain=AC", f"plan.tilts_deg={[*TILTS]}", f"plan.tilting_axis_m={[*POINT]}",
            "plan.table_step_deg=45.0", "plan.table_positions=8", "plan.runs=1",
            *more,
        ),
    )  # fmt: skip


def table_of(path, head, rows):
    lines = [head, *(",".join(f"{cell:.13g}" for cell in row) for row in rows)]
    path.write_text("\n".join(lines) + "\n")
    return path


def test_a_table_with_tilts_gives_both_axes_for_people_and_controls(tmp_path):
    world = World(planned("AC", ONE))
    read = world.readings(SIGMA, np.random.default_rng(1))
    rows = zip(read.position, read.target, read.station, *read.points.T, strict=True)
    path = table_of(tmp_path / "tilted.csv", "position,ball,tilt,x_m,y_m,z_m", rows)
    result = read_measurements(path, setup()).solve()
    assert result.verdict == "ok", result.warnings
    for found, true in zip(result.axes, (world.axis, world.line), strict=True):
        assert np.abs((found.value - true) / found.std).max() < 3.5
    assert result.axes[1].names == LINES["AC"]
    tilting = result.axes[1]
    assert tilting.letter == "A"
    assert [axis.sense for axis in result.axes] == [1, 1]
    assert tilting.point[1:] == pytest.approx(np.array(POINT[1:]) + world.line[:2], abs=5e-6)
    figures = setup().method.figures(result, None)
    assert [figure.title for figure in figures].count("Axis average line") == 2
    names = [each.name for each in setup().method.tables(result)]
    assert names[:2] == ["axis", "tilting_axis"]
    assert {"XOC_by_tilt", "ECC_by_tilt", "EXA", "EAA"} <= set(names)


def test_a_result_says_which_way_its_axes_turn(tmp_path):
    read = World(planned("A-C", ONE)).readings(SIGMA, np.random.default_rng(1))
    rows = zip(read.position, read.target, read.station, *read.points.T, strict=True)
    path = table_of(tmp_path / "tilted.csv", "position,ball,tilt,x_m,y_m,z_m", rows)
    result = read_measurements(path, setup("plan.chain=A-C")).solve()
    told = Result.from_dict(result.to_dict()).axes
    assert [(axis.letter, axis.sense) for axis in told] == [("C", -1), ("A", 1)]


def test_the_simulated_axis_is_found_where_it_stands():
    """Its line and that of the table, of the demonstration with three tilts."""
    tilts = [-60.0, 0.0, 50.0]
    configuration = changed(
        read_configuration(CONFIG.with_name("table_balls_demo.yaml")),
        (
            "plan.chain=AC", f"plan.tilts_deg={tilts}", f"simulation.balls.tilts_deg={tilts}",
            "plan.runs=1",
        ),
    )  # fmt: skip
    calibration = prepare_to_measure(configuration)
    seen = [o for event in simulated_run(calibration) for o in event.observed if o.accepted]
    assert len(seen) == 39
    result = calibration.solve(seen)
    assert result.verdict == "ok", result.warnings
    lean = np.array(configuration.simulation.balls.tilting_lean_arcsec[1:]) * ARCSEC
    found = result.axes[1]
    away = found.value - [6e-5, -4e-5, *lean]
    assert np.abs(away / found.std).max() < 3.5
    axis = result.axes[0]
    line = [4.2e-5 - 0.08 * 6.0 * ARCSEC, -2.8e-5 - 0.08 * 9.0 * ARCSEC, 9 * ARCSEC, -6 * ARCSEC]
    assert np.abs((axis.value - line) / axis.std).max() < 3.5


def test_displacements_count_from_where_a_perfect_machine_has_the_ball(tmp_path):
    world = World(planned("AC", ONE))
    ideal = World(planned("AC", ONE), axis=(0.0,) * 4, line=(0.0,) * 4)
    read, off = world.readings(), world.readings().points - ideal.readings().points
    rows = zip(read.position, read.target, read.station, *off.T, strict=True)
    path = table_of(tmp_path / "tilted.csv", "position,ball,tilt,dx_m,dy_m,dz_m", rows)
    result = read_measurements(path, setup()).solve()
    assert result.axes[0].value == pytest.approx(world.axis, abs=1e-9)
    assert result.axes[1].value == pytest.approx(world.line, abs=1e-9)


def test_a_person_brings_the_axis_to_each_tilt():
    plan = prepare_to_measure(setup()).plan
    assert [pause.instruction for pause in plan.pauses] == [
        "turn A to -60 deg", "turn A to 0 deg", "turn A to 50 deg", "turn A to 90 deg"
    ]  # fmt: skip
    world = World(planned("AC", ONE), axis=(0.0,) * 4, line=(0.0,) * 4)
    places = [step.position for step in plan.steps]
    assert len(places) == len(TILTS) * 9
    whole = np.array(places).reshape(len(TILTS), 9, 3)
    assert whole[:, :8].reshape(-1, 3) == pytest.approx(world.readings().points[:32], abs=1e-12)
    assert whole[:, 8] == pytest.approx(whole[:, 0], abs=1e-12)


def test_what_does_not_fit_is_refused(tmp_path):
    def refused(error, words, *more):
        with pytest.raises(error, match=words):
            prepare_to_measure(setup(*more))

    refused(ConfigurationError, "no axis of the chain C tilts the table", "plan.chain=C")
    refused(ConfigurationError, "1 tilts do not determine where A stands", "plan.tilts_deg=[5.0]")
    refused(
        ConfigurationError, "150 deg is beyond plan.tilt_limits_deg", "plan.tilts_deg=[0, 150]"
    )
    refused(
        PlanError,
        "with 2 table angles the observations cannot separate AOC, BOC",
        "plan.table_positions=2",
    )
    flat = table_of(tmp_path / "flat.csv", "position,ball,x_m,y_m,z_m", [(0, 0, 0.1, 0.0, 0.0)])
    with pytest.raises(DataError, match="has no column of tilts"):
        read_measurements(flat, setup()).solve()
    assert prepare(setup()).plan.steps[-1].station == 3
