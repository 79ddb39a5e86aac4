"""Which process a node is: a name can be taken twice, and only the first one keeps it; no ROS."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final
from uuid import uuid4

from rotcal_ros.foundation.node_names import NODES
from rotcal_ros.foundation.units import NANOSECOND

SESSION_VARIABLE: Final = "ROTCAL_SESSION"
"""Environment variable: what all processes of one session have in common.

It begins with the monotonic time (ns) at which the session began.
"""
IDENTITY: Final = "identity"
"""Value in a beat: who beats."""
_HOW: Final = (
    "end the first ones, or give this one another ROS_DOMAIN_ID or another cell.namespace"
)
_DIGITS: Final = 20
_AT_ONCE_S: Final = 0.1
TAKE_OVER_S: Final = 0.7
"""A holder that is silent for longer loses its name to the node that beats under it."""


@dataclass(frozen=True, slots=True)
class ProcessIdentity:
    """A process of a session, and when that began, on the monotonic clock of who knows it.

    Beats tell ages, so that neither the clocks of two machines nor one that is set matter.
    """

    session: str
    process: str
    born_s: float

    @classmethod
    def own(cls, environment: Mapping[str, str], now_s: float) -> ProcessIdentity:
        """Return a new identity for this process; without a session it is one by itself."""
        process, session = uuid4().hex, environment.get(SESSION_VARIABLE, "")
        begun_ns, _, _ = session.partition("-")
        known = begun_ns.isdecimal() and len(begun_ns) < _DIGITS
        born_s = min(int(begun_ns) * NANOSECOND, now_s) if known else now_s
        return cls("".join(session.split()) or process, process, born_s)

    @classmethod
    def read(cls, text: str, now_s: float) -> ProcessIdentity | None:
        """Return what a beat says; None where it says nothing of the kind."""
        parts = text.split()
        if len(parts) != len(cls.__slots__) or not parts[2].isdecimal() or len(parts[2]) > _DIGITS:
            return None
        return cls(parts[0], parts[1], now_s - int(parts[2]) * NANOSECOND)

    def in_a_beat(self, now_s: float) -> str:
        """Return the identity as a beat holds it, with the age in ns."""
        return f"{self.session} {self.process} {round(max(0.0, now_s - self.born_s) / NANOSECOND)}"

    def is_older(self, other: ProcessIdentity) -> bool:
        """Return whether this process was there first; of two at once there is one order too."""
        earlier_s = other.born_s - self.born_s
        return self.process < other.process if abs(earlier_s) < _AT_ONCE_S else earlier_s > 0.0


def process_of(health: Any, name: str) -> str:
    """Return which process node ``name`` is, or was last; empty where that is not known."""
    identity = ProcessIdentity.read(health.values(name).get(IDENTITY, ""), 0.0)
    return "" if identity is None else identity.process


@dataclass
class NameHolders:
    """Who holds the name of each node: the oldest that beats under it."""

    _held: dict[str, tuple[ProcessIdentity | None, float]] = field(default_factory=dict)

    def is_holder(self, name: str, text: str, now_s: float) -> bool:
        """Take a beat with the identity ``text``; return whether it is that of the node."""
        identity = ProcessIdentity.read(text, now_s)
        holder, heard_s = self._held.get(name, (identity, now_s))
        older = identity is not None and (holder is None or identity.is_older(holder))
        if not _same(identity, holder) and not older and now_s - heard_s <= TAKE_OVER_S:
            return False
        self._held[name] = identity, now_s
        return True

    def leave(self, name: str, text: str, now_s: float) -> bool:
        """Take a farewell; return whether it is that of the node."""
        holder, _ = self._held.get(name, (None, 0.0))
        if holder is not None and not _same(holder, ProcessIdentity.read(text, now_s)):
            return False
        self._held.pop(name, None)
        return True


def _same(first: ProcessIdentity | None, second: ProcessIdentity | None) -> bool:
    return (first and first.process) == (second and second.process)


def refusal(
    name: str, place: str, own: ProcessIdentity, other: ProcessIdentity, domain: str
) -> str:
    """Say why a node ends that hears a beat of its own ``name``; empty: it does not.

    ``place`` is the namespace. The older of the two stays.
    """
    if own.is_older(other):
        return ""
    where = f"{place} of ROS domain {domain or '0'}"
    return f"node {name} runs already in {where}: this second one ends, the first goes on; {_HOW}"


def other_session(health: Any, environment: Mapping[str, str]) -> str:
    """Say which node of the cell is of another session; empty: none, or this process has none."""
    if SESSION_VARIABLE not in environment:
        return ""
    own = ProcessIdentity.own(environment, 0.0).session
    for name in NODES:
        identity = ProcessIdentity.read(health.values(name).get(IDENTITY, ""), 0.0)
        if identity is not None and identity.session != own:
            return (
                f"another calibration's nodes are at work here (node {name}: "
                f"{health.state(name)}); they go on, this second start ends; {_HOW}"
            )
    return ""
