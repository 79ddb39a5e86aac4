"""The exact model of a plate on a table, solved with the linear one.

    m = v + R_u [ E(c_i) B_i E_z(u_z) (p_j + a_j) + d_i + b_k ],      i = k - j (mod N)

E(c) is the rotation about c by |c|, R_u the shortest rotation that takes z to the axis. What this
has beyond Eq. 12 are products of small quantities: the tilt of the axis with the plate's place,
the table's rotations with the plate's place. The linear fit takes the misclosure of the exact
model again and again, its design frozen at the nominal places, until nothing is left to take.
Deviations, plate and CMM errors live in the frame of the fitted axis, and obey Eq. 15 to 19 there.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.geometry.rotations import rotation_about_z, rotation_from_vector
from rotcal_ros.methods.ball_plate.solver import model
from rotcal_ros.methods.ball_plate.solver.model import FIELDS, LinearFit, PlateParameters, Solution
from rotcal_ros.methods.ball_plate.solver.problem import BallPlateProblem, on_circle

SETTLED = 3e-4
"""Largest change of any combination of parameters, in its standard deviations, left undone."""
MOST_ROUNDS = 60


def settle(problem: BallPlateProblem, linear: LinearFit) -> Solution:
    """Return the least squares solution of the exact model.

    The length of what one round neglects, in standard deviations of a centre, is a bound on the
    change of every linear combination of the parameters in the next one, in the standard
    deviations of that combination: below SETTLED the iteration ends. Well aligned data pass
    this test on the linear solution. Raises DataError when the iteration does not settle.
    """
    found, residuals = linear.fit(problem.deviations)
    if _neglected(problem, found) < _limit(problem, residuals):
        return linear.solution(found, residuals)
    pose = _Pose().moved(found)
    for _ in range(MOST_ROUNDS):
        misclosure = _misclosure(problem, found, pose)
        if _length(problem, misclosure - residuals) < _limit(problem, misclosure):
            residuals = misclosure @ pose.frame.T
            return linear.solution(pose.in_machine_axes(found), residuals)
        step, residuals = linear.fit(misclosure)
        found = PlateParameters(**{f: getattr(found, f) + getattr(step, f) for f in FIELDS})
        pose = pose.moved(step)
    raise DataError(
        f"the fit does not settle in {MOST_ROUNDS} rounds, plate and axis are too far off for "
        "these balls: centre the plate better, align the CMM's frame with the axis"
    )


def computed(
    problem: BallPlateProblem, found: PlateParameters, plate: Floats, cmm: Floats
) -> Floats:
    """Return the centres (n, 3) that the exact model predicts for the rows of ``problem``.

    ``plate`` and ``cmm`` (n, 3) are the errors of ball and CMM position of each row; the table
    positions in use must be those that ``found`` belongs to.
    """
    pose = _Pose.of(found)
    yaw = rotation_about_z(found.axis_rotation[2])
    places = problem.radius * on_circle(problem.angles[problem.ball_step]) + plate
    table = rotation_from_vector(found.rotation)
    table = table @ rotation_about_z(problem.angles[problem.table_positions]) @ yaw
    there = np.einsum("nij,nj->ni", table[problem.table_index], places)
    there += found.translation[problem.table_index] + cmm
    centres: Floats = there @ (pose.frame @ yaw.T).T + pose.origin
    return centres


@dataclass(frozen=True)
class _Pose:
    """Frame of axis and plate: ``frame`` (3, 3) holds its axes as columns, ``origin`` (3,)."""

    frame: Floats = field(default_factory=lambda: np.eye(3))
    origin: Floats = field(default_factory=lambda: np.zeros(3))

    @classmethod
    def of(cls, found: PlateParameters) -> _Pose:
        """Return the pose that the parameters of a solution state."""
        tilt = rotation_from_vector(found.axis_rotation * [1.0, 1.0, 0.0])
        return cls(tilt @ rotation_about_z(found.axis_rotation[2]), found.axis_shift)

    def moved(self, step: PlateParameters) -> _Pose:
        """Return the pose after the small motion of a step, given in this frame."""
        turned = self.frame @ rotation_from_vector(step.axis_rotation)
        return _Pose(turned, self.origin + self.frame @ step.axis_shift)

    def in_machine_axes(self, found: PlateParameters) -> PlateParameters:
        """Return parameters with the pose, their vectors along x and y of the machine.

        The frame is tilt times a turn about the axis; the latter is the plate's, not the axis's.
        """
        axis = self.frame[:, 2]
        sine = float(np.hypot(axis[0], axis[1]))
        size = np.arctan2(sine, axis[2]) / sine if sine > 0.0 else 1.0
        tilt = size * np.array([-axis[1], axis[0], 0.0])
        turn = rotation_from_vector(tilt).T @ self.frame
        yaw = np.array([0.0, 0.0, np.arctan2(turn[1, 0], turn[0, 0])])
        vectors = {f: getattr(found, f) @ turn.T for f in ("cmm", "rotation", "translation")}
        return PlateParameters(
            plate=found.plate, axis_rotation=tilt + yaw, axis_shift=self.origin, **vectors
        )


def _misclosure(problem: BallPlateProblem, found: PlateParameters, pose: _Pose) -> Floats:
    """Return observed - computed (n, 3) in the frame of axis and plate."""
    ball = np.searchsorted(problem.balls, problem.ball_step)
    cmm = np.searchsorted(problem.cmm_positions, problem.cmm_index)
    places = problem.radius * on_circle(problem.angles[problem.balls]) + found.plate
    table = rotation_from_vector(found.rotation)
    table = table @ rotation_about_z(problem.angles[problem.table_positions])
    there = np.einsum("nij,nj->ni", table[problem.table_index], places[ball])
    there += found.translation[problem.table_index] + found.cmm[cmm]
    misclosure: Floats = (problem.centres - pose.origin) @ pose.frame - there
    return misclosure


def _neglected(problem: BallPlateProblem, found: PlateParameters) -> float:
    """Return a bound on the length of all products that the linear model neglects.

    In units of the smallest standard deviation where the rows have their own.
    """
    n_balls, n = len(problem.balls), len(problem.centres)
    rotation, plate = np.linalg.norm(found.rotation), np.linalg.norm(found.plate)
    largest = float(np.max(np.abs(found.rotation)))
    pose = float(np.linalg.norm(found.axis_rotation))
    around = problem.radius * np.sqrt(n_balls) * rotation
    moved = around + np.sqrt(problem.grid) * plate
    moved += np.sqrt(n_balls) * (np.linalg.norm(found.translation) + np.linalg.norm(found.cmm))
    bound = rotation * plate + largest * around
    bound += pose * moved + 0.5 * pose**2 * problem.radius * np.sqrt(n)
    return float(bound) / _smallest(problem)


def _limit(problem: BallPlateProblem, residuals: Floats) -> float:
    """Return the length (n, 3) differences may have: in metres, or in units of ``std``."""
    total = model.weighted_square_sum(problem, residuals)
    sigma = np.sqrt(total / max(model.degrees_of_freedom(problem), 1))
    rounding = np.sqrt(model.rounding_variance(problem) * residuals.size)
    return float(max(SETTLED * sigma, rounding))


def _length(problem: BallPlateProblem, differences: Floats) -> float:
    return float(np.sqrt(model.weighted_square_sum(problem, differences)))


def _smallest(problem: BallPlateProblem) -> float:
    return 1.0 if problem.std is None else float(problem.std.min())
