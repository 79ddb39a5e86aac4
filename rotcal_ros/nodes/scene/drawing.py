"""What a scene looks like: the layout of a cell, and the shapes and frames that show it.

Lengths in metres; colours are red, green, blue and opacity, 0 to 1.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Final, TypeAlias

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.geometry.rotations import rotation_about_z
from rotcal_ros.methods import Calibration
from rotcal_ros.methods.method import Stations
from rotcal_ros.planning.plan import Point, Step

Colour: TypeAlias = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True)
class Disc:
    """A disc about +z: its middle, radius and thickness."""

    name: str
    centre: Point
    radius: float
    thickness: float
    colour: Colour


@dataclass(frozen=True, slots=True, eq=False)
class Lines:
    """Straight lines between pairs of points, (n, 2, 3)."""

    name: str
    points: Floats
    width: float
    colour: Colour


@dataclass(frozen=True, slots=True, eq=False)
class Balls:
    """Balls of one size at points (n, 3), each with its colour."""

    name: str
    points: Floats
    diameter: float
    colours: tuple[Colour, ...]


@dataclass(frozen=True, slots=True)
class Label:
    """A text that always faces the viewer; ``height`` is that of a capital letter."""

    name: str
    place: Point
    text: str
    height: float
    colour: Colour


Shape: TypeAlias = Disc | Lines | Balls | Label


@dataclass(frozen=True, slots=True)
class Transform:
    """Where a frame lies in its parent: moved by ``translation`` (m), turned about +z (rad)."""

    parent: str
    child: str
    translation: Point = (0.0, 0.0, 0.0)
    angle: float = 0.0


_MARGIN = 1.2
_LEAST_RADIUS_M = 0.1


class TargetState(Enum):
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
        """Return the ends (2, 3) of the beam to a step's place; None if there is no beam."""
        if step.station >= len(self.stations.places):
            return None
        return np.array([self.instruments(angle)[step.station], step.position])


def make_layout(calibration: Calibration) -> SceneLayout:
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
        self._seen = [TargetState.OPEN] * len(layout.places)
        self._ordered: int | None = None

    def order(self, step: int) -> None:
        """Note that ``step`` is measured now."""
        self._ordered = step

    def observe(self, step: int, *, accepted: bool) -> None:
        """Note what became of a step."""
        self._seen[self._place[step]] = TargetState.DONE if accepted else TargetState.REJECTED
        if step == self._ordered:
            self._ordered = None

    @property
    def states(self) -> tuple[TargetState, ...]:
        """The state of each place."""
        states = list(self._seen)
        if self._ordered is not None:
            states[self._place[self._ordered]] = TargetState.CURRENT
        return tuple(states)


TABLE_BASE: Final = "table_base"
TABLE: Final = "table"
MACHINE: Final = "machine"
TRACER: Final = "tracer"

GREY: Final[Colour] = (0.55, 0.58, 0.62, 0.6)
DARK: Final[Colour] = (0.2, 0.22, 0.25, 1.0)
BLUE: Final[Colour] = (0.0, 0.45, 0.7, 1.0)
RED: Final[Colour] = (0.9, 0.1, 0.1, 0.9)
COLOURS: Final[Mapping[TargetState, Colour]] = {
    TargetState.OPEN: (0.6, 0.6, 0.6, 0.7),
    TargetState.CURRENT: (0.94, 0.89, 0.26, 1.0),
    TargetState.DONE: (0.0, 0.62, 0.45, 1.0),
    TargetState.REJECTED: (0.84, 0.37, 0.0, 1.0),
}
"""Colours of places, distinct also for people who confuse red and green (Okabe and Ito)."""
_UP: Final = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class DrawnDeviations:
    """Deviations of the table: ``translation`` (n, 3) m and ``rotation`` (n, 3) rad.

    At commanded angles (n,) rad; zero where a deviation was not measured.
    """

    angles: Floats
    translation: Floats
    rotation: Floats

    def displacements(self, radius: float) -> tuple[Floats, Floats]:
        """Return places of the table's rim (n, 3) and how far they are from there (n, 3), m.

        They are those of the mark that is at ``radius`` on +x at angle 0.
        """
        places = rotation_about_z(self.angles) @ np.array([radius, 0.0, 0.0])
        return places, self.translation + np.cross(self.rotation, places)


def draw_static_shapes(
    layout: SceneLayout,
    states: Sequence[TargetState],
    errors: DrawnDeviations | None,
    exaggeration: float,
) -> tuple[Shape, ...]:
    """Return the axis, the places with their states, and the errors ``exaggeration`` times."""
    radius = layout.radius
    axis = np.array([[-0.5 * radius * _UP, 1.5 * radius * _UP]])
    shapes: list[Shape] = [
        Lines("axis", axis, 0.01 * radius, DARK),
        Balls(
            "places",
            np.array(layout.places),
            0.08 * radius,
            tuple(COLOURS[state] for state in states),
        ),
    ]
    if errors is not None and len(errors.angles):
        places, displacements = errors.displacements(radius)
        ends = np.stack([places, places + exaggeration * displacements], axis=1)
        text = f"errors x {exaggeration:g}"
        top = (0.0, 0.0, 1.6 * radius)
        shapes += [
            Lines("errors", ends, 0.015 * radius, RED),
            Label("exaggeration", top, text, 0.12 * radius, DARK),
        ]
    return tuple(shapes)


def draw_moving_shapes(layout: SceneLayout, angle: float, step: Step | None) -> tuple[Shape, ...]:
    """Return the table at ``angle`` (rad), its zero mark, the instruments, and the beam."""
    radius, thickness = layout.radius, 0.06 * layout.radius
    mark = np.stack([np.zeros(3), rotation_about_z(angle) @ np.array([radius, 0.0, 0.0])])
    shapes: list[Shape] = [
        Disc("table", (0.0, 0.0, -0.5 * thickness), radius, thickness, GREY),
        Lines("zero mark", mark[None], 0.02 * radius, DARK),
    ]
    instruments = layout.instruments(angle)
    if len(instruments):
        colours = (BLUE,) * len(instruments)
        shapes.append(Balls("instruments", instruments, 0.2 * radius, colours))
    beam = layout.beam(step, angle) if step is not None else None
    if beam is not None:
        shapes.append(Lines("beam", beam[None], 0.012 * radius, RED))
    return tuple(shapes)


def fixed_frames() -> tuple[Transform, ...]:
    """Return the frames that do not move: in plans machine and fixed table frame are one."""
    return (Transform(MACHINE, TABLE_BASE),)


def moving_frames(layout: SceneLayout, angle: float, step: Step | None) -> tuple[Transform, ...]:
    """Return the frame that turns with the table (rad), and that of a tracer on it."""
    frames = [Transform(TABLE_BASE, TABLE, angle=angle)]
    places, number = layout.stations.places, 0 if step is None else step.station
    if layout.stations.carried and number < len(places):
        frames.append(Transform(TABLE, TRACER, places[number]))
    return tuple(frames)
