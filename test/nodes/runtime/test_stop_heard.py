"""How a node hears an emergency stop: what waits, what is short, its own stall; no graph."""

from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Bool

from rotcal_ros.nodes.runtime import emergency_stop
from rotcal_ros.nodes.runtime.emergency_stop import EmergencyStop
from rotcal_ros.planning.settings import SafetySettings

TOPIC, DIAGNOSTICS = "/safety/estop", "/diagnostics"


class Node:
    """A node whose middleware is lists: what waits by topic, and its timers."""

    def __init__(self):
        self.waiting, self.profiles, self.regular, self.said = {}, [], [], []
        self.publishers = []
        self.health = SimpleNamespace(guarded=lambda work: work, concerns={}, alarms={})
        log = SimpleNamespace(error=self.said.append, warning=self.said.append)
        self.get_logger = lambda: log

    def resolve_topic_name(self, name):
        return name

    def get_publishers_info_by_topic(self, _topic):
        return [SimpleNamespace(qos_profile=qos) for qos in self.publishers]

    def every(self, _period_s, work):
        self.regular.append(work)


class Listening:
    """A subscription of that node."""

    def __init__(self, node, _kind, topic, qos, handle):
        self._batch, self._handle = node.waiting.setdefault(topic, []), handle
        node.profiles.append(qos)

    def drain(self):
        batch, self._batch[:] = [(message, None) for message in self._batch], []
        if batch:
            self._handle(batch)


@pytest.fixture
def heard(monkeypatch):
    """Return a node, its stop with some settings, and a function that sets the time (s)."""
    now, steady = [100.0], []
    monkeypatch.setattr(emergency_stop, "time", SimpleNamespace(monotonic=lambda: now[0]))
    monkeypatch.setattr(emergency_stop, "DrainedSubscription", Listening)
    monkeypatch.setattr(
        emergency_stop, "steady_timer", lambda _node, _s, work: steady.append(work), raising=False
    )

    def make(**settings):
        node = Node()
        node.steady, node.create_subscription = steady, lambda *_: None
        settings = SafetySettings(emergency_stop=TOPIC, **settings)
        return node, EmergencyStop(node, settings, "nothing moves"), lambda s: now.insert(0, s)

    return make


def look(node):
    for work in node.regular:
        work()


def test_what_waits_is_heard_before_a_stall_of_ones_own_counts_as_silence(heard):
    node, stop, set_time = heard(silent_s=1.0, stop_on_diagnostics=("drive",))
    set_time(103.0)
    good = DiagnosticArray(status=[DiagnosticStatus(name="plc: drive")])
    node.waiting[TOPIC].append(Bool())
    node.waiting[DIAGNOSTICS].append(good)
    look(node)
    assert (stop.why, stop.latched, stop.count) == (None, None, 0)
    set_time(104.5)
    look(node)
    silent = "has said nothing for 1 s (safety.silent_s)"
    assert stop.why == f"{TOPIC} {silent}; plc: drive {silent}"
    assert stop.count == 1


def test_an_error_that_is_over_in_the_same_message_is_kept(heard):
    node, stop, _ = heard(stop_on_diagnostics=("drive",))
    levels = (DiagnosticStatus.ERROR, DiagnosticStatus.OK)
    status = [DiagnosticStatus(name="plc: drive", level=level, message="I2t") for level in levels]
    node.waiting[DIAGNOSTICS].append(DiagnosticArray(status=status))
    assert stop.check_stop() == "plc: drive is in ERROR on /diagnostics (I2t)"
    assert (stop.why, stop.count) == (None, 1)


def test_a_latched_stop_is_heard_in_every_state_and_with_the_release_that_follows_at_once(heard):
    node, _, _ = heard()
    node.publishers = [QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)]
    for work in node.steady:  # what is done by node.every only happens while the node is active
        work()
    latched = node.profiles[-1]
    assert latched.durability == DurabilityPolicy.TRANSIENT_LOCAL
    assert latched.reliability == ReliabilityPolicy.RELIABLE
    assert latched.depth > 1


def test_an_order_behind_a_stop_that_waits_to_be_handled_is_refused(heard):
    node, stop, _ = heard()
    assert not stop.refuses(6)
    node.waiting[TOPIC].append(Bool(data=True))
    assert stop.refuses(7)
    assert node.said[-1] == "step 7: refused in an emergency stop"
    node.waiting[TOPIC].append(Bool())
    assert not stop.refuses(8)
