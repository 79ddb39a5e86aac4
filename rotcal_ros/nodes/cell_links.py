"""The planner's links to the cell: orders out, observations, receipts and deviations in."""

from __future__ import annotations

import math

from rotcal_msgs.msg import (
    CalibrationPlan,
    DeviationArray,
    ProbeTarget,
    RecordedObservation,
    TableAngle,
)
from rotcal_msgs.msg import Observation as ObservationMsg
from rotcal_msgs.srv import FinishCalibration, StartRecording, StopRecording

from rotcal_ros import messages
from rotcal_ros.bags import names
from rotcal_ros.nodes import conversions
from rotcal_ros.nodes.cell_node import CellNode
from rotcal_ros.nodes.qos import EVENT, LATCHED
from rotcal_ros.observations import Command, Observation

Attempt = tuple[int, int]
"""Step and attempt."""


class CellLinks:
    """Publishers, subscriptions and clients, and what came in for the steps so far."""

    def __init__(self, node: CellNode) -> None:
        self.node = node
        self.health = node.health
        self.observations: dict[Attempt, Observation] = {}
        self.receipts: dict[Attempt, int] = {}
        self.current_std = math.nan
        self._plan_id = ""
        self._plans = node.create_publisher(CalibrationPlan, names.PLAN, LATCHED)
        self._tables = node.create_publisher(TableAngle, names.TABLE_ANGLE, EVENT)
        self._probes = node.create_publisher(ProbeTarget, names.PROBE_TARGET, EVENT)
        for kind, topic, callback, qos in (
            (ObservationMsg, names.OBSERVATION, self._observed, EVENT),
            (RecordedObservation, "observation_recorded", self._recorded, EVENT),
            (DeviationArray, "deviations", self._solved, LATCHED),
        ):
            node.listen(kind, topic, callback, qos)
        self.start_recording = node.create_client(StartRecording, "start_recording")
        self.stop_recording = node.create_client(StopRecording, "stop_recording")
        self.finish_calibration = node.create_client(FinishCalibration, "finish_calibration")

    def forget(self) -> None:
        """Forget what came in for an earlier goal."""
        self.observations.clear()
        self.receipts.clear()
        self.current_std = math.nan

    def announce(self, plan: CalibrationPlan) -> None:
        """Publish the plan."""
        self._plan_id = plan.plan_id
        self._plans.publish(plan)

    def order(self, command: Command) -> None:
        """Order the table to its angle and the probe to its target."""
        table, probe = conversions.command_messages(command, self.node.now_ns())
        self._tables.publish(table)
        self._probes.publish(probe)

    def publishers(self, topic: str) -> list[str]:
        """Return the names of the nodes that publish ``topic``."""
        infos = self.node.get_publishers_info_by_topic(self.resolve(topic))
        return sorted(info.node_name for info in infos)

    def listeners(self, topic: str) -> list[str]:
        """Return the names of the nodes that subscribe to ``topic``."""
        infos = self.node.get_subscriptions_info_by_topic(self.resolve(topic))
        return sorted(info.node_name for info in infos)

    def resolve(self, topic: str) -> str:
        """Return the absolute name of a topic of the cell."""
        name: str = self.node.resolve_topic_name(topic)
        return name

    def _observed(self, message: ObservationMsg) -> None:
        self.observations[message.step, message.attempt] = messages.observation(message)

    def _recorded(self, message: RecordedObservation) -> None:
        self.receipts[message.step, message.attempt] = int(message.lost)

    def _solved(self, message: DeviationArray) -> None:
        if message.plan_id == self._plan_id and message.ecc_std:
            self.current_std = max(message.ecc_std)
