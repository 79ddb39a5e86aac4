"""The recorder: every topic of the cell as raw bytes, on disk before the next step."""

from __future__ import annotations

import struct
import sys
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, Final

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from rotcal_msgs.msg import Observation as ObservationMsg
from rotcal_msgs.msg import RecordedObservation
from rotcal_msgs.srv import StartRecording, StopRecording

from rotcal_ros.bags import names
from rotcal_ros.bags.recorder_settings import RecorderSettings
from rotcal_ros.bags.writer import BagWriter
from rotcal_ros.errors import BagError
from rotcal_ros.nodes.conversions import stamp_ns
from rotcal_ros.nodes.draining import GRAPH_PERIOD_S, Batch, DrainedSubscription
from rotcal_ros.nodes.goal_run import BAG
from rotcal_ros.nodes.health import Health
from rotcal_ros.nodes.parameters import declare_settings
from rotcal_ros.nodes.qos import EVENT
from rotcal_ros.nodes.recording import Attachment, Channel, Messages, Receipt, Recording
from rotcal_ros.nodes.running import run_node
from rotcal_ros.nodes.topic_discovery import DiscoveredTopic, discover, wanted_topics
from rotcal_ros.nodes.versions import versions_json
from rotcal_ros.nodes.waiting import until

CLOSE_TIMEOUT_S: Final = 15.0
_STAMP: Final = struct.Struct("<4xiI")
"""CDR encapsulation, then the stamp that begins every message with a header."""


@dataclass
class RecordedTopic:
    """A topic that is listened to: its channel and how far it has come."""

    discovered: DiscoveredTopic
    channel: Channel
    received: int = 0
    latest: bytes = b""
    sequences: dict[bytes, int] = field(default_factory=dict)

    def latest_stamp_ns(self) -> int:
        """Return the stamp of the newest message, which must have a header."""
        if not self.latest:
            return 0
        seconds, nanoseconds = _STAMP.unpack_from(self.latest)
        return int(seconds) * 1_000_000_000 + int(nanoseconds)


class RecorderNode(Node):
    """Listens to everything from the start; writes between start and stop."""

    def __init__(self) -> None:
        super().__init__("recorder")
        self._settings = declare_settings(self, "recorder", RecorderSettings)
        self._recording: Recording | None = None
        self._topics: dict[str, RecordedTopic] = {}
        self._drained: list[DrainedSubscription] = []
        self._refused: dict[str, str] = {}
        self._losses: Counter[str] = Counter()
        self._pending: list[tuple[int, Receipt]] = []
        self._health = Health(self, self._report, self._lost_node)
        guarded = self._health.guarded
        self._receipts = self.create_publisher(RecordedObservation, "observation_recorded", EVENT)
        self.create_service(StartRecording, "start_recording", self._start)
        self.create_service(StopRecording, "stop_recording", self._stop)
        self.create_timer(GRAPH_PERIOD_S, guarded(self._look))

    def begin_stop(self) -> None:
        """Write what has arrived and close the bag."""
        self._close()

    def stopped(self) -> bool:
        """Return whether the bag is closed."""
        done = self._recording is None or self._recording.finished
        if done:
            self._health.leave()
        return done

    def _look(self) -> None:
        """Subscribe to topics that are new in the graph."""
        for name, type_name in wanted_topics(self).items():
            if name in self._topics or name in self._refused:
                continue
            try:
                discovered = discover(self, name, type_name)
            except BagError as error:
                self._refused[name] = str(error)
                self.get_logger().error(f"{name} cannot be recorded: {error}")
                continue
            if discovered is not None:
                self._subscribe(discovered)

    def _subscribe(self, found: DiscoveredTopic) -> None:
        channel = Channel(
            found.name, found.type_name, found.definition, found.type_hash, found.offered_qos
        )
        topic = self._topics[found.name] = RecordedTopic(found, channel)
        is_observation = found.name == self.resolve_topic_name(names.OBSERVATION)

        def handle(batch: Batch) -> None:
            self._take(topic, batch)
            if is_observation:
                self._expect_receipts(batch)
            self._settle_receipts()

        def message_lost(event: Any) -> None:
            self._losses[f"middleware {found.name}"] += event.total_count_change

        self._drained.append(
            DrainedSubscription(
                self,
                found.message_type,
                found.name,
                found.qos,
                self._health.guarded(handle),
                raw=True,
                event_callbacks=SubscriptionEventCallbacks(message_lost=message_lost),
            )
        )

    def _take(self, topic: RecordedTopic, batch: Batch) -> None:
        topic.received += len(batch)
        topic.latest = batch[-1][0]
        self._count_gaps(topic, batch)
        if self._recording is not None:
            now_ns = time.time_ns()
            times = (
                (d, i["received_timestamp"] or now_ns, i["source_timestamp"]) for d, i in batch
            )
            items = [(data, received, sent or received) for data, received, sent in times]
            self._recording.put(Messages(topic.channel, items))

    def _count_gaps(self, topic: RecordedTopic, batch: Batch) -> None:
        """Count messages that the middleware numbered but never delivered, per publisher."""
        for _, info in batch:
            number, publisher = info.get("publication_sequence_number"), info.get("publisher_gid")
            if not number or publisher is None:
                return
            gid = bytes(publisher["data"])
            last = topic.sequences.get(gid, number - 1)
            if number > last + 1:
                self._losses[f"gap {topic.channel.topic}"] += number - last - 1
            topic.sequences[gid] = number

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
        stream = next((self._topics[name] for name in streams if name in self._topics), None)
        reached = None if stream is None else stream.latest_stamp_ns()
        waiting = []
        for window_end_ns, receipt in self._pending:
            if reached is None or reached >= window_end_ns:
                self._recording.put(receipt)
            else:
                waiting.append((window_end_ns, receipt))
        self._pending = waiting

    def _confirm(self, receipt: Receipt, file: str) -> None:
        """Publish a receipt; called from the writer's thread."""
        message = RecordedObservation(step=receipt.step, attempt=receipt.attempt, file=file)
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

    def _open(self, request: StartRecording.Request) -> Path:
        if self._recording is not None and not self._recording.finished:
            raise BagError(f"the recorder is writing {self._recording.file}; stop it first")
        settings = self._settings
        now = datetime.now(timezone.utc)
        session = settings.session or f"{now:%Y%m%dT%H%M%SZ}_{request.plan_id[:8]}"
        folder = (Path(settings.folder).expanduser() / session).absolute()
        writer = BagWriter(folder / BAG, settings.writer)
        self._pending.clear()
        self._losses.clear()
        self._recording = Recording(writer, settings.queue_bytes, self._confirm)
        for name, media_type, text in (
            (names.CONFIGURATION, "application/yaml", request.configuration),
            (names.VERSIONS, "application/json", versions_json()),
        ):
            self._recording.put(Attachment(name, media_type, text.encode()))
        return folder

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
        response.message = recording.error or self._loss_text()
        response.file, response.messages = recording.file, recording.messages
        response.lost = sum(self._losses.values())
        return response

    def _close(self) -> None:
        """Take what has arrived and close the bag behind it."""
        if self._recording is None or self._recording.finished:
            return
        for drained in self._drained:
            drained.drain()
        self._losses.update(self._recording.losses)
        self._recording.losses = Counter(self._losses)
        self._recording.close()

    def _lost_node(self, name: str) -> None:
        """Without its planner a calibration is over: close the bag."""
        if name == "planner" and self._recording is not None and not self._recording.finished:
            self.get_logger().error("the planner is lost: closing the bag")
            self._close()

    def _loss_text(self) -> str:
        return ", ".join(f"{count} messages: {where}" for where, count in self._losses.items())

    def _report(self) -> tuple[str, dict[str, Any]]:
        values: dict[str, Any] = {"topics": len(self._topics), **self._refused}
        values |= {f"lost {where}": count for where, count in self._losses.items()}
        recording = self._recording
        if recording is None or recording.finished:
            return "idle", values
        values |= {f"lost {where}": count for where, count in recording.losses.items()}
        values |= {"file": recording.file, "messages": recording.messages}
        return recording.error or "recording", values


def make() -> Node:
    """Return the node."""
    return RecorderNode()


def main(args: Sequence[str] | None = None) -> None:
    """Run the recorder."""
    sys.exit(run_node(make, args))


if __name__ == "__main__":
    main()
