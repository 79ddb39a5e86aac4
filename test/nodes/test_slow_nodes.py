"""Nodes that stand still are waited for, and nodes that are killed are lost at once."""

import re
import signal
import threading

import pytest
from live_cell import SUITE, wait_until

from rotcal_ros.recordings.replay import read_recording

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")
pytestmark = pytest.mark.ros

NODE_LOST = 603
STANDSTILL_S = 3.0


def stand_still(live, name):
    """Stop a process for a while, which is the subject of these tests; return when it goes on."""
    live.processes.signal(name, signal.SIGSTOP)
    back = threading.Event()
    back.wait(STANDSTILL_S)
    live.processes.signal(name, signal.SIGCONT)


@pytest.mark.slow
def test_every_node_may_stand_still_and_the_session_goes_on_and_ends_ok(cell):
    live = cell("simulation.time_scale=8.0")
    live.start(*SUITE, "simulated_cell")
    client = live.client()
    for name, step in (("solver", 4), ("capture", 12), ("recorder", 20), ("simulated_cell", 28),
                       ("planner", 36)):  # fmt: skip
        client.wait_for_step(step)
        stand_still(live, name)
    outcome = client.result()
    assert outcome["error_code"] == 0, outcome["error_msg"]
    assert (outcome["verdict"], outcome["n_used"]) == ("ok", 59)
    recording = read_recording(live.bag)
    assert recording.same_as_recorded
    assert len({o.step for o in recording.observations if o.accepted}) == 59
    assert {o.run for o in recording.observations} == {0}  # no run was broken off
    waited = re.findall(r"waiting for .*: slow, not lost; load .* it resumes", live.log("planner"))
    assert len(waited) == 1, waited  # one line for all of it
    for name in (*SUITE, "simulated_cell"):
        assert "is lost" not in live.log(name), name


def test_a_killed_node_is_lost_at_once_though_a_slow_one_may_take_its_time(cell):
    live = cell("simulation.time_scale=4.0", "health.lost_after_s=3600.0")
    live.start(*SUITE, "simulated_cell")
    client = live.client()
    client.wait_for_step(8)
    live.kill("capture")
    outcome = client.result()
    assert outcome["error_code"] == NODE_LOST, outcome["error_msg"]
    assert re.search(
        r"node capture is lost at step .*its process \d+ is gone", outcome["error_msg"]
    )


def test_a_node_that_stands_still_for_longer_than_settled_ends_the_session(cell):
    live = cell("simulation.time_scale=4.0", "health.lost_after_s=3.0")
    live.start(*SUITE, "simulated_cell")
    client = live.client()
    client.wait_for_step(8)
    live.processes.signal("capture", signal.SIGSTOP)
    outcome = client.result()
    live.processes.signal("capture", signal.SIGCONT)
    assert outcome["error_code"] == NODE_LOST, outcome["error_msg"]
    assert "node capture is lost at step" in outcome["error_msg"]
    assert "no sign of it for 3 s" in outcome["error_msg"]
    wait_until(lambda: read_recording(live.bag).verdicts[0].state == "complete", "the bag closes")
