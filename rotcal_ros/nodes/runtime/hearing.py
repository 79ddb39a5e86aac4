"""Which publishers a node hears: what the planner says of a run, applied to every message."""

from __future__ import annotations

import hashlib
import time
from contextlib import suppress
from typing import Any, Final

from rclpy.impl.implementation_singleton import rclpy_implementation

from rotcal_ros.bags import names
from rotcal_ros.capture.heard import Believed, Intruder, Origin, WhoIsHeard, publisher_of
from rotcal_ros.nodes.runtime.diagnostic_warnings import INTRUDER, show
from rotcal_ros.nodes.runtime.draining import Batch

BELIEVED: Final = "believed"
"""Value in the planner's beat: which publishers count on each topic while a goal runs."""
LISTENERS: Final = {names.OBSERVATION: 3, names.STEP_CHOICE: 1}
"""How many nodes of the suite listen to a topic; USUAL to any other of a run."""
USUAL: Final = 2
UNNAMED: Final = "_NODE_NAME_UNKNOWN_"
"""What rclpy calls a node that discovery has not named yet."""
HEARS: Final = "hears"
"""Value in the beat of every other node: the hash of what it has heard of that."""
APART: Final = "apart"
"""Instead, while not all of these publishers are discovered yet: their topics."""


class Hearing:
    """Which messages of a run a node accepts; it names the publishers that it leaves alone.

    ``quiet``: another node says that already.
    """

    def __init__(self, node: Any, *, quiet: bool = False) -> None:
        self._node, self._quiet = node, quiet
        self._judge = WhoIsHeard()
        self._beat: object = None
        self._joined = False
        self._words: dict[str, str] = {}

    def decide(self, believed: Believed) -> None:
        """Accept these publishers, as the planner that decides it; none given: all."""
        self._believe(believed)

    def hears(self, topic: str, info: Any) -> bool:
        """Return whether a message of a topic (absolute name) counts, by its message info."""
        self._follow()
        if self._judge.hears(topic, origin_of(info), time.monotonic()):
            return True
        self._tell()
        return False

    def split(self, topic: str, batch: Batch) -> tuple[Batch, Batch]:
        """Return the messages that count, and those that are left alone."""
        self._follow()
        if topic not in self._judge.believed.publishers:
            return batch, ()
        ours, others = list[tuple[Any, Any]](), list[tuple[Any, Any]]()
        for pair in batch:
            (ours if self.hears(topic, pair[1]) else others).append(pair)
        return ours, others

    def values(self) -> dict[str, str]:
        """Return the values for the beat: which publishers count here, and that they are heard."""
        self._follow()
        if not self._judge.believed.publishers:
            return {}
        apart = ", ".join(self._apart())
        return {HEARS: digest(self._judge.believed)} if self._joined else {APART: apart}

    def _apart(self) -> list[str]:
        """Return the topics of the run on which this node cannot hear or be heard yet.

        Each end discovers the other by itself, one perhaps seconds after the other, and what is
        sent once, such as an order or an observation, is lost to an end that is not discovered
        yet.
        """
        if self._joined:
            return []
        node, believed, apart = self._node, self._judge.believed.publishers, set[str]()
        listeners = dict.fromkeys(believed, USUAL)
        listeners |= {node.resolve_topic_name(role): n for role, n in LISTENERS.items()}
        with suppress(rclpy_implementation.InvalidHandle):  # one was given up: asked again soon
            for heard in tuple(node.subscriptions):
                if heard.get_publisher_count() < len(believed.get(heard.topic_name, ())):
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
            self._believe(Believed.read(self._node.health.values("planner").get(BELIEVED, "")))

    def _believe(self, believed: Believed) -> None:
        if believed != self._judge.believed:
            self._judge.believe(believed)
            self._joined = False
            self._words.clear()
            self._show(None)

    def _tell(self) -> None:
        """Name the publishers that are left alone, each once on the console."""
        texts = []
        for intruder in self._judge.met():
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
        known = self._judge.believed.publishers[intruder.topic]
        there = {publisher_of(i.endpoint_gid): i.node_name for i in infos}
        if UNNAMED in there.values():
            return None
        heard = [there[gid] for gid in known if gid in there]
        others = sorted(name for gid, name in there.items() if gid not in known)
        name = there.get(intruder.publisher, "") if intruder.publisher else ", ".join(others)
        anew = bool(name) and (not heard or name in heard)
        return intruder.in_words(name, anew=anew)

    def _show(self, text: str | None) -> None:
        if not self._quiet:
            show(self._node.health, INTRUDER, text)


def origin_of(info: Any) -> Origin:
    """Return where a message comes from, by its message info, which not every ROS 2 fills in."""
    publisher, number = info.get("publisher_gid"), info.get("publication_sequence_number")
    identity = publisher_of(publisher["data"]) if publisher else ""
    return Origin(identity, None if number is None else int(number))


def digest(believed: Believed) -> str:
    """Return a short name of the accepted publishers."""
    return hashlib.sha256(believed.in_a_beat().encode()).hexdigest()[:12]
