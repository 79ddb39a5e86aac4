"""The plan of a table that turns under a tracer at three places, its time, and a simulated run."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rotcal_ros.foundation.errors import PlanError
from rotcal_ros.methods import changed, prepare, prepare_to_measure, read_configuration
from rotcal_ros.methods.dry_run import DryRun
from rotcal_ros.methods.simulated_run import simulated_run, visible_truth
from rotcal_ros.methods.tracer_six.plan import six_plan
from rotcal_ros.methods.tracer_six.settings import SixPlanSettings

DEMO = Path(__file__).parents[3] / "config" / "tracer_six_turning_demo.yaml"
SMALL = SixPlanSettings(
    table_positions=4,
    table_step_deg=90.0,
    turning_deg_s=(12.0, -12.0),
    targets_m=(0.5, 0.0, 0.3, 0.0, 0.5, 0.7, -0.5, 0.0, 0.3, 0.0, -0.5, 0.7),
)


def made(*changes):
    return prepare_to_measure(changed(read_configuration(DEMO), changes))


def test_every_target_is_measured_from_every_place_in_a_turn_each_way():
    plan = six_plan(SMALL)
    assert len(plan.steps) == 3 * 4 * 2 * (1 + 4)
    assert [s.table_position for s in plan.steps[:10]] == [0, 0, 1, 2, 3, 7, 7, 6, 5, 4]
    assert [s.turn is None for s in plan.steps[:10]] == [True, *4 * [False]] * 2
    assert [s.station for s in plan.steps] == [*40 * [0], *40 * [1], *40 * [2]]
    assert [s.target for s in plan.steps[:40:10]] == [0, 1, 2, 3]
    assert plan.passed_from(6) == range(6, 10)
    for step in plan.steps:
        if step.turn is not None:
            assert step.table_angle == plan.table_angles[step.table_position]
    assert plan.table_angles == plan.distinct_angles * 2
    assert [(pause.first, pause.last) for pause in plan.pauses] == [(0, -1), (40, 39), (80, 79)]
    assert "it will measure 4 targets at 4 table angles" in plan.pauses[0].instruction


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"bidirectional": True}, "leave out bidirectional and arrivals"),
        ({"arrivals": 2}, "leave out bidirectional and arrivals"),
        ({"turning_deg_s": (12.0, 0.0)}, "a table that turns has a speed"),
        ({"run_up_deg": 0.4}, "leaves the table no way"),
        ({"places": 2}, "a turn of the table about the line through them"),
    ],
)
def test_a_plan_that_asks_for_stops_or_shows_too_little_is_refused(changes, why):
    with pytest.raises(PlanError, match=why):
        six_plan(replace(SMALL, **changes))


def test_what_a_cell_cannot_turn_is_refused():
    with pytest.raises(PlanError, match="longer than planner"):
        made("plan.turning_deg_s=[0.4, -0.4]")
    with pytest.raises(PlanError, match="3 targets: every turn counts from a zero of its own"):
        made("plan.targets_m=[0.48, 0.15, 0.32, -0.15, 0.48, 0.72, -0.48, -0.15, 0.32]")


def test_360_angles_from_three_places_take_less_than_20_minutes():
    """24 turns of 389 deg at 12 deg/s, 5 s at rest before each, and 90 s for each of 3 places."""
    calibration = made(
        "plan.table_positions=360", "plan.table_step_deg=1.0", "plan.run_up_deg=15.0",
        "plan.passing_deg=0.5", "plan.turning_deg_s=[12, -12]",
    )  # fmt: skip
    first = calibration.plan.steps[0]
    seconds, why = DryRun(calibration, first.table_angle).time_estimate()
    assert seconds == pytest.approx(24 * (389.0 / 12.0 + 5.0) + 3 * 90.0, rel=1e-9)
    assert seconds < 20 * 60
    assert "90 s for a pause (planner.pause_s)" in why


@pytest.mark.slow
def test_a_simulated_table_is_captured_in_its_turns_and_solved():
    calibration = made(
        "plan.table_positions=12", "plan.table_step_deg=30.0", "plan.passing_deg=2.0",
        "plan.turning_deg_s=[90, -90]", "plan.run_up_deg=35.0",
        "simulation.tracer.rate_hz=250.0",
        "simulation.table.feedback_rate_hz=100.0", "capture.window_samples=10",
        "simulation.table.speed_deg_s=120.0",
    )  # fmt: skip
    observations = [o for event in simulated_run(calibration) for o in event.observed]
    refused = [o.reason for o in observations if not o.accepted]
    assert not refused
    assert len(observations) == 24 * (1 + 12)
    result = calibration.solve(observations)
    assert result.verdict == "ok", result.warnings
    true = visible_truth(calibration)
    for name, values in true.items():
        error = (result.deviations[name] - values) / result.std[name]
        assert np.abs(error).max() < 4.5, name
    assert result.details["turning"]["lag"] == pytest.approx(1e-3, abs=2e-5)


def test_the_demonstration_is_prepared_for_a_table_of_what_it_measures():
    calibration = prepare(read_configuration(DEMO))
    assert len(calibration.plan.counting) == 3 * 4 * 2 * 120


@pytest.mark.slow
def test_a_calibration_taken_up_again_in_the_middle_of_a_place_is_one():
    calibration = made("plan.table_positions=24", "plan.table_step_deg=15.0").of_distances
    seen = [
        o for o in calibration.measured({}, 2).observations if calibration.plan.steps[o.step].turn
    ]
    leg = len(calibration.plan.steps) * 4 // 8  # the third target at the second place
    whole = calibration.solve(seen)
    again = calibration.solve([replace(o, run=int(o.step >= leg)) for o in seen])
    for name, values in whole.deviations.items():
        np.testing.assert_allclose(
            again.deviations[name], values, atol=1e-3 * whole.std[name].max()
        )
    # of the turn in which it ended, some lengths are there twice
    begun = [replace(o, mean=(o.mean[0] + 2e-3,)) for o in seen if leg <= o.step < leg + 9]
    twice = [*(o for o in seen if o.step < leg), *begun,
             *(replace(o, run=1) for o in seen if o.step >= leg)]  # fmt: skip
    result = calibration.solve(twice)
    assert result.verdict == whole.verdict
    assert result.n_observations == len(seen) + len(begun)
    assert not result.rejected
    for name, values in whole.deviations.items():
        assert np.abs(result.deviations[name] - values).max() < 0.5 * whole.std[name].max()
