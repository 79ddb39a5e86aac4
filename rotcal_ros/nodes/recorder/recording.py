"""One bag while it is written: a thread takes messages from a queue and writes them to disk.

Receiving never waits for the disk. The queue is bounded; messages that do not fit are lost and
counted, and a note of what is missing (a dropout) goes into the bag.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cache, partial
from queue import Empty, SimpleQueue
from threading import Lock, Thread
from typing import Any, Final

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.duration import Duration
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message

from rotcal_ros.bags import names
from rotcal_ros.bags.definitions import collect_definition
from rotcal_ros.bags.dropouts import MESSAGE_TYPE, QUEUE, SILENCE, Dropout
from rotcal_ros.bags.rosbag2_metadata import INFINITE_NS, OfferedQos, qos_text
from rotcal_ros.bags.writer import BagWriter
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.foundation.machine_load import end_without_memory
from rotcal_ros.nodes.recorder.bookkeeping import Receipt, Silence
from rotcal_ros.nodes.runtime.conversions import time_message
from rotcal_ros.nodes.runtime.message_types import installed_hash, share_folder
from rotcal_ros.nodes.runtime.timers_and_subscriptions import Batch

_TURN_S: Final = 0.1


@dataclass(frozen=True, slots=True)
class Channel:
    """What the writer needs to know about a topic."""

    topic: str
    type_name: str
    definition: str
    type_hash: str
    offered_qos: str


def described_channel(name: str, type_name: str, infos: Sequence[Any]) -> Channel:
    """Return what a bag says of a topic; BagError when its type is not installed here."""
    hashes = {str(info.topic_type_hash) for info in infos}
    type_hash = hashes.pop() if len(hashes) == 1 else ""
    return Channel(
        topic=name,
        type_name=type_name,
        definition=collect_definition(type_name, share_folder),
        type_hash=type_hash if type_hash.startswith("RIHS") else "",
        offered_qos=qos_text(_offered(info.qos_profile) for info in infos),
    )


@cache
def own_channel(topic: str, type_name: str) -> Channel:
    """Return what a bag says of a topic without publishers: the recorder writes it itself."""
    return Channel(
        topic=topic,
        type_name=type_name,
        definition=collect_definition(type_name, share_folder),
        type_hash=installed_hash(type_name) or "",
        offered_qos=qos_text([OfferedQos(depth=1)]),
    )


def _offered(profile: QoSProfile) -> OfferedQos:
    return OfferedQos(
        history=profile.history.short_key,
        depth=profile.depth,
        reliability=profile.reliability.short_key,
        durability=profile.durability.short_key,
        deadline_ns=_nanoseconds(profile.deadline),
        lifespan_ns=_nanoseconds(profile.lifespan),
        liveliness=profile.liveliness.short_key,
        lease_ns=_nanoseconds(profile.liveliness_lease_duration),
    )


def _nanoseconds(duration: Duration) -> int:
    """Return a duration; "unspecified" (0) and "infinite" are both infinite for rosbag2."""
    nanoseconds: int = duration.nanoseconds
    return nanoseconds if nanoseconds > 0 else INFINITE_NS


@dataclass(frozen=True, slots=True)
class Messages:
    """Serialised messages of one topic with their times of reception and origin in ns."""

    channel: Channel
    items: Sequence[tuple[bytes, int, int]]

    @classmethod
    def taken(cls, channel: Channel, batch: Batch) -> Messages:
        """Return messages as the middleware delivers them, perhaps without times."""
        now_ns = time.time_ns()
        times = ((d, i["received_timestamp"] or now_ns, i["source_timestamp"]) for d, i in batch)
        return cls(channel, [(data, taken, sent or taken) for data, taken, sent in times])

    def at(self, received_ns: Sequence[int]) -> Messages:
        """Return the same messages with other times of reception."""
        times = zip(self.items, received_ns, strict=True)
        return Messages(self.channel, [(data, now, sent) for (data, _, sent), now in times])

    def size(self) -> int:
        """Return the number of payload bytes."""
        return sum(len(data) for data, _, _ in self.items)


class BagRecording:
    """One bag being written. ``confirm`` is called from the thread, after the sync.

    After a failure of the disk ``error`` says why; nothing is confirmed any more, and later
    messages count as lost. ``losses`` are those at the full queue.
    """

    def __init__(
        self, writer: BagWriter, queue_bytes: int, confirm: Callable[[Receipt, str], None]
    ) -> None:
        self._writer = writer
        self._limit = queue_bytes
        self._confirm = confirm
        self._queue: SimpleQueue[Callable[[], object] | None] = SimpleQueue()
        self._waiting = 0
        self._lock = Lock()
        self._channels: dict[Channel, int] = {}
        self.losses: Counter[str] = Counter()
        self._further_losses: Counter[str] = Counter()
        self.messages = 0
        self.error: str | None = None
        self._thread = Thread(target=self._work, name="bag writer", daemon=True)
        self._thread.start()

    @property
    def file(self) -> str:
        """Absolute path of the file that is written now."""
        return str(self._writer.folder / self._writer.files[-1].name)

    @property
    def finished(self) -> bool:
        """Whether the bag is closed."""
        return not self._thread.is_alive()

    def put(self, messages: Messages, *, in_any_case: bool = False) -> bool:
        """Queue messages; with a full queue return False: they are lost and counted."""
        size = messages.size()
        with self._lock:
            full = self._waiting + size > self._limit and not in_any_case
            if self.error or full:
                self.losses[f"{names.QUEUE} {messages.channel.topic}"] += len(messages.items)
                return False
            self._waiting += size
        self._queue.put(partial(self._write, messages))
        return True

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Queue a file that goes beside the messages."""
        self._queue.put(partial(self._writer.attach, name, media_type, data))

    def note(self, name: str, values: Mapping[str, object]) -> None:
        """Queue a metadata record."""
        self._queue.put(partial(self._writer.note, name, values))

    def confirm(self, receipt: Receipt) -> None:
        """Queue a request for a receipt."""
        self._queue.put(partial(self._sync, receipt))

    def close(self, further_losses: Mapping[str, int]) -> None:
        """Close the bag after everything that is queued; see ``finished``.

        ``further_losses`` happened before the queue and go into the bag's counters too.
        """
        self._further_losses = Counter(further_losses)
        self._queue.put(None)

    def join(self, timeout_s: float) -> bool:
        """Wait for the bag to be closed."""
        self._thread.join(timeout_s)
        return self.finished

    def _work(self) -> None:
        work: Callable[[], object] | None = _rest
        while work is not None:
            try:
                work = self._queue.get(timeout=_TURN_S)
            except Empty:
                work = _rest
            try:
                if work is None:
                    self._finish()
                elif not self.error:
                    work()
                    self._writer.tick(time.monotonic_ns())
            except BagError as error:
                self.error = str(error)
            except Exception as error:
                end_without_memory(error, "bag writer")
                self.error = f"the bag writer failed, which is a fault of rotcal_ros: {error!r}"

    def _sync(self, receipt: Receipt) -> None:
        self._writer.sync()
        self._confirm(receipt, self.file)

    def _write(self, messages: Messages) -> None:
        with self._lock:
            self._waiting -= messages.size()
        channel = messages.channel
        if channel not in self._channels:
            self._channels[channel] = self._writer.channel(**asdict(channel))
        number = self._channels[channel]
        for data, received_ns, published_ns in messages.items:
            self._writer.write(number, data, received_ns, published_ns)
        self.messages += len(messages.items)

    def _finish(self) -> None:
        """Keep the loss counters in the bag and close it."""
        losses = self.losses + self._further_losses
        if losses and not self._writer.closed:
            self._writer.note(names.LOSSES, losses)
        self._writer.close()


def _rest() -> None:
    """Pause between two turns of the thread."""


JOINED_WITHIN_S: Final = 1.0
"""Gaps of a topic with the same reason within this time are written as one dropout."""


class DropoutNotes:
    """What is missing from the bag being written: at most a message per topic, reason and second.

    They are written to ``topic``, at the log time of their end.
    """

    def __init__(self, topic: str) -> None:
        self._topic = topic
        self._recording: BagRecording | None = None
        self._waiting: dict[tuple[str, str], tuple[float, Dropout]] = {}

    def begin(self, recording: BagRecording) -> None:
        """Write into ``recording`` from now on; earlier gaps are not noted there."""
        self._recording = recording
        self._waiting.clear()

    def note(self, dropout: Dropout) -> None:
        """Note a dropout; it is joined with those just before it."""
        if self._recording is None or self._recording.error:
            return
        key = (dropout.topic, dropout.reason)
        since_s, earlier = self._waiting.get(key, (time.monotonic(), None))
        self._waiting[key] = since_s, dropout if earlier is None else earlier.joined(dropout)

    def refused(self, messages: Messages) -> None:
        """Note messages for which the queue had no room."""
        times_ns = [received_ns for _, received_ns, _ in messages.items]
        topic, count = messages.channel.topic, len(times_ns)
        self.note(Dropout(topic, min(times_ns), max(times_ns), count, QUEUE))

    def silences(self, ended: list[Silence]) -> None:
        """Note silences that have ended."""
        for silence in ended:
            begin, end = map(_wall_ns, (silence.from_s, silence.to_s))
            self.note(Dropout(silence.topic, begin, end, 0, SILENCE))

    def write(self, older_than_s: float = 0.0) -> None:
        """Write the dropouts that no later one can join any more."""
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
