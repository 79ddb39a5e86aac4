"""The progress of a goal, and the time that is left. Needs no ROS."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field
from typing import Final

from rotcal_ros.foundation.node_state import Reason, Why

BEGINNING: Final = Reason(Why.PREFLIGHT)


@dataclass
class GoalProgress:
    """The progress of a goal, and what it is ``doing``.

    ``uncertainty`` and ``goal`` are those of the policy, rad; ``earlier`` are the steps that were
    accepted before this goal.

    ``started_s`` and ``paused_s`` are monotonic; None: no pause is on.
    """

    total: int
    step: int = 0
    doing: Reason = BEGINNING
    accepted: list[int] = field(default_factory=list)
    skipped: list[int] = field(default_factory=list)
    rejected: int = 0
    done: int = 0
    left: int = 0
    earlier: frozenset[int] = frozenset()
    uncertainty: float = math.nan
    goal: float = math.nan
    started_s: float = field(default_factory=time.monotonic)
    paused_s: float | None = None

    def time_left(self) -> float:
        """Return the estimated seconds to the last step; NaN before the first is done.

        The estimate stands still during a pause.
        """
        if not self.done:
            return math.nan
        now_s = time.monotonic() if self.paused_s is None else self.paused_s
        return (now_s - self.started_s) / self.done * self.left

    @property
    def ended(self) -> int:
        """How many steps were accepted or given up, each counted once, in all runs."""
        return len(self.earlier.union(self.accepted, self.skipped))

    def counts(self) -> dict[str, int]:
        """Return how many steps were accepted and how many attempts rejected."""
        return {"accepted": len(self.accepted), "rejected": self.rejected}

    def begin(self) -> None:
        """Begin to measure, or go on in another run."""
        if not self.done:
            self.started_s, self.paused_s = time.monotonic(), None
        self.go_on()

    def pause(self) -> None:
        """Begin a pause, unless one is on already."""
        if self.paused_s is None:
            self.paused_s = time.monotonic()

    def go_on(self) -> None:
        """End a pause: it does not count."""
        if self.paused_s is not None:
            self.started_s += time.monotonic() - self.paused_s
        self.paused_s = None

    def note(self, index: int, *, accepted: bool) -> None:
        """Note how step ``index`` ended; this replaces what was noted before."""
        for book in (self.accepted, self.skipped):
            if index in book:
                book.remove(index)
        (self.accepted if accepted else self.skipped).append(index)
        self.done += 1
