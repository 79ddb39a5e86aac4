"""Lengths of one place are compared with those of the same place only: zeros differ."""

from __future__ import annotations

from rotcal_ros.foundation.observations import Observation
from rotcal_ros.methods.tracer.lengths import LengthCheck
from rotcal_ros.planning.plan import Plan


class PlaceLengths:
    """Rejects lengths that cannot be metres, place by place."""

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._checks: dict[int, LengthCheck] = {}

    def __call__(self, observation: Observation) -> Observation:
        """Return the observation, rejected when it cannot be."""
        check = self._checks.setdefault(observation.station, LengthCheck(self._plan))
        return check(observation)
