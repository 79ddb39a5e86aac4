"""Mistakes of set-up: found where readings can show them, else named in the verdict."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from ball_world import LEVEL, ONE, THREE, World, in_orders, turned

from rotcal_ros.adjust.alternatives import alternative_doubts
from rotcal_ros.methods import changed, prepare
from rotcal_ros.methods.configuration import parse_configuration
from rotcal_ros.methods.table_balls.method import model
from rotcal_ros.methods.table_balls.set_up import compare_setups

SIGMA = 1e-6
BALLS = {"ONE": ONE, "LEVEL": LEVEL, "THREE": THREE}


def configured(balls, measure, *changes):
    places = np.reshape(BALLS[balls], (-1, 3)).tolist()
    text = (
        f"method: table_balls\nballs_m: {places}\naxis_m: [0.0, 0.0, 0.06]\nmeasure: {measure}\n"
    )
    return changed(parse_configuration(text), changes)


def measured(configuration, seed=5, placing=3e-4):
    """Return what a world reads that really is as the configuration says."""
    rng = np.random.default_rng(seed)
    world = World.drawn(configuration.plan, rng, configuration.solver, placing=placing)
    read = world.readings(SIGMA, rng)
    if configuration.plan.measure != "displacement":
        return read
    turns = [turned(0.0, 0.0, world.angles[k])[:3, :3] for k in read.position]
    sent = [turn @ world.balls[k] for turn, k in zip(turns, read.target, strict=True)]
    points = read.points - np.array(sent) - configuration.plan.axis_m
    return replace(read, points=points, value=points[:, 0])


def solved(configuration, read):
    """Return the result of readings, as those of the steps of a plan."""
    calibration = prepare(configuration)
    steps = {}
    for step in calibration.plan.steps:
        steps.setdefault((step.table_position, step.target, step.station), []).append(step)
    rows = zip(read.position, read.target, read.station, read.points, strict=True)
    observed = []
    for position, target, station, point in rows:
        mine = steps[position, target, station]
        step = mine.pop(0) if len(mine) > 1 else mine[0]
        observed.append(step.observed(tuple(np.ravel(point).tolist())))
    return calibration.solve(observed)


def scaled(read, *factors):
    points = read.points * factors
    return replace(read, points=points, value=points[:, 0])


def mirrored(balls, measure, placing=3e-4):
    """Return readings of a table that turns clockwise, which the set-up does not say."""
    return measured(configured(balls, measure, "plan.chain=-C"), placing=placing)


def exchanged(balls):
    read = measured(configured(balls, "bar"))
    return replace(read, target=read.target // 3 * 3 + np.array([1, 0, 2])[read.target % 3])


def numbered_off(balls, measure):
    read = measured(configured(balls, measure, "plan.closing=false"))
    return replace(read, position=(read.position + 1) % 12)


def treatment(result, effect):
    return next(p.treatment for p in result.protections if p.effect == effect)


NEST, BAR = "displacement", "bar"
UNSEEN = {
    "nest minus ball": ("ONE", NEST, "sign of readings", lambda b: scaled(b, -1.0, -1.0, -1.0)),
    "nest minus three balls": ("THREE", NEST, "sign of readings", lambda b: scaled(b, -1, -1, -1)),
    "dz": ("ONE", NEST, "sign of readings", lambda b: scaled(b, 1.0, 1.0, -1.0)),
    "gain": ("THREE", NEST, "gain", lambda b: scaled(b, 0.98, 0.98, 0.98)),
}


@pytest.mark.parametrize("name", UNSEEN)
def test_what_no_reading_shows_is_named(name):
    balls, measure, effect, spoilt = UNSEEN[name]
    configuration = configured(balls, measure)
    read = measured(configuration)
    for each in (read, spoilt(read)):
        result = solved(configuration, each)
        assert result.verdict == "ok", result.warnings
        assert effect in result.unprotected


@pytest.mark.parametrize("placing", [3e-4, 0.0])
def test_lengths_of_one_ball_show_neither_sense_nor_numbering_nor_which_set_up_it_was(placing):
    """Arrivals of the table are all that its tangential lengths are: anything fits."""
    configuration = configured("ONE", "bar", "plan.closing=false")
    clockwise = configured("ONE", "bar", "plan.chain=-C", "plan.closing=false")
    read = measured(configuration, placing=placing)
    off = replace(read, position=(read.position + 1) % 12)
    for each in (read, measured(clockwise, placing=placing), off):
        result = solved(configuration, each)
        assert result.verdict == "ok", result.warnings
        assert {"sense", "numbering", "sign of readings", "gain"} <= set(result.unprotected)


FOUND = {
    "clockwise, by where the ball is": (
        "ONE", NEST, "sense", lambda: mirrored("ONE", NEST), "C turns the other way",
    ),
    "clockwise, by two balls": (
        "LEVEL", NEST, "sense", lambda: mirrored("LEVEL", NEST, 0.0), "C turns the other way",
    ),
    "dz, by three balls": (
        "THREE", NEST, "sign of readings",
        lambda: scaled(measured(configured("THREE", NEST)), 1.0, 1.0, -1.0),
        "dz counts the other way",
    ),
    "numbered off, by three balls": (
        "THREE", NEST, "numbering", lambda: numbered_off("THREE", NEST),
        "the table stood one position",
    ),
    "clockwise bar, by two balls": (
        "LEVEL", BAR, "sense", lambda: mirrored("LEVEL", BAR), "C turns the other way",
    ),
    "exchanged set-ups, by two balls": (
        "LEVEL", BAR, "numbering", lambda: exchanged("LEVEL"),
        "set-ups 0 and 1 are taken for each other",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", FOUND)
def test_what_readings_show_is_told(name):
    balls, measure, effect, spoilt, words = FOUND[name]
    closing = () if "numbered" not in name else ("plan.closing=false",)
    result = solved(configured(balls, measure, *closing), spoilt())
    assert result.verdict in ("suspect", "failed")
    told = [w for w in result.warnings if w.startswith(f"it looks as if {words}")]
    assert told, result.warnings
    assert told[0].endswith("correct it, and solve again")
    assert treatment(result, effect) == "tested"


@pytest.mark.parametrize("measure", ["centre", NEST, BAR])
def test_sound_readings_of_three_balls_exclude_what_they_can(measure):
    configuration = configured("THREE", measure)
    result = solved(configuration, measured(configuration))
    assert result.verdict == "ok", result.warnings
    assert treatment(result, "sense") == "tested"
    assert ("gain" in result.unprotected) == (measure != "centre")
    never = {"centre": "sign of z", NEST: "numbering"}.get(measure)
    assert never is None or treatment(result, never) == "tested"


def test_centres_near_the_axis_do_not_show_their_numbering():
    """Ten degrees move a ball by 8.7 mm, less than people have to know of its place."""
    text = "method: table_balls\nballs_m: [[0.05, 0.0, 0.06]]\naxis_m: [0.0, 0.0, 0.06]\n"
    fine = ("plan.table_step_deg=10.0", "plan.table_positions=36", "plan.measure=centre")
    configuration = changed(parse_configuration(text), fine)
    result = solved(configuration, measured(configuration))
    assert "numbering" in result.unprotected
    assert treatment(result, "sense") == "tested"


@pytest.mark.parametrize("seed", [6, 8, 9, 10])
def test_motions_of_one_order_are_no_sign_of_exchanged_set_ups(seed):
    """By chance large in one set-up and small in another: two numbers, not 24 of each."""
    fine = ("plan.table_step_deg=15.0", "plan.table_positions=24", "plan.closing=false")
    configuration = configured("ONE", BAR, *fine)
    rng = np.random.default_rng(seed)
    world = World.drawn(configuration.plan, rng, configuration.solver)
    world.move(rng, (2,), (2,), (2,))
    world.motions[5] = 1e-5 * in_orders((2,), world.angles, rng)
    every = compare_setups(
        configuration, world.readings(SIGMA, rng), (), partial(model, whole=True)
    )
    assert not list(alternative_doubts(every))


def test_a_small_share_of_the_angles_is_compared():
    """360 angles cost no more than 24: the models of the comparison are of these alone."""
    configuration = configured("ONE", NEST, "plan.table_step_deg=1.0", "plan.table_positions=360")
    read, sizes = measured(configuration), []

    def counted(*args):
        found = model(*args, whole=True)
        sizes.append(len(found.observed))
        return found

    every = compare_setups(configuration, read, (), counted)
    assert max(sizes) < 1000
    assert len(every) == len(sizes) - 1
