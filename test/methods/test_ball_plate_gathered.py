"""Disturbances of several balls at one position: found, left out, named, or inside U."""

from dataclasses import replace

import numpy as np
import pytest
from chances import LONG
from coded import coded
from plate_data import simulated
from plate_disturbed import EIGHT, NOISE
from plate_disturbed import at_one_place as world

from rotcal_ros.adjust.engine import RIVALLED
from rotcal_ros.adjust.gathering import AS_WELL
from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.methods.ball_plate.solver import solve
from rotcal_ros.methods.ball_plate.solver.layout import PlateLayout
from rotcal_ros.methods.ball_plate.solver.problem import BallPlateProblem


def worst(result, truth):
    return max(
        np.max(np.abs(result.deviations[n] - truth.component(n)) / result.std[n])
        for n in COMPONENTS
    )


def gone(result, problem):
    rows = [r.index for r in result.rejected]
    at = np.isin(problem.rows, rows)
    return set(zip(problem.position[at].tolist(), problem.ball_step[at].tolist(), strict=True))


@pytest.mark.slow
@pytest.mark.parametrize("stated", [True, False])
@pytest.mark.parametrize("which", [(3, 7), (0, 12, 27)])
@pytest.mark.parametrize("size", [1e-6, 5e-6])
def test_a_minority_at_one_position_is_left_out_and_named(which, size, stated):
    for seed in range(3 if LONG else 1):
        problem, truth = world(seed, which, size, stated=stated)
        result = solve(problem)
        assert result.verdict == "suspect"
        assert worst(result, truth) < 4.5
        assert any("table position 11" in w for w in result.warnings), result.warnings
        assert {(11, b) for b in which} == gone(result, problem)


@pytest.mark.slow
def test_no_good_ball_is_rejected_for_two_that_are_probably_displaced():
    """Not proved, for the noise is estimated: ball 3, a good one beside them, fits worst."""
    problem, truth = world(24, (31, 0), 5e-7, at=20, stated=False)
    result = solve(problem)
    assert result.verdict == "suspect"
    assert (20, 3) not in gone(result, problem)
    assert any("table position 20" in w for w in result.warnings), result.warnings
    assert worst(result, truth) < 4.5


def test_half_of_a_position_against_the_other_is_ambiguous_and_inside_u():
    for seed in range(4 if LONG else 2):
        problem, truth = world(seed, (0, 7, 18, 27), 1e-6)
        result = solve(problem)
        assert result.verdict == "suspect"
        assert worst(result, truth) < 4.5
        assert {AS_WELL, RIVALLED} & coded(*result.warnings).keys()


@pytest.mark.slow
def test_a_half_that_is_far_off_together_is_inside_u_whatever_noise_prefers():
    """Which half of a position is off cannot be seen, however far."""
    for seed in range(100, 112 if LONG else 104):
        which = np.random.default_rng(seed).choice(EIGHT, 4, replace=False)
        problem, truth = world(seed, which, 3e-6)
        result = solve(problem)
        assert result.verdict == "suspect"
        assert worst(result, truth) < 4.5, seed


@pytest.mark.parametrize("column", ["position", "cmm"])
def test_small_ones_are_seldom_ok_and_wrong(column):
    """The figure for 100 worlds of each size is in docs/evidence.md."""
    missed = 0
    for seed in range(12 if LONG else 3):
        problem, truth = world(seed, (18, 22), 5e-7, column=column)
        result = solve(problem)
        missed += result.verdict == "ok" and worst(result, truth) > 4.5
    assert missed <= 1


def test_sound_plates_stay_ok_and_mostly_keep_their_uncertainty():
    grown = []
    for seed in range(25 if LONG else 8):
        problem, _ = world(seed)
        result = solve(problem)
        assert result.verdict == "ok", result.warnings
        assert not result.rejected
        unit = PlateLayout(problem).unit_std()
        grown += [np.mean(result.std[n] / (NOISE * unit[n])) for n in COMPONENTS]
    assert np.median(grown) == pytest.approx(1.0, abs=1e-9)
    assert np.mean(grown) < 1.02


def test_many_single_rejections_at_one_position_are_no_single_ones():
    problem, _ = world(3)
    centres = problem.centres.copy()
    here = np.flatnonzero(problem.position == 20)[[1, 5]]
    centres[here] += [[4e-6, 0.0, 0.0], [0.0, -7e-6, 2e-6]]
    spoilt = BallPlateProblem(
        problem.grid,
        problem.radius,
        problem.position,
        problem.ball_step,
        centres,
        sigma=NOISE,
        row=problem.rows,
    )
    result = solve(spoilt)
    assert gone(result, spoilt) == {(20, int(spoilt.ball_step[r])) for r in here}
    assert result.verdict == "suspect"
    rejected = {g["name"]: g["rejected"] for g in result.details["gathering"]["groups"]}
    assert rejected["table position 20"] == 2
    assert sum(rejected.values()) == 6


def test_the_table_of_groups_holds_every_position_and_ball():
    problem, _ = world(4, (3, 7), 1e-6)
    (blamed,) = solve(problem).details["gathering"]["blamed"]
    assert (blamed["name"], blamed["observations"]) == ("table position 11", 2)
    groups = {g["name"]: g for g in solve(problem).details["gathering"]["groups"]}
    assert len(groups) == 36 + 8 + 36
    assert (
        groups["table position 11"]["observations"],
        groups["ball step 3"]["observations"],
    ) == (8, 36)
    assert (groups["table position 11"]["rejected"], groups["ball step 3"]["rejected"]) == (2, 1)
    for group in groups.values():
        assert 0.0 < group["redundancy"] < 1.0
        assert group["probability"] > 1e-5


def test_groups_of_a_plate_in_two_parts_have_the_numbers_of_the_whole():
    problem, _ = simulated(24, [1, 3, 9, 11, 17, 21], sigma=5e-8)
    groups = solve(replace(problem, separate_groups=True)).details["gathering"]["groups"]
    assert {g["name"] for g in groups if "table" in g["name"]} == {
        f"table position {k}" for k in range(24)
    }
    assert {g["name"] for g in groups if "ball" in g["name"]} == {
        f"ball step {k}" for k in problem.balls
    }
    assert {g["name"] for g in groups if "CMM" in g["name"]} == {
        f"CMM position {k}" for k in range(24)
    }


def test_of_a_plate_too_large_to_be_judged_the_rejected_centres_are_counted():
    problem, _ = simulated(140, [0, 11, 25, 58, 93, 120], sigma=5e-8)
    centres, here = problem.centres.copy(), np.flatnonzero(problem.position == 70)
    centres[here[[1, 4]]] += [[4e-6, 0.0, 0.0], [0.0, -7e-6, 2e-6]]
    result = solve(replace(problem, centres=centres))
    groups = {g["name"]: g for g in result.details["gathering"]["groups"]}
    assert len(groups) == 140 + 140
    assert groups["table position 70"]["rejected"] == 2
    assert result.verdict == "suspect"
