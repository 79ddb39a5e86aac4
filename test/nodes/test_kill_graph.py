"""The whole graph at seeded moments: nodes over DDS die, or their disk fills up."""

import random
import resource
import signal
import time
from pathlib import Path

import numpy as np
import pytest
from live_cell import SUITE, wait_until

from rotcal_ros.bags import names
from rotcal_ros.bags.reader import bag_files, read_blocks
from rotcal_ros.recordings.replay import read_recording

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")
pytestmark = pytest.mark.ros

BLOCKED_STEP = 9
RECORDER_FAILED, NODE_LOST = 604, 603


def under_way(live, seed):
    """Start the cell and wait for a moment drawn from ``seed``; return accepted, file, bytes."""
    generator = random.Random(seed)
    live.start(*SUITE, "simulated_cell")
    client = live.client()
    accepted = client.wait_for_step(generator.randrange(1, 25))["accepted"]
    time.sleep(generator.uniform(0.0, 0.3))  # the moment itself is the test's subject
    (file,) = bag_files(live.bag)
    return client, accepted, file, file.read_bytes()


def check(live, accepted, file, before, died_ns=None):
    """What the planner had reported as accepted is in the bag, which only ever grew."""
    assert file.read_bytes().startswith(before)
    recording = read_recording(live.bag)
    assert all(v.state in ("complete", "truncated") for v in recording.verdicts)
    for source in (recording.recorded, recording.observations):
        steps = {o.step for o in source if o.accepted}
        first = [step for step in range(60) if step != BLOCKED_STEP][:accepted]
        assert set(first) <= steps
    if died_ns is not None:
        assert died_ns - last_reading_ns(file) < 10**9


def last_reading_ns(file: Path) -> int:
    last = 0
    for scan, block in read_blocks((file,)):
        if block is not None:
            topics = [scan.channels[c].topic for c in block.headers["channel"].tolist()]
            chosen = [topic.endswith(names.TRACER_LENGTH) for topic in topics]
            last = max([last, *block.headers["log_time"][np.array(chosen)].tolist()])
    return last


def test_kill_9_of_everything_at_once(cell):
    live = cell()
    _, accepted, file, before = under_way(live, 0)
    died_ns = time.time_ns()
    for name in live.processes.children:
        live.kill(name)
    wait_until(lambda: len(live.processes.ended()) == 6, "all are dead")
    check(live, accepted, file, before, died_ns)


@pytest.mark.long  # test_live.py kills it, test_kill_recorder.py looks at what it has kept
def test_kill_9_of_the_recorder(cell):
    live = cell()
    client, accepted, file, before = under_way(live, 10)
    died_ns = time.time_ns()
    live.kill("recorder")
    outcome = client.result()
    assert outcome["error_code"] in (NODE_LOST, RECORDER_FAILED), outcome["error_msg"]
    check(live, max(accepted, outcome["n_used"]), file, before, died_ns)


@pytest.mark.slow
def test_kill_9_of_the_planner(cell):
    live = cell()
    client, accepted, file, before = under_way(live, 20)
    live.kill("planner")
    assert "planner is lost" in client.result()["error_msg"]
    wait_until(
        lambda: read_recording(live.bag).verdicts[0].state == "complete",
        "the recorder closes the bag",
    )
    check(live, accepted, file, before)


def test_sigterm_to_everything(cell):
    live = cell()
    _, accepted, file, before = under_way(live, 30)
    for name in live.processes.children:
        live.processes.signal(name, signal.SIGTERM)
    wait_until(lambda: len(live.processes.ended()) == 6, "all have ended")
    check(live, accepted, file, before)
    assert read_recording(live.bag).verdicts[0].state == "complete"


def test_a_full_disk_ends_the_calibration_with_the_reason(cell):
    live = cell()
    client, accepted, file, before = under_way(live, 40)
    limit = len(before) + 10_000
    resource.prlimit(
        live.processes.children["recorder"].pid, resource.RLIMIT_FSIZE, (limit, limit)
    )
    outcome = client.result()
    assert outcome["error_code"] == RECORDER_FAILED, outcome["error_msg"]
    assert "cannot write the bag" in outcome["error_msg"]
    check(live, max(accepted, outcome["n_used"]), file, before)
