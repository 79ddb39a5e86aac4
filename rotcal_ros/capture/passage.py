"""A table that turns on passes its angle: readings on both sides of it become one observation.

What counts for the angle is the straight line through the readings over the angle of the table,
which is that of its feedback, interpolated to the stamp of each reading.
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
    forgotten,
    nanoseconds,
    seconds,
)
from rotcal_ros.capture.settings import CaptureSettings
from rotcal_ros.capture.streams import Stream
from rotcal_ros.capture.table import ANGLE, offset
from rotcal_ros.capture.window import ReducedWindow, sequence_steps
from rotcal_ros.foundation.arrays import Floats, Stamps
from rotcal_ros.foundation.language import NOTHING, Phrase, phrase
from rotcal_ros.foundation.observations import Observation, Turn
from rotcal_ros.foundation.units import ARCSEC, DEGREE, MICROMETRE, NANOSECOND
from rotcal_ros.planning.plan import Step

FAR: Final = 3.0
"""A table that is so many times as fast as ordered, or as slow, has not begun its turn."""
_AT_REST: Final = 0.01 * DEGREE
"""A table that turns by less than this for some seconds stands still."""
_ALIKE: Final = 0.1
"""Speeds that differ by less than this share are the same, in whatever unit."""
LONG_PAUSE: Final = 3.0
"""Readings this many times as far apart as they usually are: some between them were lost."""


@dataclass(frozen=True, slots=True)
class Line:
    """A straight line through points: its ``value`` at 0, the ``std`` of that, and its ``slope``.

    ``scatter`` is the standard deviation of one point, ``farthest`` how far one is off at most.
    """

    value: float
    slope: float
    std: float
    scatter: float
    farthest: float

    @classmethod
    def through(cls, x: Floats, y: Floats) -> Line:
        """Return the line of least squares through ``x``, ``y`` (n,), not all at one ``x``."""
        # fsum rounds once: the order of summing, which numpy chooses by machine, cannot matter.
        n, mean, height = len(x), fsum(x) / len(x), fsum(y) / len(x)
        away = x - mean
        spread = fsum(away * away)
        slope = fsum(away * (y - height)) / spread
        left = y - height - slope * away
        scatter = sqrt(fsum(left * left) / max(n - 2, 1))
        std = scatter * sqrt(1.0 / n + mean * mean / spread)
        return cls(height - slope * mean, slope, std, scatter, float(np.abs(left).max()))


@dataclass(frozen=True, slots=True)
class Passage:
    """How a table passed an angle: how far ``ahead`` of it (n,), rad, it was at ``stamps`` (n,).

    From the last feedback before the readings that count, negative, to the first behind them.
    """

    stamps: Stamps
    ahead: Floats

    def at(self, stamps: Stamps) -> Floats:
        """Return how far ahead the table was at ``stamps`` (k,) of the passage, rad."""
        return np.asarray(
            np.interp(stamps - self.stamps[0], self.stamps - self.stamps[0], self.ahead)
        )

    @property
    def motion(self) -> Line:
        """The even motion that is nearest to it, over seconds."""
        return Line.through((self.stamps - self.stamps[0]) * NANOSECOND, self.ahead)

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

    The passage is the first since the table was sent to turn; it may be over when the step is
    ordered. Raises AttemptRejectedError if there is none before the deadline of the attempt, or
    something is wrong with it.
    """
    table, nest, since_ns = streams.table, streams.nest, attempt.search_ns
    if forgotten(table, since_ns) or forgotten(nest, since_ns):
        raise AttemptRejectedError(
            "feedback or readings from the begin of the turn are no longer in memory"
        )
    step, deadline = attempt.step, attempt.deadline_ns(settings)
    passed = first_passage(table, since_ns, deadline, step)
    if passed is not None:
        if fault := passed.fault(_turn(step), settings):
            raise AttemptRejectedError(fault)
        end_ns = int(passed.stamps[-1])
        known = nest.knows(end_ns)
        return _observe(attempt, streams, settings, passed) if known else Wait(nest, end_ns)
    if not table.knows(deadline):
        return Wait(table, min(_soonest_ns(table, step, settings), deadline))
    back = replace(step, turn=replace(_turn(step), speed=-_turn(step).speed))
    reversed_ = first_passage(table, since_ns, deadline, back) is not None
    raise AttemptRejectedError(
        "the table did not pass {0:.4f} deg at about {1:g} deg/s within {2:g} s of "
        "the order (capture.step_timeout_s){3}", step.table_angle / DEGREE,
        _turn(step).speed / DEGREE, settings.step_timeout_s,
        _THE_OTHER_WAY if reversed_ else NOTHING
    )  # fmt: skip


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
    return np.asarray(np.sign(_turn(step).speed) * offset(angles, step.table_angle))


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
    nest, step = streams.nest, attempt.step
    rows = slice(nest.index(int(passed.stamps[0])), nest.index(int(passed.stamps[-1]) + 1))
    stamps, values = nest.stamps[rows], nest.values[rows]
    ahead = passed.at(stamps)
    near = np.abs(ahead) < step.passing
    stamps, values, ahead = stamps[near], values[near], ahead[near]
    if few := _few(ahead, step, settings):
        raise AttemptRejectedError(few)
    reduced = _reduced(ahead, stamps, values, settings)
    sense = float(np.sign(_turn(step).speed))
    return attempt.observation(
        reduced,
        n_samples=len(stamps),
        window_ns=(int(stamps[0]), int(stamps[-1])),
        table_angle_measured=step.table_angle + sense * fsum(ahead) / len(ahead),
        air=streams.air_at(attempt, settings),
    )


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
    lines = [Line.through(ahead, column) for column in values[:, 1:].T]
    return ReducedWindow(
        mean=tuple(line.value for line in lines),
        std=tuple(line.std for line in lines),
        scatter=tuple(line.scatter for line in lines),
        n_used=len(ahead),
        reason=_lost(stamps, values[:, 0]) or _unsteady(lines, settings),
    )


def _unsteady(lines: list[Line], settings: CaptureSettings) -> Phrase | None:
    """Return that readings scatter too much about their lines."""
    scatter = max(line.scatter for line in lines)
    if scatter <= settings.max_std_m:
        return None
    return phrase(
        "unstable: readings scatter by {0:.3g} um about their line, allowed {1:g} um "
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
