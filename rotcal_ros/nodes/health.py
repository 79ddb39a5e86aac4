"""Heartbeats and diagnostics of a node, and watching those of the others.

Every node beats on ``heartbeat`` (diagnostic_msgs/DiagnosticStatus, 5 Hz, from its executor, so
that a hung node falls silent like a dead one) and reports on ``/diagnostics`` at 1 Hz.
"""

from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from functools import wraps
from typing import Any, Final

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import QoSProfile

from rotcal_ros.nodes.clock_news import ClockNews
from rotcal_ros.nodes.draining import Batch, DrainedSubscription
from rotcal_ros.nodes.identity import IDENTITY, Identity, NameHolders, refusal
from rotcal_ros.nodes.memory import end_without_memory
from rotcal_ros.nodes.roll_call import RollCall
from rotcal_ros.nodes.sim_clock import SimClock
from rotcal_ros.nodes.steady import steady_timer

BEAT_PERIOD_S: Final = 0.2
DIAGNOSTICS_PERIOD_S: Final = 1.0
NODE_TIMEOUT_S: Final = 1.4
"""Silence after which a node is lost: noticed within 2 s together with the beat itself."""
LEAVING: Final = "leaving"
RECORDING_FAILED: Final = "recording failed"
"""How the state of a recorder begins that cannot write any more."""
LEAVE_TIMEOUT_S: Final = 0.5
CALIBRATING: Final = "calibrating"
"""How the state of a planner begins while a goal runs."""

Values = Mapping[str, object]


class Health:
    """The health of one node.

    ``lost`` is name -> silence (s) of the others that fell silent, as of the last beat,
    ``concerns`` what a person should look at, ``alarms`` what a person must look at.
    ``report`` returns (state in words, values) at any time for every beat; without it the node
    only listens, and nobody will miss it. ``on_lost`` is called once for every other node that
    falls silent, with its name. ``refused`` says why this node must end: an older one of its name
    is there; empty: it need not.
    """

    def __init__(
        self,
        node: Node,
        report: Callable[[], tuple[str, Values]] | None,
        on_lost: Callable[[str], None] | None = None,
        *,
        timeout_s: float = NODE_TIMEOUT_S,
    ) -> None:
        self._node = node
        self._report = report
        self._on_lost = on_lost
        self.lost: dict[str, float] = {}
        self._roll = RollCall(timeout_s)
        self._holders = NameHolders()
        self.identity = Identity.own(os.environ, time.monotonic())
        self.refused = ""
        self.others: dict[str, DiagnosticStatus] = {}
        self.errors: Counter[str] = Counter()
        self.concerns: dict[str, str] = {}
        self.alarms: dict[str, str] = {}
        self.clock = ClockNews(node.get_logger())
        self.sim = SimClock(node.get_clock())
        self._beats = node.create_publisher(DiagnosticStatus, "heartbeat", QoSProfile(depth=20))
        self._diagnostics = node.create_publisher(DiagnosticArray, "/diagnostics", 1)
        self._heard = DrainedSubscription(
            node, DiagnosticStatus, "heartbeat", QoSProfile(depth=100), self.guarded(self._hear)
        )
        steady_timer(node, BEAT_PERIOD_S, self.guarded(self._beat))
        steady_timer(node, DIAGNOSTICS_PERIOD_S, self.guarded(self._diagnose))

    def guarded(self, callback: Callable[..., Any]) -> Callable[..., Any]:
        """Keep an exception in ``callback`` from ending the node: count it, log it once."""

        @wraps(callback)
        def run(*arguments: Any) -> Any:
            try:
                return callback(*arguments)
            except Exception as error:
                self.note_error(getattr(callback, "__name__", "callback"), error)
                return None

        return run

    def note_error(self, where: str, error: Exception) -> None:
        """Count an error; log the first of its kind in full. Without memory the node ends."""
        end_without_memory(error, where)
        kind = f"{where}: {type(error).__name__}"
        self.errors[kind] += 1
        if self.errors[kind] == 1:
            self._node.get_logger().error(f"{kind}: {error}")

    def present(self) -> set[str]:
        """Return the names of the other nodes that beat."""
        return self.others.keys() - self.lost.keys()

    def aware(self) -> bool:
        """Return whether the others are known as they are now; not just behind a standstill."""
        return self._roll.aware(time.monotonic())

    def missing(self, names: Iterable[str]) -> list[str]:
        """Return those of ``names`` that fell silent, left, or never were there."""
        return sorted(set(names) - self.present())

    def values(self, name: str) -> dict[str, str]:
        """Return the values of the last beat of node ``name``."""
        return {v.key: v.value for v in self.others[name].values} if name in self.others else {}

    def state(self, name: str) -> str:
        """Return the state of node ``name`` in words, empty when it was never heard."""
        return str(self.others[name].message) if name in self.others else ""

    def last_words(self, name: str) -> str:
        """Return how long node ``name`` has been silent and what it did before, for a message."""
        state = self.state(name) or "never heard"
        return f"{self.lost[name]:.1f} s, before that: {state}" if name in self.lost else state

    def leave(self) -> None:
        """Tell the others that this node ends on purpose, and let the word reach them."""
        if not self.refused:
            self._beats.publish(self._status(LEAVING, {}))
            self._beats.wait_for_all_acked(Duration(seconds=LEAVE_TIMEOUT_S))

    def beat(self) -> None:
        """Tell the others the state now, before the next beat is due."""
        if self._report is not None:
            self._beats.publish(self._status(*self._report()))

    def _hear(self, batch: Batch) -> None:
        now = time.monotonic()
        for status, _ in batch:
            identity = next((v.value for v in status.values if v.key == IDENTITY), "")
            if status.message == LEAVING:
                if self._holders.leave(status.name, identity, now):
                    self._roll.seen.pop(status.name, None)
                    self.others.pop(status.name, None)
            elif status.name == self._node.get_name():
                self._meet(Identity.read(identity, now))
            elif self._holders.is_holder(status.name, identity, now):
                self._roll.hear(status.name, status.message, now)
                self.others[status.name] = status

    def _meet(self, other: Identity | None) -> None:
        """Hear a beat of this node's own name: of two nodes the younger one ends."""
        if self._report is None or other is None or other.process == self.identity.process:
            return
        name, place = self._node.get_name(), self._node.get_namespace()
        domain = os.environ.get("ROS_DOMAIN_ID", "")
        self.refused = refusal(name, place, self.identity, other, domain)
        if not self.refused:
            text = f"a second node {name} was started in {place}: it is refused"
            self._node.get_logger().warning(text, once=True)

    def _beat(self) -> None:
        self.clock.look()
        self.sim.look()
        self.beat()
        silent = self._roll.silent(time.monotonic())
        for name in silent.keys() - self.lost.keys():
            self._node.get_logger().error(f"node {name} fell silent {silent[name]:.1f} s ago")
            if self._on_lost is not None:
                self._on_lost(name)
        self.lost = silent

    def _diagnose(self) -> None:
        if self._report is None:
            return
        status = self._status(*self._report())
        status.name = self._node.get_fully_qualified_name()  # cells share this topic
        array = DiagnosticArray(status=[status])
        array.header.stamp = self._node.get_clock().now().to_msg()
        self._diagnostics.publish(array)

    def _status(self, state: str, values: Values) -> DiagnosticStatus:
        trouble: dict[str, object] = {**self.errors, **self.alarms}
        if self.lost:
            trouble["lost_nodes"] = ", ".join(sorted(self.lost))
        concerns = self.clock.concerns | self.sim.concerns() | self.concerns
        rest = DiagnosticStatus.WARN if concerns else DiagnosticStatus.OK
        own = {IDENTITY: self.identity.in_a_beat(time.monotonic())}
        told = {**values, **self.clock.values(), **self.sim.values(), **concerns, **trouble, **own}
        return DiagnosticStatus(
            level=DiagnosticStatus.ERROR if trouble else rest,
            name=self._node.get_name(),
            hardware_id=self._node.get_namespace(),
            message=state,
            values=[KeyValue(key=k, value=str(v)) for k, v in told.items()],
        )
