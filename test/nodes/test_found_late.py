"""Who is found late misses what is sent once, so nothing is sent before all are found."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest
from live_cell import wait_until

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")
pytestmark = [
    pytest.mark.ros,
    pytest.mark.slow,
    pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler for the network"),
]

SOURCE = Path(__file__).with_name("lost_packets.c")
FIRST_PORT, PER_DOMAIN = 7410, 250
"""By which the first process of a domain is found (DDSI-RTPS 2.5, 9.6.2.3)."""


def is_taken(port):
    return f":{port:04X} " in Path("/proc/net/udp").read_text()


def test_a_goal_waits_until_the_capture_knows_that_the_recorder_listens(cell, tmp_path):
    library = tmp_path / "lost_packets.so"
    subprocess.run(["cc", "-shared", "-fPIC", "-O1", "-o", library, SOURCE, "-ldl"], check=True)
    live = cell()
    port = FIRST_PORT + PER_DOMAIN * int(os.environ["ROS_DOMAIN_ID"])
    live.start("capture")
    wait_until(lambda: is_taken(port), "the capture is up")
    usual = live.processes.environment
    lossy = {"LD_PRELOAD": str(library), "LOST_PORT": str(port), "LOST_S": "9.0"}
    live.processes.environment = usual | lossy
    live.start("recorder")
    live.processes.environment = usual
    live.start("planner", "solver", "simulated_cell")
    outcome = live.client().result()
    assert outcome["error_code"] == 0, outcome["error_msg"]
    assert outcome["n_used"] == 59
