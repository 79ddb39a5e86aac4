"""One stream of samples in the order of its own stamps: checked, counted, bounded in memory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rotcal_ros.foundation.arrays import Floats, Stamps, differences_from

CAPACITY = 1 << 17
"""A stream remembers at least this many samples: two minutes at 1 kHz."""

_NEW_CLOCK_AFTER = 10
"""This many samples in a row beyond the tolerance mean that the stream had paused; this many
behind the latest one, that its clock was set back,"""
_SET_BACK_AFTER_NS = 100_000_000
"""where they span this much time."""
_STAGE = 4096
"""Most samples that are staged before a decision."""
NEVER = 1 << 63

Sample = tuple[int, Floats]
"""A stamp and its values (width,)."""


@dataclass
class StreamCounts:
    """What a stream delivered and what was wrong with it.

    ``lost`` counts the samples missing according to the sequence numbers, ``out_of_order``
    sequence numbers going backwards (two publishers?). Samples that are ``duplicates``, stamped
    ``backwards`` or by a ``foreign_clock`` are dropped; those with other values for the same stamp
    or order are ``contradicting``. ``set_back`` counts how often the clock was set back. Commands
    are ``unanswered`` if the next one came before a probe sample echoed them.
    """

    received: int = 0
    duplicates: int = 0
    contradicting: int = 0
    backwards: int = 0
    foreign_clock: int = 0
    lost: int = 0
    out_of_order: int = 0
    beam_broken: int = 0
    unstable: int = 0
    non_finite: int = 0
    implausible: int = 0
    unknown_step: int = 0
    off_plan: int = 0
    set_back: int = 0
    unanswered: int = 0


class Stream:
    """Stamps (n,) in strictly ascending order with their values (n, width).

    Single samples are staged and admitted many at a time by :meth:`flush`; :meth:`admit`
    takes arrays. Both ways end in the same state. A stamp that does not ascend is dropped; so
    is one that jumps ahead by more than the clock tolerance, unless ten in a row do (then the
    stream had paused). If ten in a row ascend behind the latest one, over 0.1 s, the clock was set
    back: the stream begins anew with them and forgets the earlier ones. A ``single_shot`` stream
    sends now and then, one sample or a burst: no pause is too long.
    """

    def __init__(self, width: int, clock_tolerance_ns: int, *, single_shot: bool = False) -> None:
        self.single_shot = single_shot
        self.counts = StreamCounts()
        self.latest: int | None = None
        self.forgotten: int | None = None  # stamp of the newest sample no longer in memory
        # A new decision is due at a staged stamp from wake_ns on, once wake_samples are staged;
        # from wake_latest_ns on in any case.
        self.wake_ns, self.wake_samples, self.wake_latest_ns = NEVER, 1, NEVER
        self._tolerance_ns = NEVER if single_shot else clock_tolerance_ns
        self.set_back_ns = 0  # how far the clock was set back the last time,
        self.set_back_at: int | None = None  # and the latest stamp before that
        self._ahead = 0
        self._behind: list[Sample] = []
        self._staged_to = -NEVER
        self._newest: Floats | None = None
        self._size = 0
        self._stamps = np.empty(1024, dtype=np.int64)
        self._values = np.empty((1024, width), dtype=np.float64)
        self._admitted = 0  # samples that came many at once since the last decision
        self._staged_stamps: list[int] = []
        self._staged_values: list[tuple[float, ...]] = []

    @property
    def received(self) -> int:
        """How many samples have come, admitted or not."""
        return self.counts.received + len(self._staged_stamps)

    @property
    def newest_ns(self) -> int:
        """Stamp of the newest sample, admitted or not."""
        return self._staged_to

    @property
    def stamps(self) -> Stamps:
        """Stamps of the remembered samples, ascending."""
        return self._stamps[: self._size]

    @property
    def values(self) -> Floats:
        """Floats of the remembered samples, one row each."""
        return self._values[: self._size]

    def stage(self, stamp_ns: int, values: tuple[float, ...]) -> bool:
        """Take one sample for later admission; return whether a decision may be due."""
        self._staged_stamps.append(stamp_ns)
        self._staged_values.append(values)
        backwards, self._staged_to = stamp_ns < self._staged_to, stamp_ns
        return backwards or bool(self._behind) or self._due(stamp_ns)

    def stage_many(self, stamps: Stamps, columns: Sequence[NDArray[Any]]) -> bool:
        """Take samples (n,) with columns (n,); return whether a decision may be due."""
        if not len(stamps):
            return False
        self._admit_staged()
        self.admit(stamps, np.column_stack(columns).astype(np.float64))
        self._admitted += len(stamps)
        backwards, self._staged_to = int(stamps.min()) < self._staged_to, int(stamps[-1])
        return backwards or self._due(int(stamps.max()))

    def _due(self, stamp_ns: int) -> bool:
        staged = self._admitted + len(self._staged_stamps)
        if stamp_ns < self.wake_ns:
            return staged >= _STAGE
        return staged >= self.wake_samples or stamp_ns >= self.wake_latest_ns

    def flush(self) -> None:
        """Admit the staged samples; unless one waits, the next sample calls for a decision."""
        self._admit_staged()
        self.wait(-NEVER)

    def _admit_staged(self) -> None:
        if self._staged_stamps:
            stamps = np.array(self._staged_stamps, dtype=np.int64)
            values = np.array(self._staged_values, dtype=np.float64)
            self._staged_stamps.clear()
            self._staged_values.clear()
            self.admit(stamps, values)

    def admit(self, stamps: Stamps, values: Floats) -> None:
        """Check the order of samples (n,), (n, width) and remember the good ones."""
        for begin in range(0, len(stamps), CAPACITY):
            self._admit(stamps[begin : begin + CAPACITY], values[begin : begin + CAPACITY])

    def samples(self) -> list[Sample]:
        """Return the remembered samples."""
        return list(zip(self.stamps.tolist(), self.values, strict=True))

    def take_behind(self) -> list[Sample]:
        """Return the samples that ascended behind the latest one; they count as good now."""
        taken, self._behind = self._behind, []
        self.counts.backwards -= len(taken)
        return taken

    def take_over(self, samples: Sequence[Sample]) -> None:
        """Admit samples that were counted before."""
        self.counts.received -= len(samples)
        for stamp, row in samples:
            self.admit(np.array([stamp], dtype=np.int64), row[np.newaxis])

    def wait(self, stamp_ns: int, samples: int = 1, latest_ns: int = NEVER) -> None:
        """Make :meth:`stage` report the stamp ``stamp_ns``, once ``samples`` are staged."""
        self.wake_ns, self.wake_samples, self.wake_latest_ns = stamp_ns, samples, latest_ns
        self._admitted = 0

    def index(self, stamp_ns: int) -> int:
        """Return the index of the first remembered sample at or after ``stamp_ns``."""
        return int(np.searchsorted(self.stamps, stamp_ns))

    def is_complete_until(self, stamp_ns: int) -> bool:
        """Return whether every sample up to ``stamp_ns`` has been admitted."""
        return self.latest is not None and self.latest >= stamp_ns

    def _admit(self, stamps: Stamps, values: Floats) -> None:
        self.counts.received += len(stamps)
        while len(stamps):
            good, taken = self._in_order(stamps, values)
            kept = (stamps, values) if good is None else (stamps[good], values[good])
            if len(kept[0]):
                self._append(kept[0], self._inspect(*kept))
                self.latest, self._newest = int(kept[0][-1]), kept[1][-1]
            if not self._is_set_back():
                return
            stamps, values = self._begin_anew(stamps[taken:], values[taken:])

    def _begin_anew(self, stamps: Stamps, values: Floats) -> tuple[Stamps, Floats]:
        """Forget the samples from before the clock was set back; return those since."""
        assert self.latest is not None
        self.counts.set_back += 1
        behind = self.take_behind()
        stamps = np.concatenate([[stamp for stamp, _ in behind], stamps])
        values = np.vstack([*(row for _, row in behind), values])
        self.set_back_at = self.latest
        self.set_back_ns, self.forgotten = self.latest - int(stamps[0]), int(stamps[0]) - 1
        self._size, self.latest = 0, None
        return stamps, values

    def _inspect(self, _stamps: Stamps, values: Floats) -> Floats:
        """Count what is wrong with samples in good order; return what to remember of them."""
        self.counts.non_finite += int(np.count_nonzero(~np.isfinite(values).all(axis=1)))
        return values

    def _in_order(self, stamps: Stamps, values: Floats) -> tuple[NDArray[np.intp] | None, int]:
        """Return the indices of the samples to keep (None: all) and how many were examined.

        It stops where the clock turns out to have been set back.
        """
        first = int(stamps[0]) - 1 if self.latest is None else self.latest
        steps = differences_from(first, stamps)
        if steps.min() > 0 and steps.max() <= self._tolerance_ns:
            self._ahead = 0
            self._behind.clear()
            return None, len(stamps)
        keep: list[int] = []
        latest, newest = self.latest, self._newest
        for i, stamp in enumerate(stamps.tolist()):
            step = 1 if latest is None else stamp - latest
            if step <= 0:
                again = step == 0 and newest is not None and _same(newest, values[i])
                self.counts.duplicates += again
                self.counts.backwards += not again
                self.counts.contradicting += step == 0 and not again
                if not again and self._set_back(stamp, values[i]):
                    return np.array(keep, dtype=np.intp), i + 1
            elif self._jumps_ahead(step):
                self.counts.foreign_clock += 1
            else:
                keep.append(i)
                self._behind.clear()
                latest, newest = stamp, values[i]
        return np.array(keep, dtype=np.intp), len(stamps)

    def _set_back(self, stamp: int, row: Floats) -> bool:
        """Note a sample behind the latest; return whether enough of them ascend."""
        latest = self._behind[-1][0] if self._behind else stamp - 1
        if stamp < latest:
            self._behind.clear()
        if stamp != latest:
            self._behind.append((stamp, row))
        return self._is_set_back()

    def _is_set_back(self) -> bool:
        """Return whether samples behind the latest come from a clock set back, not just late."""
        if len(self._behind) < _NEW_CLOCK_AFTER:
            return False
        return self._behind[-1][0] - self._behind[0][0] >= _SET_BACK_AFTER_NS

    def _jumps_ahead(self, step_ns: int) -> bool:
        """Return whether a sample is stamped by a foreign clock, not merely after a pause."""
        self._ahead = self._ahead + 1 if step_ns > self._tolerance_ns else 0
        if self._ahead >= _NEW_CLOCK_AFTER:
            self._ahead = 0
        return self._ahead > 0

    def _append(self, stamps: Stamps, values: Floats) -> None:
        """Remember samples; beyond the capacity the oldest are forgotten."""
        size = self._size + len(stamps)
        if size > 2 * CAPACITY:
            self._forget(size - CAPACITY)
            size = CAPACITY
        if size > len(self._stamps):
            room = min(2 * CAPACITY, max(size, 2 * len(self._stamps)))
            self._stamps = np.resize(self._stamps, room)
            self._values = np.resize(self._values, (room, self._values.shape[1]))
        self._stamps[self._size : size] = stamps
        self._values[self._size : size] = values
        self._size = size

    def _forget(self, count: int) -> None:
        """Forget the ``count`` oldest samples."""
        self.forgotten = int(self._stamps[count - 1])
        self._size -= count
        self._stamps[: self._size] = self._stamps[count : count + self._size]
        self._values[: self._size] = self._values[count : count + self._size]


def _same(a: Floats, b: Floats) -> bool:
    return bool(np.array_equal(a, b, equal_nan=True))
