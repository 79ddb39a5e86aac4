"""The recorder node: writes every topic of the cell to disk before the next step begins.

An observation is confirmed by a receipt once it and all readings of its window are on the disk.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict
from typing import Any, Final, TypeAlias

from rclpy.serialization import deserialize_message
from rotcal_msgs import msg
from rotcal_msgs.srv import StartRecording, StopRecording
from std_srvs.srv import Trigger

from rotcal_ros.bags import names
from rotcal_ros.bags.settings import RecorderSettings
from rotcal_ros.bags.topic_roles import CalledOtherwise
from rotcal_ros.capture.instruments.conventions import OWN
from rotcal_ros.capture.instruments.interpreter import FAST
from rotcal_ros.capture.messages import stamp_ns
from rotcal_ros.foundation.clock_jumps import jumps_to_metadata
from rotcal_ros.foundation.errors import BagError, RotcalError
from rotcal_ros.foundation.node_state import LOADING, NodeState, State, Why
from rotcal_ros.nodes.recorder.bookkeeping import (
    NEEDED,
    LogTimes,
    PendingReceipts,
    Receipt,
    Silences,
)
from rotcal_ros.nodes.recorder.provenance import NodeParameters, keep_provenance
from rotcal_ros.nodes.recorder.recording import (
    JOINED_WITHIN_S,
    BagRecording,
    DropoutNotes,
    Messages,
)
from rotcal_ros.nodes.recorder.session_bags import OpenBag, RecordedSession, SessionBags
from rotcal_ros.nodes.recorder.topic_listener import HeardTopic, TopicListener
from rotcal_ros.nodes.runtime.beat_values import LISTENS
from rotcal_ros.nodes.runtime.cell_node import IDLE_S, CellNode, until
from rotcal_ros.nodes.runtime.qos import EVENT
from rotcal_ros.nodes.runtime.running import in_thread, run
from rotcal_ros.nodes.runtime.timers_and_subscriptions import GRAPH_PERIOD_S, Batch, handle_events

CLOSE_TIMEOUT_S: Final = 15.0
Request: TypeAlias = StartRecording.Request
Response: TypeAlias = StartRecording.Response


class RecorderNode(CellNode):
    """Listens to everything from the start; writes between start and stop."""

    def __init__(self) -> None:
        super().__init__("recorder")

    def configure(self) -> None:
        """Subscribe to everything, and offer to record."""
        self._settings = self.settings("recorder", RecorderSettings)
        self._bags, self._session = SessionBags(self._settings), RecordedSession()
        self._recording: BagRecording | None = None
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
        self._listener = TopicListener(self, *heard, fast=self._is_fast)
        self._receipts = Receipts(self, self._called, self._listener, self._session)
        self.every(GRAPH_PERIOD_S, self._note_losses)

    def deactivated(self) -> None:
        """Write what has arrived and close the bag, even one that is about to be opened."""
        self._unwanted = True
        self._close()

    def stopped(self) -> bool:
        """Return whether the bag is closed."""
        return self._writing() is None and not self._reading

    def gather_s(self) -> float:
        """Collect messages while no bag is open."""
        return IDLE_S if not self.configured or self._writing() is None else 0.0

    def _writing(self) -> BagRecording | None:
        """Return the recording whose bag is open."""
        return self._recording if self._recording and not self._recording.finished else None

    def _note_losses(self) -> None:
        """Write losses and their counters into the bag, so that they outlive this node."""
        self._called.look(self.health.values)
        recording = self._writing()
        if recording is None:
            return
        heard = self._listener.heard_s(self._called.role)
        self._called.keep(recording.note)
        self._dropouts.silences(self._silences.look(heard, time.monotonic()))
        self._dropouts.write(JOINED_WITHIN_S)
        if counters := self._all_losses() + self._silences.counts:
            recording.note(names.LOSSES, counters)
        if jumps := self.health.clock.since(self._jumps_before):
            recording.note(names.CLOCK_JUMPS, jumps_to_metadata(jumps))

    def _take(self, topic: HeardTopic, batch: Batch) -> None:
        if (recording := self._writing()) is None:
            return
        if topic.channel.topic == self._called.topic(names.OBSERVATION):
            batch = self._session.of_this_run(batch)
            if not batch:
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
        return topic in map(self._called.topic, (*FAST, names.HEARTBEAT))

    def _clock_jumps(self) -> int:
        """Return how often the clock was set, up to now."""
        self.health.clock.look()
        return self.health.clock.watch.count

    def _all_losses(self) -> Counter[str]:
        """Return what was lost since the bag was opened, on the way here and at the full queue."""
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
        """Record the next run of the last session of a plan, after closing an open bag."""
        self._close()
        topic = self._called.topic(names.OBSERVATION)
        try:
            if not await until(self.stopped, CLOSE_TIMEOUT_S):
                raise BagError(
                    "the recorder is still closing the bag of the previous run: wait, "
                    "then try again"
                )
            self._reading, self._unwanted = True, False
            self.health.beat()  # before the reading can delay it
            bag = await in_thread(self._bags.go_on, request.plan_id, topic)
            if self._unwanted:
                bag.writer.close()
                raise BagError(
                    "the recorder was deactivated or ended meanwhile: activate it, then try again"
                )
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
        recording = BagRecording(bag.writer, self._settings.queue_bytes, self._receipts.confirm)
        self._dropouts.begin(recording)
        self._called.keep(recording.note)  # before the configuration, where readers stop to look
        keep_provenance(recording, request.configuration)
        bag.keep(request.configuration)
        self._listener.tell_again(recording.put)
        self._recording = recording
        self._asked = NodeParameters(recording, self)
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
        """Take what has arrived and then close the bag."""
        if (recording := self._writing()) is not None:
            self._listener.drain()
            self._asked.attach()
            self._dropouts.silences(self._silences.end(time.monotonic()))
            self._dropouts.write()
            recording.close(self._listener.losses + self._silences.counts)

    def _node_lost(self, name: str) -> None:
        """Close the bag when its planner is lost: the calibration is over."""
        if name == "planner" and self._writing() is not None:
            self.get_logger().error("the planner is lost: closing the bag")
            self._close()

    def _report(self) -> tuple[NodeState, dict[str, Any]]:
        values: dict[str, Any] = {"topics": len(self._listener.topics), **self._listener.refused}
        values[LISTENS] = " ".join(sorted(self._listener.topics))
        values |= self._all_losses() + self._silences.counts
        recording = self._recording
        if recording is not None and recording.error:
            failed = NodeState.of(State.FAILED, Why.RECORDING_FAILED, recording.error)
            return failed, values
        if recording is None or recording.finished:
            return LOADING if self._reading else NodeState(State.IDLE), values
        values |= {"file": recording.file, "messages": recording.messages}
        return NodeState(State.RECORDING), values


class Receipts:
    """Confirms observations on a topic as soon as they and their readings are on disk."""

    def __init__(
        self,
        node: CellNode,
        called: CalledOtherwise,
        listener: TopicListener,
        session: RecordedSession,
    ) -> None:
        self._clock, self._called, self._listener = node.get_clock(), called, listener
        self._logger, self._awake = node.get_logger(), node.health.awake
        self._session, self._pending = session, PendingReceipts(answered=False)
        self._publisher = node.create_publisher(
            msg.RecordedObservation, names.OBSERVATION_RECORDED, EVENT
        )

    def begin(self) -> None:
        """Forget what is still waiting; called when a bag begins."""
        points = self._listener.topics.get(self._called.topic(names.PROBE_POINT))
        self._pending = PendingReceipts(answered=points is not None and _echoes(points))

    def hear(self, topic: HeardTopic, batch: Batch) -> None:
        """Note observations, which need a receipt, and the points that answer orders."""
        name = topic.channel.topic
        if name == self._called.topic(names.OBSERVATION):
            for data, _ in batch:
                seen = self._session.take(data)
                self._pending.expect(seen.step, seen.attempt, stamp_ns(seen.window_end))
        elif name == self._called.topic(names.TABLE_ANGLE):
            for data, _ in batch:
                order = deserialize_message(data, msg.TableAngle)
                self._pending.order(order.step, order.attempt, turn=bool(order.turn_speed))
        elif name == self._called.topic(names.PROBE_POINT) and _echoes(topic):
            for data, _ in batch:
                point = deserialize_message(data, msg.ProbePoint)
                self._pending.answer(point.step, point.attempt)

    def due(self, losses: Callable[[], Mapping[str, int]]) -> Iterator[Receipt]:
        """Yield what can be confirmed; ``losses`` counts from the opening of the bag."""
        reached_ns = self._listener.reached_ns(NEEDED, self._called.topic)
        if not self._pending:
            self._pending.reach(reached_ns or 0)
            return
        lost = self._called.lost(losses())
        for receipt in self._pending.due(reached_ns, lost, self._awake.now_s()):
            if not self._pending.is_answered(receipt):
                self._logger.warning(
                    f"step {receipt.step}, attempt {receipt.attempt}: the point that answered the "
                    "order has not arrived; it counts as lost"
                )
            yield receipt

    def confirm(self, receipt: Receipt, file: str) -> None:
        """Publish a receipt; called from the writer's thread."""
        message = msg.RecordedObservation(**asdict(receipt), file=file)
        message.header.stamp = self._clock.now().to_msg()
        self._publisher.publish(message)


def _echoes(points: HeardTopic) -> bool:
    """Return whether the points say which order they answer."""
    return points.channel.type_name == OWN[names.PROBE_POINT]


def main() -> None:
    """Run the recorder."""
    run(RecorderNode)


if __name__ == "__main__":
    main()
