"""Whole calibrations of the simulated cell over DDS."""

import json
import signal

import numpy as np
import pytest
from bag_readers import read_by_all
from live_cell import SUITE, published, wait_until

from rotcal_ros.bags import names
from rotcal_ros.bags.storage_scan import FileVerdict
from rotcal_ros.methods.configuration import parse_configuration
from rotcal_ros.methods.simulation.table import true_deviations
from rotcal_ros.recordings.replay import read_recording

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")
from action_msgs.msg import GoalStatus
from state_client import StateClient

pytestmark = pytest.mark.ros

BAD_CONFIGURATION, TOPIC_MISSING, NODE_LOST, CANCELED = 601, 602, 603, 607


def verdicts(live) -> tuple[FileVerdict, ...]:
    return read_recording(live.bag).verdicts


def action_of(live):
    """Return goal, progress and status of the action as rosbags reads them from the bag."""
    topics = names.GOAL, names.PROGRESS, names.GOAL_STATUS
    return [published(live.bag, f"/cell/{name}") for name in topics]


def check_goal(asked, told):
    """The goal that was asked for is the one that was followed."""
    (goal,) = asked
    assert bytes(goal.goal_id.uuid) == bytes(told[-1].goal_id.uuid)
    assert (goal.start_index, goal.header.stamp.sec > 0) == (0, True)


def test_a_calibration_ends_with_a_true_result_that_the_bag_repeats_bit_for_bit(cell):
    live = cell()
    outcome = live.calibrate()

    assert outcome["error_code"] == 0, outcome["error_msg"]
    assert outcome["bag_folder"] == str(live.bag)
    # The beam to target 1 is blocked at one table angle: given up after all attempts.
    assert outcome["skipped_steps"] == [9]
    assert outcome["n_used"] == 59
    assert outcome["n_rejected"] >= 3

    recording, result = live.repeated()
    assert all(
        v.state == "complete" and not any(v.losses_recorded.values()) for v in recording.verdicts
    )

    settings = parse_configuration(live.file.read_text()).simulation
    truth = true_deviations(settings.table, result.angles)["ECC"]
    error = result.deviations["ECC"] - truth
    assert np.all(np.abs(error - error[0]) <= 5 * result.std["ECC"] + 1e-12)

    topics = recording.verdicts[0].topics
    for name in ("tracer_length", "joint_states", "probe_point", "temperature", "table_angle",
                 "probe_target", "observation", "observation_recorded", "plan", "deviations",
                 "compensation_table", "heartbeat"):  # fmt: skip
        assert topics[f"/cell/{name}"].messages > 0, name
    read_by_all(live.bag, live.folder / "converted")
    asked, told, stood = action_of(live)
    assert told[-1].total == 60
    assert GoalStatus.STATUS_EXECUTING in {s.status for m in stood for s in m.status_list}
    check_goal(asked, told)
    assert {
        "configuration.yaml",
        "versions.json",
        "definitions.json",
    } <= recording.attachments.keys()
    assert recording.attachments["configuration.yaml"].decode() == live.file.read_text()
    parameters = json.loads(recording.attachments["parameters.json"])
    assert parameters["simulated_cell"]["simulation.time_scale"] == 20.0
    assert parameters["planner"]["plan.box_points"] == [3, 2, 2]
    assert parameters.keys() >= {*SUITE, "simulated_cell"}
    metadata = (live.bag / "metadata.yaml").read_text()
    assert "durability: transient_local" in metadata
    assert "RIHS01_" in metadata


def test_the_parameters_are_enough_and_a_second_goal_is_refused_with_the_reason(cell):
    live = cell("simulation.time_scale=4.0")
    live.start(*SUITE, "simulated_cell")
    first = live.client("first", configuration=None)
    step = first.wait_for_step(1)
    assert step["total"] == 60  # from the parameter file that the planner was started with
    refused = live.client("second").wait_for("refused", "result")
    assert refused["event"] == "refused"
    assert "calibrating: step" in refused["reason"]
    first.cancel()
    assert first.result()["error_code"] == CANCELED


def test_cancel_leaves_a_valid_bag_and_the_plan_can_be_continued(cell):
    live = cell()
    live.start(*SUITE, "simulated_cell")
    client = live.client()
    client.wait_for_step(3)
    client.cancel()
    outcome = client.result()
    assert outcome["canceled"]
    assert outcome["error_code"] == CANCELED, outcome["error_msg"]
    assert "continue with start_index" in outcome["error_msg"]
    assert [v.state for v in verdicts(live)] == ["complete"]
    recording = read_recording(live.bag)
    assert sum(o.accepted for o in recording.recorded) >= outcome["n_used"] >= 3

    # The same nodes go on with the rest in the same session and solve all steps together.
    start = int(outcome["error_msg"].rsplit("start_index ", 1)[1])
    rest = live.client("rest", start_index=start).result()
    assert rest["error_code"] == 0, rest["error_msg"]
    result = json.loads((live.session / "result.json").read_text())
    assert result["n_observations"] >= 59  # and some that were measured again


def test_without_a_cell_the_reason_is_named_a_wrong_configuration_or_what_is_missing(cell):
    live = cell("planner.preflight_timeout_s=1.5")
    live.start(*SUITE)
    wrong = live.folder / "wrong.yaml"
    text = live.file.read_text()
    wrong.write_text(text.replace("table_positions: 5", "table_positions: -5"))
    outcome = live.client("first", configuration=wrong).result()
    assert outcome["error_code"] == BAD_CONFIGURATION, outcome["error_msg"]
    assert "table_positions" in outcome["error_msg"]
    assert "-5" in outcome["error_msg"]

    outcome = live.client("second").result()
    assert outcome["error_code"] == TOPIC_MISSING, outcome["error_msg"]
    for topic in ("tracer_length", "probe_point", "joint_states"):
        assert f"no node publishes /cell/{topic}" in outcome["error_msg"]
    assert not live.session.exists()


def test_a_recorder_that_finds_the_action_after_its_goal_has_the_goal_in_its_bag(cell):
    live = cell()
    live.start("planner", "capture", "solver", "simulated_cell")
    client = live.client()
    client.wait_for("started")
    live.start("recorder")
    client.wait_for_step(1)
    client.cancel()
    assert client.result()["error_code"] == CANCELED
    asked, told, _ = action_of(live)
    check_goal(asked, told)


def test_a_missing_node_is_named(cell):
    live = cell("planner.preflight_timeout_s=1.5")
    live.start("planner", "capture", "recorder", "simulated_cell")
    outcome = live.client().result()
    assert outcome["error_code"] == NODE_LOST, outcome["error_msg"]
    assert "node solver does not beat" in outcome["error_msg"]


def test_two_publishers_on_one_instrument_topic_are_found_and_named(cell):
    live = cell("planner.preflight_timeout_s=2.0")
    live.start("simulated_cell", name="other_cell")
    live.start("simulated_cell")
    with StateClient() as states:  # who comes after the start of a goal is not believed in it
        assert [states.state(n) for n in ("other_cell", "simulated_cell")] == ["active"] * 2
    live.start(*SUITE)
    outcome = live.client().result()
    if outcome["error_code"] == 0:
        # Found only during that goal, as happens on a busy machine: the next one is not begun.
        live.session.rename(live.recordings / "before")
        outcome = live.client().result()
    assert outcome["error_code"] == TOPIC_MISSING, outcome["error_msg"]
    assert (
        "2 publishers on /cell/tracer_length (nodes other_cell, simulated_cell)"
        in (outcome["error_msg"])
    )


@pytest.mark.parametrize(
    "victim",
    [
        pytest.param("recorder", marks=pytest.mark.slow),
        *(pytest.param(n, marks=pytest.mark.long) for n in ("capture", "simulated_cell")),
    ],
)
def test_a_killed_node_ends_the_calibration_and_is_named_by_all_others(cell, victim):
    live = cell("simulation.time_scale=4.0")
    live.start(*SUITE, "simulated_cell")
    client = live.client()
    # By then every node has met every other: discovery repairs a lost packet after 3 s only.
    client.wait_for_step(40)
    live.kill(victim)
    outcome = client.result()
    assert outcome["error_code"] == NODE_LOST, outcome["error_msg"]
    assert f"node {victim}" in outcome["error_msg"]
    for name in {*SUITE, "simulated_cell"} - {victim}:
        live.wait_for_log(name, f"node {victim} is lost: its process")
    if victim != "recorder":
        assert [v.state for v in verdicts(live)] == ["complete"]
    recording = read_recording(live.bag)
    accepted = {o.step for o in recording.recorded if o.accepted}
    assert set(range(outcome["n_used"])) - {9} <= accepted


def test_a_recorder_ended_by_sigterm_closes_the_bag(cell):
    live = cell()
    live.start(*SUITE, "simulated_cell")
    client = live.client()
    client.wait_for_step(2)
    live.processes.signal("recorder", signal.SIGTERM)
    outcome = client.result()
    assert outcome["error_code"] == NODE_LOST, outcome["error_msg"]
    assert "node recorder was ended" in outcome["error_msg"]
    wait_until(lambda: "recorder" in live.processes.ended(), "the recorder ends")
    assert live.processes.ended()["recorder"] == 0
    assert [v.state for v in verdicts(live)] == ["complete"]
    assert "Traceback" not in live.log("recorder")


def test_a_wrong_parameter_is_one_clear_line(cell):
    live = cell("simulation.time_scale=1.0")
    live.file.write_text(live.file.read_text().replace("time_scale: 1.0", "time_scale: -1.0"))
    live.start("simulated_cell")
    wait_until(lambda: live.processes.ended(), "the node refuses its parameters")
    assert live.processes.ended() == {"simulated_cell": 2}
    assert "time_scale: -1.0 is out of range" in live.log("simulated_cell")
    assert "Traceback" not in live.log("simulated_cell")
