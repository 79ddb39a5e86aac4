"""The recorder: every topic of the cell as raw bytes, on disk before the next step."""

from __future__ import annotations

import sys
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, Final

from rclpy.node import Node
from rclpy.serialization import deserialize_message
from rotcal_msgs.msg import Observation as ObservationMsg
from rotcal_msgs.msg import RecordedObservation
from rotcal_msgs.srv import StartRecording, StopRecording

from rotcal_ros.bags import names
from rotcal_ros.bags.names import ROLES
from rotcal_ros.bags.reader import session_files
from rotcal_ros.bags.recorder_settings import RecorderSettings
from rotcal_ros.bags.rosbag2_metadata import FileInfo
from rotcal_ros.bags.writer import BagWriter
from rotcal_ros.errors import BagError
from rotcal_ros.nodes.conversions import stamp_ns
from rotcal_ros.nodes.draining import GRAPH_PERIOD_S, Batch
from rotcal_ros.nodes.goal_run import BAG, FAILED
from rotcal_ros.nodes.health import Health
from rotcal_ros.nodes.listening import HeardTopic, Listener
from rotcal_ros.nodes.parameter_snapshot import parameters_json
from rotcal_ros.nodes.parameters import declare_settings
from rotcal_ros.nodes.qos import EVENT
from rotcal_ros.nodes.recording import Attachment, Messages, Note, Receipt, Recording
from rotcal_ros.nodes.running import run_node
from rotcal_ros.nodes.silence import Silences
from rotcal_ros.nodes.versions import versions_json
from rotcal_ros.nodes.waiting import until

CLOSE_TIMEOUT_S: Final = 15.0


class RecorderNode(Node):
    """Listens to everything from the start; writes between start and stop."""

    def __init__(self) -> None:
        super().__init__("recorder")
        self._settings = declare_settings(self, "recorder", RecorderSettings)
        self._earlier = self._earlier_files()
        self._recording: Recording | None = None
        self._lost_told = 0
        self._silences = Silences(self._settings.silence_s)
        self._pending: list[tuple[int, Receipt]] = []
        self._health = Health(self, self._report, self._lost_node)
        self._receipts = self.create_publisher(RecordedObservation, "observation_recorded", EVENT)
        self.create_service(StartRecording, "start_recording", self._start)
        self.create_service(StopRecording, "stop_recording", self._stop)
        self._observation_topic = self.resolve_topic_name(names.OBSERVATION)
        self._tracer_topic = self.resolve_topic_name(names.TRACER_LENGTH)
        self._listener = Listener(self, self._health, self._take)
        self.create_timer(GRAPH_PERIOD_S, self._health.guarded(self._note_losses))

    def begin_stop(self) -> None:
        """Write what has arrived and close the bag."""
        self._close()

    def stopped(self) -> bool:
        """Return whether the bag is closed."""
        done = self._recording is None or self._recording.finished
        if done:
            self._health.leave()
        return done

    def _note_losses(self) -> None:
        """Keep the loss counters in the bag, so that they outlive this node."""
        if self._recording is None or self._recording.finished:
            return
        heard = {name: topic.heard_s for name, topic in self._listener.topics.items()}
        self._silences.look(heard, time.monotonic())
        if counters := self._all_losses() + self._silences.counts:
            self._recording.put(Note(names.LOSSES, counters))

    def _take(self, topic: HeardTopic, batch: Batch) -> None:
        if self._recording is not None:
            now_ns = time.time_ns()
            times = (
                (d, i["received_timestamp"] or now_ns, i["source_timestamp"]) for d, i in batch
            )
            items = [(data, received, sent or received) for data, received, sent in times]
            self._recording.put(Messages(topic.channel, items))
        if topic.channel.topic == self._observation_topic:
            self._expect_receipts(batch)
        self._settle_receipts()

    def _expect_receipts(self, batch: Batch) -> None:
        for data, _ in batch:
            message = deserialize_message(data, ObservationMsg)
            receipt = Receipt(message.step, message.attempt)
            self._pending.append((stamp_ns(message.window_end), receipt))

    def _settle_receipts(self) -> None:
        """Queue a receipt once the readings of its window have arrived here too."""
        if not self._pending or self._recording is None:
            return
        streams = map(self.resolve_topic_name, (names.TRACER_LENGTH, names.PROBE_POINT))
        stream = next(
            (self._listener.topics[name] for name in streams if name in self._listener.topics),
            None,
        )
        reached = None if stream is None else stream.latest_stamp_ns()
        waiting = []
        for window_end_ns, receipt in self._pending:
            if reached is None or reached >= window_end_ns:
                total = self._lost_in_streams()
                self._recording.put(replace(receipt, lost=total - self._lost_told))
                self._lost_told = total
            else:
                waiting.append((window_end_ns, receipt))
        self._pending = waiting

    def _all_losses(self) -> Counter[str]:
        """Return what was lost since the bag was opened, here and at the full queue."""
        queued = self._recording.losses if self._recording is not None else Counter[str]()
        return self._listener.losses + queued

    def _lost_in_streams(self) -> int:
        """Return how many of the messages were lost that a replay needs."""
        losses = self._all_losses().items()
        return sum(count for where, count in losses if where.rpartition("/")[2] in ROLES)

    def _confirm(self, receipt: Receipt, file: str) -> None:
        """Publish a receipt; called from the writer's thread."""
        message = RecordedObservation(
            step=receipt.step, attempt=receipt.attempt, lost=receipt.lost, file=file
        )
        message.header.stamp = self.get_clock().now().to_msg()
        self._receipts.publish(message)

    def _start(
        self, request: StartRecording.Request, response: StartRecording.Response
    ) -> StartRecording.Response:
        try:
            folder = self._open(request)
            response.folder, response.success = str(folder), True
        except (BagError, OSError) as error:
            response.message = str(error)
        return response

    def _session_folder(self, session: str) -> Path:
        return (Path(self._settings.folder).expanduser() / session).absolute()

    def _earlier_files(self) -> tuple[FileInfo, ...] | None:
        """Read the files that this run continues; None when it begins a session."""
        if not self._settings.run:
            return None
        folder = self._session_folder(self._settings.session) / BAG
        return session_files(folder) if any(folder.glob("*.mcap")) else ()

    def _open(self, request: StartRecording.Request) -> Path:
        if self._recording is not None and not self._recording.finished:
            raise BagError(f"the recorder is writing {self._recording.file}; stop it first")
        settings = self._settings
        now = datetime.now(timezone.utc)
        session = settings.session or f"{now:%Y%m%dT%H%M%SZ}_{request.plan_id[:8]}"
        folder = self._session_folder(session)
        writer = BagWriter(folder / BAG, settings.writer, earlier=self._earlier)
        self._earlier = None
        writer.note(names.RUN, {"number": settings.run})
        self._pending.clear()
        self._listener.forget_losses()
        self._lost_told = 0
        self._silences.begin(time.monotonic())
        self._recording = Recording(writer, settings.queue_bytes, self._confirm)
        for name, media_type, text in (
            (names.CONFIGURATION, "application/yaml", request.configuration),
            (names.VERSIONS, "application/json", versions_json()),
        ):
            self._recording.put(Attachment(name, media_type, text.encode()))
        self.executor.create_task(self._attach_parameters, self._recording)
        return folder

    async def _attach_parameters(self, recording: Recording) -> None:
        """Ask all nodes for their parameters, while the calibration begins."""
        text = await parameters_json(self, self._health.present())
        recording.put(Attachment(names.PARAMETERS, "application/json", text.encode()))

    async def _stop(
        self, _request: StopRecording.Request, response: StopRecording.Response
    ) -> StopRecording.Response:
        recording = self._recording
        if recording is None:
            response.message = "nothing is being recorded"
            return response
        self._close()
        await until(lambda: recording.finished, CLOSE_TIMEOUT_S)
        response.success = recording.finished and not recording.error
        losses = self._all_losses()
        response.message = recording.error or ", ".join(f"{n}: {k}" for k, n in losses.items())
        response.file, response.messages = recording.file, recording.messages
        response.lost = sum(losses.values())
        return response

    def _close(self) -> None:
        """Take what has arrived and close the bag behind it."""
        if self._recording is None or self._recording.finished:
            return
        self._listener.drain()
        self._recording.close(self._listener.losses + self._silences.counts)

    def _lost_node(self, name: str) -> None:
        """Without its planner a calibration is over: close the bag."""
        if name == "planner" and self._recording is not None and not self._recording.finished:
            self.get_logger().error("the planner is lost: closing the bag")
            self._close()

    def _report(self) -> tuple[str, dict[str, Any]]:
        listener = self._listener
        values: dict[str, Any] = {"topics": len(listener.topics), **listener.refused}
        values |= self._all_losses() + self._silences.counts
        recording = self._recording
        if recording is not None and recording.error:
            return f"{FAILED}: {recording.error}", values
        if recording is None or recording.finished:
            return "idle", values
        values |= {"file": recording.file, "messages": recording.messages}
        return "recording", values


def make() -> Node:
    """Return the node."""
    return RecorderNode()


def main(args: Sequence[str] | None = None) -> None:
    """Run the recorder."""
    sys.exit(run_node(make, args))


if __name__ == "__main__":
    main()
