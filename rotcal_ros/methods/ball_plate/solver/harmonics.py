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
from functools import lru_cache

import numpy as np

from rotcal_ros.foundation.arrays import Complexes, Floats, Ints
from rotcal_ros.foundation.errors import ObservabilityError
from rotcal_ros.methods.ball_plate.solver.problem import grid_angles

PLANE, AXIS = 0, 1
POSE = ((1, PLANE), (0, AXIS))
"""Rows that tell the pose of the axis at q = 1: w- (shift) and z (tilt)."""
ROOT_HALF = np.sqrt(0.5)
TO_PLANE = ROOT_HALF * np.array([[1.0, 1.0], [-1j, 1j]])  # (w+, w-) to (w_x, w_y)
RANK_TOLERANCE = 1e-9
"""Smallest accepted eigenvalue of a harmonic's reduced matrix, relative to the ball count."""

WEAK = 100.0
"""Amplification of the noise from which on the solution is refined."""
LAYOUTS = 8
"""How many layouts are remembered."""


@dataclass(frozen=True)
class Harmonics:
    """The factored systems of q = 1..N//2, Q of them, for R balls.

    ``shift`` (3, Q, R) are the phases that bring the rows +, - and z from the frame that turns
    with the table to the one that turns with the CMM position; in the former the table's design
    is the same for all harmonics, ``adjoint`` (3, R, 3) being its adjoint. ``mean`` (2, Q, 2, 3)
    is the mean of the design over the balls in the latter; ``inverse`` (2, Q, 3, 3) is the unit
    covariance of the table's unknowns, zero where a constraint fixes one; ``amplification`` is
    its largest entry, 1 for balls that share nothing.
    """

    grid: int
    balls: Ints
    phase: Complexes
    shift: Complexes
    adjoint: Complexes
    mean: Complexes
    inverse: Complexes
    amplification: float


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
    """Invert the systems of all harmonics; raise ObservabilityError when one is singular.

    The last layouts are remembered, as trials and a plate measured again use the same one; the
    arrays are read-only.
    """
    return _factor(grid, tuple(balls.tolist()))


@lru_cache(maxsize=LAYOUTS)
def _factor(grid: int, steps: tuple[int, ...]) -> Harmonics:
    balls = np.array(steps, dtype=np.int64)
    phase = phases(grid, balls)
    sums = phase.sum(axis=1)
    normal = normal_matrices(sums, len(balls))
    try:
        inverse = np.asarray(np.linalg.inv(normal), dtype=np.complex128)
    except np.linalg.LinAlgError:
        inverse = np.full_like(normal, np.inf)
    amplification = float(np.abs(inverse).max()) * len(balls)
    if not amplification * RANK_TOLERANCE < 1.0:
        raise ObservabilityError(
            f"balls at steps {balls.tolist()} of {grid} do not separate table, plate and CMM at "
            "every harmonic; choose other steps (separability names the lost harmonics)"
        )
    inverse[:, 0, 1, 1] = 0.0
    system = Harmonics(
        grid=grid,
        balls=balls,
        phase=phase,
        shift=np.stack([phase[2:], phase[:-2], phase[1:-1]]),
        adjoint=_adjoint(phase[1]),
        mean=design(sums[:, None] / len(balls))[:, :, 0],
        inverse=inverse,
        amplification=amplification,
    )
    for array in (balls, phase, system.shift, system.adjoint, system.mean, inverse):
        array.flags.writeable = False
    return system


def _adjoint(turn: Complexes) -> Complexes:
    """Return the adjoint (3, R, 3) of the design in the table's frame; ``turn`` is e_1 (R,)."""
    half = (1j * ROOT_HALF) * turn
    adjoint = np.zeros((3, len(turn), 3), dtype=np.complex128)
    adjoint[0, :, 0] = adjoint[1, :, 1] = adjoint[2, :, 2] = 1.0
    adjoint[0, :, 2] = -half
    adjoint[2, :, 1] = half
    adjoint[1, :, 2] = adjoint[2, :, 0] = half.conj()
    adjoint[1, :, 2] *= -1.0
    return adjoint


def fit(system: Harmonics, spectrum: Complexes) -> tuple[Complexes, Complexes, Complexes]:
    """Solve all harmonics: ``spectrum`` (3, Q, R) to table (2, Q, 3), CMM (3, Q), rest (3, Q, R).

    Rows are +, - and z in the frame that turns with the table. Where a layout is weak, a step of
    iterative refinement takes the squared condition number out of the answer.
    """
    table = _table_of(system, _centred(system, spectrum.copy())[1])
    cmm, rest = _centred(system, spectrum - _fitted(system, table))
    if system.amplification > WEAK:
        table = table + _table_of(system, rest)
        cmm, rest = _centred(system, spectrum - _fitted(system, table))
    return table, cmm, rest


def _centred(system: Harmonics, rows: Complexes) -> tuple[Complexes, Complexes]:
    """Split rows (3, Q, R), in place, into the CMM's mean over the balls (3, Q) and the rest."""
    rows *= system.shift
    mean = rows.sum(axis=2)
    mean /= len(system.balls)
    rows -= mean[:, :, None]
    rows *= system.shift.conj()
    return mean, rows


def _table_of(system: Harmonics, centred: Complexes) -> Complexes:
    """Return the table's unknowns (2, Q, 3) from centred rows (3, Q, R)."""
    right = centred @ system.adjoint
    right[1] += right[0]
    unknowns: Complexes = np.einsum("bqij,bqj->bqi", system.inverse, right[1:])
    return unknowns


def _fitted(system: Harmonics, table: Complexes) -> Complexes:
    """Return the rows (3, Q, R) that the table's unknowns (2, Q, 3) cause."""
    fitted: Complexes = table[[PLANE, PLANE, AXIS]] @ system.adjoint.conj().swapaxes(1, 2)
    return fitted


def cmm_covariance(system: Harmonics) -> tuple[Complexes, Floats]:
    """Return the unit covariance of the CMM's unknowns at lag 0, (2, 2, 2), and of the pose.

    The pose (2,), shift and tilt, are the coefficients of w- and z at q = 1, which the CMM does
    not have.
    """
    grid, noise = system.grid, 1.0 / len(system.balls)
    rows = system.mean.transpose(2, 3, 0, 1).copy()  # harmonics last: quick for small matrices
    carried = np.einsum("ikbq,klbq->ilbq", rows, system.inverse.transpose(2, 3, 0, 1))
    adjoint = rows.conj()
    pose = noise + np.array(
        [(carried[i, :, block, 0] @ adjoint[i, :, block, 0]).real for i, block in POSE]
    )
    for i, block in POSE:
        carried[i, :, block, 0] = adjoint[i, :, block, 0] = 0.0
    carried *= multiplicity(grid) / grid
    lag = np.einsum("ikbq,jkbq->bij", carried, adjoint)
    # N - 1 harmonics of both signs have no mean. The w- and z of q = 1 went to the pose, counted
    # twice as all are: N - 3. For z these are q = 1 and q = -1. For w- it is q = 1 alone, but as
    # w-(q) is the conjugate of w+(-q), w+ and w- lack one harmonic each: x and y get the mean
    # of both entries, N - 2 (real_basis).
    lag[PLANE, 0, 0] += noise * (grid - 1) / grid
    lag[PLANE, 1, 1] += noise * (grid - 3) / grid
    lag[AXIS, 0, 0] += noise * (grid - 3) / grid
    return lag, pose


def multiplicity(grid: int) -> Floats:
    """How often the harmonics q = 1..N//2 occur with both signs; Nyquist has no twin."""
    twice = np.full(grid // 2, 2.0)
    twice[-1] = 1.0 + grid % 2
    return twice


def to_harmonics(sequences: Complexes) -> tuple[Complexes, Complexes]:
    """Transform x + i y, then z, (2 R, N): rows +, -, z (3, Q, R) of q = 1..N//2; mean (2, R)."""
    n_balls, grid = len(sequences) // 2, sequences.shape[1]
    last = grid // 2 + 1
    full = np.fft.fft(sequences, axis=1)
    rows = np.empty((3, last - 1, n_balls), dtype=np.complex128)
    rows[0] = full[:n_balls, 1:last].T
    rows[1] = full[:n_balls, : grid - last : -1].T.conj()
    rows[:2] *= ROOT_HALF
    rows[2] = full[n_balls:, 1:last].T
    return rows, full[:, 0].reshape(2, n_balls) / grid


def to_sequences(plus: Complexes, minus: Complexes, axial: Complexes, grid: int) -> Complexes:
    """Return x + i y, then z, (m + n, N) of zero mean from w+ and w- (m, Q) and z (n, Q)."""
    n_plane, last = len(plus), grid // 2 + 1
    full = np.zeros((n_plane + len(axial), grid), dtype=np.complex128)
    backward = full[:, : grid - last : -1]
    full[:n_plane, 1:last], backward[:n_plane] = plus, minus.conj()
    full[:n_plane] *= 1.0 / ROOT_HALF
    full[n_plane:, 1:last], backward[n_plane:] = axial, axial.conj()
    return np.fft.ifft(full, axis=1)


def to_time(coefficients: Complexes, grid: int) -> Floats:
    """Return the real sequences (N, ...) of zero mean with the coefficients (Q, ...), q >= 1."""
    padded = np.zeros((len(coefficients) + 1, *coefficients.shape[1:]), dtype=np.complex128)
    padded[1:] = coefficients
    return np.fft.irfft(padded, n=grid, axis=0)


def zero_lag(spectrum: Complexes, grid: int) -> Complexes:
    """Return the sum over harmonics of both signs / N of (2, Q, ...), still complex.

    Its real part is the covariance at lag 0 once the basis is real (:func:`real_basis`).
    """
    mean: Complexes = np.einsum("bq...,q->b...", spectrum, multiplicity(grid) / grid)
    return mean


def real_basis(covariance: Complexes) -> Complexes:
    """Turn (w+, w-[, s]) into (w_x, w_y[, s]) in covariances (..., 2 or 3, 2 or 3)."""
    basis = np.eye(covariance.shape[-1], dtype=np.complex128)
    basis[:2, :2] = TO_PLANE
    turned: Complexes = basis @ covariance @ basis.conj().T
    return turned
