"""The least squares of a complete measurement, harmonic by harmonic.

Result and covariances equal the dense form (Eq. 20, 21 of the paper); time and memory grow like
N R log N and N R instead of N^3 and N^2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rotcal_ros.errors import ObservabilityError
from rotcal_ros.methods.ball_plate import harmonics, model
from rotcal_ros.methods.ball_plate.harmonics import AXIS, PLANE, Harmonics
from rotcal_ros.methods.ball_plate.model import Parameters, Solution
from rotcal_ros.methods.ball_plate.problem import (
    BallPlateProblem,
    Complexes,
    Floats,
    Ints,
    grid_angles,
)


def solve_spectral(problem: BallPlateProblem) -> Solution:
    """Solve a complete measurement with equal weights; the same answer as Eq. 20 and 21.

    Raises ObservabilityError when centres are missing, doubled or unequally weighted (the
    general solution takes those) and when the balls do not separate all harmonics.
    """
    if not problem.complete or problem.std is not None:
        raise ObservabilityError(
            "the spectral solution needs every ball once at every table position, with equal "
            f"weights; found {len(problem.centres)} centres of {len(problem.balls)} balls on "
            f"a grid of {problem.grid}"
        )
    system = harmonics.factor(problem.grid, problem.balls)
    zeroth, spectrum, by_cmm = _measured_spectrum(problem)
    table, cmm, rest = harmonics.fit(system, spectrum)
    residuals = _residuals(problem, rest, by_cmm)
    return Solution(
        estimate=_estimate(problem, zeroth / problem.grid, table, cmm),
        unit_std=_unit_std(problem, system),
        unit_covariance=TableCovariance(problem.radius, system),
        residuals=residuals,
        cofactor=ResidualCofactor(problem.cmm_index, system),
        weighted_square_sum=float(residuals.ravel() @ residuals.ravel()),
        dof=model.degrees_of_freedom(problem),
        way="spectral",
    )


def _measured_spectrum(problem: BallPlateProblem) -> tuple[Floats, Complexes, Ints]:
    """Transform the data in the turning frame over the CMM positions.

    Returns harmonic zero (R, 3) in x, y, z, the others (2, Q, R, 2) as :mod:`harmonics` wants
    them, and ``by_cmm`` (R, N), the row of ball r at CMM position k.
    """
    grid, n_balls = problem.grid, len(problem.balls)
    shift = (np.arange(grid) - problem.balls[:, None]) % grid
    by_cmm = np.arange(n_balls)[:, None] * grid + shift
    x, y, z = problem.deviations.T
    plane = (x + 1j * y)[by_cmm].T * np.exp(-1j * problem.angles)[:, None]
    height = np.fft.rfft(z[by_cmm].T, axis=0)
    spectrum = np.zeros((2, grid // 2, n_balls, 2), dtype=np.complex128)
    spectrum[PLANE, ..., 0], spectrum[PLANE, ..., 1] = harmonics.from_plane(plane)
    spectrum[AXIS, ..., 0] = height[1:]
    zeroth = plane.sum(axis=0)
    return np.stack([zeroth.real, zeroth.imag, height[0].real], axis=1), spectrum, by_cmm


def _estimate(
    problem: BallPlateProblem, mean: Floats, table: Complexes, cmm: Complexes
) -> Parameters:
    """Bring the harmonics back to the fixed frame; ``mean`` (R, 3) is harmonic zero."""
    grid, radius = problem.grid, problem.radius
    # At q = 1 the CMM's coefficient is the pose of the axis (Eq. 15 leaves nothing for b).
    shift = np.sqrt(2.0) * cmm[PLANE, 0, 1].conj() / grid
    tilt = -2.0 * cmm[AXIS, 0, 0] / (grid * radius)
    cmm[PLANE, 0, 1] = cmm[AXIS, 0, 0] = 0.0
    turn = np.exp(1j * problem.angles)
    pairs = np.stack([table[PLANE, :, :2], table[AXIS, :, :2], cmm[PLANE]], axis=1)
    plane = harmonics.to_plane(pairs[..., 0], pairs[..., 1], grid) * turn[:, None]
    along = np.stack([table[AXIS, :, 2], table[PLANE, :, 2], cmm[AXIS, :, 0]], axis=1)
    fields = np.stack([plane.real, plane.imag, harmonics.to_time(along, grid)], axis=2)
    common = mean[:, 1:].sum(axis=0) / len(mean)  # tangential and axial: u_z and v_z (Eq. 19)
    ball = (mean[:, 0] + 1j * (mean[:, 1] - common[0])) * turn[problem.balls]
    return Parameters(
        plate=np.stack([ball.real, ball.imag, mean[:, 2] - common[1]], axis=1),
        cmm=fields[:, 2],
        rotation=fields[:, 1] / radius,
        translation=fields[:, 0],
        axis_rotation=np.array([tilt.imag, tilt.real, common[0] / radius]),
        axis_shift=np.array([shift.real, shift.imag, common[1]]),
    )


def _residuals(problem: BallPlateProblem, rest: Complexes, by_cmm: Ints) -> Floats:
    """Residuals (n, 3) in the fixed frame, canonical order, from those of the harmonics."""
    plane = harmonics.to_plane(rest[PLANE, ..., 0], rest[PLANE, ..., 1], problem.grid)
    plane *= np.exp(1j * problem.angles)[:, None]
    height = harmonics.to_time(rest[AXIS, ..., 0], problem.grid)
    residuals = np.empty((by_cmm.size, 3))
    residuals[by_cmm.T] = np.stack([plane.real, plane.imag, height], axis=2)
    return residuals


def _unit_std(problem: BallPlateProblem, system: Harmonics) -> Parameters:
    """Return the standard deviations of all parameters for unit noise."""
    grid, radius, n_balls = problem.grid, problem.radius, len(problem.balls)
    cmm_spectrum = harmonics.cmm_covariance(system)
    shift = cmm_spectrum[PLANE, 0, 1, 1].real / grid
    tilt = 2.0 * cmm_spectrum[AXIS, 0, 0, 0].real / grid / radius**2
    cmm_spectrum[PLANE, 0, 1, :] = cmm_spectrum[PLANE, 0, :, 1] = 0.0
    cmm_spectrum[AXIS, 0] = 0.0
    cmm = harmonics.zero_lag(cmm_spectrum, grid, axis=1)
    table = harmonics.zero_lag(system.inverse, grid, axis=1)
    common = 1.0 / (grid * n_balls)
    pairs = np.array([table[PLANE, :2, :2], table[AXIS, :2, :2], cmm[PLANE]])
    along = np.array([table[AXIS, 2, 2], table[PLANE, 2, 2], cmm[AXIS, 0, 0]]).real
    turn = np.exp(2j * problem.angles)
    fields = _turned_std(pairs, along, turn)
    # In its own frame a ball has the variances 1/N (radial) and 1/N - 1/(N R) (others).
    ball = np.array([[[1.0 / grid - 0.5 * common, 0.5 * common]] * 2])
    ball[:, 1] = ball[:, 1, ::-1]
    return Parameters(
        plate=_turned_std(ball, np.array([1.0 / grid - common]), turn[problem.balls])[0],
        cmm=fields[2],
        rotation=fields[1] / radius,
        translation=fields[0],
        axis_rotation=np.sqrt([tilt, tilt, common / radius**2]),
        axis_shift=np.sqrt([shift, shift, common]),
    )


def _turned_std(pairs: Complexes | Floats, along: Floats, turn: Complexes) -> Floats:
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
    deviations: Floats = np.sqrt(variances)
    return deviations


@dataclass(frozen=True)
class ResidualCofactor:
    """Unit covariance of the residuals; in the turning frame one per ball holds everywhere."""

    cmm_index: Ints
    system: Harmonics

    def __call__(self) -> Floats:
        """Return the unit covariance (n, 3, 3) of all residuals."""
        system, n_balls = self.system, len(self.system.balls)
        rows = system.centred.reshape(*system.centred.shape[:2], n_balls, 2, 3)
        fitted = rows @ system.inverse[:, :, None] @ rows.conj().swapaxes(3, 4)
        kept = np.eye(2) * (1.0 - 1.0 / n_balls) - fitted
        lag = harmonics.zero_lag(kept, system.grid, axis=1)
        turning = np.zeros((n_balls, 3, 3))
        turning[:, :2, :2] = harmonics.real_basis(lag[PLANE]).real
        turning[:, 2, 2] = lag[AXIS, :, 0, 0].real
        turn = model.rotations(grid_angles(system.grid)[self.cmm_index])
        every = np.repeat(turning, system.grid, axis=0)
        cofactor: Floats = turn @ every @ turn.swapaxes(1, 2)
        return cofactor


@dataclass(frozen=True)
class TableCovariance:
    """Unit covariance of two of the table's components, from the circulant blocks on demand.

    Calling it with two ISO 230-1 names returns (N, N). The blocks are all it holds, so a grid
    of thousands of positions costs no memory until a matrix is asked for.
    """

    radius: float
    system: Harmonics

    def __call__(self, first: str, second: str) -> Floats:
        """Return the (N, N) unit covariance of components ``first`` and ``second``."""
        grid = self.system.grid
        block, first_weights = self._weights(first)
        other_block, second_weights = self._weights(second)
        total = np.zeros((grid, grid))
        if block != other_block:
            return total  # the plane and the axis are measured by different coordinates
        covariance = harmonics.to_time(harmonics.real_basis(self.system.inverse[block]), grid)
        lag = (np.arange(grid)[:, None] - np.arange(grid)) % grid
        for index, weight in first_weights:
            for other, other_weight in second_weights:
                total += weight[:, None] * covariance[lag, index, other] * other_weight
        return total

    def _weights(self, name: str) -> tuple[int, list[tuple[int, Floats]]]:
        """Return the block and the turning-frame unknowns of which a component is made."""
        scale = 1.0 / self.radius if name in ("EAC", "EBC", "ECC") else 1.0
        block = PLANE if name in ("EXC", "EYC", "ECC") else AXIS
        angles = grid_angles(self.system.grid)
        cos, sin = scale * np.cos(angles), scale * np.sin(angles)
        if name in ("EXC", "EAC"):
            return block, [(0, cos), (1, -sin)]
        if name in ("EYC", "EBC"):
            return block, [(0, sin), (1, cos)]
        return block, [(2, np.full_like(angles, scale))]
