"""Groups of table positions: their frames and covariances; the words of separability."""

from dataclasses import replace

import numpy as np
import pytest
from plate_data import RADIUS, grid_rows, simulated
from plate_disturbed import drifted, knocked, measured

from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.foundation.errors import ObservabilityError
from rotcal_ros.methods.ball_plate.solver import (
    BallPlateProblem,
    general_least_squares,
    plate_trials,
    solve,
)
from rotcal_ros.methods.ball_plate.solver.separability import Separability, separability
from rotcal_ros.methods.ball_plate.solver.solution import split


def slope_of(problem):
    """The deviations (6 N, 3 n) per centre: they are linear, so one step of each is enough."""
    start = solve(problem).deviations
    columns = []
    for place in range(problem.centres.size):
        step = np.zeros(problem.centres.size)
        step[place] = 1e-6
        moved = solve(replace(problem, centres=problem.centres + step.reshape(-1, 3))).deviations
        columns.append([(moved[name] - start[name]) / 1e-6 for name in COMPONENTS])
    return np.moveaxis(np.array(columns), 0, -1)  # (6, N, 3 n)


@pytest.mark.slow
@pytest.mark.slow
def test_covariances_of_groups_are_the_noise_sent_through_the_solution():
    balls = np.arange(1, 6, 2)  # odd: the groups are turned
    table, ball = grid_rows(6, balls)
    angle = 2 * np.pi * (table + ball) / 6
    centres = RADIUS * np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    problem = BallPlateProblem(
        6, RADIUS, table, ball, centres, sigma=1e-3, separate_groups=True
    )  # so large a noise rejects nothing
    result = solve(problem)
    slope = slope_of(problem)
    for name, rows in zip(COMPONENTS, slope, strict=True):
        expected = 1e-6 * rows @ rows.T
        found = result.covariance[name]
        np.testing.assert_allclose(found, expected, atol=1e-5 * expected.max(), err_msg=name)
        np.testing.assert_allclose(result.std[name], np.sqrt(np.diag(expected)), rtol=1e-4)


@pytest.mark.parametrize("shift", [0, 1, 2])
def test_a_group_begins_with_its_first_ball_on_the_x_axis(shift):
    std = np.random.default_rng(1).uniform(1e-7, 2e-7, (48, 3))
    whole, _ = simulated(12, [1, 4, 7, 10], std=std)
    balls = (whole.ball_step + shift) % 12
    problem = replace(whole, ball_step=balls, separate_groups=True)
    groups = split(problem)
    assert len(groups) == 3
    for first, group in enumerate(groups):
        rows = problem.position % 3 == first
        start = int(problem.balls[0] % 3)
        part = group.problem
        assert group.positions.tolist() == list(range(first, 12, 3))
        assert group.turn == pytest.approx(2 * np.pi * ((first + start) % 12) / 12)
        assert part.grid == 4
        assert not part.separate_groups
        order = np.argsort(part.rows)
        wanted = np.argsort(problem.rows[rows])
        np.testing.assert_array_equal(
            3 * part.position[order] + first, problem.position[rows][wanted]
        )
        np.testing.assert_array_equal(
            3 * part.ball_step[order] + start, problem.ball_step[rows][wanted]
        )
        cos, sin = np.cos(group.turn), np.sin(group.turn)
        x, y, z = problem.centres[rows][wanted].T
        turned = np.column_stack([cos * x + sin * y, cos * y - sin * x, z])
        np.testing.assert_allclose(part.centres[order], turned, atol=1e-15)
        own = problem.std[rows][wanted]
        plane = np.sqrt((own[:, 0] ** 2 + own[:, 1] ** 2) / 2)
        np.testing.assert_allclose(part.std[order], np.column_stack([plane, plane, own[:, 2]]))


def test_a_group_that_was_not_measured_is_named():
    problem, _ = simulated(24, [0, 2, 4, 8, 14, 20], separate_groups=True)
    part = problem.take(problem.position % 2 == 0)
    with pytest.raises(
        ObservabilityError, match=r"at the table positions 1, 3, \.\.\.: one group"
    ):
        solve(part)


def test_findings_are_spelled_with_ranges():
    found = Separability(3, 4, {"ECC": (1, 2, 3, 7), "EZC": (5,)}, {"EXC, EYC": (2, 3, 9, 10, 12)})
    assert found.sentences() == (
        "all distances between balls share the factor 3 with the grid, which splits the positions "
        "into 3 groups without a connection (Eq. 22)",
        "cannot be separated from plate and CMM: harmonics 1-3, 7 of ECC; harmonic 5 of EZC; "
        "choose ball steps without a common factor, or more balls",
        "only weakly separated: harmonics 2-3, 9-10, 12 of EXC, EYC",
    )
    assert not found.separable
    assert Separability(1, 0, {}, {}).separable
    assert Separability(1, 0, {}, {}).sentences() == ()


def weak_harmonics(grid, balls):
    """Harmonics of heights and tilts whose smallest eigenvalue is below a thousandth of R."""
    balls, found = np.array(balls), set()
    for q in range(1, grid // 2 + 1):
        turn = [np.exp(-2j * np.pi * p * balls / grid) for p in (q + 1, q - 1, q)]
        root = np.sqrt(0.5)
        design = np.column_stack([1j * root * turn[0], -1j * root * turn[1], turn[2]])
        design = design - design.mean(axis=0)
        if q == 1:
            design = np.delete(design, 1, axis=1)  # a constraint fixes this one
        values = np.linalg.svd(design, compute_uv=False) ** 2
        if values[-1] < 1e-3 * len(balls):
            found.add(q)
    return found


@pytest.mark.parametrize(("grid", "balls"), [(24, [0, 1, 2, 3, 4]), (12, [0, 1, 2, 3, 5])])
def test_balls_side_by_side_separate_weakly(grid, balls):
    found = separability(grid, np.array(balls))
    assert found.separable
    weak = weak_harmonics(grid, balls)
    assert set(found.weak.get("EZC", ())) == weak
    assert bool(found.weak) == (grid == 24)
    problem, _ = simulated(grid, balls)
    warnings = solve(problem).warnings
    assert any(text.startswith("only weakly separated: ") for text in warnings) == (grid == 24)


def test_rejected_centres_stay_rejected_in_trials():
    problem, _ = simulated(24, [0, 3, 4, 9, 14, 20], sigma=5e-8)
    centres = problem.centres.copy()
    centres[17] += 1e-5
    trials = plate_trials(replace(problem, centres=centres))
    kept = solve(problem.take(np.arange(144) != 17))
    assert trials.causes.shape == (6 * 24, 3 * 143)
    for found, expected in (
        (trials.value, kept.deviations),
        (np.linalg.norm(trials.causes, axis=1), kept.std),
    ):
        np.testing.assert_allclose(
            found, np.concatenate([expected[name] for name in COMPONENTS]), atol=1e-15
        )


def test_trials_of_large_grids_are_solved_one_by_one(monkeypatch):
    problem, _ = simulated(12, [0, 1, 3, 7, 8, 10], sigma=5e-8)
    straight = plate_trials(problem)
    monkeypatch.setattr(general_least_squares, "MAX_UNKNOWNS", 131)
    # 18 of the plate, 36 of the CMM, 72 of the table, 6 of the axis
    assert type(plate_trials(problem)) is not type(straight)
    monkeypatch.setattr(general_least_squares, "MAX_UNKNOWNS", 132)
    assert type(plate_trials(problem)) is type(straight)


def test_a_drift_is_estimated_in_every_group():
    row = np.random.default_rng(2).permutation(72)
    still, _ = simulated(
        12, np.arange(0, 12, 2), row=row, separate_groups=True, drift=1, sigma=5e-8
    )
    drift = np.array([0.0, 0.0, 2e-6])  # along z, which the turned frames of groups share
    result = solve(replace(still, centres=still.centres + np.outer(still.run_time, drift)))
    assert [found["estimated"] for found in result.details["drift"]] == [True, True]
    for found in result.details["drift"]:  # the rows of a group do not span quite the whole run
        np.testing.assert_allclose(found["amount"], drift, atol=1.5e-7)
    assert sum("drifts by" in sentence for sentence in result.warnings) == 2


ODD = [1, 3, 7, 11, 15, 21]
"""Ball steps of two groups on a grid of 24, whose frames are turned by 15 and by 30 degrees."""


def test_a_drift_is_told_in_the_frame_of_the_machine():
    amount = np.array([3e-6, 0.0, 1e-6])
    problem, _ = measured(
        24, ODD, 3, separate_groups=True, displaced=lambda i, _: drifted(len(i), amount)
    )
    drifts = solve(problem).details["drift"]
    assert len(drifts) == 2
    for drift in drifts:
        size = np.linalg.norm(drift["amount"])  # over the time of the group, most of the run
        assert 0.9 < size / np.linalg.norm(amount) <= 1.0
        direction = amount / np.linalg.norm(amount)
        np.testing.assert_allclose(drift["amount"] / size, direction, atol=0.03)


def test_a_knock_is_told_in_the_frame_of_the_table_and_by_its_place():
    shift, moment = np.array([2e-5, 0.0, 0.0]), 61
    problem, _ = measured(
        24, ODD, 3, separate_groups=True,
        displaced=lambda i, j: knocked(24, i, j, moment, shift, np.zeros(3)),
    )  # fmt: skip
    result = solve(problem)
    knocks = [group["knock"] for group in result.details["groups"]]
    for knock in knocks:
        np.testing.assert_allclose(knock["shift"], shift, atol=5e-7)
        assert knock["last_row"] < moment <= knock["first_row"]
        row = int(np.flatnonzero(problem.rows == knock["first_row"])[0])
        where = f"ball step {problem.ball_step[row]} at table position {problem.position[row]}"
        assert any(where in w for w in result.warnings)


def test_a_rejected_centre_is_named_as_people_number_it():
    problem, _ = measured(24, ODD, 3, separate_groups=True)
    for position in (6, 7):
        row = int(np.flatnonzero((problem.position == position) & (problem.ball_step == 11))[0])
        centres = problem.centres.copy()
        centres[row] += 1e-4
        (rejected,) = solve(replace(problem, centres=centres)).rejected
        assert f"ball step 11, table position {position})" in rejected.why


def test_a_closure_is_told_by_its_place_in_the_frame_of_the_machine():
    order = {"order": "interleaved"}
    problem, _ = measured(24, ODD, 3, order=order, separate_groups=True, noise=0.0)
    closing = solve(problem).details["closure"]
    places = {c["position"] for c in closing}
    stops = problem.position[np.argsort(problem.rows)]
    assert places == {int(stops[-1])}
    moved = problem.centres.copy()
    again = np.argsort(problem.rows)[-len(ODD) :]
    moved[again] += (0.0, 4e-6, 0.0)
    (closure,) = solve(replace(problem, centres=moved)).details["closure"]
    np.testing.assert_allclose(closure["shift"], (0.0, 4e-6, 0.0), atol=1e-9)
