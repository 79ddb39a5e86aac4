"""The person at the terminal: sees the progress of a calibration, and confirms work with Enter."""

from __future__ import annotations

import select
import sys
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

from rotcal_ros.foundation.circumstances import SIMULATED
from rotcal_ros.foundation.components import COVERAGE_FACTOR
from rotcal_ros.foundation.gum_numbers import uncertainty
from rotcal_ros.foundation.node_state import PAUSES, RELEASED, STOPS, Why
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.methods import Configuration
from rotcal_ros.report.terminal.console import say

if TYPE_CHECKING:
    from rich.progress import Progress


Event = Mapping[str, Any]
NO_MACHINE: Final = f"{SIMULATED}: no machine is measured, the cell is a simulation"


class ProgressDisplay:
    """A progress bar; without a terminal, a line for every tenth of the steps.

    ``deciles`` is the number of tenths that need no further line; -1 asks for one at once.
    """

    def __init__(self, bar: Progress, deciles: int = 0) -> None:
        self._bar = bar
        self._task = bar.add_task("starting the nodes", total=None)
        self._decile = deciles

    def line(self, text: str | None) -> None:
        """Print a line above the bar; None: there is none."""
        if text:
            self._bar.console.print(text, markup=False, highlight=False, soft_wrap=True)

    def feedback(self, event: Event) -> None:
        """Move the bar."""
        step, total, text = event["step"], event["total"], describe_feedback(event)
        self._bar.update(self._task, completed=step, total=total, description=text)
        without_terminal = self._bar.disable or not self._bar.console.is_terminal
        if without_terminal and step * 10 // total > self._decile:
            say(f"{step} of {total} steps, {text}")
        self._decile = max(self._decile, step * 10 // total)


def describe_feedback(feedback: Event) -> str:
    """Return a feedback in words: activity, goal or else the largest U so far, time left."""
    doing = feedback["doing"]
    waiting = "stopped by an emergency stop" if doing in STOPS else "waiting for a person"
    words = [waiting if doing in PAUSES else str(feedback["activity"])]
    if feedback.get("goal_rad") is not None:
        words.append(_standing(feedback["uncertainty_rad"], feedback["goal_rad"]))
    elif feedback["current_std_rad"] is not None:
        largest = COVERAGE_FACTOR * feedback["current_std_rad"] / ARCSEC
        words.append(f"U (k = {COVERAGE_FACTOR:g}) at most {uncertainty(largest)} arcsec")
    if feedback["time_left_s"] is not None:
        words.append(f"{feedback['time_left_s']:.0f} s left")
    return ", ".join(words)


def _standing(uncertainty_rad: float | None, goal_rad: float) -> str:
    """Return how far a policy is from its goal; unknown while a station has too few lengths."""
    goal = f"{goal_rad / ARCSEC:.2f} arcsec"
    if uncertainty_rad is None:
        return f"goal: rms of U {goal}, known once all stations are placed"
    return f"goal: rms of U {goal}, now {uncertainty_rad / ARCSEC:.2f}"


class SessionOperator:
    """Does a person's work of a plan, or says when it is done.

    With a simulated person, or ``at_once``, the work counts as done as soon as it is asked for,
    but not for a viewer who is only ``watching`` from another terminal. In a terminal Enter
    confirms it. Without a terminal only others can: an attached viewer, or the service ``resume``
    of the cell. After an emergency stop nothing is confirmed at once, and while it lasts nothing
    is asked for. ``instruction`` is the latest request.
    """

    def __init__(
        self, configuration: Configuration, at_once: bool, *, watching: bool = False
    ) -> None:
        self._service = f"{configuration.cell.namespace.rstrip('/')}/resume"
        self._simulated = configuration.simulated and configuration.simulation.person
        self._as_done = at_once or self._simulated
        self._at_once = self._as_done and not watching
        self._asked = self._confirmed = self._paused = False
        self._code = int(Why.UNKNOWN)
        self.instruction = ""

    def receive(self, event: Mapping[str, Any]) -> str | None:
        """Handle an event of the client; return what the person has to read, None: nothing."""
        if event["event"] == "paused":
            self._asked, self._confirmed = True, False
            self._paused = True
            _enter_pressed()  # what was typed earlier is not an answer
            self.instruction, self._code = event["instruction"], event["doing"]
            return f"{self.instruction}{self._what_then()}"
        if event["event"] == "resumed" and not event["success"]:
            self._asked = self._paused  # refused: the request is still open
            return str(event["reason"])
        if event["event"] == "feedback":  # anybody may have called the service
            self._paused = event["doing"] in PAUSES
            self._asked = self._asked and self._paused
        return None

    def confirm(self, instruction: str) -> None:
        """Accept from another terminal that this work is done, if it is still asked for."""
        self._confirmed = self._asked and instruction == self.instruction

    def is_done(self) -> bool:
        """Return True once for every work that is done."""
        at_once = self._at_once and self._code not in STOPS
        done = self._asked and (at_once or self._confirmed or _enter_pressed())
        self._asked = self._asked and not done
        return done

    def _what_then(self) -> str:
        stopped = self._code in STOPS
        if stopped and self._code not in RELEASED:
            return ""
        if self._simulated and not stopped:
            return ": done by the simulated person"
        if self._as_done and not stopped:
            return ": taken as done (--yes)"
        if sys.stdin.isatty():
            return "; then press Enter"
        return (
            "; then press Enter in 'rotcal attach', or call the service "
            f"{self._service} (std_srvs/srv/Trigger)"
        )


def _enter_pressed() -> bool:
    """Return whether a line was entered in the terminal; never waits.

    A terminal that is lost at this moment reads as ended and no longer counts as a terminal.
    """
    try:
        if not sys.stdin.isatty() or not select.select([sys.stdin], [], [], 0.0)[0]:
            return False
        return bool(sys.stdin.readline())
    except OSError:
        return False
