"""Complete measurements with equal weights: one small system per harmonic, nothing to eliminate.

In the frame that turns with the CMM position every ball sees a shifted copy of the table's
sequence, so a discrete Fourier transform over the CMM positions splits the least squares into
systems that do not know of each other. Result and covariances equal the dense form (Eq. 20, 21 of
the paper; ``benchmarks/dense_ball_plate.py``); time and memory grow like N R log N and N R instead
of N^3 and N^2. The model, its symbols and constraints: docs/ball_plate_derivation.md.

Write everything in the frame that turns with the CMM position, primes for vectors in turned
frames:

    y_kj = B_k' (m_kj - p_k),   d'_i = B_i' d_i,   c'_i = B_i' c_i,   b'_k = B_k' b_k

As B_k' B_i = B_{-j},

    y_kj = B_{-j} d'_{k-j} + (B_{-j} c'_{k-j}) x p_0 + b'_k + B_{-j} a_j + (B_k' u) x p_0 + B_k' v.

B_{-j} does not depend on k, so a ball sees a *shifted copy of the same sequence*. The discrete
Fourier transform over k, F(q) = sum_k f_k exp(-2 pi i q k / N), turns the shift by j into the
phase e_q(j) = exp(-2 pi i q j / N). Every harmonic can then be solved alone.

Take w+ = (w_x + i w_y)/sqrt 2 and w- = (w_x - i w_y)/sqrt 2 for plane vectors. B_{-j} then
multiplies by e_1(j) and its conjugate, and all coefficients are pure phases. With p_0 along x only
c_z acts in the plane, and only c_x, c_y act along z:

    Y+ = e_{q+1} D+ + (i/sqrt 2) e_q rho C_z + B+
    Y- = e_{q-1} D- - (i/sqrt 2) e_q rho C_z + B-
    Y_z = e_q D_z + (i/sqrt 2) rho (e_{q+1} C+ - e_{q-1} C-) + B_z

The CMM's unknowns have the coefficient 1 for all balls. Subtracting the mean over the balls
eliminates them and leaves two Hermitian 3 x 3 matrices per harmonic. With P(q) = sum_j e_q(j) they
are, for the plane (D+, D-, rho C_z),

    R - |P(q+1)|^2/R        0                     (i/sqrt 2) X*
    .                       R - |P(q-1)|^2/R     -(i/sqrt 2) Z
    .                       .                     R - |P(q)|^2/R

    X = P(1) - P(q+1) P(q)*/R,     Z = P(1) - P(q-1)* P(q)/R

and for the axis, (rho C+, rho C-, D_z), half the first two diagonals, the same couplings to D_z,
and -1/2 (P(2) - P(q+1) P(q-1)*/R)* between C+ and C-.

As computed, the rows are divided by e_{q+1}, e_{q-1} and e_q, which brings them back to the frame
that turns with the *table*.

*Where the constraints act.* a_j is constant over k: it lives at q = 0 only. Eq. 15 to 18 set b' =
c' = d' = 0 at q = 0, so a, u_z and v_z follow from the means; u_z rho and v_z are the mean over
the balls (Eq. 19). The parts u_xy and v_xy are pure first harmonics. They have the same column as
B_z(1) and B-(1), which Eq. 15 sets to zero: what the fit finds there *is* the pose. D-(1) and
C-(1), also with a constant column, are zero by Eq. 17. For q >= 2 there is nothing to constrain.

*Covariances.* Noise sigma in every coordinate is white in the transform. So the inverse of the 3 x
3 matrix is the unit covariance of a harmonic. Its inverse transform is the circulant covariance
over the table positions in the turning frame. Turned back, the variance of x and y has a constant
part from (w+, w+) and a part that runs with twice the angle from (w+, w-).

Notation: q is the number of the harmonic, Q = N // 2 their count, R that of the balls, rho the
radius of the ball circle. A plane vector is held as w+ = (w_x + i w_y)/sqrt 2 and
w- = (w_x - i w_y)/sqrt 2, a unitary change of basis that makes every coefficient a pure phase. Two
blocks of three unknowns of the table, stacked along the first axis: PLANE (d+, d-, rho c_z),
measured by the rows +, -, and AXIS (rho c+, rho c-, d_z), measured by the row z (its second row is
empty).

With as many balls as table positions the couplings between the unknowns vanish, and the same
solution is a matter of means: :func:`closed_form` (second paper, Eq. 1 to 12).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np

from rotcal_ros.adjust.effects import Seen
from rotcal_ros.foundation.arrays import Bools, Complexes, Floats, Ints
from rotcal_ros.foundation.components import ROTATIONS
from rotcal_ros.foundation.errors import ObservabilityError, PlanError
from rotcal_ros.methods.ball_plate.solver.model import FIELDS, PARTS, LinearFit, PlateParameters
from rotcal_ros.methods.ball_plate.solver.problem import BallPlateProblem, grid_angles

PLANE, AXIS = 0, 1
POSE = ((1, PLANE), (0, AXIS))
"""Rows that determine the pose of the axis at q = 1: w- (shift) and z (tilt)."""
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

    @cached_property
    def fitted(self) -> Complexes:
        """What the table takes of the noise of each ball, (R, 2, 2, 2), at lag 0."""
        return np.array([_fitted_at_ball(self, ball) for ball in range(len(self.balls))])


def phases(grid: int, balls: Ints) -> Complexes:
    """Return exp(-2 pi i q j / N), (N//2 + 2, R), for q = 0 .. N//2 + 1."""
    turn = np.exp(-1j * grid_angles(grid))
    powers: Complexes = turn[np.outer(np.arange(grid // 2 + 2), balls) % grid]
    return powers


def _design(phase: Complexes) -> Complexes:
    """Return the table's design (2, Q, ..., 2, 3) from :func:`phases`, for q = 1..N//2."""
    below, own, above = phase[:-2], phase[1:-1], phase[2:]
    matrix = np.zeros((2, *own.shape, 2, 3), dtype=np.complex128)
    half = (1j * ROOT_HALF) * phase  # a rotation moves p_0 = (rho, 0, 0), as w+ and w- of i rho
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
    # without any coupling the largest entry of the inverse is about 1 / R
    amplification = float(np.abs(inverse).max()) * len(balls)
    if not amplification * RANK_TOLERANCE < 1.0:
        raise ObservabilityError(
            f"balls at steps {balls.tolist()} of {grid} do not separate table, plate and CMM at "
            "every harmonic; choose other steps (separability names the lost harmonics)"
        )
    inverse[:, 0, 1, 1] = 0.0  # the unknowns d- and c- of q = 1 are zero by Eq. 17
    system = Harmonics(
        grid=grid,
        balls=balls,
        phase=phase,
        shift=np.stack([phase[2:], phase[:-2], phase[1:-1]]),
        adjoint=_adjoint(phase[1]),
        mean=_design(sums[:, None] / len(balls))[:, :, 0],
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


def _solve_harmonics(
    system: Harmonics, spectrum: Complexes
) -> tuple[Complexes, Complexes, Complexes]:
    """Solve all harmonics: ``spectrum`` (3, Q, R) to table (2, Q, 3), CMM (3, Q), rest (3, Q, R).

    Rows are +, - and z in the frame that turns with the table, of one fit or of several along
    further axes in front; the rest takes the place of the spectrum. Where a layout is weak, a step
    of iterative refinement takes the squared condition number out of the answer.
    """
    table = _table_of(system, _centred(system, spectrum.copy())[1])
    if system.amplification > WEAK:
        rest = _centred(system, spectrum - _fitted(system, table))[1]
        table = table + _table_of(system, rest)
    spectrum -= _fitted(system, table)
    return table, *_centred(system, spectrum)


def _centred(system: Harmonics, rows: Complexes) -> tuple[Complexes, Complexes]:
    """Split rows (3, Q, R), in place, into the CMM's mean over the balls (3, Q) and the rest."""
    rows *= system.shift  # there and back: only with the CMM position its unknowns are the mean
    mean = rows.sum(axis=-1)
    mean /= len(system.balls)
    rows -= mean[..., None]
    rows *= system.shift.conj()
    return mean, rows


def _table_of(system: Harmonics, centred: Complexes) -> Complexes:
    """Return the table's unknowns (2, Q, 3) from centred rows (3, Q, R)."""
    right = centred @ system.adjoint
    right[..., 1, :, :] += right[..., 0, :, :]  # the rows + and - both measure the block PLANE
    unknowns: Complexes = np.einsum("bqij,...bqj->...bqi", system.inverse, right[..., 1:, :, :])
    return unknowns


def _fitted(system: Harmonics, table: Complexes) -> Complexes:
    """Return the rows (3, Q, R) that the table's unknowns (2, Q, 3) cause."""
    fitted: Complexes = table[..., [PLANE, PLANE, AXIS], :, :] @ system.adjoint.conj().swapaxes(
        1, 2
    )
    return fitted


def _cmm_covariance(system: Harmonics) -> tuple[Complexes, Floats]:
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
    # of both entries, N - 2 (_real_basis).
    lag[PLANE, 0, 0] += noise * (grid - 1) / grid
    lag[PLANE, 1, 1] += noise * (grid - 3) / grid
    lag[AXIS, 0, 0] += noise * (grid - 3) / grid
    return lag, pose


def multiplicity(grid: int) -> Floats:
    """How often the harmonics q = 1..N//2 occur with both signs; Nyquist has no twin."""
    twice = np.full(grid // 2, 2.0)
    twice[-1] = 1.0 + grid % 2
    return twice


def _to_harmonics(sequences: Complexes) -> tuple[Complexes, Complexes]:
    """Transform x + i y, then z, (2 R, N): rows +, -, z (3, Q, R) of q = 1..N//2; mean (2, R)."""
    n_balls, grid = len(sequences) // 2, sequences.shape[1]
    last = grid // 2 + 1
    full = np.fft.fft(sequences, axis=1)
    rows = np.empty((3, last - 1, n_balls), dtype=np.complex128)
    rows[0] = full[:n_balls, 1:last].T
    # x and y are real: w-(q) is the conjugate of w+(-q), found at the end of the transform
    rows[1] = full[:n_balls, : grid - last : -1].T.conj()
    rows[:2] *= ROOT_HALF
    rows[2] = full[n_balls:, 1:last].T
    return rows, full[:, 0].reshape(2, n_balls) / grid


def _of_table(table: Complexes) -> Complexes:
    """Return w+, w- and z of m translations, then of m rotations, (3, 2 m, Q); (m, 2, Q, 3)."""
    fields = table.transpose(3, 1, 0, 2).copy()
    fields[2] = fields[2, ::-1]  # d_z is an unknown of the block AXIS, c_z of PLANE
    return np.asarray(fields.reshape(3, -1, table.shape[2]))


def _to_sequences(harmonics: Complexes, grid: int) -> Complexes:
    """Return x + i y, then z, (2 m, N) of zero mean from w+, w- and z of m vectors, (3, m, Q)."""
    plus, minus, axial = harmonics
    m, last = len(plus), grid // 2 + 1
    full = np.zeros((2 * m, grid), dtype=np.complex128)
    backward = full[:, : grid - last : -1]  # a view of the harmonics -1, -2, ...
    full[:m, 1:last] = plus
    np.conj(minus, out=backward[:m])
    full[:m] *= 1.0 / ROOT_HALF
    full[m:, 1:last] = axial
    np.conj(axial, out=backward[m:])
    return np.fft.ifft(full, axis=1)


def _to_time(coefficients: Complexes, grid: int) -> Floats:
    """Return the real sequences (N, ...) of zero mean with the coefficients (Q, ...), q >= 1."""
    padded = np.zeros((len(coefficients) + 1, *coefficients.shape[1:]), dtype=np.complex128)
    padded[1:] = coefficients
    return np.fft.irfft(padded, n=grid, axis=0)


def _zero_lag(spectrum: Complexes, grid: int) -> Complexes:
    """Return the sum over harmonics of both signs / N of (2, Q, ...), still complex.

    Its real part is the covariance at lag 0 once the basis is real (:func:`_real_basis`).
    """
    mean: Complexes = np.einsum("bq...,q->b...", spectrum, multiplicity(grid) / grid)
    return mean


def _real_basis(covariance: Complexes) -> Complexes:
    """Turn (w+, w-[, s]) into (w_x, w_y[, s]) in covariances (..., 2 or 3, 2 or 3)."""
    basis = np.eye(covariance.shape[-1], dtype=np.complex128)
    basis[:2, :2] = TO_PLANE
    turned: Complexes = basis @ covariance @ basis.conj().T
    return turned


class SpectralFit(LinearFit):
    """A complete measurement with equal weights; the fits equal Eq. 20 and 21.

    For ``problem.complete`` without ``std`` only; the centres play no part, only grid, balls and
    radius. Raises ObservabilityError when the balls do not separate all harmonics.
    """

    way = "spectral"

    def __init__(self, problem: BallPlateProblem) -> None:
        super().__init__(problem)
        self._system = factor(problem.grid, problem.balls)
        self._turn = np.exp(1j * problem.angles)

    def fit(self, observed: Floats) -> tuple[PlateParameters, Floats]:
        """Return parameters and residuals (n, 3) of deviations (n, 3) of the rows, metres."""
        spectrum, mean = _to_harmonics(self._in_table_frame(observed))
        table, cmm, rest = _solve_harmonics(self._system, spectrum)
        pose = self._axis_pose(cmm)
        fields, residuals = self._back(table, cmm, rest)
        return self._estimate(fields, mean, pose), residuals

    def seen_of_plate(self, there: Bools) -> Seen:
        """Return what is seen of motions of the plate, see :class:`LinearFit`.

        Where the plate is a motion of it is the same for a ball at all table positions, in the
        frame that turns with the table: so one transform of ``there`` serves all six. What the
        residuals keep follows from their spectra (Parseval); no single residual is needed.
        """
        problem, system = self.problem, self._system
        present = np.fft.rfft(there.reshape(len(system.balls), -1)).T  # (Q + 1, R)
        out = self._turn[problem.balls]
        plane = ROOT_HALF * np.stack([np.ones_like(out), np.full_like(out, 1j), 1j * out])
        axial = np.stack([np.ones_like(out), out.imag, -out.real])
        unit = np.stack([plane, plane.conj(), axial], axis=1)  # one of each part share a fit
        table, _, rest = _solve_harmonics(system, unit[:, :, None] * present[1:])
        rest *= np.sqrt(multiplicity(system.grid) / system.grid)[:, None]
        found = self._vectors(_to_sequences(_of_table(table), system.grid))
        found = found.reshape(2, 3, system.grid, 3).transpose(1, 0, 3, 2)
        found[:, 1] /= problem.radius
        curves, information, whole = np.zeros((6, 6, system.grid)), np.zeros((6, 6)), np.zeros(6)
        for part, rows in zip(PARTS, (slice(2), slice(2, 3)), strict=True):
            curves[np.ix_(part, part)] = found.reshape(3, 6, -1)[:, part]
            kept = np.ascontiguousarray(rest[:, rows]).reshape(3, -1).view(np.float64)
            information[np.ix_(part, part)] = kept @ kept.T
            whole[part] = (np.abs(unit[:, rows]) ** 2).sum(axis=1) @ present[0].real
        return Seen(curves.reshape(6, -1), information, np.zeros(6), whole)

    @property
    def unit_std(self) -> PlateParameters:
        """The standard deviations of all parameters."""
        problem = self.problem
        return _unit_std(problem.grid, problem.radius, tuple(problem.balls.tolist()))

    def unit_covariance(self, first: str, second: str) -> Floats:
        """Return the covariance (N, N) of two components, from the circulant blocks on demand.

        The blocks are all that is held, so a grid of thousands of positions costs no memory until
        a matrix is asked for.
        """
        system, radius = self._system, self.problem.radius
        grid = system.grid
        block, first_weights = _weights(first, radius, grid)
        other_block, second_weights = _weights(second, radius, grid)
        total = np.zeros((grid, grid))
        if block != other_block:
            return total  # the plane and the axis are measured by different coordinates
        covariance = _to_time(_real_basis(system.inverse[block]), grid)
        lag = (np.arange(grid)[:, None] - np.arange(grid)) % grid  # circulant: only the lag counts
        for index, weight in first_weights:
            for other, other_weight in second_weights:
                total += weight[:, None] * covariance[lag, index, other] * other_weight
        return total

    def cofactor(self) -> Floats:
        """Return the covariance (n, 3, 3) of the residuals.

        In the turning frame one per ball holds everywhere.
        """
        system = self._system
        n_balls, grid = len(system.balls), system.grid
        # of noise 1 an observation keeps 1, less 1/R for the CMM's mean, less what the table fits
        kept: Complexes = (1.0 - 1.0 / n_balls) * (grid - 1) / grid * np.eye(2) - system.fitted
        turn = self._turn[self.problem.cmm_index].reshape(n_balls, grid)
        return _turned(kept[:, PLANE], kept[:, AXIS, 0, 0].real, turn**2).reshape(-1, 3, 3)

    def _in_table_frame(self, observed: Floats) -> Complexes:
        """Return x + i y of deviations (n, 3) in the table's turning frame, then z, (2 R, N)."""
        n_balls = len(self.problem.balls)
        x, y, z = observed.T.reshape(3, n_balls, self.problem.grid)
        sequences = np.zeros((2 * n_balls, self.problem.grid), dtype=np.complex128)
        sequences[:n_balls].real, sequences[:n_balls].imag = x, y
        sequences[:n_balls] *= self._turn.conj()  # turns x + i y back by the table angle
        sequences[n_balls:].real = z
        return sequences

    def _axis_pose(self, cmm: Complexes) -> tuple[complex, complex]:
        """Take tilt (rad) and shift (m) of the axis out of the CMM's coefficients (3, Q).

        In place: at q = 1 those of w- and z are the pose of the axis, Eq. 15 leaves nothing for b.
        """
        shift = np.sqrt(2.0) * cmm[1, 0].conjugate() / self.problem.grid
        tilt = -2.0 * cmm[2, 0] / (self.problem.grid * self.problem.radius)
        cmm[1:, 0] = 0.0
        return complex(tilt), complex(shift)

    def _back(self, table: Complexes, cmm: Complexes, rest: Complexes) -> tuple[Floats, Floats]:
        """Bring harmonics back to the fixed frame.

        Returns translation, rotation times radius and CMM, (3, N, 3), and the residuals (n, 3).
        """
        grid = self.problem.grid
        fields = np.concatenate([_of_table(table[None]), cmm[:, None]], axis=1)
        found = [_to_sequences(each, grid) for each in (fields, rest.transpose(0, 2, 1))]
        return self._vectors(found[0]), self._vectors(found[1]).reshape(-1, 3)

    def _vectors(self, sequences: Complexes) -> Floats:
        """Return vectors (m, N, 3) in the fixed frame of x + i y, then z, (2 m, N)."""
        plane, axial = np.split(sequences, 2)
        plane *= self._turn
        return np.stack([plane.real, plane.imag, axial.real], axis=2)

    def _estimate(
        self, fields: Floats, mean: Complexes, pose: tuple[complex, complex]
    ) -> PlateParameters:
        """Join all parameters; ``mean`` (2, R), x + i y and z, is harmonic zero on the plate."""
        tilt, shift = pose
        out = self._turn[self.problem.balls]
        local = mean[0] * out.conj()  # radial + i tangential
        common = local.imag.sum() / len(out), mean[1].real.sum() / len(out)  # u_z, v_z (Eq. 19)
        ball = (local - 1j * common[0]) * out
        return PlateParameters(
            plate=np.stack([ball.real, ball.imag, mean[1].real - common[1]], axis=1),
            cmm=fields[2],
            rotation=fields[1] / self.problem.radius,
            translation=fields[0],
            axis_rotation=np.array([tilt.imag, tilt.real, common[0] / self.problem.radius]),
            axis_shift=np.array([shift.real, shift.imag, common[1]]),
        )


@lru_cache(maxsize=LAYOUTS)
def _unit_std(grid: int, radius: float, balls: tuple[int, ...]) -> PlateParameters:
    """Return the standard deviations of all parameters for unit noise, read-only."""
    steps = np.array(balls, dtype=np.int64)
    system, turn = factor(grid, steps), np.exp(1j * grid_angles(grid))
    cmm, (shift, tilt) = _cmm_covariance(system)
    table = _zero_lag(system.inverse, grid)
    shift, tilt = shift / grid, 2.0 * tilt / grid / radius**2
    common = 1.0 / (grid * len(balls))  # of u_z rho and v_z, the mean of all centres
    pairs = np.empty((3, 2, 2), dtype=np.complex128)
    pairs[:2], pairs[2] = table[:, :2, :2], cmm[PLANE]
    along = np.array([table[AXIS, 2, 2], table[PLANE, 2, 2], cmm[AXIS, 0, 0]]).real
    fields = np.sqrt(np.einsum("fnii->fni", _turned(pairs, along, turn * turn)))
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


def _turned(pairs: Complexes, along: Floats, turn: Complexes) -> Floats:
    """Return the covariances (f, n, 3, 3) of f vectors at n angles each in the fixed frame.

    ``pairs`` (f, 2, 2) are the covariances of (w+, w-) in the turning frame at lag 0, ``along``
    (f,) the variances of z, ``turn`` (n,) or (f, n) the phases exp(2 i angle): the mean of the
    variances of x and y is the same everywhere, their difference turns at twice the angle.
    """
    mean = 0.5 * (pairs[:, 0, 0] + pairs[:, 1, 1]).real
    swing = pairs[:, 0, 1, None] * turn
    covariances = np.zeros((*swing.shape, 3, 3))
    covariances[..., 0, 0] = mean[:, None] + swing.real
    covariances[..., 1, 1] = mean[:, None] - swing.real
    covariances[..., 0, 1] = covariances[..., 1, 0] = swing.imag
    covariances[..., 2, 2] = along[:, None]
    return covariances


def _fitted_at_ball(system: Harmonics, ball: int) -> Complexes:
    """Return what the table takes of the noise of a ball, (2, 2, 2), at lag 0."""
    # the design at the CMM, its mean over the balls taken off
    rows = _design(system.phase[:, ball]) - system.mean
    carried = np.einsum("bqik,bqkl->bqil", rows, system.inverse)
    return _zero_lag(np.einsum("bqil,bqjl->bqij", carried, rows.conj()), system.grid)


def _weights(name: str, radius: float, grid: int) -> tuple[int, list[tuple[int, Floats]]]:
    """Return the block of a component and its unknowns in the turning frame, with weights (N,)."""
    scale = 1.0 / radius if name in ROTATIONS else 1.0
    block = PLANE if name in ("EXC", "EYC", "ECC") else AXIS
    angles = grid_angles(grid)
    cos, sin = scale * np.cos(angles), scale * np.sin(angles)
    if name in ("EXC", "EAC"):
        return block, [(0, cos), (1, -sin)]
    if name in ("EYC", "EBC"):
        return block, [(0, sin), (1, cos)]
    return block, [(2, np.full_like(angles, scale))]


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
    _require_square(problem)
    radius, offsets, place = problem.radius, problem.deviations, _places(problem.grid)
    if not nominal_radius:
        x, y, _ = offsets.T.reshape(3, problem.grid, problem.grid)
        radius += float(np.mean(x * np.cos(place) + y * np.sin(place)))  # Eq. 12
    translation, rotation = _means(offsets, radius)
    return ClosedForm(translation, rotation, radius, _std_of_means(problem.grid, radius))


class ClosedFormFit(SpectralFit):
    """All N x N centres by the means of the closed form, in place of the harmonics.

    The answer is the same but for rounding; plate and CMM errors, residuals and covariances are
    those of :class:`SpectralFit`. Raises PlanError when the grid is not complete.
    """

    way = "closed form"

    def __init__(self, problem: BallPlateProblem) -> None:
        _require_square(problem)
        super().__init__(problem)

    def fit(self, observed: Floats) -> tuple[PlateParameters, Floats]:
        """Return parameters and residuals (n, 3) of deviations (n, 3) of the rows, metres."""
        found, residuals = super().fit(observed)
        translation, rotation = _means(observed, self.problem.radius)
        return replace(found, translation=translation, rotation=rotation), residuals


def _require_square(problem: BallPlateProblem) -> None:
    grid = problem.grid
    if not problem.complete or len(problem.balls) != grid:
        raise PlanError(
            f"the closed form needs {grid} balls at {grid} table positions, all {grid * grid} "
            f"centres once; found {len(problem.centres)} centres of {len(problem.balls)} balls"
        )


def _places(grid: int) -> Floats:
    """Return the angle (N, N) at which ball j stands at table position i, rad."""
    angles = grid_angles(grid)
    return np.asarray(angles[:, None] + angles)


def _means(deviations: Floats, radius: float) -> tuple[Floats, Floats]:
    """Return translation (N, 3) m and rotation (N, 3) rad from deviations (N N, 3), m.

    The nominal circle has no part in the means: without it nothing is lost to rounding.
    """
    grid = math.isqrt(len(deviations))
    offsets = deviations.reshape(grid, grid, 3)  # ball, table position, coordinate
    angles, place = grid_angles(grid), _places(grid)
    x, y, z = np.moveaxis(offsets, 2, 0)
    shift = offsets.mean(axis=0) - offsets.mean(axis=(0, 1))  # Eq. 4, 5 and z of Eq. 3
    turn = np.stack(
        [
            2.0 / radius * np.mean(z * np.sin(place), axis=0),  # Eq. 9
            -2.0 / radius * np.mean(z * np.cos(place), axis=0),  # Eq. 10
            np.mean(y * np.cos(place) - x * np.sin(place), axis=0) / radius,  # Eq. 11
        ],
        axis=1,
    )
    return (
        _without_first_harmonic(shift, angles),
        _without_first_harmonic(turn - turn.mean(axis=0), angles),
    )


def _without_first_harmonic(sequence: Floats, angles: Floats) -> Floats:
    """Take the part off x, y that turns with the table: shift and tilt of the plate.

    Eq. 1, 2, 6, 7.
    """
    phase = np.exp(1j * angles)
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
