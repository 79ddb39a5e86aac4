"""A plate that warms while it is measured: predicted, found, and named by its cause.

The growth is written down once more, as displacements of the rows along the radius of their ball.
"""

from dataclasses import replace

import numpy as np
import pytest
from chances import LONG, most
from coded import coded
from plate_data import RADIUS, parse_plate
from plate_disturbed import DEMO_PLATE, ORDERS, caused, drifted, knocked, measured, on_plate

from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.units import MICROMETRE
from rotcal_ros.methods.ball_plate.settings import EXPANSION, kelvin
from rotcal_ros.methods.ball_plate.solver import solve
from rotcal_ros.methods.ball_plate.solver.plate_model import GREW
from rotcal_ros.methods.ball_plate.solver.result import PLATE_GREW

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
    return [text for text in result.warnings if {GREW, PLATE_GREW} & coded(text).keys()]


@pytest.mark.parametrize("order", ORDERS)
def test_a_warm_plate_is_suspect_and_named_by_kelvin_of_its_material(order):
    others, runs = 0, 20 if LONG else 4
    for seed in range(runs):
        problem, _ = measured(
            12, SMALL, seed, ORDERS[order], displaced=grown(12, HALF_A_KELVIN), material="steel"
        )
        result = solve(problem)
        (growth,) = result.details["effects_found"]
        assert growth["effect"] == "growth"
        assert growth["size"] == pytest.approx([HALF_A_KELVIN], abs=5.0 * growth["std"][0])
        assert result.verdict == "suspect"
        assert len(told(result)) == 2
        assert "as steel does that warms by 0." in told(result)[0]
        others += len(result.warnings) > 2 or bool(result.rejected)
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
    assert stated.treatment in ("tested", "harmless")
    assert (stated.error or 0.0) < 1.0
    assert "growth" not in plain.unprotected
    for growth in (0.05e-6, 0.1e-6, 0.2e-6):
        problem, _ = measured(36, DEMO_PLATE, 1, ORDERS[order], displaced=grown(36, growth))
        assert told(solve(problem)) or caused(solve(problem), plain) < 1.0


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
    assert not told(result)
    assert [r.index for r in result.rejected] == [int(problem.rows[last])]


@pytest.mark.parametrize(
    ("material", "words"),
    [
        ("aluminium", "over the run, as aluminium does that warms by 0.2"),
        ("", "over the run, plan.plate.material would give"),
        ("zerodur", "zerodur does not with 20 K: the machine's scales changed"),
    ],
)
def test_the_sentence_says_what_it_takes(material, words):
    problem, _ = measured(12, SMALL, 1, displaced=grown(12, HALF_A_KELVIN), material=material)
    assert any(words in text for text in solve(problem).warnings)


def test_kelvin_of_every_material_and_none_of_another():
    assert kelvin(STEEL, "steel") == 1.0
    assert kelvin(STEEL, "") is None
    assert all(0.0 < expansion < 30.0 * MICROMETRE for expansion in EXPANSION.values())


def test_a_material_that_is_not_known_names_those_that_are():
    entries = {"grid": 12, "ball_steps": SMALL, "circle_radius_m": 0.2, "ball_diameter_m": 0.02}
    assert parse_plate({**entries, "material": "invar"}, "plate").material == "invar"
    with pytest.raises(ConfigurationError, match=r"'stel' is none of .*steel.*zerodur.*cfrp"):
        parse_plate({**entries, "material": "stel"}, "plate")
