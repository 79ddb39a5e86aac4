"""What spoils one of several instruments is named: which one, what, from when on, how large."""

import re
from dataclasses import replace

import numpy as np
import pytest
from carried_tracer import LENGTH_STD, TARGETS, tracer_problem
from chances import LONG, most, share
from joint_world import balls, drawn, instrument, polygon, truth
from mirror_cell import measure, ring_cell
from test_joint_methods import ROUGH, plate_of, tracer_of
from two_groups import ALTERNATING, ANGLES, GRID, RADIUS, plate_problem, turned

from rotcal_ros.evaluation.joint import JointInput, solve_together
from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.foundation.units import ARCSEC, MICROMETRE
from rotcal_ros.methods.plane_mirror import solver as plane_mirror

PLACE = np.array([0.2, -0.05, 0.12])
AROUND = np.array([0.05, 0.2, 0.0]) / np.hypot(0.05, 0.2)
SIXTEEN = 2.0 * np.pi * np.arange(16) / 16


def rough_polygon(seed):
    random = np.random.default_rng(seed)
    return instrument("polygon", polygon(ALTERNATING, random, noise=ROUGH))


def only_effect(found):
    """The one effect that was found, its sizes that are shown, their standard uncertainties."""
    (effect,) = found.details["effects_found"]
    assert found.verdict == "suspect"
    assert any(effect["what"] in words for words in found.warnings)
    size, std = np.array(effect["size"]), np.array(effect["std"])
    shown = std > 1e-6 * std.max()
    return effect["what"], size[shown], std[shown]


def is_right(found, ecc=ALTERNATING):
    error = found.deviations["ECC"] - (ecc - ecc.mean())
    return np.abs(error).max() < 4.0 * found.std["ECC"].max()


def spoiled_lengths(seed, by):
    """A tracer whose lengths are longer by what ``by`` makes of its problem; with readings."""
    problem = tracer_problem(seed)
    spoiled = replace(problem, length=problem.length + by(problem))
    return solve_together([tracer_of(spoiled), rough_polygon(seed)]).result


def knocked(problem):
    """The tracer is pushed by 5 um around the axis before the sixth angle."""
    carried = turned(problem.table_angles[problem.position], np.tile(PLACE, (216, 1)))
    pushed = turned(
        problem.table_angles[problem.position], np.tile(PLACE + 5e-6 * AROUND, (216, 1))
    )
    there = problem.targets[problem.target]
    change = np.linalg.norm(pushed - there, axis=1) - np.linalg.norm(carried - there, axis=1)
    return np.where(problem.position >= 5, change, 0.0)


@pytest.mark.parametrize(
    ("by", "what", "size"),
    [
        (
            lambda p: 4e-6 * (p.position == 4) * (p.target / (len(TARGETS) - 1) - 0.5),
            "lengths drift from station 4, target 0 of tracer to station 4, target 17 of tracer",
            4e-6,
        ),
        (
            lambda p: 2e-6 * ((p.position == 4) & (p.target >= 9)),
            "the tracer moved on the table from station 4, target 9 of tracer on",
            2e-6,
        ),
    ],
)
def test_what_happens_to_lengths_is_named_beside_readings(by, what, size):
    found = spoiled_lengths(7, by)
    named, sizes, std = only_effect(found)
    assert named.startswith(f"in tracer {what}")
    assert np.abs(sizes[0]) == pytest.approx(size, abs=4.0 * std[0])
    assert std[0] < 0.25 * size
    assert is_right(found)


def test_a_tracer_that_was_pushed_along_its_circle_is_covered_beside_readings():
    found = spoiled_lengths(7, knocked)
    assert found.verdict == "suspect"
    assert is_right(found)


def test_a_wrong_scale_is_named_or_what_looks_like_it():
    found = spoiled_lengths(7, lambda p: 2e-5 * np.linalg.norm(p.targets[p.target], axis=1))
    assert any("the scale of the lengths is wrong" in words for words in found.warnings)
    assert is_right(found)


def plate_with(seed, turn=0.0, since=0, drift=0.0):
    """A plate that turned before row ``since``, or a CMM whose origin drifts along x."""
    problem = plate_problem(range(GRID), noise=2e-7, sigma=2e-7, seed=seed)
    centres = turned(turn * (problem.rows >= since), problem.centres)
    centres[:, 0] += drift * problem.run_time
    return plate_of(replace(problem, centres=centres))


def test_a_plate_that_turned_between_two_positions_is_named_beside_readings():
    """Alone, it cannot be told from a table that turned."""
    plate = plate_with(3, turn=3.0 * ARCSEC, since=60)
    assert plate.result.verdict == "ok"
    found = solve_together([plate, rough_polygon(7)]).result
    named, sizes, std = only_effect(found)
    assert named.startswith("in plate the plate moved on the table from row 60 ")
    assert sizes == pytest.approx([3.0 * ARCSEC * RADIUS], abs=4.0 * std[0])
    assert is_right(found)


def test_a_plate_that_turned_among_the_balls_of_a_position_is_named():
    found = solve_together([plate_with(3, turn=ARCSEC, since=66), rough_polygon(7)]).result
    named, sizes, std = only_effect(found)
    assert named.startswith("in plate the plate moved on the table from row 6")
    assert sizes == pytest.approx([ARCSEC * RADIUS], abs=4.0 * std[0])
    assert is_right(found)


def test_a_machine_that_drifts_under_a_plate_is_named():
    """Along z it drifts unseen: that looks like EZC and the balls of the plate."""
    found = solve_together([plate_with(3, drift=6.0 * MICROMETRE), rough_polygon(7)]).result
    named, sizes, std = only_effect(found)
    assert named == "in plate the origin of the CMM drifts"
    assert sizes == pytest.approx([6e-6, 0.0], abs=4.0 * std.max())
    (words,) = (words for words in found.warnings if named in words)
    assert words.count("±") == 2
    assert is_right(found)


def mirror_with(seed, *, turn=0.0, tracker=0.0):
    """A mirror that turned before position 10, or a tracker that turned half-way at station 2."""
    rng = np.random.default_rng(seed)
    visits = (*(tuple(range(s, s + 4)) for s in range(0, 12, 3)), (12, 13, 14, 15))
    deviations = np.zeros((16, 6))
    deviations[:, 3:] = ARCSEC * rng.standard_normal((16, 3)) * [1.0, 1.0, 2.0]
    ecc = deviations[:, 5].copy()
    deviations[10:, 5] += turn
    problem = measure(ring_cell(SIXTEEN, visits, 6, 2), deviations, rng=rng, way="joint")
    own = np.flatnonzero(problem.station == 2)
    later = own[len(own) // 2 :]
    xyz = problem.xyz.copy()
    xyz[later] = turned(np.full(len(later), tracker), xyz[later])
    problem = replace(problem, xyz=xyz)
    mirror = JointInput("mirror", plane_mirror.solve(problem), plane_mirror.curves(problem)[0])
    return [mirror, tracer_of(tracer_problem(seed, ecc, SIXTEEN))], ecc


@pytest.mark.parametrize(
    ("sizes", "what", "size"),
    [
        ({"turn": 10.0 * ARCSEC}, "the mirror turned on the table", 10.0),
        ({"tracker": 10.0 * ARCSEC}, "the tracker turned", 10.0),
    ],
)
def test_what_happens_to_a_mirror_is_named_beside_lengths(sizes, what, size):
    instruments, ecc = mirror_with(4, **sizes)
    found = solve_together(instruments).result
    assert found.verdict == "suspect"
    first = found.details["effects_found"][0]
    assert first["what"].startswith(f"in mirror {what} from ")
    assert first["size"] == pytest.approx([size * ARCSEC], abs=4.0 * first["std"][0])
    assert is_right(found, ecc)


def sound(seed):
    """Two balls, a plate and lengths of one table, and its deviations in all six."""
    rng = np.random.default_rng([seed, 5])
    world = drawn(rng)
    (about_x, about_y), ecc = world.motions[3:5], world.motions[5]
    problem = plate_problem(
        range(GRID), ecc, world.motions[:3].T, noise=2e-7, sigma=2e-7, seed=seed
    )
    centres = problem.centres.copy()
    x, y = centres[:, 0], centres[:, 1]
    centres[:, 2] += about_x[problem.position] * y - about_y[problem.position] * x
    plate, lengths = (
        plate_of(replace(problem, centres=centres)),
        tracer_of(tracer_problem(seed, ecc)),
    )
    return [instrument("balls", balls(world, rng)), plate, lengths], truth(world)


@pytest.mark.slow
def test_sound_worlds_alarm_no_more_often_than_limits_allow():
    """And the intervals of balls, plate and lengths together hold the truth."""
    runs, named, doubted, inside = 200 if LONG else 6, 0, 0, []
    for seed in range(runs):
        instruments, true = sound(seed)
        found = solve_together(instruments).result
        named += bool(found.details["effects_found"])
        doubted += found.verdict != "ok"
        errors = {c: found.deviations[c] - true[c] for c in COMPONENTS}
        inside += [np.abs(error) < 1.96 * found.std[c] for c, error in errors.items()]
    assert named <= most(0.01, runs)
    assert doubted <= most(0.2, runs)
    low, high = share(0.95, runs)
    assert low < np.mean(inside) < high


def four(seed, *, lengths=0.0, scale=0.0, mirror=0.0):
    """Balls, plate, mirror and lengths of one table, and its ECC.

    ``lengths``: noise of lengths beside what is stated, in units of it; ``scale``: by how much
    they are too long; ``mirror``: what the mirror sees more, rad in order 2.
    """
    rng = np.random.default_rng([seed, 6])
    world = drawn(rng)
    world.motions[3:5] = 0.0
    shift, ecc = world.motions[:3].T, world.motions[5]
    plate = plate_problem(range(GRID), ecc, shift, noise=2e-7, sigma=2e-7, seed=seed)
    deviations = np.zeros((GRID, 6))
    deviations[:, 5] = ecc + mirror * np.cos(2.0 * ANGLES)
    visits = (*(tuple(range(s, s + 4)) for s in range(0, 9, 3)), (9, 10, 11))
    seen = measure(ring_cell(ANGLES, visits, 6, 2), deviations, rng=rng, way="joint")
    problem = tracer_problem(seed, ecc)
    read = problem.length + lengths * LENGTH_STD * rng.standard_normal(problem.length.shape)
    read = read + scale * np.linalg.norm(problem.targets[problem.target], axis=1)
    return [
        instrument("balls", balls(world, rng)),
        plate_of(plate),
        JointInput("mirror", plane_mirror.solve(seen), plane_mirror.curves(seen)[0]),
        tracer_of(replace(problem, length=read)),
    ], ecc - ecc.mean()


@pytest.mark.slow
def test_of_four_instruments_the_one_that_scatters_is_named_and_weighed():
    instruments, ecc = four(1, lengths=np.sqrt(8.0))
    noisy, sound = solve_together(instruments), solve_together(four(1)[0])
    found, noise = noisy.result, noisy.result.details["noise"]
    assert max(noise, key=noise.__getitem__) == "the lengths of tracer"
    assert noise["the lengths of tracer"] == pytest.approx(3.0, rel=0.2)
    together, alone = found.warnings
    assert together.startswith("the scatter of the lengths of tracer is 3 times the stated value")
    factor = re.fullmatch(
        r"tracer is suspect \(the scatter of the lengths is (.*) times the stated value.*", alone
    )
    assert float(factor[1]) == pytest.approx(3.0, rel=0.2)
    assert found.verdict == "suspect"
    assert is_right(found, ecc)
    # so much they count
    share, usual = (each.groups[-1].weights["tracer"] for each in (noisy, sound))
    assert share < 0.5 * usual


@pytest.mark.slow
def test_of_four_instruments_the_one_of_wrong_scale_is_named():
    instruments, ecc = four(2, scale=3e-5)
    found = solve_together(instruments).result
    named, sizes, std = only_effect(found)
    assert named == "in tracer the scale of the lengths is wrong"
    assert sizes == pytest.approx([3e-5], abs=4.0 * std[0])
    assert is_right(found, ecc)


@pytest.mark.slow
def test_of_four_instruments_the_one_that_sees_another_table_is_named():
    instruments, ecc = four(3, mirror=4.0 * ARCSEC)
    found = solve_together(instruments).result
    named, sizes, std = only_effect(found)
    assert named == "order 2 of ECC (cosine, sine) is another for mirror than for the others"
    assert sizes == pytest.approx([4.0 * ARCSEC, 0.0], abs=4.0 * std.max())
    assert is_right(found, ecc)


@pytest.mark.slow
def test_four_sound_instruments_agree():
    instruments, ecc = four(4)
    together = solve_together(instruments)
    assert together.result.verdict == "ok"
    (of_ecc,) = (group for group in together.groups if "ECC" in group.joined)
    assert of_ecc.consistent
    assert of_ecc.dof >= 3 * (GRID - 1)
    assert is_right(together.result, ecc)
