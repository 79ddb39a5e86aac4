"""A window of tracer readings becomes a mean with its standard deviation, or a reason why not.

Where a tracer may have lost its beam a new segment of lengths with a zero of its own begins.

A tracer counts fringes: its zero holds while the beam is unbroken. It is lost when the status
says so, when the readings' numbers start anew, when readings are missing for long, and when the
length changes faster than any reflector is carried. The solver estimates a zero per segment.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import Counter
from dataclasses import dataclass
from enum import IntEnum
from math import fsum, sqrt
from typing import Final

import numpy as np

from rotcal_ros.capture.settings import CaptureSettings
from rotcal_ros.capture.streams import Stream
from rotcal_ros.foundation.arrays import Bools, Floats, Ints, Stamps, differences_from
from rotcal_ros.foundation.language import Phrase, join_texts, phrase
from rotcal_ros.foundation.observations import LengthStatus
from rotcal_ros.foundation.units import MICROMETRE, NANOSECOND

SEQUENCE, LENGTH, STATUS = range(3)
"""Columns of the tracer stream; the last one holds the :class:`ReadingFault` once admitted."""

_MAD_TO_STD = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""

BEAM_BROKEN: Final = "beam broken"
"""What a reason says if something stood in the beam."""


class ReadingFault(IntEnum):
    """Why a reading cannot be used."""

    NONE = 0
    BEAM_BROKEN = 1
    UNSTABLE = 2
    UNKNOWN = 3
    NON_FINITE = 4
    IMPLAUSIBLE = 5
    SPIKE = 6


_WORDS = {
    ReadingFault.BEAM_BROKEN: BEAM_BROKEN,
    ReadingFault.UNSTABLE: "unstable by its own status",
    ReadingFault.UNKNOWN: "of unknown status",
    ReadingFault.NON_FINITE: "not a finite number",
    ReadingFault.IMPLAUSIBLE: "implausibly long",
    ReadingFault.SPIKE: "spikes",
}
_STATUS_FAULT = {
    LengthStatus.OK: ReadingFault.NONE,
    LengthStatus.BEAM_BROKEN: ReadingFault.BEAM_BROKEN,
    LengthStatus.UNSTABLE: ReadingFault.UNSTABLE,
}


@dataclass(frozen=True, slots=True)
class ReducedWindow:
    """Numbers of a window, empty if there are none, and the ``reason`` to reject it, if any."""

    mean: tuple[float, ...] = ()
    std: tuple[float, ...] = ()
    scatter: tuple[float, ...] = ()
    n_used: int = 0
    reason: Phrase | None = None


class TracerStream(Stream):
    """Tracer readings: columns sequence, length (m), status; the status becomes a fault."""

    def __init__(
        self,
        clock_tolerance_ns: int,
        max_length: float,
        beam: Beam | None = None,
        *,
        single_shot: bool = False,
    ) -> None:
        super().__init__(3, clock_tolerance_ns, single_shot=single_shot)
        self._max_length = max_length
        self.beam = beam or Beam(silence_s=1.0, fastest=10.0)

    def _inspect(self, stamps: Stamps, values: Floats) -> Floats:
        """Turn the status into a fault and count faults and lost readings."""
        faults = classify_readings(values[:, STATUS], values[:, LENGTH], self._max_length)
        numbers = np.bincount(faults, minlength=len(ReadingFault))
        self.counts.beam_broken += int(numbers[ReadingFault.BEAM_BROKEN])
        self.counts.unstable += int(numbers[ReadingFault.UNSTABLE] + numbers[ReadingFault.UNKNOWN])
        self.counts.non_finite += int(numbers[ReadingFault.NON_FINITE])
        self.counts.implausible += int(numbers[ReadingFault.IMPLAUSIBLE])
        sequence = values[:, SEQUENCE]
        before = sequence[0] - 1 if self._newest is None else self._newest[SEQUENCE]
        steps = sequence_steps(sequence, before)
        forward = steps < WRAP // 2
        self.counts.lost += int((steps[forward & (steps > 1)] - 1).sum())
        self.counts.out_of_order += int(np.count_nonzero(~forward | (steps == 0)))
        length = values[:, LENGTH]
        self.beam.follow(
            stamps,
            sequence,
            length,
            faults == ReadingFault.NONE,
            faults == ReadingFault.BEAM_BROKEN,
        )
        return np.column_stack([sequence, length, faults])


def classify_readings(status: Floats, length: Floats, max_length: float) -> Ints:
    """Return the :class:`ReadingFault` of each reading; all arrays have shape (n,)."""
    faults = np.full(len(status), int(ReadingFault.UNKNOWN), dtype=np.int64)
    for value, fault in _STATUS_FAULT.items():
        faults[status == value] = fault
    usable = faults == ReadingFault.NONE
    faults[usable & ~np.isfinite(length)] = ReadingFault.NON_FINITE
    faults[usable & (np.abs(length) > max_length)] = ReadingFault.IMPLAUSIBLE
    faults[usable & np.isinf(length)] = ReadingFault.NON_FINITE
    return faults


def sequence_steps(sequence: Floats, before: float) -> Ints:
    """Return the steps (n,) of a sequence that follows ``before``, modulo 32 bits."""
    return differences_from(before, sequence).astype(np.int64) % WRAP


def reduce_window(stamps: Stamps, readings: Floats, settings: CaptureSettings) -> ReducedWindow:
    """Reduce the window ``stamps`` (n,), ``readings`` (n, 3) of an admitted tracer stream.

    The mean is that of the usable readings, without spikes beyond ``spike_limit`` robust standard
    deviations (from the median absolute deviation); ``scatter`` is the standard deviation of one
    reading, ``std`` = scatter / sqrt(n_used) that of the mean (type A; the floor set by the
    instrument belongs to the solver). Sums are rounded once, at the end, so that the same readings
    give the same bits on every machine.
    """
    length = readings[:, LENGTH]
    faults = readings[:, STATUS].astype(np.int64)
    _mark_spikes(length, faults, settings)
    used = faults == ReadingFault.NONE
    n_used = int(np.count_nonzero(used))
    gap = _gap(readings[:, SEQUENCE])
    if n_used < min(2, len(length)) or n_used < settings.min_used_share * len(length):
        return ReducedWindow(n_used=n_used, reason=gap or too_few_usable(faults, length, settings))
    if n_used == 1:  # a reading alone shows no scatter
        return ReducedWindow((float(length[used][0]),), (0.0,), (0.0,), 1)
    mean, scatter = mean_and_scatter(length[used])
    drift = _drift(stamps[used], length[used], mean)
    return ReducedWindow(
        mean=(mean,),
        std=(scatter / sqrt(n_used),),
        scatter=(scatter,),
        n_used=n_used,
        reason=gap or _unrest(scatter, drift, settings),
    )


def mean_and_scatter(values: Floats) -> tuple[float, float]:
    """Return mean and standard deviation of one of the ``values`` (n,), n >= 2."""
    # fsum rounds once: the order of summing, which numpy chooses by machine, cannot matter.
    mean = fsum(values) / len(values)
    return mean, sqrt(fsum((values - mean) ** 2) / (len(values) - 1))


def _mark_spikes(length: Floats, faults: Ints, settings: CaptureSettings) -> None:
    good = faults == ReadingFault.NONE
    if not good.any():
        return
    distance = np.abs(length[good] - np.median(length[good]))
    faults[np.flatnonzero(good)[are_spikes(distance, settings)]] = ReadingFault.SPIKE


def are_spikes(distance: Floats, settings: CaptureSettings) -> Bools:
    """Return which readings are spikes by their ``distance`` (n,) from what they should be, m."""
    # Median and MAD: a spike must not enlarge the limit that finds it.
    limit = settings.spike_limit * _MAD_TO_STD * float(np.median(distance))
    return np.asarray(distance > max(limit, settings.spike_floor_m), dtype=np.bool_)


def _drift(stamps: Stamps, length: Floats, mean: float) -> float:
    """Return the change of the fitted line from the first to the last reading (m)."""
    time = (stamps - stamps[0]).astype(np.float64)
    # About their mean, so that the slope does not depend on the mean of the lengths.
    time -= fsum(time) / len(time)
    return float(fsum(time * (length - mean)) / fsum(time * time) * (time[-1] - time[0]))


def _gap(sequence: Floats) -> Phrase | None:
    """Return, as a reason, which readings are missing inside a window."""
    steps = sequence_steps(sequence[1:], sequence[0])
    at = np.flatnonzero(steps != 1)
    if not len(at):
        return None
    before, after = int(sequence[at[0]]), int(sequence[at[0] + 1])
    # Modulo 2^32, a number in the upper half is a step back.
    if (steps[at] >= WRAP // 2).any() or (steps[at] == 0).any():
        return phrase(
            "tracer sequence goes from {0} to {1} in the window; expected {2} (two publishers on "
            "the topic?)", before, after, before + 1
        )  # fmt: skip
    lost = int((steps[at] - 1).sum())
    return phrase(
        "{0} tracer readings lost in the window (sequence {1} to {2})", lost, before, after
    )


def too_few_usable(faults: Ints, length: Floats, settings: CaptureSettings) -> Phrase:
    """Return, as a reason, which readings of a window cannot be used."""
    counts = Counter(ReadingFault(f) for f in faults.tolist() if f != ReadingFault.NONE)
    parts = [phrase("{0} {1}", counts[fault], phrase(_WORDS[fault])) for fault in sorted(counts)]
    needed = phrase("expected at least {0:.0%}", settings.min_used_share)
    text = phrase(
        "only {0} of {1} readings usable: {2}; {3}", len(faults) - counts.total(), len(faults),
        join_texts(parts, ", "), needed
    )  # fmt: skip
    if counts[ReadingFault.IMPLAUSIBLE]:
        largest = float(np.abs(length[faults == ReadingFault.IMPLAUSIBLE]).max())
        text = phrase(
            "{0}; found {1:.6g} m, plausible are {2:g} m (millimetres instead of metres?); "
            "topics.length_unit says which", text, largest, settings.max_length_m
        )  # fmt: skip
    return text


def _unrest(scatter: float, drift: float, settings: CaptureSettings) -> Phrase | None:
    """Return, as a reason, why a window is not stable."""
    if scatter > settings.max_std_m:
        return phrase(
            "unstable: standard deviation {0:.3g} um of the readings, allowed {1:g} um",
            scatter / MICROMETRE, settings.max_std_m / MICROMETRE
        )  # fmt: skip
    if abs(drift) > settings.max_drift_m:
        return phrase(
            "drifting: {0:+.3g} um over the window, allowed {1:g} um", drift / MICROMETRE,
            settings.max_drift_m / MICROMETRE
        )  # fmt: skip
    return None


WRAP: Final = 1 << 32
"""Sequence numbers are 32 bits wide."""


class Beam:
    """Finds, in readings that come in the order of their stamps, where segments begin.

    ``silence_s``: readings missing for longer may hide a break; ``fastest``: largest speed of the
    length, m/s. However the readings are cut into pieces, the segments are the same. ``epoch`` is
    how often the clock of the readings was set back; their zero outlives that.
    """

    def __init__(self, silence_s: float, fastest: float) -> None:
        self._silence_ns, self._fastest = silence_s / NANOSECOND, fastest
        self.epoch = 0
        self._begins: list[tuple[int, int]] = []  # epoch and stamp
        self._last: tuple[int, float] | None = None  # the last reading
        self._good: tuple[int, float] | None = None  # stamp and length of the last usable one
        self._lost = False

    @property
    def begins(self) -> list[int]:
        """The stamps at which segments but the first begin."""
        return [stamp for _, stamp in self._begins]

    def follow(
        self, stamps: Stamps, sequence: Floats, length: Floats, usable: Bools, broken: Bools
    ) -> None:
        """Take further readings, all arrays (n,); ``broken``: the status says so."""
        if not len(stamps):
            return
        if self._last is None:
            self._last = int(stamps[0]), float(sequence[0]) - 1.0
        self.epoch += int(stamps[0]) < self._last[0]
        number = np.append(self._last[1], sequence)
        steps = np.diff(number).astype(np.int64) % WRAP
        pause = np.abs(np.diff(np.append(self._last[0], stamps)))
        anew = (steps == 0) | (steps >= WRAP // 2)  # modulo 2^32 the upper half is a step back
        silent = (steps > 1) & (pause > self._silence_ns)
        lost = np.cumsum(broken | anew | silent)
        self._last = int(stamps[-1]), float(sequence[-1])
        at = np.flatnonzero(usable)
        if len(at):
            self._compare(stamps[at], length[at], lost[at])
        self._lost = bool(lost[-1] > (lost[at[-1]] if len(at) else 0)) or (
            self._lost and not len(at)
        )

    def _compare(self, stamps: Stamps, length: Floats, lost: Floats) -> None:
        """Compare each usable reading with the one before; ``lost`` counts what was between."""
        first = self._good or (int(stamps[0]), float(length[0]))
        before = -1 if self._lost else 0
        moved = np.abs(np.diff(np.append(first[1], length)))
        time = np.abs(np.diff(np.append(first[0], stamps))) * NANOSECOND
        new = (np.diff(np.append(before, lost)) > 0) | (moved > self._fastest * time)
        new[0] &= self._good is not None
        self._begins += ((self.epoch, stamp) for stamp in stamps[new].tolist())
        self._good = int(stamps[-1]), float(length[-1])

    def segment(
        self, since_ns: int, begin_ns: int, end_ns: int, since_epoch: int | None = None
    ) -> int:
        """Return the number of the segment of a window, counted from ``since_ns``.

        The window is one of the latest epoch; so is ``since_ns`` where nothing else is said.

        Windows of one unbroken beam have the same number; one that lost the beam shares its number
        with no other, because its mean has no single zero.
        """
        epoch = self.epoch if since_epoch is None else since_epoch
        before = bisect_right(self._begins, (epoch, since_ns))
        ends = (bisect_right(self._begins, (self.epoch, stamp)) for stamp in (begin_ns, end_ns))
        return sum(ends) - 2 * before
