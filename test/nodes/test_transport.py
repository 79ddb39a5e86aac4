"""However a node is started: no shared memory, whose locks outlive a killed process.

Nor does it ask for types: the threads of Fast DDS that do so have crashed.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from live_cell import wait_until

from rotcal_ros.foundation.machine_load import load_scaled_timeout

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")
pytestmark = pytest.mark.ros


def threads(kind, pid):
    names = (path.read_text().strip() for path in Path(f"/proc/{pid}/task").glob("*/comm"))
    return [name for name in names if name.startswith(kind)]


def test_a_node_that_is_started_alone_talks_over_udp_only():
    path = os.pathsep.join(filter(None, sys.path))
    command = [sys.executable, "-m", "rotcal_ros.nodes.recorder.node"]
    node = subprocess.Popen(command, env={**os.environ, "PYTHONPATH": path})
    try:
        # one for what all hear, two of its own: then the participant is whole
        wait_until(lambda: len(threads("dds.udp", node.pid)) >= 3, "the node is up")
        assert not threads("dds.shm", node.pid)
        assert not threads("dds.tls", node.pid)
    finally:
        node.terminate()
        node.wait(load_scaled_timeout(30))
