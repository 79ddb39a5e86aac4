"""Drift of the CMM and knocks of the plate: what an order of measurement shows, and what it costs.

The disturbances are written down once more, in plate_disturbed.py, as displacements of the rows.
"""

from dataclasses import replace

import numpy as np
import pytest
from chances import LONG, most
from plate_data import RADIUS, rotate_z
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

from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.protection import EFFECTS
from rotcal_ros.methods.ball_plate.measuring_order import plan_measurement
from rotcal_ros.methods.ball_plate.solver import solve
from rotcal_ros.methods.ball_plate.solver.problem import BallPlateProblem


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
            assert "drift" in [e["effect"] for e in found.details["effects_found"]]
            assert any("drifts" in warning for warning in found.warnings)


def test_without_closure_one_turn_says_what_it_hides():
    order = {"order": "table_once", "closing": False}
    problem, truth = measured(
        36, DEMO_PLATE, 3, order, displaced=lambda i, _: drifted(len(i), [1e-6, 0.0, 0.0])
    )
    found = solve(problem)
    assert {"drift", "knock", "repeatability"} & set(found.unprotected) or found.verdict != "ok"
    assert found.verdict != "ok" or errors(found, truth).max() > 7.0


def test_good_data_in_the_default_order_are_protected_from_drift_and_knock():
    doubted = 0
    seeds = 40 if LONG else 6
    for seed in range(seeds):
        problem, _ = measured(36, DEMO_PLATE, seed)
        found = solve(problem)
        assert not {"drift", "knock"} & set(found.unprotected)
        doubted += found.verdict != "ok"
    assert doubted <= most(0.03, seeds)  # three tests at 1 %


@pytest.mark.slow
def test_groups_close_and_are_protected_each_for_itself():
    """Even steps only: two groups of table positions, each with its own zero."""
    balls = [0, 2, 6, 10, 14, 20]
    problem, _ = measured(24, balls, 1, separate_groups=True)
    found = solve(problem)
    assert "gauge" in found.unprotected
    bounded = solve(replace(problem, drift_allowance=1e-6))
    assert (bounded.std["EXC"] > found.std["EXC"]).all()


def test_a_plate_that_moved_before_the_first_position_is_measured_again_is_doubted():
    moved, _ = measured(
        36, DEMO_PLATE, 5,
        displaced=lambda i, _: np.where(np.arange(len(i))[:, None] >= 432, [0.0, 4e-7, 0.0], 0.0),
    )  # fmt: skip
    assert solve(moved).verdict == "suspect"


def test_all_nine_effects_and_those_of_plates_are_stated():
    problem, _ = measured(12, list(range(12)), 0)
    assert [p.effect for p in solve(problem).protections] == [
        *EFFECTS,
        "growth",
        "one place",
        "single readings",
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
