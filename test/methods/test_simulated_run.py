"""A run of the simulated cell, and the same with what spoils it: what the method then finds."""

from pathlib import Path

import numpy as np
import pytest

import rotcal_ros as rc
from rotcal_ros.foundation.observations import Command
from rotcal_ros.methods import prepare
from rotcal_ros.methods.disturbance import DisturbedMeasurement
from rotcal_ros.methods.simulated_run import disturb_events, simulated_run, visible_truth

FOLDER = Path(__file__).parents[2] / "research" / "data_set"
each_plan = pytest.mark.parametrize("plan", ["tracer", "tracer_six", "ball_plate", "plane_mirror"])


@pytest.fixture(scope="module")
def runs():
    """Return calibration and events of each plan, made once."""
    found = {}

    def run(plan):
        if plan not in found:
            calibration = prepare(rc.read_configuration(FOLDER / f"{plan}.yaml"))
            found[plan] = calibration, list(simulated_run(calibration))
        return found[plan]

    return run


def observations_of(calibration, events):
    capture = calibration.capture()
    records = (event.what for event in events if not isinstance(event.what, Command))
    return [found for record in records for found in capture.feed(record)]


def pulls(result, truth):
    """Return the errors of each component, in standard uncertainties of their mean-free part."""
    for name, found in result.deviations.items():
        error, keep = found - truth[name], np.eye(len(found)) - 1.0 / len(found)
        std = np.sqrt(np.diag(keep @ result.covariance[name] @ keep))
        yield keep @ error / std


@each_plan
@pytest.mark.slow
def test_a_run_orders_every_step_once_and_shows_the_simulated_table(plan, runs):
    calibration, events = runs(plan)
    orders = [event.what.step for event in events if isinstance(event.what, Command)]
    assert orders == list(range(len(calibration.plan.steps)))
    result = calibration.solve([o for event in events for o in event.observed])
    largest = max(np.abs(pull).max() for pull in pulls(result, visible_truth(calibration)))
    assert largest < 4.5


@each_plan
@pytest.mark.slow
def test_a_measurement_without_error_changes_nothing(plan, runs):
    calibration, events = runs(plan)
    exact = DisturbedMeasurement(calibration.nominal_observations(), {})
    same = disturb_events(events, calibration, exact)
    assert all(a[:3] == b[:3] for a, b in zip(events, same, strict=True))


@each_plan
@pytest.mark.slow
def test_what_was_measured_is_in_the_readings(plan, runs):
    calibration, events = runs(plan)
    effect = "error motion" if plan in ("tracer_six", "ball_plate") else "gauge"
    size = {"error motion": 2e-6, "gauge": 100.0 * rc.ARCSEC}[effect]
    measured = calibration.measured({effect: size}, 5)
    found = observations_of(calibration, disturb_events(events, calibration, measured))
    before = [o for event in events for o in event.observed]
    nominal = calibration.nominal_observations()
    for was, now, exact, wanted in zip(before, found, nominal, measured.observations, strict=True):
        moved, shift = (
            np.subtract(*pair) for pair in ((now.mean, was.mean), (wanted.mean, exact.mean))
        )
        assert np.linalg.norm(moved) == pytest.approx(np.linalg.norm(shift), abs=2e-8)
    result, truth = calibration.solve(found), visible_truth(calibration, measured)
    assert max(np.sqrt(np.mean(pull**2)) for pull in pulls(result, truth)) < 2.0
