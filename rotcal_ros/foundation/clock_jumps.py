"""Jumps of the system clock: found by the monotonic clock, reported, and recorded in a bag."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime, timedelta, timezone
from typing import Final

from rotcal_ros.foundation.language import phrase

LEAST_NS: Final = 50_000_000
"""A smaller step does not count, since two clocks cannot be read at the same instant."""
NAMED_NS: Final = 30_000_000_000
"""Size from which a jump is reported to a person at once."""
_CLOSE_NS: Final = 5_000_000
_TRIES: Final = 10
_REMEMBERED: Final = 100
_EPOCH: Final = datetime(1970, 1, 1, tzinfo=timezone.utc)


@dataclass(frozen=True, slots=True)
class ClockJump:
    """The system clock was set by ``ahead_ns`` (negative: back) and showed ``at_ns`` then."""

    ahead_ns: int
    at_ns: int

    @property
    def named(self) -> bool:
        """Whether it is reported to a person at once."""
        return abs(self.ahead_ns) >= NAMED_NS

    def describe(self) -> str:
        """Return what happened and when, in UTC."""
        at = f"{_EPOCH + timedelta(microseconds=self.at_ns // 1000):%Y-%m-%dT%H:%M:%SZ}"
        return phrase("the system clock jumped by {0:+.1f} s at {1}", self.ahead_ns / 1e9, at)


class ClockWatch:
    """Watches the system clock of this process; ``count`` and ``ahead_ns`` add up its jumps.

    ``read`` returns the system clock and how far it is ahead of the monotonic one, in ns. A
    machine that was suspended looks like one whose clock jumped ahead.
    """

    def __init__(self, read: Callable[[], tuple[int, int]] | None = None) -> None:
        self._read = read or _clocks
        _, self._ahead_ns = self._read()
        self.jumps: deque[ClockJump] = deque(maxlen=_REMEMBERED)
        self.count = 0
        self.ahead_ns = 0

    def poll(self) -> ClockJump | None:
        """Return the jump since the last look, if there was one."""
        now_ns, ahead_ns = self._read()
        step_ns, self._ahead_ns = ahead_ns - self._ahead_ns, ahead_ns
        if abs(step_ns) < LEAST_NS:
            return None
        self.jumps.append(jump := ClockJump(step_ns, now_ns))
        self.count += 1
        self.ahead_ns += step_ns
        return jump


def jumps_to_metadata(jumps: Iterable[ClockJump]) -> dict[str, str]:
    """Return jumps as the metadata record of a bag holds them."""
    return {str(n): f"{jump.ahead_ns} {jump.at_ns}" for n, jump in enumerate(jumps)}


def jumps_from_metadata(note: Mapping[str, str]) -> tuple[ClockJump, ...]:
    """Return the jumps that a metadata record holds; those that cannot be read are left out."""
    found = []
    for text in note.values():
        with suppress(ValueError, OverflowError, TypeError):
            jump = ClockJump(*map(int, text.split()))
            jump.describe()  # a date that the calendar does not have is no jump either
            found.append(jump)
    return tuple(found)


def _clocks() -> tuple[int, int]:
    """Read both clocks as close together as the machine allows."""
    best_ns, now_ns, ahead_ns = 1 << 62, 0, 0
    for _ in range(_TRIES):
        before_ns, now, after_ns = time.monotonic_ns(), time.time_ns(), time.monotonic_ns()
        if after_ns - before_ns < best_ns:
            best_ns, now_ns = after_ns - before_ns, now
            ahead_ns = now - (before_ns + after_ns) // 2
        if best_ns < _CLOSE_NS:
            break
    return now_ns, ahead_ns
