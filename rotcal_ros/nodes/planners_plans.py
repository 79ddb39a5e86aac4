"""Plans are taken from the planner alone: what somebody else publishes stops no calibration."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final

from rotcal_msgs.msg import CalibrationPlan

from rotcal_ros.bags import names
from rotcal_ros.nodes.cell_node import CellNode
from rotcal_ros.nodes.concerns import FOREIGN_PLAN, show
from rotcal_ros.nodes.health import BEAT_PERIOD_S
from rotcal_ros.nodes.plans import RUN, run_name
from rotcal_ros.nodes.qos import LATCHED

PATIENCE_S: Final = 2.0
"""So long a plan waits for the planner to say that it is its own."""


class PlannersPlans:
    """Hands over the plans of the planner: while a goal runs it tells in its beat which one.

    While it has no goal every plan is handed over, and without a planner too, after a moment: a
    node that has just been started does not know it yet.
    """

    def __init__(self, node: CellNode, take: Callable[[CalibrationPlan], None]) -> None:
        self._node, self._take = node, take
        self._held: dict[str, tuple[CalibrationPlan, float]] = {}
        node.listen(CalibrationPlan, names.PLAN, self._offer, LATCHED)
        node.every(BEAT_PERIOD_S, self._look)

    def _offer(self, message: CalibrationPlan) -> None:
        self._held.setdefault(run_name(message), (message, time.monotonic()))
        self._look()

    def _look(self) -> None:
        """Hand over what is held as soon as it is the planner's; refuse it when it is not."""
        goals_run = self._node.health.values("planner").get(RUN, "")
        known = bool(self._node.health.state("planner"))
        free = (known and not goals_run) or "planner" in self._node.health.lost
        for name, (message, since_s) in tuple(self._held.items()):
            alone = not known and time.monotonic() - since_s > PATIENCE_S
            if free or alone or goals_run == name:
                del self._held[name]
                show(self._node.health, FOREIGN_PLAN, "")
                self._take(message)
            elif time.monotonic() - since_s > PATIENCE_S:
                del self._held[name]
                self._refuse(message)

    def _refuse(self, message: CalibrationPlan) -> None:
        topic = self._node.resolve_topic_name(names.PLAN)
        infos = self._node.get_publishers_info_by_topic(topic)
        others = sorted({info.node_name for info in infos} - {"planner"})
        text = (
            f"a plan on {topic} is not the planner's and was left alone (plan "
            f"{message.plan_id[:12]!r}, published by {', '.join(others) or 'a node that left'})"
        )
        self._node.get_logger().warning(text)
        show(self._node.health, FOREIGN_PLAN, text)
