"""Reasons of rejected attempts: the commonest one, which to log now, and when to give up."""

from __future__ import annotations

import re
from collections import Counter, deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Final

from rotcal_ros.capture.window import BEAM_BROKEN
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.language import Phrase, phrase
from rotcal_ros.foundation.observations import Observation, place_in_words

ALARM_AFTER: Final = 3
"""This many attempts rejected in a row are an alarm, fewer a warning."""
REPEATED_S: Final = 10.0
"""A kind of reason is logged again after this time at the earliest."""
_REMEMBERED: Final = 1000
_NUMBER: Final = re.compile(r"-?\b\d+(\.\d+)?(e[-+]?\d+)?")


def reason_kind(reason: str) -> str:
    """Return what is equal for attempts that fail in the same way: the code, and names in it.

    Of mere words, as in bags of before, it is all but the numbers.
    """
    if isinstance(reason, Phrase) and reason.parts:
        names = (reason_kind(part) for part in reason.parts if isinstance(part, str))
        return ", ".join([reason.template, *names])
    return _NUMBER.sub("#", reason)


@dataclass(frozen=True, slots=True)
class MostFrequentReason:
    """The commonest kind of ``total`` reasons: ``count`` of them are like ``example``."""

    example: str
    count: int
    total: int

    @classmethod
    def of(cls, reasons: Iterable[str]) -> MostFrequentReason | None:
        """Return the commonest kind, with its latest example; None if there is no reason."""
        examples = {}
        kinds: Counter[str] = Counter()
        for reason in reasons:
            kinds[reason_kind(reason)] += 1
            examples[reason_kind(reason)] = reason
        if not kinds:
            return None
        ((kind, count),) = kinds.most_common(1)
        return cls(examples[kind], count, kinds.total())

    def describe(self) -> Phrase:
        """Return how many, and an example."""
        like = phrase("{0} of {1} like this", self.count, self.total)
        return phrase("{0}: {1}", like, phrase(self.example))


@dataclass
class Rejections:
    """The rejected attempts of a run; ``running`` are the reasons since the last accepted one."""

    running: deque[str] = field(default_factory=lambda: deque(maxlen=_REMEMBERED))
    _told_s: dict[str, float] = field(default_factory=dict)
    _unreported: Counter[str] = field(default_factory=Counter)

    def note(self, observation: Observation, now_s: float) -> str | None:
        """Take an observation; return a line for the log, if it is worth one.

        A new kind of reason is worth one at once, the same kind again only now and then.
        """
        if observation.accepted:
            self.running.clear()
            return None
        reason = observation.reason
        self.running.append(reason)
        kind = reason_kind(reason)
        if now_s - self._told_s.get(kind, float("-inf")) < REPEATED_S:
            self._unreported[kind] += 1
            return None
        self._told_s[kind] = now_s
        more = self._unreported.pop(kind, 0)
        since = f" (and {more} more like this since the last line)" if more else ""
        place = place_in_words(observation.table_position, observation.target, observation.attempt)
        return f"{place} rejected: {reason}{since}"

    @property
    def is_alarming(self) -> bool:
        """Whether so many were rejected in a row that all further ones may be."""
        return len(self.running) >= ALARM_AFTER

    def describe(self) -> str | None:
        """Return what was rejected since the last accepted attempt."""
        most_frequent = MostFrequentReason.of(self.running)
        if most_frequent is None:
            return None
        attempts = f"{most_frequent.total} attempts" if most_frequent.total > 1 else "an attempt"
        return f"{attempts} rejected in a row, {most_frequent.describe()}"


HIDDEN: Final = 10
"""This many times the limit of steps may fail in a row because something stands in the beam: a
fixture hides a row of targets, and the rest of the plan is worth measuring."""


class TooManyFailedError(DataError):
    """So many steps in a row failed that a calibration is given up."""


@dataclass
class FailedSteps:
    """Counts steps in a row that failed in all attempts; ``limit`` 0: never give up."""

    limit: int
    _steps: list[tuple[int, tuple[str, ...]]] = field(default_factory=list)

    def note(self, step: int, reasons: Sequence[str]) -> None:
        """Note the end of a step: the reasons of its failed attempts; none if it was captured."""
        if reasons:
            self._steps.append((step, tuple(reasons)))
        else:
            self._steps.clear()

    def check(self) -> None:
        """Raise TooManyFailedError if the calibration is to be given up."""
        hidden = [
            step
            for step, reasons in self._steps
            if all(isinstance(r, Phrase) and r.has(BEAM_BROKEN) for r in reasons)
        ]
        failed = len(self._steps)
        if not self.limit or max(failed - len(hidden), failed / HIDDEN) < self.limit:
            return
        most_frequent = MostFrequentReason.of(r for _, reasons in self._steps for r in reasons)
        assert most_frequent is not None
        steps = f"{failed} steps running" if failed > 1 else "a step"
        raise TooManyFailedError(
            f"given up: {steps} failed; of their attempts {most_frequent.describe()}. Correct "
            "that, then resume with 'rotcal run --resume', which measures these steps again "
            f"(planner.max_failed_steps = {self.limit} says how many may fail in a row)"
        )
