"""A table that turns on while a nest follows its balls: the plan, and the simulated cell."""

from pathlib import Path

import numpy as np
import pytest

from rotcal_ros.foundation.observations import Approach
from rotcal_ros.foundation.units import ARCSEC, DEGREE
from rotcal_ros.methods import changed, prepare, prepare_to_measure, read_configuration
from rotcal_ros.methods.simulated_run import simulated_run
from rotcal_ros.methods.simulation.table import deviations

DEMO = Path(__file__).parents[3] / "config" / "table_balls_demo.yaml"
TURNING = (
    "plan.measure=displacement", "plan.closing=false", "plan.turning_deg_s=[20.0, -20.0]",
    "simulation.table.feedback_rate_hz=50.0", "solver.sigma_centre_m=0.2e-6",
)  # fmt: skip


def demo(*more):
    return changed(read_configuration(DEMO), (*TURNING, *more))


def test_each_run_turns_through_all_angles_once_for_each_ball():
    two = "plan.balls_m=[[0.15, 0.0, 0.08], [0.0, 0.15, 0.08]]"
    plan = prepare(demo("plan.table_positions=4", "plan.table_step_deg=90.0", two)).plan
    steps = plan.steps
    assert [(s.station, s.target, s.table_position) for s in steps] == [
        *((0, ball, k) for ball in (0, 1) for k in (0, 1, 2, 3)),
        *((1, ball, k) for ball in (0, 1) for k in (3, 2, 1, 0)),
    ]
    # on in the same sense a whole turn further, and back over the same angles
    degrees = [round(s.table_angle / DEGREE) for s in steps]
    assert degrees == [
        0, 90, 180, 270, 360, 450, 540, 630, 630, 540, 450, 360, 270, 180, 90, 0
    ]  # fmt: skip
    turns = {(s.turn.begin / DEGREE, s.turn.end / DEGREE, s.turn.speed / DEGREE) for s in steps}
    assert {tuple(np.round(turn, 9)) for turn in turns} == {
        (-15.0, 285.0, 20.0), (345.0, 645.0, 20.0), (645.0, 345.0, -20.0), (285.0, -15.0, -20.0)
    }  # fmt: skip
    assert [s.approach for s in steps] == [Approach.POSITIVE] * 8 + [Approach.NEGATIVE] * 8
    assert [plan.passed_from(k) for k in (0, 4, 8, 12)] == [range(k, k + 4) for k in (0, 4, 8, 12)]


@pytest.mark.parametrize("lag_s", [2e-3, 0.0, -5e-4])
def test_the_lag_of_the_linear_axes_is_found_by_both_directions(lag_s):
    """In the simulated cell; the deviations are not spoiled by it: 2 ms would be 144 arcsec."""
    configuration = demo(f"simulation.balls.nest_lag_s={lag_s}")
    calibration = prepare_to_measure(configuration)
    observed = [o for event in simulated_run(calibration, 10**18) for o in event.observed]
    assert len(observed) == 24
    assert all(o.accepted for o in observed), {o.reason for o in observed}
    std = np.array([o.std for o in observed])
    assert 0.5e-6 / np.sqrt(10.0) == pytest.approx(np.sqrt(np.mean(std**2)), rel=0.2)
    result = calibration.solve(observed)
    assert result.verdict == "ok", result.warnings
    lag = result.details["also"]["lag"]
    assert lag["value"][0] == pytest.approx(lag_s, abs=3.5 * lag["std"][0])
    assert lag["std"][0] < 2e-6
    one_way = calibration.solve(observed[:12])  # as of a calibration that was interrupted
    assert one_way.details["also"]["lag"]["std"][0] == pytest.approx(1e-3, rel=0.01)
    assert [p.treatment for p in one_way.protections if p.effect == "lag"] == ["harmless"]
    true = deviations(configuration.simulation.table, np.array(result.angles))["ECC"]
    away = result.deviations["ECC"] - (true - true.mean())
    assert np.abs(away / result.std["ECC"]).max() < 3.5
    (x, y, _), lean = (
        configuration.simulation.table.axis_offset_m,
        np.array(configuration.simulation.table.axis_tilt_arcsec) * ARCSEC,
    )
    height, axis = configuration.plan.axis_m[2], result.axes[0]
    line = [x + height * lean[1], y - height * lean[0], *lean]
    assert np.abs((axis.value - line) / axis.std).max() < 3.5


def test_a_run_up_that_is_too_short_is_told_and_the_run_turned_again():
    configuration = demo(
        "plan.run_up_deg=1.5", "simulation.table.acceleration_deg_s2=20.0",
        "plan.table_positions=4", "plan.table_step_deg=90.0",
    )  # fmt: skip
    run = simulated_run(prepare_to_measure(configuration), 10**18, attempts=2)
    observed = [o for event in run for o in event.observed]
    refused = sorted((o.station, o.table_position, o.attempt) for o in observed if not o.accepted)
    ends = ((0, 0), (0, 3), (1, 3), (1, 0))  # it does not yet, or no longer turn as it should
    assert refused == sorted((run, at, number) for run, at in ends for number in (0, 1))
    assert "is plan.run_up_deg long enough" in observed[0].reason
    assert sum(o.accepted for o in observed) == 8  # each turn was made twice
