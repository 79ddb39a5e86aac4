"""The bridge to a controller: writes tables as files, and feeds them to it on confirmation."""

from __future__ import annotations

from typing import Any

from rotcal_msgs.msg import CompensationTable as CompensationTableMsg
from rotcal_msgs.srv import GetCorrection

from rotcal_ros import messages
from rotcal_ros.compensation.bridge_settings import BridgeSettings
from rotcal_ros.compensation.export import standing
from rotcal_ros.compensation.feed import Feed
from rotcal_ros.compensation.lookup import Correction
from rotcal_ros.errors import DataError, RotcalError
from rotcal_ros.identity import Identity
from rotcal_ros.middleware import LOCALHOST
from rotcal_ros.nodes import conversions
from rotcal_ros.nodes.cell_node import CellNode
from rotcal_ros.nodes.controller_access import ControllerAccess
from rotcal_ros.nodes.qos import LATCHED
from rotcal_ros.nodes.running import run
from rotcal_ros.observations import Approach
from rotcal_ros.planning.cell_settings import CellSettings


class BridgeNode(CellNode):
    """Takes tables and looks corrections up; the access to the controller is a part of its own."""

    def __init__(self) -> None:
        super().__init__("bridge")

    def configure(self) -> None:
        """Open the controller."""
        settings = self.settings("bridge", BridgeSettings)
        cell = self.settings("cell", CellSettings)
        simulated = "simulation" in self.given
        self._feed = Feed(
            settings,
            cell.axis,
            self.now_ns,
            simulated=simulated,
            serial=self.settings("identity", Identity).serial,
            stated=cell.table_in_force,
        )
        self._correction: Correction | None = None
        self._state = "waiting for a table"
        self._own: dict[str, Any] = {"controller": settings.controller, "axis": cell.axis}
        self._facts: dict[str, Any] = {}
        self.listen(CompensationTableMsg, "compensation_table", self._take, LATCHED)
        self.offer(GetCorrection, "get_correction", self._look_up)
        self._access = ControllerAccess(self, self._feed, self._note)

    def begin_stop(self) -> None:
        """Leave the controller to others; what is being written is finished first."""
        self._access.close()

    def _take(self, message: CompensationTableMsg) -> None:
        """Hold a table against the configuration and write its files; a bad one is refused."""
        self._correction = None
        self._feed.forget()
        self._facts = {"table_hash": message.table_hash, "verdict": message.verdict}
        try:
            table = conversions.compensation_table(message)
            files = self._feed.take(table, messages.stamp_ns(message.header.stamp))
        except (RotcalError, OSError) as error:
            self._note(f"table refused: {error}")
            return
        offer = self._feed.offer
        assert offer is not None
        self._correction = Correction(offer.table)
        self._facts |= {
            "confirmation": offer.confirmation,
            "files": ", ".join(map(str, files)),
            "in_force": standing(offer.table),
            "residual": offer.export.residual.in_words(),
        }
        if never := self._feed.never():
            self._facts["never"] = never
        self._note(f"table {table.table_hash[:12]} written, not applied")

    def _look_up(
        self, request: GetCorrection.Request, response: GetCorrection.Response
    ) -> GetCorrection.Response:
        try:
            if self._correction is None:
                raise DataError(f"there is no table to look the correction up in: {self._state}")
            approach = Approach(request.approach)
            response.correction = float(self._correction(request.angle, approach))
            response.std = float(self._correction.std(request.angle, approach))
            response.table_hash = self._correction.table.table_hash
            response.success = True
        except (RotcalError, ValueError) as error:
            response.message = str(error)
        return response

    def _note(self, state: str) -> None:
        self._state = state
        self.get_logger().info(state)

    def _report(self) -> tuple[str, dict[str, Any]]:
        return self._state, {**self._own, **self._facts, **self._access.facts}


def main() -> None:
    """Run the bridge, reachable from this machine alone unless the user has settled the range."""
    run(BridgeNode, LOCALHOST)


if __name__ == "__main__":
    main()
