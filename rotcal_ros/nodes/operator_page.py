"""The operator's page: shows a browser what the cell does, and passes on what a person asks.

It hears what the nodes tell anyway and subscribes to no instrument. Nothing waits for it.
"""

from __future__ import annotations

import time
from collections.abc import Awaitable, Callable
from concurrent.futures import Future
from functools import partial
from typing import Any, Final

from rotcal_ros.nodes import page_sections
from rotcal_ros.nodes.cell_node import CellNode
from rotcal_ros.nodes.health import CALIBRATING
from rotcal_ros.nodes.page_goal import FollowedGoal
from rotcal_ros.nodes.page_offer import WaitingTable
from rotcal_ros.nodes.page_streams import Streams
from rotcal_ros.nodes.page_topics import PageTopics
from rotcal_ros.nodes.running import run
from rotcal_ros.page.app import Answer
from rotcal_ros.page.board import Board, Course
from rotcal_ros.page.headline import Heard, now
from rotcal_ros.page.server import PageServer
from rotcal_ros.page.settings import PageSettings
from rotcal_ros.page.state import Cell, Standing
from rotcal_ros.planning.plan import PAUSED
from rotcal_ros.units import ARCSEC

PERIOD_S: Final = 0.25
LAST_WORD_S: Final = 2.0
"""For the end of a goal, which its client may have heard before us."""
PLANNER: Final = "planner"


class OperatorPage(CellNode):
    """Turns what it hears into the sections of the page."""

    def __init__(self) -> None:
        super().__init__("operator_page")

    def configure(self) -> None:
        """Serve the page."""
        settings = self.settings("page", PageSettings)
        self.board = Board()
        self._streams = Streams()
        self._course = Course()
        self._drawn: float | None = None
        self._beat: object = None
        self._ending_s: float | None = None
        self._goal = FollowedGoal(self, self._begin)
        self._table = WaitingTable(self)
        self._topics = PageTopics(self, self.board)
        if "simulation" in self.given:
            self.board.show(cell=Cell(simulated=True))
        self.every(PERIOD_S, self._look)
        self._server = PageServer(settings, self.board, self)
        self.get_logger().info(f"page: {self._server.address}")

    def resume(self, instruction: str) -> Future[Answer]:
        """Go on after a person's work; called from the server's thread."""
        return self._asked(partial(self._goal.resume, instruction))

    def stop(self) -> Future[Answer]:
        """Cancel the goal; called from the server's thread."""
        return self._asked(self._goal.stop)

    def apply(self, confirmation: str, secret: str) -> Future[Answer]:
        """Confirm a table; called from the server's thread."""
        return self._asked(partial(self._table.apply, confirmation, secret))

    def begin_stop(self) -> None:
        """Wait for the last word of the planner, then tell the viewers the end."""
        self._ending_s = time.monotonic()

    def stopped(self) -> bool:
        """Return whether the viewers know how it ended."""
        assert self._ending_s is not None
        if self._goal.settled or time.monotonic() - self._ending_s > LAST_WORD_S:
            if not self.board.state.ended:
                self._look()
                self._server.close()
            return self._server.closed
        return False

    def _asked(self, work: Callable[[], Awaitable[Answer]]) -> Future[Answer]:
        """Do ``work`` in the executor's turn; the future is for another thread."""
        future: Future[Answer] = Future()

        async def do() -> None:
            try:
                why_not = self.why_not()
                future.set_result(Answer(False, why_not) if why_not else await work())
            except Exception as error:
                self.health.note_error("request of a person", error)
                future.set_result(Answer(False, str(error)))

        self.executor.create_task(do)
        return future

    def _begin(self) -> None:
        """Forget what belongs to an earlier goal."""
        self._course, self._drawn = Course(), None
        self._topics.begin()
        self.board.show(standing=Standing(), recording=None)

    def _look(self) -> None:
        """Bring what the heartbeats tell up to date."""
        health, goal = self.health, self._goal
        capture = health.others.get("capture")
        if capture is not None and capture is not self._beat:
            self._beat = capture
            self._streams.hear(health.values("capture"))
        offer = self._table.offer()
        self.board.show(
            now=now(self._heard(), offer),
            steps=goal.steps(),
            standing=self._standing(),
            lengths=self._streams.lengths(),
            length_course=self._streams.length_course(),
            temperatures=self._streams.temperatures(),
            nodes=page_sections.nodes(health),
            streams=self._streams.streams(),
            # An idle recorder tells no more of the bag that it closed.
            recording=page_sections.recording(health.values("recorder"))
            or self.board.state.recording,
            offer=offer,
        )

    def _heard(self) -> Heard:
        health, goal = self.health, self._goal
        state = health.state(PLANNER)
        activity = goal.feedback.activity if goal.feedback else ""
        outcome = goal.outcome
        return Heard(
            planner=state,
            silent=PLANNER in health.lost,
            calibrating=goal.running or (outcome is None and state.startswith(CALIBRATING)),
            activity=activity.removeprefix(PAUSED),
            instruction=goal.feedback.instruction if goal.feedback else "",
            stopping=goal.stopping,
            ended=outcome is not None,
            canceled=outcome is not None and outcome.canceled,
            verdict=outcome.verdict if outcome else "",
            error=outcome.error_msg if outcome else "",
        )

    def _standing(self) -> Standing:
        """Return U of the curve, and where there is a goal the policy's figure beside it."""
        feedback, curve = self._goal.feedback, self._topics.uncertainty
        if feedback is None:
            return self.board.state.standing
        if curve is not None and curve != self._drawn:
            self._drawn = curve
            self._course.add(feedback.accepted, round(curve / ARCSEC, 4))
        if self._topics.withheld:
            return Standing(withheld=self._topics.withheld)
        rms, goal = feedback.uncertainty_rad, feedback.goal_rad
        return Standing(
            largest_arcsec=None if curve is None else round(curve / ARCSEC, 4),
            rms_arcsec=None if rms is None else round(rms / ARCSEC, 4),
            goal_arcsec=None if goal is None else goal / ARCSEC,
            course=self._course.points,
        )

    def _report(self) -> tuple[str, dict[str, Any]]:
        return self._topics.state or f"serving {self._server.address}", {}


def main() -> None:
    """Run the operator's page."""
    run(OperatorPage)


if __name__ == "__main__":
    main()
