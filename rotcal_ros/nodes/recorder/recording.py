"""The bags of a session: opened new or continued, and written by a thread from a queue.

Receiving never waits for the disk. The queue is bounded; messages that do not fit are lost and
counted, and a note of what is missing (a dropout) goes into the bag.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from datetime import datetime, timezone
from functools import cache, partial
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Lock, Thread
from typing import Any, Final
from uuid import uuid4

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.duration import Duration
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message, serialize_message
from rotcal_msgs import msg
from std_srvs.srv import Trigger

from rotcal_ros.bags import names
from rotcal_ros.bags.definitions import collect_definition
from rotcal_ros.bags.dropouts import MESSAGE_TYPE, QUEUE, SILENCE, Dropout
from rotcal_ros.bags.interrupted_files import InterruptedSession
from rotcal_ros.bags.reader import bag_files, read_blocks
from rotcal_ros.bags.rosbag2_metadata import INFINITE_NS, OfferedQos, qos_text
from rotcal_ros.bags.session_identity import file_head
from rotcal_ros.bags.settings import RecorderSettings
from rotcal_ros.bags.writer import BagWriter
from rotcal_ros.capture import messages
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.foundation.files import write_atomically
from rotcal_ros.foundation.machine_load import end_without_memory
from rotcal_ros.foundation.observations import Observation
from rotcal_ros.foundation.session_folder import SessionFolder
from rotcal_ros.methods.continuation import Recorded
from rotcal_ros.nodes.recorder.bookkeeping import SilentInterval, WriteReceipt
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
class SerializedMessages:
    """Serialised messages of one topic with their times of reception and origin in ns."""

    channel: Channel
    items: Sequence[tuple[bytes, int, int]]

    @classmethod
    def taken(cls, channel: Channel, batch: Batch) -> SerializedMessages:
        """Return messages as the middleware delivers them, perhaps without times."""
        now_ns = time.time_ns()
        times = ((d, i["received_timestamp"] or now_ns, i["source_timestamp"]) for d, i in batch)
        return cls(channel, [(data, taken, sent or taken) for data, taken, sent in times])

    def at(self, received_ns: Sequence[int]) -> SerializedMessages:
        """Return the same messages with other times of reception."""
        times = zip(self.items, received_ns, strict=True)
        return SerializedMessages(
            self.channel, [(data, now, sent) for (data, _, sent), now in times]
        )

    def size(self) -> int:
        """Return the number of payload bytes."""
        return sum(len(data) for data, _, _ in self.items)


class BagRecording:
    """One bag being written. ``confirm`` is called from the thread, after the sync.

    After a failure of the disk ``error`` says why; nothing is confirmed any more, and later
    messages count as lost. ``losses`` are those at the full queue.
    """

    def __init__(
        self, writer: BagWriter, queue_bytes: int, confirm: Callable[[WriteReceipt, str], None]
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

    def put(self, messages: SerializedMessages, *, in_any_case: bool = False) -> bool:
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

    def confirm(self, receipt: WriteReceipt) -> None:
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

    def _sync(self, receipt: WriteReceipt) -> None:
        self._writer.sync()
        self._confirm(receipt, self.file)

    def _write(self, messages: SerializedMessages) -> None:
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


class DropoutWriter:
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

    def refused(self, messages: SerializedMessages) -> None:
        """Note messages for which the queue had no room."""
        times_ns = [received_ns for _, received_ns, _ in messages.items]
        topic, count = messages.channel.topic, len(times_ns)
        self.note(Dropout(topic, min(times_ns), max(times_ns), count, QUEUE))

    def silences(self, ended: list[SilentInterval]) -> None:
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
                self._recording.put(SerializedMessages(channel, [item]), in_any_case=True)


def _wall_ns(monotonic_s: float) -> int:
    return time.time_ns() - round((time.monotonic() - monotonic_s) * 1e9)


def _message(dropout: Dropout) -> DiagnosticArray:
    status = DiagnosticStatus(
        level=DiagnosticStatus.WARN,
        name=dropout.topic,
        message=dropout.describe(),
        values=[KeyValue(key=key, value=value) for key, value in dropout.values().items()],
    )
    array = DiagnosticArray(status=[status])
    array.header.stamp = time_message(dropout.from_ns)
    return array


@dataclass(frozen=True)
class RunBag:
    """A bag that is open for a run; ``earlier`` holds the observations of the runs before."""

    folder: SessionFolder
    writer: BagWriter
    run: int
    earlier: tuple[Observation, ...] = ()

    def keep(self, configuration_text: str) -> None:
        """Put the configuration into the folder, so that ``rotcal run --resume`` can go on there.

        Opening the bag shows whether the disk can be written.
        """
        if not self.folder.configuration.exists():
            with suppress(OSError):
                write_atomically(self.folder.configuration, configuration_text)


class SessionBags:
    """Opens bags as the settings say; the first one may continue an interrupted session."""

    def __init__(self, settings: RecorderSettings) -> None:
        self._settings = settings
        self._earlier: InterruptedSession | None = None
        self._last: SessionFolder | None = None
        if settings.run:
            bag = self._folder(settings.session).bag
            left = any(bag.glob("*.mcap"))
            self._earlier = InterruptedSession.read(bag) if left else InterruptedSession()

    def open(self, plan_id: str) -> RunBag:
        """Open the bag of a new session (or run of one)."""
        now = datetime.now(timezone.utc)
        name = self._settings.session or f"{now:%Y%m%dT%H%M%SZ}_{plan_id[:8]}"
        folder = self._folder(name)
        earlier, self._earlier = self._earlier, None
        writer = self._writer(folder, earlier)
        self._note(writer, self._settings.run, earlier)
        return RunBag(folder, writer, self._settings.run)

    def go_on(self, plan_id: str, topic: str) -> RunBag:
        """Open the next run of the last session of a plan, with the observations on ``topic``.

        Raises BagError when there is none that could be continued.
        """
        folder = self._unfinished(plan_id)
        earlier = InterruptedSession.read(folder.bag)
        files = [folder.bag / file.name for file in earlier.files]
        observed = observations_in(files, topic)
        writer = self._writer(folder, earlier)
        run = len(files)  # no earlier run has this number: each wrote a file at least
        self._note(writer, run, earlier, earlier=names.RECORDED)
        return RunBag(folder, writer, run, observed)

    def _writer(self, folder: SessionFolder, earlier: InterruptedSession | None) -> BagWriter:
        """Return the writer of a new file that follows the files of ``earlier``."""
        files = None if earlier is None else earlier.files
        writer = BagWriter(folder.bag, self._settings.writer, earlier=files)
        if earlier is not None:
            try:
                earlier.close_before(writer)
            except BagError:
                writer.close()
                raise
        self._last = folder
        return writer

    def _note(
        self, writer: BagWriter, run: int, before: InterruptedSession | None, **more: str
    ) -> None:
        session = (before.session if before else "") or uuid4().hex
        writer.note(names.RUN, {"number": run, "session": session, **more})

    def _unfinished(self, plan_id: str) -> SessionFolder:
        """Return the last session of a plan that has no result yet; BagError: there is none."""
        for folder in self._candidates(plan_id):
            files: tuple[Path, ...] = ()
            with suppress(BagError):
                files = bag_files(folder.bag)
            if files and file_head(files[0]).configuration == plan_id:
                if folder.result.exists():
                    raise BagError(
                        f"the calibration in {folder.path} is finished already; begin a new one"
                    )
                return folder
        place = self._folder(self._settings.session).path
        raise BagError(
            f"{place} holds no session of this plan to continue: it was measured elsewhere, with "
            "another configuration, or not at all; begin a new one with start_index 0"
        )

    def _candidates(self, plan_id: str) -> Iterator[SessionFolder]:
        """Yield where the session of a plan may be, the last one first."""
        if self._last is not None:
            yield self._last
        if self._settings.session:
            yield self._folder(self._settings.session)
        else:
            found = self._folder("").path.glob(f"*_{plan_id[:8]}")
            yield from map(SessionFolder, sorted(found, reverse=True))

    def _folder(self, session: str) -> SessionFolder:
        return SessionFolder((Path(self._settings.folder).expanduser() / session).absolute())


class RecordedSession:
    """The observations of all runs of the session that is being recorded, in order."""

    def __init__(self) -> None:
        self._plan_id, self._run = "", 0
        self._observations: list[Observation] = []

    def begin(self, plan_id: str, run: int = 0, earlier: Iterable[Observation] = ()) -> None:
        """Begin a run; ``earlier`` holds the observations of the runs before it."""
        self._plan_id, self._run = plan_id, run
        self._observations = list(earlier)

    def of_this_run(self, batch: Batch) -> Batch:
        """Return the observations of this run: a turn may outlast the run in which it began.

        What its later angles would need is not in the bag between two runs.
        """
        return [
            (data, info)
            for data, info in batch
            if deserialize_message(data, msg.Observation).run == self._run
        ]

    def take(self, data: bytes) -> msg.Observation:
        """Take an observation that is being recorded, and return its message."""
        message: msg.Observation = deserialize_message(data, msg.Observation)
        self._observations.append(messages.observation(message))
        return message

    def tell(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Answer with all of it, as JSON."""
        recorded = Recorded(self._plan_id, self._run, tuple(self._observations))
        response.success, response.message = bool(self._plan_id), recorded.to_json()
        return response


def observations_in(files: Sequence[Path], topic: str) -> tuple[Observation, ...]:
    """Return the observations on ``topic`` in the files of a session, in their order.

    Raises BagError when a file cannot be read.
    """
    found: list[Observation] = []
    for scan, block in read_blocks(tuple(files)):
        here = [number for number, channel in scan.channels.items() if channel.topic == topic]
        if block is not None and here:
            rows = np.flatnonzero(np.isin(block.headers["channel"], here)).tolist()
            found += (_observation(block.payload(row), scan.path) for row in rows)
    return tuple(found)


def _observation(data: bytes, file: Path) -> Observation:
    """Return a message as the bag holds it, by rclpy: our own decoder takes longer to load."""
    try:
        return messages.observation(deserialize_message(data, msg.Observation))
    except Exception as error:
        raise BagError(
            f"{file}: an observation of another version ({error}): begin a new calibration, or go "
            "on with the version that began it"
        ) from error
