"""The writer's thread: receipts after the sync, a bounded queue, failures without a hang."""

from threading import Event

import pytest

from rotcal_ros.bags.reader import scan_file
from rotcal_ros.bags.writer import BagWriter
from rotcal_ros.foundation.machine_load import load_scaled_timeout
from rotcal_ros.nodes.recorder.bookkeeping import WriteReceipt
from rotcal_ros.nodes.recorder.recording import BagRecording, Channel, SerializedMessages

CHANNEL = Channel("/cell/a", "std_msgs/msg/Float64", "float64 data", "", "")
TIMEOUT_S = 30.0


def verdict(folder):
    """Return what is on disk, read to its end."""
    scan = scan_file(folder / "bag" / "bag_0.mcap")
    for _ in scan.blocks():
        pass
    return scan.verdict()


def message(number: int) -> SerializedMessages:
    return SerializedMessages(CHANNEL, [(bytes(12), number, number)])


def test_a_receipt_is_given_when_the_message_before_it_is_on_disk(tmp_path):
    given = Event()
    found = []

    def confirm(receipt, file):
        found.append((receipt, file, verdict(tmp_path).messages))
        given.set()

    recording = BagRecording(BagWriter(tmp_path / "bag"), 1000, confirm)
    recording.attach("a.txt", "text/plain", b"a")
    recording.put(message(1))
    recording.confirm(WriteReceipt(7, 2))
    assert given.wait(load_scaled_timeout(TIMEOUT_S))
    recording.put(message(2))
    recording.close({})
    assert recording.join(load_scaled_timeout(TIMEOUT_S))
    assert found == [(WriteReceipt(7, 2), str(tmp_path / "bag" / "bag_0.mcap"), 1)]
    assert recording.messages == 2
    assert not recording.error


def test_what_does_not_fit_the_queue_is_lost_and_counted_in_the_bag(tmp_path):
    blocked, go_on = Event(), Event()

    def confirm(_receipt, _file):
        blocked.set()
        go_on.wait(load_scaled_timeout(TIMEOUT_S))

    recording = BagRecording(BagWriter(tmp_path / "bag"), 30, confirm)
    recording.confirm(WriteReceipt(0, 0))
    assert blocked.wait(load_scaled_timeout(TIMEOUT_S))
    for number in range(5):
        recording.put(message(number))
    go_on.set()
    recording.close({})
    assert recording.join(load_scaled_timeout(TIMEOUT_S))
    assert recording.messages == 2
    assert recording.losses == {"queue /cell/a": 3}
    assert verdict(tmp_path).losses_recorded == {"queue /cell/a": 3}


def test_after_a_failure_nothing_is_confirmed_and_everything_is_counted(tmp_path, monkeypatch):
    confirmed = []
    recording = BagRecording(BagWriter(tmp_path / "bag"), 10**6, lambda *a: confirmed.append(a))
    full = OSError(28, "No space left on device")

    def refuse(*_):
        raise full

    monkeypatch.setattr("os.write", refuse)
    recording.put(message(1))
    recording.confirm(WriteReceipt(0, 0))
    recording.close({})
    assert recording.join(load_scaled_timeout(TIMEOUT_S))
    assert "the disk is full" in recording.error
    assert confirmed == []
    recording.put(message(2))
    assert recording.losses == {"queue /cell/a": 1}


def test_a_closed_recording_ends_its_thread(tmp_path):
    recording = BagRecording(BagWriter(tmp_path / "bag"), 1000, lambda *_: None)
    assert not recording.finished
    recording.close({})
    assert recording.join(load_scaled_timeout(TIMEOUT_S))


@pytest.mark.parametrize("count", [0, 3])
def test_the_size_of_a_batch_is_its_payload(count):
    assert SerializedMessages(CHANNEL, [(bytes(12), 0, 0)] * count).size() == 12 * count
