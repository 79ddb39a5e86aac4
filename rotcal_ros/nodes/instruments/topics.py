"""The instruments of the capture, under the names that the goal's configuration gives them."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from typing import Any

from rotcal_ros.bags import names
from rotcal_ros.bags.settings import TopicSettings
from rotcal_ros.capture.instruments.conventions import Conventions
from rotcal_ros.capture.instruments.forms import check_type
from rotcal_ros.foundation.errors import BagError, ConfigurationError
from rotcal_ros.foundation.settings import load
from rotcal_ros.methods import Configuration
from rotcal_ros.nodes.runtime.cell_node import CellNode
from rotcal_ros.nodes.runtime.channels import message_type
from rotcal_ros.nodes.runtime.draining import Batch, InstrumentSubscription
from rotcal_ros.nodes.runtime.heartbeat import BEAT_PERIOD_S
from rotcal_ros.nodes.runtime.latest import REFUSED
from rotcal_ros.nodes.runtime.topic_names import TOPICS, given_topics, other_names


class InstrumentTopics:
    """Subscribes to instruments, and to other topics when a goal names them.

    ``settings`` are the group ``topics`` in force: what a goal gives, told by the planner's beat
    before the preflight, else by the plan. Units and clocks are then those of the goal alone, as
    for every reader of the bag; of the node's own parameters only names stay. ``switched`` is
    called with the role of a stream that comes from elsewhere now, or is understood otherwise.
    ``refused`` says by role which types cannot be used.
    """

    def __init__(self, node: CellNode, switched: Callable[[str], None]) -> None:
        self._node, self._switched = node, switched
        self._own: dict[str, Any] = dict(node.given.get("topics") or {})
        self._goals = ""
        self.settings = node.settings("topics", TopicSettings)
        self._streams: dict[str, InstrumentSubscription] = {}
        self.refused: dict[str, str] = {}
        self._types: dict[str, str] = {}
        node.every(BEAT_PERIOD_S, self._follow)

    def listen(self, role: str, handle: Callable[[str, Batch], None]) -> None:
        """Subscribe to the instrument of a role once it is published, whatever its type.

        ``handle`` is called with the name of the type.
        """
        chosen = ""

        def choose(type_names: Sequence[str]) -> type | None:
            nonlocal chosen
            for chosen in type_names:
                kind, why = _kind(role, chosen)
                if kind is not None:
                    self.refused.pop(role, None)
                    self._types[role] = chosen
                    return kind
                self.refused[role] = f"{self.name(role)}: {why}"
            return None

        def take(batch: Batch) -> None:
            handle(chosen, batch)

        self._streams[role] = InstrumentSubscription(self._node, choose, self.name(role), take)

    def name(self, role: str) -> str:
        """Return the absolute name of the topic of a role."""
        name: str = self._node.resolve_topic_name(self.settings.renamed().get(role, role))
        return name

    def use(self, configuration: Configuration) -> None:
        """Listen where the configuration of a plan says."""
        self._take(given_topics(configuration))

    def values(self) -> dict[str, str]:
        """Return what the beat tells of names."""
        refused = {REFUSED + r: text for r, text in (self._by_sending() | self.refused).items()}
        named = other_names(self._node.get_namespace(), self.name)
        return {**named, **refused, TOPICS: self._goals}

    def _by_sending(self) -> dict[str, str]:
        """Say by role what has the computer's time while the cell follows ``/clock``."""
        if not self._node.health.sim.used:
            return {}
        conventions = Conventions(self.settings)
        return {
            role: f"{self.name(role)}: {kind} is taken when it is sent, by the computer's clock, "
            "and the cell follows /clock (use_sim_time): publish a type with a header that is "
            "stamped by /clock (topics.*_clock: stamp), or leave use_sim_time out"
            for role, kind in self._types.items()
            if conventions.by_sending(role, kind)
        }

    def _follow(self) -> None:
        """Listen where the goal of the planner says."""
        goals = self._node.health.values("planner").get(TOPICS, "")
        if goals and goals != self._goals:
            self._take(json.loads(goals))

    def _take(self, given: dict[str, Any]) -> None:
        goals = json.dumps(given, sort_keys=True)
        others = {key: value for key, value in self._own.items() if key not in names.ROLES}
        if goals != self._goals and (ours := others.items() - given.items()):
            self._node.get_logger().warning(
                "parameters of this node that the goal's configuration does not say: "
                f"{', '.join(f'topics.{key}' for key, _ in sorted(ours))}; they are ignored, "
                "since the bag would not hold them: put them into the configuration"
            )
        called = {key: value for key, value in self._own.items() if key in names.ROLES}
        settings = load(TopicSettings, {**called, **given}, "the goal's configuration: topics")
        self._goals = goals
        if settings == self.settings:
            return
        nameless = Conventions(settings).nameless != Conventions(self.settings).nameless
        self.settings = settings
        for role, stream in self._streams.items():
            if stream.move(self.name(role)) or nameless:
                self.refused.pop(role, None)
                self._switched(role)
        self._node.health.beat()


def _kind(role: str, type_name: str) -> tuple[type | None, str]:
    """Return the class of a type in its role; None, and why, where it cannot be used."""
    try:
        check_type(role, type_name)
        return message_type(type_name), ""
    except (BagError, ConfigurationError) as error:
        return None, str(error)
