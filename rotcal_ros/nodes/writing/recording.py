"""The writer's side of the recorder: a thread that puts a queue of messages on the disk.

The taking of messages never waits for the disk. The queue is bounded; what does not fit is lost
and counted.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from queue import Empty, SimpleQueue
from threading import Lock, Thread
from typing import Final

from rotcal_ros.bags import names
from rotcal_ros.bags.writer import BagWriter
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.nodes.runtime.draining import Batch
from rotcal_ros.nodes.runtime.memory import end_without_memory

_TURN_S: Final = 0.1


@dataclass(frozen=True, slots=True)
class Channel:
    """What the writer needs to know of a topic."""

    topic: str
    type_name: str
    definition: str
    type_hash: str
    offered_qos: str


@dataclass(frozen=True, slots=True)
class Messages:
    """Serialised messages of one topic with their times of reception and origin in ns."""

    channel: Channel
    items: Sequence[tuple[bytes, int, int]]

    @classmethod
    def taken(cls, channel: Channel, batch: Batch) -> Messages:
        """Return messages as they were taken from the middleware, which may know no times."""
        now_ns = time.time_ns()
        times = ((d, i["received_timestamp"] or now_ns, i["source_timestamp"]) for d, i in batch)
        return cls(channel, [(data, taken, sent or taken) for data, taken, sent in times])

    def at(self, received_ns: Sequence[int]) -> Messages:
        """Return them with other times of reception."""
        times = zip(self.items, received_ns, strict=True)
        return Messages(self.channel, [(data, now, sent) for (data, _, sent), now in times])

    def size(self) -> int:
        """Return the number of payload bytes."""
        return sum(len(data) for data, _, _ in self.items)


@dataclass(frozen=True, slots=True)
class Receipt:
    """A request to confirm that everything before it is on disk; ``lost`` messages are not."""

    step: int
    attempt: int
    lost: int = 0


class BagRecording:
    """One bag being written. ``confirm`` is called from the thread, after the sync.

    After a failure of the disk ``error`` says why, nothing is confirmed any more, and what still
    arrives counts as lost. ``losses`` are those at the full queue.
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
        self.error = ""
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
        """Queue messages; those that find the queue full are lost and counted: False."""
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
    """Do nothing for a turn."""
