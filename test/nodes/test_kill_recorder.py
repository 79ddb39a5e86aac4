"""Real recorders, fed over DDS, that die at seeded moments: five at a time, each on its own."""

import json
import os
import random
import signal
import sys
import time
from collections import defaultdict
from pathlib import Path
from threading import Thread

import numpy as np
import pytest
from live_cell import wait_until

from rotcal_ros.bags.decode import Decoder
from rotcal_ros.bags.reader import bag_files, read_blocks
from rotcal_ros.sessions.environment import node_environment
from rotcal_ros.sessions.processes import Processes

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")
pytestmark = pytest.mark.ros

AT_ONCE = 5
WINDOW = 50
"""Readings per observation."""
LAST_SECOND_NS = 10**9
TRACER, OBSERVATION = "/cell/tracer_length", "/cell/observation"


class Recorders:
    """A feeder and the recorders it feeds; ``receipts`` holds what each has confirmed."""

    def __init__(self, folder):
        self.folder = folder
        self.receipts = defaultdict(list)
        self.processes = Processes(folder, node_environment())
        feeder = str(Path(__file__).with_name("feeder.py"))
        self.processes.start("feeder", [sys.executable, feeder, str(WINDOW)], piped=True)
        Thread(target=self._listen, daemon=True).start()

    def start(self, name):
        self.processes.start(
            name,
            [
                sys.executable, "-m", "rotcal_ros.nodes.recorder", "--ros-args",
                "-r", "__ns:=/cell", "-r", f"__node:={name}",
                "-r", f"start_recording:=start_{name}",
                "-r", f"observation_recorded:=receipts_{name}",
                "-p", f"recorder.folder:={json.dumps(str(self.folder))}",
                "-p", f"recorder.session:={name}",
            ],
        )  # fmt: skip
        self.processes.tell("feeder", name)

    def die(self, names, seed, how):
        """End each recorder at its own moment after its first receipt.

        Return the time (ns) of each death and what was on disk just before it.
        """
        generator = random.Random(seed)
        wait_until(lambda: all(self.receipts[name] for name in names), "all have confirmed")
        moments = sorted((generator.uniform(0.0, 1.0), name) for name in names)
        begin, deaths = time.monotonic(), {}
        for delay_s, name in moments:
            time.sleep(max(0.0, begin + delay_s - time.monotonic()))
            before = self.file(name).read_bytes()
            deaths[name] = time.time_ns(), before
            self.processes.signal(name, how)
        wait_until(lambda: self.processes.ended().keys() >= set(names), "all have ended")
        for _ in range(2):  # the second answer comes a turn of the executor after the first
            answers = len(self.receipts[""])
            self.processes.tell("feeder", "")
            wait_until(lambda n=answers: len(self.receipts[""]) > n, "the receipts are here")
        return deaths

    def file(self, name):
        return self.folder / name / "bag" / "bag_0.mcap"

    def _listen(self):
        for line in self.processes.children["feeder"].stdout:
            event = json.loads(line)
            self.receipts[event["recorder"]].append(event["step"])


@pytest.fixture(scope="module")
def recorders(tmp_path_factory):
    before = os.environ.get("PYTHONPATH")
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, sys.path))
    made = Recorders(tmp_path_factory.mktemp("recorders"))
    yield made
    made.processes.end()
    os.environ.pop("PYTHONPATH")
    if before is not None:
        os.environ["PYTHONPATH"] = before


def numbers(bag):
    """Return topic -> (numbers, log times) of what the bag holds, and its verdict."""
    fields = {TRACER: "sequence", OBSERVATION: "step"}
    found = {topic: ([], []) for topic in fields}
    decoders = {}
    for scan, block in read_blocks(bag_files(bag)):
        if block is None:
            return {t: tuple(map(np.array, lists)) for t, lists in found.items()}, scan.verdict()
        for number, channel in scan.channels.items():
            if channel.topic in fields:
                chosen = block.select(block.headers["channel"] == number)
                decoder = decoders.setdefault(number, Decoder(channel))
                for part in decoder.columns(chosen, (fields[channel.topic],)):
                    values, times = found[channel.topic]
                    values += part.values[fields[channel.topic]].astype(int).tolist()
                    times += chosen.headers["log_time"][part.rows].astype(int).tolist()
    pytest.fail(f"{bag} has no end")


def check(recorders, name, died_ns, before, state):
    """All that was confirmed is there, and the readings up to it; the last second may miss."""
    file = recorders.file(name)
    assert file.read_bytes().startswith(before)
    found, verdict = numbers(file)
    assert verdict.state == state
    assert not verdict.lost
    (readings, times), (steps, _) = found[TRACER], found[OBSERVATION]
    confirmed = recorders.receipts[name]
    assert set(confirmed) <= set(steps.tolist())
    assert np.all(np.diff(steps) == 1)
    assert np.all(np.diff(readings) == 1)
    assert readings[-1] >= WINDOW * confirmed[-1] - 1
    assert died_ns - times[-1] < LAST_SECOND_NS


@pytest.mark.parametrize(
    ("batch", "how", "state"),
    [*((batch, signal.SIGKILL, "truncated") for batch in range(5)),
     (5, signal.SIGTERM, "complete")],
)  # fmt: skip
def test_a_dead_recorder_has_kept_all_that_it_confirmed(recorders, batch, how, state):
    names = [f"recorder_{batch}_{number}" for number in range(AT_ONCE)]
    for name in names:
        recorders.start(name)
    deaths = recorders.die(names, batch, how)
    for name in names:
        check(recorders, name, *deaths[name], state)
