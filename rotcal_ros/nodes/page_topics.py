"""What the page takes from topics: plan, deviations, rejected attempts, orders, warnings."""

from __future__ import annotations

import time
from collections import deque
from typing import Final

from rcl_interfaces.msg import Log
from rclpy.logging import LoggingSeverity
from rclpy.qos import DurabilityPolicy, QoSProfile
from rotcal_msgs.msg import CalibrationPlan, DeviationArray
from rotcal_msgs.msg import Observation as ObservationMsg

from rotcal_ros.bags import names
from rotcal_ros.catalogue import Calibration
from rotcal_ros.errors import RotcalError
from rotcal_ros.messages import stamp_ns
from rotcal_ros.nodes import page_sections
from rotcal_ros.nodes.cell_node import CellNode
from rotcal_ros.nodes.plans import calibration_of
from rotcal_ros.nodes.qos import LATCHED, VIEW
from rotcal_ros.nodes.roll_call import LOADING
from rotcal_ros.observations import Command, place_in_words
from rotcal_ros.page.board import Board
from rotcal_ros.page.state import Cell, LogLine, Pointing, Rejection
from rotcal_ros.units import ARCSEC, DEGREE, NANOSECOND

REJECTIONS: Final = 50
LOG_LINES: Final = 100
ROSOUT: Final = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class PageTopics:
    """Shows on a board what its topics say.

    ``uncertainty`` is the largest expanded one (k = 2) of ECC in the latest solution, rad; None
    where it is not known. ``withheld`` says why it may not be stated, else it is empty.
    ``state`` says that the node is busy, else it is empty.
    """

    def __init__(self, node: CellNode, board: Board) -> None:
        self._node, self._board = node, board
        self._calibration: Calibration | None = None
        self._rejections: deque[Rejection] = deque(maxlen=REJECTIONS)
        self._log: deque[LogLine] = deque(maxlen=LOG_LINES)
        self._visited: dict[float, None] = {}
        self.uncertainty: float | None = None
        self.withheld = self.state = ""
        node.listen(CalibrationPlan, names.PLAN, self._take_plan, LATCHED)
        node.listen(DeviationArray, "deviations", self._take_deviations, LATCHED)
        node.listen(ObservationMsg, names.OBSERVATION, self._take_observation, VIEW)
        node.listen(Log, "/rosout", self._take_log, ROSOUT)
        node.take_orders(self._point)

    def begin(self) -> None:
        """Forget what belongs to an earlier goal."""
        self._rejections.clear()
        self._visited.clear()
        self.uncertainty, self.withheld = None, ""
        self._board.show(rejections=(), deviations=None, pointing=None)

    def _take_plan(self, message: CalibrationPlan) -> None:
        self.state = LOADING
        self._node.health.beat()
        try:
            self._calibration = calibration_of(message)
        except RotcalError as error:
            self._calibration = None
            self._board.show(cell=Cell(), view=None)
            self._node.get_logger().warning(f"the plan cannot be drawn: {error}")
            return
        finally:
            self.state = ""
        self._board.show(
            cell=page_sections.cell(self._calibration, self._node.get_namespace()),
            view=page_sections.plan_view(self._calibration),
        )

    def _take_deviations(self, message: DeviationArray) -> None:
        if self._calibration and message.plan_id == self._calibration.configuration.plan_id:
            identity = self._calibration.configuration.identity
            found = page_sections.deviations(message, identity)
            self._board.show(deviations=found)
            ecc = next((c for c in found.curves if c.name == "ECC"), None)
            known = [u for u in ecc.expanded if u is not None] if ecc else []
            self.uncertainty = max(known) * ARCSEC if known else None
            self.withheld = found.withheld

    def _take_observation(self, message: ObservationMsg) -> None:
        if not message.accepted:
            place = place_in_words(message.table_index, message.target, message.attempt)
            row = Rejection(time.time(), place, message.reason)
            self._rejections.appendleft(row)
            self._board.show(rejections=tuple(self._rejections))

    def _take_log(self, message: Log) -> None:
        if message.level >= LoggingSeverity.WARN:
            error = message.level >= LoggingSeverity.ERROR
            when_s = stamp_ns(message.stamp) * NANOSECOND
            name = message.name.rpartition(".")[2]
            self._log.appendleft(LogLine(when_s, error, name, message.msg))
            self._board.show(log=tuple(self._log))

    def _point(self, order: Command) -> None:
        if self._calibration is None:
            return
        step = self._calibration.plan.steps[order.step]
        place = self._calibration.stand_at(step)
        angle_deg = round(order.table_angle / DEGREE, 3)
        self._visited[angle_deg % 360.0] = None
        self._board.show(
            pointing=Pointing(
                place=step.in_words(order.attempt),
                table_angle_deg=angle_deg,
                target=page_sections.above(order.position),
                stand=None if place is None else page_sections.above(place),
                visited_deg=tuple(self._visited),
            )
        )
