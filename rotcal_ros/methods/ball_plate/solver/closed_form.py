"""The closed form of the second paper, as printed: means instead of least squares (Eq. 1 to 12).

Of N balls at N table positions, all N^2 centres once. On these it is the least squares of the
exact grid, so what is said of its values comes from there. In two groups of table positions it
holds for each of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.errors import PlanError
from rotcal_ros.geometry.rotations import rotation_about_z
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
    grid, radius = problem.grid, problem.radius
    if not problem.complete or len(problem.balls) != grid:
        raise PlanError(
            f"the closed form needs {grid} balls at {grid} table positions, all {grid * grid} "
            f"centres once; found {len(problem.centres)} centres of {len(problem.balls)} balls"
        )
    ball, position = np.indices((grid, grid))
    place = grid_angles(grid)[(position + ball) % grid]
    # the nominal circle has no part in the means: without it nothing is lost to rounding
    x, y, z = np.moveaxis(problem.deviations.reshape(grid, grid, 3), 2, 0)
    if not nominal_radius:
        radius += float(np.mean(x * np.cos(place) + y * np.sin(place)))  # Eq. 12
    shift = np.stack([x, y, z], axis=2).mean(axis=0)
    shift = shift - shift.mean(axis=0)  # Eq. 4, 5 and z of Eq. 3
    turn = np.stack(
        [
            2.0 / radius * np.mean(z * np.sin(place), axis=0),  # Eq. 9
            -2.0 / radius * np.mean(z * np.cos(place), axis=0),  # Eq. 10
            np.mean(y * np.cos(place) - x * np.sin(place), axis=0) / radius,  # Eq. 11
        ],
        axis=1,
    )
    return ClosedForm(
        _without_first_harmonic(shift),
        _without_first_harmonic(turn - turn.mean(axis=0)),
        radius,
        _std_of_means(grid, radius),
    )


def _without_first_harmonic(sequence: Floats) -> Floats:
    """Take the part off x, y (N, 3) that turns with the table: shift and tilt of the plate.

    Eq. 1, 2, 6, 7.
    """
    phase = np.exp(1j * grid_angles(len(sequence)))
    plane = sequence[:, 0] + 1j * sequence[:, 1]
    plane = plane - np.mean(plane * phase.conj()) * phase
    return np.stack([plane.real, plane.imag, sequence[:, 2]], axis=1)


def _std_of_means(grid: int, radius: float) -> Floats:
    """Return the ``unit_std`` of a closed form.

    A mean over N balls has the variance 1/N. Of the N harmonics of a sequence the constraints take
    two in the plane (mean and what turns with the table) and one along z.
    """
    plane, along = (1.0 - 2.0 / grid) / grid, (1.0 - 1.0 / grid) / grid
    tilt, turn = 2.0 * plane / radius**2, along / radius**2
    return np.sqrt([plane, plane, along, tilt, tilt, turn])


def curves_of_groups(problem: BallPlateProblem, groups: int) -> Floats:
    """Return the six deviations (6 N,), one after the other, by the closed form of each group."""
    found = np.zeros((6, problem.grid))
    for first in range(groups):
        mine = problem.position % groups == first
        start = int(problem.balls[0] % groups)
        # the group's position 0 with its ball step 0 lies on its +x axis
        turn = rotation_about_z(problem.angles[(first + start) % problem.grid])
        part = problem.take(mine)
        own = closed_form(
            BallPlateProblem(
                problem.grid // groups, problem.radius, part.position // groups,
                (part.ball_step - start) // groups, part.centres @ turn,
            ),
            nominal_radius=True,
        )  # fmt: skip
        each = np.hstack([own.translation @ turn.T, own.rotation @ turn.T])
        found[:, first::groups] = each.T
    return found.ravel()
