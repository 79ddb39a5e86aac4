"""How far a calibration has come, for the person at a terminal."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

from rotcal_ros.foundation.circumstances import SIMULATED
from rotcal_ros.foundation.components import COVERAGE_FACTOR
from rotcal_ros.foundation.node_state import PAUSES, STOPS
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.report.terminal.console import say

if TYPE_CHECKING:
    from rich.progress import Progress

Event = Mapping[str, Any]
NO_MACHINE: Final = f"{SIMULATED}: no machine is measured, the cell is a simulation"


class Display:
    """A progress bar; without a terminal, a line for every tenth of the steps.

    ``deciles`` are how many tenths need no line; -1 asks for one at once.
    """

    def __init__(self, bar: Progress, deciles: int = 0) -> None:
        self._bar = bar
        self._task = bar.add_task("starting the nodes", total=None)
        self._decile = deciles

    def line(self, text: str) -> None:
        """Print a line, if there is any, above the bar."""
        if text:
            self._bar.console.print(text, markup=False, highlight=False, soft_wrap=True)

    def feedback(self, event: Event) -> None:
        """Move the bar."""
        step, total, text = event["step"], event["total"], describe(event)
        self._bar.update(self._task, completed=step, total=total, description=text)
        without_terminal = self._bar.disable or not self._bar.console.is_terminal
        if without_terminal and step * 10 // total > self._decile:
            say(f"{step} of {total} steps, {text}")
        self._decile = max(self._decile, step * 10 // total)


def describe(feedback: Event) -> str:
    """Return a feedback in words: activity, goal, largest U of the curve so far, time left."""
    doing = feedback["doing"]
    waiting = "stopped by an emergency stop" if doing in STOPS else "waiting for a person"
    words = [waiting if doing in PAUSES else str(feedback["activity"])]
    if feedback.get("goal_rad") is not None:
        words.append(_standing(feedback["uncertainty_rad"], feedback["goal_rad"]))
    if feedback["current_std_rad"] is not None:
        largest = COVERAGE_FACTOR * feedback["current_std_rad"] / ARCSEC
        words.append(f"U (k = {COVERAGE_FACTOR:g}) {largest:.2f} arcsec")
    if feedback["time_left_s"] is not None:
        words.append(f"{feedback['time_left_s']:.0f} s left")
    return ", ".join(words)


def _standing(uncertainty_rad: float | None, goal_rad: float) -> str:
    """Return how far a policy is from its goal; at first some station has too few lengths."""
    goal = f"{goal_rad / ARCSEC:.2f} arcsec"
    if uncertainty_rad is None:
        return f"goal: rms of U {goal}, known once all stations are placed"
    return f"goal: rms of U {goal}, now {uncertainty_rad / ARCSEC:.2f}"
