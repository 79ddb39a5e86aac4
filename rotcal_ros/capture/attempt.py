"""One attempt at a step: the streams and rules that judge it, and its observation.

The rules are those of a method: how its steps become observations, and which contradict others.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import nan
from typing import Final

from rotcal_ros.capture.air import AirStreams, ObservedAir
from rotcal_ros.capture.settings import CaptureSettings
from rotcal_ros.capture.streams import NEVER, Stream
from rotcal_ros.capture.window import ReducedWindow, TracerStream
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.language import NOTHING, phrase
from rotcal_ros.foundation.observations import Observation, PointKind, ProbeSample
from rotcal_ros.foundation.units import NANOSECOND
from rotcal_ros.planning.plan import Plan, Step

UNKNOWN_AIR: Final = ObservedAir()


class AttemptRejectedError(DataError):
    """An attempt cannot become a measured value, for this ``reason`` in the observation."""

    def __init__(self, reason: str, *parts: object) -> None:
        """Set the reason, a template and what fills its places, or a phrase."""
        self.reason = phrase(reason, *parts)
        super().__init__(self.reason)


@dataclass(frozen=True, slots=True)
class Wait:
    """No decision yet: ``stream`` must come to ``stamp_ns`` and bring ``samples`` more.

    From ``latest_ns`` on fewer samples are enough.
    """

    stream: Stream
    stamp_ns: int
    samples: int = 1
    latest_ns: int = NEVER


@dataclass
class AttemptStreams:
    """The streams that an attempt is judged by.

    ``nest`` are the points that are read while the table turns: sequence, and three values (m).
    ``since_ns`` is the stamp of the first probe sample. Earlier readings of the air are not used,
    since their number depends on when the capture began to listen; nor are those from before a
    clock was set back. ``counted_from`` is the epoch and the stamp from which the segments of the
    beam are counted, ``settled_ns`` the stamp from which all streams have followed a clock that
    was set back.
    """

    tracer: TracerStream
    table: Stream
    nest: Stream
    air: AirStreams
    since_ns: int | None = None
    counted_from: tuple[int, int] | None = None
    settled_ns: int = 0
    _belated: tuple[tuple[int, int], ...] = ()
    _times_set_back: int = 0

    def begin(self, stamp_ns: int) -> None:
        """Take a probe sample that begins an attempt."""
        self.since_ns = stamp_ns if self.since_ns is None else self.since_ns
        self.counted_from = self.counted_from or (self.tracer.beam.epoch, stamp_ns)

    def reset(self, settling_ns: int) -> None:
        """Forget the air that was read before the clock of a stream was set back.

        Samples of the other streams with older stamps arrive at ``settling_ns`` at the latest.
        """
        set_back = [s for s in self.fast if s.counts.set_back]
        newest = max(s.forgotten for s in set_back if s.forgotten is not None)
        self.since_ns = self.settled_ns = newest + settling_ns
        self._belated = tuple(late_stamp_range(s, settling_ns) for s in set_back)
        times = max(s.counts.set_back for s in set_back)
        self.air.reset(self._belated, follows=times == self._times_set_back)
        self._times_set_back = times

    def before_set_back(self, stamp_ns: int) -> bool:
        """Return whether a sample that has just come was stamped before the clock was set back."""
        if not any(self.settled_ns <= a <= stamp_ns <= b for a, b in self._belated):
            return False
        fast = (s.latest for s in self.fast if s.set_back_at is not None)
        return all(latest is None or latest < self.settled_ns for latest in fast)

    @property
    def fast(self) -> tuple[Stream, ...]:
        """The streams that send all the time."""
        return self.tracer, self.table, self.nest

    def by_name(self) -> dict[str, Stream]:
        """Return the streams, fastest first."""
        return dict(zip(("tracer", "table", "nest"), self.fast, strict=True)) | self.air.by_name

    def lag_ns(self, attempt: Attempt, wait: Wait) -> int:
        """Return how far the awaited stream is behind the newest of probe, tracer and table."""
        newest = max(attempt.begin_ns, *(self.reached(stream, attempt) for stream in self.fast))
        return newest - self.reached(wait.stream, attempt)

    def reached(self, stream: Stream, attempt: Attempt) -> int:
        """Return how far a stream has come; one without samples is at the begin of the attempt.

        So is a single shot that comes only later.
        """
        if stream.latest is None:
            return attempt.begin_ns
        return max(stream.latest, attempt.begin_ns) if stream.single_shot else stream.latest

    def timeout_ns(self, stream: Stream, settings: CaptureSettings) -> int:
        """Return how far a stream may be behind the others."""
        timeout_s = settings.step_timeout_s if stream.single_shot else 0.0
        return nanoseconds(settings.clock_tolerance_s) + nanoseconds(timeout_s)

    def air_at(self, attempt: Attempt, settings: CaptureSettings) -> ObservedAir:
        """Return the air of an attempt."""
        return self.air.at(attempt.due_ns, self.since_ns, settings)


@dataclass
class Attempt:
    """An attempt at a step, from the first probe sample that echoes it.

    ``samples`` are the probe samples so far. ``superseded_ns`` is the stamp of the first probe
    sample of the next attempt, once known: nothing later can belong to this one. From
    ``search_ns`` on the table may be in position, or pass it in the turn that began then. The
    steps that a turn passes share the order and the sample of the first.
    ``rejected`` is set as soon as it is certain that the attempt cannot succeed.
    """

    step: Step
    number: int
    run: int
    samples: list[ProbeSample]
    search_ns: int
    rejected: AttemptRejectedError | None = None
    superseded_ns: int | None = None

    @property
    def begin_ns(self) -> int:
        """Stamp of the machine's first answer to the command."""
        return self.samples[0].stamp_ns

    @property
    def due_ns(self) -> int:
        """Stamp at which the table may be at its angle at the earliest: a turn takes its time."""
        turn = self.step.turn
        if turn is None:
            return self.begin_ns
        return self.begin_ns + nanoseconds((self.step.table_angle - turn.begin) / turn.speed)

    @property
    def was_ordered(self) -> bool:
        """Whether its step was ordered; the later ones of a turn are not."""
        return self.samples[0].step == self.step.index

    def next_in_turn(self, plan: Plan) -> Attempt | None:
        """Return the attempt at the step that the same turn passes next, if there is one."""
        index = self.step.index + 1
        if index == len(plan.steps) or not plan.steps[index].follows(self.step):
            return None
        return replace(self, step=plan.steps[index])

    def deadline_ns(self, settings: CaptureSettings) -> int:
        """Return the last stamp that may belong to this attempt."""
        deadline = self.due_ns + nanoseconds(settings.step_timeout_s)
        if self.superseded_ns is not None:
            deadline = min(deadline, self.superseded_ns - 1)
        return max(deadline, self.begin_ns)

    def observation(
        self,
        reduced: ReducedWindow,
        *,
        n_samples: int = 0,
        window_ns: tuple[int, int] | None = None,
        table_angle_measured: float = nan,
        air: ObservedAir = UNKNOWN_AIR,
        segment: int = 0,
    ) -> Observation:
        """Return the observation of this attempt; a reason in ``reduced`` rejects it."""
        begin, end = window_ns or (self.begin_ns, self.begin_ns)
        return replace(
            self.step.observed(reduced.mean),
            attempt=self.number,
            std=reduced.std,
            scatter=reduced.scatter,
            probe_position=self.samples[0].position,
            n_samples=n_samples,
            n_used=reduced.n_used,
            accepted=not reduced.reason,
            reason=reduced.reason or NOTHING,
            table_angle_measured=table_angle_measured,
            temperature_c=air.temperature_c,
            pressure_pa=air.pressure_pa,
            humidity=air.humidity,
            window_start_ns=begin,
            window_end_ns=end,
            run=self.run,
            segment=segment,
        )

    def rejection(self, error: AttemptRejectedError) -> Observation:
        """Return the observation of an attempt that never got a window."""
        return self.observation(ReducedWindow(reason=error.reason))


def late_stamp_range(stream: Stream, settling_ns: int) -> tuple[int, int]:
    """Return the range of stamps that may still arrive from before a stream was set back."""
    assert stream.set_back_at is not None
    margin = min(settling_ns, stream.set_back_ns // 2)
    return stream.set_back_at - margin, stream.set_back_at + margin


def is_no_longer_in_memory(stream: Stream, stamp_ns: int) -> bool:
    """Return whether samples from ``stamp_ns`` on are no longer in memory."""
    return stream.forgotten is not None and stream.forgotten >= stamp_ns


def nanoseconds(duration_s: float) -> int:
    """Return a duration in integer nanoseconds."""
    return round(duration_s / NANOSECOND)


def seconds(duration_ns: int) -> float:
    """Return a duration in seconds."""
    return duration_ns * NANOSECOND


Decide = Callable[[Attempt, AttemptStreams, CaptureSettings], Observation | Wait]
"""Returns the observation of an attempt, or what it waits for."""
Check = Callable[[Observation], Observation]
"""Returns an observation as it is, or rejected because it contradicts the earlier ones."""


def no_checks(_plan: Plan) -> Sequence[Check]:
    """Return no checks: every observation stands for itself."""
    return ()


@dataclass(frozen=True)
class CaptureRules:
    """How the streams of a method become observations.

    ``decide`` has one entry for every kind of step in the method's plans; see
    :mod:`~rotcal_ros.capture.decisions` for the two ways there are. ``checks`` makes the checks
    of one run; they see the observations in their order.
    """

    decide: Mapping[PointKind, Decide]
    checks: Callable[[Plan], Sequence[Check]] = no_checks
