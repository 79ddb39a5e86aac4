"""What is missing of a bag stands in it: joined, in order, equal to the counters, readable."""

import sys
import time

import pytest

pytest.importorskip("rclpy")
from rosbags.highlevel import AnyReader

from rotcal_ros.bags.dropouts import GAP, QUEUE, REPORTED, SILENCE, Dropout, loss_counters
from rotcal_ros.bags.reader import bag_files, check_files
from rotcal_ros.bags.settings import WriterSettings
from rotcal_ros.bags.writer import BagWriter
from rotcal_ros.nodes.recorder.bookkeeping import SilentInterval
from rotcal_ros.nodes.recorder.recording import (
    BagRecording,
    Channel,
    DropoutWriter,
    SerializedMessages,
)

TOPIC = "/cell/recorder/dropouts"
SECOND = 10**9
BEGIN = 1_700_000_000 * SECOND
CHANNEL = Channel("/cell/a", "std_msgs/msg/Float64", "float64 data", "", "")


@pytest.fixture
def notes(tmp_path, monkeypatch):
    """Return notes into a bag, and a function that closes it and returns its verdict."""
    monkeypatch.setenv("AMENT_PREFIX_PATH", sys.prefix)
    writer = BagWriter(tmp_path / "bag", WriterSettings(min_free_bytes=0))
    recording = BagRecording(writer, 30, lambda *_: None)
    made = DropoutWriter(TOPIC)
    made.begin(recording)

    def close(losses=()):
        made.write()
        recording.close(dict(losses))
        assert recording.join(30.0)
        assert not recording.error
        (verdict,) = check_files(bag_files(tmp_path / "bag"))
        return verdict

    yield made, close
    recording.close({})
    recording.join(30.0)


def test_gaps_close_together_are_one_dropout(notes):
    made, close = notes
    for number in range(100_000):
        begin = BEGIN + number * 1000
        made.note(Dropout("/cell/a", begin, begin + 500, 2, GAP))
    made.write(older_than_s=3600.0)
    (found,) = close().dropouts
    assert found == Dropout("/cell/a", BEGIN, BEGIN + 99_999_500, 200_000, GAP, 100_000)


def test_topics_and_reasons_stay_apart_and_none_is_cut_by_a_full_queue(notes):
    made, close = notes
    told = [
        Dropout(topic, BEGIN + n, BEGIN + SECOND, n, reason)
        for n, (topic, reason) in enumerate(
            [("/cell/a", GAP), ("/cell/a", QUEUE), ("/cell/b", GAP), ("/cell/b", SILENCE)]
        )
    ]
    for dropout in told:
        made.note(dropout)
    assert close().dropouts == tuple(told)


def test_messages_that_the_queue_refuses_are_told_with_their_own_times(notes):
    made, close = notes
    made.refused(SerializedMessages(CHANNEL, [(b"", BEGIN + 5, 0), (b"", BEGIN + 9, 0)]))
    assert close().dropouts == (Dropout("/cell/a", BEGIN + 5, BEGIN + 9, 2, QUEUE),)


def test_a_silence_is_told_by_the_wall_clock(notes):
    made, close = notes
    now_s, now_ns = time.monotonic(), time.time_ns()
    made.silences([SilentInterval("/cell/a", now_s - 3.0, now_s - 1.0)])
    (found,) = close().dropouts
    assert found.to_ns - found.from_ns == pytest.approx(2 * SECOND, abs=0.1 * SECOND)
    assert found.to_ns == pytest.approx(now_ns - SECOND, abs=0.5 * SECOND)
    assert (found.count, found.gaps, found.reason) == (0, 1, SILENCE)


def test_other_readers_show_topic_place_and_reason(notes, tmp_path):
    made, close = notes
    made.note(Dropout("/cell/tracer_length", BEGIN, BEGIN + SECOND // 4, 3, GAP))
    assert close().topics[TOPIC].type_name == "diagnostic_msgs/msg/DiagnosticArray"
    with AnyReader([tmp_path / "bag"]) as reader:
        ((connection, time_ns, data),) = reader.messages()
        message = reader.deserialize(data, connection.msgtype)
    assert connection.topic == TOPIC
    assert time_ns == BEGIN + SECOND // 4
    assert message.header.stamp.sec * SECOND + message.header.stamp.nanosec == BEGIN
    (status,) = message.status
    assert status.name == "/cell/tracer_length"
    assert status.message == (
        "/cell/tracer_length: 3 messages missing between 2023-11-14 22:13:20.000 and 22:13:20.250 "
        f"UTC (0.250 s): {GAP}"
    )


def test_the_counters_follow_from_the_dropouts():
    told = [
        Dropout("/a", 0, 1, 3, GAP), Dropout("/a", 2, 3, 4, REPORTED, 2),
        Dropout("/a", 0, 9, 0, SILENCE, 2), Dropout("/b", 0, 1, 5, QUEUE),
    ]  # fmt: skip
    assert loss_counters(told) == {"lost /a": 7, "silent /a": 2, "queue /b": 5}
