"""A rotary axis of LinuxCNC as the table: takes orders, publishes ``joint_states``.

The machine may have other axes too; its ini file says which joint the axis is. LinuxCNC's modules
belong to the system's Python, so a process of its own speaks to LinuxCNC: ``linuxcnc_agent``
beside this file. Where a HAL pin holds the actual angle, it is published on ``table_actual``.
"""

from __future__ import annotations

import json
import subprocess
import time
from collections.abc import Mapping
from contextlib import suppress
from threading import Thread
from typing import Any, Final

from rotcal_msgs.msg import TableAngle
from sensor_msgs.msg import JointState

from rotcal_ros.bags import names
from rotcal_ros.compensation.linuxcnc_machine import agent_command
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.node_state import NodeState, State, Why
from rotcal_ros.foundation.observations import Approach, TableSample
from rotcal_ros.foundation.units import DEGREE, NANOSECOND
from rotcal_ros.nodes.runtime import conversions
from rotcal_ros.nodes.runtime.cell_node import CellNode
from rotcal_ros.nodes.runtime.emergency_stop import EmergencyStop
from rotcal_ros.nodes.runtime.qos import EVENT, STREAM
from rotcal_ros.nodes.runtime.running import run_node
from rotcal_ros.planning.approach import require_rest
from rotcal_ros.planning.settings import CellSettings, SafetySettings

END_TIMEOUT_S: Final = 15.0
"""Time for the agent to end by itself; shorter than the time that a node has to end."""
SIDES: Final = {Approach.POSITIVE: 1, Approach.NEGATIVE: -1}


class LinuxCncDriver(CellNode):
    """Passes on orders and positions; a thread reads the output of the agent."""

    def __init__(self) -> None:
        super().__init__("linuxcnc_driver")

    def configure(self) -> None:
        """Start the agent."""
        ini = self.parameter("ini_file", "", "ini file of LinuxCNC")
        number = self.parameter("linuxcnc_joint", 0, "number of the table's joint in LinuxCNC")
        command = list(
            self.parameter("agent_command", [""], "starts the agent; empty: chosen automatically")
        )
        self._overshoot_deg = self.parameter(
            "overshoot_deg", 2.0, "deg, overshoot for arriving from the ordered side"
        )
        cell = self.settings("cell", CellSettings)
        self._joint = cell.joint or "table"
        if command == [""]:
            command = agent_command(ini, cell.axis, number)
        self._state = NodeState.of(State.PREPARING, Why.STARTING_AGENT)
        self._complaints = 0
        self._ending_s: float | None = None
        self._last: TableSample | None = None
        self._motor_deg = 0.0
        self._positions = self.create_publisher(JointState, names.JOINT_STATES, STREAM)
        self._actual = self.create_publisher(JointState, "table_actual", STREAM)
        self._agent = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1
        )
        Thread(target=self._read, name="agent", daemon=True).start()
        self._stop = EmergencyStop(
            self, self.settings("safety", SafetySettings), "LinuxCNC gets no more orders"
        )
        self.listen(TableAngle, names.TABLE_ANGLE, self._obey, EVENT)

    def begin_stop(self) -> None:
        """End the agent; LinuxCNC goes on, unless the agent's command started it."""
        assert self._agent.stdin is not None
        self._ending_s = time.monotonic()
        with suppress(BrokenPipeError):
            self._agent.stdin.close()

    def stopped(self) -> bool:
        """Return whether the agent has ended; after a while it is terminated."""
        late_s = 0.0 if self._ending_s is None else time.monotonic() - self._ending_s
        if late_s > END_TIMEOUT_S and self._agent.poll() is None:
            self._agent.terminate()
        return self._agent.poll() is not None

    def finished(self) -> bool:
        """Return whether the agent has ended by itself: then nothing moves the table."""
        return self._ending_s is None and self._agent.poll() is not None

    def _obey(self, message: TableAngle) -> None:
        if self._stop.refuses(message.step):
            return
        try:
            require_rest(message.turn_speed)
        except DataError as error:
            self._complaints += 1
            self.get_logger().error(str(error))
            return
        order = {
            "angle_deg": message.angle / DEGREE,
            "side": SIDES.get(Approach(message.approach), 0),
            "overshoot_deg": self._overshoot_deg,
        }
        assert self._agent.stdin is not None
        self._agent.stdin.write(json.dumps(order) + "\n")
        self._agent.stdin.flush()
        self._state = NodeState.of(State.WORKING, Why.ORDERED, message.step, message.attempt)

    def _read(self) -> None:
        """Publish what the agent reports; publishing is safe from any thread."""
        assert self._agent.stdout is not None
        for line in self._agent.stdout:
            reading = json.loads(line)
            if "event" in reading:
                self._state = NodeState(State.READY)
                continue
            for error in reading["errors"]:
                self._complaints += 1
                self.get_logger().error(f"LinuxCNC: {error}")
            self._publish(reading)

    def _publish(self, reading: Mapping[str, Any]) -> None:
        """Publish the joint's angle, and the motor's speed, which includes the correction.

        A table that has an order and has not begun to move is not at rest where it was sent: if it
        stands there by chance, before it arrives again from the other side, that is not published.
        """
        stamp_ns, angle = reading["stamp_ns"], reading["angle_deg"] * DEGREE
        speed = 0.0
        if self._last is not None and stamp_ns > self._last.stamp_ns:
            moved = (reading["motor_deg"] - self._motor_deg) * DEGREE
            speed = moved / ((stamp_ns - self._last.stamp_ns) * NANOSECOND)
        self._last, self._motor_deg = TableSample(stamp_ns, angle, speed), reading["motor_deg"]
        if reading["obeying"] and speed == 0.0:
            return
        self._positions.publish(conversions.table_message(self._last, self._joint))
        if reading["actual_deg"] is not None:
            actual = TableSample(stamp_ns, reading["actual_deg"] * DEGREE, speed)
            self._actual.publish(conversions.table_message(actual, self._joint))

    def _report(self) -> tuple[NodeState, dict[str, Any]]:
        return self._state, {"complaints": self._complaints}


def main() -> None:
    """Run the driver."""
    run_node(LinuxCncDriver)


if __name__ == "__main__":
    main()
