"""How far a calibration has come."""

from __future__ import annotations

import time
from dataclasses import dataclass, field


@dataclass
class Progress:
    """How far a goal has come."""

    total: int
    step: int = 0
    activity: str = "preflight"
    accepted: list[int] = field(default_factory=list)
    skipped: list[int] = field(default_factory=list)
    rejected: int = 0
    done: int = 0
    left: int = 0
    started_s: float = field(default_factory=time.monotonic)

    def time_left(self) -> float:
        """Return the estimated seconds to the last step; NaN before the first is done."""
        if not self.done:
            return float("nan")
        return (time.monotonic() - self.started_s) / self.done * self.left

    def note(self, index: int, *, accepted: bool) -> None:
        """Note how step ``index`` ended; what was noted of it before no longer counts."""
        for book in (self.accepted, self.skipped):
            if index in book:
                book.remove(index)
        (self.accepted if accepted else self.skipped).append(index)
        self.done += 1
