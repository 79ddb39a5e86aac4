"""Tests whether recorder and capture keep pace here, for ``rotcal doctor``.

    python -m rotcal_ros.nodes.check.rate_trial FOLDER

For 5 s, beside whatever else runs, a tracer's readings come over DDS, are decoded and written as a
bag below FOLDER. Prints one line and exits with 0, or says what was missing and exits with 1.
"""

from __future__ import annotations

import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Final

from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from rotcal_msgs.msg import TracerLength

from rotcal_ros.bags import names
from rotcal_ros.bags.settings import TopicSettings
from rotcal_ros.bags.writer import BagWriter
from rotcal_ros.capture.instruments.conventions import OWN
from rotcal_ros.capture.instruments.interpreter import Interpreter
from rotcal_ros.foundation import machine_load
from rotcal_ros.foundation.machine_load import WaitBudget
from rotcal_ros.nodes.recorder.recording import BagRecording, SerializedMessages, own_channel
from rotcal_ros.nodes.runtime import conversions
from rotcal_ros.nodes.runtime.qos import LISTENING_DEPTH, STREAM
from rotcal_ros.nodes.runtime.running import PeerNode, use_middleware
from rotcal_ros.nodes.runtime.timers_and_subscriptions import Batch, DrainedSubscription, sent_ns
from rotcal_ros.planning.settings import HealthSettings

RATE_HZ: Final = 1000
TRIAL_S: Final = 5.0
QUEUE_BYTES: Final = 1 << 26
MATCH_S: Final = 10.0
REST_S: Final = 5.0


class ReadingCounter:
    """Does what recorder and capture do with readings: keeps their bytes and decodes them."""

    def __init__(self, recording: BagRecording) -> None:
        self._recording = recording
        self._kind = OWN[names.TRACER_LENGTH]
        self._channel = own_channel(f"/doctor/{names.TRACER_LENGTH}", self._kind)
        self._interpreter = Interpreter(TopicSettings())
        self.understood, self.longest_s, self._last_s = 0, 0.0, 0.0

    def receive(self, batch: Batch) -> None:
        """Take serialised readings."""
        now_s = time.monotonic()
        self.longest_s = max(self.longest_s, now_s - (self._last_s or now_s))
        self._last_s = now_s
        self._recording.put(SerializedMessages.taken(self._channel, batch))
        sent = [(deserialize_message(data, TracerLength), sent_ns(info)) for data, info in batch]
        records = self._interpreter.records(names.TRACER_LENGTH, self._kind, sent)
        self.understood += len(records)


def publish_readings(peer: PeerNode, count: int) -> None:
    """Publish so many readings at the rate, and make up for late ones."""
    publisher = peer.node.create_publisher(TracerLength, names.TRACER_LENGTH, STREAM)
    budget = WaitBudget(MATCH_S)
    while not publisher.get_subscription_count() and not budget.is_over():
        time.sleep(0.01)
    begin_s = time.monotonic()
    for number in range(count):
        header = conversions.make_header(time.time_ns())
        publisher.publish(TracerLength(header=header, sequence=number, length=1.0))
        if (early_s := begin_s + (number + 1) / RATE_HZ - time.monotonic()) > 0.0:
            time.sleep(early_s)


def run_rate_trial(folder: Path) -> tuple[bool, str]:
    """Return whether the rate was held, and the findings in words."""
    count = round(RATE_HZ * TRIAL_S)
    here, there = PeerNode("doctor_instrument", "/doctor"), PeerNode("doctor_recorder", "/doctor")
    recording = BagRecording(BagWriter(folder / "bag"), QUEUE_BYTES, lambda *_: None)
    heard = ReadingCounter(recording)
    depth = QoSProfile(depth=LISTENING_DEPTH)
    listening = DrainedSubscription(
        there.node, TracerLength, names.TRACER_LENGTH, depth, heard.receive, raw=True
    )
    sending = threading.Thread(target=publish_readings, args=(here, count))
    sending.start()
    there.work_until(lambda: not sending.is_alive(), 2.0 * TRIAL_S + MATCH_S)
    budget = WaitBudget(REST_S)
    there.work_until(lambda: heard.understood >= count or budget.is_over(), 10.0 * REST_S)
    listening.drain()
    sending.join()
    recording.close({})
    recording.join(REST_S)
    here.close()
    there.close()
    return rate_verdict(count, heard.understood, recording, heard.longest_s)


def rate_verdict(
    count: int, came: int, recording: BagRecording, longest_s: float
) -> tuple[bool, str]:
    """Return whether all of ``count`` readings came and were written, and that in words."""
    limit_s = HealthSettings().slow_after_s
    written = recording.messages
    ok = came == written == count and longest_s < limit_s and recording.finished
    what = f"{min(came, written)} of {count} readings in {TRIAL_S:g} s came and were written"
    error = f"; {recording.error}" if recording.error else ""
    return ok, (
        f"{what}, the longest wait was {1000.0 * longest_s:.0f} ms (allowed "
        f"{1000.0 * limit_s:.0f}); {machine_load.describe_load()}{error}"
    )


def main() -> int:
    """Run the trial and print the outcome in one line."""
    use_middleware()
    parent = Path(sys.argv[1]) if len(sys.argv) > 1 else None
    with tempfile.TemporaryDirectory(prefix=".doctor", dir=parent) as folder:
        ok, text = run_rate_trial(Path(folder))
    sys.stdout.write(f"{text}\n")
    return 0 if ok else 1


if __name__ == "__main__":
    sys.exit(main())
