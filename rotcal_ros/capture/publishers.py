"""Decides which publishers count: those that published a run's topics when it began.

Every listener of a cell judges each message itself, by the same list from the planner: what one
ignores all ignore, and the recorder keeps it apart.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, Final, Generic, TypeVar

from rotcal_ros.capture.messages import stamp_ns

T = TypeVar("T")

GID_BYTES: Final = 16
"""Significant bytes of a publisher's identity; some middlewares pad it with zeros."""
MOST_MISSED: Final = 10_000
"""This many messages of a publisher without identity may be missing between two that arrive."""
PATIENCE_S: Final = 2.0
"""A plan waits this long for the planner to confirm that it is its own."""


@dataclass(frozen=True, slots=True)
class MessageOrigin:
    """Where a message comes from: its publisher, and its number among the publisher's messages.

    ``publisher`` is empty and ``number`` None if the middleware does not provide them.
    """

    publisher: str = ""
    number: int | None = None


def publisher_of(identity: Sequence[int]) -> str:
    """Return the identity of a publisher, bytes, as text."""
    return bytes(identity[:GID_BYTES]).hex()


@dataclass(frozen=True)
class PublisherList:
    """The accepted publishers of each topic (absolute name); on other topics all are accepted."""

    publishers: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def to_heartbeat(self) -> str:
        """Return one line for a heartbeat; equal objects give equal lines."""
        return json.dumps(self.publishers, sort_keys=True) if self.publishers else ""

    @classmethod
    def read(cls, text: str) -> PublisherList:
        """Return the content of a line; one that cannot be read accepts everybody."""
        try:
            publishers = json.loads(text or "{}")
            return cls({str(topic): tuple(map(str, gids)) for topic, gids in publishers.items()})
        except (ValueError, TypeError, AttributeError):
            return cls()


Offers = Mapping[str, Mapping[str, str]]
"""Who publishes: topic -> identity of the publisher -> name of its node, absolute."""


def restarted_nodes(began: Offers, now: Offers) -> dict[str, list[str]]:
    """Return the topics of the nodes that were restarted since a run ``began``, by node.

    The publisher of that time is gone, and ``now`` there is a new one with the same node name. It
    may have lost its zero or its reference, so that only another run can accept it.
    """
    restarted: dict[str, list[str]] = {}
    for topic, then in began.items():
        here = now.get(topic, {})
        back = {node for publisher, node in here.items() if publisher not in then}
        for publisher, node in then.items():
            if publisher not in here and node in back:
                restarted.setdefault(node, []).append(topic)
    return restarted


@dataclass(frozen=True, slots=True)
class Intruder:
    """A publisher that is not accepted on a ``topic``; empty where it is not known."""

    topic: str
    publisher: str

    def describe(self, node: str | None, *, anew: bool = False) -> str:
        """Return a sentence for people; ``node`` published the messages, None: gone or not known.

        ``anew``: it has the name of an accepted node, or an accepted node is gone.
        """
        who = f"node {node}" if node else "a node that is gone"
        if anew:
            return (
                f"{self.topic}: {who} was restarted, or replaces the one with which the run "
                "began; its messages are ignored until another run begins"
            )
        return (
            f"{self.topic}: {who} publishes there too, but was not there when the run began; its "
            "messages are ignored and the run goes on; end that node, or give it another namespace"
        )


@dataclass
class PublisherFilter:
    """Decides for one listener; ``intruders`` are those met since the run began."""

    accepted: PublisherList = field(default_factory=PublisherList)
    intruders: list[Intruder] = field(default_factory=list)
    _last: dict[str, int] = field(default_factory=dict)

    def accept(self, accepted: PublisherList) -> None:
        """Accept these from now on; repeating them changes nothing."""
        if accepted != self.accepted:
            self.accepted = accepted
            self.intruders.clear()
            self._last.clear()

    def accepts(self, topic: str, origin: MessageOrigin) -> bool:
        """Return whether a message counts; the publisher of one that does not is noted.

        Without identities the message numbers decide: those of one publisher increase, and a
        publisher that began later counts from 1.
        """
        publishers = self.accepted.publishers.get(topic)
        if not publishers:
            return True
        if origin.publisher:
            accepted = origin.publisher in publishers
        else:
            accepted = self._follows(topic, origin.number)
        intruder = Intruder(topic, origin.publisher)
        if not accepted and intruder not in self.intruders:
            self.intruders.append(intruder)
        return accepted

    def _follows(self, topic: str, number: int | None) -> bool:
        last = self._last.get(topic)
        follows = number is None or last is None or 0 < number - last <= MOST_MISSED
        if follows and number is not None:
            self._last[topic] = number
        return follows


@dataclass
class HeardPublishers:
    """Tells the publishers of messages apart; its length is how many were heard.

    Without identities, as in Jazzy, the message numbers decide: those of one publisher increase.
    """

    identities: set[str] = field(default_factory=set)
    _latest: list[int] = field(default_factory=list)

    def __len__(self) -> int:
        return len(self.identities) + len(self._latest)

    def receive(self, origin: MessageOrigin) -> None:
        """Take a message; one with neither identity nor number counts as of the unknown one."""
        if origin.publisher or origin.number is None:
            self.identities.add(origin.publisher)
            return
        below = [n for n in self._latest if 0 < origin.number - n <= MOST_MISSED]
        if below:
            self._latest.remove(max(below))
        self._latest.append(origin.number)


RUN: Final = "run"
"""Value in a beat: the run of the plan that a node works for; see :func:`unique_run_name`."""


def unique_run_name(plan: Any) -> str:
    """Return a unique name for the run that a rotcal_msgs/CalibrationPlan announces."""
    return f"{plan.plan_id}@{stamp_ns(plan.header.stamp)}"


class PlanOwner(Enum):
    """Whose plan it is: the running goal's, one without a goal, or another planner's."""

    RUNNING_GOAL = "running goal"
    NO_GOAL = "no goal"
    OTHER_PLANNER = "other planner"


@dataclass
class _WaitingPlan(Generic[T]):
    plan: T
    since_s: float
    in_a_goal: bool = False


@dataclass
class PendingPlans(Generic[T]):
    """The plans that arrived, each until it is known whose it is.

    While a goal runs only its plan counts: one that arrives meanwhile and is not confirmed by the
    planner in time belongs to someone else, even if the goal has ended by then. While the planner
    has no goal every plan counts. So it does without a planner, after a moment: a node that was
    just started may not have heard the planner yet.
    """

    _waiting: dict[str, _WaitingPlan[T]] = field(default_factory=dict)

    def offer(self, run: str, plan: T, now_s: float) -> None:
        """Take a plan, which announces ``run``; repeating it changes nothing."""
        self._waiting.setdefault(run, _WaitingPlan(plan, now_s))

    def with_known_owner(
        self, goals_run: str | None, now_s: float
    ) -> Iterator[tuple[T, PlanOwner]]:
        """Yield each plan once, as soon as it is known whose it is.

        ``goals_run`` is the run of the planner's goal, "" where it has none, and None if no
        planner has been heard of.
        """
        for run, waiting in tuple(self._waiting.items()):
            waiting.in_a_goal |= bool(goals_run) and goals_run != run
            late = now_s - waiting.since_s > PATIENCE_S
            if goals_run == run:
                whose = PlanOwner.RUNNING_GOAL
            elif waiting.in_a_goal and late:
                whose = PlanOwner.OTHER_PLANNER
            elif not waiting.in_a_goal and (goals_run == "" or late):
                whose = PlanOwner.NO_GOAL
            else:
                continue
            del self._waiting[run]
            yield waiting.plan, whose
