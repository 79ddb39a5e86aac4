"""What the recorder counts: lost messages, silent streams, receipts that are due. Needs no ROS."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import inf
from typing import Final

from rotcal_ros.bags import names

NEVER_PAUSE: Final = (
    names.TRACER_LENGTH, names.JOINT_STATES, names.TEMPERATURE, names.AIR_PRESSURE,
    names.RELATIVE_HUMIDITY,
)  # fmt: skip
"""Roles of the streams that are watched, once somebody publishes them."""
NEEDED: Final = ((names.TRACER_LENGTH, names.PROBE_POINT), (names.JOINT_STATES,))
"""Before an observation is confirmed, readings of one role of each row must have come."""


class TopicLosses:
    """Losses by gaps in the publishers' numbers, and by the reports of the middleware.

    The numbers do not cover what a publisher sent before the first or after the last message that
    arrived; reports come too late or, from some middlewares, never. Both count the same messages,
    so the larger number is the better one.
    """

    def __init__(self) -> None:
        self._sequences: dict[bytes, int] = {}
        self._gaps = 0
        self._reported = 0

    @property
    def count(self) -> int:
        """Number of lost messages since :meth:`forget`."""
        return max(self._gaps, self._reported)

    def forget(self) -> None:
        """Count from zero; the numbers of the publishers go on."""
        self._gaps = self._reported = 0

    def number(self, number: int | None, publisher: bytes) -> int | None:
        """Take the number that ``publisher`` gave a message; None or 0 if it gives none.

        Return how many messages before it are newly known to be lost, 0 if they had been
        reported; None if nothing is missing.
        """
        if not number:
            return None
        gap = number - self._sequences.get(publisher, number - 1) - 1
        self._sequences[publisher] = number
        if gap <= 0:
            return None
        known, self._gaps = self.count, self._gaps + gap
        return self.count - known

    def report(self, lost: int) -> int:
        """Take a report of ``lost`` further messages; return how many were not known before."""
        known, self._reported = self.count, self._reported + lost
        return self.count - known


@dataclass(frozen=True, slots=True)
class SilentInterval:
    """A silence of ``topic`` between two messages, in monotonic time (s)."""

    topic: str
    from_s: float
    to_s: float


class SilenceMonitor:
    """Silences since the beginning; ``counts`` holds their number by ``silent <topic>``."""

    def __init__(self, limit_s: float, now_s: float) -> None:
        self._limit_s = limit_s
        self._begun_s = now_s
        self._silent: dict[str, float] = {}
        self.counts: Counter[str] = Counter()

    def poll(self, heard_s: Mapping[str, float], now_s: float) -> list[SilentInterval]:
        """Take the times at which streams that never pause were last heard, by topic.

        Return the silences that have ended.
        """
        ended = []
        for topic, last_s in heard_s.items():
            since_s = max(last_s, self._begun_s)
            if topic in self._silent and since_s > self._silent[topic]:
                ended.append(SilentInterval(topic, self._silent.pop(topic), since_s))
            if topic not in self._silent and now_s - since_s > self._limit_s:
                self._silent[topic] = since_s
                self.counts[f"{names.SILENT} {topic}"] += 1
        return ended

    def end(self, now_s: float) -> list[SilentInterval]:
        """Return the silences that the end of the bag cuts off."""
        silent, self._silent = self._silent, {}
        return [SilentInterval(topic, since_s, now_s) for topic, since_s in silent.items()]


JUMP_ON_ITS_WAY_S: Final = 60.0
"""How long after a clock was set messages with older stamps may still arrive."""


class LogTimes:
    """Log times in the order of a topic: none goes back, unless the clock of this machine did.

    Messages that wait for a packet that is sent again arrive together with it: a message has
    arrived when it can be taken. ``jumps`` counts the jumps of the clock so far.
    """

    def __init__(
        self, jumps: Callable[[], int], read: Callable[[], float] = time.monotonic
    ) -> None:
        self._jumps, self._read = jumps, read
        self._latest: dict[str, int] = {}
        self._seen, self._set_s = jumps(), -inf

    def ascending(self, topic: str, times_ns: Sequence[int]) -> list[int]:
        """Return the log times of messages of a topic that arrived at ``times_ns``."""
        latest, found = self._latest.get(topic, 0), list[int]()
        for time_ns in times_ns:
            latest = time_ns if time_ns >= latest or self._was_set() else latest
            found.append(latest)
        self._latest[topic] = latest
        return found

    def _was_set(self) -> bool:
        if (jumps := self._jumps()) != self._seen:
            self._seen, self._set_s = jumps, self._read()
        return self._read() - self._set_s < JUMP_ON_ITS_WAY_S


_SETTLED_NS: Final = 1_000_000_000
"""This long after a clock was set back, no earlier observation is still on its way."""
PATIENCE_S: Final = 2.0
"""How long an observation waits for the point that answers its order, once all else is here."""


@dataclass(frozen=True, slots=True)
class WriteReceipt:
    """Confirms that everything before it is on disk, except ``lost`` messages."""

    step: int
    attempt: int
    lost: int = 0


@dataclass(frozen=True, slots=True)
class _WaitingObservation:
    """An observation without a receipt.

    All but its point has been here since ``all_else_s`` (monotonic time).
    """

    window_end_ns: int
    receipt: WriteReceipt
    all_else_s: float | None = None


class PendingReceipts:
    """Observations that wait for their receipts: readings may still be on their way.

    If the clock of the readings is set back, the readings of all earlier windows have come. Where
    orders are ``answered`` by points that echo them, each observation of an order waits for its
    own; one that does not come within ``PATIENCE_S`` after all else is lost. What the table passes
    later in a turn was not ordered, and is answered by no point.
    """

    def __init__(self, *, answered: bool) -> None:
        self._answers: set[tuple[int, int]] | None = set() if answered else None
        self._ordered: dict[tuple[int, int], bool] = {}  # whether the order begins a turn
        self._waiting: list[_WaitingObservation] = []
        self._lost = 0
        self._reached_ns = 0
        self._set_back: tuple[int, int] | None = None  # from one stamp to another

    def reach(self, reached_ns: int) -> None:
        """Note the latest stamp of the readings."""
        if reached_ns < self._reached_ns:
            self._set_back = self._reached_ns, reached_ns
        elif self._set_back is not None and reached_ns > self._set_back[1] + _SETTLED_NS:
            self._set_back = None
        self._reached_ns = reached_ns

    def _has_come(self, window_end_ns: int, reached_ns: int | None) -> bool:
        if reached_ns is None or reached_ns >= window_end_ns:
            return True
        return self._set_back is not None and window_end_ns > sum(self._set_back) // 2

    def answer(self, step: int, attempt: int) -> None:
        """Note that a point has come which echoes an order."""
        if self._answers is not None:
            self._answers.add((step, attempt))

    def order(self, step: int, attempt: int, *, turn: bool) -> None:
        """Note an order, and whether it begins a ``turn``."""
        self._ordered[step, attempt] = turn

    def expect(self, step: int, attempt: int, window_end_ns: int) -> None:
        """Note an observation that needs a receipt."""
        self._waiting.append(_WaitingObservation(window_end_ns, WriteReceipt(step, attempt)))

    def due(self, reached_ns: int | None, lost: int, now_s: float) -> Iterator[WriteReceipt]:
        """Yield what can be confirmed now that the readings have come to ``reached_ns``.

        None: there is no such stream. ``lost`` counts the losses since the bag was opened; each
        receipt reports those since the previous one, and its point if that is lost. The clock of
        ``now_s`` stands still while this process does.
        """
        if reached_ns is not None:
            self.reach(reached_ns)
        waiting, self._waiting = self._waiting, []
        for observed in waiting:
            if not self._has_come(observed.window_end_ns, reached_ns):
                self._waiting.append(observed)
                continue
            answered = self.is_answered(observed.receipt)
            since_s = now_s if observed.all_else_s is None else observed.all_else_s
            if answered or now_s - since_s > PATIENCE_S:
                yield replace(observed.receipt, lost=lost - self._lost + (not answered))
                self._lost = lost
            else:
                self._waiting.append(replace(observed, all_else_s=since_s))

    def is_answered(self, receipt: WriteReceipt) -> bool:
        """Return whether the point that echoes this order has come, or none echoes it."""
        key = (receipt.step, receipt.attempt)
        if self._answers is None or key in self._answers:
            return True
        return key not in self._ordered and any(
            turn and begun[0] < receipt.step and begun[1] == receipt.attempt
            for begun, turn in self._ordered.items()
        )

    def __bool__(self) -> bool:
        return bool(self._waiting)
