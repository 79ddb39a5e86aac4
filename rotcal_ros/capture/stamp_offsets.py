"""Clocks of instruments that differ: stamps are compared with the times of arrival.

Streams stamped by one clock arrive equally late: a constant difference is an offset of their
clocks (or an equal delay, which does the same harm). Stamps that do not run at the pace of
arrival, as in an accelerated simulation, are not judged.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from math import inf
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from rotcal_ros.capture.settings import CaptureSettings
from rotcal_ros.foundation.language import Phrase, phrase
from rotcal_ros.foundation.observations import Observation
from rotcal_ros.foundation.units import NANOSECOND

LENGTHS: Final = "tracer_length"
REFERENCE: Final = "joint_states"
"""The stream that the others are compared with: it never pauses."""
_OPENING: Final = "by the times of arrival the stamps of "
"""Beginning of the reason for which an observation is rejected because clocks differ."""
_OWNERS: Final = {"tracer_length": "length", "joint_states": "table", "probe_point": "probe"}
"""Stream -> how the settings of its clock begin in the group ``topics``."""
_BUCKET_NS: Final = 250_000_000
_BUCKETS: Final = 3
"""An offset is known when it is the same in this many intervals in a row."""
_SPREAD_NS: Final = 200_000_000
"""Offsets that differ by less are the same."""
_EVENTS: Final = 4
"""This many messages of a stream that comes now and then must agree."""
DOUBT_S: Final = 0.2
"""An offset (s) that is only reported, if it lasts ``_LASTING`` intervals."""
_LASTING: Final = 8
_NEWEST: Final = _LASTING + 1
"""Of many messages at once, only those of this many intervals are used."""
_Far = tuple[str, int, int | None]
"""A stream, and by how much its stamps and its arrival are ahead of the reference, ns."""


@dataclass(frozen=True, slots=True)
class OffsetLimits:
    """Offsets (s) beyond which observations are spoilt.

    ``at_once_s`` counts for any stream, either way; ``ahead_s`` for lengths whose stamps have been
    ahead of the table's for a while.
    """

    at_once_s: float = inf
    ahead_s: float = inf

    @classmethod
    def of(cls, settings: CaptureSettings) -> OffsetLimits:
        """Return what is allowed: a window may not begin before the table has come to rest."""
        return cls(settings.stamp_offset_s, max(settings.settle_time_s, DOUBT_S))


class StampOffsets:
    """Estimates constant offsets between streams; more than the ``limits`` spoils observations."""

    def __init__(self, limits: OffsetLimits) -> None:
        self.limits = limits
        self._ahead: dict[str, dict[int, int]] = {}
        self._events: dict[str, dict[int, int]] = {}
        self._first: dict[str, tuple[int, int]] = {}

    def note(self, stream: str, stamp_ns: int, received_ns: int) -> None:
        """Take a message; both times in ns since the same instant."""
        bucket, ahead_ns = received_ns // _BUCKET_NS, stamp_ns - received_ns
        self._keep(stream, bucket, ahead_ns)
        self._keep_event(stream, bucket, ahead_ns)

    def forget(self, stream: str) -> None:
        """Begin anew with a stream: it is another one, or stamped by another clock."""
        self._ahead.pop(stream, None)
        self._events.pop(stream, None)
        self._first.clear()

    def note_many(self, stream: str, stamps: NDArray[Any], received: NDArray[Any]) -> None:
        """Take many messages of a stream, arrays (n,) of int64 ns."""
        buckets = received // _BUCKET_NS
        for bucket in np.unique(buckets)[-_NEWEST:].tolist():
            ahead = (stamps - received)[buckets == bucket]
            self._keep(stream, bucket, int(ahead.max()))
            self._keep_event(stream, bucket, int(ahead[0]))

    def reason_to_reject(self) -> Phrase | None:
        """Return which stream differs from the table's by how much, if by more than allowed."""
        if far := self._far(self.limits.at_once_s, _BUCKETS, _BUCKETS):
            return phrase(
                "by the times of arrival the stamps of {0}, allowed {1:g} s "
                "(capture.stamp_offset_s): two clocks, synchronise them{2}",
                _constantly(far, 1), self.limits.at_once_s, self._advice(*far)
            )  # fmt: skip
        if far := self._lengths_ahead():
            return phrase(
                "by the times of arrival the stamps of {0}, and stay so: more than the {1:g} s of "
                "settling (capture.settle_time_s), so a length may be from the motion before; two "
                "clocks, or feedback that comes late (a longer time outlasts it){2}",
                _constantly(far, 2), self.limits.ahead_s, self._advice(*far)
            )  # fmt: skip
        return None

    def doubt(self) -> str | None:
        """Return which stream differs by more than ``DOUBT_S``, though nothing is rejected."""
        if self._offset_ns(REFERENCE, _LASTING) is None or self.reason_to_reject():
            return None
        if far := self._far(DOUBT_S, _LASTING, _EVENTS):
            return (
                f"stamps of {_constantly(far, 2)} by the times of arrival: a clock is off, or a "
                "stream comes late; nothing is rejected for so little, but readings may be older "
                f"or younger than they seem{self._advice(*far)}"
            )
        return None

    def compared(self) -> tuple[str, ...]:
        """Return the streams whose offset from the table's is known."""
        others = sorted(self._ahead.keys() - {REFERENCE})
        return tuple(s for s in others if self._difference_ns(s, _LASTING, _EVENTS) is not None)

    def _lengths_ahead(self) -> _Far | None:
        """Return by how much stamps of lengths are too late, if that spoils them.

        Lengths with too early stamps were taken in the same rest, only later.
        """
        ahead_ns = self._difference_ns(LENGTHS, _LASTING) or 0
        spoilt = ahead_ns * NANOSECOND > self.limits.ahead_s
        return (LENGTHS, ahead_ns, self._offset_ns(REFERENCE, _LASTING)) if spoilt else None

    def _far(self, limit_s: float, intervals: int, shots: int) -> _Far | None:
        """Return the first stream that differs by more than the limit, either way."""
        for stream in sorted(self._ahead.keys() - {REFERENCE}):
            difference = self._difference_ns(stream, intervals, shots) or 0
            if abs(difference) * NANOSECOND > limit_s:
                return stream, difference, self._offset_ns(REFERENCE, intervals)
        return None

    def _difference_ns(self, stream: str, intervals: int, shots: int | None = None) -> int | None:
        """Return how far a stream is ahead of the table's, over so many intervals or ``shots``.

        None: not known. An instrument that is asked may answer late: ``shots`` None leaves it out.
        """
        offset_ns, reference_ns = (self._offset_ns(s, intervals) for s in (stream, REFERENCE))
        if offset_ns is not None and reference_ns is not None:
            difference = offset_ns - reference_ns
            self._first.setdefault(stream, (max(self._ahead[stream]), difference))
            return difference
        return _agreed(self._events.get(stream, {}).values(), shots) if shots else None

    def check_clocks(self, observation: Observation) -> Observation:
        """Return an observation, rejected if the clocks of its streams differ."""
        return reject_observation(self.reason_to_reject(), observation)

    def _advice(self, stream: str, difference_ns: int, reference_ns: int | None) -> str:
        """Return whose clock is off, as far as known, and what to do."""
        far, sign, text = stream, 1.0, ""
        if reference_ns is not None:
            arrival_ns = difference_ns + reference_ns  # stamps of the stream - times of arrival
            if abs(arrival_ns) <= abs(reference_ns):
                far, sign = REFERENCE, -1.0
            text = f"; the stamps of {far} are not its times of arrival"
        owner = _OWNERS.get(far, "length")
        text += (
            f"; if it stays so, add {sign * difference_ns * NANOSECOND:.2f} to "
            f"topics.{owner}_clock_offset_s"
        )
        if (drift := self._drift(stream, difference_ns)) is not None:
            text += (
                f"; but it drifts, by {1e3 * sign * drift:+.3g} ms in a second: use the times of "
                f"sending (topics.{owner}_clock: sent)"
            )
        return text

    def _drift(self, stream: str, difference_ns: int) -> float | None:
        """Return the drift (s/s) of a stream's clock against the table's, if it is certain."""
        bucket, first_ns = self._first.get(stream, (0, difference_ns))
        seconds = (max(self._ahead[stream]) - bucket) * _BUCKET_NS * NANOSECOND
        if abs(difference_ns - first_ns) < _SPREAD_NS or seconds <= 0.0:
            return None
        return (difference_ns - first_ns) * NANOSECOND / seconds

    def _keep_event(self, stream: str, bucket: int, ahead_ns: int) -> None:
        """Keep the first message of an interval, for a stream that comes now and then."""
        events = self._events.setdefault(stream, {})
        if stream == REFERENCE or bucket in events:
            return
        reference_ns = self._offset_ns(REFERENCE)
        if reference_ns is not None:
            events[bucket] = ahead_ns - reference_ns
            while len(events) > _EVENTS:
                del events[next(iter(events))]

    def _keep(self, stream: str, bucket: int, ahead_ns: int) -> None:
        ahead = self._ahead.setdefault(stream, {})
        ahead[bucket] = max(ahead_ns, ahead.get(bucket, ahead_ns))
        for old in [b for b in ahead if b < bucket - _LASTING]:
            del ahead[old]

    def _offset_ns(self, stream: str, intervals: int = _BUCKETS) -> int | None:
        """Return how far the stamps of a stream are ahead of their arrival; None: not constant."""
        known = self._ahead.get(stream)
        if not known:
            return None
        newest = max(bucket for ahead in self._ahead.values() for bucket in ahead)
        wanted = range(newest - intervals, newest)  # the newest one is not at its end
        if not all(bucket in known for bucket in wanted):
            return None
        return _agreed([known[bucket] for bucket in wanted])


def reject_observation(reason: Phrase | None, observation: Observation) -> Observation:
    """Return an observation, rejected for a ``reason``; a reason of its own stays."""
    if not reason or not observation.accepted:
        return observation
    return replace(observation, accepted=False, reason=reason)


def is_clock_rejection(reason: str) -> bool:
    """Return whether an observation was rejected because clocks differ."""
    return reason.startswith(_OPENING)


def _constantly(far: _Far, digits: int) -> str:
    stream, difference_ns, _ = far
    way = "ahead of" if difference_ns > 0 else "behind"
    off = f"{abs(difference_ns) * NANOSECOND:.{digits}f} s {way}"
    return f"{stream} are constantly {off} those of {REFERENCE}"


def _agreed(values: Collection[int], least: int = _BUCKETS) -> int | None:
    """Return the largest of values (ns) that are about the same: the least delayed one."""
    if len(values) < least or max(values) - min(values) > _SPREAD_NS:
        return None
    return int(max(values))
