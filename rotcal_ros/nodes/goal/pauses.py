"""The pause of the running goal: as data on ``pause``, ended by the service ``resume``."""

from __future__ import annotations

from collections.abc import Callable
from math import nan
from typing import Final

from rotcal_msgs.msg import Pause as PauseMsg
from std_srvs.srv import Trigger

from rotcal_ros.bags import names
from rotcal_ros.foundation.errors import RotcalError
from rotcal_ros.foundation.node_state import STOPS, Reason
from rotcal_ros.nodes.runtime import conversions
from rotcal_ros.nodes.runtime.cell_node import CellNode
from rotcal_ros.nodes.runtime.qos import LATCHED
from rotcal_ros.planning.plan import MACHINE_FRAME, Move

RESUME: Final = "resume"
UNKNOWN_PLACE: Final = (nan, nan, nan)


class Pauses:
    """What the goal waits for; ``waiting`` is True until somebody has called ``resume``.

    ``require_free`` raises RotcalError while it cannot go on; ``busy`` says what the planner is
    doing.
    """

    def __init__(
        self, node: CellNode, require_free: Callable[[], None], busy: Callable[[], str]
    ) -> None:
        self._node, self._require_free, self._busy = node, require_free, busy
        self._publisher = node.create_publisher(PauseMsg, names.PAUSE, LATCHED)
        node.offer(Trigger, RESUME, self._resume)
        self._latest = PauseMsg()
        self._stops = 0
        self.waiting = False

    def begin(self, plan_id: str, run: int, step: int, stops: int) -> None:
        """Wait from now on, before ``step`` of a run of a plan, after so many stops."""
        self._stops = stops
        self._latest = PauseMsg(plan_id=plan_id, run=run, step=step, waiting=True)
        self.waiting = True

    def show(self, asked: Reason, move: Move | None = None) -> None:
        """Publish what is waited for, unless that has not changed."""
        latest, instruction = self._latest, asked.instruction
        if latest.instruction == instruction:
            return
        place = move or Move("", 0)
        latest.kind = PauseMsg.KIND_MOVE if move else PauseMsg.KIND_WORK
        latest.kind = PauseMsg.KIND_STOP if asked.code in STOPS else latest.kind
        latest.what, latest.station = place.what, place.station
        latest.position = place.position or UNKNOWN_PLACE
        latest.instruction = instruction
        latest.resume = self._node.resolve_service_name(RESUME)
        self._publish(place.frame)

    def stop_between(self, stops: int) -> bool:
        """Return, once, that a stop came after the pause began: its caller may not know of it."""
        before, self._stops = self._stops, stops
        return stops > before

    def end(self) -> None:
        """Publish that nothing is waited for any more."""
        self.waiting = False
        if self._latest.waiting:
            latest = self._latest
            self._latest = PauseMsg(plan_id=latest.plan_id, run=latest.run, step=latest.step)
            self._latest.position = UNKNOWN_PLACE
            self._publish(MACHINE_FRAME)

    def _publish(self, frame: str) -> None:
        self._latest.header = conversions.header(self._node.now_ns(), frame)
        self._publisher.publish(self._latest)

    def _resume(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Go on after the work is done, unless something keeps the cell from it."""
        if not self.waiting:
            response.message = f"nothing waits for resume: the planner is {self._busy()}"
            return response
        try:
            self._require_free()
        except RotcalError as error:
            response.message = f"not resumed: {error}"
        else:
            self.waiting, response.success = False, True
        return response
