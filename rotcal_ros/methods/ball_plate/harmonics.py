"""One small system per harmonic: the complete measurement after a discrete Fourier transform.

In the frame that turns with the CMM position every ball sees a shifted copy of the table's
sequence, so the transform over the CMM positions splits the least squares into systems that do
not know of each other (docs/ball_plate.md has the derivation).

Notation: a plane vector is held as w+ = (w_x + i w_y)/sqrt 2 and w- = (w_x - i w_y)/sqrt 2, a
unitary change of basis that makes every coefficient a pure phase. Two blocks of three table
unknowns, stacked along the first axis: PLANE (d+, d-, rho c_z), measured by the rows +, -, and
AXIS (rho c+, rho c-, d_z), measured by the row z (its second row is empty).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rotcal_ros.errors import ObservabilityError
from rotcal_ros.methods.ball_plate.problem import Complexes, Floats, Ints, grid_angles

PLANE, AXIS = 0, 1
ROOT_HALF = np.sqrt(0.5)
TO_PLANE = ROOT_HALF * np.array([[1.0, 1.0], [-1j, 1j]])  # (w+, w-) to (w_x, w_y)
RANK_TOLERANCE = 1e-9
"""Smallest accepted eigenvalue of a harmonic's reduced matrix, relative to the ball count."""

WEAK = 100.0
"""Amplification of the noise from which on the solution is refined."""


@dataclass(frozen=True)
class Harmonics:
    """The factored systems of q = 1..N//2, Q of them, for R balls.

    ``centred`` (2, Q, 2R, 3) is the table's design, rows ordered ball by ball, with the mean
    over the balls taken off, which eliminates the CMM's unknowns; ``mean`` (2, Q, 2, 3) is that
    mean; ``inverse`` (2, Q, 3, 3) is the unit covariance of the table's unknowns, zero where a
    constraint fixes one.
    """

    grid: int
    balls: Ints
    centred: Complexes
    mean: Complexes
    inverse: Complexes


def phases(grid: int, balls: Ints) -> Complexes:
    """Return exp(-2 pi i q j / N), (N//2 + 2, R), for q = 0 .. N//2 + 1."""
    turn = np.exp(-1j * grid_angles(grid))
    powers: Complexes = turn[np.outer(np.arange(grid // 2 + 2), balls) % grid]
    return powers


def design(phase: Complexes) -> Complexes:
    """Return the table's design (2, Q, R, 2, 3) from :func:`phases`, for q = 1..N//2."""
    below, own, above = phase[:-2], phase[1:-1], phase[2:]
    matrix = np.zeros((2, *own.shape, 2, 3), dtype=np.complex128)
    half = (1j * ROOT_HALF) * phase
    matrix[PLANE, ..., 0, 0] = above
    matrix[PLANE, ..., 1, 1] = below
    matrix[PLANE, ..., 0, 2] = half[1:-1]
    matrix[PLANE, ..., 1, 2] = -half[1:-1]
    matrix[AXIS, ..., 0, 0] = half[2:]
    matrix[AXIS, ..., 0, 1] = -half[:-2]
    matrix[AXIS, ..., 0, 2] = own
    return matrix


def couplings(sums: Complexes, n_balls: int) -> tuple[Floats, Complexes, Complexes, Complexes]:
    """Return the pieces of all normal matrices from P(q) = sum of the phases over the balls.

    ``sums`` (..., Q + 2) holds q = 0..N//2 + 1. Returns R - |P(q)|^2 / R (..., Q + 2), and for
    q = 1..N//2 the couplings of the unknowns of q + 1 with those of q, of q - 1 with q and of
    q + 1 with q - 1, (..., Q) each. At q = 1 a constraint fixes the unknown of q - 1: its
    couplings are zero, and its diagonal is R so that the matrices stay regular.
    """
    below, own, above = sums[..., :-2], sums[..., 1:-1], sums[..., 2:]
    share = 1.0 / n_balls
    diagonal = n_balls - share * (sums.real**2 + sums.imag**2)
    diagonal[..., 0] = n_balls
    up = sums[..., 1, None] - share * above * own.conj()
    down = sums[..., 1, None] - share * below.conj() * own
    across = sums[..., 2, None] - share * above * below.conj()
    down[..., 0] = across[..., 0] = 0.0
    return diagonal, up, down, across


def normal_matrices(sums: Complexes, n_balls: int) -> Complexes:
    """Return the normal matrices (2, Q, 3, 3) after the CMM is eliminated."""
    diagonal, up, down, across = couplings(sums, n_balls)
    lower, middle, upper = diagonal[:-2], diagonal[1:-1], diagonal[2:]
    normal = np.zeros((2, len(middle), 3, 3), dtype=np.complex128)
    normal[PLANE, :, 0, 0], normal[AXIS, :, 0, 0] = upper, 0.5 * upper
    normal[PLANE, :, 1, 1], normal[AXIS, :, 1, 1] = lower, 0.5 * lower
    normal[..., 2, 2] = middle
    up, down, across = (1j * ROOT_HALF) * up.conj(), (-1j * ROOT_HALF) * down, -0.5 * across
    normal[PLANE, :, 0, 2], normal[PLANE, :, 2, 0] = up, up.conj()
    normal[PLANE, :, 1, 2], normal[PLANE, :, 2, 1] = down, down.conj()
    normal[AXIS, :, 0, 1], normal[AXIS, :, 1, 0] = across.conj(), across
    normal[AXIS, :, :2, 2] = -normal[PLANE, :, :2, 2]
    normal[AXIS, :, 2, :2] = -normal[PLANE, :, 2, :2]
    return normal


def factor(grid: int, balls: Ints) -> Harmonics:
    """Invert the systems of all harmonics; raise ObservabilityError when one is singular."""
    phase = phases(grid, balls)
    sums = phase.sum(axis=1)
    normal = normal_matrices(sums, len(balls))
    mean = design(sums[:, None] / len(balls))[:, :, 0]
    centred = (design(phase) - mean[:, :, None]).reshape(2, len(sums) - 2, -1, 3)
    try:
        inverse = np.asarray(np.linalg.inv(normal), dtype=np.complex128)
    except np.linalg.LinAlgError:
        inverse = np.full_like(normal, np.inf)
    if not np.abs(inverse).max() * RANK_TOLERANCE * len(balls) < 1.0:
        raise ObservabilityError(
            f"balls at steps {balls.tolist()} of {grid} do not separate table, plate and CMM at "
            "every harmonic; choose other steps (separability names the lost harmonics)"
        )
    inverse[:, 0, 1, 1] = 0.0
    return Harmonics(grid, balls, centred, mean, inverse)


def fit(system: Harmonics, spectrum: Complexes) -> tuple[Complexes, Complexes, Complexes]:
    """Solve all harmonics: ``spectrum`` (2, Q, R, 2) to table (2, Q, 3), CMM (2, Q, 2), rest.

    Where a layout is weak, a step of iterative refinement takes the squared condition number
    out of the answer.
    """
    mean = spectrum.sum(axis=2) / len(system.balls)
    right = (spectrum - mean[:, :, None]).reshape(*spectrum.shape[:2], -1, 1)
    adjoint = system.centred.conj().swapaxes(2, 3)
    table = system.inverse @ (adjoint @ right)
    residual = right - system.centred @ table
    if np.abs(system.inverse).max() * len(system.balls) > WEAK:
        table += system.inverse @ (adjoint @ residual)
        residual = right - system.centred @ table
    cmm = mean - (system.mean @ table)[..., 0]
    return table[..., 0], cmm, residual.reshape(spectrum.shape)


def cmm_covariance(system: Harmonics) -> Complexes:
    """Return the unit covariance (2, Q, 2, 2) of the CMM's unknowns, pose of the axis included."""
    spread = system.mean @ system.inverse @ system.mean.conj().swapaxes(2, 3)
    covariance: Complexes = spread + np.eye(2) / len(system.balls)
    return covariance


def from_plane(sequences: Complexes) -> tuple[Complexes, Complexes]:
    """Transform x + i y, (N, ...), to w+ and w- (Q, ...) for q = 1..N//2."""
    grid = len(sequences)
    last = grid // 2 + 1
    full = ROOT_HALF * np.fft.fft(sequences, axis=0)
    return full[1:last], full[: grid - last : -1].conj()


def to_plane(plus: Complexes, minus: Complexes, grid: int) -> Complexes:
    """Return x + i y (N, ...) of zero mean from w+ and w- (Q, ...): inverts from_plane."""
    full = np.zeros((grid, *plus.shape[1:]), dtype=np.complex128)
    full[1 : grid // 2 + 1] = plus
    full[: grid - grid // 2 - 1 : -1] = minus.conj()
    sequences: Complexes = np.fft.ifft(full / ROOT_HALF, axis=0)
    return sequences


def to_time(coefficients: Complexes, grid: int) -> Floats:
    """Return the real sequences (N, ...) of zero mean with the coefficients (Q, ...), q >= 1."""
    padded = np.zeros((len(coefficients) + 1, *coefficients.shape[1:]), dtype=np.complex128)
    padded[1:] = coefficients
    sequences: Floats = np.fft.irfft(padded, n=grid, axis=0)
    return sequences


def zero_lag(spectrum: Complexes, grid: int, axis: int) -> Complexes:
    """Return the sum over harmonics of both signs / N, before the real part is taken.

    Its real part is the covariance at lag 0 once the basis is real (:func:`real_basis`).
    """
    total = 2.0 * spectrum.sum(axis=axis)
    if grid % 2 == 0:
        total -= spectrum.take(-1, axis=axis)  # the Nyquist harmonic has no twin
    mean: Complexes = total / grid
    return mean


def real_basis(covariance: Complexes) -> Complexes:
    """Turn (w+, w-[, s]) into (w_x, w_y[, s]) in covariances (..., 2 or 3, 2 or 3)."""
    basis = np.eye(covariance.shape[-1], dtype=np.complex128)
    basis[:2, :2] = TO_PLANE
    turned: Complexes = basis @ covariance @ basis.conj().T
    return turned
