"""Subscriptions to the instruments: their messages as records, whatever type or unit they have."""

from __future__ import annotations

import json
import math
from collections import Counter, deque
from collections.abc import Callable, Collection, Sequence
from functools import partial
from typing import Any, Final

from sensor_msgs.msg import JointState

from rotcal_ros.bags import names
from rotcal_ros.bags.settings import TopicSettings
from rotcal_ros.capture import CaptureSettings
from rotcal_ros.capture.instruments.conventions import OWN, Conventions, single_shots
from rotcal_ros.capture.instruments.interpreter import FAST, Interpreter
from rotcal_ros.capture.instruments.plausibility import Rates, reading_scatter
from rotcal_ros.capture.instruments.steps import Position
from rotcal_ros.capture.stamp_offsets import OffsetLimits, StampOffsets
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.foundation.observations import (
    HumiditySample,
    LengthStatus,
    PressureSample,
    ProbeSample,
    TableSample,
    TemperatureSample,
    TracerSample,
)
from rotcal_ros.foundation.settings import load
from rotcal_ros.methods import Configuration
from rotcal_ros.nodes.runtime.beat_values import (
    FRAME,
    JOINT,
    MOST_JOINTS,
    NOW,
    RATE,
    REFUSED,
    SCATTER,
    SILENT,
    TOPICS,
    configured_topics,
    reading_values,
    remapped_topic_values,
)
from rotcal_ros.nodes.runtime.cell_graph import CellGraph
from rotcal_ros.nodes.runtime.cell_node import CellNode
from rotcal_ros.nodes.runtime.health import BEAT_PERIOD_S
from rotcal_ros.nodes.runtime.message_types import ONE_VERSION, message_type, numeric_fields
from rotcal_ros.nodes.runtime.timers_and_subscriptions import (
    Batch,
    InstrumentSubscription,
    received_ns,
    sent_ns,
)


class JointReadings:
    """The latest angle (rad) and velocity (rad/s) of each joint."""

    def __init__(self) -> None:
        self._joints: dict[str, tuple[float, float]] = {}

    def note(self, message: JointState, chosen: str) -> None:
        """Note the joints of a message; the ``chosen`` one is always kept."""
        velocities = (*message.velocity, *(math.nan for _ in message.position))
        for name, angle, velocity in zip(message.name, message.position, velocities, strict=False):
            if name in self._joints or name == chosen or len(self._joints) < MOST_JOINTS:
                self._joints[name] = angle, velocity

    def values(self) -> dict[str, str]:
        """Return the values for the beat, in the order in which the joints were first heard."""
        return {f"{JOINT}{n}": f"{a:.9f} {v:.9f}" for n, (a, v) in self._joints.items()}


_SCATTERED: Final = 200
"""Lengths whose scatter is in the beat."""
TIMED: Final = (*FAST, names.PROBE_POINT)
"""Streams whose stamps make an observation: their clocks must agree."""


class InstrumentStreams:
    """Listens to all instruments; every record goes to ``take``.

    ``topics`` knows their names and settings, ``offsets`` which clocks differ.
    """

    def __init__(self, node: CellNode, take: Callable[[Any], None]) -> None:
        self._node, self._take = node, take
        self._awake = node.health.awake
        self._valid: Counter[str] = Counter()
        self._heard_s: dict[str, float] = {}
        self._latest: dict[str, Any] = {}
        self._frames: dict[str, str] = {}
        self._joints, self._rates = JointReadings(), Rates()
        self._lengths: deque[float] = deque(maxlen=_SCATTERED)
        self.offsets = StampOffsets(OffsetLimits.of(CaptureSettings()))
        self.topics = InstrumentTopics(node, self._switched)
        self._joint = ""
        self._interpreter = Interpreter(self.topics.settings)
        for role in OWN:
            self.topics.listen(role, node.health.guarded(partial(self._heard, role)))

    def use(self, configuration: Configuration) -> None:
        """Read the instruments as the configuration of a plan says."""
        self.topics.use(configuration)
        self.offsets.limits = OffsetLimits.of(configuration.capture)
        self._joint = configuration.cell.joint
        self._interpreter = Interpreter(self.topics.settings, self._joint)

    def restart_silence(self) -> None:
        """Count silences from now on: while the node was busy, messages waited unread."""
        self._heard_s = dict.fromkeys(self._heard_s, self._awake.now_s())

    def values(self, needed: Collection[str]) -> dict[str, Any]:
        """Return the values for the beat, with the silence of ``needed`` steady streams."""
        values: dict[str, Any] = self.topics.values()
        values |= {f"valid.{role}": self._valid[role] for role in self._heard_s}
        values |= {f"{NOW}{role}": reading_values(record) for role, record in self._latest.items()}
        values |= {f"{FRAME}{role}": frame for role, frame in self._frames.items()}
        values |= {
            f"{RATE}{role}": f"{hertz:.4g}" for role, hertz in self._rates.rates_hz().items()
        }
        if (scatter := reading_scatter(self._lengths)) is not None:
            values[f"{SCATTER}{names.TRACER_LENGTH}"] = f"{scatter:.4g}"
        values |= self._joints.values()
        steady = set(FAST) - set(single_shots(self.topics.settings))
        now = self._awake.now_s()
        for role in steady & set(needed) & self._heard_s.keys():
            values[f"{SILENT}{role}"] = f"{now - self._heard_s[role]:.2f}"
        return values

    def _heard(self, role: str, type_name: str, batch: Batch) -> None:
        batch, _ = self._node.accepted.split(self.topics.name(role), batch)
        if not batch:
            return
        self._heard_s[role] = self._awake.now_s()
        sent = [(message, sent_ns(info)) for message, info in batch]
        if header := getattr(batch[-1][0], "header", None):
            self._frames[role] = header.frame_id
        if type_name == OWN[names.JOINT_STATES]:
            for message, _ in batch:
                self._joints.note(message, self._joint)
        records = self._interpreter.records(role, type_name, sent)
        if role in TIMED:
            simulated_ns = self._node.now_ns() if self._node.health.sim.used else 0
            left_out = len(batch) - len(records)  # the first ones
            for record, (_, info) in zip(records, batch[left_out:], strict=True):
                self.offsets.note(role, record.stamp_ns, simulated_ns or received_ns(info))
        for record in records:
            self._latest[role] = record
            self._valid[role] += (valid := _is_valid(record))
            if valid and isinstance(record, TracerSample):
                self._lengths.append(record.length)
            if role in FAST:
                self._rates.note(role, record.stamp_ns)
            self._take(record)

    def _switched(self, role: str) -> None:
        """Forget what was heard of an instrument that changed or is now read differently."""
        for known in (self._heard_s, self._latest, self._frames, self._valid):
            known.pop(role, None)
        self._rates.forget(role)
        if role == names.TRACER_LENGTH:
            self._lengths.clear()
        self.offsets.forget(role)
        self._interpreter = Interpreter(self.topics.settings, self._joint)


def _is_valid(record: Any) -> bool:
    """Return whether a record is a valid reading; a preflight waits for one."""
    match record:
        case (
            TracerSample(status=LengthStatus.OK, length=number)
            | TableSample(angle=number)
            | TemperatureSample(temperature_c=number)
            | PressureSample(pressure_pa=number)
            | HumiditySample(humidity=number)
        ):
            return math.isfinite(number)
        case ProbeSample() | Position():
            return all(map(math.isfinite, record.position))
    return False


class InstrumentTopics:
    """Subscribes to instruments, and to other topics when a goal names them.

    ``settings`` are the group ``topics`` in force: what a goal gives, announced by the planner's
    beat before the preflight, else by the plan. Units and clocks are then those of the goal alone,
    as for every reader of the bag; of the node's own parameters only the names of topics still
    count. ``switched`` is called with the role of a stream that has another source now, or is read
    differently.
    ``refused`` maps each role whose type cannot be used to the reason.
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
            if versions := list(CellGraph(self._node).other_versions([self.name(role)])):
                # their messages would end this node
                self.refused[role] = f"{versions[0]}; {ONE_VERSION}"
                return None
            for chosen in type_names:
                kind, why = _kind(role, chosen, Conventions(self.settings))
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
        return self._node.resolve_topic_name(self.settings.renamed().get(role, role))

    def use(self, configuration: Configuration) -> None:
        """Use the topics that the configuration of a plan names."""
        self._take(configured_topics(configuration))

    def values(self) -> dict[str, str]:
        """Return the values for the beat: names of topics, and types that cannot be used."""
        refused = {REFUSED + r: text for r, text in (self._by_sending() | self.refused).items()}
        named = remapped_topic_values(self._node.get_namespace(), self.name)
        return {**named, **refused, TOPICS: self._goals}

    def _by_sending(self) -> dict[str, str]:
        """Return role -> why a stream without stamps cannot be used with ``/clock``."""
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
        """Use the topics that the goal of the planner names."""
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
        nameless = (
            Conventions(settings).without_topic_names
            != Conventions(self.settings).without_topic_names
        )
        self.settings = settings
        for role, stream in self._streams.items():
            if stream.move(self.name(role)) or nameless:
                self.refused.pop(role, None)
                self._switched(role)
        self._node.health.beat()


def _kind(role: str, type_name: str, conventions: Conventions) -> tuple[type | None, str]:
    """Return the class of a type in its role, or None and the reason why it cannot be used."""
    try:
        kind = message_type(type_name)
    except BagError as error:
        return None, str(error)
    why = conventions.why_unusable(role, type_name, [*numeric_fields(kind())])
    return (None, why) if why else (kind, "")
