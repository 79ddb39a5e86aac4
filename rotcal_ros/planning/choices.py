"""Which step is measured next: what a policy returns and is given, and the policy as_listed."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final, Protocol

from rotcal_ros.foundation.observations import Observation


@dataclass(frozen=True, slots=True)
class Standing:
    """How far a policy has come.

    ``uncertainty``: expanded uncertainty (k = 2) now, ``goal``: the wanted one, both in rad, root
    mean squares over the table angles; NaN where there is none. ``left``: steps that are expected
    to be left, the chosen one included.
    """

    left: int
    uncertainty: float = math.nan
    goal: float = math.nan


@dataclass(frozen=True, slots=True)
class Choice:
    """The next ``step`` of the plan and the ``reason`` for it; None: nothing more is measured."""

    step: int | None
    reason: str
    standing: Standing

    def same_as(self, other: Choice) -> bool:
        """Tell whether both choose the same, for the same reason, to the last bit."""
        mine, theirs = self.standing, other.standing
        pairs = ((mine.uncertainty, theirs.uncertainty), (mine.goal, theirs.goal))
        return (
            (self.step, self.reason, mine.left) == (other.step, other.reason, theirs.left)
            and all(a == b or (math.isnan(a) and math.isnan(b)) for a, b in pairs)
        )  # fmt: skip


@dataclass(frozen=True, slots=True)
class StepOutcome:
    """How ``step`` went: its accepted observation, or None when it was given up."""

    step: int
    observation: Observation | None


class Policy(Protocol):
    """Chooses step by step: ``choose`` and ``note`` are called in turn.

    A policy depends on nothing but its constructor's arguments and what ``note`` gives it; with
    the same outcomes it makes the same choices.
    """

    def choose(self) -> Choice:
        """Return the next step, or that there is none; takes less than 50 ms."""

    def note(self, outcome: StepOutcome) -> None:
        """Take the outcome of a step, the chosen one or another."""


AS_LISTED: Final = "as_listed"
UNTIL_GOAL: Final = "until_goal"


class AsListed:
    """Measures ``steps`` in their order; a step that is given up is not asked for again."""

    def __init__(self, steps: Iterable[int]) -> None:
        self._left = deque(steps)

    def choose(self) -> Choice:
        """Return the next step of the list."""
        if not self._left:
            return Choice(None, "all steps of the list are done", Standing(0))
        return Choice(self._left[0], "next of the list", Standing(len(self._left)))

    def note(self, outcome: StepOutcome) -> None:
        """Strike the step off when it is the next one."""
        if self._left and self._left[0] == outcome.step:
            self._left.popleft()
