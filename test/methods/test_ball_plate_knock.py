"""A knock of the plate and a single bad centre: each is called what it is."""

import re
from dataclasses import replace

import numpy as np
import pytest
from chances import LONG
from exact_plate import ExactPlate, about_z

from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.methods.ball_plate.solver import solve

SIGMA = 5e-8
NEAR = 8
"""Rows by which the moment may be off: it is looked for at 40 of 288."""
GRID = 24
BALLS = [0, 1, 3, 4, 7, 9, 12, 14, 15, 18, 20, 22]


PLATE = ExactPlate(GRID, BALLS, table=2e-6, machine=2e-6, made=1e-5, seed=1)


@pytest.fixture(scope="module")
def exact():
    return PLATE.problem()


def numbered(problem, order):
    """Rows numbered table position by table position, or CMM position by CMM position."""
    first = problem.position if order == "table_once" else problem.cmm_index
    rank = np.argsort(np.lexsort((problem.ball_step, first)))
    return replace(problem, row=rank)


def worst(result):
    """Largest error of a deviation, in stated standard deviations."""
    return max(
        np.abs((result.deviations[name] - PLATE.true(name)) / result.std[name]).max()
        for name in COMPONENTS
    )


def noisy(problem, rng):
    return problem.centres + SIGMA * rng.normal(size=problem.centres.shape)


@pytest.mark.slow
@pytest.mark.parametrize("order", ["table_once", "probe_rests"])
@pytest.mark.parametrize("size", [1e-6, 5e-5])
def test_one_bad_centre_is_never_called_a_knock(exact, order, size):
    problem = numbered(exact, order)
    rng = np.random.default_rng(3)
    for row in range(int(size > 1e-5), len(problem.centres), 11 if LONG else 71):
        centres = noisy(problem, rng)
        away = rng.normal(size=3)
        centres[row] += size * away / np.linalg.norm(away)
        result = solve(replace(problem, centres=centres))
        assert int(problem.rows[row]) in {r.index for r in result.rejected}
        if order == "table_once" and problem.rows[row] % len(BALLS) == len(BALLS) - 1:
            continue  # a knock before it does the same: see below
        assert not any("moved" in text for text in result.warnings), problem.row_name(row)


def test_the_last_centre_of_a_position_that_is_off_may_be_a_knock_before_it(exact):
    """No residual is another: later positions move as a whole, which is the table's to do.

    The knock moves the last centre, three of its six sizes, and all later positions, whose own
    six deviations take that up. So both are named, the one centre first, for moments are as many
    as centres. U covers either, what no residual shows of a knock being held to be as large as
    what does.
    """
    problem, rng = numbered(exact, "table_once"), np.random.default_rng(3)
    last = problem.rows == 263
    for size in (1e-6, 5e-5):
        centres = noisy(problem, rng)
        centres[last] += size * np.array([0.6, -0.64, 0.48])
        result = solve(replace(problem, centres=centres))
        assert result.verdict == "suspect"
        assert [r.index for r in result.rejected] == [263]
        (text,) = (text for text in result.warnings if "nearly as well" in text)
        assert "that the plate moved on the table from row 263" in text
        assert "(1 : 3)" in text
        assert worst(result) < 2.5
    for seed in range(8 if LONG else 2):
        shift, turn = np.random.default_rng(seed).normal(size=(2, 3))
        result = solve(knocked(problem, 263, rng, 3e-5 * shift, 1.6e-4 * turn))
        assert result.verdict == "suspect"
        assert any("the plate moved on the table from row 263" in t for t in result.warnings)
        assert worst(result) < 5.0


@pytest.mark.slow
def test_two_bad_centres_at_one_table_position_are_no_knock(exact):
    problem = numbered(exact, "table_once")
    rng = np.random.default_rng(4)
    for position in range(0, GRID, 2 if LONG else 9):
        centres = noisy(problem, rng)
        there = np.flatnonzero(problem.position == position)[[4, 7]]
        centres[there] += 2e-6 * rng.normal(size=(2, 3))
        result = solve(replace(problem, centres=centres))
        assert not any("looks as if the plate moved" in text for text in result.warnings)


def knocked(problem, moment, rng, shift, turn):
    """All rows from ``moment`` on, after the plate moved on the table."""
    centres = noisy(problem, rng)
    for r in np.flatnonzero(problem.rows >= moment):
        table = about_z(2 * np.pi * problem.position[r] / GRID)
        on_table = table.T @ problem.centres[r]
        centres[r] += table @ (np.cross(turn, on_table) + shift)
    return replace(problem, centres=centres)


def found(exact, order, moments, size):
    problem, rng, count = numbered(exact, order), np.random.default_rng(5), 0
    for moment in moments:
        shift, turn = rng.normal(size=(2, 3))
        shift *= size / np.linalg.norm(shift)
        turn *= size / 0.185 / np.linalg.norm(turn)
        result = solve(knocked(problem, moment, rng, shift, turn))
        if any("the plate moved" in text for text in result.warnings):
            text = next(text for text in result.warnings if "the plate moved" in text)
            count += abs(int(re.search(r"from row (\d+)", text)[1]) - moment) <= NEAR
    return count / len(moments)


@pytest.mark.slow
def test_a_knock_between_cmm_positions_is_found_as_before(exact):
    moments = range(30, 260, 9 if LONG else 23)
    assert found(exact, "probe_rests", moments, 3e-7) > 0.9
    assert found(exact, "probe_rests", moments, 3e-6) > 0.95


def test_a_knock_within_a_table_position_is_noticed(exact):
    """Six balls before and six after it: that some are off together is as good a reason."""
    problem, rng = numbered(exact, "table_once"), np.random.default_rng(5)
    for moment in range(30, 260, 12 if LONG else 36):
        shift, turn = rng.normal(size=(2, 3))
        shift *= 1e-6 / np.linalg.norm(shift)
        turn *= 1e-6 / 0.185 / np.linalg.norm(turn)
        assert solve(knocked(problem, moment, rng, shift, turn)).verdict != "ok"


def test_a_knock_in_one_axis_is_not_taken_for_its_noise(exact):
    problem, rng = numbered(exact, "probe_rests"), np.random.default_rng(5)
    result = solve(knocked(problem, 120, rng, np.zeros(3), np.array([2e-5, 0.0, 0.0])))
    assert any("the plate moved" in text for text in result.warnings)
