"""The way of a tip around a ball: from above, beside it, against it, and up again.

No part of the way leads through the ball, whichever points of its upper half are touched in
whichever order; between the balls the tip travels at the height of clearance.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import cos, pi, sin, sqrt
from typing import Final

from rotcal_ros.planning.plan import Point

_GOLDEN: Final = pi * (3.0 - sqrt(5.0))


@dataclass(frozen=True, slots=True)
class Go:
    """Move the tip in a straight line; what is None stays as it is. Metres."""

    x: float | None
    y: float | None
    z: float | None


@dataclass(frozen=True, slots=True)
class Touch:
    """Touch the surface at ``nominal`` (m) against ``direction``, which leads away from it."""

    nominal: Point
    direction: Point


def upper_half(count: int) -> Iterator[Point]:
    """Yield ``count`` directions that cover the upper half of a ball evenly, unit vectors."""
    for number in range(count):
        height = (number + 0.5) / count
        flat = sqrt(1.0 - height * height)
        yield flat * cos(number * _GOLDEN), flat * sin(number * _GOLDEN), height


def around_ball(
    centre: Point, diameter: float, count: int, tip_radius: float, approach: float, height: float
) -> Iterator[Go | Touch]:
    """Yield the moves that touch a ball ``count`` times, from ``height`` (z, m) back to it.

    ``approach`` (m) is the distance from the surface at which a probing motion begins.
    """
    radius = 0.5 * diameter
    beside = radius + tip_radius + approach
    for direction in upper_half(count):
        nominal = _along(centre, direction, radius)
        start = _along(centre, direction, beside)
        yield Go(start[0], start[1], height)
        yield Go(None, None, start[2])
        yield Touch(nominal, direction)
        yield Go(None, None, height)


def _along(centre: Point, direction: Point, distance: float) -> Point:
    x, y, z = (c + distance * d for c, d in zip(centre, direction, strict=True))
    return x, y, z
