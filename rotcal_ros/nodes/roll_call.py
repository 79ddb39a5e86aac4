"""Who beats and who fell silent, without ROS."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import inf
from typing import Final

SOLVING: Final = "solving"
"""State of a node whose numerics may hold up its beat: it is given SOLVING_TIMEOUT_S."""
SOLVING_TIMEOUT_S: Final = 10.0
LOADING: Final = "loading what the plan needs"
"""State of a node that loads a method's code, which may take as long on a busy machine."""


@dataclass
class RollCall:
    """Who is there: ``seen`` is name -> monotonic time (s) of the last beat.

    ``timeout_s`` is the silence after which a node counts as lost, SOLVING_TIMEOUT_S for those
    that are ``solving`` or loading. A pause of the caller itself (a stalled machine) is not blamed
    on the others: it is granted to all.
    """

    timeout_s: float
    seen: dict[str, float] = field(default_factory=dict)
    solving: set[str] = field(default_factory=set)
    _checked: float | None = None
    _aware_from: float = -inf

    def hear(self, name: str, state: str, now: float) -> None:
        """Take a beat of node ``name``."""
        self.seen[name] = now
        (self.solving.add if state in (SOLVING, LOADING) else self.solving.discard)(name)

    def silent(self, now: float) -> dict[str, float]:
        """Return the lost names with their silence in seconds; call it regularly."""
        pause = 0.0 if self._checked is None else now - self._checked
        self._checked = now
        if pause > self.timeout_s / 2:
            self.seen = {name: seen + pause for name, seen in self.seen.items()}
            self._aware_from = now + self.timeout_s / 2
        silence = {name: now - seen for name, seen in self.seen.items()}
        return {name: s for name, s in silence.items() if s > self._granted(name)}

    def aware(self, now: float) -> bool:
        """Return whether the caller knows the others as they are now.

        Not at once behind a pause of its own: what they said meanwhile is still to come.
        """
        pause = 0.0 if self._checked is None else now - self._checked
        return pause <= self.timeout_s / 2 and now >= self._aware_from

    def _granted(self, name: str) -> float:
        return SOLVING_TIMEOUT_S if name in self.solving else self.timeout_s
