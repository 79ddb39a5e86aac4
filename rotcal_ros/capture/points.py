"""The probe-only path: one or several probe points while the table is at rest in position."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from math import sqrt

import numpy as np

from rotcal_ros.capture.attempt import (
    Attempt,
    AttemptRejectedError,
    AttemptStreams,
    Decide,
    Wait,
    forgotten,
    nanoseconds,
    seconds,
)
from rotcal_ros.capture.settings import CaptureSettings
from rotcal_ros.capture.table import departure, farthest, mean_angle
from rotcal_ros.capture.window import ReducedWindow, mean_and_scatter
from rotcal_ros.foundation.observations import Observation, ProbeSample
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.planning.plan import Step

PointReducer = Callable[[Sequence[ProbeSample], Step, CaptureSettings], ReducedWindow]
"""How the points of a step become one value."""


def decide_points(
    attempt: Attempt, streams: AttemptStreams, settings: CaptureSettings, reduce: PointReducer
) -> Observation | Wait:
    """Return the observation of a step that only the probe measures, or what is needed.

    ``reduce`` makes one value of the points. All ``n_points`` must come before the deadline, with
    the table at rest in position from the first to the last; raises AttemptRejectedError if they
    did not come, or are no longer in memory.
    """
    wanted, samples, table = attempt.step.n_points, attempt.samples, streams.table
    deadline = attempt.deadline_ns(settings)
    patience = deadline + nanoseconds(settings.clock_tolerance_s)  # points may arrive late
    if len(samples) < wanted and attempt.superseded_ns is None and not table.knows(patience):
        return Wait(table, patience)
    if len(samples) < wanted or samples[-1].stamp_ns > deadline:
        raise AttemptRejectedError(
            f"only {len(samples)} of {wanted} probe points within "
            f"{seconds(deadline - attempt.begin_ns):.3g} s"
        )
    begin_ns, end_ns = samples[0].stamp_ns, samples[-1].stamp_ns
    if not table.knows(end_ns):
        return Wait(table, end_ns)
    if forgotten(table, begin_ns):
        raise AttemptRejectedError("table feedback at the time of the points is not in memory")
    angle = attempt.step.table_angle
    reduced = reduce(samples, attempt.step, settings)
    if departure(table, begin_ns, end_ns, angle, settings) is not None:
        off = farthest(table, begin_ns, end_ns, angle) / ARCSEC
        reduced = ReducedWindow(
            reason=f"table not at rest in position during the probe points: up to {off:.4g} "
            f"arcsec off (allowed {settings.position_tolerance_arcsec:g})"
        )
    return attempt.observation(
        reduced,
        n_samples=len(samples),
        window_ns=(begin_ns, end_ns),
        table_angle_measured=mean_angle(table, begin_ns, end_ns, angle),
        air=streams.air_at(attempt, settings),
    )


def points(reduce: PointReducer) -> Decide:
    """Return the function that decides a step whose points ``reduce`` turns into one value."""
    return partial(decide_points, reduce=reduce)


def mean_point(
    samples: Sequence[ProbeSample], _step: Step, _settings: CaptureSettings
) -> ReducedWindow:
    """Return the mean of repeated points (m), or a single point with its own deviation."""
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
