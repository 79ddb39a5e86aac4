"""The constrained least squares as printed (Eq. 10 to 21), one dense matrix.

Opponent of the benchmark and referee of the tests: it shares no algebra with the solver. Slow and
large (N = 72, R = 12: 709 unknowns and multipliers), but nothing in it is clever.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.errors import ObservabilityError
from rotcal_ros.methods.ball_plate.solver.problem import BallPlateProblem

FIELDS = ("plate", "cmm", "rotation", "translation", "axis_rotation", "axis_shift")
COLUMNS = {
    "EXC": ("translation", 0), "EYC": ("translation", 1), "EZC": ("translation", 2),
    "EAC": ("rotation", 0), "EBC": ("rotation", 1), "ECC": ("rotation", 2),
}  # fmt: skip


@dataclass(frozen=True)
class DenseSolution:
    """Unknowns and standard deviations for unit noise by field (., 3), m and rad.

    ``inverse`` (P, P): their unit covariance, rotations times the radius; ``residuals`` (n, 3), m.
    """

    estimate: dict[str, Floats]
    unit_std: dict[str, Floats]
    inverse: Floats
    residuals: Floats
    dof: int

    def component(self, name: str) -> Floats:
        """Return a deviation (M,)."""
        field, axis = COLUMNS[name]
        return self.estimate[field][:, axis]

    def std(self, name: str) -> Floats:
        """Return its standard deviation (M,) for unit noise."""
        field, axis = COLUMNS[name]
        return self.unit_std[field][:, axis]


def turned(angle: Floats) -> Floats:
    """Return rotations about z, (n, 3, 3)."""
    cos, sin, no = np.cos(angle), np.sin(angle), np.zeros_like(angle)
    rows = [[cos, -sin, no], [sin, cos, no], [no, no, no + 1.0]]
    return np.moveaxis(np.array(rows), 2, 0)


def crossed(angle: Floats) -> Floats:
    """Return C with C w = w x (cos, sin, 0), (n, 3, 3)."""
    place = np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle])
    return np.stack([np.cross(unit, place) for unit in np.eye(3)], axis=2)


def places(problem: BallPlateProblem) -> dict[str, slice]:
    """Return where each field stands in the vector of unknowns."""
    turns = len(problem.table_positions)
    counts = (len(problem.balls), len(problem.cmm_positions), turns, turns, 1, 1)
    ends = np.cumsum(counts) * 3
    return {f: slice(e - 3 * n, e) for f, n, e in zip(FIELDS, counts, ends, strict=True)}


def design_of(problem: BallPlateProblem) -> Floats:
    """Return T (3 n, P) of Eq. 14."""
    own, angle = places(problem), problem.angles
    matrix = np.zeros((len(problem.centres), 3, own["axis_shift"].stop))
    ball = np.searchsorted(problem.balls, problem.ball_step)
    cmm = np.searchsorted(problem.cmm_positions, problem.cmm_index)
    cross = crossed(angle[problem.cmm_index])
    turn = turned(angle[problem.position])
    for r, i in enumerate(np.searchsorted(problem.table_positions, problem.position)):
        for field, number, block in (
            ("plate", ball[r], turn[r]), ("cmm", cmm[r], np.eye(3)), ("rotation", i, cross[r]),
            ("translation", i, np.eye(3)), ("axis_rotation", 0, cross[r]),
            ("axis_shift", 0, np.eye(3)),
        ):  # fmt: skip
            first = own[field].start + 3 * number
            matrix[r, :, first : first + 3] = block
    return matrix.reshape(3 * len(problem.centres), -1)


def constraints_of(problem: BallPlateProblem) -> Floats:
    """Return G (19, P) of Eq. 15 to 19."""
    own, angle = places(problem), problem.angles
    across, table = angle[problem.cmm_positions], angle[problem.table_positions]
    ball, back = turned(angle[problem.balls]), turned(-table)
    rows = np.zeros((19, own["axis_shift"].stop))
    radial = np.column_stack([np.cos(across), np.sin(across), 0.0 * across])
    rows[0:3, own["cmm"]] = np.tile(np.eye(3), len(across))  # Eq. 15, left
    rows[3:6, own["cmm"]] = np.hstack(list(crossed(across)))  # Eq. 15, right
    rows[6, own["cmm"]] = radial.ravel()  # Eq. 16
    rows[7:10, own["rotation"]] = np.tile(np.eye(3), len(table))  # Eq. 17
    rows[10:13, own["translation"]] = rows[7:10, own["rotation"]]
    rows[13:15, own["rotation"]] = np.hstack(list(back[:, :2]))  # Eq. 18
    rows[15:17, own["translation"]] = rows[13:15, own["rotation"]]
    rows[17, own["plate"]] = ball[:, :, 1].ravel()  # Eq. 19, tangential
    rows[18, own["plate"]][2::3] = 1.0  # Eq. 19, axial
    return rows


def solve_dense(problem: BallPlateProblem) -> DenseSolution:
    """Solve Eq. 20 and invert its matrix for Eq. 21.

    Raises ObservabilityError when the matrix is singular.
    """
    design, constraints = design_of(problem), constraints_of(problem)
    weight = np.ones(len(design)) if problem.std is None else 1.0 / problem.std.ravel()
    white, observed = design * weight[:, None], problem.deviations.ravel() * weight
    size = design.shape[1]
    normal = white.T @ white
    scale = np.trace(normal) / size  # brings the constraints to the size of T'T
    border = np.zeros((size + len(constraints),) * 2)
    border[:size, :size] = normal / scale
    border[size:, :size], border[:size, size:] = constraints, constraints.T
    try:
        inverse = np.linalg.inv(border)[:size, :size] / scale
    except np.linalg.LinAlgError:
        raise ObservabilityError("the matrix of Eq. 20 is singular") from None
    vector = inverse @ (white.T @ observed)
    std = np.sqrt(np.maximum(np.diag(inverse), 0.0))

    def fields(values: Floats) -> dict[str, Floats]:
        radius = {"rotation": problem.radius, "axis_rotation": problem.radius}
        own = places(problem).items()
        return {f: values[at].reshape(-1, 3) / radius.get(f, 1.0) for f, at in own}

    residuals = problem.deviations - (design @ vector).reshape(-1, 3)
    return DenseSolution(
        fields(vector), fields(std), inverse, residuals, len(design) - size + len(constraints)
    )
