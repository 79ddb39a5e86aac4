"""What the instruments of the cell say, as records, and what is known of each stream."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Collection
from functools import partial
from typing import Any, Final

from sensor_msgs.msg import JointState

from rotcal_ros.bags import names
from rotcal_ros.capture import CaptureSettings
from rotcal_ros.capture.instruments.conventions import single_shots
from rotcal_ros.capture.instruments.forms import OWN
from rotcal_ros.capture.instruments.interpreter import FAST, Interpreter
from rotcal_ros.capture.instruments.rates import Rates
from rotcal_ros.capture.instruments.steps import Position
from rotcal_ros.capture.stamp_offsets import OffsetLimits, StampOffsets
from rotcal_ros.foundation.observations import (
    HumiditySample,
    LengthStatus,
    PressureSample,
    ProbeSample,
    TableSample,
    TemperatureSample,
    TracerSample,
)
from rotcal_ros.methods import Configuration
from rotcal_ros.nodes.instruments.topics import InstrumentTopics
from rotcal_ros.nodes.runtime.cell_node import CellNode
from rotcal_ros.nodes.runtime.draining import Batch, received_ns, sent_ns
from rotcal_ros.nodes.runtime.latest import FRAME, JOINT, MOST_JOINTS, NOW, RATE, SILENT, reading


class JointReadings:
    """The latest angle (rad) and velocity (rad/s) of each joint."""

    def __init__(self) -> None:
        self._joints: dict[str, tuple[float, float]] = {}

    def note(self, message: JointState, chosen: str) -> None:
        """Note what a message says of its joints; the ``chosen`` one is told in any case."""
        velocities = (*message.velocity, *(math.nan for _ in message.position))
        for name, angle, velocity in zip(message.name, message.position, velocities, strict=False):
            if name in self._joints or name == chosen or len(self._joints) < MOST_JOINTS:
                self._joints[name] = angle, velocity

    def values(self) -> dict[str, str]:
        """Return what is told of the joints, in the order in which they were first heard."""
        return {f"{JOINT}{n}": f"{a:.9f} {v:.9f}" for n, (a, v) in self._joints.items()}


TIMED: Final = (*FAST, names.PROBE_POINT)
"""Streams whose stamps make an observation: their clocks must agree."""


class InstrumentStreams:
    """Listens to all instruments; every record goes to ``take``.

    ``topics`` knows their names and settings, ``offsets`` whose clocks differ.
    """

    def __init__(self, node: CellNode, take: Callable[[Any], None]) -> None:
        self._node, self._take = node, take
        self._awake = node.health.awake
        self._valid: Counter[str] = Counter()
        self._heard_s: dict[str, float] = {}
        self._latest: dict[str, Any] = {}
        self._frames: dict[str, str] = {}
        self._joints, self._rates = JointReadings(), Rates()
        self.offsets = StampOffsets(OffsetLimits.of(CaptureSettings()))
        self.topics = InstrumentTopics(node, self._switched)
        self._joint = ""
        self._interpreter = Interpreter(self.topics.settings)
        for role in OWN:
            self.topics.listen(role, node.health.guarded(partial(self._heard, role)))

    def use(self, configuration: Configuration) -> None:
        """Understand the instruments as the configuration of a plan says."""
        self.topics.use(configuration)
        self.offsets.limits = OffsetLimits.of(configuration.capture)
        self._joint = configuration.cell.joint
        self._interpreter = Interpreter(self.topics.settings, self._joint)

    def not_silent(self) -> None:
        """Count silences from now on: what came while the node was busy waits to be read."""
        self._heard_s = dict.fromkeys(self._heard_s, self._awake.now_s())

    def values(self, needed: Collection[str]) -> dict[str, Any]:
        """Return what the beat tells: of ``needed`` streams that never pause, their silence."""
        values: dict[str, Any] = self.topics.values()
        values |= {f"valid.{role}": self._valid[role] for role in self._heard_s}
        values |= {f"{NOW}{role}": reading(record) for role, record in self._latest.items()}
        values |= {f"{FRAME}{role}": frame for role, frame in self._frames.items()}
        values |= {f"{RATE}{role}": f"{hertz:.4g}" for role, hertz in self._rates.hertz().items()}
        values |= self._joints.values()
        steady = set(FAST) - set(single_shots(self.topics.settings))
        now = self._awake.now_s()
        for role in steady & set(needed) & self._heard_s.keys():
            values[f"{SILENT}{role}"] = f"{now - self._heard_s[role]:.2f}"
        return values

    def _heard(self, role: str, type_name: str, batch: Batch) -> None:
        batch, _ = self._node.hearing.split(self.topics.name(role), batch)
        if not batch:
            return
        self._heard_s[role] = self._awake.now_s()
        sent = [(message, sent_ns(info)) for message, info in batch]
        if header := getattr(batch[-1][0], "header", None):
            self._frames[role] = header.frame_id
        if type_name == OWN[names.JOINT_STATES]:
            self._note_joints([message for message, _ in batch])
        records = self._interpreter.records(role, type_name, sent)
        if role in TIMED:
            simulated_ns = self._node.now_ns() if self._node.health.sim.used else 0
            left_out = len(batch) - len(records)  # the first ones
            for record, (_, info) in zip(records, batch[left_out:], strict=True):
                self.offsets.note(role, record.stamp_ns, simulated_ns or received_ns(info))
        for record in records:
            self._latest[role] = record
            self._valid[role] += _is_valid(record)
            if role in FAST:
                self._rates.note(role, record.stamp_ns)
            self._take(record)

    def _note_joints(self, messages: list[JointState]) -> None:
        for message in messages:
            self._joints.note(message, self._joint)

    def _switched(self, role: str) -> None:
        """Forget what was heard of an instrument that changed, or is understood differently."""
        for known in (self._heard_s, self._latest, self._frames, self._valid):
            known.pop(role, None)
        self._rates.forget(role)
        self.offsets.forget(role)
        self._interpreter = Interpreter(self.topics.settings, self._joint)


def _is_valid(record: Any) -> bool:
    """Return whether an instrument measures: a preflight waits for it."""
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
