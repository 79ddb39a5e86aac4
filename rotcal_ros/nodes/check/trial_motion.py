"""Makes a small trial motion that a person has confirmed; ``rotcal cell check --move``.

    python -m rotcal_ros.nodes.check.trial_motion --ros-args -p ...

Orders the table by a few degrees and back, as the planner would, and writes what was heard.
"""

from __future__ import annotations

import json
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

import numpy as np
from rotcal_msgs.msg import TableAngle

from rotcal_ros.bags import names
from rotcal_ros.foundation.node_state import NodeState, State, Why
from rotcal_ros.foundation.observations import ProbeSample, TableSample, TracerSample
from rotcal_ros.foundation.units import DEGREE
from rotcal_ros.methods.calibration import prepare_to_measure
from rotcal_ros.methods.configuration import read_configuration
from rotcal_ros.methods.trial_motion import TRIAL_DEG, TrialMotion, beams_of
from rotcal_ros.nodes.capture.instrument_streams import InstrumentStreams
from rotcal_ros.nodes.runtime.cell_graph import CellGraph
from rotcal_ros.nodes.runtime.cell_node import CellNode, wait_for_condition
from rotcal_ros.nodes.runtime.emergency_stop import EmergencyStop
from rotcal_ros.nodes.runtime.qos import EVENT
from rotcal_ros.nodes.runtime.running import run_node
from rotcal_ros.planning.settings import SafetySettings
from rotcal_ros.planning.table_feedback import is_near

START_S: Final = 15.0
BEFORE_S: Final = 1.0
"""Time of listening before the order: gives the noise of the lengths."""
TURN_S: Final = 30.0
AFTER_S: Final = 2.0
"""Time of listening after the table has reported rest."""
_SAME: Final = 0.02 * DEGREE
_LOOK_S: Final = 0.02


class TrialMotionNode(CellNode):
    """Moves once, there and back, and ends."""

    def __init__(self) -> None:
        super().__init__("trial_motion")

    def configure(self) -> None:
        """Subscribe to table, tracer, probe and the emergency stop."""
        file = Path(self.parameter("configuration_file", "", "configuration of the cell"))
        self._output = Path(self.parameter("output", "", "file that the report is written to"))
        self._calibration = prepare_to_measure(read_configuration(file))
        self._orders = self.create_publisher(TableAngle, names.TABLE_ANGLE, EVENT)
        self._stop = EmergencyStop(
            self, self.settings("safety", SafetySettings), "no trial motion is ordered"
        )
        self._table: list[tuple[float, float, float]] = []
        self._lengths: list[tuple[float, float]] = []
        self._probe: tuple[float, float, float] | None = None
        self._done = False
        self._streams = InstrumentStreams(self, self._take)
        self._streams.use(self._calibration.configuration)
        self._begun = False
        self.every(_LOOK_S, self._look)

    def finished(self) -> bool:
        """Return whether the report is written."""
        return self._done

    def _look(self) -> None:
        """Begin in the first turn; later ones only wake the coroutine to check its conditions."""
        if not self._begun:
            self._begun = True
            self.begin(self._try)

    async def _try(self) -> None:
        """Move there and back, and write what was heard on the way there."""
        motion = await self._there()
        if not motion.fault:
            await self._back(motion)
        calibration = self._calibration
        lines = list(
            motion.lines(calibration.configuration.capture, beams_of(calibration, motion))
        )
        self._output.write_text(json.dumps([asdict(line) for line in lines]))
        self._done = True

    async def _there(self) -> TrialMotion:
        ready = await wait_for_condition(self._ready, START_S)
        if ready and self._calibration.place_on_table() is not None:
            await wait_for_condition(
                lambda: bool(self._lengths) and self._probe is not None, START_S
            )
        begun_s = time.monotonic()
        if ready:
            await wait_for_condition(lambda: time.monotonic() > begun_s + BEFORE_S, 2.0 * BEFORE_S)
        absent = None if ready else "the table or its feedback is not there"
        if fault := self._why_not() or absent:
            return TrialMotion(0.0, 0.0, 0.0, np.empty((0, 3)), np.empty((0, 2)), fault=fault)
        start = self._table[-1][1]
        way = self._way(start)
        ordered_s = time.monotonic()
        self._order(start + way)
        await self._rest(start + way, ordered_s)
        return TrialMotion(
            start, way, ordered_s,
            np.array(self._table), np.array(self._lengths).reshape(-1, 2), self._probe,
            f"emergency stop: {self._stop.latched}" if self._stop.latched else "",
        )  # fmt: skip

    async def _back(self, motion: TrialMotion) -> None:
        """Go back to where the table stood; after a stop it stays where it is."""
        if not self._why_not():
            ordered_s = time.monotonic()
            self._order(motion.start)
            await self._rest(motion.start, ordered_s)

    async def _rest(self, goal: float, ordered_s: float) -> None:
        """Wait until the table reports rest, at its goal or anywhere else, and a little longer."""
        since_s = ordered_s

        def rests() -> bool:
            nonlocal since_s
            now_s, (heard_s, angle, velocity) = time.monotonic(), self._table[-1]
            recent = [row for row in self._table if row[0] > heard_s - 0.5]
            resting = np.ptp([row[1] for row in recent]) < _SAME and not abs(velocity) > _SAME
            patience_s = AFTER_S if is_near(angle, goal, _SAME) else 2.0 * AFTER_S
            if not resting:
                since_s = now_s
            return bool(self._stop.latched) or now_s > since_s + patience_s

        await wait_for_condition(rests, TURN_S)

    def _way(self, start: float) -> float:
        """Return how far to turn: away from the nearer end of the travel, if one is stated."""
        upper = self._calibration.configuration.table_adapter.upper_deg
        way = TRIAL_DEG * DEGREE
        return way if upper is None or start + way <= upper * DEGREE else -way

    def _ready(self) -> bool:
        """Return whether the table is heard and a machine will obey, or nothing can be done."""
        obeys = CellGraph(self).machines(names.TABLE_ANGLE)
        return self._why_not() is not None or bool(self._table and set(obeys) - {self.get_name()})

    def _why_not(self) -> str | None:
        """Return why nothing may be ordered; None: it may."""
        if self.health.is_calibrating():
            return "a calibration is running: its planner alone gives orders"
        if reason := self._stop.why or self._stop.check_stop():
            return f"emergency stop: {reason}"
        return None

    def _order(self, angle: float) -> None:
        message = TableAngle(angle=angle, approach=TableAngle.APPROACH_UNKNOWN)
        message.header.stamp = self.get_clock().now().to_msg()
        self._orders.publish(message)

    def _take(self, record: Any) -> None:
        now_s = time.monotonic()
        match record:
            case TableSample():
                self._table.append((now_s, record.angle, record.velocity))
            case TracerSample(status=status) if status == status.OK:
                self._lengths.append((now_s, record.length))
            case ProbeSample():
                self._probe = record.position

    def _report(self) -> tuple[NodeState, dict[str, Any]]:
        return NodeState.of(State.WORKING, Why.TRIAL_MOTION), {}


def main() -> None:
    """Run the trial."""
    run_node(TrialMotionNode)


if __name__ == "__main__":
    main()
