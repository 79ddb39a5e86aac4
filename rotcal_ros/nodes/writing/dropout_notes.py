"""Writing dropouts into the bag: at their place, and never too many."""

from __future__ import annotations

import time
from typing import Final

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.serialization import serialize_message

from rotcal_ros.bags.dropouts import MESSAGE_TYPE, QUEUE, SILENCE, Dropout
from rotcal_ros.nodes.runtime.channels import own_channel
from rotcal_ros.nodes.runtime.conversions import time_message
from rotcal_ros.nodes.writing.bookkeeping import Silence
from rotcal_ros.nodes.writing.recording import BagRecording, Messages

TOGETHER_S: Final = 1.0
"""Gaps of a topic for the same reason within this time are written as one dropout."""


class DropoutNotes:
    """What is missing from the bag being written: at most a message per topic, reason and second.

    They stand in the bag at the log time of their end, on ``topic``.
    """

    def __init__(self, topic: str) -> None:
        self._topic = topic
        self._recording: BagRecording | None = None
        self._waiting: dict[tuple[str, str], tuple[float, Dropout]] = {}

    def begin(self, recording: BagRecording) -> None:
        """Write into ``recording`` from now on; what was missing earlier is not noted there."""
        self._recording = recording
        self._waiting.clear()

    def note(self, dropout: Dropout) -> None:
        """Take a dropout; it is joined with those just before it."""
        if self._recording is None or self._recording.error:
            return
        key = (dropout.topic, dropout.reason)
        since_s, earlier = self._waiting.get(key, (time.monotonic(), None))
        self._waiting[key] = since_s, dropout if earlier is None else earlier.joined(dropout)

    def refused(self, messages: Messages) -> None:
        """Take messages for which the queue had no room."""
        times_ns = [received_ns for _, received_ns, _ in messages.items]
        topic, count = messages.channel.topic, len(times_ns)
        self.note(Dropout(topic, min(times_ns), max(times_ns), count, QUEUE))

    def silences(self, ended: list[Silence]) -> None:
        """Take silences that have ended."""
        for silence in ended:
            begin, end = map(_wall_ns, (silence.from_s, silence.to_s))
            self.note(Dropout(silence.topic, begin, end, 0, SILENCE))

    def write(self, older_than_s: float = 0.0) -> None:
        """Write those that have waited long enough."""
        if self._recording is None or self._recording.error:
            return
        now_s = time.monotonic()
        for key, (since_s, dropout) in list(self._waiting.items()):
            if now_s - since_s >= older_than_s:
                del self._waiting[key]
                channel = own_channel(self._topic, MESSAGE_TYPE)
                item = (serialize_message(_message(dropout)), dropout.to_ns, dropout.to_ns)
                self._recording.put(Messages(channel, [item]), in_any_case=True)


def _wall_ns(monotonic_s: float) -> int:
    return time.time_ns() - round((time.monotonic() - monotonic_s) * 1e9)


def _message(dropout: Dropout) -> DiagnosticArray:
    status = DiagnosticStatus(
        level=DiagnosticStatus.WARN,
        name=dropout.topic,
        message=dropout.sentence(),
        values=[KeyValue(key=key, value=value) for key, value in dropout.values().items()],
    )
    array = DiagnosticArray(status=[status])
    array.header.stamp = time_message(dropout.from_ns)
    return array
