"""Watches over a running goal: what it needs, what it waits for, and when it must end."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from typing import Any, Final

from rotcal_msgs.action import Calibrate

from rotcal_ros.bags import names
from rotcal_ros.capture.publishers import Offers, restarted_nodes
from rotcal_ros.foundation import machine_load
from rotcal_ros.foundation.machine_load import AwakeClock, WaitBudget, load_scaled_timeout
from rotcal_ros.foundation.node_names import PREFLIGHT_NODES
from rotcal_ros.foundation.node_state import Reason, State, Why
from rotcal_ros.foundation.session_folder import SessionFolder, resume_command
from rotcal_ros.nodes.planner.cell_links import CellLinks, GoalPauses
from rotcal_ros.nodes.planner.progress import GoalProgress
from rotcal_ros.nodes.runtime.beat_values import (
    HOPELESS,
    PREFLIGHT_WAITS,
    SILENT,
    SLOW,
    set_warning,
)
from rotcal_ros.nodes.runtime.cell_graph import ORDERS
from rotcal_ros.nodes.runtime.cell_node import wait_for_condition
from rotcal_ros.nodes.runtime.clocks import reported_jump_count
from rotcal_ros.nodes.runtime.emergency_stop import EmergencyStop
from rotcal_ros.nodes.runtime.health import Health
from rotcal_ros.nodes.runtime.liveness import OverloadMonitor
from rotcal_ros.planning.choices import AS_LISTED
from rotcal_ros.planning.plan import Pause
from rotcal_ros.planning.settings import PlannerSettings

ASTRAY_TIMEOUT_S: Final = 5.0
"""How long capture and solver may work on another plan than the goal's."""
FOUND_S: Final = 5.0
"""Time for two ends to discover each other: lost discovery packets are sent again after 3 s."""
SETTLED_S: Final = 0.5
"""If no new publisher is discovered for this long, the known ones count as all."""
TOLD_S: Final = 3.0
"""What a preflight has lacked for this long is told, on a busy machine too."""
LOOK_S: Final = 0.1
"""Looking at the graph takes longer than a turn of the executor."""
HOPELESS_S: Final = 0.5
"""The capture must report HOPELESS for this long: late readings may look so for a moment."""
SOLVER: Final = "solver"
Codes = Calibrate.Result
"""The message that holds the error codes of the action."""


class GoalError(Exception):
    """The goal cannot go on; ``code`` is an error code of the action.

    ``in_another_run``: it can go on in another run, once the nodes of the suite are back.
    """

    def __init__(self, code: int, text: str, *, in_another_run: bool = False) -> None:
        super().__init__(text)
        self.code = code
        self.in_another_run = in_another_run


def _rarely(condition: Callable[[], bool]) -> Callable[[], bool]:
    """Return a ``condition`` that is looked at every LOOK_S, however often it is asked for."""
    last_s, met = -math.inf, False

    def seen() -> bool:
        nonlocal last_s, met
        if (now_s := time.monotonic()) - last_s >= LOOK_S:
            last_s, met = now_s, condition()
        return met

    return seen


class MissingReport:
    """Tells people what ``missing`` has named for TOLD_S, while it is waited for."""

    def __init__(
        self, links: CellLinks, missing: Callable[[], list[str]], patience_s: float
    ) -> None:
        self._links, self._missing, self._patience_s = links, missing, patience_s
        self._clock, self._since_s = AwakeClock(time.monotonic), dict[str, float]()
        self._reported: list[str] = []

    def nothing(self) -> bool:
        """Return whether nothing is missing; tell what has been missing for long."""
        now_s, texts = self._clock.now_s(), self._missing()
        self._since_s = {text: self._since_s.get(text, now_s) for text in texts}
        lasting = [text for text, since_s in self._since_s.items() if now_s - since_s >= TOLD_S]
        if set(lasting) - set(self._reported):
            self._reported = lasting
            limit = f"the preflight waits up to {load_scaled_timeout(self._patience_s):.0f} s"
            self._links.warn(PREFLIGHT_WAITS, [f"{limit}: {'; '.join(lasting)}"])
        return not texts

    def __enter__(self) -> MissingReport:
        return self

    def __exit__(self, *_: object) -> None:
        """Tell no more: all is there, or the goal ends with what is missing."""
        self._links.warn(PREFLIGHT_WAITS, ())


class RequiredNodes:
    """The ``nodes`` that must be there while a goal runs.

    The solver may be away for ``restart_wait_s``: it gets from the recorder what it missed. A
    restart of any other node breaks the run off, however quick it was.
    """

    def __init__(self, health: Health, restart_wait_s: float) -> None:
        self.nodes: set[str] = set()
        self.restart_wait_s = restart_wait_s
        self._health = health
        self._processes: dict[str, str | None] = {}
        self._away: WaitBudget | None = None

    def begin_run(self) -> None:
        """Make the present nodes those of the run."""
        nodes = self.nodes.union(PREFLIGHT_NODES)
        self._processes = {name: self._health.process(name) for name in nodes}

    def end_run(self) -> None:
        """Let the nodes of the suite come and go: the next preflight looks for them."""
        self.nodes -= set(PREFLIGHT_NODES)
        for name in PREFLIGHT_NODES:
            self._processes.pop(name, None)

    def newcomers(self) -> list[str]:
        """Return which nodes are no longer the processes they were when the run began."""
        began = self._processes.items()
        return [name for name, process in began if self._health.process(name) != process]

    def slow(self) -> dict[str, float]:
        """Return which required nodes are slow: name -> seconds without a sign that it answers."""
        return {name: s for name, s in self._health.slow.items() if name in self.nodes}

    def is_another(self, name: str) -> Callable[[], bool]:
        """Return a function that says whether a node has become another process since now."""
        now = self._health.process(name)
        return lambda: self._health.process(name) != now

    def check(self, place: str) -> None:
        """Raise GoalError if the run cannot go on with the nodes that are here."""
        missing = self._health.missing(self.nodes)
        anew = sorted({*self.newcomers()} - {SOLVER, *missing})
        if SOLVER not in missing:
            self._away = None
        elif missing == [SOLVER] and not anew and self._may_be_away():
            return
        if missing or anew:
            raise GoalError(
                Codes.NODE_LOST,
                f"{'; '.join(self._in_words(missing, anew))} {place}{self._last_words(missing)}",
                in_another_run={*missing, *anew} <= set(PREFLIGHT_NODES),
            )

    def _may_be_away(self) -> bool:
        self._away = self._away or WaitBudget(self.restart_wait_s)
        return self.restart_wait_s > 0.0 and not self._away.is_over()

    def _in_words(self, missing: list[str], anew: list[str]) -> list[str]:
        lost = any(name in self._health.lost for name in missing)
        how = "is lost" if lost else "was ended"
        words = [f"node {', '.join(missing)} {how}"] if missing else []
        return [*words, *(f"node {name} was restarted" for name in anew)]

    def _last_words(self, missing: list[str]) -> str:
        lost = [name for name in missing if name in self._health.lost]
        return f" ({self._health.last_words(lost[0])})" if lost else ""


class StepInterruptedError(Exception):
    """An emergency stop has broken off the present step; the goal waits."""


@dataclass
class GoalWatch:
    """What one goal knows of the cell, and when it has to end."""

    settings: PlannerSettings
    links: CellLinks
    stop: EmergencyStop
    pauses: GoalPauses
    progress: GoalProgress
    show: Callable[[GoalProgress], None]
    """Is called whenever the progress changes."""
    canceled: Callable[[], bool]
    """Returns whether the client has asked to cancel the goal."""
    required: RequiredNodes
    patience_s: float
    """How long a preflight waits for what is missing."""
    stopping: str | None = None
    """Why the planner gives up the goal; None: it does not."""
    preflight: bool = True
    """Nothing has moved yet: an emergency stop ends the goal, later the goal waits."""
    recording: bool = False
    """A bag is open: the recorder and the streams are watched too."""
    run: str | None = None
    """The run that capture and solver have to work for; None: none yet."""
    owed: tuple[Pause, str | None, int] | None = None
    """An unfinished pause, its work that is still to be done, and the first step to check."""
    slow: dict[str, float] = field(default_factory=dict)
    """Nodes and instruments that are waited for: name -> seconds without a sign of life."""
    instruments: Collection[str] = ()
    heard: Offers = field(default_factory=dict)
    """The publishers of the instruments' topics when the run began."""
    _astray: WaitBudget | None = None
    _hopeless: WaitBudget | None = None
    _overload: OverloadMonitor = field(default_factory=OverloadMonitor)
    _stream_beat: object = None
    _silent: dict[str, float] = field(default_factory=dict)
    _interrupted: Reason | None = None
    _bag_open: bool = False

    def tell(self, code: Why, *arguments: object) -> None:
        """Show what is being done now."""
        self.tell_again(Reason.of(code, *arguments))

    def tell_again(self, doing: Reason) -> None:
        """Show again what is being done now."""
        self.progress.doing = doing
        self.show(self.progress)

    def resume_instruction(self, code: int, folder: SessionFolder | None) -> str:
        """Return how to continue after an error that ends the goal half-way."""
        if code not in (
            Codes.NODE_LOST, Codes.RECORDER_FAILED, Codes.CANCELED, Codes.TOPIC_MISSING,
        ):  # fmt: skip
            return ""
        if self.settings.policy != AS_LISTED:
            return f"; continue with: {resume_command(folder.path)}" if folder else ""
        again = "restart what is lost, then " if code == Codes.NODE_LOST else ""
        step = max(0, min(self.progress.step, self.progress.total - 1))
        return f"; {again}continue with start_index {step}"

    def begin_run(self, run: str) -> None:
        """Watch a run from now on: capture and solver have its plan, and the bag is open."""
        self.run = run
        self.required.begin_run()

    def end_run(self, patience_s: float) -> None:
        """Stop watching the run; a preflight looks for the nodes of the next one."""
        self.run, self.recording, self._bag_open, self._astray = None, False, False, None
        self._silent, self.heard = {}, {}
        self.patience_s = patience_s
        self.required.end_run()

    async def wait(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        """Wait until ``condition``; False after the time-out, GoalError when the goal must end.

        The time does not run while a node is slow.
        """
        return await wait_for_condition(condition, timeout_s, self._check, self._is_slow)

    async def wait_for_machine(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        """Wait like :meth:`wait` for what was ordered; raises StepInterruptedError."""
        arrived = await wait_for_condition(
            condition, timeout_s, self._check_machine, self._is_slow
        )
        self.wait_out_stop()
        return arrived

    async def wait_for_slow_nodes(self) -> None:
        """Wait until no node is slow; called between orders, when nothing moves."""
        self._check()
        await self.wait(lambda: not self.slow, math.inf)

    def _is_slow(self) -> bool:
        return bool(self.slow)

    def wait_out_stop(self) -> None:
        """Raise StepInterruptedError from an emergency stop until a person has resumed."""
        if why := self.stop.check_stop():
            raise StepInterruptedError(f"emergency stop: {why}")

    def clock_jumps(self) -> int:
        """Return how often a clock of the cell has jumped, as far as this node knows."""
        health = self.links.health
        health.clock.poll()
        return health.clock.watch.count + reported_jump_count(map(health.values, health.others))

    async def have(
        self,
        missing: Callable[[], list[str]],
        code: int,
        in_vain: Callable[[], list[str]] = lambda: [],
    ) -> None:
        """Wait until nothing is missing; after the time of a preflight GoalError names what is.

        It does so at once when ``in_vain`` says why waiting would be in vain. What is missing is
        told long before.
        """
        with MissingReport(self.links, missing, self.patience_s) as lacking:
            came = await self.wait(
                _rarely(lambda: lacking.nothing() or bool(in_vain())), self.patience_s
            )
        if why := in_vain() or ([] if came else missing() or ["preflight timed out"]):
            raise GoalError(code, "; ".join(why))

    async def wait_until_stable(self, look: Callable[[], object]) -> None:
        """Wait until what ``look`` returns has not changed for SETTLED_S, at most patience_s."""
        clock, known = AwakeClock(time.monotonic), look()
        since_s = clock.now_s()

        def settled() -> bool:
            nonlocal known, since_s
            now, now_s = look(), clock.now_s()
            if now != known:
                known, since_s = now, now_s
            return now_s - since_s >= SETTLED_S

        await self.wait(_rarely(settled), self.patience_s)

    async def wait_until_found(self, missing: Callable[[], list[str]]) -> bool:
        """Return whether everything was found within FOUND_S; if not, make new publishers.

        Sometimes the middleware never connects two ends that it knows, but does connect new ones.
        """
        with MissingReport(self.links, missing, self.patience_s) as lacking:
            if await self.wait(_rarely(lacking.nothing), min(FOUND_S, self.patience_s)):
                return True
        self.links.publish_anew()
        return False

    async def call(
        self,
        client: Any,
        request: Any,
        timeout_s: float,
        in_vain: Callable[[], bool] = lambda: False,
    ) -> Any:
        """Return the answer of a service; None once ``in_vain`` says that none will come."""
        future = client.call_async(request)
        if not await self.wait(lambda: future.done() or in_vain(), timeout_s):
            text = f"{client.srv_name} gave no answer in {timeout_s:g} s"
            raise GoalError(Codes.NODE_LOST, text)
        return future.result() if future.done() else None

    def refuse_stop(self) -> None:
        """Raise GoalError in an emergency stop, before the goal may move anything."""
        if self.preflight and (why := self.stop.check_stop()):
            raise GoalError(
                Codes.EMERGENCY_STOP,
                f"emergency stop: {why}: nothing is ordered; release it, then start again",
            )

    def _check_machine(self) -> None:
        self._check()
        self.wait_out_stop()

    def _check(self) -> None:
        """Raise when the goal must end: cancel, shutdown, a node or an instrument lost."""
        place = f"at step {self.progress.step} of {self.progress.total}"
        self.refuse_stop()
        if self.stopping:
            raise GoalError(Codes.CANCELED, f"{self.stopping} {place}")
        if self.canceled():
            raise GoalError(Codes.CANCELED, f"canceled {place}")
        self.required.check(place)
        idle = self.links.idle_nodes(but=self.required.newcomers()) if self.recording else ()
        if idle:
            raise GoalError(Codes.NODE_LOST, f"{idle[0]} ({place})")
        if self.recording:
            health = self.links.health
            state = health.state("recorder")
            if state is State.FAILED:
                text = f"{health.describe('recorder')}, {place}"
                raise GoalError(Codes.RECORDER_FAILED, text)
            self._bag_open |= state is State.RECORDING
            if self._bag_open and state is State.IDLE:
                raise GoalError(
                    Codes.RECORDER_FAILED,
                    f"the recorder has closed the bag {place}: node planner stood still too long; "
                    "keep other work off this computer",
                )
            self._check_streams(place)
            self._check_plan(place)
        self._heed_slow()

    def _heed_slow(self) -> None:
        """Find the slow nodes, log an overload once, and show what is being waited for."""
        overload, before = self._overload, self._overload.text
        self.slow = self.required.slow() | self._silent
        if text := overload.poll(self.slow, time.monotonic(), machine_load.describe_load):
            self.links.node.get_logger().warning(text)
        if bool(overload.text) == bool(before):
            return
        set_warning(self.links.health, SLOW, overload.text)
        doing = self.progress.doing
        if overload.text and not self.pauses.waiting:
            self._interrupted = doing
            self.tell(Why.NODES_SLOW, overload.text)
        elif self._interrupted is not None and doing.code is Why.NODES_SLOW:
            self.tell_again(self._interrupted)

    def _check_plan(self, place: str) -> None:
        """Raise GoalError if capture or solver have worked on another plan for too long."""
        astray = self.links.missing_plan(self.run) if self.run else []
        if not astray:
            self._astray = None
            return
        of_capture = self.links.missing_plan(self.run, ("capture",))
        allowed_s = (
            ASTRAY_TIMEOUT_S if of_capture else ASTRAY_TIMEOUT_S + self.required.restart_wait_s
        )
        self._astray = self._astray or WaitBudget(allowed_s)
        if self._astray.is_over(pausing=bool(self.slow)):
            topic = self.links.graph.resolve(names.PLAN)
            publishers = ", ".join(self.links.graph.publishers(topic)) or "none"
            raise GoalError(
                Codes.NODE_LOST,
                f"{'; '.join(astray)} any more {place}: does another node publish on {topic} (its "
                f"publishers: {publishers}), or was it restarted?",
                in_another_run=True,
            )

    def _check_streams(self, place: str) -> None:
        """Raise when the capture reports that an instrument it had heard is lost.

        A silent one that is still there counts as slow for as long as a node may.
        """
        beat = self.links.health.others.get("capture")
        settled = self.links.health.sim.is_settled()
        if self.stop.latched or not settled:
            self._silent = {}
        if beat is self._stream_beat or self.stop.latched or not settled:
            return
        self._stream_beat = beat
        hopeless = self.links.health.values("capture").get(HOPELESS)
        self._hopeless = (self._hopeless or WaitBudget(HOPELESS_S)) if hopeless else None
        if self._hopeless is not None and self._hopeless.is_over(pausing=bool(self.slow)):
            raise GoalError(Codes.TOPIC_MISSING, f"nothing can be measured: {hopeless} ({place})")
        self._check_publishers(place)
        self._silent = self.silent_streams()
        for topic, seconds in self._silent.items():
            publishers = ", ".join(self.links.graph.publishers(topic))
            if not publishers or seconds > self.links.health.settings.lost_after_s:
                who = f"{topic} (node {publishers or 'gone'})"
                text = f"{who} has been silent for {seconds:.1f} s {place}"
                raise GoalError(Codes.NODE_LOST, text)

    def _check_publishers(self, place: str) -> None:
        """Raise GoalError if an instrument was restarted: only the next run hears it.

        Beats show a restart of required nodes. A restarted machine may no longer know where it is,
        so a person has to begin again.
        """
        found = restarted_nodes(self.heard, self.links.offered(self.instruments))
        for path, topics in found.items():
            name = path.rpartition("/")[2]
            if name not in self.required.nodes:
                moves = any(name in self.links.graph.machines(order) for order in ORDERS)
                raise GoalError(
                    Codes.NODE_LOST,
                    f"node {name}, which publishes {', '.join(topics)}, was restarted {place}",
                    in_another_run=not moves,
                )

    def silent_streams(self) -> dict[str, float]:
        """Return which instruments are silent according to the capture: topic -> seconds."""
        return {
            self.links.instrument(key.removeprefix(SILENT)): float(value)
            for key, value in self.links.health.values("capture").items()
            if key.startswith(SILENT) and float(value) > self.settings.stream_timeout_s
        }
