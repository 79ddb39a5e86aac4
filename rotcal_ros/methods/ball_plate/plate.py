"""The ball plate: grid, ball steps, circle, balls, material."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, dataclass
from typing import Any

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.settings import load, setting


def grid_setting(default: Any = MISSING, *, doc: str, first: bool = False) -> Any:
    """Declare the number of grid steps of a plate, planned or simulated."""
    return setting(default, doc=doc, minimum=3, maximum=36_000, first=first)


def points_setting() -> Any:
    """Declare how many touch points a ball gets: a sphere has four unknowns, and needs a check."""
    return setting(15, doc="touch points on the upper half of a ball", minimum=5, maximum=1000)


@dataclass(frozen=True)
class Plate:
    """A circular ball plate, as a group of settings or as the entries of a plate file.

    Ball ``ball_steps[r]`` stands at the angle 2 pi step / ``grid``, counter-clockwise seen from
    above. ``separate_groups`` allows ball steps that share a factor with the grid (groups of
    positions without a connection). :func:`checked` refuses a plate that cannot be.
    """

    grid: int = grid_setting(
        doc="number of table positions in a turn: the grid that ball_steps counts in", first=True
    )
    ball_steps: tuple[int, ...] = setting(
        doc="grid steps on which balls stand, from 0", minimum=0, first=True
    )
    circle_radius_m: float = setting(
        doc="m, radius of the circle of ball centres", minimum=1e-3, first=True
    )
    ball_diameter_m: float = setting(doc="m, diameter of the balls", minimum=1e-4, first=True)
    name: str = setting("ball plate", doc="name of the plate")
    material: str = setting("", doc="material of the plate")
    separate_groups: bool = setting(
        False, doc="accept a plate whose table positions fall into groups that no ball connects"
    )

    @property
    def places(self) -> Floats:
        """Nominal places (grid, 3) of all steps at table position 0, metres."""
        from rotcal_ros.methods.ball_plate.solver.problem import grid_angles, on_circle

        return self.circle_radius_m * on_circle(grid_angles(self.grid))


def parse_plate(entries: Mapping[str, Any], where: str) -> Plate:
    """Return the plate with the given entries; ``where`` names them in error messages.

    Raises ConfigurationError for entries that are missing, unknown, of the wrong kind, or that
    do not go together.
    """
    return checked(load(Plate, entries, where), where)


def checked(plate: Plate, where: str) -> Plate:
    """Return ``plate``; ConfigurationError for steps off the grid and balls without room."""
    _check_steps(plate, where)
    _check_room(plate, where)
    return plate


def _check_steps(plate: Plate, where: str) -> None:
    steps = plate.ball_steps
    outside = sorted(step for step in steps if step >= plate.grid)
    if outside:
        raise ConfigurationError(
            f"{where}: ball_steps must lie in 0..{plate.grid - 1}, found {outside}"
        )
    twice = sorted({step for step in steps if steps.count(step) > 1})
    if twice or len(steps) < 3:
        raise ConfigurationError(
            f"{where}: at least 3 different ball_steps are needed; {len(steps)} found, "
            f"named twice: {twice}"
        )


def _check_room(plate: Plate, where: str) -> None:
    """Refuse lengths in millimetres and balls that overlap."""
    if plate.circle_radius_m > 10.0:
        raise ConfigurationError(
            f"{where}: a ball circle with a radius of {plate.circle_radius_m:g} m looks like "
            "millimetres; metres are expected"
        )
    steps = np.sort(plate.ball_steps)
    smallest = int(np.diff(steps, append=steps[0] + plate.grid).min())
    chord = 2.0 * plate.circle_radius_m * np.sin(np.pi * smallest / plate.grid)
    if chord < plate.ball_diameter_m:
        raise ConfigurationError(
            f"{where}: balls {smallest} grid steps apart are {chord:.4f} m apart, less "
            f"than their diameter of {plate.ball_diameter_m:.4f} m; check circle and diameter"
        )
