"""A node stands still for five seconds: it is waited for; or has no memory: the run says so."""

import json
import os
import re
import resource
import signal
import sys
import time
from pathlib import Path

import pytest
import warm
from live_cell import process_of, wait_until

from rotcal_ros.foundation.machine_load import load_scaled_timeout
from rotcal_ros.recordings.replay import read_recording

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")
pytestmark = [pytest.mark.ros, pytest.mark.slow]

NODES = ("planner", "capture", "solver", "recorder", "simulated_cell", "client")
LONG = bool(os.environ.get("ROTCAL_LONG_TESTS"))
STOPPED = NODES if LONG else ()
STARVED = NODES if LONG else ("recorder",)
STANDSTILL_S = 5.0
ROOM = 1 << 20
CASES = [("stopped", node) for node in STOPPED] + [("starved", node) for node in STARVED]


def starve(pid):
    """Leave a process next to no memory: what the kernel does in a full control group."""
    (used,) = re.findall(r"VmData:\s+(\d+)", Path(f"/proc/{pid}/status").read_text())
    limit = 1024 * int(used) + ROOM
    resource.prlimit(pid, resource.RLIMIT_DATA, (limit, limit))


@pytest.mark.parametrize(("how", "node"), CASES)
def test_a_lost_node_ends_the_run_with_the_reason_and_a_slow_one_does_not(
    rotcal, tmp_path, how, node
):
    folder, log = tmp_path / "run", tmp_path / "run.log"
    quiet = ("--no-report", "--no-export", "--no-page")
    changes = ("simulation.time_scale=8.0",)
    process = rotcal("-o", folder, *quiet, log=log, changes=changes)
    measured = re.compile(r"\d of 60 steps, table")
    wait_until(lambda: measured.search(log.read_text()), "some steps are measured")
    pid = process_of(process.pid, node)
    if how == "stopped":
        os.kill(pid, signal.SIGSTOP)
        time.sleep(STANDSTILL_S)  # the standstill is the test's subject
        os.kill(pid, signal.SIGCONT)
    else:
        starve(pid)
    code, text = process.wait(load_scaled_timeout(90)), log.read_text()
    assert "Traceback" not in text
    if code == 0:  # it could wait
        return
    assert how != "stopped"
    assert code == 3
    assert node in text
    recording = read_recording(folder / "bag")
    before = {o.step for o in recording.recorded if o.accepted}
    assert before
    if how == "starved" and not LONG:
        return  # the other case goes on
    (command,) = re.findall(r"resume with: rotcal (run .*?);", text)
    again = warm.run(
        [sys.executable, "-m", "rotcal_ros.cli.main", *command.split(), *quiet],
        timeout=load_scaled_timeout(120),
    )
    assert again.returncode == 0, again.stderr
    assert json.loads((folder / "result.json").read_text())["n_observations"] == 59
    assert before <= {o.step for o in read_recording(folder / "bag").observations if o.accepted}
