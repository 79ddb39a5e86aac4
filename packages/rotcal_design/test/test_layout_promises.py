"""What a layout promises, how the searches count and where their limits lie."""

import csv
import re
import warnings
from dataclasses import replace
from itertools import combinations
from math import comb
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from rotcal_design.ball_plate import ball_layout
from rotcal_design.ball_plate.ball_layout import (
    MOST_BALLS,
    count_layouts,
    mean_variances,
    plan_plate,
    proven_bound,
    required_effort,
    unit_std,
)
from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.foundation.errors import PlanError
from rotcal_ros.methods.configuration import read_configuration

ROOT = Path(__file__).parents[3]
FIGURES = ROOT / "research" / "figures"
PAPER_PLATE = [0, 8, 12, 18, 21, 28, 32, 37, 42, 50, 58, 62]


def promised(grid, steps, **wanted):
    """What the layout with just these steps promises: there is no other to choose."""
    return plan_plate(grid, len(steps), subset_of=steps, **wanted)


def printed_layouts():
    """The rows of the documentation's two tables of layouts."""
    for name in ("ball_layouts.csv", "ball_subsets.csv"):
        _head, *rows = csv.reader((FIGURES / name).read_text().splitlines())
        for cells in rows:
            steps = [int(step) for step in re.sub(r"\(.*", "", cells[2]).split()]
            yield int(cells[0]), steps, cells[3:7], float(cells[7].rstrip(" %")), cells[8:]


@pytest.mark.parametrize(("grid", "steps", "printed", "gap", "optimal"), [*printed_layouts()])
def test_printed_layouts_promise_what_the_page_says(grid, steps, printed, gap, optimal):
    layout = promised(grid, steps[::-1])
    assert layout.steps == tuple(steps)
    assert (layout.grid, layout.evaluated, layout.optimal) == (grid, 1, True)
    std = layout.predicted_std(0.05e-6, 0.185)
    for text, names in zip(
        printed, (["EXC", "EYC"], ["EZC"], ["EAC", "EBC"], ["ECC"]), strict=False
    ):
        for name in names:
            assert 2e6 * std[name] == pytest.approx(float(text), abs=0.51e-3)
    assert layout.score == pytest.approx(sum(layout.variances))
    assert layout.bound == pytest.approx(proven_bound(grid, len(steps)).sum())
    assert 100.0 * layout.gap == pytest.approx(gap, abs=0.51 if gap > 100 else 0.051)
    assert optimal in ([], ["yes"], ["no"])


@pytest.mark.parametrize("count", [6, 8, 10])
def test_shipped_subsets_are_the_best_ones(count):
    plate = read_configuration(
        ROOT / "config" / "plates" / f"ball_plate_{count}_of_72.yaml"
    ).plan.plate
    assert plate.ball_steps == plan_plate(72, count, subset_of=PAPER_PLATE).steps


def test_the_page_has_its_tables():
    assert len(list(printed_layouts())) == 21


@pytest.mark.parametrize(
    ("grid", "count", "gap"), [(12, 5, 1), (12, 6, 1), (24, 5, 2), (24, 6, 1)]
)
def test_searches_find_the_printed_optimum(grid, count, gap):
    """Looking at all, and exchanging; layouts that are only turned or mirrored are as good."""
    (steps,) = [row[1] for row in printed_layouts() if (row[0], len(row[1])) == (grid, count)]
    best = promised(grid, steps)
    every = plan_plate(grid, count, min_gap=gap)
    assert every.optimal
    assert every.score == pytest.approx(best.score, rel=1e-12)
    assert every.evaluated <= count_layouts(grid, count, gap)
    moved = plan_plate(grid, count, min_gap=gap, exact=False)
    assert not moved.optimal
    assert moved.score == pytest.approx(best.score, rel=1e-12)


def test_a_layout_is_judged_by_the_wanted_weights():
    plain = promised(24, [0, 3, 8, 12, 18])
    heavy = promised(24, [18, 0, 3, 8, 12], weights=(1.0, 2.0, 0.0, 5.0))
    assert heavy.steps == plain.steps
    turn, plane, _, along = plain.variances
    assert heavy.score == pytest.approx(turn + 2.0 * plane + 5.0 * along)
    bound = proven_bound(24, 5)
    assert heavy.bound == pytest.approx(bound[0] + 2.0 * bound[1] + 5.0 * bound[3])
    assert heavy.gap == pytest.approx(heavy.score / heavy.bound - 1.0)


def test_each_component_has_its_own_variance():
    layout = replace(promised(24, [0, 3, 8, 12, 18]), variances=(1.0, 4.0, 9.0, 16.0))
    std = layout.predicted_std(3.0, 0.5)
    assert std == pytest.approx(
        {"EXC": 6.0, "EYC": 6.0, "EZC": 12.0, "EAC": 18.0, "EBC": 18.0, "ECC": 6.0}
    )
    assert tuple(std) == COMPONENTS


def smallest_determinant(grid, balls):
    """Of the centred design of tilt and height, over the harmonics, for amplitudes of +- i q."""
    balls, found = np.array(balls), []
    for q in range(1, grid // 2 + 1):
        turn = [np.exp(-2j * np.pi * p * balls / grid) for p in (q + 1, q - 1, q)]
        design = np.column_stack([1j * turn[0], -1j * turn[1], turn[2]])
        design = design - design.mean(axis=0)
        if q == 1:  # the constant is fixed by a constraint
            design[:, 1] = np.linalg.qr(design, mode="complete")[0][:, -1] * np.sqrt(len(balls))
        found.append(np.linalg.svd(design, compute_uv=False).prod() ** 2)
    return min(found) / len(balls) ** 3


def clustered():
    """Balls close together, a little to both sides of what counts as separable."""
    for grid in range(24, 53, 4):
        for balls in ([0, 1, 2, 3, 4, 5], [0, 1, 2, 4, 8], [0, 1, 2, 3, 4, 5, 6, 7], [0, 2, 3, 5]):
            size = smallest_determinant(grid, balls) / 1e-7
            if 1e-3 < size < 1e3 and abs(np.log(size)) > 0.05:
                yield grid, balls, size > 1.0


def test_weak_layouts_count_as_separable_down_to_a_small_determinant():
    cases = list(clustered())
    assert {True, False} == {case[2] for case in cases}
    for grid, balls, separable in cases:
        variances = mean_variances(grid, np.array(balls))[0]
        assert np.isfinite(variances).all() == np.isfinite(variances).any() == separable
        if separable and grid < 32:
            std = unit_std(grid, balls, np.arange(grid), 1.0)
            mean = {name: np.mean(std[name] ** 2) for name in COMPONENTS}
            expected = [
                mean["ECC"],
                (mean["EXC"] + mean["EYC"]) / 2,
                (mean["EAC"] + mean["EBC"]) / 2,
                mean["EZC"],
            ]
            np.testing.assert_allclose(variances, expected, rtol=1e-5)


@pytest.mark.parametrize(("grid", "balls"), [(12, [0, 2, 4, 6, 8]), (12, [0, 4, 8]), (8, [0, 4])])
def test_what_cannot_be_separated_is_infinite_without_a_warning(grid, balls):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert np.isinf(mean_variances(grid, np.array(balls))).all()


def test_many_layouts_are_rated_as_each_alone():
    layouts = np.array(list(combinations(range(13), 5)))
    assert len(layouts) > 3 * 256
    together = mean_variances(13, layouts)
    alone = np.array([mean_variances(13, layout)[0] for layout in layouts])
    np.testing.assert_allclose(together, alone, rtol=1e-12)


@pytest.mark.parametrize(("grid", "count"), [(13, 4), (24, 5), (36, 9), (72, 12), (7, 5)])
def test_the_bound_is_the_best_way_to_share_out_the_power(grid, count):
    """sum |P(q)|^2 = N R, P(0) = R; each harmonic costs 1 / (R - power / R) at least."""
    power = grid * count - count**2
    others = grid - 3

    def alike(share, of):
        return of / (count - share / count)

    def pair(first):
        """P(1) = P(-1) get ``first`` each; the pair x, y meets only one of the two."""
        return alike(first, 1.0) + alike((power - 2.0 * first) / others, others)

    most = min(0.5 * power, 0.999 * count**2)  # no |P| exceeds R
    best = minimize_scalar(pair, bounds=(0.0, most), options={"xatol": 1e-12})
    plane = min(best.fun, pair(most))
    each = alike(power / (grid - 1), grid - 1.0)
    expected = np.array([each, plane, 2.0 * plane, each]) / grid
    np.testing.assert_allclose(proven_bound(grid, count), expected, rtol=1e-10)


@pytest.mark.parametrize(
    ("grid", "count", "gap"), [(12, 4, 1), (13, 5, 2), (15, 5, 3), (16, 4, 4)]
)
def test_layouts_are_counted_by_their_smallest_gap(grid, count, gap):
    """One of the smallest gaps lies first: the others are at least as large."""
    counted = 0
    for inner in combinations(range(1, grid), count - 1):
        gaps = np.diff([0, *inner, grid])
        counted += gaps[0] >= gap and gaps[0] == gaps.min()
    assert count_layouts(grid, count, gap) == counted
    if gap == 1:
        assert count_layouts(grid, count) == counted


def test_all_are_looked_at_up_to_the_limit(monkeypatch):
    count = count_layouts(13, 5)
    monkeypatch.setattr(ball_layout, "EXHAUSTIVE_LIMIT", count)
    assert plan_plate(13, 5).optimal
    monkeypatch.setattr(ball_layout, "EXHAUSTIVE_LIMIT", count - 1)
    assert not plan_plate(13, 5, starts=2).optimal
    monkeypatch.setattr(ball_layout, "EXHAUSTIVE_LIMIT", comb(8, 5))
    assert plan_plate(13, 5, subset_of=range(8)).optimal
    monkeypatch.setattr(ball_layout, "EXHAUSTIVE_LIMIT", comb(8, 5) - 1)
    assert not plan_plate(13, 5, subset_of=range(8), starts=2).optimal


def test_neighbours_may_be_alone_side_by_side():
    """Without a gap the best five of thirteen have neighbours; asked for two steps they do not."""
    best = plan_plate(13, 5)
    layouts = np.array([(0, *inner) for inner in combinations(range(1, 13), 4)])
    assert best.score == pytest.approx(mean_variances(13, layouts).sum(axis=1).min(), rel=1e-12)
    assert np.diff(best.steps).min() == 1
    apart = plan_plate(13, 5, min_gap=2, exact=False, starts=3)
    assert np.diff(apart.steps, append=apart.steps[0] + 13).min() >= 2
    assert apart.score > best.score


@pytest.mark.parametrize("exact", [True, False])
def test_balls_are_chosen_among_those_of_a_plate(exact):
    places = [1, 2, 5, 9, 14, 16, 21]
    layouts = np.array(list(combinations(places, 5)))
    gaps = np.diff(np.hstack([layouts, layouts[:, :1] + 24]), axis=1).min(axis=1)
    scores = mean_variances(24, layouts).sum(axis=1)
    for gap in (1, 2, 3, 4):
        found = plan_plate(24, 5, min_gap=gap, subset_of=[*places, 25], exact=exact)
        assert found.score == pytest.approx(scores[gaps >= gap].min(), rel=1e-12)
        assert set(found.steps) <= set(places)
        if exact:
            assert found.evaluated == np.count_nonzero(gaps >= gap)


def test_an_exchange_stops_where_no_single_move_helps():
    weights = np.array([1.0, 0.5, 2.0, 1.0])
    found = plan_plate(30, 5, min_gap=2, weights=tuple(weights), exact=False, starts=1, seed=4)
    assert found.score == pytest.approx(mean_variances(30, np.array(found.steps))[0] @ weights)
    for ball in range(5):
        others = np.delete(found.steps, ball)
        for place in range(30):
            away = np.abs((place - others + 15) % 30 - 15)
            if away.min() >= 2:
                moved = mean_variances(30, np.sort([*others, place]))[0] @ weights
                assert moved >= found.score * (1 - 1e-12)


@pytest.mark.parametrize(
    ("grid", "count", "gap"), [(13, 4, 3), (16, 5, 3), (27, 5, 5), (31, 6, 5)]
)
def test_an_exchange_keeps_tight_gaps(grid, count, gap):
    """On even and odd grids, across the last step too, from whatever start."""
    for seed in range(10):
        found = plan_plate(grid, count, min_gap=gap, exact=False, starts=1, seed=seed)
        assert np.diff(found.steps, append=found.steps[0] + grid).min() >= gap


def test_more_starts_look_at_more_layouts_and_find_no_worse_one():
    seen = []
    counts, scores = [], []
    for starts in (1, 2, 6):
        found = plan_plate(30, 6, exact=False, starts=starts, seed=3)
        counts.append(found.evaluated)
        scores.append(found.score)
    assert counts[0] < counts[1] < counts[2]
    assert scores == sorted(scores, reverse=True)
    # every look at the neighbours of a layout counts them and itself: 1 + 6 * 24
    assert all(count % (1 + 6 * 24) == 0 for count in counts)
    plan_plate(30, 6, exact=False, starts=3, progress=lambda *at: seen.append(at))
    assert seen == [(1, 3), (2, 3), (3, 3)]


def test_seeds_begin_elsewhere():
    found = {plan_plate(40, 6, exact=False, starts=1, seed=seed).evaluated for seed in range(8)}
    assert len(found) > 1
    usual = plan_plate(40, 6, exact=False, starts=1)
    assert usual == plan_plate(40, 6, exact=False, starts=1, seed=0)
    assert plan_plate(40, 6, exact=False) == plan_plate(40, 6, exact=False, starts=40)


def test_progress_counts_the_layouts_looked_at():
    seen = []
    found = plan_plate(24, 5, progress=lambda *at: seen.append(at))
    total = count_layouts(24, 5)
    assert all(of == total for _, of in seen)
    assert [done for done, _ in seen] == sorted({done for done, _ in seen})
    assert seen[-1][0] == min(found.evaluated, total)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"weights": (1.0, 1.0, 1.0, -0.1)}, "four weights of at least 0"),
        ({"weights": (0.0, 0.0, 0.0, 0.0)}, "four weights of at least 0"),
        ({"min_gap": 0}, "5 balls 0 steps apart"),
        ({"min_gap": 5}, "5 balls 5 steps apart do not fit on 24 steps"),
        ({"subset_of": [0, 3, 8, 12, 12]}, "only 4 of 5 wanted balls"),
        ({"balls": 3}, "3 balls cannot separate"),
    ],
)
def test_what_cannot_be_searched_is_refused(arguments, text):
    with pytest.raises(PlanError, match=text):
        plan_plate(**({"grid": 24, "balls": 5} | arguments))


def test_the_last_that_can_be_searched():
    assert plan_plate(25, 5, min_gap=4).optimal
    assert plan_plate(24, 4, starts=5).evaluated > 1
    assert plan_plate(24, 5, subset_of=[0, 3, 8, 12, 18]).steps == (0, 3, 8, 12, 18)
    with pytest.raises(
        PlanError, match="no layout of 5 balls on 25 steps with gaps of at least 5"
    ):
        plan_plate(25, 5, min_gap=5)  # evenly spaced: nothing is separated


def test_effort_is_that_of_the_layouts_it_names():
    radius, sigma, limit = 0.2, 5e-8, 1.5e-7
    ways = required_effort(12, "EXC", limit, sigma=sigma, radius=radius, min_gap=2, seed=3)
    assert {len(way.layout.steps) for way in ways} == {5}  # six in steps of two share a factor
    ways = required_effort(9, "EXC", limit, sigma=sigma, radius=radius, seed=3)
    assert MOST_BALLS > 9
    assert {len(way.layout.steps) for way in ways} == {5, 6, 7, 8, 9}
    for way in ways:
        assert way.layout == plan_plate(9, len(way.layout.steps), seed=3, starts=6, exact=False)
        assert way.centres == len(way.layout.steps) * len(way.positions)
        std = unit_std(9, list(way.layout.steps), list(way.positions), radius)["EXC"]
        assert way.expanded == pytest.approx(2.0 * sigma * std.max())
        assert way.expanded <= limit
        assert way.positions == tuple(sorted(set(way.positions)))
    assert list(ways) == sorted(ways, key=lambda way: (way.centres, way.expanded))


def test_unit_std_takes_any_positions():
    """Fewer positions, in any order: the same as solving those rows alone, larger than all."""
    positions = np.delete(np.arange(24), [2, 3, 13, 21])
    some = unit_std(24, [0, 3, 8, 12, 18], np.roll(positions, 5), 0.3)
    same = unit_std(24, [18, 3, 8, 12, 0], positions, 0.3)
    every = unit_std(24, [0, 3, 8, 12, 18], np.arange(24), 0.3)
    assert tuple(some) == COMPONENTS
    for name in COMPONENTS:
        np.testing.assert_allclose(some[name], same[name], rtol=1e-12)
        assert some[name].shape == (24,)
        assert (some[name] > every[name]).all()


@pytest.mark.parametrize("limit", [0.0, -1e-7, float("nan")])
def test_a_wanted_uncertainty_is_positive(limit):
    with pytest.raises(PlanError, match="must be positive"):
        required_effort(12, "EXC", limit, sigma=5e-8, radius=0.2)
