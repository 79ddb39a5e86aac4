"""Heartbeats and diagnostics of a node, and watching those of the others.

Every node beats on ``heartbeat`` (diagnostic_msgs/DiagnosticStatus, 5 Hz) and reports on
``/diagnostics`` at 1 Hz. A beat tells that the process lives, and how long ago its executor took a
turn: one that hangs is slow, one whose process is gone is lost.
"""

from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from functools import wraps
from typing import Any, Final

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node
from rclpy.qos import QoSProfile

from rotcal_ros.bags import names
from rotcal_ros.foundation.machine_load import AwakeClock
from rotcal_ros.foundation.plugins import culprit
from rotcal_ros.nodes.runtime.clock_news import ClockNews
from rotcal_ros.nodes.runtime.draining import Batch, DrainedSubscription
from rotcal_ros.nodes.runtime.heartbeat import BEAT_PERIOD_S, BUSY, LEAVING, Heartbeat
from rotcal_ros.nodes.runtime.identity import IDENTITY, NameHolders, ProcessIdentity, refusal
from rotcal_ros.nodes.runtime.memory import end_without_memory
from rotcal_ros.nodes.runtime.processes_here import PROCESS, is_of_here, why_gone
from rotcal_ros.nodes.runtime.roll_call import RollCall
from rotcal_ros.nodes.runtime.sim_clock import SimClock
from rotcal_ros.nodes.runtime.timers_and_events import UNWAITED, steady_timer
from rotcal_ros.planning.settings import HealthSettings

HEAR_PERIOD_S: Final = 0.1
"""Interval at which the beats of the others are handled, all together."""
DIAGNOSTICS_PERIOD_S: Final = 1.0
AWARE_S: Final = 0.7
"""For so long after a standstill a node does not know the present state of the others."""
RECORDING_FAILED: Final = "recording failed"
"""Beginning of the state of a recorder that cannot write any more."""
CALIBRATING: Final = "calibrating"
"""Beginning of the state of a planner while a goal runs."""

Values = Mapping[str, object]


class Health:
    """The health of one node.

    ``concerns`` is what a person should look at, ``alarms`` what a person must look at. ``report``
    returns (state in words, values) at any time for every beat; without it the node only listens,
    and is not missed. ``on_lost`` is called with the name of every other node that is lost.
    ``refused`` says why this node must end: an older one of its name is there; empty: it need not.
    """

    def __init__(
        self,
        node: Node,
        report: Callable[[], tuple[str, Values]] | None,
        on_lost: Callable[[str], None] | None = None,
        *,
        settings: HealthSettings | None = None,
    ) -> None:
        self._node = node
        self._report = report
        self._on_lost = on_lost
        self.settings = settings or HealthSettings()
        self.awake = AwakeClock()
        self._roll = RollCall(self.settings)
        self._holders = NameHolders()
        self.identity = ProcessIdentity.own(os.environ, time.monotonic())
        self.refused = ""
        self.others: dict[str, DiagnosticStatus] = {}
        self._read: dict[str, tuple[DiagnosticStatus, dict[str, str]]] = {}
        self.errors: Counter[str] = Counter()
        self.concerns: dict[str, str] = {}
        self.alarms: dict[str, str] = {}
        self.clock = ClockNews(node.get_logger())
        self.sim = SimClock(node.get_clock())
        self._beats = Heartbeat(node, self.identity) if report is not None else None
        self._diagnostics = node.create_publisher(DiagnosticArray, "/diagnostics", 1)
        self._heard = DrainedSubscription(
            node, DiagnosticStatus, names.HEARTBEAT, QoSProfile(depth=100),
            self.guarded(self._hear), group=UNWAITED,
        )  # fmt: skip
        steady_timer(node, HEAR_PERIOD_S, self._heard.drain)
        steady_timer(node, BEAT_PERIOD_S, self.guarded(self._turn))
        steady_timer(node, DIAGNOSTICS_PERIOD_S, self.guarded(self._diagnose))

    @property
    def lost(self) -> dict[str, str]:
        """Name -> why, of the others that are lost, as of the last turn."""
        return self._roll.lost

    @property
    def slow(self) -> dict[str, float]:
        """Name -> seconds without a sign that it answers, of the others that are slow."""
        return self._roll.slow

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
            self._node.get_logger().error(f"{kind}: {error} {culprit(error) or ''}".rstrip())

    def present(self) -> set[str]:
        """Return the names of the other nodes that are there, slow ones too."""
        return self.others.keys() - self.lost.keys()

    def aware(self) -> bool:
        """Return whether the others are known as they are now; not just behind a standstill."""
        return self.awake.awake_s() > AWARE_S

    def missing(self, names: Iterable[str]) -> list[str]:
        """Return those of ``names`` that are lost, left, or never were there."""
        return sorted(set(names) - self.present())

    def values(self, name: str) -> dict[str, str]:
        """Return the values of the last beat of node ``name``; every turn asks for them."""
        beat = self.others.get(name)
        if beat is None:
            return {}
        if self._read.get(name, (None,))[0] is not beat:
            self._read[name] = beat, {v.key: v.value for v in beat.values}
        return self._read[name][1]

    def state(self, name: str) -> str:
        """Return the state of node ``name`` in words, empty when it was never heard."""
        return str(self.others[name].message) if name in self.others else ""

    def last_words(self, name: str) -> str:
        """Return why node ``name`` is lost and what it did before, for a message."""
        state = self.state(name) or "never heard"
        return f"{self.lost[name]}; before that: {state}" if name in self.lost else state

    def leave(self) -> None:
        """Tell the others that this node ends on purpose, and let the message reach them."""
        if self._beats is not None and not self.refused:
            self._beats.leave(self._status(LEAVING, {}))

    def beat(self) -> None:
        """Tell the others the state now, before the next beat is due."""
        if self._beats is not None and self._report is not None:
            self._beats.tell(self._status(*self._report()))

    def _hear(self, batch: Batch) -> None:
        now_s, awake_s = time.monotonic(), self.awake.now_s()
        for status, _ in batch:
            values = {v.key: v.value for v in status.values if v.key in (IDENTITY, PROCESS, BUSY)}
            name, identity = status.name, values.get(IDENTITY, "")
            if status.message == LEAVING:
                if self._holders.leave(name, identity, now_s):
                    self._roll.forget(name)
                    self.others.pop(name, None)
            elif name == self._node.get_name():
                self._meet(ProcessIdentity.read(identity, now_s))
            elif name in self.lost and why_gone(values.get(PROCESS, "")):
                continue  # its last beats came late
            elif self._holders.is_holder(name, identity, now_s):
                self._roll.hear(name, awake_s - _seconds(values.get(BUSY, "")))
                self.others[name] = status

    def _meet(self, other: ProcessIdentity | None) -> None:
        """Hear a beat of this node's own name: of two nodes the younger one ends."""
        if self._report is None or other is None or other.process == self.identity.process:
            return
        name, place = self._node.get_name(), self._node.get_namespace()
        domain = os.environ.get("ROS_DOMAIN_ID", "")
        self.refused = refusal(name, place, self.identity, other, domain)
        if not self.refused:
            text = f"a second node {name} was started in {place}: it is refused"
            self._node.get_logger().warning(text, once=True)

    def _turn(self) -> None:
        """Beat, and look at the clocks and at the others."""
        self.clock.look()
        self.sim.look()
        self.beat()
        if self._beats is not None:
            self._beats.go_on()
        for name in self._roll.look(self.awake.now_s(), self._gone):
            self._node.get_logger().error(f"node {name} is lost: {self.last_words(name)}")
            if self._on_lost is not None:
                self._on_lost(name)

    def _gone(self, name: str) -> str:
        """Say why a node whose beat is late is gone; empty: it is there, as far as can be told.

        On another machine, or where its process is not known, the graph decides: DDS removes a
        participant that does not renew its lease.
        """
        process = self.values(name).get(PROCESS, "")
        if is_of_here(process):
            return why_gone(process)
        silent_s = self.awake.now_s() - self._roll.seen[name]
        if silent_s <= self.settings.slow_after_s:
            return ""
        topic = self._node.resolve_topic_name(names.HEARTBEAT)
        here = {info.node_name for info in self._node.get_publishers_info_by_topic(topic)}
        return "" if name in here else "it has left the graph"

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
        beat = {**values, **self.clock.values(), **self.sim.values(), **concerns, **trouble}
        return DiagnosticStatus(
            level=DiagnosticStatus.ERROR if trouble else rest,
            name=self._node.get_name(),
            hardware_id=self._node.get_namespace(),
            message=state,
            values=[KeyValue(key=k, value=str(v)) for k, v in beat.items()],
        )


def _seconds(text: str) -> float:
    """Return a number of seconds from a beat; 0 where it is none."""
    try:
        return max(0.0, float(text))
    except ValueError:
        return 0.0
