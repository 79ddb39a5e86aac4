"""Which publishers a node accepts while a calibration runs: those that the planner names.

When a run begins, the planner fixes the publishers of every topic and lists them in its beat
(ACCEPTED). Each node ignores all others from then on, and answers in its own beat (HEARS) with a
hash of what it accepts, once it is connected to all of them. Only then does the planner go on.
"""

from __future__ import annotations

import hashlib
from contextlib import suppress
from typing import Any, Final

from rclpy.impl.implementation_singleton import rclpy_implementation

from rotcal_ros.bags import names
from rotcal_ros.capture.publishers import (
    Intruder,
    MessageOrigin,
    PublisherFilter,
    PublisherList,
    publisher_of,
)
from rotcal_ros.nodes.runtime.beat_values import INTRUDER, set_warning
from rotcal_ros.nodes.runtime.timers_and_subscriptions import Batch

ACCEPTED: Final = "believed"
"""Value in the planner's beat: which publishers count on each topic while a goal runs."""
LISTENERS: Final = {names.OBSERVATION: 3, names.PLAN: 3, names.STEP_CHOICE: 1, names.GOAL: 1}
"""Topic -> how many of our nodes subscribe; to any other topic of a run, USUAL."""
USUAL: Final = 2
UNNAMED: Final = "_NODE_NAME_UNKNOWN_"
"""rclpy's name for a node whose name discovery has not delivered yet."""
HEARS: Final = "hears"
"""Value in the beat of every other node: the hash of the publishers that it accepts."""
APART: Final = "apart"
"""Value instead of HEARS while connections are missing: the topics of these."""


class AcceptedPublishers:
    """Decides which messages of a run a node accepts, and reports ignored publishers.

    ``quiet``: it does not report them, because other nodes do.
    """

    def __init__(self, node: Any, *, quiet: bool = False) -> None:
        self._node, self._quiet = node, quiet
        self._judge = PublisherFilter()
        self._beat: object = None
        self._joined = False
        self._words: dict[str, str] = {}

    def decide(self, accepted: PublisherList) -> None:
        """Accept these publishers; without any, accept all. Only the planner calls this."""
        self._accept(accepted)

    def accepts(self, topic: str, info: Any) -> bool:
        """Return whether a message on a topic (absolute name) counts, by its message info."""
        self._follow()
        if self._judge.accepts(topic, message_publisher(info)):
            return True
        self._tell()
        return False

    def split(self, topic: str, batch: Batch) -> tuple[Batch, Batch]:
        """Return the messages of accepted publishers, and the others."""
        self._follow()
        if topic not in self._judge.accepted.publishers:
            return batch, ()
        ours, others = list[tuple[Any, Any]](), list[tuple[Any, Any]]()
        for pair in batch:
            (ours if self.accepts(topic, pair[1]) else others).append(pair)
        return ours, others

    def values(self) -> dict[str, str]:
        """Return the values for the beat: HEARS, or APART; none while no run is on."""
        self._follow()
        if not self._judge.accepted.publishers:
            return {}
        apart = ", ".join(self._apart())
        return (
            {HEARS: accepted_publishers_hash(self._judge.accepted)}
            if self._joined
            else {APART: apart}
        )

    def _apart(self) -> list[str]:
        """Return the topics of the run on which this node is not connected to all others yet.

        Publisher and subscriber discover each other separately, perhaps seconds apart. What is
        sent once, such as an order or an observation, never reaches a subscriber that its
        publisher has not discovered yet.
        """
        if self._joined:
            return []
        node, accepted, apart = self._node, self._judge.accepted.publishers, set[str]()
        listeners = dict.fromkeys(accepted, USUAL)
        listeners |= {node.resolve_topic_name(role): n for role, n in LISTENERS.items()}
        with suppress(rclpy_implementation.InvalidHandle):  # one was given up: asked again soon
            for heard in tuple(node.subscriptions):
                if heard.get_publisher_count() < len(accepted.get(heard.topic_name, ())):
                    apart.add(heard.topic_name)
            for sent in tuple(node.publishers):
                if sent.get_subscription_count() < listeners.get(sent.topic_name, 0):
                    apart.add(sent.topic_name)
            self._joined = not apart
        return sorted(apart)

    def _follow(self) -> None:
        """Accept the publishers that the planner names."""
        beat = self._node.health.others.get("planner")
        if beat is self._beat:
            return
        self._beat = beat
        if beat is not None:
            self._accept(PublisherList.read(self._node.health.values("planner").get(ACCEPTED, "")))

    def _accept(self, accepted: PublisherList) -> None:
        if accepted != self._judge.accepted:
            self._judge.accept(accepted)
            self._joined = False
            self._words.clear()
            self._show(None)

    def _tell(self) -> None:
        """Report the publishers that are ignored, each once on the console."""
        texts = []
        for intruder in self._judge.intruders:
            known = self._words.get(intruder.publisher)
            words = known or self._in_words(intruder)
            if words is None:
                continue  # its next message names it
            self._words[intruder.publisher] = words
            texts.append(words)
            if known is None and not self._quiet:
                self._node.get_logger().warning(words)
        self._show("; ".join(texts))

    def _in_words(self, intruder: Intruder) -> str | None:
        """Return the name of a publisher; None while the middleware lacks its node's name."""
        infos = self._node.get_publishers_info_by_topic(intruder.topic)
        known = self._judge.accepted.publishers[intruder.topic]
        there = {publisher_of(i.endpoint_gid): i.node_name for i in infos}
        if UNNAMED in there.values():
            return None
        heard = [there[gid] for gid in known if gid in there]
        others = sorted(name for gid, name in there.items() if gid not in known)
        name = there.get(intruder.publisher, "") if intruder.publisher else ", ".join(others)
        anew = bool(name) and (not heard or name in heard)
        return intruder.describe(name, anew=anew)

    def _show(self, text: str | None) -> None:
        if not self._quiet:
            set_warning(self._node.health, INTRUDER, text)


def message_publisher(info: Any) -> MessageOrigin:
    """Return the publisher of a message by its message info, which not every ROS 2 fills in."""
    publisher, number = info.get("publisher_gid"), info.get("publication_sequence_number")
    identity = publisher_of(publisher["data"]) if publisher else ""
    return MessageOrigin(identity, None if number is None else int(number))


def accepted_publishers_hash(accepted: PublisherList) -> str:
    """Return a hash of the accepted publishers."""
    return hashlib.sha256(accepted.to_heartbeat().encode()).hexdigest()[:12]
