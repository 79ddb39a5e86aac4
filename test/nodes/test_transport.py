"""However a node is started: no shared memory, whose locks outlive a killed process."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from live_cell import wait_until

from rotcal_ros.foundation.machine_load import patient

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")
pytestmark = pytest.mark.ros


def thread_names(pid):
    return {path.read_text().strip() for path in Path(f"/proc/{pid}/task").glob("*/comm")}


def test_a_node_that_is_started_alone_talks_over_udp_only():
    path = os.pathsep.join(filter(None, sys.path))
    command = [sys.executable, "-m", "rotcal_ros.nodes.recorder.node"]
    node = subprocess.Popen(command, env={**os.environ, "PYTHONPATH": path})
    try:
        wait_until(lambda: "dds.tls.replies" in thread_names(node.pid), "the node is up")
        names = thread_names(node.pid)
        assert any(name.startswith("dds.udp") for name in names)
        assert not any(name.startswith("dds.shm") for name in names)
    finally:
        node.terminate()
        node.wait(patient(30))
