"""The beats of a node: sent at every change, and otherwise by a thread that nothing can block."""

from __future__ import annotations

import time
from contextlib import suppress
from threading import Event, Lock, Thread
from typing import Final

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from rclpy.duration import Duration
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.qos import QoSProfile

from rotcal_ros.bags import names
from rotcal_ros.nodes.runtime.identity import IDENTITY, Identity
from rotcal_ros.nodes.runtime.processes_here import PROCESS, own_process

BEAT_PERIOD_S: Final = 0.2
BUSY: Final = "busy_s"
"""Value in a beat: how long ago the node took its last turn, where that is long."""
LEAVING: Final = "leaving"
LEAVE_TIMEOUT_S: Final = 0.5
_TOLD_S: Final = 0.5
"""Only from then on a beat says that the node is busy."""


class Heartbeat:
    """Sends the node's latest state; from the second beat on also while it takes no turn."""

    def __init__(self, node: Node, identity: Identity) -> None:
        self._context, self._identity = node.context, identity
        self._process = own_process()
        self._publisher = node.create_publisher(
            DiagnosticStatus, names.HEARTBEAT, QoSProfile(depth=20)
        )
        self._lock, self._ended = Lock(), Event()
        self._thread: Thread | None = None
        self._latest = DiagnosticStatus()
        self._turn_s = self._sent_s = 0.0

    def tell(self, status: DiagnosticStatus) -> None:
        """Send the state of the node, which takes a turn now."""
        with self._lock:
            self._latest, self._turn_s = status, time.monotonic()
            self._send()

    def go_on(self) -> None:
        """Let the thread beat from now on: everything is loaded, the node takes its turns."""
        if self._thread is None:
            self._thread = Thread(target=self._beat, name="heartbeat", daemon=True)
            self._thread.start()

    def leave(self, status: DiagnosticStatus) -> None:
        """Send the last beat, and let it reach the others."""
        self._ended.set()
        self.tell(status)
        self._publisher.wait_for_all_acked(Duration(seconds=LEAVE_TIMEOUT_S))

    def _beat(self) -> None:
        """Send what is due until the node is no more."""
        with suppress(rclpy_implementation.InvalidHandle, rclpy_implementation.RCLError):
            while not self._ended.wait(BEAT_PERIOD_S / 2) and self._context.ok():
                with self._lock:
                    if (
                        time.monotonic() - self._sent_s > BEAT_PERIOD_S
                        and not self._ended.is_set()
                    ):
                        self._send()

    def _send(self) -> None:
        now_s, latest = time.monotonic(), self._latest
        own = {IDENTITY: self._identity.in_a_beat(now_s), PROCESS: self._process}
        if (busy_s := now_s - self._turn_s) > _TOLD_S:
            own[BUSY] = f"{busy_s:.2f}"
        values = [*latest.values, *(KeyValue(key=k, value=v) for k, v in own.items())]
        self._publisher.publish(
            DiagnosticStatus(
                level=latest.level, name=latest.name, hardware_id=latest.hardware_id,
                message=latest.message, values=values,
            )
        )  # fmt: skip
        self._sent_s = now_s
