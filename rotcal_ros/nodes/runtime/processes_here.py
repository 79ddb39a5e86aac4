"""Which process a beat comes from, and whether it still exists on this machine."""

from __future__ import annotations

import os
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Final
from uuid import getnode

PROCESS: Final = "process"
"""Value in a beat: the machine, the process id there, and when that began (ticks; 0: unknown)."""
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


def own_process() -> str:
    """Return this process as it stands in a beat."""
    return f"{machine()} {os.getpid()} {_fields(os.getpid())[1]}"


def why_gone(process: str) -> str:
    """Say that a process of a beat is gone; empty: it exists, or is on another machine."""
    words = process.split()
    if len(words) != 3 or words[0] != machine() or not (words[1] + words[2]).isdecimal():
        return ""
    pid = int(words[1])
    if not _exists(pid):
        return f"its process {pid} is gone"
    state, start = _fields(pid)
    if state in _DEAD or (start != words[2] and "0" not in (start, words[2])):
        return f"its process {pid} is gone"
    return ""


def is_of_here(process: str) -> bool:
    """Return whether a process of a beat runs on this machine."""
    return process.partition(" ")[0] == machine()


def _exists(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except OSError:  # that of another user
        return True
    return True


def _fields(pid: int) -> tuple[str, str]:
    """Return state and start of a process; ("", "0") where the system does not show them."""
    try:
        text = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return "", "0"
    fields = text.rpartition(")")[2].split()
    return fields[_STATE], fields[_START]
