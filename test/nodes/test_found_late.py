"""A node that others find late: a goal waits for it, and nothing that is sent once is lost."""

import os
import subprocess
from pathlib import Path

import pytest
from live_cell import SUITE, wait_until

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")
pytestmark = [pytest.mark.ros, pytest.mark.slow]

SOURCE = Path(__file__).with_name("lost_packets.c")
FIRST_PORT, PER_DOMAIN = 7410, 250
"""By which the first process of a domain is found (DDSI-RTPS 2.5, 9.6.2.3)."""


def is_taken(port):
    return f":{port:04X} " in Path("/proc/net/udp").read_text()


@pytest.mark.parametrize(("late", "of"), [("recorder", "capture"), ("simulated_cell", "planner")])
def test_a_goal_waits_until_each_node_is_found_by_whom_it_hears(cell, tmp_path, late, of):
    library = tmp_path / "lost_packets.so"
    subprocess.run(["cc", "-shared", "-fPIC", "-O1", "-o", library, SOURCE, "-ldl"], check=True)
    live = cell("capture.step_timeout_s=600.0")  # what is lost is not ordered again meanwhile
    port = FIRST_PORT + PER_DOMAIN * int(os.environ["ROS_DOMAIN_ID"])
    live.start(of)
    wait_until(lambda: is_taken(port), f"{of} is up")
    usual = live.processes.environment
    lossy = {"LD_PRELOAD": str(library), "LOST_PORT": str(port), "LOST_S": "12.0"}
    live.processes.environment = usual | lossy
    live.start(late)
    live.processes.environment = usual
    live.start(*(name for name in (*SUITE, "simulated_cell") if name not in (of, late)))
    outcome = live.client().result()
    assert outcome["error_code"] == 0, outcome["error_msg"]
    assert outcome["n_used"] == 59
