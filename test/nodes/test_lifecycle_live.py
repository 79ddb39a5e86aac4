"""All nodes are managed nodes: what each state means, with real nodes as processes."""

import pytest
from live_cell import SUITE, wait_until

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")
pytestmark = pytest.mark.ros

from rotcal_msgs.srv import StartRecording  # noqa: E402
from state_client import StateClient  # noqa: E402

NODE_LOST = 603


def test_a_cell_is_taken_through_all_its_states_and_calibrates_again(cell):
    live = cell("simulation.time_scale=8.0")
    live.start(*SUITE[:-1], "simulated_cell")
    live.start("recorder", arguments=("-p", "autostart:=false"))
    with StateClient() as states:
        assert states.state("recorder") == "unconfigured"
        assert states.transitions("recorder") == {"configure", "shutdown"}
        assert states.change("recorder", "activate", "configure") == [False, True]
        refused = states.call(StartRecording, "start_recording", plan_id="p", configuration="")
        assert not refused.success
        assert refused.message == (
            "node recorder is inactive: ros2 lifecycle set /cell/recorder activate"
        )
        assert states.change("recorder", "activate") == [True]
        nodes = (*SUITE, "simulated_cell")
        assert {node: states.state(node) for node in nodes} == dict.fromkeys(nodes, "active")

        first = live.client()
        first.wait_for_step(3)
        assert states.change("capture", "deactivate") == [True]
        outcome = first.result()
        assert outcome["error_code"] == NODE_LOST
        assert (
            "node capture is inactive: ros2 lifecycle set /cell/capture activate"
            in (outcome["error_msg"])
        )
        assert states.change("capture", "activate") == [True]

        for node in nodes:
            done = states.change(node, "deactivate", "cleanup", "configure", "activate")
            assert done == [True] * 4, (node, live.log(node))
        live.session.rename(live.folder / "first")
        second = live.client("second").result()
        assert second["error_code"] == 0, second["error_msg"]
        assert second["n_used"] == 59
        assert states.change("capture", "shutdown") == [True]
        wait_until(lambda: live.processes.ended().get("capture") == 0, "the capture ends")
    for node in nodes:
        assert "Traceback" not in live.log(node)
