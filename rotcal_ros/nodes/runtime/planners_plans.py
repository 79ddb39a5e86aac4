"""Plans are taken from the planner alone: another publisher cannot stop a calibration."""

from __future__ import annotations

import time
from collections.abc import Callable

from rotcal_msgs.msg import CalibrationPlan

from rotcal_ros.bags import names
from rotcal_ros.capture.heard import PlansHeard, Whose
from rotcal_ros.foundation.errors import RotcalError
from rotcal_ros.nodes.runtime.cell_node import CellNode
from rotcal_ros.nodes.runtime.diagnostic_warnings import FOREIGN_PLAN, show
from rotcal_ros.nodes.runtime.heartbeat import BEAT_PERIOD_S
from rotcal_ros.nodes.runtime.plans import RUN, run_name
from rotcal_ros.nodes.runtime.qos import LATCHED


class PlannersPlans:
    """Hands over the plans that count: while a goal runs the planner's beat names it.

    A foreign plan that cannot be used is not an error of the node: it is reported and left alone.
    """

    def __init__(self, node: CellNode, take: Callable[[CalibrationPlan], None]) -> None:
        self._node, self._take = node, take
        self._heard = PlansHeard[CalibrationPlan]()
        node.listen(CalibrationPlan, names.PLAN, self._offer, LATCHED)
        node.every(BEAT_PERIOD_S, self._look)

    def _offer(self, message: CalibrationPlan) -> None:
        self._heard.offer(run_name(message), message, time.monotonic())
        self._look()

    def _look(self) -> None:
        """Hand over what counts as soon as that is known; name what does not."""
        for message, whose in self._heard.judged(self._goals_run(), time.monotonic()):
            if whose is Whose.A_STRANGERS:
                self._left_alone(message, "is not the planner's and was left alone")
                continue
            show(self._node.health, FOREIGN_PLAN, None)
            try:
                self._take(message)
            except RotcalError as error:
                if whose is Whose.THE_GOALS:
                    raise
                self._left_alone(message, f"cannot be used: {error}")

    def _goals_run(self) -> str | None:
        """Return the run that the planner works for; empty: it is free, None: it is not known."""
        health = self._node.health
        if "planner" in health.lost:
            return ""
        return health.values("planner").get(RUN, "") if "planner" in health.others else None

    def _left_alone(self, message: CalibrationPlan, why: str) -> None:
        topic = self._node.resolve_topic_name(names.PLAN)
        infos = self._node.get_publishers_info_by_topic(topic)
        others = sorted({info.node_name for info in infos} - {"planner"})
        text = (
            f"a plan on {topic} {why} (plan {message.plan_id[:12]!r}, published by "
            f"{', '.join(others) or 'a node that left'})"
        )
        self._node.get_logger().warning(text)
        show(self._node.health, FOREIGN_PLAN, text)
