"""The simulated cell as a node: obeys orders and publishes streams as the instruments would."""

from __future__ import annotations

import time
from typing import Any, Final

from rclpy.qos import QoSProfile
from rotcal_msgs import msg
from sensor_msgs.msg import FluidPressure, JointState, RelativeHumidity, Temperature

from rotcal_ros.bags import names
from rotcal_ros.bags.settings import TopicSettings
from rotcal_ros.capture import messages
from rotcal_ros.foundation.in_force import NONE, UNKNOWN
from rotcal_ros.foundation.node_state import NodeState, Reason, State, Why
from rotcal_ros.foundation.observations import Command, HumiditySample, PressureSample
from rotcal_ros.foundation.units import NANOSECOND
from rotcal_ros.methods.method import DEFAULT, find_method
from rotcal_ros.methods.simulation.cell import CellOutput
from rotcal_ros.nodes.runtime import conversions
from rotcal_ros.nodes.runtime.cell_node import CellNode
from rotcal_ros.nodes.runtime.emergency_stop import EmergencyStop
from rotcal_ros.nodes.runtime.qos import EVENT, LATCHED, STREAM
from rotcal_ros.nodes.runtime.running import run_node
from rotcal_ros.planning.settings import CellSettings, SafetySettings

PERIOD_S: Final = 0.01
LONGEST_TURN_NS: Final = 20_000_000
"""Longest wall time that one turn makes up for, so that a stall never becomes a burst."""
LONGEST_SIM_TURN_NS: Final = 500_000_000
"""The same for ``/clock``, which may come rarely."""
UNASKED_PERIOD_S: Final = 0.5
ANNOUNCING_PERIOD_S: Final = 0.5
FOLLOWED_DEPTH: Final = 5
"""How many places of an external table may wait."""
AIR: Final = {
    PressureSample: (FluidPressure, names.AIR_PRESSURE),
    HumiditySample: (RelativeHumidity, names.RELATIVE_HUMIDITY),
}


class SimulatedCellNode(CellNode):
    """Advances the simulated machine, ``time_scale`` times as fast as real time while it moves."""

    def __init__(self) -> None:
        super().__init__("simulated_cell")

    def configure(self) -> None:
        """Build the cell."""
        method = find_method(self.parameter("method", DEFAULT, "method of the calibration"))
        settings = self.settings("simulation", method.simulation_settings)
        cell = self.settings("cell", CellSettings)
        self._called = self.settings("topics", TopicSettings).renamed()
        self._settings, self._axis = settings, cell.axis
        self._joint = cell.joint or "table"
        self._scale = settings.time_scale
        self._cell = method.simulated_cell(settings, self.now_ns())
        self._turned_ns, self._set_ahead_ns = self._steady_ns(), 0
        self._order = Reason(Why.NO_ORDER_YET)
        self._stop = EmergencyStop(
            self, self.settings("safety", SafetySettings), "the machine stands still", self._halt
        )
        if self._cell.instrument.streams_lengths:
            self._tracer = self._instrument(msg.TracerLength, names.TRACER_LENGTH, STREAM)
        self._probe_frame = self._cell.instrument.frame
        if settings.table.external:
            # A busy machine costs it places in between, which it fills in: a long queue would
            # make its stamps ever later.
            self.listen(JointState, "table_actual", self._follow, FOLLOWED_DEPTH)
        else:
            self._table = self._instrument(JointState, names.JOINT_STATES, STREAM)
            self.every(PERIOD_S, self._turn)
        controlled = self.given.get("bridge", {}).get("controller_folder")
        if not settings.table.external and not controlled:
            self._table_in_force = self.create_publisher(
                msg.TableInForce, names.TABLE_IN_FORCE, LATCHED
            )
            self.every(ANNOUNCING_PERIOD_S, self._announce)
        self._probe = self._instrument(msg.ProbePoint, names.PROBE_POINT, STREAM)
        self._temperature = self._instrument(Temperature, names.TEMPERATURE, EVENT)
        self._air = {
            kind: self._instrument(message, name, EVENT)
            for kind, (message, name) in AIR.items()
            if settings.air.published
        }
        self.take_orders(self._obey)
        self.every(UNASKED_PERIOD_S, self._tell_position)

    def _instrument(self, kind: type, role: str, qos: QoSProfile) -> Any:
        """Return the publisher of an instrument, under the name that the group topics gives."""
        return self.create_publisher(kind, self._called.get(role, role), qos)

    def _obey(self, command: Command) -> None:
        """Begin both motions of an order together, unless safety has stopped the machine."""
        if self._stop.refuses(command.step):
            return
        self._cell.order_table(command)
        self._cell.order_probe(command)
        self._order = Reason.of(Why.ORDERED, command.step, command.attempt)

    def _halt(self, _why: str) -> None:
        self._cell.stop()

    def _follow(self, message: JointState) -> None:
        """Take the actual angle of a table that another program moves; its clock is ours."""
        self.health.clock.poll()
        stamp_ns = messages.stamp_ns(message.header.stamp) - self._jumped_ns
        self._publish(self._cell.follow_table(stamp_ns, message.position[0]))

    def _turn(self) -> None:
        """Let as much machine time pass as has passed on the wall clock, or on ``/clock``."""
        self.health.clock.poll()
        now_ns = self._steady_ns()
        passed_ns, self._turned_ns = now_ns - self._turned_ns, now_ns
        longest_ns = LONGEST_SIM_TURN_NS if self.health.sim.used else LONGEST_TURN_NS
        lived_ns = min(max(passed_ns, 0), longest_ns)
        if self.health.sim.used:  # stamps are those of /clock, whatever it does
            self._set_ahead_ns += passed_ns - lived_ns
        elapsed = lived_ns * NANOSECOND
        scale = self._scale if self._cell.busy else min(self._scale, 1.0)
        self._publish(self._cell.advance(elapsed * scale))

    def _publish(self, output: CellOutput) -> None:
        """Publish the streams, the probe first: its point begins the wait for the readings.

        The stamps are those of the system clock, with all its jumps.
        """
        if self._jumped_ns:
            output = output.later(self._jumped_ns)
        for probe in output.probe:
            self._probe.publish(conversions.probe_message(probe, self._probe_frame))
        for table in output.table:
            self._table.publish(conversions.table_message(table, self._joint))
        for temperature in output.temperature:
            self._temperature.publish(conversions.temperature_message(temperature))
        for sample in output.air:
            self._air[type(sample)].publish(conversions.air_message(sample))
        for tracer in output.tracer:
            self._tracer.publish(conversions.tracer_message(tracer))

    def _announce(self) -> None:
        """Say whether our control holds a table; only the configuration knows which one."""
        empty = not self._settings.table.compensation.angles_deg
        self._table_in_force.publish(
            conversions.in_force_message(self._axis, NONE if empty else UNKNOWN, self.now_ns())
        )

    def _tell_position(self) -> None:
        """Publish the probe's position without an order, so that a preflight hears the machine."""
        if not self._cell.busy:
            self._publish(CellOutput(probe=(self._cell.unsolicited_point(),)))

    def _steady_ns(self) -> int:
        """Return the time of the machine."""
        return self.now_ns() if self.health.sim.used else time.monotonic_ns()

    @property
    def _jumped_ns(self) -> int:
        """How far the clock of the stamps was set ahead since the machine's began to run."""
        if self.health.sim.used:
            return self._set_ahead_ns
        return self.health.clock.watch.ahead_ns

    def _report(self) -> tuple[NodeState, dict[str, Any]]:
        state = State.MOVING if self._cell.busy else State.IDLE
        return NodeState(state, (self._order,)), {"machine_time_ns": self._cell.now_ns}


def main() -> None:
    """Run the simulated cell."""
    run_node(SimulatedCellNode)


if __name__ == "__main__":
    main()
