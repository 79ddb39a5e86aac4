"""The heartbeat and the diagnostics of a node, and what it hears of the other nodes.

Every node beats on ``heartbeat`` (rotcal_msgs/NodeState, 5 Hz), and reports in words on
``/diagnostics`` at 1 Hz. A beat shows that the process lives, and how long ago its executor last
ran: a node that hangs is slow, a node whose process is gone is lost. Beats are sent at every
change, and otherwise by a thread of their own, which a busy executor cannot block.
"""

from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from functools import wraps
from threading import Event, Lock, Thread
from typing import Any, Final

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.duration import Duration
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rotcal_msgs import msg

from rotcal_ros.bags import names
from rotcal_ros.foundation.machine_load import AwakeClock, end_without_memory
from rotcal_ros.foundation.node_state import UNHEARD, NodeState, State
from rotcal_ros.foundation.plugins import failing_plugin
from rotcal_ros.nodes.runtime import conversions
from rotcal_ros.nodes.runtime.clocks import ReportedClockJumps, SimClock
from rotcal_ros.nodes.runtime.liveness import (
    HostProcess,
    Liveness,
    NameHolders,
    ProcessIdentity,
    SecondNodeError,
)
from rotcal_ros.nodes.runtime.timers_and_subscriptions import (
    UNWAITED,
    Batch,
    DrainedSubscription,
    ResubscribeBackoff,
    steady_timer,
)
from rotcal_ros.planning.settings import HealthSettings

HEAR_PERIOD_S: Final = 0.1
"""Interval at which the beats of the others are handled, all together."""
DIAGNOSTICS_PERIOD_S: Final = 1.0
AWARE_S: Final = 0.7
"""After a standstill a node needs this long to learn the present state of the others."""
PLANNER: Final = "planner"

Values = Mapping[str, object]
BEAT_PERIOD_S: Final = 0.2
LEAVE_TIMEOUT_S: Final = 0.5
_TOLD_S: Final = 0.5
"""A beat reports a busy node only if its last turn is older than this."""


class Heartbeat:
    """Sends the node's latest state, from the second beat on even while its executor is busy."""

    def __init__(self, node: Node, identity: ProcessIdentity) -> None:
        self._context, self._clock, self._identity = node.context, node.get_clock(), identity
        self._process = HostProcess.own()
        self._publisher = node.create_publisher(
            msg.NodeState, names.HEARTBEAT, QoSProfile(depth=20)
        )
        self._lock, self._ended = Lock(), Event()
        self._thread: Thread | None = None
        self._latest = msg.NodeState()
        self._turn_s = self._sent_s = 0.0

    def tell(self, state: msg.NodeState) -> None:
        """Send the present state of the node, from a turn of its executor."""
        with self._lock:
            self._latest, self._turn_s = state, time.monotonic()
            self._send()

    def go_on(self) -> None:
        """Start the thread of the beats; called when everything is loaded."""
        if self._thread is None:
            self._thread = Thread(target=self._beat, name="heartbeat", daemon=True)
            self._thread.start()

    def leave(self, state: msg.NodeState) -> None:
        """Send the last beat, and let it reach the others."""
        self._ended.set()
        self.tell(state)
        self._publisher.wait_for_all_acked(Duration(seconds=LEAVE_TIMEOUT_S))

    def _beat(self) -> None:
        """Repeat the latest state whenever a beat is due, until the node has left."""
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


class Health:
    """The health of one node.

    ``concerns`` are what a person should look at, ``alarms`` what a person must look at.
    ``report`` returns (state, values) for every beat; without it the node only listens, and is
    not missed. ``on_lost`` is called with the name of every other node that is lost. ``refused``
    is the error with which this node must end, because an older one of its name is there.
    """

    def __init__(
        self,
        node: Node,
        report: Callable[[], tuple[NodeState, Values]] | None,
        on_lost: Callable[[str], None] | None = None,
        *,
        settings: HealthSettings | None = None,
    ) -> None:
        self._node = node
        self._report = report
        self._on_lost = on_lost
        self.settings = settings or HealthSettings()
        self.awake = AwakeClock()
        self._liveness = Liveness(self.settings)
        self._holders = NameHolders()
        self.identity = ProcessIdentity.own(os.environ, time.monotonic())
        self.refused: SecondNodeError | None = None
        self.others: dict[str, msg.NodeState] = {}
        self._read: dict[str, tuple[msg.NodeState, dict[str, str]]] = {}
        self.errors: Counter[str] = Counter()
        self.concerns: dict[str, str] = {}
        self.alarms: dict[str, str] = {}
        self.clock = ReportedClockJumps(node.get_logger())
        self.sim = SimClock(node.get_clock())
        self._beats = Heartbeat(node, self.identity) if report is not None else None
        self._diagnostics = node.create_publisher(DiagnosticArray, "/diagnostics", 1)
        self._heard = DrainedSubscription(
            node, msg.NodeState, names.HEARTBEAT, QoSProfile(depth=100), self.guarded(self._hear),
            group=UNWAITED,
        )  # fmt: skip
        self._backoff = ResubscribeBackoff(self.awake.now_s())
        steady_timer(node, HEAR_PERIOD_S, lambda: self._heard.drain())
        steady_timer(node, BEAT_PERIOD_S, self.guarded(self._turn))
        steady_timer(node, DIAGNOSTICS_PERIOD_S, self.guarded(self._diagnose))
        steady_timer(node, DIAGNOSTICS_PERIOD_S, self.guarded(self._miss))

    @property
    def lost(self) -> dict[str, str]:
        """Name -> why, of the others that are lost, as of the last turn."""
        return self._liveness.lost

    @property
    def slow(self) -> dict[str, float]:
        """Name -> seconds without a sign that it answers, of the others that are slow."""
        return self._liveness.slow

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
            self._node.get_logger().error(
                f"{kind}: {error} {failing_plugin(error) or ''}".rstrip()
            )

    def present(self) -> set[str]:
        """Return the names of the other nodes that are there, slow ones too."""
        return self.others.keys() - self.lost.keys()

    def is_current(self) -> bool:
        """Return whether the state of the others is up to date; not right after a standstill."""
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

    def node_state(self, name: str) -> NodeState:
        """Return state and reasons in the last beat of node ``name``; UNKNOWN: never heard."""
        beat = self.others.get(name)
        return UNHEARD if beat is None else conversions.node_state(beat)

    def state(self, name: str) -> State:
        """Return what node ``name`` did at its last beat; UNKNOWN: never heard."""
        beat = self.others.get(name)
        return State.UNKNOWN if beat is None else State(beat.state)

    def process(self, name: str) -> str | None:
        """Return which process node ``name`` is, or was last; None if it was never heard."""
        beat = self.others.get(name)
        return None if beat is None else str(beat.process)

    def is_calibrating(self) -> bool:
        """Return whether the planner carries out a goal, by its last beat."""
        return self.state(PLANNER) is State.CALIBRATING

    def describe(self, name: str) -> str:
        """Return the state of node ``name``, for a person to read."""
        return self.node_state(name).describe()

    def last_words(self, name: str) -> str:
        """Return the cause of a node's loss and what it did before, for a person to read."""
        return f"{self.lost[name]}; before that: {self.describe(name)}"

    def leave(self) -> None:
        """Tell the others that this node ends on purpose, and let the message reach them."""
        if self._beats is not None and not self.refused:
            self._beats.leave(self._message(NodeState(State.LEAVING), {}))

    def beat(self) -> None:
        """Tell the others the state now, before the next beat is due."""
        if self._beats is not None and self._report is not None:
            self._beats.tell(self._message(*self._report()))

    def _miss(self) -> None:
        """Subscribe anew where beats are sent that do not arrive."""
        sent = self._node.count_publishers(self._node.resolve_topic_name(names.HEARTBEAT))
        heard = len(self.others)
        if self._beats is not None:
            sent -= 1
        if self._backoff.is_due(sent > heard, self.awake.now_s()):
            self._node.get_logger().info(
                f"{heard} of {sent} heartbeat publishers received; resubscribing"
            )
            self._heard.anew()

    def _hear(self, batch: Batch) -> None:
        now_s, awake_s = time.monotonic(), self.awake.now_s()
        for beat, _ in batch:
            name, identity = beat.node, ProcessIdentity.of(beat, now_s)
            if beat.state == State.LEAVING:
                if self._holders.leave(name, identity):
                    self._liveness.forget(name)
                    self.others.pop(name, None)
            elif name == self._node.get_name():
                self._meet(identity)
            elif name in self.lost and _process(beat).is_gone:
                continue  # sent before its process died, delivered late
            elif self._holders.is_holder(name, identity, now_s):
                self._liveness.receive(name, awake_s - max(0.0, beat.busy))
                self.others[name] = beat

    def _meet(self, other: ProcessIdentity) -> None:
        """Handle a beat of another node with this node's name: the younger of the two ends."""
        if self._report is None or other.process == self.identity.process:
            return
        name, namespace = self._node.get_name(), self._node.get_namespace()
        if self.identity.is_older(other):
            text = f"a second node {name} was started in {namespace}: it is refused"
            self._node.get_logger().warning(text, once=True)
        else:
            self.refused = SecondNodeError(name, namespace, os.environ.get("ROS_DOMAIN_ID", ""))

    def _turn(self) -> None:
        """Beat, and look at the clocks and at the others."""
        self.clock.poll()
        self.sim.poll()
        self.beat()
        if self._beats is not None:
            self._beats.go_on()
        for name in self._liveness.poll(self.awake.now_s(), self._gone):
            self._node.get_logger().error(f"node {name} is lost: {self.last_words(name)}")
            if self._on_lost is not None:
                self._on_lost(name)

    def _gone(self, name: str) -> str | None:
        """Return why a node whose beat is late is gone; None: as far as known it is there.

        On another machine, or where its process is not known, the graph decides: DDS removes a
        participant that does not renew its lease.
        """
        process = _process(self.others[name])
        if process.is_of_here:
            return f"its process {process.pid} is gone" if process.is_gone else None
        silent_s = self.awake.now_s() - self._liveness.seen[name]
        if silent_s <= self.settings.slow_after_s:
            return None
        topic = self._node.resolve_topic_name(names.HEARTBEAT)
        here = {info.node_name for info in self._node.get_publishers_info_by_topic(topic)}
        return None if name in here else "it has left the graph"

    def _diagnose(self) -> None:
        if self._report is None:
            return
        state, values = self._report()
        beat = self._message(state, values)
        codes = ", ".join(reason.code.name for reason in state.reasons)
        status = DiagnosticStatus(
            level=bytes([beat.level]),
            name=self._node.get_fully_qualified_name(),  # cells share this topic
            hardware_id=self._node.get_namespace(),
            message=state.describe(),
            values=[
                KeyValue(key="state", value=state.state.name),
                KeyValue(key="reasons", value=codes),
                *beat.values,
            ],
        )
        array = DiagnosticArray(status=[status])
        array.header.stamp = self._node.get_clock().now().to_msg()
        self._diagnostics.publish(array)

    def _message(self, state: NodeState, values: Values) -> msg.NodeState:
        """Return a state with what else is to be reported."""
        trouble: dict[str, object] = {**self.errors, **self.alarms}
        if self.lost:
            trouble["lost_nodes"] = ", ".join(sorted(self.lost))
        concerns = self.clock.concerns | self.sim.concerns() | self.concerns
        rest = msg.NodeState.LEVEL_WARN if concerns else msg.NodeState.LEVEL_OK
        known = {**values, **self.clock.values(), **self.sim.values(), **concerns, **trouble}
        message = conversions.node_state_message(state)
        message.node = self._node.get_name()
        message.level = msg.NodeState.LEVEL_ERROR if trouble else rest
        message.values = [KeyValue(key=k, value=str(v)) for k, v in known.items()]
        return message


def _process(beat: msg.NodeState) -> HostProcess:
    return HostProcess(beat.host, beat.pid, beat.start)
