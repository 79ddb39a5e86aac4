"""The recorder: every topic of the cell as raw bytes, on disk before the next step.

Writing dropouts into the bag: at their place, and never many.

The bags of a session: begun, or gone on with after an interruption.

Receipts: an observation is confirmed once it and the readings of its window are on disk.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, Final, TypeAlias
from uuid import uuid4

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.serialization import deserialize_message, serialize_message
from rotcal_msgs.msg import ProbePoint, RecordedObservation
from rotcal_msgs.srv import StartRecording, StopRecording
from std_srvs.srv import Trigger

from rotcal_ros.bags import names
from rotcal_ros.bags.closing import InterruptedSession
from rotcal_ros.bags.dropouts import MESSAGE_TYPE, QUEUE, SILENCE, Dropout
from rotcal_ros.bags.reader import bag_files
from rotcal_ros.bags.recorder_settings import RecorderSettings
from rotcal_ros.bags.session_identity import file_head
from rotcal_ros.bags.writer import BagWriter
from rotcal_ros.clock_jumps import noted
from rotcal_ros.errors import BagError, RotcalError
from rotcal_ros.files import write_atomically
from rotcal_ros.instruments.forms import OWN
from rotcal_ros.instruments.interpreter import FAST
from rotcal_ros.messages import stamp_ns
from rotcal_ros.nodes.runtime.cell_node import IDLE_S, CellNode, until
from rotcal_ros.nodes.runtime.channels import own_channel
from rotcal_ros.nodes.runtime.conversions import time_message
from rotcal_ros.nodes.runtime.draining import GRAPH_PERIOD_S, Batch
from rotcal_ros.nodes.runtime.health import RECORDING_FAILED
from rotcal_ros.nodes.runtime.heartbeat import HEARTBEAT
from rotcal_ros.nodes.runtime.qos import EVENT
from rotcal_ros.nodes.runtime.roll_call import LOADING
from rotcal_ros.nodes.runtime.running import done_aside, run
from rotcal_ros.nodes.runtime.topic_names import CalledOtherwise
from rotcal_ros.nodes.runtime.turns import handle_events
from rotcal_ros.nodes.writing.bookkeeping import (
    NEEDED,
    LogTimes,
    PendingReceipts,
    Silence,
    Silences,
)
from rotcal_ros.nodes.writing.heard_topic import HeardTopic
from rotcal_ros.nodes.writing.listening import Listener
from rotcal_ros.nodes.writing.recorded_session import RecordedSession, observations_in
from rotcal_ros.nodes.writing.recording import Messages, Receipt, Recording
from rotcal_ros.nodes.writing.surroundings import Parameters, keep_surroundings
from rotcal_ros.observations import Observation
from rotcal_ros.session_folder import SessionFolder

CLOSE_TIMEOUT_S: Final = 15.0
Request: TypeAlias = StartRecording.Request
Response: TypeAlias = StartRecording.Response


class RecorderNode(CellNode):
    """Listens to everything from the start; writes between start and stop."""

    def __init__(self) -> None:
        super().__init__("recorder")

    def configure(self) -> None:
        """Get ready to write."""
        self._settings = self.settings("recorder", RecorderSettings)
        self._bags, self._session = SessionBags(self._settings), RecordedSession()
        self._recording: Recording | None = None
        self._silences = Silences(self._settings.silence_s, time.monotonic())
        self._jumps_before, self._reading, self._unwanted = 0, False, False
        self._log_times = LogTimes(self._clock_jumps)
        self.offer(StartRecording, "start_recording", self._start)
        self.offer(StartRecording, "continue_recording", self._go_on)
        self.offer(StopRecording, "stop_recording", self._stop, always=True)
        self.offer(Trigger, "recorded_observations", self._session.tell)
        self._called = CalledOtherwise(self.get_namespace())
        self._dropouts = DropoutNotes(self.resolve_topic_name(f"~/{names.DROPOUTS}"))
        heard = self._take, self._dropouts.note, self._called.topics.values
        self._listener = Listener(self, *heard, fast=self._is_fast)
        self._receipts = Receipts(self, self._called, self._listener, self._session)
        self.every(GRAPH_PERIOD_S, self._note_losses)

    def deactivated(self) -> None:
        """Write what has arrived and close the bag, also one that is about to be opened."""
        self._unwanted = True
        self._close()

    def stopped(self) -> bool:
        """Return whether the bag is closed."""
        return self._writing() is None and not self._reading

    def gather_s(self) -> float:
        """Let messages gather while no bag is open."""
        return IDLE_S if not self.configured or self._writing() is None else 0.0

    def _writing(self) -> Recording | None:
        """Return the recording whose bag is open."""
        return self._recording if self._recording and not self._recording.finished else None

    def _note_losses(self) -> None:
        """Keep losses and their counters in the bag, so that they outlive this node."""
        self._called.look(self.health.values)
        recording = self._writing()
        if recording is None:
            return
        heard = self._listener.heard_s(self._called.role)
        self._called.keep_in(recording)
        self._dropouts.silences(self._silences.look(heard, time.monotonic()))
        self._dropouts.write(TOGETHER_S)
        if counters := self._all_losses() + self._silences.counts:
            recording.note(names.LOSSES, counters)
        if jumps := self.health.clock.since(self._jumps_before):
            recording.note(names.CLOCK_JUMPS, noted(jumps))

    def _take(self, topic: HeardTopic, batch: Batch) -> None:
        if (recording := self._writing()) is None:
            return
        messages = Messages.taken(topic.channel, batch)
        arrived_ns = [received_ns for _, received_ns, _ in messages.items]
        messages = messages.at(self._log_times.ascending(topic.channel.topic, arrived_ns))
        if not recording.put(messages):
            self._dropouts.refused(messages)
        if topic.channel.topic == self._called.topic(names.OBSERVATION):
            self._listener.take_fast()  # its receipt is due once the readings before it are here
        self._receipts.hear(topic, batch)
        for receipt in self._receipts.due(self._all_losses):
            self._dropouts.write()
            recording.confirm(receipt)

    def _is_fast(self, topic: str) -> bool:
        return topic in map(self._called.topic, (*FAST, HEARTBEAT))

    def _clock_jumps(self) -> int:
        """Return how often the clock was set, just now included."""
        self.health.clock.look()
        return self.health.clock.watch.count

    def _all_losses(self) -> Counter[str]:
        """Return what was lost since the bag was opened, here and at the full queue."""
        handle_events(self)
        queued = self._recording.losses if self._recording is not None else Counter[str]()
        return self._listener.losses + queued

    def _start(self, request: Request, response: Response) -> Response:
        try:
            if (open_one := self._writing()) is not None:
                raise BagError(f"the recorder is writing {open_one.file}; stop it first")
            self._begin(request, self._bags.open(request.plan_id), response)
        except (BagError, OSError) as error:
            response.message = str(error)
        return response

    async def _go_on(self, request: Request, response: Response) -> Response:
        """Record the next run of the last session of a plan; what is still open is closed."""
        self._close()
        topic = self._called.topic(names.OBSERVATION)
        try:
            if not await until(self.stopped, CLOSE_TIMEOUT_S):
                raise BagError("the recorder is still closing the bag of the run before")
            self._reading, self._unwanted = True, False
            self.health.beat()  # before the reading can hold it up
            bag = await done_aside(self._bags.go_on, request.plan_id, topic)
            if self._unwanted:
                bag.writer.close()
                raise BagError("the recorder was deactivated or ended meanwhile")
            self._begin(request, bag, response)
        except (RotcalError, OSError) as error:
            response.message = str(error)
        finally:
            self._reading = False
        return response

    def _begin(self, request: Request, bag: OpenBag, response: Response) -> None:
        """Record into ``bag`` from now on."""
        self._listener.drain()  # of what came before
        self._receipts.begin()
        self._jumps_before = self.health.clock.watch.count
        self._listener.begin(request.configuration)
        self._silences = Silences(self._settings.silence_s, time.monotonic())
        self._session.begin(request.plan_id, bag.run, bag.earlier)
        recording = Recording(bag.writer, self._settings.queue_bytes, self._receipts.confirm)
        self._dropouts.begin(recording)
        self._called.keep_in(recording)  # before the configuration, where readers stop to look
        keep_surroundings(recording, request.configuration)
        bag.keep(request.configuration)
        self._listener.tell_again(recording.put)
        self._recording = recording
        self._asked = Parameters(recording, self)
        self.begin(self._asked.ask)
        response.folder, response.success = str(bag.folder.path), True

    async def _stop(
        self, _request: StopRecording.Request, response: StopRecording.Response
    ) -> StopRecording.Response:
        recording = self._recording
        if recording is None:
            response.message = "nothing is being recorded"
            return response
        self._close()
        await until(lambda: recording.finished, CLOSE_TIMEOUT_S)
        response.success, losses = recording.finished and not recording.error, self._all_losses()
        response.message = recording.error or ", ".join(f"{n}: {k}" for k, n in losses.items())
        response.file, response.messages = recording.file, recording.messages
        response.lost = sum(losses.values())
        return response

    def _close(self) -> None:
        """Take what has arrived and close the bag behind it."""
        if (recording := self._writing()) is not None:
            self._listener.drain()
            self._asked.attach()
            self._dropouts.silences(self._silences.end(time.monotonic()))
            self._dropouts.write()
            recording.close(self._listener.losses + self._silences.counts)

    def _node_lost(self, name: str) -> None:
        """Without its planner a calibration is over: close the bag."""
        if name == "planner" and self._writing() is not None:
            self.get_logger().error("the planner is lost: closing the bag")
            self._close()

    def _report(self) -> tuple[str, dict[str, Any]]:
        values = {"topics": len(self._listener.topics), **self._listener.refused}
        values |= self._all_losses() + self._silences.counts
        recording = self._recording
        if recording is not None and recording.error:
            return f"{RECORDING_FAILED}: {recording.error}", values
        if recording is None or recording.finished:
            return LOADING if self._reading else "idle", values
        return "recording", values | {"file": recording.file, "messages": recording.messages}


TOGETHER_S: Final = 1.0
"""Gaps of a topic for the same reason within this time are written as one dropout."""


class DropoutNotes:
    """What the bag that is written misses: at most a message per topic, reason and second.

    They stand in the bag at the log time of their end, on ``topic``.
    """

    def __init__(self, topic: str) -> None:
        self._topic = topic
        self._recording: Recording | None = None
        self._waiting: dict[tuple[str, str], tuple[float, Dropout]] = {}

    def begin(self, recording: Recording) -> None:
        """Write into ``recording`` from now on; what was missing before is not told there."""
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
        """Write those that have waited so long."""
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


@dataclass(frozen=True)
class OpenBag:
    """A bag that is open for a run; ``earlier`` is what the runs before observed."""

    folder: SessionFolder
    writer: BagWriter
    run: int
    earlier: tuple[Observation, ...] = ()

    def keep(self, configuration_text: str) -> None:
        """Put the configuration into the folder, so that ``rotcal run --resume`` can go on there.

        Whether the disk can be written the bag itself tells.
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

    def open(self, plan_id: str) -> OpenBag:
        """Open the bag of a new session (or run of one)."""
        now = datetime.now(timezone.utc)
        name = self._settings.session or f"{now:%Y%m%dT%H%M%SZ}_{plan_id[:8]}"
        folder = self._folder(name)
        earlier, self._earlier = self._earlier, None
        writer = self._writer(folder, earlier)
        self._note(writer, self._settings.run, earlier)
        return OpenBag(folder, writer, self._settings.run)

    def go_on(self, plan_id: str, topic: str) -> OpenBag:
        """Open the next run of the last session of a plan, with the observations on ``topic``.

        Raises BagError when there is none that could be gone on with.
        """
        folder = self._unfinished(plan_id)
        earlier = InterruptedSession.read(folder.bag)
        files = [folder.bag / file.name for file in earlier.files]
        observed = observations_in(files, topic)
        writer = self._writer(folder, earlier)
        run = len(files)  # no earlier run has this number: each wrote a file at least
        self._note(writer, run, earlier, earlier=names.RECORDED)
        return OpenBag(folder, writer, run, observed)

    def _writer(self, folder: SessionFolder, earlier: InterruptedSession | None) -> BagWriter:
        """Return the writer of a new file, behind the files of ``earlier``."""
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
            f"{place} holds no session of this plan to go on with: it was measured elsewhere, "
            "with another configuration, or not at all; begin a new one with start_index 0"
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


class Receipts:
    """The receipts of a recorder that are due, and their topic."""

    def __init__(
        self, node: CellNode, called: CalledOtherwise, listener: Listener, session: RecordedSession
    ) -> None:
        self._clock, self._called, self._listener = node.get_clock(), called, listener
        self._logger, self._awake = node.get_logger(), node.health.awake
        self._session, self._pending = session, PendingReceipts(answered=False)
        self._publisher = node.create_publisher(
            RecordedObservation, names.OBSERVATION_RECORDED, EVENT
        )

    def begin(self) -> None:
        """Forget what is still waiting: a bag begins."""
        points = self._listener.topics.get(self._called.topic(names.PROBE_POINT))
        self._pending = PendingReceipts(answered=points is not None and _echoes(points))

    def hear(self, topic: HeardTopic, batch: Batch) -> None:
        """Take observations, which want a receipt, and the points that answer orders."""
        name = topic.channel.topic
        if name == self._called.topic(names.OBSERVATION):
            for data, _ in batch:
                seen = self._session.take(data)
                self._pending.expect(seen.step, seen.attempt, stamp_ns(seen.window_end))
        elif name == self._called.topic(names.PROBE_POINT) and _echoes(topic):
            for data, _ in batch:
                point = deserialize_message(data, ProbePoint)
                self._pending.answer(point.step, point.attempt)

    def due(self, losses: Callable[[], Mapping[str, int]]) -> Iterator[Receipt]:
        """Yield what can be confirmed; ``losses`` are those since the bag was opened."""
        reached_ns = self._listener.reached_ns(NEEDED, self._called.topic)
        if not self._pending:
            self._pending.reach(reached_ns or 0)
            return
        lost = self._called.lost(losses())
        for receipt in self._pending.due(reached_ns, lost, self._awake.now_s()):
            if not self._pending.is_answered(receipt):
                self._logger.warning(
                    f"step {receipt.step}, attempt {receipt.attempt}: the point that answered the "
                    "order has not come here; it counts as lost"
                )
            yield receipt

    def confirm(self, receipt: Receipt, file: str) -> None:
        """Publish a receipt; called from the writer's thread."""
        message = RecordedObservation(**asdict(receipt), file=file)
        message.header.stamp = self._clock.now().to_msg()
        self._publisher.publish(message)


def _echoes(points: HeardTopic) -> bool:
    """Return whether the points tell which order they answer."""
    return points.channel.type_name == OWN[names.PROBE_POINT]


def main() -> None:
    """Run the recorder."""
    run(RecorderNode)


if __name__ == "__main__":
    main()
