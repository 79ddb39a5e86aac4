"""Groups of table positions: their frames and covariances; the words of separability."""

import re
from dataclasses import replace

import numpy as np
import pytest
from coded import coded
from plate_data import RADIUS, grid_rows, simulated
from plate_disturbed import measured

from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.foundation.errors import ObservabilityError
from rotcal_ros.methods.ball_plate.solver import (
    BallPlateProblem,
    plate_trials,
    solve,
)
from rotcal_ros.methods.ball_plate.solver.result import ORIGIN_DRIFTS
from rotcal_ros.methods.ball_plate.solver.separability import (
    WEAKLY_SEPARATED,
    Separability,
    separability,
)


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
    assert (WEAKLY_SEPARATED in coded(*warnings)) == (grid == 24)


def test_rejected_centres_stay_rejected_in_trials():
    problem, _ = simulated(24, [0, 3, 4, 9, 14, 20], sigma=5e-8)
    centres = problem.centres.copy()
    centres[17] += 1e-5
    trials = plate_trials(replace(problem, centres=centres))
    kept = solve(problem.take(np.arange(144) != 17))
    assert not trials.causes[:, 3 * 17 : 3 * 18].any()
    for found, expected in (
        (trials.value, kept.deviations),
        (np.linalg.norm(trials.causes, axis=1), kept.std),
    ):
        np.testing.assert_allclose(
            found, np.concatenate([expected[name] for name in COMPONENTS]), atol=1e-13
        )


def test_a_drift_is_estimated_in_every_group():
    row = np.random.default_rng(2).permutation(72)
    still, _ = simulated(
        12, np.arange(0, 12, 2), row=row, separate_groups=True, drift=1, sigma=5e-8
    )
    drift = np.array([0.0, 0.0, 2e-6])  # along z, which the turned frames of groups share
    result = solve(replace(still, centres=still.centres + np.outer(still.run_time, drift)))
    (text,) = [text for text in result.warnings if ORIGIN_DRIFTS in coded(text)]
    found = re.search(r"by \((\S+) \+- \S+, (\S+) \+- \S+, (\S+)", text).groups()
    np.testing.assert_allclose(1e-6 * np.array(found, float), drift, atol=1.5e-7)


ODD = [1, 3, 7, 11, 15, 21]
"""Ball steps of two groups on a grid of 24, whose frames are turned by 15 and by 30 degrees."""


def test_a_rejected_centre_is_named_as_people_number_it():
    problem, _ = measured(24, ODD, 3, separate_groups=True)
    for position in (6, 7):
        row = int(np.flatnonzero((problem.position == position) & (problem.ball_step == 11))[0])
        centres = problem.centres.copy()
        centres[row] += 1e-4
        (rejected,) = solve(replace(problem, centres=centres)).rejected
        assert f"ball step 11, table position {position})" in rejected.why
