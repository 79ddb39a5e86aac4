"""The plan that the planner announces: accepted from the planner alone, then prepared.

Another node may publish a plan on the same topic; that must not stop a running calibration. So the
planner's beat names the run, and a plan of another publisher is reported and ignored.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Final

from rotcal_msgs.msg import CalibrationPlan

from rotcal_ros.bags import names
from rotcal_ros.capture.publishers import RUN, PendingPlans, PlanOwner, unique_run_name
from rotcal_ros.foundation.errors import DataError, PlanError, RotcalError
from rotcal_ros.foundation.untrusted import read_errors_as, read_text
from rotcal_ros.methods import Calibration, prepare
from rotcal_ros.methods.configuration import parse_configuration
from rotcal_ros.methods.continuation import Continuation
from rotcal_ros.methods.method import DEFAULT, find_method
from rotcal_ros.nodes.runtime.beat_values import FOREIGN_PLAN, set_warning
from rotcal_ros.nodes.runtime.cell_node import CellNode
from rotcal_ros.nodes.runtime.health import BEAT_PERIOD_S
from rotcal_ros.nodes.runtime.qos import LATCHED

REFUSED_RUN: Final = "refused_run"
"""Value in a beat: the run whose plan the node could not take, a blank, and the reason."""


def calibration_from_message(message: CalibrationPlan) -> Calibration:
    """Return the calibration that a plan message describes.

    Raises PlanError if the configuration gives another plan here than at the planner, because the
    two run different versions; ConfigurationError if it is wrong.
    """
    configuration = parse_configuration(message.configuration, "the announced plan")
    calibration = prepare(configuration)
    found = (configuration.plan_id, len(calibration.plan.steps))
    if found != (message.plan_id, message.total_steps):
        raise PlanError(
            f"the announced plan has {message.total_steps} steps and the hash {message.plan_id}, "
            f"here it would have {found[1]} and {found[0]}: install the same version everywhere"
        )
    return calibration


def load_method(node: CellNode) -> None:
    """Load the code of the configured method before the first beat: it can take seconds.

    The planner reports a method that cannot be loaded.
    """
    with suppress(RotcalError):
        find_method(str(node.given.get("method") or DEFAULT))


def read_continuation(node: CellNode) -> Continuation | None:
    """Declare ``continuation_file`` and return its content; None if it is not given."""
    path = node.parameter(
        "continuation_file", "", "file that an interrupted calibration has left; empty: none"
    )
    if not path:
        return None
    with read_errors_as(path, DataError, "the continuation "):
        return Continuation.from_json(read_text(Path(path)))


class PlanSubscription:
    """Calls ``take`` with the planner's plans; while a goal runs, the beat names its run.

    Beat and plan come on two topics, in any order: a plan waits until a beat decides about it. An
    unusable plan of another publisher is reported and ignored; it is no error.
    """

    def __init__(self, node: CellNode, take: Callable[[CalibrationPlan], None]) -> None:
        self._node, self._take = node, take
        self._heard = PendingPlans[CalibrationPlan]()
        node.listen(CalibrationPlan, names.PLAN, self._offer, LATCHED)
        node.every(BEAT_PERIOD_S, self._look)

    def _offer(self, message: CalibrationPlan) -> None:
        self._heard.offer(unique_run_name(message), message, time.monotonic())
        self._look()

    def _look(self) -> None:
        """Hand over the plans that are known to be the planner's; report the others."""
        for message, whose in self._heard.with_known_owner(self._goals_run(), time.monotonic()):
            if whose is PlanOwner.OTHER_PLANNER:
                self._ignored(message, "is not the planner's and was ignored")
                continue
            for key in (FOREIGN_PLAN, REFUSED_RUN):
                set_warning(self._node.health, key, None)
            try:
                self._take(message)
            except Exception as error:  # the goal must hear of a fault of this program, too
                if whose is PlanOwner.RUNNING_GOAL:
                    self._refused(message, error)
                    raise
                if not isinstance(error, RotcalError):
                    raise
                self._ignored(message, f"cannot be used: {error}")

    def _goals_run(self) -> str | None:
        """Return the run of the planner's goal; empty: it has none, None: not known."""
        health = self._node.health
        if "planner" in health.lost:
            return ""
        return health.values("planner").get(RUN, "") if "planner" in health.others else None

    def _refused(self, message: CalibrationPlan, error: Exception) -> None:
        """Tell the planner at once, which would wait for this node in vain."""
        health, why = self._node.health, str(error) or type(error).__name__
        set_warning(health, REFUSED_RUN, f"{unique_run_name(message)} {why}", alarm=True)
        health.beat()

    def _ignored(self, message: CalibrationPlan, why: str) -> None:
        topic = self._node.resolve_topic_name(names.PLAN)
        infos = self._node.get_publishers_info_by_topic(topic)
        others = sorted({info.node_name for info in infos} - {"planner"})
        text = (
            f"a plan on {topic} {why} (plan {message.plan_id[:12]!r}, published by "
            f"{', '.join(others) or 'a node that left'})"
        )
        self._node.get_logger().warning(text)
        set_warning(self._node.health, FOREIGN_PLAN, text)
