"""Solver and trials side by side, for every method: they confirm, and they contradict."""

from dataclasses import replace

import numpy as np
import one_table
import pytest
from two_groups import plate_problem

from rotcal_ros.evaluation.monte_carlo import PropagatedResult, propagate
from rotcal_ros.methods.ball_plate import solver as ball_plate
from rotcal_ros.methods.plane_mirror import solver as plane_mirror
from rotcal_ros.methods.tracer import solver as tracer


def prepared(method):
    rng = np.random.default_rng(2)
    if method == "tracer":
        problem = one_table.by_tracer(one_table.table_deviations(8, rng), rng)
        return tracer.solve(problem), tracer.adjust(problem).trials
    if method == "plate":
        table = one_table.table_deviations(12, rng)
        problem = one_table.by_ball_plate(table, rng, (0, 1, 3, 7))
        return ball_plate.solve(problem), ball_plate.plate_trials(problem)
    problem = one_table.by_mirror(one_table.table_deviations(12, rng), rng, stations=4)
    return plane_mirror.solve(problem), plane_mirror.mirror_trials(problem)


@pytest.fixture(scope="module", params=["tracer", "plate", "mirror"])
def both(request):
    result, trials = prepared(request.param)
    return PropagatedResult(result, propagate(trials, seed=4, max_trials=4000, block=1000), 4)


@pytest.mark.slow
def test_trials_confirm_the_solver(both):
    assert both.warnings == ()
    assert list(both.components) == list(both.result.deviations)
    for name, part in both.components.items():
        np.testing.assert_array_equal(part.value, both.result.deviations[name])
        measured = part.linear_std > 0.0
        np.testing.assert_allclose(part.std[measured], part.linear_std[measured], rtol=0.08)
    assert "confirm the solver's uncertainty" in both.describe()


def test_an_uncertainty_that_is_too_small_is_contradicted_and_named(both):
    halved = {name: values / 2.0 for name, values in both.result.std.items()}
    told = PropagatedResult(replace(both.result, std=halved), both.spread, both.seed)
    assert len(told.warnings) >= len(both.result.angles) - 2
    assert any(text.startswith("ECC at 30 deg (arcsec): ") or "ECC at 45 deg" in text
               for text in told.warnings)  # fmt: skip
    assert "CONTRADICT" in told.describe()


def test_plain_form_holds_everything(both):
    data = both.to_dict()
    assert data["trials"] == both.spread.trials
    for name, part in data["components"].items():
        assert len(part["low"]) == len(data["angles_rad"])
        inside = np.array(part["low"]) <= both.result.deviations[name]
        assert inside.all()


@pytest.mark.slow
def test_trials_do_not_hide_an_offset_that_none_of_them_tells():
    problem = plate_problem()
    told = PropagatedResult(
        ball_plate.solve(problem),
        propagate(ball_plate.plate_trials(problem), seed=1, max_trials=40, block=20),
        1,
    )
    assert "the odd and even table positions is not measured" in told.describe()
    assert told.to_dict()["open_zeros"] == told.result.zeros.describe()
