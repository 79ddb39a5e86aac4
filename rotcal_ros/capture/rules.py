"""What a method tells the capture: how its steps become observations, and what cannot be."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from rotcal_ros.capture.attempt import Attempt, AttemptStreams, Wait
from rotcal_ros.capture.settings import CaptureSettings
from rotcal_ros.foundation.observations import Observation, PointKind
from rotcal_ros.planning.plan import Plan

Decide = Callable[[Attempt, AttemptStreams, CaptureSettings], Observation | Wait]
"""Returns the observation of an attempt, or what it waits for."""
Check = Callable[[Observation], Observation]
"""Returns an observation as it is, or rejected because it contradicts the earlier ones."""


def no_checks(_plan: Plan) -> Sequence[Check]:
    """Return nothing: every observation stands for itself."""
    return ()


@dataclass(frozen=True)
class CaptureRules:
    """How the streams of a method are understood.

    ``decide`` has one entry for every kind of step in the method's plans; see
    :mod:`~rotcal_ros.capture.length` and :mod:`~rotcal_ros.capture.points` for the two ways
    there are. ``checks`` makes the checks of one run; they see the observations in their order.
    """

    decide: Mapping[PointKind, Decide]
    checks: Callable[[Plan], Sequence[Check]] = no_checks
