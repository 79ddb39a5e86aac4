"""The choice of the next step: what a policy returns and gets, and the policy as_listed."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final, Protocol

from rotcal_ros.foundation.language import Phrase, phrase
from rotcal_ros.foundation.observations import Observation


@dataclass(frozen=True, slots=True)
class PolicyProgress:
    """How far a policy has come.

    ``uncertainty`` is the present expanded uncertainty (k = 2), ``goal`` the wanted one, both in
    rad as root mean squares over the table angles; NaN if there is none. ``left``: expected number
    of further steps, including the chosen one.
    """

    left: int
    uncertainty: float = math.nan
    goal: float = math.nan


@dataclass(frozen=True, slots=True)
class StepChoice:
    """The next ``step`` of the plan and the ``reason`` for it; None: nothing more is measured."""

    step: int | None
    reason: Phrase
    standing: PolicyProgress

    def same_as(self, other: StepChoice) -> bool:
        """Return whether both choose the same, for the same reason, to the last bit."""
        mine, theirs = self.standing, other.standing
        pairs = ((mine.uncertainty, theirs.uncertainty), (mine.goal, theirs.goal))
        return (
            (self.step, self.reason, mine.left) == (other.step, other.reason, theirs.left)
            and all(a == b or (math.isnan(a) and math.isnan(b)) for a, b in pairs)
        )  # fmt: skip


@dataclass(frozen=True, slots=True)
class StepOutcome:
    """The outcome of ``step``: its accepted observation, or None if it was given up."""

    step: int
    observation: Observation | None


class StepPolicy(Protocol):
    """Chooses step by step: ``choose`` and ``note`` are called in turn.

    A policy depends only on its constructor's arguments and what ``note`` gives it: the same
    outcomes lead to the same choices.
    """

    def choose(self) -> StepChoice:
        """Return the next step, or that there is none, in less than 50 ms."""

    def note(self, outcome: StepOutcome) -> None:
        """Note the outcome of a step, the chosen one or another."""


AS_LISTED: Final = "as_listed"
UNTIL_GOAL: Final = "until_goal"


class ListedPolicy:
    """Measures ``steps`` in order; a step that is given up is not tried again."""

    def __init__(self, steps: Iterable[int]) -> None:
        self._left = deque(steps)

    def choose(self) -> StepChoice:
        """Return the next step of the list."""
        if not self._left:
            return StepChoice(None, phrase("all planned steps are done"), PolicyProgress(0))
        return StepChoice(
            self._left[0], phrase("next of the list"), PolicyProgress(len(self._left))
        )

    def note(self, outcome: StepOutcome) -> None:
        """Remove the step from the list if it is the next one."""
        if self._left and self._left[0] == outcome.step:
            self._left.popleft()
