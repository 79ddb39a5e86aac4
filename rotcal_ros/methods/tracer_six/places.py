"""Where the tracer is fixed on the table: places that tell all six deviations, or do not."""

from __future__ import annotations

from typing import Final

import numpy as np

from rotcal_ros.foundation.errors import PlanError
from rotcal_ros.foundation.units import DEGREE, MILLIMETRE
from rotcal_ros.methods.tracer_six.solver.layout import lost_direction
from rotcal_ros.planning.plan import Point

LEAST_PLACES: Final = 3
_UPRIGHT: Final = 0.7
"""From this vertical part on, what is lost about a line is mostly ECC."""


def around(
    count: int, radius: float, azimuth: float, height: float, height_step: float
) -> tuple[Point, ...]:
    """Return ``count`` places evenly around the axis, the first at ``azimuth`` (rad), in metres.

    Each is ``height_step`` higher than the one before, the first at ``height``. Table frame at
    angle 0.
    """
    angles = azimuth + 2.0 * np.pi * np.arange(count) / count
    heights = height + height_step * np.arange(count)
    rows = np.column_stack([radius * np.cos(angles), radius * np.sin(angles), heights])
    return tuple((x, y, z) for x, y, z in rows.tolist())


def require_six(places: tuple[Point, ...], *, tilt_known: bool = False) -> None:
    """Raise PlanError, with the direction that is lost, unless the places tell six deviations.

    ``tilt_known``: a lost tilt is tolerated, because it is stated beforehand.
    """
    points = np.array(places)
    if len(set(places)) < 2:
        raise PlanError(
            f"plan: the tracer stands at {len(places)} place(s) of the table: six deviations need "
            f"{LEAST_PLACES} that do not lie in a line; raise plan.places"
        )
    lost = lost_direction(points)
    if lost is None:
        return
    x, y, z = (lost.round(3) + 0.0).tolist()  # without negative zeros
    upright = abs(z) > _UPRIGHT
    if tilt_known and not upright:
        return
    what = "ECC" if upright else "the tilt about it"
    lie = f"the {len(places)} places" + (" lie in a line:" if len(places) > 2 else ":")
    stated = "" if upright else ", or state solver.tilt_std_rad"
    raise PlanError(
        f"plan: {lie} a turn of the table about the line through them ({x:.3f}, {y:.3f}, {z:.3f}) "
        f"moves none of them, so that no length tells {what}; take {LEAST_PLACES} places that do "
        f"not lie in a line, at best 120 degrees apart{stated}"
    )


def described(place: Point) -> str:
    """Return a place in words a person can work with."""
    x, y, z = place
    azimuth = np.arctan2(y, x) / DEGREE % 360.0
    return (
        f"{np.hypot(x, y) / MILLIMETRE:.0f} mm from the table axis towards {azimuth:.0f} deg of "
        f"the table, its centre {z / MILLIMETRE:.0f} mm above it"
    )
