"""Who is heard: a run believes those who published its topics when it began, and nobody else.

Every listener of a cell judges message by message, each for itself, by the same words of the
planner: what one leaves alone all leave alone, and the recorder keeps apart.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Final, Generic, TypeVar

T = TypeVar("T")

GID_BYTES: Final = 16
"""Bytes of a publisher's identity that tell it; some middlewares pad it with zeros."""
MOST_MISSED: Final = 10_000
"""So many messages of a publisher without identity may be missing between two that come."""
PATIENCE_S: Final = 2.0
"""So long a plan waits for the planner to say that it is its own."""


@dataclass(frozen=True, slots=True)
class Origin:
    """Where a message comes from: who published it, and as its how-manieth.

    ``publisher`` is empty and ``number`` None where the middleware does not say that.
    """

    publisher: str = ""
    number: int | None = None


def publisher_of(identity: Sequence[int]) -> str:
    """Return the identity of a publisher, bytes, as text."""
    return bytes(identity[:GID_BYTES]).hex()


@dataclass(frozen=True)
class Believed:
    """Who is believed on each topic (absolute name), as a run has found it; others are free."""

    publishers: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def in_a_beat(self) -> str:
        """Return it as one line: equal ones are equal lines."""
        return json.dumps(self.publishers, sort_keys=True) if self.publishers else ""

    @classmethod
    def read(cls, text: str) -> Believed:
        """Return what a line says; what cannot be read believes everybody."""
        try:
            known = json.loads(text or "{}")
            return cls({str(topic): tuple(map(str, gids)) for topic, gids in known.items()})
        except (ValueError, TypeError, AttributeError):
            return cls()


Offers = Mapping[str, Mapping[str, str]]
"""Who publishes: topic -> identity of the publisher -> name of its node, absolute."""


def started_anew(began: Offers, now: Offers) -> dict[str, list[str]]:
    """Return which nodes, heard when a run ``began``, publish ``now`` as others: their topics.

    The one that was heard is gone, and a new one of its name is there. It may have lost its zero
    or its reference, so that only another run can hear it.
    """
    found: dict[str, list[str]] = {}
    for topic, then in began.items():
        here = now.get(topic, {})
        back = {node for publisher, node in here.items() if publisher not in then}
        for publisher, node in then.items():
            if publisher not in here and node in back:
                found.setdefault(node, []).append(topic)
    return found


@dataclass(frozen=True, slots=True)
class Intruder:
    """Somebody who is not believed on a ``topic``, and how many messages were left alone.

    ``since_s`` is the time of the first one; ``publisher`` is empty where that is not known.
    """

    topic: str
    publisher: str
    since_s: float
    count: int = 1

    def in_words(self, node: str, *, anew: bool = False) -> str:
        """Say it to people; ``node`` published them, empty: one that left or nobody knows.

        ``anew``: it has the name of one that is heard, or that one is gone.
        """
        who = f"node {node}" if node else "a node that is gone"
        if anew:
            return (
                f"{self.topic}: {who} was restarted, or replaces the one with which the run "
                "began; its messages are left alone until another run begins"
            )
        return (
            f"{self.topic}: {who} publishes there too, and was not there when the run began; its "
            "messages were left alone, the run goes on without them; end that node, or give it "
            "another namespace"
        )


@dataclass
class WhoIsHeard:
    """The judge of one listener; ``intruders`` are those it has met since the run began."""

    believed: Believed = field(default_factory=Believed)
    intruders: dict[tuple[str, str], Intruder] = field(default_factory=dict)
    _last: dict[str, int] = field(default_factory=dict)

    def believe(self, believed: Believed) -> None:
        """Believe these from now on; the same again changes nothing."""
        if believed != self.believed:
            self.believed = believed
            self.intruders.clear()
            self._last.clear()

    def hears(self, topic: str, origin: Origin, now_s: float) -> bool:
        """Return whether a message counts; who is not believed is noted.

        Without identities only the numbers tell: those of one publisher ascend, and somebody who
        began later counts from 1 anew.
        """
        known = self.believed.publishers.get(topic)
        if not known:
            return True
        if origin.publisher:
            believed = origin.publisher in known
        else:
            believed = self._follows(topic, origin.number)
        if not believed:
            key = (topic, origin.publisher)
            met = self.intruders.get(key)
            self.intruders[key] = (
                Intruder(topic, origin.publisher, now_s)
                if met is None
                else replace(met, count=met.count + 1)
            )
        return believed

    def _follows(self, topic: str, number: int | None) -> bool:
        last = self._last.get(topic)
        follows = number is None or last is None or 0 < number - last <= MOST_MISSED
        if follows and number is not None:
            self._last[topic] = number
        return follows

    def met(self) -> Iterator[Intruder]:
        """Yield the intruders in the order in which they came."""
        yield from sorted(self.intruders.values(), key=lambda intruder: intruder.since_s)


class Whose(Enum):
    """What a plan is: of the goal that runs, of nobody in particular, of a stranger to a goal."""

    THE_GOALS = "the goal's"
    ANYBODYS = "anybody's"
    A_STRANGERS = "a stranger's"


@dataclass
class _WaitingPlan(Generic[T]):
    plan: T
    since_s: float
    in_a_goal: bool = False


@dataclass
class PlansHeard(Generic[T]):
    """The plans that came in, each until it is known whose it is.

    While a goal runs its plan alone counts: one that came meanwhile and is not vouched for in
    time is a stranger's, even if the goal has ended by then. While the planner has no goal every
    plan counts, and without a planner too, after a moment: who has just been started does not
    know it yet.
    """

    _waiting: dict[str, _WaitingPlan[T]] = field(default_factory=dict)

    def offer(self, run: str, plan: T, now_s: float) -> None:
        """Take in a plan, which announces ``run``; the same again changes nothing."""
        self._waiting.setdefault(run, _WaitingPlan(plan, now_s))

    def judged(self, goals_run: str | None, now_s: float) -> Iterator[tuple[T, Whose]]:
        """Yield each plan of which it is known now whose it is, once.

        ``goals_run`` is the run that the planner vouches for; empty: it has no goal, None: nobody
        knows a planner.
        """
        for run, waiting in tuple(self._waiting.items()):
            waiting.in_a_goal |= bool(goals_run) and goals_run != run
            late = now_s - waiting.since_s > PATIENCE_S
            if goals_run == run:
                whose = Whose.THE_GOALS
            elif waiting.in_a_goal and late:
                whose = Whose.A_STRANGERS
            elif not waiting.in_a_goal and (goals_run == "" or late):
                whose = Whose.ANYBODYS
            else:
                continue
            del self._waiting[run]
            yield waiting.plan, whose
