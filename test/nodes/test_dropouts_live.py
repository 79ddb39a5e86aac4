"""A recorder that is held up misses messages, and the bag says when and how many."""

import signal

import numpy as np
import pytest
from fed_recorders import fed
from live_cell import wait_until

from rotcal_ros.bags import names
from rotcal_ros.bags.decode import Decoder
from rotcal_ros.bags.dropouts import GAP, REPORTED, loss_counters
from rotcal_ros.bags.reader import bag_files, check_files, read_blocks

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")
pytestmark = pytest.mark.ros

TRACER = "/cell/tracer_length"
MISSED = 60
"""Observations during which the recorder is held up: 3 s, and 18 MB, where a socket takes 8."""
DEPTH = 50
"""Readings that the publisher keeps for a reader who does not answer: 0.05 s."""


@pytest.fixture(scope="module")
def recorders(tmp_path_factory):
    yield from fed(tmp_path_factory.mktemp("dropouts"), DEPTH)


def readings(bag):
    """Return the numbers that the tracer gave its readings, and their log times."""
    numbers, times, decoders = [], [], {}
    for scan, block in read_blocks(bag_files(bag)):
        for channel in () if block is None else block.counts():
            if scan.channels[channel].topic == TRACER:
                chosen = block.select(block.headers["channel"] == channel)
                decoder = decoders.setdefault(channel, Decoder(scan.channels[channel]))
                for part in decoder.columns(chosen, ("sequence",)):
                    numbers += part.values["sequence"].astype(int).tolist()
                    times += chosen.headers["log_time"][part.rows].astype(int).tolist()
    return np.array(numbers), np.array(times)


def published(recorders):
    """Return the number of the latest observation that was published."""
    answers = recorders.receipts[""]
    before = len(answers)
    recorders.processes.tell("feeder", "")
    wait_until(lambda: len(answers) > before, "the feeder answers")
    return answers[-1]


def held_up(recorders, name):
    """Return the bag of a recorder that was stopped for a while."""
    recorders.start(name)
    receipts = recorders.receipts[name]
    wait_until(lambda: receipts, "the recorder confirms")
    recorders.processes.signal(name, signal.SIGSTOP)
    until = published(recorders) + MISSED
    wait_until(lambda: published(recorders) > until, "enough is missed")
    recorders.processes.signal(name, signal.SIGCONT)
    wait_until(lambda: receipts[-1] > until + 10, "it goes on")
    recorders.processes.signal(name, signal.SIGTERM)
    wait_until(lambda: name in recorders.processes.ended(), "it has ended")
    return recorders.file(name).parent


@pytest.mark.long  # where a loss falls depends on the buffers and the load of the machine
def test_what_a_held_up_recorder_missed_stands_in_its_bag(recorders):
    bag = held_up(recorders, "held")
    numbers, times = readings(bag)
    missing = np.diff(numbers) - 1
    (verdict,) = check_files(bag_files(bag))
    assert missing.sum() > 0
    told = [dropout for dropout in verdict.dropouts if dropout.topic == TRACER]
    assert {dropout.reason for dropout in told} <= {GAP, REPORTED}
    assert sum(dropout.count for dropout in told) == missing.sum()
    for place in np.flatnonzero(missing):
        assert any(d.from_ns <= times[place] and times[place + 1] <= d.to_ns for d in told)
    lost = {n: c for n, c in verdict.losses_recorded.items() if n.startswith(names.LOST)}
    assert lost == {n: c for n, c in loss_counters(verdict.dropouts).items() if n in lost}
