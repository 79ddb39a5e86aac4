"""Subscribes to every topic of the cell as serialised bytes, as soon as it has a publisher."""

from __future__ import annotations

import struct
import time
from collections import Counter, deque
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass, field, replace
from typing import Any, Final

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import QoSProfile

from rotcal_ros.bags import names
from rotcal_ros.bags.dropouts import GAP, REPORTED, UNHEARD, Dropout
from rotcal_ros.bags.settings import TopicSettings
from rotcal_ros.capture.instruments.conventions import Conventions, single_shots
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.methods.configuration import read_topics
from rotcal_ros.nodes.recorder.bookkeeping import NEVER_PAUSE, TopicLosses
from rotcal_ros.nodes.recorder.recording import Channel, Messages, described_channel
from rotcal_ros.nodes.runtime.cell_node import CellNode
from rotcal_ros.nodes.runtime.message_types import message_type
from rotcal_ros.nodes.runtime.qos import adapted_qos
from rotcal_ros.nodes.runtime.timers_and_subscriptions import (
    GRAPH_PERIOD_S,
    UNWAITED,
    Batch,
    DrainedSubscription,
    sent_ns,
    steady_timer,
)
from rotcal_ros.planning.settings import SafetySettings

ALWAYS: Final = ("/diagnostics", "/rosout", names.TF_STATIC)
"""Topics outside the namespace of the cell that are recorded too."""
FAST_PERIOD_S: Final = 0.02
"""Period at which fast topics are read: a turn costs as much for one message as for many."""
MOST_LATCHED: Final = 100
"""Number of batches of static transforms that are kept for the next bag."""
_STAMP: Final = struct.Struct("<4xiI")
"""CDR encapsulation, then the stamp that begins every message with a header."""


@dataclass
class HeardTopic:
    """A topic that is recorded: its channel and how far it has come.

    ``heard_s`` is the monotonic time of the latest batch, or of the subscription, ``heard_ns`` the
    log time of the latest message; ``latched`` is what was published once for late subscribers.
    """

    channel: Channel
    heard_s: float = field(default_factory=time.monotonic)
    heard_ns: int = field(default_factory=time.time_ns)
    sent_ns: int = 0
    latest: bytes = b""
    latched: deque[Messages] = field(default_factory=lambda: deque(maxlen=MOST_LATCHED))
    losses: TopicLosses = field(default_factory=TopicLosses)

    def taken_ns(self, role: str, conventions: Conventions) -> int:
        """Return when the newest message was taken, by the common clock; 0: none has come."""
        if not self.latest:
            return 0
        form = conventions.form(role, self.channel.type_name)
        if form is not None and not form.stamped:
            return int(conventions.taken_ns(role, self.sent_ns, self.sent_ns))
        seconds, nanoseconds = _STAMP.unpack_from(self.latest)
        stamp_ns = int(seconds) * 1_000_000_000 + int(nanoseconds)
        return int(conventions.taken_ns(role, stamp_ns, self.sent_ns))


class TopicListener:
    """Subscribes to topics as they appear and hands their messages to ``take``.

    Gaps go to ``missed`` before the messages that follow them go to ``take``. Recorded are the
    topics of the cell's namespace and the ``further`` ones, by absolute name. Messages of a
    ``fast`` topic do not wake the node: they are taken together. ``topics`` maps absolute names to
    what was heard; ``refused`` holds topics whose type is not installed.
    """

    def __init__(
        self,
        node: CellNode,
        take: Callable[[HeardTopic, Batch], None],
        missed: Callable[[Dropout], None],
        further: Callable[[], Collection[str]] = tuple,
        fast: Callable[[str], bool] = lambda _: False,
    ) -> None:
        self._node = node
        self._hand_over = take
        self._missed = missed
        self._further = further
        self._is_fast = fast
        self._drained: list[DrainedSubscription] = []
        self._fast: list[DrainedSubscription] = []
        self.topics: dict[str, HeardTopic] = {}
        self.refused: dict[str, str] = {}
        self._conventions = Conventions(TopicSettings())
        self._incompatible: Counter[str] = Counter()
        stop = node.settings("safety", SafetySettings).emergency_stop
        self._stop = [node.resolve_topic_name(stop)] if stop else []
        node.every(GRAPH_PERIOD_S, self._look)
        steady_timer(node, FAST_PERIOD_S, node.health.guarded(self.take_fast))

    @property
    def losses(self) -> Counter[str]:
        """What the middleware lost, and how many publishers cannot be heard, by topic."""
        lost = {f"{names.LOST} {name}": topic.losses.count for name, topic in self.topics.items()}
        return Counter({name: count for name, count in lost.items() if count}) + self._incompatible

    def begin(self, configuration_text: str) -> None:
        """Begin a bag: count losses from zero, and read the instruments by its configuration."""
        self._conventions = Conventions(read_topics(configuration_text))
        self._incompatible.clear()
        for topic in self.topics.values():
            topic.losses.forget()

    def reached_ns(
        self, rows: Iterable[Iterable[str]], called: Callable[[str], str]
    ) -> int | None:
        """Return how far all ``rows`` have come, each by its first role that has come at all.

        ``called`` returns the topic of a role. None: nothing has come.
        """
        reached = (self._first_reached_ns(roles, called) for roles in rows)
        return min((stamp for stamp in reached if stamp is not None), default=None)

    def _first_reached_ns(self, roles: Iterable[str], called: Callable[[str], str]) -> int | None:
        heard = ((role, self.topics.get(called(role))) for role in roles)
        came = ((role, topic) for role, topic in heard if topic is not None and topic.latest)
        return next((topic.taken_ns(role, self._conventions) for role, topic in came), None)

    def heard_s(self, role: Callable[[str], str]) -> dict[str, float]:
        """Return when the topics that never pause were last heard, in monotonic time.

        ``role`` returns the role of a topic.
        """
        steady = set(NEVER_PAUSE) - set(single_shots(self._conventions.settings))
        return {name: t.heard_s for name, t in self.topics.items() if role(name) in steady}

    def tell_again(self, take: Callable[[Messages], object]) -> None:
        """Hand over latched messages as if they had just come: every bag begins with them."""
        now_ns = time.time_ns()
        for topic in self.topics.values():
            for latched in topic.latched:
                take(Messages(topic.channel, [(d, now_ns, sent) for d, _, sent in latched.items]))

    def drain(self) -> None:
        """Handle what has arrived and is still waiting."""
        for drained in self._drained:
            drained.drain()

    def take_fast(self) -> None:
        """Handle what has arrived on the fast topics."""
        for drained in self._fast:
            drained.drain()

    def _look(self) -> None:
        """Subscribe to topics that are new in the graph and have publishers."""
        for name, type_name in _wanted_topics(self._node, [*self._further(), *self._stop]).items():
            if name in self.topics or name in self.refused:
                continue
            infos = self._node.get_publishers_info_by_topic(name)
            if not infos:
                continue
            try:
                kind = message_type(type_name)
                topic = HeardTopic(described_channel(name, type_name, infos))
            except BagError as error:
                self.refused[name] = str(error)
                self._node.get_logger().error(f"{name} cannot be recorded: {error}")
                continue
            qos = adapted_qos([info.qos_profile for info in infos])
            self._subscribe(topic, kind, qos)
            self.topics[name] = topic  # only now: a subscription that fails is tried again

    def _subscribe(self, topic: HeardTopic, kind: type, qos: QoSProfile) -> None:
        name = topic.channel.topic

        def missed(count: int, to_ns: int, reason: str) -> None:
            self._missed(Dropout(name, min(topic.heard_ns, to_ns), to_ns, count, reason))

        fast = self._is_fast(name)

        def handle(batch: Batch) -> None:
            ours, others = self._node.accepted.split(name, batch)
            if others:  # kept on a topic of their own, apart from the run's publishers
                self._hand_over(_left_alone(self._node, topic), others)
            if ours:
                self._heard(topic, ours, missed)

        def message_lost(event: Any) -> None:
            if lost := topic.losses.report(event.total_count_change):
                missed(lost, time.time_ns(), REPORTED)

        def incompatible(event: Any) -> None:
            self._incompatible[f"{names.UNHEARD} {name}"] += event.total_count_change
            for _ in range(event.total_count_change):
                missed(0, time.time_ns(), UNHEARD)

        self._drained.append(
            DrainedSubscription(
                self._node,
                kind,
                name,
                qos,
                self._node.health.guarded(handle),
                raw=True,
                event_callbacks=SubscriptionEventCallbacks(
                    message_lost=message_lost, incompatible_qos=incompatible
                ),
                group=UNWAITED if fast else None,
            )
        )
        if fast:
            self._fast.append(self._drained[-1])

    def _heard(
        self, topic: HeardTopic, batch: Batch, missed: Callable[[int, int, str], None]
    ) -> None:
        """Note how far a topic has come and what is missing, and hand its messages over."""
        topic.latest, topic.heard_s = batch[-1][0], time.monotonic()
        topic.sent_ns = sent_ns(batch[-1][1])
        if topic.channel.topic == names.TF_STATIC:
            topic.latched.append(Messages.taken(topic.channel, batch))
        elif topic.channel.topic.endswith((f"/{names.GOAL}", f"/{names.GOAL_STATUS}")):
            topic.latched.clear()  # published before the bag begins; the last one counts
            topic.latched.append(Messages.taken(topic.channel, batch[-1:]))
        for _, info in batch:
            received_ns = info["received_timestamp"] or time.time_ns()
            if (lost := _lost_before(topic, info)) is not None:
                missed(lost, received_ns, GAP)
            topic.heard_ns = received_ns
        self._hand_over(topic, batch)


def _left_alone(node: Node, topic: HeardTopic) -> HeardTopic:
    """Return the channel for messages of publishers that are ignored during a run."""
    last = topic.channel.topic.rpartition("/")[2]
    beside = node.resolve_topic_name(f"~/{last}_{names.LEFT_ALONE}")
    return HeardTopic(replace(topic.channel, topic=beside))


def _lost_before(topic: HeardTopic, info: Any) -> int | None:
    """Return how many messages are newly missing before one, by its number; None: none."""
    publisher = info.get("publisher_gid")
    if publisher is None:
        return None
    return topic.losses.number(info.get("publication_sequence_number"), bytes(publisher["data"]))


def _wanted_topics(node: Node, further: Collection[str]) -> dict[str, str]:
    """Return name -> type of all topics to record: namespace, diagnostics, log, others.

    Of the hidden topics only the status of the cell's action is among them.
    """
    prefix = node.get_namespace().rstrip("/") + "/"
    further = {*further, prefix + names.GOAL_STATUS}
    return {
        name: types[0]
        for name, types in node.get_topic_names_and_types()
        if name in further or ((name in ALWAYS or name.startswith(prefix)) and "/_" not in name)
    }
