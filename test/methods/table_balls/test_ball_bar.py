"""A ball bar between spindle and table: one length where a touched ball has three coordinates."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from ball_world import AS_DRAWN, NAMES, ONE, THREE, World
from chances import LONG
from scipy.stats import binom

from rotcal_ros.adjust.engine import adjust
from rotcal_ros.adjust.fit import fit_model
from rotcal_ros.foundation.errors import ConfigurationError, DataError, PlanError
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.methods import changed, prepare, prepare_to_measure, read_configuration
from rotcal_ros.methods.measurements import read_measurements
from rotcal_ros.methods.simulated_run import simulated_run
from rotcal_ros.methods.table_balls.model import BallsOnTable, components_of, model_of
from rotcal_ros.methods.table_balls.settings import BallsPlanSettings, BallsSolverSettings

CONFIG = Path(__file__).parents[3] / "config"
SIGMA = 1e-6
RADIAL, TANGENTIAL, AXIAL = (0.1, 0.0, 0.0), (0.0, 0.1, 0.0), (0.0, 0.0, 0.1)
FLAT = (*ONE, -0.1, 0.08, 0.06, -0.02, -0.13, 0.06)
SLANTED = (0.06, 0.05, 0.07)
SURE = BallsSolverSettings(scale_std_um_per_m=1e-3, squareness_std_um_per_m=1e-3, bar_std_m=1e-9)


def planned(balls=ONE, bars=(*RADIAL, *TANGENTIAL, *AXIAL), **more):
    return BallsPlanSettings(
        balls_m=balls, axis_m=(0.0, 0.0, 0.06), measure="bar", bars_m=bars, **more
    )


def solved(world, read=None):
    model = model_of(world.plan, world.solver, world.readings() if read is None else read)
    return fit_model(model, np.ones(len(model.observed), dtype=bool), model.std, model.first)


@pytest.mark.parametrize(("balls", "chain"), [(ONE, "C"), (THREE, "C"), (THREE, "AC")])
def test_three_lengths_of_a_ball_are_its_three_coordinates(balls, chain):
    """Turned into the axes of the set-ups a centre with equal noise is a centre: same numbers."""
    more = {"chain": chain, "tilts_deg": (-60.0, 0.0, 50.0) if chain == "AC" else ()}
    plan = planned(balls, runs=1, closing=False, **more)
    world = World.drawn(plan, np.random.default_rng(5), SURE, placing=0.0)
    centres = replace(world, plan=replace(plan, measure="centre"))
    a, b = solved(world), solved(centres)
    count = len(a.model.outputs)
    std = np.linalg.norm(b.response, axis=1)[:count]
    assert np.linalg.norm(a.response, axis=1)[:count] == pytest.approx(std, rel=2e-3)
    assert np.abs((a.value - b.value)[:count] / std).max() < 0.02


@pytest.mark.parametrize(
    ("name", "bar", "share"), [("EXC", 0, 0.14), ("EXC", 1, -0.03), ("EZC", 2, 1.0)]
)
def test_a_ball_that_moves_towards_the_spindle_shortens_its_bar(name, bar, share):
    """EXC at angle 0 goes outward by the cosine of where the ball is, and back along its way."""
    still, moved = (World(planned(), axis=(0.0,) * 4) for _ in range(2))
    moved.motions[NAMES.index(name), 0] = 4e-6
    read = still.readings()
    change, first = moved.readings().value - read.value, read.position == 0
    share = share if name == "EZC" else share / np.hypot(*ONE[:2])
    assert change[first & (read.target == bar)] == pytest.approx(-4e-6 * share, rel=1e-3)
    assert change[~first] == pytest.approx(0.0, abs=1e-15)
    balls = BallsOnTable.of(still.plan, still.solver, read)
    x = balls.started(read.points)
    x[balls.first[name]] = 4e-6
    assert balls(x)[0] == pytest.approx(moved.readings().value, abs=1e-14)


def test_derivatives_of_lengths_are_those_of_differences():
    plan = planned(THREE, (*RADIAL, *SLANTED), chain="-B-C", tilts_deg=(-60.0, 0.0, 50.0))
    world = World.drawn(plan, np.random.default_rng(2))
    model = model_of(plan, world.solver, world.readings())
    x = model.first + 1e-4 * np.random.default_rng(3).standard_normal(model.size[1])
    some = slice(None, None, len(x) // 40 + 1)
    step = 1e-6 * np.eye(len(x))[some]
    by_difference = [(model.equations(x + h)[0] - model.equations(x - h)[0]) / 2e-6 for h in step]
    found = model.equations(x)[1].dense().T[some]
    assert found == pytest.approx(np.array(by_difference), abs=1e-8)


@pytest.mark.parametrize(
    ("balls", "bars", "told"),
    [
        (ONE, (*RADIAL, *TANGENTIAL, *AXIAL), ("ECC",)),
        (ONE, TANGENTIAL, ("ECC",)),
        (ONE, SLANTED, ("ECC",)),
        (FLAT, (*RADIAL, *TANGENTIAL, *AXIAL), NAMES),
        (FLAT, (*RADIAL, *TANGENTIAL), ("EXC", "EYC", "ECC")),
        (FLAT, (*RADIAL, *AXIAL), NAMES[:5]),
        (FLAT, AXIAL, ("EZC", "EAC", "EBC")),
    ],
)
def test_what_lengths_tell_follows_from_their_directions(balls, bars, told):
    balls = BallsOnTable.of(planned(balls, bars), BallsSolverSettings())
    assert set(components_of(balls)) == {*told, "ECC"}
    assert ("ECC" in balls.shown) == ("ECC" in told)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("balls", "bars"),
    [
        (ONE, (*RADIAL, *TANGENTIAL, *AXIAL)),
        (ONE, (*SLANTED, *TANGENTIAL, *AXIAL)),
        (THREE, (*RADIAL, *TANGENTIAL, *AXIAL)),
    ],
)
def test_intervals_from_lengths_hold_the_truth(balls, bars):
    """Of worlds drawn from what is stated, the error of the bar and of the axes included."""
    rng, inside, runs = np.random.default_rng(20), [], 1000 if LONG else 300
    for _ in range(runs):
        world = World.drawn(planned(balls, bars), rng, AS_DRAWN)
        fit = solved(world, world.readings(SIGMA, rng))
        std = np.linalg.norm(fit.response, axis=1)[: len(fit.model.outputs)]
        motions, line = world.truth()
        names = components_of(BallsOnTable.of(world.plan, world.solver))
        true = np.append([motions[NAMES.index(c)] for c in names], line)
        inside.append(np.abs(fit.value[: len(std)] - true) < 1.96 * std)
    found = np.mean(inside, axis=0)
    odds = 1e-3 / len(found)
    assert (found > binom.ppf(odds, runs, 0.95) / runs).all(), found
    assert (found < binom.isf(odds, runs, 0.95) / runs).all(), found
    assert 0.93 < found[:-4].mean() < 0.97


def test_a_length_that_was_read_wrongly_is_left_out_and_a_drift_is_found():
    world = World.drawn(planned(runs=3), np.random.default_rng(4))
    read = world.readings(SIGMA, np.random.default_rng(2))
    value = read.value.copy()
    value[50] += 4e-5
    found = adjust(model_of(world.plan, world.solver, replace(read, value=value)))
    assert list(found.why) == [50]
    where = f"position {read.position[50]}, run {read.station[50]}"
    assert f"bar {read.target[50]} at {where}" in found.why[50]
    drift = 2e-5 * np.where(read.target % 3 == 1, np.linspace(-0.5, 0.5, len(value)), 0.0)
    found = adjust(model_of(world.plan, world.solver, replace(read, value=read.value + drift)))
    assert found.verdict == "suspect"
    assert {e.effect.effect for e in found.found_effects} == {"drift"}


def setup(*more):
    return changed(
        read_configuration(CONFIG / "table_balls.yaml"),
        (
            f"plan.balls_m={[*ONE]}", "plan.axis_m=[0.0, 0.0, 0.06]", "plan.measure=bar",
            *more,
        ),
    )  # fmt: skip


def table_of(path, head, rows):
    lines = [head, *(",".join(f"{cell:.13g}" for cell in row) for row in rows)]
    path.write_text("\n".join(lines) + "\n")
    return path


def test_a_table_of_lengths_gives_the_axis_and_says_what_it_does_not_tell(tmp_path):
    world = World.drawn(planned(), np.random.default_rng(2))
    read = world.readings(SIGMA, np.random.default_rng(1))
    rows = zip(read.position, read.target, read.value, strict=True)
    path = table_of(tmp_path / "bar.csv", "position,bar,length_m", rows)
    result = read_measurements(path, setup("plan.measure=centre")).solve()
    assert result.verdict == "ok", result.warnings
    axis = result.axes[0]
    assert np.abs((axis.value - world.truth()[1]) / axis.std).max() < 3.5
    assert result.details["untold"] == ["EXC", "EYC", "EZC", "EAC", "EBC"]
    assert result.n_observations == 75
    assert result.residuals.coordinates == 1
    path = table_of(tmp_path / "mm.csv", "position,bar,length_m", [(0, 0, 0.2)])
    with pytest.raises(DataError, match=r"bar 0 at position 0 is 0\.2 m long, expected 0\.1 m"):
        read_measurements(path, setup()).solve()


def test_the_bar_is_brought_from_set_up_to_set_up():
    plan = prepare_to_measure(setup("plan.runs=1")).plan
    assert [(pause.first, pause.instruction) for pause in plan.pauses] == [
        (0, "bring the ball bar to ball 0, set-up 0 of plan.bars_m"),
        (13, "bring the ball bar to ball 0, set-up 1 of plan.bars_m"),
        (26, "bring the ball bar to ball 0, set-up 2 of plan.bars_m"),
    ]
    quarter = plan.steps[3]  # 90 degrees
    radius = np.hypot(*ONE[:2])
    x, y = ONE[0] * (1 + 0.1 / radius), ONE[1] * (1 + 0.1 / radius)
    assert quarter.position == pytest.approx((-y, x, 0.06), abs=1e-12)
    tilted = setup("plan.chain=AC", "plan.tilts_deg=[0.0, 30.0]", "plan.runs=1")
    texts = [pause.instruction for pause in prepare_to_measure(tilted).plan.pauses]
    assert texts[3] == "turn A to 30 deg; bring the ball bar to ball 0, set-up 0 of plan.bars_m"


def test_lengths_must_come_before_anything_moves_and_no_light_measures_them():
    bar, centre = prepare(setup()), prepare(setup("plan.measure=centre"))
    assert set(bar.topics) - set(centre.topics) == {"tracer_length"}
    assert bar.refraction.describe(()) == ""


def test_set_ups_that_tell_too_little_are_refused():
    with pytest.raises(PlanError, match="no set-up of the ball bar determines ECC"):
        prepare_to_measure(setup("plan.bars_m=[[0.1, 0, 0], [0, 0, 0.1]]"))
    with pytest.raises(PlanError, match="no observation determines AOC, BOC"):
        prepare_to_measure(setup("plan.bars_m=[[0.1, 0, 0], [0, 0.1, 0]]"))
    # what is outward and up in one reading hides a lean of the axis behind its place
    with pytest.raises(PlanError, match="cannot separate"):
        prepare_to_measure(setup("plan.bars_m=[[0.1, 0, 0.1], [0, 0.1, 0]]"))
    with pytest.raises(ConfigurationError, match="state at least one set-up"):
        prepare(setup("plan.bars_m=[]"))


def test_a_simulated_bar_finds_the_axis():
    configuration = changed(
        read_configuration(CONFIG / "table_balls_demo.yaml"),
        ("plan.measure=bar",),
    )
    calibration = prepare_to_measure(configuration)
    seen = [o for event in simulated_run(calibration) for o in event.observed if o.accepted]
    assert len(seen) == 75
    result = calibration.solve(seen)
    assert result.verdict == "ok", result.warnings
    axis = result.axes[0]
    line = [4.2e-5 - 0.08 * 6.0 * ARCSEC, -2.8e-5 - 0.08 * 9.0 * ARCSEC, 9 * ARCSEC, -6 * ARCSEC]
    assert np.abs((axis.value - line) / axis.std).max() < 3.5


def test_a_measurement_that_is_spoiled_on_purpose_is_one_of_lengths():
    """As the power table makes them: noise alone is good, a knock in one set-up is not."""
    calibration = prepare_to_measure(setup())
    measure, plan = calibration.method.disturbances.measure, calibration.plan
    good = measure(calibration.configuration, plan, {}, 3)
    assert {len(o.mean) for o in good.observations} == {1}
    result = calibration.solve(good.observations)
    assert result.verdict == "ok", result.warnings
    assert np.abs((result.deviations["ECC"] - good.truth["ECC"]) / result.std["ECC"]).max() < 4.0
    bad = measure(calibration.configuration, plan, {"knock": 5e-5}, 3)
    assert calibration.solve(bad.observations).verdict != "ok"
