"""Receipts of the recorder, held back until everything that they confirm has arrived."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from rclpy.serialization import deserialize_message
from rotcal_msgs.msg import Observation

from rotcal_ros.messages import stamp_ns
from rotcal_ros.nodes.draining import Batch
from rotcal_ros.nodes.recording import Receipt


class PendingReceipts:
    """Receipts of observations whose readings may still be on their way here."""

    def __init__(self) -> None:
        self._waiting: list[tuple[int, Receipt]] = []
        self._lost = 0

    def begin(self) -> None:
        """Begin anew with a new bag."""
        self._waiting.clear()
        self._lost = 0

    def expect(self, batch: Batch) -> None:
        """Take serialised observations that want a receipt."""
        for data, _ in batch:
            message = deserialize_message(data, Observation)
            receipt = Receipt(message.step, message.attempt)
            self._waiting.append((stamp_ns(message.window_end), receipt))

    def due(self, reached_ns: int | None, lost: int) -> Iterator[Receipt]:
        """Yield what can be confirmed now that the readings have come to ``reached_ns``.

        None: there is no such stream. ``lost`` counts the losses since the bag was opened; each
        receipt tells those since the one before.
        """
        waiting, self._waiting = self._waiting, []
        for window_end_ns, receipt in waiting:
            if reached_ns is None or reached_ns >= window_end_ns:
                yield replace(receipt, lost=lost - self._lost)
                self._lost = lost
            else:
                self._waiting.append((window_end_ns, receipt))

    def __bool__(self) -> bool:
        return bool(self._waiting)
