"""Who can reach the bridge: this machine alone by default; what the wheels' security can do."""

import os
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest
from live_cell import DEADLINE_S
from test_bridge import SECRET, Bench, table

from rotcal_ros.foundation.machine_load import load_scaled_timeout
from rotcal_ros.foundation.middleware import middleware

rclpy = pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")
pytestmark = pytest.mark.ros

LOOPBACK, ANYWHERE = "0100007F", "00000000"
"""127.0.0.1 and 0.0.0.0 in /proc/net/udp."""


@pytest.fixture
def bench(cell, tmp_path):
    made = Bench(cell, tmp_path)
    yield made
    made.end()


def addresses(process):
    """Return the local addresses of the UDP sockets of a process."""
    held = set()
    for path in Path(f"/proc/{process.pid}/fd").iterdir():
        with suppress(FileNotFoundError):  # closed since
            held.add(str(path.readlink()))
    lines = [line.split() for line in Path("/proc/net/udp").read_text().splitlines()[1:]]
    return {line[1].partition(":")[0] for line in lines if f"socket:[{line[9]}]" in held}


@pytest.mark.parametrize(("node", "alone"), [("bridge", True), ("capture", False)])
def test_started_by_hand_the_bridge_alone_keeps_to_this_machine(cell, monkeypatch, node, alone):
    """No variable of ours is set, as after ``ros2 run rotcal_ros bridge``."""
    live = cell()
    live.processes.environment = {}
    for name in ("ROS_AUTOMATIC_DISCOVERY_RANGE", "FASTDDS_DEFAULT_PROFILES_FILE",
                 "FASTRTPS_DEFAULT_PROFILES_FILE"):  # fmt: skip
        monkeypatch.delenv(name, raising=False)
    live.start(node)
    deadline = time.monotonic() + load_scaled_timeout(DEADLINE_S)
    process = live.processes.children[node]
    while len(found := addresses(process)) == 0 or (ANYWHERE not in found and not alone):
        assert time.monotonic() < deadline, found
        time.sleep(0.1)
    time.sleep(1.0 if alone else 0.0)  # all of its sockets
    assert (addresses(process) == {LOOPBACK}) == alone


def test_started_by_hand_it_is_reached_from_this_machine(bench, monkeypatch):
    """The bench speaks as ROS does where the range is LOCALHOST."""
    bench.live.processes.environment = {}
    monkeypatch.delenv("ROS_AUTOMATIC_DISCOVERY_RANGE")
    bench.publish(table())
    bench.start()
    bench.wait_for_state("written")
    assert bench.apply().success


def test_the_secret_is_in_no_bag(bench):
    from mcap.reader import make_reader
    from rotcal_msgs.srv import StartRecording, StopRecording

    bench.publish(table())
    bench.start()
    bench.live.start("recorder")
    bench.wait_for_state("written")
    request = StartRecording.Request(plan_id="p", configuration=bench.live.file.read_text())
    assert bench.call(StartRecording, "start_recording", request).success
    assert bench.apply().success
    assert bench.restore().success
    bench.wait_for_state("restored")
    stopped = bench.call(StopRecording, "stop_recording", StopRecording.Request())
    with Path(stopped.file).open("rb") as stream:
        reader = make_reader(stream)
        parts = [message.data for _, _, message in reader.iter_messages()]
        parts += [attachment.data for attachment in reader.iter_attachments()]
    everything = b"".join(parts)
    assert str(bench.secret_file).encode() in everything  # the configuration is there
    assert b"restored and verified by reading it back" in everything
    assert SECRET.encode() not in everything


MAKE_A_NODE = """
import rclpy
rclpy.init(args=["--ros-args", "--enclave", "/bridge"])
rclpy.create_node("bridge")
"""


@pytest.mark.parametrize("strategy", ["Enforce", "Permissive"])
def test_the_wheels_have_no_security_plugin(tmp_path, strategy):
    """Why there is a secret. Should this fail one day, SROS 2 can take its place: docs/feed.md."""
    (tmp_path / "enclaves" / "bridge").mkdir(parents=True)
    secured = {
        "ROS_SECURITY_ENABLE": "true",
        "ROS_SECURITY_STRATEGY": strategy,
        "ROS_SECURITY_KEYSTORE": str(tmp_path),
    }
    run = subprocess.run(
        [sys.executable, "-c", MAKE_A_NODE],
        env={**os.environ, **middleware(os.environ), **secured, "AMENT_PREFIX_PATH": sys.prefix},
        capture_output=True,
        text=True,
        timeout=load_scaled_timeout(DEADLINE_S),
        check=False,
    )
    assert run.returncode == 1
    assert "This Fast DDS version doesn't have the security libraries" in run.stderr
