"""The services of recorder and solver that a planner calls."""

from __future__ import annotations

from rotcal_msgs.srv import FinishCalibration, StartRecording, StopRecording
from std_srvs.srv import Trigger

from rotcal_ros.nodes.cell_node import CellNode


class CellServices:
    """One client for each service."""

    def __init__(self, node: CellNode) -> None:
        self.start_recording = node.create_client(StartRecording, "start_recording")
        self.continue_recording = node.create_client(StartRecording, "continue_recording")
        self.recorded_observations = node.create_client(Trigger, "recorded_observations")
        self.stop_recording = node.create_client(StopRecording, "stop_recording")
        self.finish_calibration = node.create_client(FinishCalibration, "finish_calibration")

    def missing(self) -> list[str]:
        """Return which services are not offered, in words."""
        of_recorder = (
            self.start_recording,
            self.continue_recording,
            self.recorded_observations,
            self.stop_recording,
        )
        needed = [("recorder", client) for client in of_recorder]
        return [
            f"node {node} does not offer {client.srv_name}"
            for node, client in (*needed, ("solver", self.finish_calibration))
            if not client.service_is_ready()
        ]
