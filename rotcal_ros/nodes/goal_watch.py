"""Watching over a running goal: it waits for what it needs and ends when it cannot go on."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Final

from rotcal_msgs.action import Calibrate

from rotcal_ros.bags import names
from rotcal_ros.nodes.cell_links import CellLinks
from rotcal_ros.nodes.cell_node import until
from rotcal_ros.nodes.clock_news import jumps_told
from rotcal_ros.nodes.health import RECORDING_FAILED
from rotcal_ros.nodes.progress import Progress
from rotcal_ros.planning.planner_settings import PlannerSettings
from rotcal_ros.planning.policy.names import AS_LISTED

SILENCE: Final = "silent_s."
"""How the values of the capture begin that tell the silence of a stream in seconds."""

ASTRAY_TIMEOUT_S: Final = 5.0
"""So long capture and solver may be without the plan of the goal."""
Codes = Calibrate.Result
"""The message that holds the error codes of the action."""


class GoalError(Exception):
    """The goal cannot go on; ``code`` is an error code of the action."""

    def __init__(self, code: int, text: str) -> None:
        super().__init__(text)
        self.code = code


@dataclass
class GoalWatch:
    """One goal's view of the cell.

    ``show`` is called with every progress, ``canceled`` tells of a cancel request. ``stopping``
    says why the planner gives the goal up. ``nodes`` must beat; ``recording`` says that a bag is
    open, from then on the recorder and the streams are watched too; ``run`` is what capture and
    solver have to work for, empty before they do.
    """

    settings: PlannerSettings
    links: CellLinks
    progress: Progress
    show: Callable[[Progress], None]
    canceled: Callable[[], bool]
    stopping: str = ""
    nodes: set[str] = field(default_factory=set)
    recording: bool = False
    run: str = ""
    _astray_s: float | None = None
    _stream_beat: object = None
    _bag_open: bool = False

    def tell(self, activity: str) -> None:
        """Show what is done now."""
        self.progress.activity = activity
        self.show(self.progress)

    def how_to_go_on(self, code: int) -> str:
        """Return how to go on after an error of the goal, for those that end it half-way."""
        if code not in (Codes.NODE_LOST, Codes.CANCELED):
            return ""
        if self.settings.policy != AS_LISTED:
            return "; continue with rotcal run --resume"
        new_zero = "rotcal run --resume where an instrument was started anew, else with "
        how = new_zero if code == Codes.NODE_LOST else ""
        return f"; continue with {how}start_index {self.progress.step}"

    async def wait(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        """Wait until ``condition``; False after the time-out, GoalError when all is in vain."""
        return await until(condition, timeout_s, self._check)

    def clock_jumps(self) -> int:
        """Return how often a clock of the cell has jumped, as far as this node knows by now."""
        health = self.links.health
        health.clock.look()
        return health.clock.watch.count + jumps_told(map(health.values, health.others))

    async def have(self, missing: Callable[[], list[str]], code: int) -> None:
        """Wait until nothing is missing; after the preflight time raise what still is."""
        if not await self.wait(lambda: not missing(), self.settings.preflight_timeout_s):
            raise GoalError(code, "; ".join(missing()) or "preflight timed out")

    async def call(self, client: Any, request: Any, timeout_s: float) -> Any:
        """Return the answer of a service."""
        future = client.call_async(request)
        if not await self.wait(future.done, timeout_s):
            raise GoalError(
                Codes.NODE_LOST, f"{client.srv_name} gave no answer in {timeout_s:g} s"
            )
        return future.result()

    def _check(self) -> None:
        """Raise when the goal must end: cancel, shutdown, a node or an instrument lost."""
        place = f"at step {self.progress.step} of {self.progress.total}"
        if self.stopping:
            raise GoalError(Codes.CANCELED, f"{self.stopping} {place}")
        if self.canceled():
            raise GoalError(Codes.CANCELED, f"canceled {place}")
        if missing := self.links.health.missing(self.nodes):
            lost = [name for name in missing if name in self.links.health.lost]
            how = "fell silent" if lost else "was ended"
            words = f" ({self.links.health.last_words(lost[0])})" if lost else ""
            raise GoalError(Codes.NODE_LOST, f"node {', '.join(missing)} {how} {place}{words}")
        if idle := self.links.idle_nodes():
            raise GoalError(Codes.NODE_LOST, f"{idle[0]} ({place})")
        if self.recording:
            state = self.links.health.state("recorder")
            if state.startswith(RECORDING_FAILED):
                raise GoalError(Codes.RECORDER_FAILED, f"{state}, {place}")
            self._bag_open |= state == "recording"
            if self._bag_open and state == "idle":
                raise GoalError(
                    Codes.RECORDER_FAILED,
                    f"the recorder has closed the bag {place}: node planner stood still too long",
                )
            self._check_streams(place)
            self._check_plan(place)

    def _check_plan(self, place: str) -> None:
        """Raise when capture or solver have been at work for another plan for long."""
        astray = self.links.missing_plan(self.run) if self.run else []
        if not astray:
            self._astray_s = None
            return
        self._astray_s = self._astray_s or time.monotonic()
        if time.monotonic() - self._astray_s > ASTRAY_TIMEOUT_S:
            topic = self.links.resolve(names.PLAN)
            publishers = ", ".join(self.links.publishers(topic)) or "nobody"
            raise GoalError(
                Codes.NODE_LOST,
                f"{'; '.join(astray)} any more {place}: does somebody else publish on {topic} "
                f"(its publishers: {publishers}), or was it started anew?",
            )

    def _check_streams(self, place: str) -> None:
        """Raise when the capture tells of an instrument that fell silent after it had spoken."""
        beat = self.links.health.others.get("capture")
        if beat is self._stream_beat or not self.links.health.sim.is_settled():
            return
        self._stream_beat = beat
        for key, value in self.links.health.values("capture").items():
            if key.startswith(SILENCE) and float(value) > self.settings.stream_timeout_s:
                topic = self.links.instrument(key.removeprefix(SILENCE))
                publishers = ", ".join(self.links.publishers(topic)) or "gone"
                raise GoalError(
                    Codes.NODE_LOST,
                    f"{topic} (node {publishers}) has been silent for {value} s {place}",
                )
