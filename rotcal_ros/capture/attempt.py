"""One attempt at a step, the streams it is judged by, and the observation that comes of it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import nan

from rotcal_ros.capture.settings import CaptureSettings
from rotcal_ros.capture.streams import NEVER, Stream
from rotcal_ros.capture.window import Reduced, TracerStream
from rotcal_ros.observations import Observation, ProbeSample
from rotcal_ros.planning.plan import Step
from rotcal_ros.units import NANOSECOND


@dataclass(frozen=True, slots=True)
class Wait:
    """No decision yet: ``stream`` must come to ``stamp_ns`` and bring ``samples`` more.

    From ``latest_ns`` on fewer samples decide as well.
    """

    stream: Stream
    stamp_ns: int
    samples: int = 1
    latest_ns: int = NEVER


@dataclass
class Streams:
    """The streams that an attempt is judged by; temperature holds one column (degC).

    ``since_ns`` is the stamp of the first probe sample. Temperatures before it are not used:
    how many of them there are depends on when somebody began to listen.
    """

    tracer: TracerStream
    table: Stream
    temperature: Stream
    since_ns: int | None = None

    def all(self) -> tuple[Stream, ...]:
        """Return the streams, fastest first."""
        return self.tracer, self.table, self.temperature


@dataclass
class Attempt:
    """An attempt at a step, from the first probe sample that echoes it.

    ``samples`` are the probe samples so far. ``superseded_ns`` is the stamp of the first probe
    sample of the next attempt, once known: nothing later can belong to this one. ``search_ns``
    is from when the table may be in position. A non-empty ``refusal`` needs no further look.
    """

    step: Step
    number: int
    run: int
    samples: list[ProbeSample]
    search_ns: int
    refusal: str
    superseded_ns: int | None = None

    @property
    def begin_ns(self) -> int:
        """Stamp of the machine's first answer to the command."""
        return self.samples[0].stamp_ns

    def deadline_ns(self, settings: CaptureSettings) -> int:
        """Return the last stamp that may belong to this attempt."""
        deadline = self.begin_ns + nanoseconds(settings.step_timeout_s)
        if self.superseded_ns is not None:
            deadline = min(deadline, self.superseded_ns - 1)
        return max(deadline, self.begin_ns)

    def observation(
        self,
        reduced: Reduced,
        *,
        n_samples: int = 0,
        window_ns: tuple[int, int] | None = None,
        table_angle_measured: float = nan,
        temperature_c: float | None = None,
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
            reason=reduced.reason,
            table_angle_measured=table_angle_measured,
            temperature_c=temperature_c,
            window_start_ns=begin,
            window_end_ns=end,
            run=self.run,
            segment=segment,
        )

    def rejection(self, reason: str) -> Observation:
        """Return the observation of an attempt that never came to a window."""
        return self.observation(Reduced(reason=reason))


def temperature_at(streams: Streams, begin_ns: int, settings: CaptureSettings) -> float | None:
    """Return the temperature (degC) that goes with an attempt; None: there is none.

    It is the last reading stamped ``temperature_lag_s`` or more before the probe reached its
    target, else the first one of the calibration: a choice that later readings do not change.
    """
    stream = streams.temperature
    wanted = _temperature_stamp(streams, begin_ns, settings)
    if not (settings.temperature_expected and stream.knows(wanted)):
        return None
    row = max(stream.index(wanted + 1) - 1, stream.index(streams.since_ns or 0))
    if abs(int(stream.stamps[row]) - wanted) > nanoseconds(settings.clock_tolerance_s):
        return None
    return float(stream.values[row, 0])


def missing_temperature(streams: Streams, begin_ns: int, settings: CaptureSettings) -> Wait | None:
    """Return what to wait for before :func:`temperature_at` is known for good."""
    wanted = _temperature_stamp(streams, begin_ns, settings)
    if not settings.temperature_expected or streams.temperature.knows(wanted):
        return None
    return Wait(streams.temperature, wanted)


def _temperature_stamp(streams: Streams, begin_ns: int, settings: CaptureSettings) -> int:
    """Return the stamp at which an attempt that began at ``begin_ns`` reads the temperature."""
    wanted = begin_ns - nanoseconds(settings.temperature_lag_s)
    return wanted if streams.since_ns is None else max(wanted, streams.since_ns)


def forgotten(stream: Stream, stamp_ns: int) -> bool:
    """Return whether samples from ``stamp_ns`` on are no longer in memory."""
    return stream.forgotten is not None and stream.forgotten >= stamp_ns


def nanoseconds(duration_s: float) -> int:
    """Return a duration in integer nanoseconds."""
    return round(duration_s / NANOSECOND)


def seconds(duration_ns: int) -> float:
    """Return a duration in seconds."""
    return duration_ns * NANOSECOND
