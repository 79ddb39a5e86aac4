"""Predicted uncertainty of ball layouts: closed form per harmonic, many layouts at once.

With P(q) = sum over the balls of exp(-2 pi i q j / N) the normal matrices of a harmonic (see
rotcal_ros.methods.ball_plate.solver.harmonics) are 3 x 3 with entries made of P at q - 1, q, q + 1
and of P(1), P(2): their inverse is written out, so a layout costs one short transform and a few
hundred operations. Complete measurements (all CMM positions) only.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Bools, Complexes, Floats, Ints
from rotcal_ros.methods.ball_plate.solver.harmonics import couplings, multiplicity

SINGULAR: Final = 1e-7
"""Relative determinant below which a layout counts as not separable."""
CHUNK: Final = 256  # keeps the work in the processor cache


def mean_variances(grid: int, layouts: Ints) -> Floats:
    """Return the mean variances (L, 4) of layouts (L, R) for unit noise; inf if not separable.

    Mean over the table positions and, for pairs, over x and y: ECC; EXC, EYC; EAC, EBC; EZC.
    Multiply by sigma^2, and divide those of rotations by the squared radius.
    """
    layouts = np.atleast_2d(layouts)
    variances = np.empty((len(layouts), 4))
    for start in range(0, len(layouts), CHUNK):
        part = layouts[start : start + CHUNK]
        variances[start : start + CHUNK] = _variances(spectrum(grid, part), grid, part.shape[1])
    return variances


def spectrum(grid: int, layouts: Ints) -> Complexes:
    """Return P(q) of layouts (L, R) for q = 0 .. N//2 + 1, (L, N//2 + 2)."""
    present = np.zeros((len(layouts), grid))
    present[np.arange(len(layouts))[:, None], layouts] = 1.0
    half = np.fft.rfft(present)
    beyond = half[:, grid - grid // 2 - 1].conj()  # P(N//2 + 1), by symmetry
    extended: Complexes = np.concatenate([half, beyond[:, None]], axis=1)
    return extended


def proven_bound(grid: int, n_balls: int) -> Floats:
    """Return what no layout of so many balls can beat, (4,), ordered as :func:`mean_variances`.

    The sum of |P(q)|^2 over all q is N R (Parseval) and the diagonal terms are convex in it, so
    spreading it evenly is best (Jensen); the couplings between unknowns only add variance.
    """
    power = grid * n_balls - n_balls**2
    each = (grid - 1) / grid / (n_balls - power / (grid - 1) / n_balls)
    # The pair meets P(-1) but not P(1), which have the same size: some more power there is best.
    others = grid - 3
    first = ((np.sqrt(2.0) - 1.0) * n_balls**2 + power / others) / (np.sqrt(2.0) + 2.0 / others)
    first = min(first, 0.5 * power)
    rest = (power - 2.0 * first) / others
    pair = 1.0 / (n_balls - first / n_balls) + others / (n_balls - rest / n_balls)
    return np.array([each, pair / grid, 2.0 * pair / grid, each])


def _variances(sums: Complexes, grid: int, n_balls: int) -> Floats:
    """Evaluate the inverses (L, 4) from P (L, N//2 + 2)."""
    diagonal, up, down, across = couplings(sums, n_balls)
    lower, middle, upper = diagonal[:, :-2], diagonal[:, 1:-1], diagonal[:, 2:]
    up_power, down_power = _power(up), _power(down)
    cross_power = _power(across)
    with np.errstate(divide="ignore", invalid="ignore"):
        up_share, down_share = 0.5 * up_power / upper, 0.5 * down_power / lower
        turn = 1.0 / (middle - up_share - down_share)
        plane_up, plane_down = (1.0 + up_share * turn) / upper, (1.0 + down_share * turn) / lower
        determinant = (
            middle * (upper * lower - cross_power)
            - upper * down_power
            - lower * up_power
            + 2.0 * (across.conj() * up * down).real
        )
        tilt_up = 2.0 * (lower * middle - down_power) / determinant
        tilt_down = 2.0 * (upper * middle - up_power) / determinant
        height = (upper * lower - cross_power) / determinant
    bad = _singular(upper, lower, middle, turn, determinant, n_balls)
    plane_down[:, 0] = tilt_down[:, 0] = 0.0
    twice = multiplicity(grid) / grid
    result = np.stack(
        [
            turn @ twice,
            0.5 * (plane_up + plane_down) @ twice,
            0.5 * (tilt_up + tilt_down) @ twice,
            height @ twice,
        ],
        axis=1,
    )
    result[bad] = np.inf
    return result


def _power(values: Complexes) -> Floats:
    power: Floats = values.real**2 + values.imag**2
    return power


def _singular(
    upper: Floats, lower: Floats, middle: Floats, turn: Floats, determinant: Floats, n_balls: int
) -> Bools:
    """Layouts (L,) with a harmonic whose systems are singular to rounding."""
    small = SINGULAR * n_balls
    smallest = np.minimum(np.minimum(upper, lower), middle).min(axis=1) < small
    plane = ~((turn > 0.0) & (turn * small < 1.0)).all(axis=1)
    axis = ~(determinant > SINGULAR * n_balls**3).all(axis=1)
    bad: Bools = smallest | plane | axis
    return bad
