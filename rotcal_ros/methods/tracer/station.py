"""Station by station: the tracer's places from known targets, all in one vectorised solve.

Laser tracer paper, section 3.1 (Eq. 5-17): Levenberg-Marquardt with the paper's damping rule and
line search on four unknowns (X, Y, Z, d) per station. The stations share the targets and hence
the targets' errors; their joint covariance keeps that, because errors common to all stations
largely cancel in the angle.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from rotcal_ros.errors import DataError
from rotcal_ros.methods.tracer.adjustment import Adjustment, StationCovariance, ranges
from rotcal_ros.methods.tracer.grid import Grid
from rotcal_ros.methods.tracer.observability import check_station_rank

Floats = NDArray[np.float64]

BETA: Final = 0.55
SIGMA: Final = 0.4
"""Line search constants of the paper, section 4.2.1."""
EPSILON: Final = 1e-7
"""Last step of the damped search, metres: the paper's 1e-4 mm."""
POLISHED: Final = 1e-11
"""Last step of the undamped iteration that follows, metres."""
MAX_ITERATIONS: Final = 100
ROUNDING: Final = 1e-14
"""Relative change of the objective that is rounding, not information."""


def locate_stations(
    targets: Floats, length: Floats, weights: Floats, start: Floats
) -> tuple[Floats, NDArray[np.bool_]]:
    """Return (X, Y, Z, d) of all stations (m, 4), and which have settled (m,); Eq. 5-17.

    ``targets`` (n, 3), ``length`` and ``weights`` (m, n; weight zero for a missing length),
    ``start`` (m, 4), in metres. Weights count relative to the largest one, so that objective
    and first damping mu = |f(x_0)| keep the paper's dimension, a length.

    Slip of Eq. 11-14: the line search is printed once per coordinate; it is one search along h,
    and it is the objective F of Eq. 6 that has to fall. The paper stops when the step is below
    1e-4 mm; undamped steps follow here until 1e-11 m, so that damping leaves no trace.
    """
    root = np.sqrt(weights / weights.max())
    state, active = start.copy(), np.ones(len(start), dtype=np.bool_)
    f, jacobian = _errors(state, targets, length, root)
    objective = _half_square(f)
    damping = np.sqrt(2.0 * objective)
    for _ in range(MAX_ITERATIONS):
        normal, gradient = _normal_equations(jacobian, f)
        h = -np.linalg.solve(normal + damping[:, None, None] * np.eye(4), gradient)[:, :, 0]
        slope = (h * gradient[:, :, 0]).sum(axis=1)
        # Eq. 15, with (N + mu) h = -g put in: h'g + h'N h / 2 = (h'g - mu h'h) / 2
        predicted = 0.5 * (slope - damping * (h * h).sum(axis=1))
        h *= active[:, None]
        state, f, jacobian, fallen, gain = _search(
            state, h, objective, slope, predicted, (targets, length, root)
        )
        objective = fallen
        active &= np.abs(h).max(axis=1) > EPSILON
        if not active.any():
            break
        damping *= np.where(gain > 0.75, 0.1, np.where(gain < 0.25, 10.0, 1.0))
    return _polish(state, f, jacobian, (targets, length, root)), ~active


def _search(
    state: Floats,
    h: Floats,
    objective: Floats,
    slope: Floats,
    predicted: Floats,
    data: tuple[Floats, Floats, Floats],
) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """Go along ``h`` by the largest power of beta that lets F fall enough (Eq. 11-14).

    Returns the new state with its errors, Jacobian and objective, and the gain ratio of the full
    step (Eq. 16).
    """
    slack = ROUNDING * objective
    trial = state + h
    f, jacobian = _errors(trial, *data)
    fallen = _half_square(f)
    certain = -predicted > slack
    gain = np.where(certain, (fallen - objective) / np.where(certain, predicted, 1.0), 1.0)
    step = np.ones(len(h))
    for _ in range(60):
        short = fallen > objective + SIGMA * step * slope + slack
        if not short.any():
            break
        step[short] *= BETA
        trial = state + step[:, None] * h
        f, jacobian = _errors(trial, *data)
        fallen = _half_square(f)
    return trial, f, jacobian, fallen, gain


def _polish(
    state: Floats, f: Floats, jacobian: Floats, data: tuple[Floats, Floats, Floats]
) -> Floats:
    """Finish with undamped Gauss-Newton steps, where the targets determine the station."""
    for _ in range(8):
        normal, gradient = _normal_equations(jacobian, f)
        h: Floats = np.linalg.solve(normal + np.finfo(float).eps * np.eye(4), gradient)[:, :, 0]
        largest = np.abs(h).max(axis=1)
        # a step beyond the damped search's last one means a station that is not determined
        state = state - np.where(largest > 1e3 * EPSILON, 0.0, 1.0)[:, None] * h
        if not ((largest > POLISHED) & (largest <= 1e3 * EPSILON)).any():
            break
        f, jacobian = _errors(state, *data)
    return state


def _errors(state: Floats, targets: Floats, length: Floats, root: Floats) -> tuple[Floats, Floats]:
    """Return f (m, n) of Eq. 5, computed - observed, and its Jacobian (m, n, 4), weighted."""
    difference = state[:, None, :3] - targets
    distance = np.sqrt(np.einsum("jia,jia->ji", difference, difference))
    jacobian = np.empty((*length.shape, 4))
    np.multiply(difference, (root / distance)[:, :, None], out=jacobian[:, :, :3])
    np.negative(root, out=jacobian[:, :, 3])
    return (distance - state[:, 3:] - length) * root, jacobian


def _half_square(f: Floats) -> Floats:
    return np.asarray(0.5 * np.einsum("ji,ji->j", f, f), dtype=np.float64)


def _normal_equations(jacobian: Floats, f: Floats) -> tuple[Floats, Floats]:
    transposed = jacobian.swapaxes(1, 2)
    return transposed @ jacobian, transposed @ f[:, :, None]


def adjust_stations(grid: Grid, start: Floats) -> Adjustment:
    """Return the stations that fit the lengths of ``grid`` best, from ``start`` (m, 4).

    The targets stay where the machine says. A length is weighted by the variance of its noise plus
    that of its target along the beam: within one station the targets' errors are independent.

    Raises ObservabilityError when the targets leave a direction of a station open, DataError when a
    station does not settle.
    """
    _, unit = ranges(start[:, :3], grid.targets)
    variance = grid.length_std**2 + np.einsum("jia,ia->ji", unit**2, grid.target_std**2)
    weights = grid.used / variance
    state, settled = locate_stations(grid.targets, grid.length, weights, start)
    distance, unit = ranges(state[:, :3], grid.targets)
    design = np.concatenate([unit, -np.ones((*distance.shape, 1))], axis=2)
    check_station_rank(design * grid.used[:, :, None], grid.station_ids)
    if not settled.all():
        worst = grid.station_ids[np.flatnonzero(~settled)[0]]
        raise DataError(
            f"station {worst} does not settle in {MAX_ITERATIONS} iterations: its lengths do not "
            "fit the targets; check the order of the targets and the sign of the lengths"
        )
    whitened = design * np.sqrt(weights)[:, :, None]
    inverse = np.linalg.inv(whitened.swapaxes(1, 2) @ whitened)
    leverage = np.einsum("jia,jia->ji", whitened @ inverse, whitened)
    residual = grid.length - (distance - state[:, 3:])
    n_lengths, unknowns = int(grid.used.sum()), 4 * len(state)
    return Adjustment(
        stations=state[:, :3],
        distances=state[:, 3],
        targets=grid.targets,
        residual=residual,
        std=np.sqrt(variance),
        redundancy=grid.used * (1.0 - leverage),
        chi2=float((weights * residual**2).sum()),
        dof=n_lengths - unknowns,
        unknowns=unknowns,
        rank=unknowns,
    )


def stations_covariance(grid: Grid, fit: Adjustment) -> StationCovariance:
    """Return the joint covariance of all stations: own noise, and the common target errors."""
    m = len(fit.stations)
    _, unit = ranges(fit.stations, grid.targets)
    weights = grid.used / fit.std**2
    design = np.concatenate([unit, -np.ones((*fit.std.shape, 1))], axis=2)
    weighted = design * weights[:, :, None]
    inverse = np.linalg.inv(design.swapaxes(1, 2) @ weighted)
    gain = (weighted @ inverse)[:, :, :3]  # (m, n, 3): d station / d length
    own = np.zeros((m, 3, m, 3))
    own[np.arange(m), :, np.arange(m)] = gain.swapaxes(1, 2) @ (
        gain * (grid.length_std**2)[:, :, None]
    )
    felt = unit * grid.target_std  # (m, n, 3): what a standard target error does to a length
    common = np.einsum("jia,jic->jaic", gain, felt).reshape(3 * m, -1)
    return StationCovariance(
        lengths=own.reshape(3 * m, 3 * m),
        targets=common @ common.T,
        dof_effective=_effective_dof(
            design * np.sqrt(weights)[:, :, None], felt * np.sqrt(weights)[:, :, None], fit.dof
        ),
    )


def _effective_dof(whitened: Floats, felt: Floats, dof: int) -> float:
    """Return the degrees of freedom of the chi-squared sum, whose stations are correlated.

    ``whitened`` (m, n, 4) is the design, ``felt`` (m, n, 3) the targets' standard errors, both in
    standard deviations of the lengths. Welch-Satterthwaite: 2 mean^2 / variance, where the variance
    of the sum is 2 sum_jk tr(R_j D_jk R_k D_jk), D_jk the correlation of lengths to one
    target from two stations and R the projection on the residuals of a station.
    """
    if not felt.any():
        return float(dof)
    factor = np.linalg.cholesky(whitened.swapaxes(1, 2) @ whitened)
    basis = np.linalg.solve(factor, whitened.swapaxes(1, 2))  # (m, 4, n), orthonormal rows
    leverage = (basis**2).sum(axis=1)
    total = 0.0
    for j in range(len(basis)):
        shared = np.einsum("ic,kic->ki", felt[j], felt)
        shared[j] = 0.0
        overlap = (basis[j] * shared[:, None, :]) @ basis.swapaxes(1, 2)
        total += float((shared**2 * (1.0 - leverage[j] - leverage)).sum() + (overlap**2).sum())
    return dof**2 / (dof + total)
