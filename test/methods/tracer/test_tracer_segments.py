"""Zeros that stations share: one per segment of unbroken beam."""

import numpy as np
import pytest
from rotcal_ros.methods.tracer.solver.trials import cumulative_deviations, predicted, trials_about
from segment_scene import LENGTH_STD, Dense, measure
from tracer_scene import low_ring, paper_block

from rotcal_ros.foundation.errors import ConfigurationError, DataError, ObservabilityError
from rotcal_ros.methods.tracer.solver import TracerProblem, solve
from rotcal_ros.methods.tracer.solver.solution import adjust


def dense_covariance(dense, x):
    """Of stations, zeros and targets; what a free network leaves open is left out."""
    jacobian = dense.slope(x)
    scale = 1.0 / np.linalg.norm(jacobian, axis=0)
    hidden = 7 if dense.p.datum == "free" else 0
    u, s, vt = np.linalg.svd(jacobian * scale, full_matrices=False)
    keep = len(s) - hidden
    half = scale[:, None] * vt[:keep].T / s[:keep]
    return half @ half.T, (u[:, :keep] ** 2).sum(axis=1)


def ecc_covariance(stations, angles, covariance):
    """By central differences of plane, circle and angle."""
    h, m = 1e-7, len(angles)
    steps = h * np.eye(3 * m).reshape(3 * m, m, 3)
    up, down = (cumulative_deviations(stations + sign * steps, angles) for sign in (1, -1))
    jacobian = ((up - down) / (2 * h)).T
    return jacobian @ covariance @ jacobian.T


@pytest.mark.parametrize("datum", ["prior", "free"])
@pytest.mark.parametrize("by_target", [True, False])
def test_solution_and_covariance_are_those_of_dense_least_squares(datum, by_target):
    run = measure(by_target=by_target)
    k = np.arange(140)
    segment = np.select([k < 33, k < 90], [4, 9], 7)
    zero = np.select([k < 33, k < 90], [0.8, 0.3], 1.1)
    problem = run.problem(zero, segment, datum=datum, slip=0.0)
    solution = adjust(problem)
    assert solution.noise.estimated is False
    dense = Dense(problem)
    found = solution.fit
    zeros = found.distances[solution.grid.first_of_zero]
    at = np.concatenate([found.stations.ravel(), zeros, found.targets.ravel()])
    if datum == "prior":
        at = dense.solve(run.stations)
        assert np.abs(found.stations - at[:21].reshape(7, 3)).max() < 1e-11
        assert np.abs(zeros - at[21:24]).max() < 1e-11
    covariance, leverage = dense_covariance(dense, at)
    expected = ecc_covariance(found.stations, run.angles, covariance[:21, :21])
    scale = np.abs(expected).max()
    # a free network at noisy lengths feels its seventh direction a little, 1e-6 of the others
    near = 1e-9 if datum == "prior" else 1e-5
    assert np.abs(solution.covariance - expected).max() < near * scale
    redundancy = solve(problem).residuals.redundancy
    assert np.abs(redundancy - (1 - leverage[:140])).max() < 10 * near
    assert predicted(problem, found.stations).covariance == pytest.approx(
        solution.covariance, rel=1e-4, abs=1e-4 * scale
    )


def test_prediction_of_stations_with_zeros_of_their_own_and_of_known_targets():
    run = measure(layout=paper_block)
    for options in ({"variant": "station"}, {"variant": "joint"}):
        problem = run.problem(0.5, None, **options)
        found = adjust(problem)
        foreseen = predicted(problem, run.stations)
        assert foreseen.angles.std[1:] == pytest.approx(found.angles.std[1:], rel=2e-4)
        assert foreseen.redundancy.sum() == pytest.approx(found.fit.redundancy.sum(), rel=1e-4)


def test_few_lengths_per_station_to_targets_of_its_own():
    run = measure(3, n=40, kept=8)
    result = solve(run.problem(0.5, np.arange(56) // 30))
    assert result.verdict == "ok"
    assert result.rejected == ()
    error = result.deviations["ECC"] - run.deviation
    assert np.abs(error).max() < 4 * result.std["ECC"].max() < 4 * 2e-5
    alone = solve(run.problem(0.5, None))  # each station with a zero of its own
    assert (alone.std["ECC"][1:] > result.std["ECC"][1:]).all()


def test_a_shared_zero_measures_better_and_a_break_costs_little():
    run = measure(layout=paper_block)
    half = np.arange(140) // 70
    std = [np.sqrt((solve(run.problem(0.5, s)).std["ECC"] ** 2).mean()) for s in (None, 0, half)]
    assert std[1] < std[2] < std[0]


def test_neither_the_order_of_rows_nor_the_size_of_a_break_changes_the_result():
    run = measure()
    half = np.arange(140) // 70
    problem = run.problem(0.5 + 1e-3 * half, half)
    mixed = np.random.default_rng(0).permutation(140)
    by_row = ("position", "target", "length", "order", "segment")
    rows = {name: getattr(problem, name)[mixed] for name in by_row}
    again = TracerProblem(**{**vars(problem), **rows, "length_std": 2e-7, "distance_std": 0.0})
    first, second = solve(problem), solve(again)
    assert np.array_equal(first.deviations["ECC"], second.deviations["ECC"])
    assert np.array_equal(first.covariance["ECC"], second.covariance["ECC"])
    moved = solve(run.problem(0.5 - 2e-2 * half, half))
    difference = moved.deviations["ECC"] - first.deviations["ECC"]
    assert np.abs(difference).max() < 1e-4 * first.std["ECC"].max()


def level_ring(n, rng):
    """Targets in one plane, as the best plans have them."""
    return np.column_stack([low_ring(n, rng)[:, :2], np.full(n, 0.29)])


@pytest.mark.parametrize("by_target", [True, False])
def test_few_lengths_to_level_targets_with_breaks_find_their_start(by_target):
    for seed in range(8):
        run = measure(seed, n=16, kept=7, by_target=by_target, layout=level_ring)
        segment = np.searchsorted(
            np.sort(np.random.default_rng(seed).integers(1, 49, 3)), range(49)
        )
        result = solve(run.problem(0.5 + 1e-3 * segment, segment))
        assert np.abs(result.details["stations"] - run.stations).max() < 2e-5
        assert any("all targets lie in one plane" in w for w in result.warnings)
        assert result.verdict == "ok"


def test_stations_that_turn_the_other_way_are_recognised():
    run = measure()
    with pytest.raises(DataError, match="negate the table angles"):
        solve(run.problem(0.5, 0, table_angles=-run.angles))


def test_an_outlier_is_rejected_and_the_trials_spread_as_stated():
    run = measure()
    problem = run.problem(0.5, np.arange(140) // 50)
    length = problem.length.copy()
    length[37] += 5e-6
    problem = TracerProblem(**{**vars(problem), "length": length})
    result = solve(problem)
    assert [r.index for r in result.rejected] == [37]
    assert result.residuals.residual[37] == pytest.approx(5e-6, abs=1e-6)
    drawn = trials_about(adjust(problem))(np.random.default_rng(1), 2000)
    spread = (drawn - drawn.mean(axis=0)).std(axis=0)
    assert spread[1:] == pytest.approx(result.std["ECC"][1:], rel=0.08)


def test_the_same_place_in_two_segments_counts_twice():
    run = measure()
    problem = run.problem(0.5, 0)
    again = np.arange(0, 140, 7)
    rng = np.random.default_rng(3)
    rows = {
        "position": np.append(problem.position, problem.position[again]),
        "target": np.append(problem.target, problem.target[again]),
        "length": np.append(
            problem.length, problem.length[again] + 0.01 + LENGTH_STD * rng.standard_normal(20)
        ),
        "order": np.append(problem.order, 140 + np.arange(20)),
        "segment": np.append(problem.segment, np.ones(20, dtype=int)),
        "length_std": LENGTH_STD,
        "distance_std": 0.0,
    }
    result = solve(TracerProblem(**{**vars(problem), **rows}))
    assert result.dof == solve(problem).dof + 19
    assert result.residuals.used.all()


def test_segments_need_the_joint_variant_and_lengths_enough():
    run = measure()
    with pytest.raises(ConfigurationError, match="choose the variant 'joint', or a zero per st"):
        run.problem(0.5, 0, variant="station")
    with pytest.raises(ConfigurationError, match=r"slip is -1\.0, expected zero or more"):
        run.problem(0.5, 0, slip=-1.0)
    with pytest.raises(ConfigurationError, match="zero_walk_std is for a zero per segment"):
        run.problem(0.5, None, zero_walk_std=1e-8)
    with pytest.raises(ObservabilityError, match="0 stations"):
        solve(run.problem(0.5, np.arange(140)))


def wandered(run, seed, std=5e-8, **options):
    steps = std * np.random.default_rng(seed).standard_normal(140)
    return run.problem(0.5 + np.cumsum(steps), 0, **options)


def test_a_zero_that_wanders_is_that_of_dense_least_squares():
    run = measure()
    problem = wandered(run, 2, zero_walk_std=5e-8, slip=0.0)
    solution = adjust(problem)
    dense = Dense(problem, walk=5e-8)
    at = dense.solve(run.stations)
    assert np.abs(solution.fit.stations - at[:21].reshape(7, 3)).max() < 1e-11
    covariance, _ = dense_covariance(dense, at)
    expected = ecc_covariance(solution.fit.stations, run.angles, covariance[:21, :21])
    assert np.abs(solution.covariance - expected).max() < 1e-8 * np.abs(expected).max()
    assert solution.fit.dof == 140 + 139 - 21 - 140
    drawn = trials_about(adjust(problem))(np.random.default_rng(1), 1000)
    assert drawn.std(axis=0)[1:] == pytest.approx(solution.angles.std[1:], rel=0.1)


def test_the_walk_is_estimated():
    run = measure(m=5, n=18)
    problem = run.problem(
        0.5 + np.cumsum(3e-7 * np.random.default_rng(7).standard_normal(90)), 0, zero_walk_std=None
    )
    assert solve(problem).details["zero_walk_std"] == pytest.approx(3e-7, rel=0.3)
    assert solve(run.problem(0.5, 0, zero_walk_std=None)).details["zero_walk_std"] < 3e-8


def test_a_slip_is_found_where_it_is_and_a_break_is_told_from_none():
    run = measure(n=40, by_target=False)
    k = np.arange(280)
    result = solve(run.problem(0.5 + 316e-9 * (k >= 160), 0))
    assert result.verdict == "suspect"
    assert "the zero of segment 0 jumps by -3" in result.warnings[0]
    assert "as much as -1 fringe(s), a counter that slipped; it was" in result.warnings[0]
    first, second = result.details["segments"]
    assert first["lengths"] + second["lengths"] == 280
    assert abs(first["lengths"] - 160) < 20
    assert second["step"] == pytest.approx(316e-9, abs=4 * second["step_std"])
    assert second["probability"] < 1e-4
    stayed = solve(run.problem(0.5, k // 160))
    assert stayed.verdict == "ok"
    assert stayed.details["segments"][1]["probability"] > 1e-3
