"""Where the limits of the screening lie: just inside is accepted, just outside is not."""

from dataclasses import replace

import numpy as np
import pytest
from plate_data import PAPER_PLATE, RADIUS, grid_rows

from rotcal_ros.errors import DataError
from rotcal_ros.methods.ball_plate.problem import BallPlateProblem
from rotcal_ros.methods.ball_plate.screening import screen

GRID = 72
STEP = 2 * np.pi / GRID


def perfect(turned=0.0, larger=1.0, raised=0.0):
    """Centres exactly at their places, but for a turn (rad), a scale and a height of each row."""
    table, ball = grid_rows(GRID, PAPER_PLATE)
    angle = STEP * (table + ball) + turned
    radius = RADIUS * np.broadcast_to(larger, angle.shape)
    height = np.broadcast_to(raised, angle.shape)
    centres = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height])
    return BallPlateProblem(GRID, RADIUS, table, ball, centres)


def one(value, row=100):
    values = np.zeros(GRID * len(PAPER_PLATE))
    values[row] = value
    return values


def refused(problem):
    return [rejection.index for rejection in screen(problem)[1]]


@pytest.mark.parametrize("larger", [1.0019, 1 / 1.0019])
def test_a_circle_may_be_a_little_larger_or_smaller(larger):
    assert refused(perfect(larger=larger)) == []


@pytest.mark.parametrize("larger", [1.0022, 1 / 1.0022])
def test_a_circle_of_another_radius_is_refused(larger):
    text = f"radius {RADIUS * larger:.6f} m, the plate says 0.185000 m"
    with pytest.raises(DataError, match=text):
        screen(perfect(larger=larger))


@pytest.mark.parametrize("direction", [0.4, 2.0, -2.5])
def test_the_circle_may_lie_off_the_axis_by_three_percent(direction):
    problem = perfect()
    away = RADIUS * np.array([np.cos(direction), np.sin(direction), 0.0])
    assert refused(replace(problem, centres=problem.centres + 0.0299 * away)) == []
    x, y = 0.0301e3 * away[:2]
    with pytest.raises(DataError, match=rf"\({x:.3f}, {y:.3f}\) mm off the origin"):
        screen(replace(problem, centres=problem.centres + 0.0301 * away))


@pytest.mark.parametrize("direction", [0.4, 2.0, -2.5])
def test_the_plate_may_lie_off_the_axis_by_three_percent(direction):
    """Every ball moves by more than a quarter step from its place, and none is flagged."""
    problem = perfect()
    turn = direction + STEP * problem.position
    away = RADIUS * np.column_stack([np.cos(turn), np.sin(turn), 0.0 * turn])
    off = problem.centres + np.array([3e-3, -2e-3, 1e-3])
    assert refused(replace(problem, centres=off + 0.0299 * away)) == []
    misplaced = perfect(turned=one(4 * STEP)).centres - problem.centres
    assert refused(replace(problem, centres=off + 0.0299 * away + misplaced)) == [100]
    x, y = 0.0301e3 * RADIUS * np.array([np.cos(direction), np.sin(direction)])
    text = rf"the plate lies \({x:.3f}, {y:.3f}\) mm off the table's axis: centre it"
    with pytest.raises(DataError, match=text):
        screen(replace(problem, centres=off + 0.0301 * away))


@pytest.mark.parametrize(("factor", "unit"), [(99.0, "wrong plate file"), (101.0, "millimetres")])
def test_a_hundred_times_the_radius_is_another_unit(factor, unit):
    with pytest.raises(DataError, match=unit):
        screen(perfect(larger=factor))


@pytest.mark.parametrize("sign", [1, -1])
def test_a_centre_may_lie_a_quarter_step_from_its_place(sign):
    assert refused(perfect(turned=one(sign * 0.249 * STEP))) == []
    (rejection,) = screen(perfect(turned=one(sign * 0.251 * STEP)))[1]
    assert rejection.index == 100
    assert "the centre lies 1.25 degrees from its place" in rejection.why


def test_a_centre_at_another_ball_is_named():
    (rejection,) = screen(perfect(turned=one(4 * STEP)))[1]
    # row 100: ball step 8 at table position 28; four steps on stands ball 12
    assert rejection.why == (
        "row 100 (ball step 8, table position 28): the centre lies 20.00 degrees from its place, "
        "where ball step 12 stands"
    )


def test_a_fifth_of_the_rows_may_be_misplaced():
    n = GRID * len(PAPER_PLATE)
    rows = np.random.default_rng(1).permutation(n)
    few, many = np.zeros(n), np.zeros(n)
    few[rows[: int(0.199 * n)]] = STEP
    many[rows[: int(0.21 * n)]] = STEP
    assert refused(perfect(turned=few)) == sorted(rows[: int(0.199 * n)])
    with pytest.raises(DataError):
        screen(perfect(turned=many))


@pytest.mark.parametrize("sign", [1, -1])
def test_a_centre_may_lie_a_twentieth_of_the_radius_off_the_circle(sign):
    for kind in ("raised", "larger"):
        for share, rows in ((0.0499, []), (0.0502, [100])):
            moved = one(sign * share * (RADIUS if kind == "raised" else 1.0))
            problem = perfect(**{kind: moved + (kind == "larger")})
            found = screen(problem)[1]
            assert [rejection.index for rejection in found] == rows
            if rows:
                miss = sign * 0.0502 * RADIUS / 1e-3
                assert f"the centre lies {miss:.3f} mm off the circle" in found[0].why


def test_a_middle_height_anywhere_is_good():
    assert refused(perfect(raised=0.3)) == []


def test_what_is_rejected_is_not_fitted():
    fitted, _ = screen(perfect(turned=one(STEP)))
    assert len(fitted.centres) == GRID * len(PAPER_PLATE) - 1
    assert 100 not in fitted.rows
