"""Whether balls and positions separate table, plate and CMM; if not, what is lost, in words.

Three balls at every table position and a common divisor of 1 (Eq. 22) are necessary; the
eigenvalues of each harmonic show whether they are enough, and for incomplete measurements the null
space of the whole model.

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

from dataclasses import dataclass, replace
from math import gcd
from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Bools, Complexes, Floats, Ints
from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.foundation.errors import ObservabilityError
from rotcal_ros.foundation.language import Phrase, join_texts, noted, phrase
from rotcal_ros.methods.ball_plate.solver.layout import PlateLayout
from rotcal_ros.methods.ball_plate.solver.problem import BallPlateProblem, grid_angles

WEAKLY_SEPARATED: Final = noted("only weakly separated: {0}")

MIN_BALLS = 3
"""Balls that a table position needs: two leave the rotation about their line open."""
TOLERANCE = 1e-9
"""Eigenvalues below this, relative to the number of balls, count as zero."""
WEAK = 1e-3
"""Eigenvalues below this make a harmonic weak: its standard deviation is 30 times larger."""
MAX_DENSE = 2500
"""Unknowns up to which an incomplete measurement is searched for the harmonics it loses."""

PLANE, AXIS = 0, 1
ROOT_HALF: Final = float(np.sqrt(0.5))
# Harmonic q of w+, w-, s in the turning frame is harmonic q + 1, q - 1, q in the fixed frame.
_COMPONENTS = (
    (("EXC, EYC", 1), ("EXC, EYC", -1), ("ECC", 0)),
    (("EAC, EBC", 1), ("EAC, EBC", -1), ("EZC", 0)),
)


@dataclass(frozen=True)
class Separability:
    """Outcome: ``common_divisor`` of Eq. 22, rank deficit, and the lost and weak harmonics.

    ``lost`` and ``weak`` map component names to ascending harmonic numbers (0..N//2).
    """

    common_divisor: int
    deficit: int
    lost: dict[str, tuple[int, ...]]
    weak: dict[str, tuple[int, ...]]

    @property
    def separable(self) -> bool:
        """Whether all parameters are determined."""
        return self.deficit == 0

    def sentences(self) -> tuple[Phrase, ...]:
        """Return the findings in words, nothing when all is well."""
        found = []
        if self.common_divisor > 1:
            found.append(
                phrase(
                    "all distances between balls share the factor {0} with the grid, "
                    "which splits the positions into {1} groups without a connection (Eq. "
                    "22)",
                    self.common_divisor,
                    self.common_divisor,
                )
            )
        if self.lost:
            found.append(
                phrase(
                    "cannot be separated from plate and CMM: {0}; choose ball steps "
                    "without a common factor, or more balls",
                    _spell(self.lost),
                )
            )
        if self.weak:
            found.append(phrase(WEAKLY_SEPARATED, _spell(self.weak)))
        return tuple(found)


def common_divisor(grid: int, balls: Ints) -> int:
    """Return gcd(j2 - j1, ..., jR - j1, N) of Eq. 22; 1 is necessary, and enough for R >= 5."""
    return gcd(grid, *(int(ball - balls[0]) for ball in balls))


def separability(grid: int, balls: Ints) -> Separability:
    """Judge a layout of balls (steps) that is measured at all CMM positions."""
    balls = np.unique(balls)
    sums = phase_factors(grid, balls).sum(axis=1)
    values, vectors = np.linalg.eigh(normal_matrices(sums, len(balls)))
    lost, weak = values < TOLERANCE * len(balls), values < WEAK * len(balls)
    return Separability(
        common_divisor=common_divisor(grid, balls),
        # of real unknowns a complex one has two, at the Nyquist harmonic one
        deficit=int(2 * lost.sum() - (grid % 2 == 0) * lost[:, -1].sum()),
        lost=_by_component(grid, lost, vectors),
        weak=_by_component(grid, weak & ~lost, vectors),
    )


def separability_of(problem: BallPlateProblem) -> Separability:
    """Judge the centres of a problem, complete or with gaps.

    The lost harmonics of incomplete data come from the null space of the whole model; beyond
    ``MAX_DENSE`` unknowns only the layout of the balls is judged.
    """
    layout = separability(problem.grid, problem.balls)
    if problem.complete or PlateLayout(problem).unknowns > MAX_DENSE:
        return layout
    lost, deficit = _lost_of_dense(problem)
    return replace(layout, deficit=deficit, lost=lost, weak={} if deficit else layout.weak)


def require_separable(problem: BallPlateProblem) -> None:
    """Raise ObservabilityError that says in words what is lost, if anything is."""
    found = separability_of(problem)
    if not found.separable:
        raise ObservabilityError(
            f"{len(problem.balls)} balls at steps {problem.balls.tolist()} of {problem.grid}, "
            f"{len(problem.cmm_positions)} CMM positions: " + "; ".join(found.sentences())
        )


def balls_at_positions(problem: BallPlateProblem) -> Ints:
    """Return how many different balls were measured at every table position, (n_positions,)."""
    once = np.diff(problem.cell, prepend=-1) != 0  # in canonical order doubles are neighbours
    return np.bincount(problem.position[once], minlength=problem.n_positions)


def require_balls(problem: BallPlateProblem, *, everywhere: bool = False) -> None:
    """Raise ObservabilityError that names the table positions with fewer than three balls.

    ``everywhere`` includes those without any; else they are no part of the problem.
    """
    count = balls_at_positions(problem)
    poor = np.flatnonzero((count < MIN_BALLS) & ((count > 0) | everywhere))
    if len(poor):
        shown = ", ".join(f"{i} ({count[i]})" for i in poor[:10])
        raise ObservabilityError(
            f"at {len(poor)} table positions fewer than {MIN_BALLS} balls are left, the six "
            f"errors there are open: position (balls) {shown}; measure more balls there"
        )


def phase_factors(grid: int, balls: Ints) -> Complexes:
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


def harmonic_multiplicity(grid: int) -> Floats:
    """How often the harmonics q = 1..N//2 occur with both signs; Nyquist has no twin."""
    twice = np.full(grid // 2, 2.0)
    twice[-1] = 1.0 + grid % 2
    return twice


def _by_component(grid: int, chosen: Bools, vectors: Complexes) -> dict[str, tuple[int, ...]]:
    """Return the harmonics that take part in the chosen eigenvectors (2, Q, 3)."""
    found: dict[str, set[int]] = {}
    for block, q, column in np.argwhere(chosen):
        share = np.abs(vectors[block, q, :, column])
        for part in np.flatnonzero(share > 1e-3):
            name, offset = _COMPONENTS[block][part]
            harmonic = (q + 1 + offset) % grid  # the systems start at q = 1
            found.setdefault(name, set()).add(int(min(harmonic, grid - harmonic)))
    return {name: tuple(sorted(found[name])) for name in sorted(found)}


def _lost_of_dense(problem: BallPlateProblem) -> tuple[dict[str, tuple[int, ...]], int]:
    """Return the harmonics in the null space of model and constraints, and its dimension."""
    layout = PlateLayout(problem)
    stacked = np.vstack([layout.rows.toarray(), layout.definitions])
    values, vectors = np.linalg.eigh(stacked.T @ stacked)
    null = vectors[:, values < TOLERANCE * values[-1]]
    every = (layout.curves() @ null).reshape(6, layout.counts[0], null.shape[1])
    found: dict[str, tuple[int, ...]] = {}
    for name, sequences in zip(COMPONENTS, every, strict=True):
        # of both sides the first
        share = np.abs(np.fft.rfft(sequences[: problem.grid], axis=0)).max(axis=1, initial=0.0)
        present = np.flatnonzero(share > 1e-6 * np.sqrt(problem.grid))
        if len(present):
            found[name] = tuple(int(q) for q in present)
    return found, null.shape[1]


def _spell(parts: dict[str, tuple[int, ...]]) -> Phrase:
    single, several = noted("harmonic {0} of {1}"), noted("harmonics {0} of {1}")
    return join_texts(
        [phrase(several if len(q) > 1 else single, _ranges(q), n) for n, q in parts.items()]
    )


def _ranges(numbers: tuple[int, ...]) -> str:
    """Write 1, 2, 3, 7 as '1-3, 7'."""
    groups: list[list[int]] = []
    for number in numbers:
        if groups and number == groups[-1][-1] + 1:
            groups[-1].append(number)
        else:
            groups.append([number])
    return ", ".join(str(g[0]) if len(g) == 1 else f"{g[0]}-{g[-1]}" for g in groups)
