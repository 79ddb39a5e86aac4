"""The least squares of a complete measurement, harmonic by harmonic.

Result and covariances equal the dense form (Eq. 20, 21 of the paper); time and memory grow like
N R log N and N R instead of N^3 and N^2.
"""

from __future__ import annotations

from functools import lru_cache, partial

import numpy as np

from rotcal_ros.foundation.arrays import Complexes, Floats, Ints
from rotcal_ros.foundation.components import ROTATIONS
from rotcal_ros.geometry.rotations import rotation_about_z
from rotcal_ros.methods.ball_plate.solver import harmonics, model
from rotcal_ros.methods.ball_plate.solver.harmonics import AXIS, PLANE, Harmonics
from rotcal_ros.methods.ball_plate.solver.model import FIELDS, LinearFit, PlateParameters, Solution
from rotcal_ros.methods.ball_plate.solver.problem import BallPlateProblem, grid_angles


def solve_spectral(problem: BallPlateProblem) -> Solution:
    """Solve a complete measurement with equal weights; the same answer as Eq. 20 and 21.

    For ``problem.complete`` without ``std`` only; the general solution takes all others. Raises
    ObservabilityError when the balls do not separate all harmonics.
    """
    linear = factored(problem)
    return linear.solution(*linear.fit(problem.deviations))


def factored(problem: BallPlateProblem) -> LinearFit:
    """Factor a complete measurement with equal weights; raises what :func:`solve_spectral` does.

    Its centres play no part, only grid, balls and radius.
    """
    system = harmonics.factor(problem.grid, problem.balls)
    turn = np.exp(1j * problem.angles)

    def fit(observed: Floats) -> tuple[PlateParameters, Floats]:
        spectrum, mean = harmonics.to_harmonics(_in_table_frame(problem, observed, turn))
        table, cmm, rest = harmonics.fit(system, spectrum)
        pose = _axis_pose(problem, cmm)
        fields, residuals = _back(problem, turn, table, cmm, rest)
        return _estimate(problem, turn, fields, mean, pose), residuals

    def solution(estimate: PlateParameters, residuals: Floats) -> Solution:
        return Solution(
            estimate=estimate,
            unit_std=_unit_std(problem.grid, problem.radius, tuple(problem.balls.tolist())),
            unit_covariance=partial(_table_covariance, problem.radius, system),
            residuals=residuals,
            cofactor=partial(_residual_cofactor, problem.cmm_index, system),
            weighted_square_sum=float(residuals.ravel() @ residuals.ravel()),
            dof=model.degrees_of_freedom(problem),
            way="spectral",
        )

    return LinearFit(fit, solution)


def _in_table_frame(problem: BallPlateProblem, observed: Floats, turn: Complexes) -> Complexes:
    """Return x + i y of deviations (n, 3) in the table's turning frame, then z, (2 R, N)."""
    n_balls = len(problem.balls)
    x, y, z = observed.T.reshape(3, n_balls, problem.grid)
    sequences = np.zeros((2 * n_balls, problem.grid), dtype=np.complex128)
    sequences[:n_balls].real, sequences[:n_balls].imag = x, y
    sequences[:n_balls] *= turn.conj()
    sequences[n_balls:].real = z
    return sequences


def _axis_pose(problem: BallPlateProblem, cmm: Complexes) -> tuple[complex, complex]:
    """Take tilt (radians) and shift (m) of the axis out of the CMM's coefficients (3, Q).

    At q = 1 the CMM's coefficient is the pose of the axis (Eq. 15 leaves nothing for b).
    """
    shift = np.sqrt(2.0) * cmm[1, 0].conjugate() / problem.grid
    tilt = -2.0 * cmm[2, 0] / (problem.grid * problem.radius)
    cmm[1:, 0] = 0.0
    return complex(tilt), complex(shift)


def _back(
    problem: BallPlateProblem, turn: Complexes, table: Complexes, cmm: Complexes, rest: Complexes
) -> tuple[Floats, Floats]:
    """Bring harmonics back to the fixed frame.

    Returns translation, rotation times radius and CMM, (3, N, 3), and the residuals (n, 3).
    """
    n_balls, grid = len(problem.balls), problem.grid
    plus, minus, axial = np.empty((3, n_balls + 3, grid // 2), dtype=np.complex128)
    plus[3:], minus[3:], axial[3:] = rest.transpose(0, 2, 1)
    plus[:2], minus[:2] = table[:, :, 0], table[:, :, 1]
    axial[0], axial[1] = table[AXIS, :, 2], table[PLANE, :, 2]
    plus[2], minus[2], axial[2] = cmm
    sequences = harmonics.to_sequences(plus, minus, axial, grid)
    plane = sequences[: n_balls + 3] * turn
    vectors = np.empty((n_balls + 3, grid, 3))
    vectors[..., 0], vectors[..., 1] = plane.real, plane.imag
    vectors[..., 2] = sequences[n_balls + 3 :].real
    return vectors[:3], vectors[3:].reshape(-1, 3)


def _estimate(
    problem: BallPlateProblem,
    turn: Complexes,
    fields: Floats,
    mean: Complexes,
    pose: tuple[complex, complex],
) -> PlateParameters:
    """Join all parameters; ``mean`` (2, R), x + i y and z, is harmonic zero on the plate."""
    tilt, shift = pose
    out = turn[problem.balls]
    local = mean[0] * out.conj()  # radial and tangential
    common = local.imag.sum() / len(out), mean[1].real.sum() / len(out)  # u_z, v_z (Eq. 19)
    ball = (local - 1j * common[0]) * out
    return PlateParameters(
        plate=np.stack([ball.real, ball.imag, mean[1].real - common[1]], axis=1),
        cmm=fields[2],
        rotation=fields[1] / problem.radius,
        translation=fields[0],
        axis_rotation=np.array([tilt.imag, tilt.real, common[0] / problem.radius]),
        axis_shift=np.array([shift.real, shift.imag, common[1]]),
    )


@lru_cache(maxsize=harmonics.LAYOUTS)
def _unit_std(grid: int, radius: float, balls: tuple[int, ...]) -> PlateParameters:
    """Return the standard deviations of all parameters for unit noise, read-only."""
    steps = np.array(balls, dtype=np.int64)
    system, turn = harmonics.factor(grid, steps), np.exp(1j * grid_angles(grid))
    cmm, (shift, tilt) = harmonics.cmm_covariance(system)
    table = harmonics.zero_lag(system.inverse, grid)
    shift, tilt = shift / grid, 2.0 * tilt / grid / radius**2
    common = 1.0 / (grid * len(balls))
    pairs = np.empty((3, 2, 2), dtype=np.complex128)
    pairs[:2], pairs[2] = table[:, :2, :2], cmm[PLANE]
    along = np.array([table[AXIS, 2, 2], table[PLANE, 2, 2], cmm[AXIS, 0, 0]]).real
    fields = _turned_std(pairs, along, turn * turn)
    # A ball has the variances 1/N (radial) and 1/N - 1/(N R) (tangential, axial).
    out = turn[steps]
    less = np.full((len(out), 3), common)
    less[:, 0] *= out.imag**2
    less[:, 1] *= out.real**2
    stds = PlateParameters(
        plate=np.sqrt(1.0 / grid - less),
        cmm=fields[2],
        rotation=fields[1] / radius,
        translation=fields[0],
        axis_rotation=np.sqrt([tilt, tilt, common / radius**2]),
        axis_shift=np.sqrt([shift, shift, common]),
    )
    for name in FIELDS:
        getattr(stds, name).flags.writeable = False
    return stds


def _turned_std(pairs: Complexes, along: Floats, turn: Complexes) -> Floats:
    """Return the standard deviations (f, n, 3) of f vectors at n angles in the fixed frame.

    ``pairs`` (f, 2, 2) are the covariances of (w+, w-) in the turning frame at lag 0, ``along``
    (f,) the variances of z, ``turn`` (n,) the phases exp(2 i angle): the mean of the variances
    of x and y is the same everywhere, their difference turns at twice the angle.
    """
    mean = 0.5 * (pairs[:, 0, 0] + pairs[:, 1, 1]).real
    swing = (pairs[:, 0, 1, None] * turn).real
    variances = np.empty((len(pairs), len(turn), 3))
    variances[..., 0] = mean[:, None] + swing
    variances[..., 1] = mean[:, None] - swing
    variances[..., 2] = along[:, None]
    return np.sqrt(variances)


def _residual_cofactor(cmm_index: Ints, system: Harmonics) -> Floats:
    """Return the unit covariance (n, 3, 3) of all residuals.

    In the turning frame one per ball holds everywhere.
    """
    n_balls = len(system.balls)
    # the design at the CMM, its mean over the balls taken off
    rows = harmonics.design(system.phase) - system.mean[:, :, None]
    fitted = rows @ system.inverse[:, :, None] @ rows.conj().swapaxes(3, 4)
    kept = np.eye(2) * (1.0 - 1.0 / n_balls) - fitted
    lag = harmonics.zero_lag(kept, system.grid)
    turning = np.zeros((n_balls, 3, 3))
    turning[:, :2, :2] = harmonics.real_basis(lag[PLANE]).real
    turning[:, 2, 2] = lag[AXIS, :, 0, 0].real
    turn = rotation_about_z(grid_angles(system.grid)[cmm_index])
    every = np.repeat(turning, system.grid, axis=0)
    cofactor: Floats = turn @ every @ turn.swapaxes(1, 2)
    return cofactor


def _table_covariance(radius: float, system: Harmonics, first: str, second: str) -> Floats:
    """Return the (N, N) unit covariance of two components, from the circulant blocks on demand.

    The blocks are all that is held, so a grid of thousands of positions costs no memory until a
    matrix is asked for.
    """
    grid = system.grid
    block, first_weights = _weights(first, radius, grid)
    other_block, second_weights = _weights(second, radius, grid)
    total = np.zeros((grid, grid))
    if block != other_block:
        return total  # the plane and the axis are measured by different coordinates
    covariance = harmonics.to_time(harmonics.real_basis(system.inverse[block]), grid)
    lag = (np.arange(grid)[:, None] - np.arange(grid)) % grid
    for index, weight in first_weights:
        for other, other_weight in second_weights:
            total += weight[:, None] * covariance[lag, index, other] * other_weight
    return total


def _weights(name: str, radius: float, grid: int) -> tuple[int, list[tuple[int, Floats]]]:
    """Return the block and the turning-frame unknowns of which a component is made."""
    scale = 1.0 / radius if name in ROTATIONS else 1.0
    block = PLANE if name in ("EXC", "EYC", "ECC") else AXIS
    angles = grid_angles(grid)
    cos, sin = scale * np.cos(angles), scale * np.sin(angles)
    if name in ("EXC", "EAC"):
        return block, [(0, cos), (1, -sin)]
    if name in ("EYC", "EBC"):
        return block, [(0, sin), (1, cos)]
    return block, [(2, np.full_like(angles, scale))]
