"""Every call that a recording makes to the disk fails in its turn, as SQLite tests itself.

Whatever fails, and however often: no receipt for what a power cut takes away, no traceback,
and the reason in the recorder's words. ROTCAL_LONG_TESTS=1 tries all faults.
"""

import inspect
import os
import random
import shutil
import struct
from pathlib import Path

import pytest
from bag_samples import writer_settings
from faulty_disk import CALLS, Fault, FaultyDisk, faults
from mcap.stream_reader import StreamReader

from rotcal_ros.bags import names
from rotcal_ros.bags.interrupted_files import InterruptedSession
from rotcal_ros.bags.reader import bag_files, check_files
from rotcal_ros.bags.session_verdict import judge_session
from rotcal_ros.bags.writer import BagWriter
from rotcal_ros.foundation import disk
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.nodes.recorder.bookkeeping import WriteReceipt
from rotcal_ros.nodes.recorder.recording import BagRecording, Channel, SerializedMessages

ALL = bool(os.environ.get("ROTCAL_LONG_TESTS"))
SAMPLE = 80
STEPS = 5
READINGS = 12
NUMBER = struct.Struct("<4xQ")
READING = Channel("/cell/tracer_length", "demo_msgs/msg/Blob", "uint8[] data\n", "", "")
OBSERVATION = Channel("/cell/observation", "demo_msgs/msg/Number", "uint64 number\n", "", "")
SETTINGS = writer_settings(
    min_free_bytes=1, chunk_bytes=1024, split_bytes=8000, sync_interval_s=1.0
)
REASONS = {
    "full": ("the disk is full", "MB that recording keeps free"),
    "error": ("the disk reports an error",),
    "read-only": ("the file system is read-only", "was made read-only"),
    "short, then full": ("the disk is full", "MB that recording keeps free"),
}


def record(folder: Path, *, earlier=None) -> tuple[list[int], str | None]:
    """Make the recording that is the same every time; return its receipts and its error."""
    receipts: list[int] = []
    noise = random.Random(0)
    try:
        writer = BagWriter(folder, SETTINGS, earlier=earlier)
        writer.note(names.RUN, {"number": 0})
    except BagError as error:
        return receipts, str(error)
    recording = BagRecording(writer, 10**7, lambda receipt, _: receipts.append(receipt.step))
    recording.attach(names.CONFIGURATION, "application/yaml", b"method: none\n")
    time_ns = 10**18
    for step in range(STEPS):
        for _ in range(READINGS):
            time_ns += 10**6
            recording.put(SerializedMessages(READING, [(noise.randbytes(100), time_ns, time_ns)]))
        recording.put(SerializedMessages(OBSERVATION, [(NUMBER.pack(step), time_ns, time_ns)]))
        recording.confirm(WriteReceipt(step, 0))
        recording.note(names.LOSSES, {"lost /cell/tracer_length": step})
    recording.close({})
    assert recording.join(60.0)
    return receipts, recording.error


def observations(folder: Path) -> set[int]:
    """Return what the mcap package finds before the first thing that it does not understand."""
    found = set()
    for path in sorted(folder.glob("*.mcap")):
        topics = {}
        with path.open("rb") as file:
            try:
                for item in StreamReader(file, validate_crcs=True).records:
                    if type(item).__name__ == "Channel":
                        topics[item.id] = item.topic
                    elif type(item).__name__ == "Message" and topics[item.channel_id] == (
                        OBSERVATION.topic
                    ):
                        found.add(NUMBER.unpack(item.data)[0])
            except Exception:
                continue
    return found


@pytest.fixture(scope="module")
def calls(tmp_path_factory) -> list[str]:
    """Return the calls of a recording to which nothing happens."""
    root = tmp_path_factory.mktemp("sound")
    with pytest.MonkeyPatch.context() as patch:
        sound = FaultyDisk(root)
        sound.install(patch)
        assert record(root / "session" / "bag") == (list(range(STEPS)), None)
    files = bag_files(root / "session" / "bag")
    assert len(files) > 1
    assert all(verdict.state == "complete" for verdict in check_files(files))
    assert not sound.open
    return sound.calls


def test_the_faulty_disk_stands_in_for_every_call():
    functions = inspect.getmembers(disk, inspect.isfunction)
    assert {name for name, f in functions if f.__module__ == disk.__name__} == set(CALLS)


def drawn(possible: list[Fault], calls: list[str]) -> list[Fault]:
    """Return one fault of every kind of call, and a sample of the others."""
    generator = random.Random(15)
    of_kind = {calls[fault.at]: fault for fault in generator.sample(possible, len(possible))}
    return [*of_kind.values(), *generator.sample(possible, SAMPLE)]


def check(root: Path, fault: Fault, monkeypatch) -> str:
    """Record with a fault; return the call that it hit."""
    faulty = FaultyDisk(root / "disk", fault)
    faulty.root.mkdir(parents=True)
    bag = faulty.root / "session" / "bag"
    with monkeypatch.context() as patch:
        faulty.install(patch)
        receipts, error = record(bag)
    assert faulty.hit
    assert not faulty.open, "a file is still open"
    assert receipts == list(range(len(receipts)))
    if error:
        assert any(reason in error for reason in REASONS[fault.name]), error
    else:
        assert receipts == list(range(STEPS))
        assert all(v.state == "complete" for v in check_files(bag_files(bag)))
    for seed in (None, -1, fault.at):
        left = root / f"left_{seed}"
        left.mkdir()
        faulty.power_cut(left, seed)
        assert set(receipts) <= observations(left / "session" / "bag"), f"power cut {seed}"
    if receipts:
        go_on(root / "left_None", receipts, monkeypatch)
    return faulty.hit


def go_on(left: Path, receipts: list[int], monkeypatch) -> None:
    """What is left of a session is continued and keeps what was confirmed."""
    bag = left / "session" / "bag"
    with monkeypatch.context() as patch:
        FaultyDisk(left).install(patch)
        earlier = InterruptedSession.read(bag).files
        assert record(bag, earlier=earlier) == (list(range(STEPS)), None)
    assert set(receipts) <= observations(bag)


@pytest.mark.slow
def test_whichever_call_fails_nothing_that_was_confirmed_is_lost(calls, tmp_path, monkeypatch):
    possible = faults(calls)
    chosen = possible if ALL else drawn(possible, calls)
    hit = {
        check(tmp_path / str(number), fault, monkeypatch) for number, fault in enumerate(chosen)
    }
    assert hit == set(calls)


class WatchedDisk(FaultyDisk):
    """A disk of which an image is taken before every call, as a kill and as a power cut leave it.

    ``missed`` maps the number of a call to what is then said to be missing, ``split`` holds the
    calls before which there was more than one file.
    """

    def __init__(self, root, images):
        super().__init__(root)
        self.images = images
        self.missed = {}
        self.split = set()
        self._seen = set()

    def _call(self, name):
        for seed in (-1, None):
            image = self.images / f"{len(self.calls)}_{seed}"
            image.mkdir(parents=True)
            self.power_cut(image, seed)
            self._judge(image / "session" / "bag")
            shutil.rmtree(image)
        return super()._call(name)

    def _judge(self, bag):
        files = [] if not bag.is_dir() else sorted(bag.glob("*.mcap"))
        if not files:
            return
        image = frozenset((f.name, f.read_bytes()) for f in bag.iterdir() if f.is_file())
        if image in self._seen:
            return
        self._seen.add(image)
        if len(files) > 1:
            self.split.add(len(self.calls))
        if missing := judge_session(bag, check_files(files)).missing:
            self.missed[len(self.calls)] = missing


def test_no_file_is_missed_that_never_was(tmp_path, monkeypatch):
    watched = WatchedDisk(tmp_path / "disk", tmp_path / "images")
    watched.root.mkdir()
    with monkeypatch.context() as patch:
        watched.install(patch)
        assert record(watched.root / "session" / "bag") == (list(range(STEPS)), None)
    assert watched.split
    assert watched.missed == {}
