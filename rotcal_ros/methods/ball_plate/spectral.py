"""The least squares of a complete measurement, harmonic by harmonic.

Result and covariances equal the dense form (Eq. 20, 21 of the paper); time and memory grow like
N R log N and N R instead of N^3 and N^2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rotcal_ros.errors import ObservabilityError
from rotcal_ros.methods.ball_plate import harmonics, model
from rotcal_ros.methods.ball_plate.harmonics import AXIS, PLANE, TO_PLANE, Harmonics
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
    zeroth, spectrum, shift = _measured_spectrum(problem)
    table, cmm, rest = harmonics.fit(system, spectrum)
    residuals = _residuals(problem, rest, shift)
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
    them, and ``shift`` (R, N), the table position of ball r at CMM position k.
    """
    grid, n_balls = problem.grid, len(problem.balls)
    shift = (np.arange(grid) - problem.balls[:, None]) % grid
    by_cmm = problem.deviations.reshape(n_balls, grid, 3)[np.arange(n_balls)[:, None], shift]
    by_cmm[..., :2] = _turn(by_cmm, -problem.angles)
    transform = np.fft.rfft(by_cmm, axis=1).swapaxes(0, 1)
    spectrum = np.zeros((2, len(transform) - 1, n_balls, 2), dtype=np.complex128)
    spectrum[PLANE] = transform[1:, :, :2] @ TO_PLANE.conj()
    spectrum[AXIS, ..., 0] = transform[1:, :, 2]
    return transform[0].real, spectrum, shift


def _turn(vectors: Floats, angles: Floats) -> Floats:
    """Rotate the plane parts of vectors (..., n, 2 or 3) by their angles (n,)."""
    turned = (vectors[..., 0] + 1j * vectors[..., 1]) * np.exp(1j * angles)
    return np.stack([turned.real, turned.imag], axis=-1)


def _estimate(
    problem: BallPlateProblem, mean: Floats, table: Complexes, cmm: Complexes
) -> Parameters:
    """Bring the harmonics back to the fixed frame; ``mean`` (R, 3) is harmonic zero."""
    grid, radius = problem.grid, problem.radius
    # At q = 1 the CMM's coefficient is the pose of the axis (Eq. 15 leaves nothing for b).
    shift = np.sqrt(2.0) * cmm[PLANE, 0, 1].conj() / grid
    tilt = -2.0 * cmm[AXIS, 0, 0] / (grid * radius)
    columns = np.empty((len(table[PLANE]), 3, 3), dtype=np.complex128)
    columns[:, 0, :2], columns[:, 0, 2] = table[PLANE, :, :2] @ TO_PLANE.T, table[AXIS, :, 2]
    columns[:, 1, :2], columns[:, 1, 2] = table[AXIS, :, :2] @ TO_PLANE.T, table[PLANE, :, 2]
    cmm[PLANE, 0, 1] = cmm[AXIS, 0, 0] = 0.0
    columns[:, 2, :2], columns[:, 2, 2] = cmm[PLANE] @ TO_PLANE.T, cmm[AXIS, :, 0]
    sequences = harmonics.to_time(columns, grid).swapaxes(0, 1)
    sequences[..., :2] = _turn(sequences, problem.angles)
    common = mean[:, 1:].sum(axis=0) / len(mean)  # tangential and axial: u_z and v_z (Eq. 19)
    plate = mean.copy()
    plate[:, 1:] -= common
    plate[:, :2] = _turn(plate, problem.angles[problem.balls])
    return Parameters(
        plate=plate,
        cmm=sequences[2],
        rotation=sequences[1] / radius,
        translation=sequences[0],
        axis_rotation=np.array([tilt.imag, tilt.real, common[0] / radius]),
        axis_shift=np.array([shift.real, shift.imag, common[1]]),
    )


def _residuals(problem: BallPlateProblem, rest: Complexes, shift: Ints) -> Floats:
    """Residuals (n, 3) in the fixed frame, canonical order, from those of the harmonics."""
    grid, n_balls = problem.grid, len(problem.balls)
    columns = np.empty((rest.shape[1], n_balls, 3), dtype=np.complex128)
    columns[..., :2], columns[..., 2] = rest[PLANE] @ TO_PLANE.T, rest[AXIS, ..., 0]
    turned = harmonics.to_time(columns, grid).swapaxes(0, 1)
    residuals = np.empty((n_balls, grid, 3))
    by_table = np.arange(n_balls)[:, None], shift
    residuals[(*by_table, 2)] = turned[..., 2]
    residuals[(*by_table, slice(0, 2))] = _turn(turned, problem.angles)
    return residuals.reshape(-1, 3)


def _unit_std(problem: BallPlateProblem, system: Harmonics) -> Parameters:
    """Return the standard deviations of all parameters for unit noise."""
    grid, radius, n_balls = problem.grid, problem.radius, len(problem.balls)
    cmm_spectrum = harmonics.cmm_covariance(system)
    shift = cmm_spectrum[PLANE, 0, 1, 1].real / grid
    tilt = 2.0 * cmm_spectrum[AXIS, 0, 0, 0].real / grid / radius**2
    cmm_spectrum[PLANE, 0, 1, :] = cmm_spectrum[PLANE, 0, :, 1] = 0.0
    cmm_spectrum[AXIS, 0] = 0.0
    axial_cmm = harmonics.zero_lag(cmm_spectrum[AXIS, :, 0, 0], grid, axis=0).real
    plane_cmm = harmonics.real_basis(harmonics.zero_lag(cmm_spectrum[PLANE], grid, axis=0)).real
    table = harmonics.real_basis(harmonics.zero_lag(system.inverse, grid, axis=1)).real
    common = 1.0 / (grid * n_balls)
    ball = np.diag([1.0 / grid, 1.0 / grid - common])
    pairs = np.array([table[PLANE, :2, :2], table[AXIS, :2, :2], plane_cmm])
    along = np.array([table[AXIS, 2, 2], table[PLANE, 2, 2], axial_cmm])
    translation, rotation, cmm = _turned_std(pairs, along, problem.angles)
    return Parameters(
        plate=_turned_std(ball[None], ball[1:, 1], problem.angles[problem.balls])[0],
        cmm=cmm,
        rotation=rotation / radius,
        translation=translation,
        axis_rotation=np.sqrt([tilt, tilt, common / radius**2]),
        axis_shift=np.sqrt([shift, shift, common]),
    )


def _turned_std(pairs: Floats, along: Floats, angles: Floats) -> Floats:
    """Return the standard deviations (f, n, 3) of f vectors at n angles.

    ``pairs`` (f, 2, 2) are their plane covariances in the turning frame, ``along`` (f,) the
    variances of their z.
    """
    cos, sin = np.cos(angles), np.sin(angles)
    xx, yy, xy = pairs[:, 0, 0, None], pairs[:, 1, 1, None], pairs[:, 0, 1, None]
    variances = np.empty((len(pairs), len(angles), 3))
    mixed = 2.0 * xy * (cos * sin)
    variances[..., 0] = xx * cos**2 + yy * sin**2 - mixed
    variances[..., 1] = xx * sin**2 + yy * cos**2 + mixed
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
