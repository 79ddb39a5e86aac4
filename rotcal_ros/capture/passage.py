"""A table that turns on passes its angle: readings on both sides of it become one observation.

What counts for the angle is a curve through the readings over the angle of the table, which is
that of its feedback, interpolated to the stamp of each reading: a straight line for a nest that
goes along, a cubic for a tracer that rides on the table.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import fsum, sqrt
from typing import Final

import numpy as np

from rotcal_ros.capture.attempt import (
    Attempt,
    AttemptRejectedError,
    AttemptStreams,
    Wait,
    is_no_longer_in_memory,
    nanoseconds,
    seconds,
)
from rotcal_ros.capture.settings import CaptureSettings
from rotcal_ros.capture.streams import Stream
from rotcal_ros.capture.table import ANGLE, angle_offset
from rotcal_ros.capture.window import (
    BEAM_BROKEN,
    LENGTH,
    SEQUENCE,
    STATUS,
    ReadingFault,
    ReducedWindow,
    are_spikes,
    sequence_steps,
    too_few_usable,
)
from rotcal_ros.foundation.arrays import Floats, Stamps
from rotcal_ros.foundation.language import NOTHING, Phrase, phrase
from rotcal_ros.foundation.observations import Observation, PointKind, Turn
from rotcal_ros.foundation.units import ARCSEC, DEGREE, MICROMETRE, NANOSECOND, TURN
from rotcal_ros.planning.plan import Step

FAR: Final = 3.0
"""A table that is so many times as fast as ordered, or as slow, has not begun its turn."""
_AT_REST: Final = 0.01 * DEGREE
"""A table that turns by less than this for some seconds stands still."""
_ALIKE: Final = 0.1
"""Speeds that differ by less than this share are the same, in whatever unit."""
CUBIC: Final = 3
"""Degree of the curve through lengths: their second and third derivatives are no error."""
SIFTED: Final = 3
"""How often spikes are looked for, each time about the curve through what was left before."""
TELLING: Final = 20
"""Readings from which spikes are told: a cubic comes too near to fewer to show what is usual."""
LONG_PAUSE: Final = 3.0
"""Readings this many times as far apart as they usually are: some between them were lost."""


@dataclass(frozen=True, eq=False)
class FittedCurve:
    """A polynomial of least squares: its ``value`` at 0, the ``std`` of that, and its ``slope``.

    It is a sum of polynomials that are orthogonal at the points, after Forsythe (1957): ``terms``
    are the share of each, and by how much it is shifted, and turned back, for the next.
    ``left`` (n,): what it leaves of each point; ``scatter``: the standard deviation of one.
    """

    value: float
    slope: float
    std: float
    scatter: float
    left: Floats
    terms: tuple[tuple[float, float, float], ...]

    @classmethod
    def through(cls, x: Floats, y: Floats, degree: int = 1) -> FittedCurve:
        """Return that through ``x``, ``y`` (n,), at more different ``x`` than its degree."""
        # fsum rounds once: the order of summing, which numpy chooses by machine, cannot matter.
        before, own, left, square_before = np.zeros_like(x), np.ones_like(x), y, 1.0
        (at_0, risen), (at_0_before, risen_before) = (1.0, 0.0), (0.0, 0.0)
        value, slope, variance, terms = 0.0, 0.0, 0.0, []
        for _ in range(degree + 1):
            square = fsum(own * own)
            share, middle = fsum(own * left) / square, fsum(x * own * own) / square
            back = square / square_before
            left = left - share * own
            value, slope = value + share * at_0, slope + share * risen
            variance += at_0 * at_0 / square
            before, own = own, (x - middle) * own - back * before
            risen, risen_before = at_0 - middle * risen - back * risen_before, risen
            at_0, at_0_before = -middle * at_0 - back * at_0_before, at_0
            square_before = square
            terms.append((share, middle, back))
        scatter = sqrt(fsum(left * left) / max(len(x) - degree - 1, 1))
        return cls(value, slope, scatter * sqrt(variance), scatter, left, tuple(terms))

    def at(self, x: Floats) -> Floats:
        """Return its values at ``x`` (n,)."""
        before, own, total = np.zeros_like(x), np.ones_like(x), np.zeros_like(x)
        for share, middle, back in self.terms:
            total = total + share * own
            before, own = own, (x - middle) * own - back * before
        return total

    @property
    def farthest(self) -> float:
        """How far one point is off at most."""
        return float(np.abs(self.left).max())


@dataclass(frozen=True, slots=True)
class Passage:
    """How a table passed an angle: how far ``ahead`` of it (n,), rad, it was at ``stamps`` (n,).

    From the last feedback before the readings that count, negative, to the first behind them.
    """

    stamps: Stamps
    ahead: Floats

    def at(self, stamps: Stamps) -> Floats:
        """Return how far ahead the table was at ``stamps`` (k,), rad; outside it moves evenly."""
        since, passed = stamps - self.stamps[0], self.stamps - self.stamps[0]
        beyond_s = (since - np.clip(since, 0, passed[-1])) * NANOSECOND
        return np.asarray(np.interp(since, passed, self.ahead) + self.motion.slope * beyond_s)

    @property
    def motion(self) -> FittedCurve:
        """The even motion that is nearest to it, over seconds."""
        return FittedCurve.through((self.stamps - self.stamps[0]) * NANOSECOND, self.ahead)

    def fault(self, turn: Turn, settings: CaptureSettings) -> Phrase | None:
        """Return what is wrong with it, so that no reading counts."""
        speed, ordered = self.motion.slope, abs(turn.speed)
        pause = seconds(int(np.diff(self.stamps).max()))
        if pause > settings.table_silence_s:
            return phrase(
                "the table's feedback paused for {0:.3g} s while it passed, allowed {1:g} s "
                "(capture.table_silence_s)", pause, settings.table_silence_s
            )  # fmt: skip
        if abs(speed - ordered) > settings.speed_tolerance * ordered:
            return phrase(
                "the table passed at {0:.4g} deg/s, ordered {1:g}, allowed {2:.2%} off: is "
                "plan.run_up_deg long enough to reach that speed?", speed / DEGREE,
                ordered / DEGREE, settings.speed_tolerance
            )  # fmt: skip
        if (off := self.motion.farthest) > settings.position_tolerance_arcsec * ARCSEC:
            return phrase(
                "the table passed up to {0:.3g} arcsec off even motion, allowed {1:g} "
                "(capture.position_tolerance_arcsec)", off / ARCSEC,
                settings.position_tolerance_arcsec
            )  # fmt: skip
        return None


def decide_passage(
    attempt: Attempt, streams: AttemptStreams, settings: CaptureSettings
) -> Observation | Wait:
    """Return the observation of a step that the table passes, or what is needed to decide.

    The passage is the first since the table was sent to turn; it may be over when the step before
    is decided. Raises AttemptRejectedError if there is none before the deadline of the attempt;
    one with which something is wrong is an observation that is rejected.
    """
    table, step = streams.table, attempt.step
    read = _readings(streams, step)
    # An angle that wraps around may come in the run-up, too, a whole turn early.
    since_ns = max(attempt.search_ns, attempt.due_ns - _half_turn_ns(step))
    if is_no_longer_in_memory(table, since_ns) or is_no_longer_in_memory(read, since_ns):
        raise AttemptRejectedError(
            "feedback or readings from the start of the turn have left memory"
        )
    deadline = attempt.deadline_ns(settings)
    passed = first_passage(table, since_ns, deadline, step)
    if passed is not None:
        begin_ns, end_ns = int(passed.stamps[0]), int(passed.stamps[-1])
        if not read.is_complete_until(end_ns):
            return Wait(read, end_ns)
        attempt.search_ns = begin_ns  # the table passes the next angle later
        return _observe(attempt, streams, settings, passed)
    if not table.is_complete_until(deadline):
        return Wait(table, min(_soonest_ns(table, step, settings), deadline))
    back = replace(step, turn=replace(_turn(step), speed=-_turn(step).speed))
    reversed_ = first_passage(table, since_ns, deadline, back) is not None
    raise AttemptRejectedError(
        "the table did not pass {0:.4f} deg at about {1:g} deg/s within {2:g} s of when it was "
        "due (capture.step_timeout_s){3}", step.table_angle / DEGREE,
        _turn(step).speed / DEGREE, settings.step_timeout_s,
        _THE_OTHER_WAY if reversed_ else NOTHING
    )  # fmt: skip


def _half_turn_ns(step: Step) -> int:
    return nanoseconds(0.5 * TURN / abs(_turn(step).speed))


def _readings(streams: AttemptStreams, step: Step) -> Stream:
    """Return the stream of what is read at a step."""
    return streams.tracer if step.kind == PointKind.REFLECTOR else streams.nest


_THE_OTHER_WAY: Final = phrase(
    "; it passed it the other way: is a sign wrong? Positive is counter-clockwise seen from above"
)


def why_not_turning(table: Stream, attempt: Attempt, patience_ns: int) -> str | None:
    """Return why the table will not pass its angle, if that has lasted for ``patience_ns``."""
    turn, newest_ns = _turn(attempt.step), table.latest
    if newest_ns is None:
        return "no table feedback has come: does cell.joint name a joint of the feedback?"
    rows = slice(table.index(newest_ns - patience_ns), None)
    stamps, angles = table.stamps[rows], table.values[rows, ANGLE]
    if newest_ns - attempt.search_ns < patience_ns or len(stamps) < 3:
        return None
    if np.ptp(angles) < _AT_REST:
        return (
            f"the table stands still at {angles[-1] / DEGREE:.4f} deg, it was ordered to turn "
            f"from {turn.begin / DEGREE:g} to {turn.end / DEGREE:g} deg at "
            f"{turn.speed / DEGREE:g} deg/s"
        )
    speed = float(np.median(np.abs(np.diff(angles) / (np.diff(stamps) * NANOSECOND))))
    if abs(speed * DEGREE / abs(turn.speed) - 1.0) < _ALIKE:
        return (
            f"the feedback turns at {speed:.4g} rad/s where {abs(turn.speed) / DEGREE:g} deg/s "
            "were ordered: degrees? Publish radians, or set topics.angle_unit: deg"
        )
    return None


def first_passage(table: Stream, since_ns: int, until_ns: int, step: Step) -> Passage | None:
    """Return how the table first passed the angle of a step in its turn, if it has.

    One that goes the other way than ordered, or far faster or slower, is still on its way to where
    the turn begins.
    """
    known = slice(table.index(since_ns), table.index(until_ns + 1))
    stamps, ahead = table.stamps[known], _ahead(table.values[known, ANGLE], step)
    before, behind = np.flatnonzero(ahead <= -step.passing), np.flatnonzero(ahead >= step.passing)
    ordered = abs(_turn(step).speed)
    # where the angle wraps around, opposite the step, it goes down
    for at in np.flatnonzero((ahead[:-1] < 0.0) & (ahead[1:] >= 0.0)).tolist():
        first, last = np.searchsorted(before, at, "right") - 1, np.searchsorted(behind, at)
        if first < 0 or last == len(behind):
            continue
        rows = slice(before[first], behind[last] + 1)
        passed = Passage(stamps[rows], ahead[rows])
        if ordered < FAR * passed.motion.slope < FAR**2 * ordered:
            return passed
    return None


def _ahead(angles: Floats, step: Step) -> Floats:
    """Return how far ``angles`` (n,) are past that of a step in the sense of its turn, rad."""
    return np.asarray(np.sign(_turn(step).speed) * angle_offset(angles, step.table_angle))


def _turn(step: Step) -> Turn:
    assert step.turn is not None
    return step.turn


def _soonest_ns(table: Stream, step: Step, settings: CaptureSettings) -> int:
    """Return a stamp before which no passage that is not known yet can be over."""
    if table.latest is None:
        return 0
    (ahead,) = _ahead(table.values[-1:, ANGLE], step).tolist()
    left = step.passing - ahead if abs(ahead) < step.passing else 2.0 * step.passing
    fastest = abs(_turn(step).speed) * (1.0 + settings.speed_tolerance)
    return table.latest + 1 + nanoseconds(0.9 * left / fastest)


def _observe(
    attempt: Attempt, streams: AttemptStreams, settings: CaptureSettings, passed: Passage
) -> Observation:
    """Reduce the readings of a passage."""
    step = attempt.step
    read, sense = _readings(streams, step), float(np.sign(_turn(step).speed))
    first, last = (int(stamp) for stamp in passed.stamps[[0, -1]])
    rows = slice(max(read.index(first) - 1, 0), read.index(last) + 1)  # one more on each side
    stamps, values = read.stamps[rows], read.values[rows]
    ahead = passed.at(stamps)
    near = np.abs(ahead) < step.passing
    missing = missing_readings(values[:, SEQUENCE], ahead, step.passing)
    stamps, values, ahead = stamps[near], values[near], ahead[near]
    if reason := why_no_reading_counts(passed, ahead, step, settings):
        reduced = ReducedWindow(reason=reason)
    elif step.kind == PointKind.REFLECTOR:
        reduced = reduce_passing_lengths(ahead, values, missing, settings)
    else:
        reduced = _reduced(ahead, stamps, values, settings)
    window = (int(stamps[0]), int(stamps[-1])) if len(stamps) else None
    segment = 0
    if step.kind == PointKind.REFLECTOR and window is not None:
        epoch, since_ns = streams.counted_from or (streams.tracer.beam.epoch, attempt.begin_ns)
        segment = streams.tracer.beam.segment(since_ns, *window, epoch)
    return attempt.observation(
        reduced,
        n_samples=len(stamps),
        window_ns=window,
        table_angle_measured=step.table_angle + sense * fsum(ahead) / max(len(ahead), 1),
        air=streams.air_at(attempt, settings),
        segment=segment,
    )


def why_no_reading_counts(
    passed: Passage, ahead: Floats, step: Step, settings: CaptureSettings
) -> Phrase | None:
    """Return what is wrong with a passage, or that readings (n,) ``ahead`` of it are too few."""
    return passed.fault(_turn(step), settings) or _few(ahead, step, settings)


def _few(ahead: Floats, step: Step, settings: CaptureSettings) -> Phrase | None:
    """Return that one side of the angle has not enough readings."""
    sides = int(np.count_nonzero(ahead < 0.0)), int(np.count_nonzero(ahead > 0.0))
    if min(sides) >= settings.passing_samples:
        return None
    return phrase(
        "{0} readings before {1:.4f} deg and {2} behind it, expected {3} on each side within "
        "{4:g} deg: turn slower, read faster, or raise plan.passing_deg", sides[0],
        step.table_angle / DEGREE, sides[1], settings.passing_samples, step.passing / DEGREE
    )  # fmt: skip


def _reduced(
    ahead: Floats, stamps: Stamps, values: Floats, settings: CaptureSettings
) -> ReducedWindow:
    """Return the lines through readings, ``values`` (n, 4), at the angle, or what is wrong."""
    if not np.isfinite(values).all():
        return ReducedWindow(reason=phrase("a reading is not a finite number"))
    return _of_curves(
        [FittedCurve.through(ahead, column) for column in values[:, 1:].T],
        _lost(stamps, values[:, 0]),
        settings,
    )


def missing_readings(sequence: Floats, ahead: Floats, passing: float) -> int:
    """Return how many readings (n,) up to ``passing`` (rad) beside an angle are missing.

    By their numbers; an instrument that does not number them misses none.
    """
    if len(sequence) < 2:
        return 0
    lost = sequence_steps(sequence[1:], sequence[0]) - 1
    inside = np.diff(np.clip(ahead, -passing, passing))
    share = inside / np.where(inside != 0.0, np.diff(ahead), 1.0)
    return round(float(lost @ share))


def reduce_passing_lengths(
    ahead: Floats, values: Floats, missing: int, settings: CaptureSettings
) -> ReducedWindow:
    """Return the cubic through lengths at the angle, or what is wrong with them.

    ``ahead`` (n,) rad: where the table was when they were read; ``values`` (n, 3): an admitted
    tracer stream, in which others are ``missing``. Few that are, or are spikes, do no harm. A beam
    that broke in between is no length: what comes behind counts from another zero.
    """
    length, faults = values[:, LENGTH], values[:, STATUS].astype(np.int64)
    if (faults == ReadingFault.BEAM_BROKEN).any():
        return ReducedWindow(reason=phrase("{0} while the table passed", phrase(BEAM_BROKEN)))
    used = good = np.flatnonzero(faults == ReadingFault.NONE)
    least = max(settings.min_used_share * (len(length) + missing), CUBIC + 2)
    for _ in range(SIFTED):
        if len(used) < least:
            lost = phrase("{0} readings lost while the table passed", missing) if missing else None
            return ReducedWindow(reason=lost or too_few_usable(faults, length, settings))
        curve = FittedCurve.through(ahead[used], length[used], CUBIC)
        if len(good) < TELLING:
            break
        spikes = good[are_spikes(np.abs(length[good] - curve.at(ahead[good])), settings)]
        faults[good], faults[spikes] = ReadingFault.NONE, ReadingFault.SPIKE
        used = good[faults[good] == ReadingFault.NONE]
        if len(used) == len(curve.left):
            break
    return _of_curves([curve], None, settings)


def _of_curves(
    curves: list[FittedCurve], lost: Phrase | None, settings: CaptureSettings
) -> ReducedWindow:
    """Return what curves through readings say at the angle, rejected if readings are ``lost``."""
    return ReducedWindow(
        mean=tuple(curve.value for curve in curves),
        std=tuple(curve.std for curve in curves),
        scatter=tuple(curve.scatter for curve in curves),
        n_used=len(curves[0].left),
        reason=lost or _unsteady(curves, settings),
    )


def _unsteady(curves: list[FittedCurve], settings: CaptureSettings) -> Phrase | None:
    """Return that readings scatter too much about their curves."""
    scatter = max(curve.scatter for curve in curves)
    if scatter <= settings.max_std_m:
        return None
    return phrase(
        "unstable: readings scatter by {0:.3g} um about their curve, allowed {1:g} um "
        "(capture.max_std_m)", scatter / MICROMETRE, settings.max_std_m / MICROMETRE
    )  # fmt: skip


def _lost(stamps: Stamps, sequence: Floats) -> Phrase | None:
    """Return which readings are missing, by their numbers or, without numbers, by a pause."""
    missed = int((sequence_steps(sequence[1:], sequence[0]) - 1).sum())
    if missed:
        return phrase(
            "{0} readings lost while the table passed ({1:.0f} and following)", missed, sequence[0]
        )
    pauses = np.diff(stamps)
    if pauses.max() > LONG_PAUSE * np.median(pauses):
        longest, usual = seconds(int(pauses.max())), seconds(int(np.median(pauses)))
        return phrase(
            "readings lost: a pause of {0:.3g} s, usually they are {1:.3g} s apart", longest, usual
        )
    return None
