"""Telling the cell which table the controller holds, so that every bag knows it."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from typing import Final

from rotcal_msgs.msg import TableInForce

from rotcal_ros.bags import names
from rotcal_ros.compensation.feed import Feed
from rotcal_ros.errors import RotcalError
from rotcal_ros.in_force import UNKNOWN
from rotcal_ros.nodes import conversions
from rotcal_ros.nodes.cell_node import CellNode
from rotcal_ros.nodes.qos import LATCHED

PERIOD_S: Final = 1.0


class Announcer:
    """Looks at the controller in the thread of its other accesses, and publishes what it found."""

    def __init__(self, node: CellNode, feed: Feed, worker: ThreadPoolExecutor) -> None:
        self._node, self._feed, self._worker = node, feed, worker
        self._looking: Future[str] | None = None
        self._publisher = node.create_publisher(TableInForce, names.TABLE_IN_FORCE, LATCHED)
        node.every(PERIOD_S, self._announce)

    def _announce(self) -> None:
        """Publish what the last look found, and look again."""
        looked = self._looking
        if looked is not None and not looked.done():
            return
        if looked is not None:
            try:
                found = looked.result()
            except (RotcalError, OSError):
                found = UNKNOWN
            self._publisher.publish(
                conversions.in_force_message(self._feed.axis, found, self._node.now_ns())
            )
        self._looking = self._worker.submit(self._feed.in_force)
