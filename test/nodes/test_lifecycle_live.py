"""All nodes are managed nodes: what each state means, with real nodes as processes."""

import pytest
from live_cell import SUITE, wait_until

from rotcal_ros.recordings.summary import summarise_bag

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")
pytestmark = pytest.mark.ros

from rotcal_msgs.srv import StartRecording  # noqa: E402
from state_client import StateClient  # noqa: E402

NODE_LOST = 603
NODES = (*SUITE, "simulated_cell")


@pytest.fixture
def states():
    with StateClient() as client:
        yield client


@pytest.mark.slow
def test_a_cell_goes_through_all_states_and_a_dumped_planner_measures_the_same(cell, states):
    live = cell()
    live.start(*NODES[:-2], "simulated_cell")
    live.start("recorder", arguments=("-p", "autostart:=false"))
    assert states.state("recorder") == "unconfigured"
    assert states.transitions("recorder") == {"configure", "shutdown"}
    assert states.change("recorder", "activate", "configure") == [False, True]
    refused = states.call(StartRecording, "start_recording", plan_id="p", configuration="")
    assert not refused.success
    assert refused.message == (
        "node recorder is inactive: ros2 lifecycle set /cell/recorder activate"
    )
    assert states.change("recorder", "activate") == [True]
    assert {node: states.state(node) for node in NODES} == dict.fromkeys(NODES, "active")

    first = live.client(configuration=None)
    first.wait_for_step(3)
    assert states.change("capture", "deactivate") == [True]
    outcome = first.result()
    assert outcome["error_code"] == NODE_LOST, outcome["error_msg"]
    assert "node capture is inactive: ros2 lifecycle set /cell/capture" in outcome["error_msg"]
    assert states.change("capture", "activate") == [True]
    for node in NODES:
        done = states.change(node, "deactivate", "cleanup", "configure", "activate")
        assert done == [True] * 4, (node, live.log(node))

    before = live.session.rename(live.folder / "first")
    states.dump("planner", live.file)
    assert states.change("planner", "shutdown") == [True]
    wait_until(lambda: live.processes.ended().get("planner") == 0, "the planner ends")
    live.start("planner", name="planner")
    second = live.client("second", configuration=None).result()
    assert second["error_code"] == 0, second["error_msg"]
    plans = [summarise_bag(session / "bag").configuration for session in (before, live.session)]
    assert plans[0].plan_id == plans[1].plan_id
    for node in NODES:
        assert "Traceback" not in live.log(node)


def test_what_may_change_does_and_the_rest_says_why_not(cell, states):
    live = cell()
    live.start("planner", "recorder")
    assert states.set("planner", "planner.max_attempts", 7) == (True, "")
    done, reason = states.set("planner", "plan.order", "by_chance")
    assert not done
    assert "plan.order: 'by_chance' is none of" in reason
    done, reason = states.set("planner", "method", "ball_plate")
    assert not done
    assert reason.startswith("method: fixed when node planner starts")
    done, reason = states.set("recorder", "recorder.silence_s", 1.0)
    assert not done
    assert "recorder.silence_s: fixed when node recorder starts" in reason
    states.dump("planner", live.folder / "dump.yaml")
    assert "max_attempts: 7" in (live.folder / "dump.yaml").read_text()
