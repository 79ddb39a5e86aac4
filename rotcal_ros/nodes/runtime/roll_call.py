"""Who is there, who is slow and who is lost, without ROS.

A node is *lost* when its process is gone, and *slow* while its sign of life is late: a slow one is
not given up before the set time is over.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Final

from rotcal_ros.planning.settings import HealthSettings

LATE_S: Final = 0.6
"""A sign of life that is three beats late is worth a look at the process."""
OVER_S: Final = 60.0
"""An overload is over when no node has been slow for so long."""


@dataclass
class RollCall:
    """Who is there: ``seen`` is name -> when it last answered, by a clock of the caller (s).

    That clock stands while the caller does, see
    :class:`~rotcal_ros.foundation.machine_load.AwakeClock`. ``slow`` is name -> seconds, ``lost``
    is name -> why, both as of the latest look.
    """

    settings: HealthSettings = field(default_factory=HealthSettings)
    seen: dict[str, float] = field(default_factory=dict)
    slow: dict[str, float] = field(default_factory=dict)
    lost: dict[str, str] = field(default_factory=dict)

    def hear(self, name: str, answered_s: float) -> None:
        """Take a beat of a node that last took a turn at ``answered_s``; it is there."""
        self.seen[name] = answered_s
        if self.lost.pop(name, None):
            self.slow.pop(name, None)

    def forget(self, name: str) -> None:
        """Take a goodbye."""
        for book in (self.seen, self.slow, self.lost):
            book.pop(name, None)

    def look(self, now_s: float, gone: Callable[[str], str | None]) -> list[str]:
        """Judge all nodes; return the names of those that are lost since the last look.

        ``gone`` says why the process of a node is gone, None: it is there, or this is not known.
        It is called only for nodes whose beat is late.
        """
        silence = {name: now_s - seen_s for name, seen_s in self.seen.items()}
        late = {n: s for n, s in silence.items() if s > LATE_S and n not in self.lost}
        given_up = self.settings.lost_after_s
        new = {
            name: why or f"no sign of it for {s:.0f} s"
            for name, s in late.items()
            if (why := gone(name)) or s > given_up
        }
        self.lost |= new
        slow_after = self.settings.slow_after_s
        self.slow = {n: s for n, s in late.items() if s > slow_after and n not in new}
        return list(new)


@dataclass
class Overload:
    """Reports an overload once at its begin, and once when it is over.

    ``text`` says who is waited for now, None: nobody.
    """

    text: str | None = None
    _times: int = 0
    _longest_s: float = 0.0
    _last_s: float | None = None

    def look(
        self, slow: Mapping[str, float], now_s: float, machine: Callable[[], str]
    ) -> str | None:
        """Take who is slow (name -> s); return what to log, if anything.

        ``now_s`` is monotonic, ``machine`` tells the load of the machine in words.
        """
        was_waiting = bool(self.text)
        if not slow:
            self.text = None
            over = self._last_s is not None and now_s - self._last_s > OVER_S
            return self._end() if over else None
        if not was_waiting:
            names = ", ".join(f"{name} ({s:.1f} s)" for name, s in sorted(slow.items()))
            self.text = f"waiting for {names}: slow, not lost; {machine()}"
        self._longest_s = max(self._longest_s, *slow.values())
        self._times += not was_waiting
        begins, self._last_s = self._last_s is None, now_s
        return f"{self.text}; it goes on by itself" if begins else None

    def _end(self) -> str:
        text = (
            f"no node has been slow for {OVER_S:g} s: waited {self._times} times, the longest "
            f"silence was {self._longest_s:.1f} s"
        )
        self._times, self._longest_s, self._last_s = 0, 0.0, None
        return text
