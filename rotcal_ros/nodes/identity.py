"""Which process a node is: a name can be taken twice, and only the first one keeps it; no ROS."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import astuple, dataclass, field
from typing import Any, Final
from uuid import uuid4

from rotcal_ros.node_names import NODES

SESSION_VARIABLE: Final = "ROTCAL_SESSION"
"""Environment variable: what all processes of one session have in common, its start first."""
IDENTITY: Final = "identity"
"""Value in a beat: who beats."""
_HOW: Final = (
    "end the first ones, or give this one another ROS_DOMAIN_ID or another cell.namespace"
)
TAKE_OVER_S: Final = 0.7
"""A holder that is silent for longer gives its name to whoever beats under it."""


@dataclass(frozen=True, order=True, slots=True)
class Identity:
    """A process, ordered by age: first that of its session (ns since 1970), then its own."""

    session_ns: int
    session: str
    begun_ns: int
    process: str

    @classmethod
    def own(cls, environment: Mapping[str, str]) -> Identity:
        """Return a new identity for this process; without a session it is one by itself."""
        now_ns, process = time.time_ns(), uuid4().hex
        begun, _, session = environment.get(SESSION_VARIABLE, "").partition("-")
        if not begun.isdigit():
            begun, session = str(now_ns), process
        return cls(int(begun), session, now_ns, process)

    @classmethod
    def read(cls, text: str) -> Identity | None:
        """Return what a beat says; None where it says nothing of the kind."""
        parts = text.split()
        if len(parts) != len(cls.__slots__) or not (parts[0] + parts[2]).isdigit():
            return None
        return cls(int(parts[0]), parts[1], int(parts[2]), parts[3])

    def __str__(self) -> str:
        """Return the identity as a beat holds it."""
        return " ".join(map(str, astuple(self)))


@dataclass
class NameHolders:
    """Who holds the name of each node: the oldest that beats under it."""

    _held: dict[str, tuple[Identity | None, float]] = field(default_factory=dict)

    def is_holder(self, name: str, text: str, now_s: float) -> bool:
        """Take a beat with the identity ``text``; return whether it is that of the node."""
        identity = Identity.read(text)
        holder, heard_s = self._held.get(name, (identity, now_s))
        older = identity is not None and (holder is None or identity <= holder)
        if identity != holder and not older and now_s - heard_s <= TAKE_OVER_S:
            return False
        self._held[name] = identity, now_s
        return True

    def leave(self, name: str, text: str) -> bool:
        """Take a farewell; return whether it is that of the node."""
        holder, _ = self._held.get(name, (None, 0.0))
        if holder is not None and holder != Identity.read(text):
            return False
        self._held.pop(name, None)
        return True


def refusal(
    name: str, place: str, own: Identity, text: str, environment: Mapping[str, str]
) -> str:
    """Say why a node ends that hears a beat of its own ``name``; empty: it does not.

    ``place`` is the namespace. The older of the two stays.
    """
    other = Identity.read(text)
    if other is None or other == own or own < other:
        return ""
    where = f"{place} of ROS domain {environment.get('ROS_DOMAIN_ID') or '0'}"
    return f"node {name} runs already in {where}: this second one ends, the first goes on; {_HOW}"


def other_session(health: Any, environment: Mapping[str, str]) -> str:
    """Say which node of the cell is of another session; empty: none, or this process has none."""
    if SESSION_VARIABLE not in environment:
        return ""
    own = Identity.own(environment).session
    for name in NODES:
        identity = Identity.read(health.values(name).get(IDENTITY, ""))
        if identity is not None and identity.session != own:
            return (
                f"another calibration's nodes are at work here (node {name}: "
                f"{health.state(name)}); they go on, this second start ends; {_HOW}"
            )
    return ""
