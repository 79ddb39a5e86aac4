"""Nodes are killed in the middle of a run and started again: the result is that of all of it."""

import os
import re
import sys
from pathlib import Path

import pytest
from known_truth import require_injected_truth
from live_cell import SUITE, LiveCell, wait_until

from rotcal_ros.methods import prepare
from rotcal_ros.methods.configuration import changed, read_configuration
from rotcal_ros.recordings.replay import read_recording

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")
pytestmark = pytest.mark.ros

NODE_LOST = 603
PLATE = (
    "plan.plate.grid=12", "plan.plate.ball_steps=[0, 1, 3, 5, 8, 9]", "plan.rounds=1",
    "simulation.plate.grid=12", "simulation.plate.ball_steps=[0, 1, 3, 5, 8, 9]",
)  # fmt: skip
SIX = ("plan.table_positions=3", "plan.table_step_deg=120.0", "plan.box_points=[2, 2, 2]")


def killed(live, *names):
    for name in names:
        live.kill(name)
    wait_until(lambda: set(names) <= live.processes.ended().keys(), "they are dead")


def restarted(live, *names):
    killed(live, *names)
    live.start(*names)


def check(live, outcome, runs, steps):
    """The result is true, from all steps, and offline the same to the last bit; return it."""
    assert outcome["error_code"] == 0, outcome["error_msg"]
    assert outcome["verdict"] == "ok"
    assert outcome["n_used"] == steps
    recording = read_recording(live.bag)
    assert recording.same_as_recorded
    assert {o.run for o in recording.observations} == set(range(runs))
    result = recording.calibration.solve(recording.observations, recording.announced)
    assert result.to_json() == (live.session / "result.json").read_text()
    require_injected_truth(prepare(read_configuration(live.file)), result)
    return result


@pytest.mark.slow
def test_a_goal_waits_for_nodes_of_the_suite_that_were_killed_and_goes_on(cell):
    live = cell()
    live.restart_wait_s = 20.0
    live.start(*SUITE, "simulated_cell")
    client = live.client()
    client.wait_for_step(8)
    restarted(live, "solver")
    client.wait_for_step(20)
    restarted(live, "capture")
    client.wait_for_step(34)
    restarted(live, "recorder", "solver")
    outcome = client.result()
    assert len(check(live, outcome, 3, 59).details["joins"]) == 2


@pytest.mark.slow
def test_start_index_joins_what_was_measured_before_an_instrument_was_started_anew(cell):
    live = cell("simulation.time_scale=8.0", "simulation.tracer.zero_shift_um=1000.0")
    live.start(*SUITE, "simulated_cell")
    client = live.client()
    client.wait_for_step(24)
    killed(live, "simulated_cell")
    outcome = client.result()
    assert outcome["error_code"] == NODE_LOST, outcome["error_msg"]
    start = int(re.search(r"continue with start_index (\d+)$", outcome["error_msg"])[1])
    restarted(live, "planner", "recorder")  # nor do these have to be the same
    live.start("simulated_cell")
    rest = live.client("rest", start_index=start)
    (join,) = check(live, rest.result(), 2, 59).details["joins"]
    assert abs(join["offset_m"]) > 10 * join["offset_std_m"]  # a new zero after every start


def followed(client, live, name, accepted=float("inf")):
    """Do a person's work in every pause; return the result, or where so much was accepted."""
    while True:
        event = client.wait_for("paused", "feedback", "result")
        if event["event"] == "paused":
            live.processes.tell(name, "resume")
        elif event["event"] == "result" or event["accepted"] >= accepted:
            return event


@pytest.mark.long
@pytest.mark.parametrize(
    ("file", "changes"),
    [("ball_plate_demo", PLATE), ("tracer_six_demo", SIX), ("plane_mirror_demo", ())],
)
def test_other_methods_go_on_too(tmp_path, monkeypatch, file, changes):
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, sys.path)))
    configuration = read_configuration(Path(__file__).parents[2] / "config" / f"{file}.yaml")
    live = LiveCell(tmp_path, changed(configuration, (*changes, "planner.preflight_timeout_s=20")))
    try:
        live.start(*SUITE, "simulated_cell")
        client = live.client()
        followed(client, live, "client", accepted=30)
        killed(live, "simulated_cell", "capture")
        outcome = followed(client, live, "client")
        assert outcome["error_code"] == NODE_LOST, outcome["error_msg"]
        start = int(re.search(r"continue with start_index (\d+)$", outcome["error_msg"])[1])
        live.start("simulated_cell", "capture")
        outcome = followed(live.client("rest", start_index=start), live, "rest")
        check(live, outcome, 2, len(prepare(read_configuration(live.file)).plan.steps))
    finally:
        live.processes.end()
