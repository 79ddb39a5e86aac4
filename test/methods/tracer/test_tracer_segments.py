"""Zeros that stations share: one per segment of unbroken beam."""

import numpy as np
import pytest
from coded import coded
from segment_scene import LENGTH_STD, measure
from tracer_scene import low_ring, paper_block

from rotcal_ros.foundation.errors import ConfigurationError, DataError, ObservabilityError
from rotcal_ros.methods.tracer.solver import TracerProblem, solve
from rotcal_ros.methods.tracer.solver.prediction import predicted
from rotcal_ros.methods.tracer.solver.solution import adjust
from rotcal_ros.methods.tracer.solver.solve import AS_FRINGES, IN_ONE_PLANE


def test_prediction_of_stations_with_zeros_of_their_own_and_of_known_targets():
    run = measure(layout=paper_block)
    for options in ({"variant": "station"}, {"variant": "joint"}):
        problem = run.problem(0.5, None, **options)
        found = adjust(problem)
        foreseen = predicted(problem, run.stations)
        std = np.sqrt(foreseen.covariance.diagonal())
        assert std[1:] == pytest.approx(found.std[1:], rel=2e-3)


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
    again = TracerProblem(**{**vars(problem), **rows, "length_std": 2e-7})
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
        assert IN_ONE_PLANE in coded(*result.warnings)
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
    drawn = adjust(problem).trials(np.random.default_rng(1), 2000)
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
    assert solve(run.problem(0.5 + 316e-9 * (k >= 160), 0)).verdict == "suspect"
    result = solve(run.problem(0.5 + 2 * 316e-9 * (k >= 160), 0))
    assert coded(*result.warnings)[AS_FRINGES] == [(-2,)]
    stayed = solve(run.problem(0.5, k // 160))
    assert stayed.verdict == "ok"
    assert stayed.details["segments"][1]["probability"] > 1e-3
