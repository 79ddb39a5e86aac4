"""Which process a node is: a name can be taken twice, and only the first one keeps it; no ROS."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final
from uuid import uuid4

from rotcal_ros.foundation.errors import RotcalError
from rotcal_ros.foundation.node_names import NODES
from rotcal_ros.foundation.units import NANOSECOND

SESSION_VARIABLE: Final = "ROTCAL_SESSION"
"""Environment variable: what all processes of one session have in common.

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
    def of(cls, beat: Any, now_s: float) -> ProcessIdentity:
        """Return who sent a beat, a NodeState."""
        return cls(beat.session, beat.process, now_s - beat.age * NANOSECOND)

    def age_ns(self, now_s: float) -> int:
        """Return how long ago it began, as a beat tells it."""
        return round(max(0.0, now_s - self.born_s) / NANOSECOND)

    def is_older(self, other: ProcessIdentity) -> bool:
        """Return whether this process was there first; of two at once there is one order too."""
        earlier_s = other.born_s - self.born_s
        return self.process < other.process if abs(earlier_s) < _AT_ONCE_S else earlier_s > 0.0


@dataclass
class NameHolders:
    """Who holds the name of each node: the oldest that beats under it."""

    _held: dict[str, tuple[ProcessIdentity, float]] = field(default_factory=dict)

    def is_holder(self, name: str, identity: ProcessIdentity, now_s: float) -> bool:
        """Take a beat under a name; return whether it is that of the node."""
        holder, heard_s = self._held.get(name, (identity, now_s))
        stays = identity.process == holder.process or identity.is_older(holder)
        if not stays and now_s - heard_s <= TAKE_OVER_S:
            return False
        self._held[name] = identity, now_s
        return True

    def leave(self, name: str, identity: ProcessIdentity) -> bool:
        """Take a farewell; return whether it is that of the node."""
        holder, _ = self._held.get(name, (identity, 0.0))
        if holder.process != identity.process:
            return False
        self._held.pop(name, None)
        return True


def second_of_its_name(name: str, place: str, domain: str) -> str:
    """Say why a node ends whose ``name`` in the namespace ``place`` an older one has."""
    where = f"{place} of ROS domain {domain or '0'}"
    return f"node {name} runs already in {where}: this second one ends, the first goes on; {_HOW}"


class OtherSessionError(RotcalError):
    """The nodes of the cell belong to another session than this process."""


def require_own_session(health: Any, environment: Mapping[str, str]) -> None:
    """Raise OtherSessionError where a node of the cell is of another session than this process."""
    if SESSION_VARIABLE not in environment:
        return
    own = ProcessIdentity.own(environment, 0.0).session
    for name in NODES:
        beat = health.others.get(name)
        if beat is not None and beat.session != own:
            raise OtherSessionError(
                f"another calibration's nodes are at work here (node {name}: "
                f"{health.in_words(name)}); they go on, this second start ends; {_HOW}"
            )
