"""Real recorders, fed over DDS, that die at seeded moments: five at a time, each on its own."""

import random
import signal
import time

import numpy as np
import pytest
from fed_recorders import WINDOW, fed
from live_cell import wait_until

from rotcal_ros.bags.decode import Decoder
from rotcal_ros.bags.reader import bag_files, read_blocks

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")
pytestmark = pytest.mark.ros

AT_ONCE = 5
LAST_SECOND_NS = 10**9
TRACER, OBSERVATION = "/cell/tracer_length", "/cell/observation"


def die(recorders, names, seed, how):
    """End each recorder at its own moment after its first receipt.

    Return the time (ns) of each death and what was on disk just before it.
    """
    generator = random.Random(seed)
    wait_until(lambda: all(recorders.receipts[name] for name in names), "all have confirmed")
    moments = sorted((generator.uniform(0.0, 1.0), name) for name in names)
    begin, deaths = time.monotonic(), {}
    for delay_s, name in moments:
        time.sleep(max(0.0, begin + delay_s - time.monotonic()))
        before = recorders.file(name).read_bytes()
        deaths[name] = time.time_ns(), before
        recorders.processes.signal(name, how)
    wait_until(lambda: recorders.processes.ended().keys() >= set(names), "all have ended")
    for _ in range(2):  # the second answer comes a turn of the executor after the first
        answers = len(recorders.receipts[""])
        recorders.processes.tell("feeder", "")
        wait_until(lambda n=answers: len(recorders.receipts[""]) > n, "the receipts are here")
    return deaths


@pytest.fixture(scope="module")
def recorders(tmp_path_factory):
    yield from fed(tmp_path_factory.mktemp("recorders"))


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
    [(0, signal.SIGKILL, "truncated"),
     *(pytest.param(n, signal.SIGKILL, "truncated", marks=pytest.mark.long) for n in range(1, 5)),
     (5, signal.SIGTERM, "complete")],
)  # fmt: skip
def test_a_dead_recorder_has_kept_all_that_it_confirmed(recorders, batch, how, state):
    names = [f"recorder_{batch}_{number}" for number in range(AT_ONCE)]
    for name in names:
        recorders.start(name)
    deaths = die(recorders, names, batch, how)
    for name in names:
        check(recorders, name, *deaths[name], state)
