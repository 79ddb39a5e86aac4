"""Layout search against the solver's own covariances and brute force."""

from contextlib import suppress
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rotcal_design.ball_plate.ball_layout import (
    count_layouts,
    mean_variances,
    plan_plate,
    proven_bound,
    required_effort,
    unit_std,
)
from rotcal_ros.foundation.errors import ObservabilityError, PlanError
from rotcal_ros.methods.ball_plate.measuring_order import spread_out
from rotcal_ros.methods.ball_plate.solver import BallPlateProblem
from rotcal_ros.methods.ball_plate.solver.layout import PlateLayout

PAPER_PLATE = [0, 8, 12, 18, 21, 28, 32, 37, 42, 50, 58, 62]
RADIUS = 0.185


def promised(grid, steps, **wanted):
    """What the layout with just these steps promises: there is no other to choose."""
    return plan_plate(grid, len(steps), subset_of=steps, **wanted)


def eliminated_variances(grid, balls):
    ball = np.repeat(balls, grid)
    table = np.tile(np.arange(grid), len(balls))
    angle = 2 * np.pi * ((table + ball) % grid) / grid
    centres = RADIUS * np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    problem = BallPlateProblem(grid, RADIUS, table, ball, centres)
    std = PlateLayout(problem).unit_std()
    mean = {n: np.mean(std[n] ** 2) for n in ("EXC", "EYC", "EZC", "EAC", "EBC", "ECC")}
    return [
        mean["ECC"] * RADIUS**2,
        (mean["EXC"] + mean["EYC"]) / 2,
        (mean["EAC"] + mean["EBC"]) / 2 * RADIUS**2,
        mean["EZC"],
    ]


@pytest.mark.parametrize(
    ("grid", "balls"),
    [(72, PAPER_PLATE), (24, [0, 3, 8, 12, 18]), (25, [0, 2, 7, 11, 12, 20]), (13, [0, 1, 3, 9])],
)
def test_variances_equal_those_of_the_eliminated_solution(grid, balls):
    np.testing.assert_allclose(
        mean_variances(grid, np.array(balls))[0], eliminated_variances(grid, balls), rtol=1e-8
    )


def test_layouts_that_do_not_separate_are_infinite():
    layouts = np.array([[0, 2, 4, 6, 8], [0, 1, 3, 7, 8]])
    variances = mean_variances(12, layouts)
    assert np.isinf(variances[0]).all()
    assert np.isfinite(variances[1]).all()


@settings(max_examples=40, deadline=None)
@given(st.integers(13, 80), st.integers(5, 12), st.integers(0, 10**6))
def test_nothing_beats_the_proven_bound(grid, count, seed):
    rng = np.random.default_rng(seed)
    layouts = np.array([rng.choice(grid, count, replace=False) for _ in range(50)])
    assert (mean_variances(grid, layouts) >= proven_bound(grid, count) * (1 - 1e-12)).all()


def test_perfect_difference_set_comes_close_to_the_bound():
    """Steps of the projective plane of order 3: |F(q)|^2 is the same for all q."""
    variances = mean_variances(13, np.array([0, 1, 3, 9]))[0]
    assert variances[0] > proven_bound(13, 4)[0]
    power = np.abs(np.fft.fft(np.isin(np.arange(13), [0, 1, 3, 9])))[1:] ** 2
    np.testing.assert_allclose(power, 3.0)


@pytest.mark.parametrize(("grid", "count", "gap"), [(13, 5, 1), (14, 5, 2), (16, 4, 3)])
def test_exhaustive_search_finds_what_brute_force_finds(grid, count, gap):
    layouts = np.array([(0, *c) for c in combinations(range(1, grid), count - 1)])
    gaps = np.diff(np.hstack([layouts, np.full((len(layouts), 1), grid)]), axis=1).min(axis=1)
    scores = mean_variances(grid, layouts[gaps >= gap]).sum(axis=1)
    found = plan_plate(grid, count, min_gap=gap)
    assert found.optimal
    assert found.score == pytest.approx(scores.min(), rel=1e-12)
    steps = np.array(found.steps)
    assert np.diff(steps, append=steps[0] + grid).min() >= gap
    assert found.evaluated < 0.6 * np.sum(gaps >= gap)  # the symmetry is used
    classes = {tuple(canonical(grid, layout)) for layout in layouts[gaps >= gap]}
    assert found.evaluated >= len(classes)  # and none is left out
    assert found.gap > 0.0


def canonical(grid, steps):
    """The smallest of all rotations and reflections of a layout."""
    turned = [np.sort((sign * (steps - start)) % grid) for sign in (1, -1) for start in steps]
    return min(turned, key=lambda layout: tuple(layout))


def test_symmetric_layouts_have_one_canonical_form_and_one_variance():
    steps = np.array([0, 3, 4, 9, 14])
    turned = np.sort((-steps + 5) % 24)
    assert (canonical(24, steps) == canonical(24, turned)).all()
    np.testing.assert_allclose(mean_variances(24, steps), mean_variances(24, turned), rtol=1e-12)


def test_count_covers_all_classes():
    classes = {tuple(canonical(12, np.array([0, *c]))) for c in combinations(range(1, 12), 4)}
    assert len(classes) <= count_layouts(12, 5) <= 4 * len(classes)


def test_subsets_of_the_paper_plate():
    layouts = np.array(list(combinations(PAPER_PLATE, 6)))
    assert len(layouts) == 924
    score = mean_variances(72, layouts).sum(axis=1)
    assert layouts[score.argmin()].tolist() == [0, 12, 28, 37, 50, 58]
    assert np.median(score) / score.min() == pytest.approx(1.30, abs=0.01)  # 30 % worse
    assert plan_plate(72, 6, subset_of=PAPER_PLATE).steps == (0, 12, 28, 37, 50, 58)
    # free choice of six steps must not be worse than the best subset
    assert plan_plate(72, 6, exact=False).score < score.min()


def test_exchange_search_beats_the_paper_and_random_layouts():
    rng = np.random.default_rng(1)
    layouts = np.array([rng.choice(72, 12, replace=False) for _ in range(3000)])
    found = plan_plate(72, 12, seed=0, starts=10)
    assert not found.optimal
    assert found.score < mean_variances(72, layouts).sum(axis=1).min()
    assert found.score < promised(72, PAPER_PLATE).score
    assert 0.0 < found.gap < 0.03
    assert plan_plate(72, 12, seed=0, starts=10).steps == found.steps


def test_predicted_standard_deviations_of_the_paper_plate():
    std = promised(72, PAPER_PLATE).predicted_std(5e-8, RADIUS)
    assert round(2e6 * std["ECC"], 3) == 0.163
    assert round(2e6 * std["EAC"], 3) == 0.231
    assert round(2e6 * std["EXC"], 3) == 0.030
    layout = replace(promised(72, PAPER_PLATE), variances=(1.0, 4.0, 9.0, 16.0))
    assert layout.predicted_std(1.0, 0.5)["EBC"] == pytest.approx(6.0)


def test_weights_move_the_optimum_towards_what_is_asked():
    only_turn = plan_plate(24, 5, weights=(1.0, 0.0, 0.0, 0.0))
    only_tilt = plan_plate(24, 5, weights=(0.0, 0.0, 1.0, 0.0))
    assert only_turn.variances[0] <= only_tilt.variances[0]
    assert only_tilt.variances[2] <= only_turn.variances[2]


def test_progress_reaches_the_end():
    seen = []
    plan_plate(13, 5, progress=lambda done, total: seen.append((done, total)))
    assert seen
    assert all(0 < done <= total for done, total in seen)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"grid": 24, "balls": 3}, "at least 4"),
        ({"grid": 24, "balls": 6, "min_gap": 5}, "do not fit"),
        ({"grid": 24, "balls": 6, "subset_of": [0, 1, 2]}, "only 3 of 6"),
        ({"grid": 24, "balls": 5, "subset_of": [0, 2, 4, 6, 8]}, "no layout"),
        ({"grid": 24, "balls": 5, "weights": (1.0, 1.0)}, "four weights"),
    ],
)
def test_impossible_wishes_are_refused(arguments, text):
    with pytest.raises(PlanError, match=text):
        plan_plate(**arguments)


def test_unit_std_of_all_positions_is_that_of_the_layout():
    std = unit_std(24, [0, 3, 8, 12, 18], np.arange(24), RADIUS)
    expected = promised(24, [0, 3, 8, 12, 18]).predicted_std(1.0, RADIUS)
    assert np.sqrt(np.mean(std["ECC"] ** 2)) == pytest.approx(expected["ECC"], rel=1e-9)


def test_effort_reaches_the_limit_with_the_least_work_first():
    ways = required_effort(24, "ECC", 0.6e-6, sigma=5e-8, radius=RADIUS, most_balls=8)
    assert all(way.expanded <= 0.6e-6 for way in ways)
    assert [w.centres for w in ways] == sorted(w.centres for w in ways)
    best = ways[0]
    std = unit_std(24, list(best.layout.steps), list(best.positions), RADIUS)["ECC"]
    assert best.expanded == pytest.approx(2 * 5e-8 * std.max(), rel=1e-9)
    assert {len(way.layout.steps) for way in ways} == {5, 6, 7, 8}
    for way in ways:  # one position less is not enough
        fewer = spread_out(24)[: len(way.positions) - 1]
        with suppress(ObservabilityError):  # it may not even separate the errors
            std = unit_std(24, list(way.layout.steps), fewer, RADIUS)["ECC"]
            assert 2 * 5e-8 * std.max() > 0.6e-6
    with pytest.raises(PlanError, match="repeat the measurement"):
        required_effort(24, "ECC", 1e-9, sigma=5e-8, radius=RADIUS, most_balls=6)
    with pytest.raises(PlanError, match="unknown component"):
        required_effort(24, "EEC", 1e-9, sigma=5e-8, radius=RADIUS)
