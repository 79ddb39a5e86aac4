"""What the recorder has of a plan before a node takes part in it."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any, Final

from rotcal_msgs.msg import CalibrationPlan
from std_srvs.srv import Trigger

from rotcal_ros.catalogue import last_accepted
from rotcal_ros.catalogue.calibration import RunStep
from rotcal_ros.catalogue.continuation import Recorded
from rotcal_ros.errors import DataError
from rotcal_ros.nodes.cell_node import CellNode
from rotcal_ros.nodes.heartbeat import BEAT_PERIOD_S
from rotcal_ros.nodes.plans import RUN, run_name
from rotcal_ros.observations import Observation

PATIENCE_S: Final = 10.0
"""After so long without an answer a recorder is asked again."""
NO_GOAL_S: Final = 2.0
"""A planner that has no goal for so long did not announce the plan."""
Known = Mapping[RunStep, Observation]


class EarlierObservations:
    """Asks the recorder for the observations of a plan so far, all runs of its session.

    Only where the planner works for this plan: what somebody else announces has none. While it
    does, they are waited for: without them the joined runs could not be solved.
    """

    def __init__(self, node: CellNode) -> None:
        self._node = node
        self._client = node.create_client(Trigger, "recorded_observations")
        self._plan: CalibrationPlan | None = None
        self._kept: Known = {}
        self._wanted: tuple[CalibrationPlan, Callable[[Known], None], float] | None = None
        self._asked: Any = None
        self._asked_s = 0.0
        node.every(BEAT_PERIOD_S, self._look)

    def ask(self, message: CalibrationPlan, kept: Known, take: Callable[[Known], None]) -> None:
        """Call ``take`` with the accepted ones, later.

        ``kept`` is what the node itself has; it counts where the recorder knows no earlier run.
        """
        self._plan, self._kept = message, kept
        self.ask_again(take)

    def ask_again(self, take: Callable[[Known], None]) -> None:
        """Ask once more for the same plan."""
        if self._plan is not None:
            self._wanted = self._plan, take, time.monotonic()
            self._asked = None
            self._look()

    def _look(self) -> None:
        if self._wanted is None:
            return
        message, take, since_s = self._wanted
        now_s = time.monotonic()
        if self._is_foreign(message, now_s - since_s):
            self._answer(take, ())
        elif self._asked is not None and self._asked.done():
            self._answer(take, self._recorded(message))
        elif self._asked is None and self._client.service_is_ready():
            self._asked_s, self._asked = now_s, self._client.call_async(Trigger.Request())
            self._asked.add_done_callback(self._node.health.guarded(lambda _: self._look()))
        elif now_s - max(self._asked_s, since_s) > PATIENCE_S:
            text = "the recorder does not tell what was measured before: waiting for it"
            self._node.get_logger().warning(text, throttle_duration_sec=PATIENCE_S)
            self._asked = None

    def _is_foreign(self, message: CalibrationPlan, waited_s: float) -> bool:
        """Return whether the plan is not that of the planner's goal: there is nothing to ask."""
        health = self._node.health
        if not health.state("planner") or "planner" in health.lost:
            return True
        goals_run = health.values("planner").get(RUN, "")
        return goals_run != run_name(message) if goals_run else waited_s > NO_GOAL_S

    def _recorded(self, message: CalibrationPlan) -> tuple[Observation, ...]:
        """Return what the recorder told, if it is of this plan."""
        try:
            known = Recorded.from_json(self._asked.result().message)
        except DataError as error:
            self._node.get_logger().warning(str(error))
            return ()
        same = (known.plan_id, known.run) == (message.plan_id, message.run)
        return known.observations if same else ()

    def _answer(self, take: Callable[[Known], None], recorded: tuple[Observation, ...]) -> None:
        assert self._plan is not None
        self._wanted = self._asked = None
        known: Known = last_accepted(recorded)
        now = self._plan.run
        take(known if any(run < now for run, _ in known) else {**self._kept, **known})
