"""Somebody takes the bag away under a real recorder: it says so and confirms nothing more."""

import os
import shutil
import subprocess

import pytest
from fed_recorders import fed
from live_cell import SUITE, wait_until

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")
pytestmark = pytest.mark.ros

RECORDER_FAILED = 604


@pytest.fixture(scope="module")
def recorders(tmp_path_factory):
    yield from fed(tmp_path_factory.mktemp("taken_away"))


@pytest.fixture
def medium(tmp_path):
    """Return a file system of its own, where the system lets us mount one."""
    folder = tmp_path / "medium"
    folder.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=100m", "tmpfs", str(folder)]
    mounted = subprocess.run(command, capture_output=True).returncode == 0
    yield folder if mounted else None
    if mounted:
        subprocess.run(["umount", "--lazy", str(folder)], capture_output=True)


def swap(file):
    shutil.copy(file, file.with_name("copy"))
    file.with_name("copy").replace(file)


DEEDS = {
    "deleted": (os.unlink, "no longer there"),
    "swapped": (swap, "somebody put another there"),
    "cut": (lambda file: os.truncate(file, 100), "somebody changed it"),
    "moved": (lambda file: file.parents[1].rename(file.parents[2] / "away"), "no longer there"),
}


def detach(file):
    subprocess.run(["umount", "--lazy", str(file.parents[2])], check=True)


def test_the_recorder_says_so_and_confirms_nothing_more(recorders, medium):
    deeds = dict(DEEDS)
    for name in deeds:
        recorders.start(name)
    files = {name: recorders.file(name) for name in deeds}
    if medium is not None:
        deeds["unmounted"] = (detach, "no longer there")
        recorders.start("unmounted", medium)
        files["unmounted"] = medium / "unmounted" / "bag" / "bag_0.mcap"
    wait_until(lambda: all(recorders.receipts[name] for name in deeds), "all have confirmed")
    for name, (do, _) in deeds.items():
        do(files[name])
    wait_until(lambda: recorders.failures.keys() >= deeds.keys(), "all have given up")
    confirmed = {name: list(recorders.receipts[name]) for name in deeds}
    for _ in range(3):  # the feeder goes on meanwhile, and reports what still comes
        answers = len(recorders.receipts[""])
        recorders.processes.tell("feeder", "")
        wait_until(lambda n=answers: len(recorders.receipts[""]) > n, "the receipts are here")
    for name, (_, words) in deeds.items():
        assert words in recorders.failures[name]
        assert recorders.receipts[name] == confirmed[name]


@pytest.mark.long  # test_kill_graph.py ends one for a full disk
def test_a_calibration_ends_with_the_reason(cell):
    live = cell()
    live.start(*SUITE, "simulated_cell")
    client = live.client()
    client.wait_for_step(3)
    (live.bag / "bag_0.mcap").unlink()
    outcome = client.result()
    assert outcome["error_code"] == RECORDER_FAILED, outcome["error_msg"]
    assert "bag_0.mcap is no longer there: somebody deleted or moved it" in outcome["error_msg"]
