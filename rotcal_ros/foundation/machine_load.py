"""The load of this machine, and time that counts only while this process runs.

A busy machine is no fault: time-outs are longer there, and a standstill of the waiting process
does not use them up. A node without memory ends at once, as if it were killed, but with the
reason.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from math import inf
from typing import Final

LARGEST_LOAD_FACTOR: Final = 10.0
"""Time-outs become at most this many times as long."""
LONGEST_TURN_S: Final = 0.5
"""A longer time between two looks is a standstill of this process; only this much counts."""
_KNOWN_S: Final = 1.0


def core_count() -> int:
    """Return how many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def load_average() -> float:
    """Return how many processes wanted a core in the last minute; 0 if that is not known."""
    try:
        return os.getloadavg()[0]
    except (AttributeError, OSError):
        return 0.0


def describe_load() -> str:
    """Return the load of the machine for people."""
    number = core_count()
    return f"load {load_average():.1f} on {number} core{'s' * (number != 1)}"


class LoadFactor:
    """Processes that want each core, from 1 to ``LARGEST_LOAD_FACTOR``; updated once a second."""

    def __init__(self, read: Callable[[], float] | None = None) -> None:
        self._read = read or (lambda: load_average() / core_count())
        self._until_s, self._known = -inf, 1.0

    def __call__(self) -> float:
        """Return it as it is now."""
        now_s = time.monotonic()
        if now_s > self._until_s:
            self._until_s = now_s + _KNOWN_S
            self._known = min(max(1.0, self._read()), LARGEST_LOAD_FACTOR)
        return self._known


load_factor: Final = LoadFactor()


def load_scaled_timeout(seconds: float) -> float:
    """Return a time-out adapted to the present load of this machine."""
    return seconds * load_factor()


class AwakeClock:
    """Seconds of the monotonic clock without the standstills of this process; look regularly."""

    def __init__(self, read: Callable[[], float] = time.monotonic) -> None:
        self._read = read
        self._last_s = read()
        self._stood_s = 0.0
        self._woke_s = -inf

    def now_s(self) -> float:
        """Return the time; of a standstill only ``LONGEST_TURN_S`` count."""
        now_s = self._read()
        if (stood_s := now_s - self._last_s - LONGEST_TURN_S) > 0.0:
            self._stood_s += stood_s
            self._woke_s = now_s
        self._last_s = now_s
        return now_s - self._stood_s

    def awake_s(self) -> float:
        """Return how long ago the latest standstill has ended; 0 if this look ends one."""
        self.now_s()
        return self._last_s - self._woke_s


class WaitBudget:
    """The remaining time to wait: standstills, a busy machine and pauses do not use it up."""

    def __init__(
        self,
        seconds: float,
        load: Callable[[], float] = load_factor,
        read: Callable[[], float] = time.monotonic,
    ) -> None:
        self._left_s, self._load = seconds, load
        self._clock = AwakeClock(read)
        self._last_s = self._clock.now_s()

    def is_over(self, *, pausing: bool = False) -> bool:
        """Return whether the time is used up.

        ``pausing``: time since the last look does not count.
        """
        now_s = self._clock.now_s()
        passed_s, self._last_s = now_s - self._last_s, now_s
        if not pausing:
            self._left_s -= passed_s / self._load()
        return self._left_s < 0.0


OUT_OF_MEMORY: Final = 71
"""Exit code of such a process."""
OF_LIBRARIES: Final = "not enough memory"
"""How compressors report it, in errors of their own."""


def end_without_memory(error: BaseException, where: str) -> None:
    """End this process if ``error`` is a lack of memory: other work may be half done.

    The others notice its silence; a bag is sound up to its last chunk, as after any kill.
    """
    if not isinstance(error, MemoryError) and OF_LIBRARIES not in str(error):
        return
    os.write(2, f"out of memory ({where})\n".encode())
    os._exit(OUT_OF_MEMORY)
