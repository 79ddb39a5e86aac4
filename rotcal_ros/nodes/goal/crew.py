"""The nodes that a goal needs: which are lost, which were restarted, which are waited for."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from rotcal_msgs.action import Calibrate

from rotcal_ros.foundation.machine_load import Patience
from rotcal_ros.foundation.node_names import PREFLIGHT_NODES
from rotcal_ros.nodes.runtime.health import Health

Codes = Calibrate.Result
"""The message that holds the error codes of the action."""
SOLVER: Final = "solver"


class GoalError(Exception):
    """The goal cannot go on; ``code`` is an error code of the action.

    ``in_another_run`` says that it can, in another run, once the nodes of the suite are back.
    """

    def __init__(self, code: int, text: str, *, in_another_run: bool = False) -> None:
        super().__init__(text)
        self.code = code
        self.in_another_run = in_another_run


class Crew:
    """The ``nodes`` that must be there while a goal runs.

    The solver may be away for ``restart_wait_s``: it gets from the recorder what it missed. The
    restart of any other node breaks the run off, however quickly it came back.
    """

    def __init__(self, health: Health, restart_wait_s: float) -> None:
        self.nodes: set[str] = set()
        self.restart_wait_s = restart_wait_s
        self._health = health
        self._processes: dict[str, str | None] = {}
        self._away: Patience | None = None

    def begin_run(self) -> None:
        """Take those that are here now for those of the run."""
        nodes = self.nodes.union(PREFLIGHT_NODES)
        self._processes = {name: self._health.process(name) for name in nodes}

    def end_run(self) -> None:
        """Let the nodes of the suite come and go: a preflight looks for them."""
        self.nodes -= set(PREFLIGHT_NODES)
        for name in PREFLIGHT_NODES:
            self._processes.pop(name, None)

    def newcomers(self) -> list[str]:
        """Return which nodes are other processes than when the run began."""
        began = self._processes.items()
        return [name for name, process in began if self._health.process(name) != process]

    def slow(self) -> dict[str, float]:
        """Return who of the crew is slow: name -> seconds without a sign that it answers."""
        return {name: s for name, s in self._health.slow.items() if name in self.nodes}

    def is_another(self, name: str) -> Callable[[], bool]:
        """Return what tells whether a node is another process than now."""
        now = self._health.process(name)
        return lambda: self._health.process(name) != now

    def check(self, place: str) -> None:
        """Raise GoalError where the run cannot go on with the nodes that are here."""
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
        self._away = self._away or Patience(self.restart_wait_s)
        return self.restart_wait_s > 0.0 and not self._away.is_over()

    def _in_words(self, missing: list[str], anew: list[str]) -> list[str]:
        lost = any(name in self._health.lost for name in missing)
        how = "is lost" if lost else "was ended"
        words = [f"node {', '.join(missing)} {how}"] if missing else []
        return [*words, *(f"node {name} was restarted" for name in anew)]

    def _last_words(self, missing: list[str]) -> str:
        lost = [name for name in missing if name in self._health.lost]
        return f" ({self._health.last_words(lost[0])})" if lost else ""
