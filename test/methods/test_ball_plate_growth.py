"""A plate that warms while it is measured: predicted, found, and named by its cause.

The growth is written down once more, as displacements of the rows along the radius of their ball.
"""

from dataclasses import replace

import numpy as np
import pytest
from chances import LONG, most
from plate_data import RADIUS, parse_plate
from plate_disturbed import DEMO_PLATE, ORDERS, caused, drifted, knocked, measured, on_plate

from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.units import MICROMETRE
from rotcal_ros.methods.ball_plate.materials import EXPANSION, kelvin
from rotcal_ros.methods.ball_plate.measuring_order import plan_measurement
from rotcal_ros.methods.ball_plate.solver import solve
from rotcal_ros.methods.ball_plate.solver.estimate import solved
from rotcal_ros.methods.ball_plate.solver.growth import GrowthTest, find_growth, unit_growth
from rotcal_ros.methods.ball_plate.solver.problem import BallPlateProblem

SMALL = [0, 1, 3, 5, 8, 9]
BALLS = {12: SMALL, 36: DEMO_PLATE}
STEEL = 11.5e-6
HALF_A_KELVIN = 0.5 * STEEL
OPEN = {"order": "table_once", "closing": False}


def grown(grid, growth):
    """Return what moves the rows: each ball away from the middle, more from row to row."""

    def displaced(table, ball):
        share = np.linspace(0.0, 1.0, len(table))
        return growth * share[:, None] * on_plate(grid, (table + ball) % grid)

    return displaced


def told(result):
    return [text for text in result.warnings if "the plate grew" in text or "shrank" in text]


@pytest.mark.parametrize("order", [*ORDERS, "open"])
@pytest.mark.parametrize("grid", BALLS)
def test_the_predicted_error_is_that_of_a_simulated_run(order, grid):
    """A perfect table, machine and plate: the six deviations are what the growth makes of them."""
    how = {**ORDERS, "open": OPEN}[order] | {"closing": False}
    rows = plan_measurement(grid, BALLS[grid], **how)
    table, ball, row = rows.position, rows.ball_step, np.arange(len(rows.position))
    places = on_plate(grid, (table + ball) % grid)
    warm = places + grown(grid, HALF_A_KELVIN)(table, ball)
    linear, solution = solved(BallPlateProblem(grid, RADIUS, table, ball, warm, row=row))
    unit = unit_growth(BallPlateProblem(grid, RADIUS, table, ball, places, row=row), linear, None)
    predicted = HALF_A_KELVIN * unit.response[:, :, 0]
    largest = np.abs(predicted).max()
    assert largest > 1e-9
    np.testing.assert_allclose(solution.estimate.curves(), predicted, rtol=0, atol=1e-3 * largest)


@pytest.mark.parametrize("order", ORDERS)
def test_a_warm_plate_is_suspect_and_named_by_kelvin_of_its_material(order):
    n = len(plan_measurement(12, SMALL, **ORDERS[order], closing=False).position)
    rows = len(plan_measurement(12, SMALL, **ORDERS[order]).position)
    others, runs = 0, 20 if LONG else 4
    for seed in range(runs):
        problem, _ = measured(
            12, SMALL, seed, ORDERS[order], displaced=grown(12, HALF_A_KELVIN), material="steel"
        )
        result = solve(problem)
        (growth,) = result.details["growth"]
        # the fit has all rows but those that close
        expected = HALF_A_KELVIN * (n - 1) / (rows - 1)
        assert growth["amount"] == pytest.approx(expected, abs=5.0 * growth["std"])
        assert growth["kelvin"] == pytest.approx(growth["amount"] / STEEL)
        assert result.verdict == "suspect"
        assert len(told(result)) == 1
        assert "as steel does that warms by 0." in told(result)[0]
        others += len(result.warnings) > 1 or bool(result.rejected)
    assert others <= most(0.02, runs), "nothing else is to blame"


@pytest.mark.slow
@pytest.mark.parametrize("order", ORDERS)
def test_a_plate_that_keeps_its_temperature_is_seldom_said_to_grow(order):
    runs = 300 if LONG else 25
    named = sum(bool(told(solve(measured(12, SMALL, s, ORDERS[order])[0]))) for s in range(runs))
    assert named <= most(0.01, runs)


@pytest.mark.parametrize("order", ORDERS)
def test_what_is_not_noticed_does_little(order):
    """The protection states the largest error that stays unseen; smaller growths do less."""
    clean, _ = measured(36, DEMO_PLATE, 1, ORDERS[order])
    plain = solve(clean)
    (stated,) = (p for p in plain.protections if p.effect == "growth")
    assert stated.treatment == "tested"
    assert stated.error < 0.3
    assert "growth" not in plain.unprotected
    for growth in (0.05e-6, 0.1e-6, 0.2e-6):
        problem, _ = measured(36, DEMO_PLATE, 1, ORDERS[order], displaced=grown(36, growth))
        assert told(solve(problem)) or caused(solve(problem), plain) < 0.3


def test_drift_knock_and_dirt_are_not_called_growth():
    for displaced in (
        lambda i, _: drifted(len(i), [3e-6, 0.0, 0.0]),
        lambda i, j: knocked(36, i, j, 200),
    ):
        problem, _ = measured(36, DEMO_PLATE, 2, displaced=displaced)
        result = solve(problem)
        assert result.verdict != "ok"
        assert not told(result)
    problem, _ = measured(36, DEMO_PLATE, 2, displaced=grown(36, HALF_A_KELVIN))
    dirty = problem.centres.copy()
    dirty[100] += [0.0, 8e-6, 0.0]
    result = solve(replace(problem, centres=dirty))
    assert [r.index for r in result.rejected] == [int(problem.rows[100])]
    assert told(result)


def test_a_ball_that_is_dirty_at_the_end_is_no_growth():
    problem, _ = measured(36, DEMO_PLATE, 5)
    outward = on_plate(36, problem.cmm_index)
    last = int(np.argmax(problem.rows))
    centres = problem.centres.copy()
    centres[last] += 5e-6 * outward[last] / RADIUS
    result = solve(replace(problem, centres=centres))
    assert result.verdict == "ok"
    assert result.details["closure"][0]["n_gross"] == 1


def test_the_order_tells_from_which_size_a_growth_is_found():
    """Where every ball comes to a CMM position at one time, the closing rows show it alone."""
    plan = plan_measurement(36, DEMO_PLATE, order="probe_rests", closing=False)
    problem = BallPlateProblem.nominal(
        36, RADIUS, plan.position, plan.ball_step, row=np.arange(432)
    )
    linear, _ = solved(problem)
    alone = unit_growth(problem, linear, None)
    again = BallPlateProblem.nominal(
        36, RADIUS, np.zeros(12, dtype=int), np.array(DEMO_PLATE), row=432 + np.arange(12)
    )
    found = unit_growth(problem, linear, again)
    assert found.seen.information[0, 0] < 1e-3 * found.seen.whole[0]
    assert alone.closing[0, 0] == 0.0
    # 12 balls moved outward by up to RADIUS, less what a motion of the plate explains
    assert 0.3 * 6.0 * RADIUS**2 < found.closing[0, 0] < 6.0 * RADIUS**2


def test_without_noise_nothing_grows():
    problem, _ = measured(36, DEMO_PLATE, 4, {"closing": False}, 0.0)
    growth = find_growth(problem, *solved(problem))
    assert growth.test.p_value > 0.01
    assert not growth.evident


@pytest.mark.parametrize(
    ("material", "amount", "words"),
    [
        ("steel", 5.75e-6, "grew by 5.75 +- 0.2 um/m over the run, as steel does that warms by "
         "0.5 K"),
        ("aluminium", -11.8e-6, "shrank by 11.8 +- 0.2 um/m over the run, as aluminium does that "
         "cools by 0.5 K"),
        ("", 5.75e-6, "grew by 5.75 +- 0.2 um/m over the run, plan.plate.material would give"),
        ("zerodur", 5.75e-6, "zerodur does not with 20 K: the machine's scales changed"),
    ],
)  # fmt: skip
def test_the_sentence_says_what_it_takes(material, amount, words):
    assert words in GrowthTest.of(amount, 1e-7, 1e-9, material).sentence()


def test_kelvin_of_every_material_and_none_of_another():
    assert kelvin(STEEL, "steel") == 1.0
    assert kelvin(STEEL, "") is None
    assert all(0.0 < expansion < 30.0 * MICROMETRE for expansion in EXPANSION.values())


def test_a_material_that_is_not_known_names_those_that_are():
    entries = {"grid": 12, "ball_steps": SMALL, "circle_radius_m": 0.2, "ball_diameter_m": 0.02}
    assert parse_plate({**entries, "material": "invar"}, "plate").material == "invar"
    with pytest.raises(ConfigurationError, match=r"'stel' is none of .*steel.*zerodur.*cfrp"):
        parse_plate({**entries, "material": "stel"}, "plate")
