"""Drift of the CMM and knocks of the plate: what an order of measurement shows, and what it costs.

The disturbances are written down once more, in plate_disturbed.py, as displacements of the rows.
"""

from dataclasses import replace

import numpy as np
import pytest
from chances import LONG, most, share
from plate_data import PAPER_PLATE, RADIUS, rotate_z
from plate_disturbed import (
    DEMO_PLATE,
    NOISE,
    ORDERS,
    caused,
    drifted,
    errors,
    knocked,
    measured,
    on_plate,
)
from plate_in_engine import in_the_engine

from rotcal_ros.adjust.effects import effect_test
from rotcal_ros.adjust.seen import seen_by
from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.protection import EFFECTS
from rotcal_ros.methods.ball_plate.measuring_order import plan_measurement
from rotcal_ros.methods.ball_plate.solver import solve
from rotcal_ros.methods.ball_plate.solver.estimate import drift_columns, factored_with_drift
from rotcal_ros.methods.ball_plate.solver.estimate import solved as solve_exactly
from rotcal_ros.methods.ball_plate.solver.model import plate_motion
from rotcal_ros.methods.ball_plate.solver.order_effects import (
    drift_error,
    find_drift,
    found_size,
    knock_error,
    needed,
    order_effects,
)
from rotcal_ros.methods.ball_plate.solver.problem import BallPlateProblem
from rotcal_ros.methods.ball_plate.solver.repeated_stops import closing_apart


@pytest.mark.parametrize("part", [0.02, 0.37, 0.97])
def test_a_knock_between_two_stops_is_never_a_bare_ok(part):
    """Every seed at each moment: the plate moves while the table turns."""
    plan = plan_measurement(36, DEMO_PLATE)
    stops = np.flatnonzero(np.diff(plan.position)) + 1
    moment = stops[int(part * len(stops))]
    for seed in range(10 if LONG else 2):
        problem, _ = measured(
            36, DEMO_PLATE, seed, displaced=lambda i, j: knocked(36, i, j, moment)
        )
        clean, _ = measured(36, DEMO_PLATE, seed)
        found, expected = solve(problem), solve(clean)
        bare = found.verdict == "ok" and "knock" not in found.unprotected
        assert not bare or caused(found, expected) < 2.0
        assert found.verdict != "ok"


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("order", ORDERS)
def test_a_drift_of_a_micrometre_is_seen_or_does_no_harm(order, axis):
    amount = np.eye(3)[axis] * 1e-6
    for seed in range(8 if LONG else 1):
        problem, _ = measured(
            36, DEMO_PLATE, seed, ORDERS[order], displaced=lambda i, _: drifted(len(i), amount)
        )
        clean, _ = measured(36, DEMO_PLATE, seed, ORDERS[order])
        found = solve(problem)
        assert found.verdict != "ok" or caused(found, solve(clean)) < 2.0
        if order == "interleaved":
            drift = found.details["drift"][0]
            np.testing.assert_allclose(
                drift["amount"], amount * 431 / 443, atol=5.0 * np.max(drift["std"]), rtol=0.0
            )
            assert any("drifts" in warning for warning in found.warnings)


def test_without_closure_one_turn_says_what_it_hides():
    order = {"order": "table_once", "closing": False}
    problem, truth = measured(
        36, DEMO_PLATE, 3, order, displaced=lambda i, _: drifted(len(i), [1e-6, 0.0, 0.0])
    )
    found = solve(problem)
    assert found.verdict == "ok"
    assert errors(found, truth).max() > 7.0
    assert {"drift", "knock", "repeatability"} <= set(found.unprotected)
    assert "drift" in found.verdict_line


def test_good_data_in_the_default_order_are_protected_from_drift_and_knock():
    doubted = 0
    seeds = 40 if LONG else 6
    for seed in range(seeds):
        problem, _ = measured(36, DEMO_PLATE, seed)
        found = solve(problem)
        assert not {"drift", "knock", "repeatability"} & set(found.unprotected)
        doubted += found.verdict != "ok"
    assert doubted <= most(0.03, seeds)  # three tests at 1 %


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("grid", [12, 36])
def test_predicted_errors_are_what_a_simulation_gives(order, grid):
    """Exact centres, disturbed by a unit, solved: the prediction to rounding."""
    balls = DEMO_PLATE if grid == 36 else [0, 1, 3, 5, 8, 9]
    plan = plan_measurement(grid, balls, **ORDERS[order], closing=False)
    table, ball = plan.position, plan.ball_step
    row = np.arange(len(table))
    nominal = on_plate(grid, (table + ball) % grid)
    problem = BallPlateProblem(grid, RADIUS, table, ball, nominal, row=row)
    effects = order_effects(problem, None)

    def found(displaced):
        solved = solve_exactly(replace(problem_of(displaced), std=None))[1]
        curves = np.array([solved.estimate.component(n) for n in COMPONENTS])
        return curves, solved.weighted_square_sum

    def problem_of(displaced):
        return BallPlateProblem(grid, RADIUS, table, ball, nominal + displaced, row=row)

    size = 1e-8  # small: products of the displacements are no part of the prediction
    for axis in range(3):
        curves, left = found(drifted(len(row), size * np.eye(3)[axis]))
        np.testing.assert_allclose(curves / size, effects.drift.response[:, :, axis], atol=1e-6)
        assert left / size**2 == pytest.approx(
            effects.drift.seen.information[axis, axis], abs=1e-6
        )
    for number in (0, len(effects.moments) // 2, len(effects.moments) - 1):
        knock, moment = effects.knocks[number], effects.moments[number]
        shift, turn = np.array([3.0, 2.0, -1.0]), np.array([5.0, -4.0, 6.0])
        motion = (size * shift, size * turn / RADIUS)
        curves, left = found(knocked(grid, table, ball, moment, *motion))
        amount = np.concatenate([shift, turn])
        np.testing.assert_allclose(curves / size, knock.response @ amount, atol=2e-5)
        expected = amount @ knock.seen.information @ amount
        assert left / size**2 == pytest.approx(expected, rel=1e-5, abs=1e-5)


@pytest.mark.parametrize("drift", [0, 1])
def test_drift_and_knocks_are_effects_of_the_engine(drift):
    """What they do, what residuals keep of them, and their test: as of its dense reference."""
    amount = [4e-8, -2e-8, 6e-8]
    problem, _ = measured(
        24, [0, 3, 4, 9, 14, 20], 2, {"closing": False}, drift=drift,
        displaced=lambda i, _: drifted(len(i), amount),
    )  # fmt: skip
    dense, effects = in_the_engine(problem), order_effects(problem, None)
    n = len(problem.centres)
    late = np.argsort(np.argsort(problem.rows))[:, None, None]
    moved = [np.where(late >= m, plate_motion(problem), 0.0) for m in effects.moments[[3, -4]]]
    patterns = [effects.knocks[3], effects.knocks[-4]]
    if not drift:
        moved, patterns = [*moved, drift_columns(problem.run_time, 1)], [*patterns, effects.drift]
    for columns, found in zip(moved, patterns, strict=True):
        seen = seen_by(dense, columns.reshape(3 * n, -1))
        size = np.abs(seen.moved).max()
        np.testing.assert_allclose(
            found.response.reshape(-1, columns.shape[2]), seen.moved.T, rtol=0, atol=1e-9 * size
        )
        np.testing.assert_allclose(
            found.seen.information, seen.information, rtol=0, atol=1e-9 * seen.whole.max()
        )
    if drift:
        return
    solution = factored_with_drift(problem).solve(problem.deviations)
    mine, test = find_drift(problem, solution, effects), effect_test(seen, (dense.chi2, dense.dof))
    np.testing.assert_allclose(mine.amount, test.size, rtol=1e-7)
    assert mine.p_value == pytest.approx(test.probability, rel=1e-6)
    assert 1e-6 < mine.p_value < 0.1


@pytest.mark.slow
def test_a_drift_of_the_predicted_size_is_found_in_95_percent():
    n, hits, runs = 144, 0, 120 if LONG else 20
    problem, _ = measured(12, list(range(12)), 0, {"closing": False})
    effects = order_effects(problem, None)
    dof = solve_exactly(problem)[1].dof
    size = found_size(effects.drift, np.array([0.0, 0.0, 1.0]), needed(3, dof), needed(6, dof))
    for seed in range(runs):
        disturbed, _ = measured(
            12, list(range(12)), seed, {"closing": False},
            displaced=lambda _i, _j: drifted(n, [0.0, 0.0, size * NOISE]),
        )  # fmt: skip
        hits += solve(disturbed).details["drift"][0]["p_value"] < 0.01
    low, high = (0.88, 119 / 120) if LONG else share(0.95, runs)
    assert low <= hits / runs <= high


def test_the_default_order_is_the_one_that_shows_most():
    """The errors that stay unseen, in stated standard deviations, predicted."""
    seen = {}
    for name, order in {
        **ORDERS, "open": {"order": "table_once", "closing": False},
    }.items():  # fmt: skip
        problem, _ = measured(72, PAPER_PLATE, 0, order)
        once, again = closing_apart(problem)
        solution = solve_exactly(once)[1]
        std = solution.unit_std.curves()
        effects = order_effects(once, again)
        seen[name] = (
            drift_error(effects, std, solution.dof),
            knock_error(effects, std, solution.dof),
        )
    assert max(seen["interleaved"]) < 1.5
    assert seen["table_once"][1] > 5.0
    assert seen["open"][0] > 100.0
    assert seen["open"][1] == np.inf
    assert seen["probe_rests"][0] < 0.5


def test_closing_rows_stay_out_of_the_fit_and_are_compared():
    problem, _ = measured(36, DEMO_PLATE, 5)
    found = solve(problem)
    assert found.details["groups"][0]["way"] == "spectral"
    (closed,) = found.details["closure"]
    assert closed["n_balls"] == 12
    assert closed["p_value"] > 0.01
    moved, _ = measured(
        36, DEMO_PLATE, 5,
        displaced=lambda i, _: np.where(np.arange(len(i))[:, None] >= 432, [0.0, 4e-7, 0.0], 0.0),
    )  # fmt: skip
    doubted = solve(moved)
    assert doubted.verdict == "suspect"
    assert "measured again at the end" in " ".join(doubted.warnings)
    (closed,) = doubted.details["closure"]
    assert closed["shift"][1] == pytest.approx(4e-7, abs=5.0 * closed["shift_std"][1])
    assert closed["shift_std"][1] == pytest.approx(NOISE * np.sqrt(2.0 / 12.0), rel=0.3)


def test_a_closure_needs_no_ball_that_was_not_measured_first():
    problem, _ = measured(36, DEMO_PLATE, 5)
    whole = np.arange(len(problem.centres))
    first = int(np.flatnonzero(problem.rows == problem.rows.min())[0])
    lacking = solve(problem.take(np.setdiff1d(whole, [first])))
    assert lacking.n_observations == len(whole) - 1
    assert not lacking.rejected
    wrong = problem.centres.copy()
    last = int(np.flatnonzero(problem.rows == problem.rows.max())[0])
    wrong[last, 2] += 5e-6
    dirty = solve(replace(problem, centres=wrong))
    assert dirty.details["closure"][0]["n_gross"] == 1
    assert dirty.verdict == "ok"


@pytest.mark.slow
@pytest.mark.parametrize("size", [0.0, 3e-7])
def test_the_tables_repeatability_is_estimated_from_its_stops(size):
    """Every stop shifts the table along y by a random amount of its own."""
    found = []
    inside = total = 0
    for seed in range(12 if LONG else 2):
        rng = np.random.default_rng([seed, 11])

        def arriving(table, ball, rng=rng):
            stop = np.cumsum(np.diff(table, prepend=-1) != 0) - 1
            return size * rng.normal(size=stop.max() + 1)[stop, None] * np.array([0.0, 1.0, 0.0])

        problem, truth = measured(36, DEMO_PLATE, seed, displaced=arriving)
        result = solve(problem)
        scatter = result.details["repeatability"][0]
        found.append(scatter["std"][1])
        assert bool(scatter["significant"][1]) == (size > 0.0)
        assert not scatter["significant"][2]
        repeatability = next(p for p in result.protections if p.effect == "repeatability")
        assert repeatability.treatment == "estimated"
        variance = result.covariance["EYC"].diagonal()  # both hold what the stops add
        np.testing.assert_allclose(result.std["EYC"] ** 2, variance, rtol=1e-9, atol=1e-20)
        off = np.abs(result.deviations["EYC"] - truth.component("EYC")) / result.std["EYC"]
        inside, total = inside + np.count_nonzero(off < 1.96), total + len(off)
    close = 0.15 if LONG else 0.3
    assert np.sqrt(np.mean(np.square(found))) == pytest.approx(size, rel=close, abs=1.5e-8)
    assert (0.9 if LONG else 0.86) < inside / total < (0.99 if LONG else 1.0)


@pytest.mark.slow
def test_groups_close_and_are_protected_each_for_itself():
    """Even steps only: two groups of table positions, each with its own zero."""
    balls = [0, 2, 6, 10, 14, 20]
    problem, _ = measured(24, balls, 1, separate_groups=True)
    found = solve(problem)
    assert [len(c["shift"]) for c in found.details["closure"]] == [3]
    assert found.details["closure"][0]["n_balls"] == 6
    assert "gauge" in found.unprotected
    bounded = solve(replace(problem, drift_allowance=1e-6))
    assert (bounded.std["EXC"] > found.std["EXC"]).all()


def test_all_nine_effects_and_those_of_plates_are_stated():
    problem, _ = measured(12, list(range(12)), 0)
    assert [p.effect for p in solve(problem).protections] == [
        *EFFECTS,
        "growth",
        "one place",
        "numbering",
        "sign of z",
    ]


def test_exact_centres_are_not_doubted_for_their_rounding():
    problem, _ = measured(12, list(range(12)), 0, noise=0.0)
    nominal = on_plate(12, problem.cmm_index)
    assert solve(replace(problem, centres=nominal)).verdict == "ok"


@pytest.mark.parametrize("sigma", [NOISE, None])
def test_what_the_exact_model_leaves_is_no_motion_of_the_plate(sigma):
    """Eight balls off centre by half a millimetre, seen in a frame tilted by a milliradian."""
    balls = np.array([0, 1, 5, 8, 10, 14, 17, 19])
    table, ball = np.repeat(np.arange(24), len(balls)), np.tile(balls, 24)
    places = on_plate(24, ball) + np.array([5e-4, 0.0, 0.0])
    turned = rotate_z(places, 2 * np.pi * table / 24)
    cosine, sine = np.cos(1e-3), np.sin(1e-3)
    tilt = np.array([[1.0, 0.0, 0.0], [0.0, cosine, -sine], [0.0, sine, cosine]])
    found = solve(BallPlateProblem(24, RADIUS, table, ball, turned @ tilt.T, sigma=sigma))
    assert not [text for text in found.warnings if "moved" in text or "drifts" in text]


def test_nonsense_about_drift_and_time_is_refused():
    problem, _ = measured(12, list(range(12)), 0)
    with pytest.raises(DataError, match="drift of degree 3"):
        replace(problem, drift=3)
    with pytest.raises(DataError, match="allowance"):
        replace(problem, drift_allowance=-1.0)
    with pytest.raises(DataError, match="time"):
        replace(problem, time=np.full(len(problem.centres), np.nan))
