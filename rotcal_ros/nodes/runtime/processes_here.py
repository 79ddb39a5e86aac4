"""Which process a beat comes from, and whether it still exists on this machine."""

from __future__ import annotations

import os
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Final
from uuid import getnode

_DEAD: Final = ("Z", "X")
_STATE, _START = 0, 19
"""Fields of ``/proc/PID/stat`` behind the name of the program."""


@cache
def machine() -> str:
    """Return what identifies this machine and its space of process ids."""
    with suppress(OSError):
        boot = Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
        return f"{boot}/{Path('/proc/self/ns/pid').stat().st_ino}"  # containers count anew
    return f"{getnode():x}"


@dataclass(frozen=True, slots=True)
class HostProcess:
    """A process id on a ``host``, and when that process began (ticks; 0: unknown)."""

    host: str
    pid: int
    start: int

    @classmethod
    def own(cls) -> HostProcess:
        """Return this process."""
        return cls(machine(), os.getpid(), _fields(os.getpid())[1])

    @property
    def is_of_here(self) -> bool:
        """Whether it runs on this machine."""
        return self.host == machine()

    @property
    def is_gone(self) -> bool:
        """Whether it is known that it does not exist any more; of another machine it is not."""
        if not self.is_of_here:
            return False
        if not _exists(self.pid):
            return True
        state, start = _fields(self.pid)
        return state in _DEAD or (start != self.start and 0 not in (start, self.start))


def _exists(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except OSError:  # that of another user
        return True
    return True


def _fields(pid: int) -> tuple[str, int]:
    """Return state and start of a process; ("", 0) where the system does not show them."""
    try:
        text = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return "", 0
    fields = text.rpartition(")")[2].split()
    return fields[_STATE], int(fields[_START])
