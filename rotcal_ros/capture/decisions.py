"""The two ways in which an attempt becomes an observation.

The tracer path takes the window of readings after table and probe have come to rest, the
probe-only path one or several probe points while the table is at rest in position.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from math import sqrt
from typing import Final

import numpy as np

from rotcal_ros.capture.attempt import (
    Attempt,
    AttemptRejectedError,
    AttemptStreams,
    Decide,
    Wait,
    is_no_longer_in_memory,
    nanoseconds,
    seconds,
)
from rotcal_ros.capture.passage import decide_passage
from rotcal_ros.capture.settings import CaptureSettings
from rotcal_ros.capture.streams import Stream
from rotcal_ros.capture.table import (
    arrival,
    departure,
    largest_offset,
    mean_angle,
    why_not_at_rest,
)
from rotcal_ros.capture.window import (
    SEQUENCE,
    ReducedWindow,
    TracerStream,
    mean_and_scatter,
    reduce_window,
    sequence_steps,
)
from rotcal_ros.foundation.language import Phrase, phrase
from rotcal_ros.foundation.observations import Observation, ProbeSample
from rotcal_ros.foundation.units import ARCSEC, NANOSECOND
from rotcal_ros.planning.plan import Step

CLOCK_JUMP_S: Final = 0.5
"""A pause this long between readings in a row is a jump of their clock, if it is also"""
LONG_PAUSE: Final = 10.0
"""so many times as long as they usually are apart."""
_MEMORY: Final = phrase(
    "samples of that time have left memory: one stream lags far behind the others"
)


def decide_length(
    attempt: Attempt, streams: AttemptStreams, settings: CaptureSettings
) -> Observation | Wait:
    """Return the observation of a tracer step, or what is needed to decide.

    Of a table that turns: :func:`~.passage.decide_passage`. At rest the window is the first
    ``window_samples`` readings stamped at least ``settle_time_s`` after the table came to rest in
    position (not before the probe reached its target). If the table leaves its position before the
    window ends, the next rest counts. The window must end before the deadline of the attempt;
    raises AttemptRejectedError if there is none.
    """
    if attempt.step.turn is not None:
        return decide_passage(attempt, streams, settings)
    deadline = attempt.deadline_ns(settings)
    while True:
        start = _start(attempt, streams, settings, deadline)
        if isinstance(start, Wait):
            return start
        window = _window(streams.tracer, attempt, settings, deadline, start)
        if isinstance(window, Wait):
            return window
        first, last = window
        end_ns = int(streams.tracer.stamps[last])
        if not streams.table.is_complete_until(end_ns):
            return Wait(streams.table, end_ns)
        again = departure(streams.table, start, end_ns, attempt.step.table_angle, settings)
        if again is None:
            return _observe(attempt, streams, settings, first, last)
        attempt.search_ns = again


def _start(
    attempt: Attempt, streams: AttemptStreams, settings: CaptureSettings, deadline: int
) -> int | Wait:
    """Return the stamp of the table's arrival."""
    table, angle = streams.table, attempt.step.table_angle
    if is_no_longer_in_memory(table, attempt.search_ns):
        raise AttemptRejectedError("table feedback: {0}", _MEMORY)
    start = arrival(table, attempt.search_ns, angle, settings)
    if start is not None and start <= deadline:
        return start
    if table.is_complete_until(deadline):
        raise AttemptRejectedError(
            why_not_at_rest(table, attempt.begin_ns, deadline, angle, settings)
        )
    if table.latest is not None:
        attempt.search_ns = max(attempt.search_ns, table.latest + 1)
    # No window can end sooner than this: looking earlier would be in vain.
    return Wait(table, min(attempt.search_ns + nanoseconds(settings.settle_time_s), deadline))


def _window(
    tracer: TracerStream, attempt: Attempt, settings: CaptureSettings, deadline: int, start: int
) -> tuple[int, int] | Wait:
    """Return the indices of the first and the last reading of the window."""
    begin = start + nanoseconds(settings.settle_time_s)
    if is_no_longer_in_memory(tracer, begin):
        raise AttemptRejectedError("tracer readings: {0}", _MEMORY)
    first = tracer.index(begin)
    last = first + settings.window_samples - 1
    if last < len(tracer.stamps) and tracer.stamps[last] <= deadline:
        return first, last
    if last >= len(tracer.stamps) and not tracer.is_complete_until(deadline):
        return Wait(tracer, begin, last + 1 - len(tracer.stamps), deadline)
    raise _too_few(attempt, tracer, settings, deadline, begin)


def _too_few(
    attempt: Attempt, tracer: TracerStream, settings: CaptureSettings, deadline: int, begin: int
) -> AttemptRejectedError:
    """Return a reason: there is no whole window from ``begin`` on, and what to change."""
    first = tracer.index(begin)
    count = max(0, tracer.index(deadline + 1) - first)
    left_s = max(0.0, seconds(deadline - begin))
    reason = phrase(
        "only {0} of {1} tracer readings in the {2:.3g} s remaining after settling", count,
        settings.window_samples, left_s
    )  # fmt: skip
    pauses = np.diff(tracer.stamps[-settings.window_samples :])
    needed_s = settings.window_samples * seconds(int(np.median(pauses))) if len(pauses) else 0.0
    if needed_s > settings.step_timeout_s - settings.settle_time_s:
        reason = phrase(
            "{0}; that many take {1:.3g} s: reduce capture.window_samples, or increase "
            "capture.step_timeout_s and planner.step_timeout_s", reason, needed_s
        )  # fmt: skip
    if not count and first < len(tracer.stamps):
        ahead = seconds(int(tracer.stamps[first]) - begin)
        reason = phrase(
            "{0}; the next is stamped {1:.3g} s after settling (another clock?)", reason, ahead
        )
    elif not count:
        reason = _early_reading(reason, attempt, tracer, begin)
    return AttemptRejectedError(reason)


def _observe(
    attempt: Attempt, streams: AttemptStreams, settings: CaptureSettings, first: int, last: int
) -> Observation:
    """Reduce the readings ``first`` to ``last``, the latter included."""
    tracer = streams.tracer
    stamps, readings = tracer.stamps[first : last + 1], tracer.values[first : last + 1]
    begin_ns, end_ns = int(stamps[0]), int(stamps[-1])
    epoch, since_ns = streams.counted_from or (tracer.beam.epoch, attempt.begin_ns)
    _refuse_clock_jump(tracer, attempt.begin_ns, last)
    return attempt.observation(
        reduce_window(stamps, readings, settings),
        n_samples=len(stamps),
        window_ns=(begin_ns, end_ns),
        table_angle_measured=mean_angle(streams.table, begin_ns, end_ns, attempt.step.table_angle),
        air=streams.air_at(attempt, settings),
        segment=tracer.beam.segment(since_ns, begin_ns, end_ns, epoch),
    )


def _refuse_clock_jump(tracer: TracerStream, begin_ns: int, last: int) -> None:
    """Raise if the tracer's clock was set ahead between ``begin_ns`` and the reading ``last``.

    Readings with successive numbers must not have stamps far apart, except those of a single shot.
    """
    if tracer.single_shot:
        return
    first = max(0, tracer.index(begin_ns) - 1)
    pauses = np.diff(tracer.stamps[first : last + 1])
    number = tracer.values[first : last + 1, SEQUENCE]
    steps = sequence_steps(number[1:], number[0])
    usual = float(np.median(pauses)) if len(pauses) else 0.0
    limit = max(CLOCK_JUMP_S / NANOSECOND, LONG_PAUSE * usual)
    at = np.flatnonzero((steps == 1) & (pauses > limit))
    if len(at):
        raise AttemptRejectedError(
            "the stamps of the tracer readings jump ahead by {0:.3g} s from {1} to {2}: "
            "their clock was set, or the instrument stood still (one that always does: "
            "topics.length_single_shot)", pauses[at[0]] * NANOSECOND, int(number[at[0]]),
            int(number[at[0] + 1])
        )  # fmt: skip


def single_shot_missing(attempt: Attempt, wait: Wait, lag_ns: int) -> AttemptRejectedError:
    """Return the reason that a single shot did not come."""
    reason = phrase(
        "{0} tracer readings of the window have not come in {1:.3g} s: expected one for each "
        "order and step, taken at the earliest capture.settle_time_s after the table came to "
        "rest, or requested by topics.length_trigger", wait.samples, seconds(lag_ns)
    )  # fmt: skip
    return AttemptRejectedError(_early_reading(reason, attempt, wait.stream, wait.stamp_ns))


def _early_reading(reason: Phrase, attempt: Attempt, tracer: Stream, begin_ns: int) -> Phrase:
    """Return why a window has no readings, with the last one before the table had settled."""
    first = tracer.index(begin_ns)
    if not first or tracer.stamps[first - 1] <= attempt.begin_ns:
        return reason
    early_s = seconds(begin_ns - int(tracer.stamps[first - 1]))
    return phrase(
        "{0}; the last one is stamped {1:.3g} s before the end of settling: it was taken too "
        "early (capture.settle_time_s)", reason, early_s
    )  # fmt: skip


PointReducer = Callable[[Sequence[ProbeSample], Step, CaptureSettings], ReducedWindow]
"""How the points of a step become one value."""


def decide_points(
    attempt: Attempt, streams: AttemptStreams, settings: CaptureSettings, reduce: PointReducer
) -> Observation | Wait:
    """Return the observation of a step that only the probe measures, or what is needed.

    ``reduce`` makes one value of the points. All ``n_points`` of them must come before the
    deadline, with the table at rest in position from the first point to the last; raises
    AttemptRejectedError where they did not come, or are no longer known.
    """
    wanted, samples, table = attempt.step.n_points, attempt.samples, streams.table
    deadline = attempt.deadline_ns(settings)
    patience = deadline + nanoseconds(settings.clock_tolerance_s)  # points may arrive late
    if (
        len(samples) < wanted
        and attempt.superseded_ns is None
        and not table.is_complete_until(patience)
    ):
        return Wait(table, patience)
    if len(samples) < wanted or samples[-1].stamp_ns > deadline:
        raise AttemptRejectedError(
            "only {0} of {1} probe points within {2:.3g} s", len(samples), wanted,
            seconds(deadline - attempt.begin_ns)
        )  # fmt: skip
    begin_ns, end_ns = samples[0].stamp_ns, samples[-1].stamp_ns
    if not table.is_complete_until(end_ns):
        return Wait(table, end_ns)
    if is_no_longer_in_memory(table, begin_ns):
        raise AttemptRejectedError("table feedback from the time of the points has left memory")
    angle = attempt.step.table_angle
    reduced = reduce(samples, attempt.step, settings)
    if departure(table, begin_ns, end_ns, angle, settings) is not None:
        off = largest_offset(table, begin_ns, end_ns, angle) / ARCSEC
        reduced = ReducedWindow(
            reason=phrase(
                "table not at rest in position during the probe points: up to {0:.4g} "
                "arcsec off (allowed {1:g})",
                off,
                settings.position_tolerance_arcsec,
            )
        )
    return attempt.observation(
        reduced,
        n_samples=len(samples),
        window_ns=(begin_ns, end_ns),
        table_angle_measured=mean_angle(table, begin_ns, end_ns, angle),
        air=streams.air_at(attempt, settings),
    )


def decide_by_points(reduce: PointReducer) -> Decide:
    """Return the way to decide a step whose points ``reduce`` makes one value of."""
    return partial(decide_points, reduce=reduce)


def mean_point(
    samples: Sequence[ProbeSample], _step: Step, _settings: CaptureSettings
) -> ReducedWindow:
    """Return the mean of repeated points (m), or the one point with its own deviation."""
    if len(samples) == 1:
        std = samples[0].position_std
        return ReducedWindow(mean=samples[0].position, std=std, scatter=std, n_used=1)
    positions = np.array([sample.position for sample in samples])
    columns = [mean_and_scatter(column) for column in positions.T]
    scatter = tuple(s for _, s in columns)
    return ReducedWindow(
        mean=tuple(mean for mean, _ in columns),
        std=tuple(s / sqrt(len(samples)) for s in scatter),
        scatter=scatter,
        n_used=len(samples),
    )
