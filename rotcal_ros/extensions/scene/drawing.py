"""Drawing a layout: what stands still, and what moves with table and plan."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from rotcal_ros.extensions.scene.layout import Layout, State
from rotcal_ros.extensions.scene.shapes import Balls, Colour, Disc, Label, Lines, Shape, Transform
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.geometry.rotations import rotation_about_z
from rotcal_ros.planning.plan import Step

TABLE_BASE: Final = "table_base"
TABLE: Final = "table"
MACHINE: Final = "machine"
TRACER: Final = "tracer"

GREY: Final[Colour] = (0.55, 0.58, 0.62, 0.6)
DARK: Final[Colour] = (0.2, 0.22, 0.25, 1.0)
BLUE: Final[Colour] = (0.0, 0.45, 0.7, 1.0)
RED: Final[Colour] = (0.9, 0.1, 0.1, 0.9)
COLOURS: Final[Mapping[State, Colour]] = {
    State.OPEN: (0.6, 0.6, 0.6, 0.7),
    State.CURRENT: (0.94, 0.89, 0.26, 1.0),
    State.DONE: (0.0, 0.62, 0.45, 1.0),
    State.REJECTED: (0.84, 0.37, 0.0, 1.0),
}
"""Of the places; told apart by those who do not see red and green as well (Okabe and Ito)."""
_UP: Final = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class Errors:
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


def draw_still(
    layout: Layout, states: Sequence[State], errors: Errors | None, exaggeration: float
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


def draw_moving(layout: Layout, angle: float, step: Step | None) -> tuple[Shape, ...]:
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


def standing_frames() -> tuple[Transform, ...]:
    """Return the frames that do not move: plans take the machine's for the table's fixed one."""
    return (Transform(MACHINE, TABLE_BASE),)


def moving_frames(layout: Layout, angle: float, step: Step | None) -> tuple[Transform, ...]:
    """Return the frame that turns with the table (rad), and that of a tracer on it."""
    frames = [Transform(TABLE_BASE, TABLE, angle=angle)]
    places, number = layout.stations.places, 0 if step is None else step.station
    if layout.stations.carried and number < len(places):
        frames.append(Transform(TABLE, TRACER, places[number]))
    return tuple(frames)
