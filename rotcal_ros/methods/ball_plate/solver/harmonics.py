"""What a ball layout makes of each harmonic: the normal matrices of a complete plate.

In the frames of :mod:`.layout` the discrete Fourier transform over the CMM positions splits the
least squares of a complete plate into small systems. A plane vector is held as
w+ = (w_x + i w_y)/sqrt 2 and w- = (w_x - i w_y)/sqrt 2: then all coefficients are phases, and with
the CMM eliminated two Hermitian 3 x 3 matrices are left of each harmonic q, the PLANE
(d+, d-, rho c_z) and the AXIS (rho c+, rho c-, d_z). They hold nothing but the sums P(q) of the
phases over the R balls, so that the choice of balls costs microseconds. With
P(q) = sum_j exp(-2 pi i q j / N) the first is

    R - |P(q+1)|^2/R        0                     (i/sqrt 2) X*
    .                       R - |P(q-1)|^2/R     -(i/sqrt 2) Z
    .                       .                     R - |P(q)|^2/R

    X = P(1) - P(q+1) P(q)*/R,     Z = P(1) - P(q-1)* P(q)/R

and the second has half of the first two diagonals, the same couplings to d_z, and
-1/2 (P(2) - P(q+1) P(q-1)*/R)* between c+ and c-.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Complexes, Floats, Ints
from rotcal_ros.methods.ball_plate.solver.problem import grid_angles

PLANE, AXIS = 0, 1
ROOT_HALF: Final = float(np.sqrt(0.5))


def phases(grid: int, balls: Ints) -> Complexes:
    """Return exp(-2 pi i q j / N), (N//2 + 2, R), for q = 0 .. N//2 + 1."""
    turn = np.exp(-1j * grid_angles(grid))
    powers: Complexes = turn[np.outer(np.arange(grid // 2 + 2), balls) % grid]
    return powers


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


def multiplicity(grid: int) -> Floats:
    """How often the harmonics q = 1..N//2 occur with both signs; Nyquist has no twin."""
    twice = np.full(grid // 2, 2.0)
    twice[-1] = 1.0 + grid % 2
    return twice
