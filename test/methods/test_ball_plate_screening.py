"""Where the limits of the screening lie: just inside is accepted, just outside is not."""

from dataclasses import replace

import numpy as np
import pytest
from coded import coded
from exact_plate import ExactPlate
from plate_data import PAPER_PLATE, RADIUS, grid_rows

from rotcal_ros.foundation.errors import DataError
from rotcal_ros.methods.ball_plate.solver import solve
from rotcal_ros.methods.ball_plate.solver.problem import BallPlateProblem
from rotcal_ros.methods.ball_plate.solver.screening import AT_STEP, screen

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
    assert coded(rejection.why)[AT_STEP][0][0] == pytest.approx(1.255, abs=1e-6)


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


MIRRORS = {
    "y of the other sign": np.diag([1.0, -1.0, 1.0]),
    "x of the other sign": np.diag([-1.0, 1.0, 1.0]),
    "x and y exchanged": np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
    "z down, right-handed": np.diag([1.0, -1.0, -1.0]),
}


@pytest.mark.parametrize("mirror", MIRRORS.values(), ids=MIRRORS.keys())
def test_a_mirrored_frame_is_told_from_a_clockwise_table(mirror):
    problem = perfect()
    with pytest.raises(DataError, match="left-handed or its z axis points down"):
        screen(replace(problem, centres=problem.centres @ mirror.T))


def test_a_clockwise_table_is_no_mirrored_frame():
    table, ball = grid_rows(GRID, PAPER_PLATE)
    angle = STEP * (ball - table)
    centres = RADIUS * np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle])
    text = "clockwise while the table positions count up.*reverse the sign of the table angle"
    with pytest.raises(DataError, match=text) as caught:
        screen(BallPlateProblem(GRID, RADIUS, table, ball, centres))
    assert "left-handed" not in str(caught.value)


def test_no_centre_can_tell_the_sign_of_z_and_the_result_says_so():
    """The mirror z -> -z is a symmetry of the exact model, whatever tilts and shifts there are."""
    plate = ExactPlate(
        24, [0, 3, 4, 9, 14, 20], tilt=(1e-3, 2e-3), eccentric=(1e-3, 0.0), table=3e-6,
        machine=2e-6, made=2e-5,
    )  # fmt: skip
    problem = plate.problem(noise=5e-8, sigma=5e-8)
    there = solve(problem)
    mirrored = solve(replace(problem, centres=problem.centres * [1.0, 1.0, -1.0]))
    assert mirrored.verdict == there.verdict
    assert mirrored.sigma0 == pytest.approx(there.sigma0, rel=1e-6)
    for name, sign in {"EXC": 1, "EYC": 1, "EZC": -1, "EAC": -1, "EBC": -1, "ECC": 1}.items():
        np.testing.assert_allclose(
            mirrored.deviations[name], sign * there.deviations[name],
            atol=1e-3 * there.std[name].max(),
        )  # fmt: skip
    assert "sign of z" in there.verdict_line
    (named,) = [p for p in there.protections if p.effect == "sign of z"]
    assert named.treatment == "not protected"
    assert "EZC, EAC and EBC" in named.why


def test_positions_and_balls_renumbered_to_fit_are_named_as_no_centre_tells_it():
    """Position 0 is called 1, and the balls are counted from the next one: the same places."""
    plate = ExactPlate(24, [0, 3, 4, 9, 14, 20], table=3e-6, machine=2e-6, made=2e-5, seed=1)
    problem = plate.problem(noise=5e-8, sigma=5e-8)
    off = replace(problem, position=(problem.position + 1) % 24)
    with pytest.raises(DataError, match="Or the table positions are numbered off by as many"):
        solve(off)
    there = solve(problem)
    renumbered = solve(replace(off, ball_step=(problem.ball_step - 1) % 24))
    assert renumbered.verdict == there.verdict == "ok"
    turned = renumbered.deviations["ECC"] - np.roll(there.deviations["ECC"], 1)
    assert np.abs(turned).max() < 1e-3 * there.std["ECC"].max()
    assert "numbering" in there.verdict_line
