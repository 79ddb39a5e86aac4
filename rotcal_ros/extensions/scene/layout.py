"""The layout of a cell: the places of a plan, what was seen at each, and who looks at them."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.geometry.rotations import rotation_about_z
from rotcal_ros.methods import Calibration
from rotcal_ros.methods.method import Stations
from rotcal_ros.planning.plan import Point, Step

_MARGIN = 1.2
_LEAST_RADIUS_M = 0.1


class PlaceState(Enum):
    """What was last seen at a place."""

    OPEN = "open"
    CURRENT = "current"
    DONE = "done"
    REJECTED = "rejected"


@dataclass(frozen=True)
class SceneLayout:
    """Nominal geometry of a plan in the table's fixed frame, which is the machine's too (m).

    ``places`` are those that the plan's steps go to, each once; ``radius`` is that of the table.
    """

    steps: tuple[Step, ...]
    places: tuple[Point, ...]
    stations: Stations
    radius: float

    def instruments(self, angle: float) -> Floats:
        """Return where the instruments stand, (n, 3), with the table at ``angle`` (rad)."""
        places = np.array(self.stations.places).reshape(-1, 3)
        return places @ rotation_about_z(angle).T if self.stations.carried else places

    def beam(self, step: Step, angle: float) -> Floats | None:
        """Return the ends (2, 3) of the beam to a step's place; None where there is no beam."""
        if step.station >= len(self.stations.places):
            return None
        return np.array([self.instruments(angle)[step.station], step.position])


def layout_of(calibration: Calibration) -> SceneLayout:
    """Return the layout of a calibration; the table reaches as far as what it carries."""
    method, plan = calibration.method, calibration.plan
    stations = Stations()
    if method.stations is not None:
        stations = method.stations(calibration.configuration)
    places = tuple(dict.fromkeys(step.position for step in plan.steps))
    on_table = stations.places if stations.carried else ()
    if not stations.places:
        on_table = places  # an artefact on the table is what is measured
    reach = max((float(np.hypot(x, y)) for x, y, _ in on_table), default=0.0)
    return SceneLayout(plan.steps, places, stations, max(_MARGIN * reach, _LEAST_RADIUS_M))


class SceneProgress:
    """What was last seen at the places of a layout."""

    def __init__(self, layout: SceneLayout) -> None:
        index = {place: number for number, place in enumerate(layout.places)}
        self._place = [index[step.position] for step in layout.steps]
        self._seen = [PlaceState.OPEN] * len(layout.places)
        self._ordered: int | None = None

    def order(self, step: int) -> None:
        """Note that ``step`` is measured now."""
        self._ordered = step

    def observe(self, step: int, *, accepted: bool) -> None:
        """Note what became of a step."""
        self._seen[self._place[step]] = PlaceState.DONE if accepted else PlaceState.REJECTED
        if step == self._ordered:
            self._ordered = None

    @property
    def states(self) -> tuple[PlaceState, ...]:
        """The state of each place."""
        states = list(self._seen)
        if self._ordered is not None:
            states[self._place[self._ordered]] = PlaceState.CURRENT
        return tuple(states)
