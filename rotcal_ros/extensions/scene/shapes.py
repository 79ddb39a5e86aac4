"""What a scene is drawn with. Lengths in metres; colours are red, green, blue, opacity in 0..1."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.planning.plan import Point

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
