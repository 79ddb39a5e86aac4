"""Receipts: an observation is confirmed once it and the readings of its window are on disk."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict

from rotcal_msgs.msg import Observation, RecordedObservation

from rotcal_ros.messages import stamp_ns
from rotcal_ros.nodes.bookkeeping import NEEDED, PendingReceipts
from rotcal_ros.nodes.cell_node import CellNode
from rotcal_ros.nodes.listening import Listener
from rotcal_ros.nodes.qos import EVENT
from rotcal_ros.nodes.recording import Receipt
from rotcal_ros.nodes.topic_names import CalledOtherwise


class Receipts:
    """The receipts of a recorder that are due, and their topic."""

    def __init__(self, node: CellNode, called: CalledOtherwise, listener: Listener) -> None:
        self._clock, self._called, self._listener = node.get_clock(), called, listener
        self._pending = PendingReceipts()
        self._publisher = node.create_publisher(RecordedObservation, "observation_recorded", EVENT)

    def begin(self) -> None:
        """Forget what is still waiting: a bag begins."""
        self._pending = PendingReceipts()

    def expect(self, message: Observation) -> None:
        """Take an observation that wants a receipt."""
        self._pending.expect(message.step, message.attempt, stamp_ns(message.window_end))

    def due(self, losses: Callable[[], Mapping[str, int]]) -> Iterator[Receipt]:
        """Yield what can be confirmed; ``losses`` are those since the bag was opened."""
        reached_ns = self._listener.reached_ns(NEEDED, self._called.topic)
        if not self._pending:
            self._pending.reach(reached_ns or 0)
            return
        yield from self._pending.due(reached_ns, self._called.lost(losses()))

    def confirm(self, receipt: Receipt, file: str) -> None:
        """Publish a receipt; called from the writer's thread."""
        message = RecordedObservation(**asdict(receipt), file=file)
        message.header.stamp = self._clock.now().to_msg()
        self._publisher.publish(message)
