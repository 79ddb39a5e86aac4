"""The closed form for a complete grid: N balls at N table positions (second paper, Eq. 1-12).

Means over the balls and removal of the first harmonic, nothing to invert. With the nominal
radius it is the least squares solution of the complete three-rosette method.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.errors import PlanError
from rotcal_ros.methods.ball_plate.solver.problem import BallPlateProblem, grid_angles


@dataclass(frozen=True)
class ClosedForm:
    """Deviations of the table: ``translation`` (N, 3) in metres, ``rotation`` (N, 3) in radians.

    ``radius`` is the radius of the ball circle that the rotations were divided by, in metres;
    ``unit_std`` (6,) are the standard deviations of EXC, EYC, EZC, EAC, EBC, ECC for unit
    standard deviation of a centre, the same at every position.
    """

    translation: Floats
    rotation: Floats
    radius: float
    unit_std: Floats


def closed_form(problem: BallPlateProblem, *, nominal_radius: bool = False) -> ClosedForm:
    """Return the table's deviations from all N x N centres (Eq. 1-12).

    The paper divides the rotations by the mean measured radius (Eq. 12); ``nominal_radius``
    divides by the plate's, as the least squares does. Raises PlanError when the grid is not
    complete.
    """
    grid = problem.grid
    if not problem.complete or len(problem.balls) != grid:
        raise PlanError(
            f"the closed form needs {grid} balls at {grid} table positions, all {grid * grid} "
            f"centres once; found {len(problem.centres)} centres of {len(problem.balls)} balls"
        )
    # The nominal circle has no part in the means: without it nothing is lost to rounding.
    offsets = problem.deviations.reshape(grid, grid, 3)  # ball, table position, coordinate
    angles = grid_angles(grid)
    place = angles[:, None] + angles  # where ball j stands at table position i
    x, y, z = np.moveaxis(offsets, 2, 0)
    radius = problem.radius
    if not nominal_radius:
        radius += float(np.mean(x * np.cos(place) + y * np.sin(place)))  # Eq. 12
    shift = offsets.mean(axis=0) - offsets.mean(axis=(0, 1))  # Eq. 4, 5 and z of Eq. 3
    turn = np.stack(
        [
            2.0 / radius * np.mean(z * np.sin(place), axis=0),  # Eq. 9
            -2.0 / radius * np.mean(z * np.cos(place), axis=0),  # Eq. 10
            np.mean(y * np.cos(place) - x * np.sin(place), axis=0) / radius,  # Eq. 11
        ],
        axis=1,
    )
    return ClosedForm(
        translation=_without_first_harmonic(shift, angles),
        rotation=_without_first_harmonic(turn - turn.mean(axis=0), angles),
        radius=radius,
        unit_std=_unit_std(grid, radius),
    )


def _without_first_harmonic(sequence: Floats, angles: Floats) -> Floats:
    """Take the part off x, y that turns with the table: shift and tilt of the plate.

    Eq. 1, 2, 6, 7.
    """
    phase = np.exp(1j * angles)
    plane = sequence[:, 0] + 1j * sequence[:, 1]
    plane = plane - np.mean(plane * phase.conj()) * phase
    return np.stack([plane.real, plane.imag, sequence[:, 2]], axis=1)


def _unit_std(grid: int, radius: float) -> Floats:
    """Propagate unit noise: a mean over N balls less the constraints (two harmonics of N)."""
    plane, along = (1.0 - 2.0 / grid) / grid, (1.0 - 1.0 / grid) / grid
    tilt, turn = 2.0 * plane / radius**2, along / radius**2
    return np.sqrt([plane, plane, along, tilt, tilt, turn])
