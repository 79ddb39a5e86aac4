"""What until_goal says when things go wrong, on the simulated cell's streams, without ROS."""

import re
from dataclasses import replace
from pathlib import Path

import pytest

from rotcal_ros.methods import changed, prepare, read_configuration
from rotcal_ros.planning.choices import StepOutcome

PAPER = Path(__file__).parents[2] / "config" / "tracer_paper.yaml"
SHORT = (
    "plan.table_positions=11",
    "plan.box_points=[4, 3, 3]",
    "planner.policy=until_goal",
    "planner.goal_arcsec=4.0",
    "planner.expected_std_m=0.54e-7",  # half of what the lengths scatter
    "solver.zero=per_segment",
    "simulation.temperature.drift_k_per_h=90.0",  # and with it the dead path
    "simulation.faults.spike_probability=0.0",
    "simulation.faults.dropout_probability=0.0",
    "simulation.faults.blocked_targets=[40]",  # none of them
)
WRONG_NUMBER, WRONG_M = 12, 30e-6
TICK_S = 0.02
MOST = 200


def observed(cell, capture, step, attempt):
    """Order a step and return its observation."""
    command = step.command(attempt)
    cell.order_table(command)
    cell.order_probe(command)
    found = ()
    while not found:
        out = cell.advance(TICK_S)
        for sample in (*out.temperature, *out.table, *out.probe, *out.tracer):
            found += capture.feed(sample)
    return found[0]


@pytest.mark.slow
def test_the_reasons_name_a_wrong_length_a_drift_and_the_noise():
    calibration = prepare(changed(read_configuration(PAPER), SHORT))
    cell = calibration.method.simulated_cell(calibration.configuration.simulation)
    capture = calibration.capture()
    policy, choices = calibration.policy(calibration.first_run()), []
    while len(choices) < MOST:
        choices.append(policy.choose())
        step = choices[-1].step
        if step is None:
            break
        attempt = sum(choice.step == step for choice in choices)
        seen = observed(cell, capture, calibration.plan.steps[step], attempt)
        assert seen.accepted, seen.reason
        if len(choices) == WRONG_NUMBER:
            seen = replace(seen, mean=(seen.mean[0] + WRONG_M,))
        policy.note(StepOutcome(step, seen))

    wrong = choices[WRONG_NUMBER - 1].step
    reasons = [choice.reason for choice in choices]
    suspect = [choice for choice in choices if "is suspect (" in choice.reason]
    assert wrong in {choice.step for choice in suspect}
    why = r"station \d+, target \d+: (far off all others|its test value [+-]\d+\.\d is beyond .*)"
    assert re.search(rf"suspect \({why}\): measured ag", suspect[0].reason)
    drift = r"it looks as if .* drift.*: measured again to close the sweep"
    assert sum(bool(re.match(drift, reason)) for reason in reasons) == 2
    noise = re.search(r"noise ([\d.]+) times the planned", reasons[-1])
    assert noise is not None
    assert float(noise[1]) == pytest.approx(2.0, rel=0.1)
    assert reasons[-1].startswith("goal reached: U ")
    assert re.search(r"; closed: step \d+ by [+-]\d+\.\d\d um, ", reasons[-1])
