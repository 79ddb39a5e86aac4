"""An emergency stop in the middle of a calibration, by processes of somebody else over DDS."""

import json
import sys
from pathlib import Path

import pytest
from known_truth import require_injected_truth
from live_cell import SUITE
from mcap.reader import make_reader
from rclpy.serialization import deserialize_message
from rotcal_msgs.msg import Pause, TableAngle
from std_msgs.msg import Bool

from rotcal_ros.foundation.results import Result
from rotcal_ros.methods import prepare
from rotcal_ros.methods.configuration import read_configuration
from rotcal_ros.recordings.replay import read_recording

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")
pytestmark = pytest.mark.ros

STOPPER = Path(__file__).parent / "stop_publisher.py"
CHANGES = (
    "safety.emergency_stop=/safety/estop",
    "safety.stop_on_diagnostics=[drive]",
    "simulation.time_scale=8.0",
    "simulation.faults.blocked_targets=[]",
)
STOPPED = 608
TYPES = {"/safety/estop": Bool, "/cell/table_angle": TableAngle, "/cell/pause": Pause}


@pytest.fixture
def stopped(cell):
    """Return a function that makes a cell beside a safety controller of somebody else."""

    def make(*changes, qos="volatile"):
        live = cell(*CHANGES, *changes)
        ears = ("planner", "simulated_cell") if qos == "volatile" else ()
        live.processes.start("safety", [sys.executable, str(STOPPER), qos, *ears], piped=True)
        live.start(*SUITE, "simulated_cell")
        return live

    return make


def recorded(bag):
    """Return (log time, topic, message) of what was ordered, stopped and waited for."""
    found = []
    for path in sorted(bag.glob("*.mcap")):
        with path.open("rb") as stream:
            for _, channel, message in make_reader(stream).iter_messages(topics=[*TYPES]):
                kind = TYPES[channel.topic]
                content = deserialize_message(message.data, kind)
                found.append((message.log_time, channel.topic, content))
    return sorted(found, key=lambda row: row[0])


def orders_in_pauses(rows):
    """Return the orders while the planner waited, and how many times it did."""
    waiting, found, pauses = False, [], 0
    for _, topic, message in rows:
        if topic == "/cell/pause":
            pauses += message.waiting and not waiting
            waiting = message.waiting
        elif topic == "/cell/table_angle" and waiting:
            found.append((message.step, message.attempt))
    return found, pauses


def orders_on_their_way(rows):
    """Return how many orders the recorder heard between the stop and the planner's pause."""
    topics = [topic for _, topic, message in rows if topic != "/safety/estop" or message.data]
    behind = topics[topics.index("/safety/estop") :]
    return behind[: behind.index("/cell/pause")].count("/cell/table_angle")


def is_waiting(event, text):
    return event["instruction"].startswith(text)


def test_nothing_is_ordered_from_a_stop_to_resume_and_the_truth_is_found(stopped):
    live = stopped()
    client = live.client()
    client.wait_for_step(3)
    live.processes.tell("safety", "true")
    waiting = client.wait_for("paused")
    assert waiting["instruction"].startswith("emergency stop: /safety/estop is true; ")
    assert "recording continues" in waiting["instruction"]
    live.wait_for_log(
        "simulated_cell", "emergency stop: /safety/estop is true; the machine stands"
    )

    live.processes.tell("client", "resume")
    refused = client.wait_for("resumed")
    assert not refused["success"]
    assert "not resumed: the emergency stop is on: /safety/estop is true" in refused["reason"]

    live.processes.tell("safety", "false")
    assert is_waiting(client.wait_for("paused"), "emergency stop released, cause: /safety/est")
    live.processes.tell("client", "resume")
    assert client.wait_for("resumed")["success"]

    client.wait_for_step(10)
    live.processes.tell("safety", "error ok")  # however short it is, somebody has to resume
    waiting = client.wait_for("paused", where=lambda e: is_waiting(e, "emergency stop released"))
    assert "plc: drive is in ERROR on /diagnostics (I2t)" in waiting["instruction"]
    live.processes.tell("client", "resume")
    assert client.wait_for("resumed")["success"]

    outcome = client.result()
    assert outcome["error_code"] == 0, outcome["error_msg"]
    assert outcome["n_used"] == 60
    assert outcome["n_rejected"] >= 2  # what was under way in either stop
    assert outcome["skipped_steps"] == []

    rows = recorded(live.bag)
    assert orders_in_pauses(rows) == ([], 2)
    assert orders_on_their_way(rows) <= 1
    pauses = [message for _, topic, message in rows if topic == "/cell/pause"]
    assert {p.kind for p in pauses if p.waiting} == {Pause.KIND_STOP}
    assert not pauses[-1].waiting

    recording = read_recording(live.bag)
    text = (live.session / "result.json").read_text()
    assert recording.same_as_recorded
    assert recording.solve().to_json() == text
    calibration = prepare(read_configuration(live.file))
    require_injected_truth(calibration, Result.from_dict(json.loads(text)))


def test_a_stop_before_the_start_is_refused_with_its_reason(stopped):
    live = stopped(qos="latched")
    live.processes.tell("safety", "true")
    live.wait_for_log("planner", "emergency stop: /safety/estop is true")
    outcome = live.client().result()
    assert outcome["error_code"] == STOPPED, outcome["error_msg"]
    assert "/safety/estop is true: nothing is ordered; release it" in outcome["error_msg"]
    assert not live.session.exists()
