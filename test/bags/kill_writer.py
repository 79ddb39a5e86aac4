"""A process that records like the recorder does, to be killed: fed by itself instead of by DDS.

Two streams and an "observation" with a receipt after every tenth reading. Every receipt is sent
to the parent, as the recorder sends it to the planner, which from then on relies on it.
"""

from __future__ import annotations

import os
import resource
import signal
import struct
import time
from pathlib import Path
from typing import Any

from rotcal_ros.bags.interrupted_files import InterruptedSession
from rotcal_ros.bags.settings import WriterSettings
from rotcal_ros.bags.writer import BagWriter
from rotcal_ros.nodes.recorder.bookkeeping import WriteReceipt
from rotcal_ros.nodes.recorder.recording import BagRecording, Channel, SerializedMessages

DEFINITION = "uint64 number\nuint64 stamp_ns\n"
READING = struct.Struct("<4xQQ")
TOPICS = ("/cell/tracer_length", "/cell/joint_states", "/cell/observation")
TRACER, TABLE, OBSERVATION = (
    Channel(topic, "demo_msgs/msg/Reading", DEFINITION, "", "") for topic in TOPICS
)
PERIOD_S = 0.0005
HOUR_NS = 3600 * 10**9


def payload(number: int) -> bytes:
    """Return one message: its number, and when it was sent by the clock that nobody turns."""
    data = READING.pack(number, time.monotonic_ns())
    return b"\0\1\0\0" + data[4:]


def record(folder: Path, receipts: Any, how: dict[str, Any]) -> None:
    """Record until killed; ``how`` says what goes wrong besides."""
    told_to_end = []
    signal.signal(signal.SIGTERM, lambda *_: told_to_end.append(True))
    if "file_limit" in how:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (how["file_limit"], how["file_limit"]))
    if how.get("nobody") and os.geteuid() == 0:
        os.seteuid(65534)
    try:
        earlier = InterruptedSession.read(folder) if how.get("resume") else None
        settings = WriterSettings(min_free_bytes=0, split_bytes=how.get("split_bytes", 0))
        writer = BagWriter(folder, settings, earlier=earlier.files if earlier else None)
        if earlier:
            earlier.close_before(writer)
    except Exception as error:
        receipts.send(("error", str(error)))
        return
    recording = BagRecording(writer, 1 << 26, lambda r, _: receipts.send(("receipt", r.step)))
    number = 0
    while not told_to_end and not recording.error:
        now_ns = time.time_ns() + clock_jump_ns(how, number)
        recording.put(SerializedMessages(TRACER, [(payload(number), now_ns, now_ns)]))
        if number % 5 == 0:
            recording.put(SerializedMessages(TABLE, [(payload(number // 5), now_ns, now_ns)]))
        if number % 10 == 0:
            recording.put(
                SerializedMessages(OBSERVATION, [(payload(number // 10), now_ns, now_ns)])
            )
            recording.confirm(WriteReceipt(number // 10, 0))
        number += 1
        time.sleep(PERIOD_S)
    recording.close({})
    recording.join(10.0)
    receipts.send(("error", recording.error) if recording.error else ("closed", number))


def clock_jump_ns(how: dict[str, Any], number: int) -> int:
    """Return how far the wall clock is off: it jumps at every 50th message."""
    return (number // 50 % 3 - 1) * HOUR_NS if how.get("clock") else 0
