"""Receiving orders: two topics, one command."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from rotcal_msgs.msg import ProbeTarget, TableAngle

from rotcal_ros.bags import names
from rotcal_ros.capture.orders import Orders
from rotcal_ros.nodes.cell_node import CellNode
from rotcal_ros.nodes.qos import EVENT
from rotcal_ros.observations import Command


class OrderSubscription:
    """Subscribes to both halves of the orders and calls ``obey`` with every complete one."""

    def __init__(self, node: CellNode, obey: Callable[[Command], None]) -> None:
        self._obey = obey
        self._orders = Orders()
        self.forget = self._orders.clear
        for kind, topic, take in (
            (TableAngle, names.TABLE_ANGLE, self._orders.table_angle),
            (ProbeTarget, names.PROBE_TARGET, self._orders.probe_target),
        ):
            node.listen(kind, topic, partial(self._take, take), EVENT)

    def _take(self, take: Callable[[Any], Command | None], message: Any) -> None:
        command = take(message)
        if command is not None:
            self._obey(command)
