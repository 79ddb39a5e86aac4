"""The least squares of a complete measurement by discrete Fourier transform.

In the frame that turns with the CMM position every ball sees a shifted copy of the table's
sequence, so the transform over the CMM positions splits the problem into one small system per
harmonic (docs/ball_plate.md has the derivation). Result and covariances equal the dense form.

Notation: a plane vector is held as w+ = (w_x + i w_y)/sqrt 2 and w- = (w_x - i w_y)/sqrt 2, a
unitary change of basis that makes every coefficient a pure phase. Unknowns per harmonic q:
in the plane (d+, d-, rho c_z | b+, b-), along the axis (d_z, rho c+, rho c- | b_z).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rotcal_ros.errors import ObservabilityError
from rotcal_ros.methods.ball_plate import model
from rotcal_ros.methods.ball_plate.model import Parameters, Solution
from rotcal_ros.methods.ball_plate.problem import (
    BallPlateProblem,
    Complexes,
    Floats,
    Ints,
    grid_angles,
)

ROOT_HALF = np.sqrt(0.5)
_TO_PLANE = ROOT_HALF * np.array([[1.0, 1.0], [-1j, 1j]])  # (w+, w-) to (w_x, w_y)
RANK_TOLERANCE = 1e-9
"""Smallest accepted eigenvalue of a harmonic's reduced matrix, relative to the ball count."""


@dataclass(frozen=True)
class Block:
    """The systems of all harmonics q = 1..N//2 of one direction (plane or axis).

    ``centred`` (Q, R, m, 3) is the table's design, its mean over the balls taken off (which
    eliminates the CMM's m unknowns), ``mean`` (Q, m, 3) that mean, ``inverse`` (Q, 3, 3) the
    unit covariance of the table's three unknowns; zero where a constraint fixes one.
    """

    centred: Complexes
    mean: Complexes
    inverse: Complexes


def phases(grid: int, balls: Ints) -> Complexes:
    """Return exp(-2 pi i q j / N), (N//2 + 3, R), for q = -1 .. N//2 + 1."""
    q = np.arange(-1, grid // 2 + 2)
    turn = np.exp(-1j * grid_angles(grid))
    powers: Complexes = turn[np.outer(q, balls) % grid]
    return powers


def plane_design(phase: Complexes) -> Complexes:
    """Return the design (Q, R, 2, 3) of rows +, - against (d+, d-, rho c_z), q = 1..N//2."""
    below, own, above = phase[1:-2], phase[2:-1], phase[3:]
    design = np.zeros((*own.shape, 2, 3), dtype=np.complex128)
    design[..., 0, 0] = above
    design[..., 1, 1] = below
    design[..., 0, 2] = 1j * ROOT_HALF * own
    design[..., 1, 2] = -design[..., 0, 2]
    return design


def axis_design(phase: Complexes) -> Complexes:
    """Return the design (Q, R, 1, 3) of the z row against (d_z, rho c+, rho c-), q = 1..N//2."""
    below, own, above = phase[1:-2], phase[2:-1], phase[3:]
    design = np.empty((*own.shape, 1, 3), dtype=np.complex128)
    design[..., 0, 0] = own
    design[..., 0, 1] = 1j * ROOT_HALF * above
    design[..., 0, 2] = -1j * ROOT_HALF * below
    return design


def gram(design: Complexes) -> tuple[Complexes, Complexes, Complexes]:
    """Eliminate the CMM: return the centred design, its mean and the normal matrix (Q, 3, 3)."""
    mean = design.mean(axis=1)
    centred = design - mean[:, None]
    flat = centred.reshape(len(design), -1, 3)
    return centred, mean, flat.conj().transpose(0, 2, 1) @ flat


def factor(design: Complexes, fixed_at_first: int) -> Block:
    """Invert the systems of all harmonics; at q = 1 the constraint sets one unknown to zero."""
    centred, mean, normal = gram(design)
    normal[0, fixed_at_first, :] = normal[0, :, fixed_at_first] = 0.0
    normal[0, fixed_at_first, fixed_at_first] = 1.0
    # The squared tolerance only keeps the inversion alive; separability.py names what is lost.
    if np.any(np.abs(np.linalg.det(normal)) < (RANK_TOLERANCE * design.shape[1]) ** 2):
        raise ObservabilityError(
            "these balls do not separate table, plate and CMM at every harmonic; "
            "see separability.describe for the harmonics that are lost"
        )
    inverse = np.linalg.inv(normal)
    inverse[0, fixed_at_first, fixed_at_first] = 0.0
    return Block(centred, mean, inverse)


def fit(block: Block, spectrum: Complexes) -> tuple[Complexes, Complexes, Complexes]:
    """Solve all harmonics: ``spectrum`` (Q, R, m) to table (Q, 3), CMM (Q, m), residual.

    One step of iterative refinement takes the squared condition number out of the answer.
    """
    mean = spectrum.mean(axis=1)
    rest = spectrum - mean[:, None]
    table = np.zeros((len(spectrum), 3, 1), dtype=np.complex128)
    flat = block.centred.reshape(len(spectrum), -1, 3)
    adjoint = block.inverse @ flat.conj().transpose(0, 2, 1)
    right = rest.reshape(len(spectrum), -1, 1)
    residual = right
    for _ in range(2):
        table = table + adjoint @ residual
        residual = right - flat @ table
    return table[..., 0], mean - (block.mean @ table)[..., 0], residual.reshape(spectrum.shape)


def covariance_spectrum(block: Block) -> Complexes:
    """Return the unit covariance (Q, 3 + m, 3 + m) of table and CMM unknowns per harmonic."""
    n_harmonics, n_balls, rows, _ = block.centred.shape
    spectrum = np.empty((n_harmonics, 3 + rows, 3 + rows), dtype=np.complex128)
    cross = block.mean @ block.inverse
    spectrum[:, :3, :3] = block.inverse
    spectrum[:, 3:, :3] = -cross
    spectrum[:, :3, 3:] = -cross.conj().transpose(0, 2, 1)
    spectrum[:, 3:, 3:] = np.eye(rows) / n_balls + cross @ block.mean.conj().transpose(0, 2, 1)
    return spectrum


def lags(spectrum: Complexes, grid: int) -> Floats:
    """Return the real circulant covariance (N, p, p) of half a spectrum (Q, p, p), q >= 1."""
    full = np.concatenate([np.zeros_like(spectrum[:1]), spectrum])
    covariance: Floats = np.fft.irfft(full, n=grid, axis=0)
    return covariance


def zero_lag(spectrum: Complexes, grid: int) -> Floats:
    """Return only the covariance at lag 0, (p, p): all that standard deviations need."""
    twice = np.full(len(spectrum), 2.0)
    if grid % 2 == 0:
        twice[-1] = 1.0
    covariance: Floats = np.tensordot(twice, spectrum.real, axes=1) / grid
    return covariance


def real_basis(spectrum: Complexes, plane: tuple[int, ...]) -> Complexes:
    """Turn pairs (w+, w-) starting at the indices ``plane`` into (w_x, w_y) in a covariance."""
    basis = np.eye(spectrum.shape[-1], dtype=np.complex128)
    for start in plane:
        basis[start : start + 2, start : start + 2] = _TO_PLANE
    turned: Complexes = basis @ spectrum @ basis.conj().T
    return turned


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
    grid, balls = problem.grid, problem.balls
    phase = phases(grid, balls)
    plane = factor(plane_design(phase), fixed_at_first=1)
    axis = factor(axis_design(phase), fixed_at_first=2)
    spectrum, shift = _measured_spectrum(problem)
    plane_fit = fit(plane, spectrum[1:, :, :2] @ _TO_PLANE.conj())
    axis_fit = fit(axis, spectrum[1:, :, 2:])
    residuals = _residuals(problem, plane_fit[2], axis_fit[2], shift)
    return Solution(
        estimate=_estimate(problem, spectrum[0].real / grid, plane_fit, axis_fit),
        unit_std=_unit_std(problem, plane, axis),
        unit_covariance=TableCovariance(grid, problem.radius, plane, axis),
        residuals=residuals,
        cofactor=_cofactor(problem, plane, axis),
        weighted_square_sum=float(np.sum(residuals**2)),
        dof=model.degrees_of_freedom(problem),
        way="spectral",
    )


def _measured_spectrum(problem: BallPlateProblem) -> tuple[Complexes, Ints]:
    """Return the transform (N//2 + 1, R, 3) of the data in the turning frame, and the shift.

    ``shift`` (R, N) is the table position at which ball r was measured at CMM position k.
    """
    grid, n_balls = problem.grid, len(problem.balls)
    shift = (np.arange(grid) - problem.balls[:, None]) % grid
    by_cmm = problem.centres.reshape(n_balls, grid, 3)[np.arange(n_balls)[:, None], shift]
    turn = np.exp(-1j * problem.angles)
    flat = (by_cmm[..., 0] + 1j * by_cmm[..., 1]) * turn - problem.radius
    turned = np.stack([flat.real, flat.imag, by_cmm[..., 2]], axis=-1)
    return np.fft.rfft(turned, axis=1).transpose(1, 0, 2), shift


def _to_time(coefficients: Complexes, grid: int) -> Floats:
    """Back from the coefficients (Q, p) of q >= 1 to real sequences (N, p) of zero mean."""
    full = np.concatenate([np.zeros_like(coefficients[:1]), coefficients])
    sequence: Floats = np.fft.irfft(full, n=grid, axis=0)
    return sequence


def _turn(plane: Floats, angles: Floats) -> Floats:
    """Rotate plane vectors (n, 2) by their angles (n,)."""
    turned = (plane[:, 0] + 1j * plane[:, 1]) * np.exp(1j * angles)
    return np.stack([turned.real, turned.imag], axis=1)


def _estimate(
    problem: BallPlateProblem,
    mean: Floats,
    plane_fit: tuple[Complexes, Complexes, Complexes],
    axis_fit: tuple[Complexes, Complexes, Complexes],
) -> Parameters:
    """Bring the harmonics back to the fixed frame; ``mean`` (R, 3) is harmonic zero."""
    grid, radius, angles = problem.grid, problem.radius, problem.angles
    (plane_table, plane_cmm, _), (axis_table, axis_cmm, _) = plane_fit, axis_fit
    # At q = 1 the CMM's coefficient is the pose of the axis (Eq. 15 leaves nothing for b).
    shift = np.sqrt(2.0) * plane_cmm[0, 1].conj() / grid
    tilt = -2.0 * axis_cmm[0, 0] / (grid * radius)
    plane_cmm, axis_cmm = plane_cmm.copy(), axis_cmm.copy()
    plane_cmm[0, 1] = axis_cmm[0, 0] = 0.0
    translation = _to_time(np.hstack([plane_table[:, :2] @ _TO_PLANE.T, axis_table[:, :1]]), grid)
    rotation = _to_time(np.hstack([axis_table[:, 1:] @ _TO_PLANE.T, plane_table[:, 2:]]), grid)
    cmm = _to_time(np.hstack([plane_cmm @ _TO_PLANE.T, axis_cmm]), grid)
    for sequence in (translation, rotation, cmm):
        sequence[:, :2] = _turn(sequence[:, :2], angles)
    common = mean[:, 1:].mean(axis=0)  # tangential and axial: u_z and v_z (Eq. 19)
    plate = mean - np.concatenate([[0.0], common])
    plate[:, :2] = _turn(plate[:, :2], angles[problem.balls])
    return Parameters(
        plate=plate,
        cmm=cmm,
        rotation=rotation / radius,
        translation=translation,
        axis_rotation=np.array([tilt.imag, tilt.real, common[0] / radius]),
        axis_shift=np.array([shift.real, shift.imag, common[1]]),
    )


def _residuals(
    problem: BallPlateProblem, plane: Complexes, axis: Complexes, shift: Ints
) -> Floats:
    """Residuals (n, 3) in the fixed frame, canonical order, from those of the harmonics."""
    grid, n_balls = problem.grid, len(problem.balls)
    coefficients = np.concatenate([plane @ _TO_PLANE.T, axis], axis=2)
    turned = _to_time(coefficients.reshape(len(plane), -1), grid).reshape(grid, n_balls, 3)
    flat = turned.transpose(1, 0, 2).reshape(-1, 3)
    flat[:, :2] = _turn(flat[:, :2], np.tile(problem.angles, n_balls))
    residuals = np.empty((n_balls, grid, 3))
    residuals[np.arange(n_balls)[:, None], shift] = flat.reshape(n_balls, grid, 3)
    return residuals.reshape(-1, 3)


def _fixed_frame(covariance: Floats, angles: Floats) -> Floats:
    """Turn (..., 2, 2) covariances of plane vectors into the fixed frame at ``angles`` (n,)."""
    turn = model.rotations(angles)[:, :2, :2]
    turned: Floats = turn @ covariance @ turn.transpose(0, 2, 1)
    return turned


def _unit_std(problem: BallPlateProblem, plane: Block, axis: Block) -> Parameters:
    """Standard deviations of all parameters for unit noise."""
    grid, radius, n_balls = problem.grid, problem.radius, len(problem.balls)
    angles = problem.angles
    plane_spectrum, axis_spectrum = covariance_spectrum(plane), covariance_spectrum(axis)
    shift = plane_spectrum[0, 4, 4].real / grid
    tilt = 2.0 * axis_spectrum[0, 3, 3].real / grid / radius**2
    plane_spectrum[0, 4, :] = plane_spectrum[0, :, 4] = 0.0
    axis_spectrum[0, 3, :] = axis_spectrum[0, :, 3] = 0.0
    in_plane = zero_lag(real_basis(plane_spectrum, (0, 3)), grid)
    axial = zero_lag(real_basis(axis_spectrum, (1,)), grid)

    def columns(flat: Floats, along: float) -> Floats:
        variances = np.diagonal(_fixed_frame(flat, angles), axis1=1, axis2=2)
        return np.sqrt(np.column_stack([variances, np.full(grid, along)]))

    ball = np.array([1.0, 1.0 - 1.0 / n_balls]) / grid
    plate = np.diagonal(_fixed_frame(np.diag(ball), angles[problem.balls]), axis1=1, axis2=2)
    common = 1.0 / (grid * n_balls)
    return Parameters(
        plate=np.sqrt(np.column_stack([plate, np.full(n_balls, ball[1])])),
        cmm=columns(in_plane[3:, 3:], axial[3, 3]),
        rotation=columns(axial[1:3, 1:3], in_plane[2, 2]) / radius,
        translation=columns(in_plane[:2, :2], axial[0, 0]),
        axis_rotation=np.sqrt([tilt, tilt, common / radius**2]),
        axis_shift=np.sqrt([shift, shift, common]),
    )


def _cofactor(problem: BallPlateProblem, plane: Block, axis: Block) -> Floats:
    """Unit covariance (n, 3, 3) of the residuals: the same for a ball at all positions."""
    grid, n_balls = problem.grid, len(problem.balls)
    turning = np.zeros((n_balls, 3, 3))
    for block, at in ((plane, slice(0, 2)), (axis, slice(2, 3))):
        rows = block.centred.transpose(1, 0, 2, 3)
        spectrum = -(rows @ block.inverse @ rows.conj().swapaxes(2, 3))
        spectrum = spectrum + np.eye(rows.shape[2]) * (1.0 - 1.0 / n_balls)
        for ball in range(n_balls):
            real = real_basis(spectrum[ball], (0,) if rows.shape[2] == 2 else ())
            turning[ball, at, at] = zero_lag(real, grid)
    angle = problem.angles[problem.cmm_index]
    turn = model.rotations(angle)
    cofactor: Floats = turn @ np.repeat(turning, grid, axis=0) @ turn.transpose(0, 2, 1)
    return cofactor


@dataclass(frozen=True)
class TableCovariance:
    """Unit covariance of two of the table's components, from the circulant blocks on demand.

    Calling it with two ISO 230-1 names returns (N, N). The blocks are all it holds, so a grid
    of thousands of positions costs no memory until a matrix is asked for.
    """

    grid: int
    radius: float
    plane: Block
    axis: Block

    def __call__(self, first: str, second: str) -> Floats:
        """Return the (N, N) unit covariance of components ``first`` and ``second``."""
        in_plane = {"EXC": (0, 1.0), "EYC": (0, -1j), "ECC": (2, 1.0 / self.radius)}
        along = {"EZC": (0, 1.0), "EAC": (1, 1.0 / self.radius), "EBC": (1, -1j / self.radius)}
        for block, part in ((self.plane, in_plane), (self.axis, along)):
            if first in part and second in part:
                return self._pair(block, part[first], part[second])
        return np.zeros((self.grid, self.grid))

    def _pair(
        self, block: Block, first: tuple[int, complex], second: tuple[int, complex]
    ) -> Floats:
        paired = 0 if block is self.plane else 1
        real = real_basis(block.inverse, (paired,))
        covariance = lags(real, self.grid)
        lag = (np.arange(self.grid)[:, None] - np.arange(self.grid)) % self.grid
        total = np.zeros((self.grid, self.grid))
        for index, weight in self._weights(first, paired):
            for other, other_weight in self._weights(second, paired):
                total += weight[:, None] * covariance[lag, index, other] * other_weight
        return total

    def _weights(self, component: tuple[int, complex], paired: int) -> list[tuple[int, Floats]]:
        """Return the turning-frame unknowns of which a fixed-frame component is made."""
        start, factor = component
        if start != paired:
            return [(start, np.full(self.grid, factor.real))]
        turn = np.exp(1j * grid_angles(self.grid)) * factor  # x: Re, y: Re(-i ...)
        return [(start, turn.real), (start + 1, -turn.imag)]
