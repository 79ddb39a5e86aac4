"""Receipts: an observation is confirmed once it and the readings of its window are on disk."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict

from rclpy.serialization import deserialize_message
from rotcal_msgs.msg import ProbePoint, RecordedObservation

from rotcal_ros.bags import names
from rotcal_ros.bags.topic_roles import CalledOtherwise
from rotcal_ros.capture.instruments.forms import OWN
from rotcal_ros.capture.messages import stamp_ns
from rotcal_ros.nodes.runtime.cell_node import CellNode
from rotcal_ros.nodes.runtime.draining import Batch
from rotcal_ros.nodes.runtime.qos import EVENT
from rotcal_ros.nodes.writing.bookkeeping import NEEDED, PendingReceipts
from rotcal_ros.nodes.writing.heard_topic import HeardTopic
from rotcal_ros.nodes.writing.recorded_session import RecordedSession
from rotcal_ros.nodes.writing.recording import Receipt
from rotcal_ros.nodes.writing.topic_listener import TopicListener


class Receipts:
    """The receipts of a recorder that are due, and their topic."""

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
                    "order has not arrived; it counts as lost"
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
