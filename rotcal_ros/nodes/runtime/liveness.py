"""Keeps track of which nodes are present, slow or lost, and which process each one is.

Needs no ROS.

A node is *lost* when its process is gone and *slow* while its beat is late. A slow node is kept
until ``health.lost_after_s`` is over.

Two processes can be started under one name: the older one keeps the name, the younger one ends.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, Final
from uuid import getnode, uuid4

from rotcal_ros.foundation.errors import ConfigurationError, RotcalError
from rotcal_ros.foundation.node_names import NODES
from rotcal_ros.foundation.units import NANOSECOND
from rotcal_ros.planning.settings import HealthSettings

LATE_S: Final = 0.6
"""A beat that is three periods late is a reason to look at the process."""
OVER_S: Final = 60.0
"""An overload is over when no node has been slow for this time."""


@dataclass
class Liveness:
    """The nodes that are present; ``seen`` is name -> when it last answered, in s.

    The clock is the caller's, and stands still while the caller does (see
    :class:`~rotcal_ros.foundation.machine_load.AwakeClock`): a node that was itself suspended must
    not take all others for lost. ``slow`` is name -> seconds, ``lost`` is name -> reason, both as
    of the latest look.
    """

    settings: HealthSettings = field(default_factory=HealthSettings)
    seen: dict[str, float] = field(default_factory=dict)
    slow: dict[str, float] = field(default_factory=dict)
    lost: dict[str, str] = field(default_factory=dict)

    def receive(self, name: str, answered_s: float) -> None:
        """Note a beat of a node whose executor last took a turn at ``answered_s``."""
        self.seen[name] = answered_s
        if self.lost.pop(name, None):
            self.slow.pop(name, None)

    def forget(self, name: str) -> None:
        """Note that a node has left on purpose."""
        for book in (self.seen, self.slow, self.lost):
            book.pop(name, None)

    def poll(self, now_s: float, gone: Callable[[str], str | None]) -> list[str]:
        """Judge all nodes; return the names of those that are newly lost.

        ``gone`` says why the process of a node is gone; None: it is there, or that is not known.
        It looks at processes and the graph, so it is called only for nodes whose beat is late.
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
class OverloadMonitor:
    """Reports an overload of the machine once when it begins and once when it is over.

    ``text`` says which nodes are waited for at present; None: none.
    """

    text: str | None = None
    _times: int = 0
    _longest_s: float = 0.0
    _last_s: float | None = None

    def poll(
        self, slow: Mapping[str, float], now_s: float, machine: Callable[[], str]
    ) -> str | None:
        """Note which nodes are slow (name -> s); return what to log, if anything.

        ``now_s`` is monotonic, ``machine`` returns the load of the machine in words.
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
        return f"{self.text}; it resumes by itself" if begins else None

    def _end(self) -> str:
        text = (
            f"no node has been slow for {OVER_S:g} s: waited {self._times} times, the longest "
            f"silence was {self._longest_s:.1f} s"
        )
        self._times, self._longest_s, self._last_s = 0, 0.0, None
        return text


SESSION_VARIABLE: Final = "ROTCAL_SESSION"
"""Environment variable: the name that all processes of one session share.

It begins with the monotonic time (ns) at which the session began.
"""
_HOW: Final = (
    "end the first ones, or give this one another ROS_DOMAIN_ID or another cell.namespace"
)
_DIGITS: Final = 20
_AT_ONCE_S: Final = 0.1
TAKE_OVER_S: Final = 0.7
"""A holder that is silent for longer loses its name to the node that beats under it."""


@dataclass(frozen=True, slots=True)
class ProcessIdentity:
    """A process, its session, and when that began, on the monotonic clock of the holder of this.

    Beats carry ages instead of times, so that clocks of two machines need not agree.
    """

    session: str
    process: str
    born_s: float

    @classmethod
    def own(cls, environment: Mapping[str, str], now_s: float) -> ProcessIdentity:
        """Return a new identity for this process; without a session it is one of its own."""
        process, session = uuid4().hex, environment.get(SESSION_VARIABLE, "")
        begun_ns, _, _ = session.partition("-")
        known = begun_ns.isdecimal() and len(begun_ns) < _DIGITS
        born_s = min(int(begun_ns) * NANOSECOND, now_s) if known else now_s
        return cls("".join(session.split()) or process, process, born_s)

    @classmethod
    def of(cls, beat: Any, now_s: float) -> ProcessIdentity:
        """Return who sent a beat, a NodeState."""
        return cls(beat.session, beat.process, now_s - beat.age * NANOSECOND)

    def age_ns(self, now_s: float) -> int:
        """Return the age for a beat."""
        return round(max(0.0, now_s - self.born_s) / NANOSECOND)

    def is_older(self, other: ProcessIdentity) -> bool:
        """Return whether this process began first; at equal times the smaller id decides."""
        earlier_s = other.born_s - self.born_s
        return self.process < other.process if abs(earlier_s) < _AT_ONCE_S else earlier_s > 0.0


@dataclass
class NameHolders:
    """Which process holds the name of each node: the oldest that beats under it."""

    _held: dict[str, tuple[ProcessIdentity, float]] = field(default_factory=dict)

    def is_holder(self, name: str, identity: ProcessIdentity, now_s: float) -> bool:
        """Note a beat under a name; return whether it comes from the holder of the name."""
        holder, heard_s = self._held.get(name, (identity, now_s))
        stays = identity.process == holder.process or identity.is_older(holder)
        if not stays and now_s - heard_s <= TAKE_OVER_S:
            return False
        self._held[name] = identity, now_s
        return True

    def leave(self, name: str, identity: ProcessIdentity) -> bool:
        """Note a last beat; return whether it comes from the holder of the name."""
        holder, _ = self._held.get(name, (identity, 0.0))
        if holder.process != identity.process:
            return False
        self._held.pop(name, None)
        return True


class SecondNodeError(ConfigurationError):
    """An older node has the name of this one."""

    def __init__(self, name: str, namespace: str, domain: str) -> None:
        super().__init__(
            f"node {name} already runs in {namespace} of ROS domain {domain or '0'}: this second "
            f"one ends, the first continues; {_HOW}"
        )


class OtherSessionError(RotcalError):
    """The nodes of the cell belong to another session than this process."""


def require_own_session(health: Any, environment: Mapping[str, str]) -> None:
    """Raise OtherSessionError if a node of the cell belongs to another session."""
    if SESSION_VARIABLE not in environment:
        return
    own = ProcessIdentity.own(environment, 0.0).session
    for name in NODES:
        beat = health.others.get(name)
        if beat is not None and beat.session != own:
            raise OtherSessionError(
                f"another calibration's nodes are at work here (node {name}: "
                f"{health.describe(name)}); they go on, this second start ends; {_HOW}"
            )


_DEAD: Final = ("Z", "X")
_STATE, _START = 0, 19
"""Indices of fields of ``/proc/PID/stat`` behind the name of the program."""


@cache
def host_identity() -> str:
    """Return a name for this machine and its space of process ids."""
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
        return cls(host_identity(), os.getpid(), _fields(os.getpid())[1])

    @property
    def is_of_here(self) -> bool:
        """Whether it runs on this machine."""
        return self.host == host_identity()

    @property
    def is_gone(self) -> bool:
        """Whether it is known to have ended; of another machine that is never known."""
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
