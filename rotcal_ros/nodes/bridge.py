"""The bridge to a controller: writes tables as files, and feeds them to it on confirmation."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

from rotcal_msgs.msg import CompensationTable as CompensationTableMsg
from rotcal_msgs.srv import ApplyTable, GetCorrection
from std_srvs.srv import Trigger

from rotcal_ros import messages
from rotcal_ros.compensation.bridge_settings import BridgeSettings
from rotcal_ros.compensation.feed import Applied, Feed
from rotcal_ros.compensation.lookup import Correction
from rotcal_ros.errors import DataError, RotcalError
from rotcal_ros.nodes import conversions
from rotcal_ros.nodes.cell_node import CellNode
from rotcal_ros.nodes.qos import LATCHED
from rotcal_ros.nodes.running import run
from rotcal_ros.observations import Approach
from rotcal_ros.planning.cell_settings import CellSettings
from rotcal_ros.units import ARCSEC

T = TypeVar("T")

ANSWERS_PER_ACTION = 8
"""Accesses to the controller in one action at most; each has its own time limit."""


class BridgeNode(CellNode):
    """Talks to the controller in a thread of its own, so that the node beats meanwhile."""

    def __init__(self) -> None:
        super().__init__("bridge")
        self._settings = self.settings("bridge", BridgeSettings)
        cell = self.settings("cell", CellSettings)
        self._feed = Feed(self._settings, cell.axis, self.now_ns)
        self._correction: Correction | None = None
        self._state = "waiting for a table"
        self._facts: dict[str, Any] = {"controller": self._settings.controller, "axis": cell.axis}
        self._worker = ThreadPoolExecutor(max_workers=1, thread_name_prefix="feed")
        self.listen(CompensationTableMsg, "compensation_table", self._take, LATCHED)
        self.create_service(ApplyTable, "apply", self._apply)
        self.create_service(Trigger, "restore", self._restore)
        self.create_service(GetCorrection, "get_correction", self._look_up)

    def begin_stop(self) -> None:
        """Leave the controller to others; what is being written is finished first."""
        self._worker.shutdown(wait=True, cancel_futures=True)
        self._feed.close()

    def _take(self, message: CompensationTableMsg) -> None:
        """Hold a table against the configuration and write its files; a bad one is refused."""
        self._correction = None
        self._facts = {k: self._facts[k] for k in ("controller", "axis")}
        self._facts |= {"table_hash": message.table_hash, "verdict": message.verdict}
        try:
            table = conversions.compensation_table(message)
            files = self._feed.take(table, messages.stamp_ns(message.header.stamp))
            self._correction = Correction(table)
        except (RotcalError, OSError) as error:
            self._note(f"table refused: {error}")
            return
        assert self._feed.offer is not None
        self._facts |= {
            "files": ", ".join(map(str, files)),
            "residual": self._feed.offer.export.residual.in_words(),
        }
        self._note(f"table {table.table_hash[:12]} written, not applied")

    async def _apply(
        self, request: ApplyTable.Request, response: ApplyTable.Response
    ) -> ApplyTable.Response:
        try:
            done = await self._do(lambda: self._feed.apply(request.table_hash))
        except (RotcalError, OSError) as error:
            response.message = str(error)
            self._note(f"not applied: {error}")
            return response
        response.success = True
        response.files = [str(path) for path in done.files]
        response.backup = str(done.backup)
        response.largest_change = done.largest_change
        response.message = self._done(f"table {request.table_hash[:12]} applied", done)
        return response

    async def _restore(
        self, _request: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        try:
            response.message = self._done("old table restored", await self._do(self._feed.restore))
            response.success = True
        except (RotcalError, OSError) as error:
            response.message = str(error)
            self._note(f"not restored: {error}")
        return response

    def _look_up(
        self, request: GetCorrection.Request, response: GetCorrection.Response
    ) -> GetCorrection.Response:
        try:
            if self._correction is None:
                raise DataError(f"there is no table to look the correction up in: {self._state}")
            approach = Approach(request.approach)
            response.correction = float(self._correction(request.angle, approach))
            response.std = float(self._correction.std(request.angle))
            response.table_hash = self._correction.table.table_hash
            response.success = True
        except (RotcalError, ValueError) as error:
            response.message = str(error)
        return response

    async def _do(self, action: Callable[[], T]) -> T:
        """Return what ``action`` returns, which may wait for the controller."""
        limit_s = ANSWERS_PER_ACTION * self._settings.answer_timeout_s
        return await self.answer_of(self._worker.submit(action), limit_s)

    def _done(self, what: str, done: Applied) -> str:
        self._facts["backup"] = str(done.backup)
        text = (
            f"{what}, read back and equal; largest change {done.largest_change / ARCSEC:.4g} "
            "arcsec; most controllers use it from their next start on"
        )
        self._note(text)
        return text

    def _note(self, state: str) -> None:
        self._state = state
        self.get_logger().info(state)

    def _report(self) -> tuple[str, dict[str, Any]]:
        return self._state, self._facts


def main() -> None:
    """Run the bridge."""
    run(BridgeNode)


if __name__ == "__main__":
    main()
