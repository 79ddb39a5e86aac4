"""Points of a tracker that cannot be, though they were measured well: points exchanged."""

from __future__ import annotations

from dataclasses import replace
from math import dist, hypot

from rotcal_ros.foundation.observations import Observation, PointKind
from rotcal_ros.foundation.units import MILLIMETRE
from rotcal_ros.methods.plane_mirror.solver.nest_tests import MIN_APART
from rotcal_ros.methods.plane_mirror.solver.screening import MIN_SEPARATION


class TrackerCheck:
    """Rejects points of a laser tracker that contradict those of the same station.

    The image of a reflector is farther away than the reflector itself, and two nests stand
    apart. What is found while the reflector is still there can be measured again at once.
    """

    def __init__(self) -> None:
        self._direct: dict[tuple[int, int, int], tuple[float, ...]] = {}
        self._nests: dict[int, dict[int, tuple[float, ...]]] = {}

    def __call__(self, observation: Observation) -> Observation:
        """Return the observation, rejected when it cannot be."""
        if not observation.accepted:
            return observation
        reason = ""
        key = (observation.station, observation.table_position, observation.target)
        if observation.kind == PointKind.DIRECT:
            self._direct[key] = observation.mean
        elif observation.kind == PointKind.MIRRORED and key in self._direct:
            reason = _not_an_image(self._direct[key], observation.mean)
        elif observation.kind == PointKind.NEST:
            reason = self._on_another_nest(observation)
        return replace(observation, accepted=False, reason=reason) if reason else observation

    def _on_another_nest(self, observation: Observation) -> str:
        nests = self._nests.setdefault(observation.station, {})
        for number, place in nests.items():
            apart = dist(place, observation.mean)
            if number != observation.target and apart < MIN_APART:
                return (
                    f"nest {observation.target} is {apart / MILLIMETRE:.3f} mm from where nest "
                    f"{number} was measured: reflector on the wrong nest"
                )
        nests[observation.target] = observation.mean
        return ""


def _not_an_image(direct: tuple[float, ...], mirrored: tuple[float, ...]) -> str:
    """Say why a point is not the image of the reflector at ``direct``; empty: it may be."""
    apart = dist(direct, mirrored)
    if apart < MIN_SEPARATION:
        return (
            f"the mirrored point is {apart / MILLIMETRE:.3f} mm from the direct one: the same "
            "point was measured twice; measure the image through the mirror"
        )
    near, far = hypot(*direct), hypot(*mirrored)
    if near >= far:
        return (
            f"the mirrored point is {far:.4f} m away, the direct one {near:.4f} m, but an image "
            "is always the farther one: direct and mirrored exchanged"
        )
    return ""
