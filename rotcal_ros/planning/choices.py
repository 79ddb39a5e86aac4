"""What a policy says and hears: choices of steps, and how these went."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

from rotcal_ros.foundation.observations import Observation


@dataclass(frozen=True, slots=True)
class Standing:
    """How far a policy has come.

    ``uncertainty``: expanded uncertainty (k = 2) now, ``goal``: the wanted one, both in rad, root
    mean squares over the table angles; NaN where nobody knows or wants any. ``left``: steps that
    are expected to be left, the chosen one included.
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

    A policy knows nothing but what it was made of and what it was given by ``note``; with the same
    outcomes it makes the same choices.
    """

    def choose(self) -> Choice:
        """Return the next step, or that there is none; takes less than 50 ms."""

    def note(self, outcome: StepOutcome) -> None:
        """Take notice of how a step went, be it the chosen one or another."""
