"""Points of a plan: listed in settings, or on a grid in an order that keeps paths short."""

from __future__ import annotations

from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.errors import PlanError
from rotcal_ros.planning.plan import Point

_ROUNDING: Final = 1e-9


def parse_points(values: tuple[float, ...], name: str) -> tuple[Point, ...]:
    """Return a flat list of coordinates as points; PlanError if it does not consist of triples."""
    if len(values) % 3:
        raise PlanError(f"plan: {name} has {len(values)} values, expected x y z of each point")
    rows = np.reshape(values, (-1, 3)).tolist()
    return tuple((x, y, z) for x, y, z in rows)


def serpentine_grid(
    centre: Point, size: tuple[float, float, float], points: tuple[int, int, int]
) -> tuple[Point, ...]:
    """Return the places (m), layer by layer in a serpentine: neighbours are close together.

    ``centre`` and ``size`` in m; ``points`` is their number along x, y and z.
    """
    x_axis, y_axis, z_axis = (
        np.linspace(c - s / 2, c + s / 2, n) if n > 1 else np.array([c])
        for c, s, n in zip(centre, size, points, strict=True)
    )
    rows = [(y, z) for k, z in enumerate(z_axis) for y in y_axis[:: _zigzag(k)]]
    return tuple(
        (float(x), float(y), float(z))
        for k, (y, z) in enumerate(rows)
        for x in x_axis[:: _zigzag(k)]
    )


def _zigzag(row: int) -> int:
    """Return the direction of travel (1 or -1) of a row of a serpentine."""
    return -1 if row % 2 else 1


def are_collinear(points: Floats) -> bool:
    """Return whether ``points`` (n, 3) lie on a line, or at one place, within rounding."""
    return _directions(points) < 2


def are_coplanar(points: Floats) -> bool:
    """Return whether ``points`` (n, 3) lie in a plane, or on a line, within rounding."""
    return _directions(points) < 3


def _directions(points: Floats) -> int:
    """Return how many dimensions ``points`` (n, 3) have: 1 for a line, 2 for a plane."""
    sizes = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return int(np.sum(sizes > _ROUNDING * sizes[0]))
