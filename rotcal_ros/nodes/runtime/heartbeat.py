"""The beats of a node: sent at every change, and otherwise by a thread that nothing can block."""

from __future__ import annotations

import time
from contextlib import suppress
from threading import Event, Lock, Thread
from typing import Final

from rclpy.duration import Duration
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rotcal_msgs.msg import NodeState as NodeStateMsg

from rotcal_ros.bags import names
from rotcal_ros.nodes.runtime.identity import ProcessIdentity
from rotcal_ros.nodes.runtime.processes_here import HostProcess

BEAT_PERIOD_S: Final = 0.2
LEAVE_TIMEOUT_S: Final = 0.5
_TOLD_S: Final = 0.5
"""Only from then on a beat says that the node is busy."""


class Heartbeat:
    """Sends the node's latest state; from the second beat on also while it takes no turn."""

    def __init__(self, node: Node, identity: ProcessIdentity) -> None:
        self._context, self._clock, self._identity = node.context, node.get_clock(), identity
        self._process = HostProcess.own()
        self._publisher = node.create_publisher(
            NodeStateMsg, names.HEARTBEAT, QoSProfile(depth=20)
        )
        self._lock, self._ended = Lock(), Event()
        self._thread: Thread | None = None
        self._latest = NodeStateMsg()
        self._turn_s = self._sent_s = 0.0

    def tell(self, state: NodeStateMsg) -> None:
        """Send the state of the node, which takes a turn now."""
        with self._lock:
            self._latest, self._turn_s = state, time.monotonic()
            self._send()

    def go_on(self) -> None:
        """Let the thread beat from now on: everything is loaded, the node takes its turns."""
        if self._thread is None:
            self._thread = Thread(target=self._beat, name="heartbeat", daemon=True)
            self._thread.start()

    def leave(self, state: NodeStateMsg) -> None:
        """Send the last beat, and let it reach the others."""
        self._ended.set()
        self.tell(state)
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
        now_s, beat, process = time.monotonic(), self._latest, self._process
        busy_s = now_s - self._turn_s
        beat.header.stamp = self._clock.now().to_msg()
        beat.session, beat.process = self._identity.session, self._identity.process
        beat.age = self._identity.age_ns(now_s)
        beat.host, beat.pid, beat.start = process.host, process.pid, process.start
        beat.busy = busy_s if busy_s > _TOLD_S else 0.0
        self._publisher.publish(beat)
        self._sent_s = now_s
