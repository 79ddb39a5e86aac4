"""Reports the state of a cell's tables: one latched status for each axis of the history.

It outlives calibrations, needs no other node, and reads the history in a thread of its own.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, Final

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from rotcal_history.database import ParkHistory
from rotcal_history.outlook import Outlook, all_outlooks
from rotcal_history.settings import HistorySettings
from rotcal_ros.foundation.node_state import NodeState, State
from rotcal_ros.nodes.runtime.cell_node import CellNode
from rotcal_ros.nodes.runtime.conversions import make_header
from rotcal_ros.nodes.runtime.qos import LATCHED
from rotcal_ros.nodes.runtime.running import run_node

TOPIC: Final = "calibration_status"


def axis_statuses(outlooks: Sequence[Outlook], now_ns: int) -> list[DiagnosticStatus]:
    """Return a status for each axis: ERROR to look at, WARN due, else OK."""
    found = []
    for view in outlooks:
        late = DiagnosticStatus.WARN if view.due_ns <= now_ns else DiagnosticStatus.OK
        level = DiagnosticStatus.ERROR if view.urgent else late
        names = ("axis", "verdict", "verdict_line", "due", "due_ns", "last")
        values = {name: str(getattr(view, name)) for name in names}
        values["table_in_force"] = view.measured_on
        status = DiagnosticStatus(level=level, name=view.title, message=view.reason)
        status.hardware_id = view.serial
        status.values = [KeyValue(key=key, value=value) for key, value in values.items()]
        found.append(status)
    return found


def machine_outlooks(settings: HistorySettings, serial: str) -> list[Outlook]:
    """Return the outlooks of all axes of a machine; of all machines without a serial number."""
    with ParkHistory(settings.database, must_exist=True) as history:
        return [view for view in all_outlooks(history, settings) if serial in ("", view.serial)]


class CalibrationStatus(CellNode):
    """Publishes what changes, and looks every ``history.period_s``."""

    def __init__(self) -> None:
        super().__init__(TOPIC)

    def configure(self) -> None:
        """Look for the first time."""
        self._settings = self.settings("history", HistorySettings)
        self._serial = str(self.parameter("serial", "", "serial number; empty: all tables"))
        self._publisher = self.create_publisher(DiagnosticArray, TOPIC, LATCHED)
        self._worker = ThreadPoolExecutor(1, "history")
        self._asked: Future[list[Outlook]] | None = None
        self._next_s, self._published = 0.0, list[DiagnosticStatus]()
        self._state = NodeState(State.LOADING)
        self.every(0.5, self._look)

    def _look(self) -> None:
        if self._asked is None and time.monotonic() >= self._next_s:
            self._asked = self._worker.submit(machine_outlooks, self._settings, self._serial)
            self._next_s = time.monotonic() + self._settings.period_s
        elif self._asked is not None and self._asked.done():
            asked, self._asked = self._asked, None
            self._state = NodeState(State.FAILED)
            new = axis_statuses(asked.result(), self.now_ns())
            self._state = NodeState(State.READY)
            if new != self._published:
                self._published = new
                self.get_logger().info(f"reported: {len(new)} tables")
                self._publisher.publish(
                    DiagnosticArray(header=make_header(self.now_ns()), status=new)
                )

    def _report(self) -> tuple[NodeState, dict[str, Any]]:
        return self._state, {"tables": str(len(self._published))}


def main() -> None:
    """Run the node."""
    run_node(CalibrationStatus)


if __name__ == "__main__":
    main()
