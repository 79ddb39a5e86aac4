"""The jumps of the system clock: those that a node reports, and those that others report."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Final

from rotcal_ros.foundation.clock_jumps import ClockJump, ClockWatch

JUMPS: Final = "clock_jumps"
"""Value in a beat: how often the clock of a node's machine has jumped."""
JUMP: Final = "clock_jump"
"""Value in a beat: the latest jump in words, where it is one to tell a person."""


class ClockNews:
    """The jumps of this node's clock: logged once, in every beat from then on."""

    def __init__(self, logger: Any) -> None:
        self._logger = logger
        self.watch = ClockWatch()
        self.concerns: dict[str, str] = {}

    def look(self) -> None:
        """Look at the clock; regularly, and whenever it matters just now."""
        jump = self.watch.look()
        if jump is None:
            return
        self._logger.warning(f"{jump.in_words()}: what is being measured is measured again")
        if jump.named:
            self.concerns = {JUMP: jump.in_words()}

    def values(self) -> Mapping[str, int]:
        """Return what goes into every beat."""
        return {JUMPS: self.watch.count} if self.watch.count else {}

    def since(self, count: int) -> tuple[ClockJump, ...]:
        """Return the jumps after the first ``count``, as far as they are remembered."""
        new = self.watch.count - count
        return tuple(self.watch.jumps)[-new:] if new else ()


def jumps_told(beats: Iterable[Mapping[str, str]]) -> int:
    """Return the number of jumps in the values of all beats."""
    return sum(int(values.get(JUMPS, 0)) for values in beats)


def jumps_in_words(health: Any) -> tuple[str, ...]:
    """Return what nodes tell of great jumps of their clocks, the node of ``health`` first."""
    health.clock.look()
    beats = [health.clock.concerns, *map(health.values, health.others)]
    return tuple(values[JUMP] for values in beats if JUMP in values)
