"""Why attempts were rejected: which reason is the commonest, what is worth a line just now."""

from __future__ import annotations

import re
from collections import Counter, deque
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Final

from rotcal_ros.foundation.observations import Observation, place_in_words

ALARM_AFTER: Final = 3
"""Attempts rejected running from which on it is an alarm, no more a mere concern."""
REPEATED_S: Final = 10.0
"""A kind of reason that has a line gets its next one after this time."""
_REMEMBERED: Final = 1000
_NUMBER: Final = re.compile(r"-?\b\d+(\.\d+)?(e[-+]?\d+)?")


def kind_of(reason: str) -> str:
    """Return a reason without its numbers: equal for what goes wrong in the same way."""
    return _NUMBER.sub("#", reason)


@dataclass(frozen=True, slots=True)
class Commonest:
    """The commonest kind of ``total`` reasons: ``count`` of them are like ``example``."""

    example: str
    count: int
    total: int

    @classmethod
    def of(cls, reasons: Iterable[str]) -> Commonest | None:
        """Return the commonest kind, with its latest example; None where there is no reason."""
        examples = {}
        kinds: Counter[str] = Counter()
        for reason in reasons:
            kinds[kind_of(reason)] += 1
            examples[kind_of(reason)] = reason
        if not kinds:
            return None
        ((kind, count),) = kinds.most_common(1)
        return cls(examples[kind], count, kinds.total())

    def in_words(self) -> str:
        """Return how many, and an example."""
        return f"{self.count} of {self.total} like this: {self.example}"


@dataclass
class Rejections:
    """The rejected attempts of a run; ``running`` are the reasons since the last accepted one."""

    running: deque[str] = field(default_factory=lambda: deque(maxlen=_REMEMBERED))
    _told_s: dict[str, float] = field(default_factory=dict)
    _untold: Counter[str] = field(default_factory=Counter)

    def note(self, observation: Observation, now_s: float) -> str:
        """Take an observation; return the line that it is worth, empty: none.

        A new kind of reason is worth one at once, the same kind again only now and then.
        """
        if observation.accepted:
            self.running.clear()
            return ""
        reason = observation.reason
        self.running.append(reason)
        kind = kind_of(reason)
        if now_s - self._told_s.get(kind, float("-inf")) < REPEATED_S:
            self._untold[kind] += 1
            return ""
        self._told_s[kind] = now_s
        more = self._untold.pop(kind, 0)
        since = f" (and {more} more like this since the last line)" if more else ""
        place = place_in_words(observation.table_position, observation.target, observation.attempt)
        return f"{place} rejected: {reason}{since}"

    @property
    def alarming(self) -> bool:
        """Whether so many running were rejected that nothing may come at all."""
        return len(self.running) >= ALARM_AFTER

    def in_words(self) -> str:
        """Return what was rejected running; empty: the last attempt was accepted."""
        found = Commonest.of(self.running)
        if found is None:
            return ""
        attempts = f"{found.total} attempts" if found.total > 1 else "an attempt"
        return f"{attempts} rejected running, {found.in_words()}"
