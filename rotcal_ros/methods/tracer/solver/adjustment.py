"""What an adjustment of lengths returns; and the simplest one: station by station.

Laser tracer paper, section 3.1 (Eq. 5-17): the targets are known, and each station has four
unknowns (X, Y, Z, d). All stations are solved at once, by undamped Gauss-Newton steps as long as
these contract (:func:`contract`), else by Levenberg-Marquardt with the paper's damping rule and
line search (:func:`locate_damped`). From a fair start undamped steps converge quadratically, and
damping and line search only cost time. The normal equations lose digits of a step, not of the
answer: that is where the gradient of the residuals vanishes, which each step works out anew in
full precision.

The stations share the targets and hence the targets' errors; their joint covariance keeps that,
because errors common to all stations largely cancel in the angle.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Final, Protocol

import numpy as np

from rotcal_ros.adjust.low_rank import LowRank
from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.methods.tracer.solver.grid import Grid
from rotcal_ros.methods.tracer.solver.observability import check_station_rank

if TYPE_CHECKING:
    from rotcal_ros.methods.tracer.solver.network import Network

MINIMAL_REDUNDANCY: Final = 1e-6
"""Below this share a length is checked by nothing: its test value is zero."""
BETA: Final = 0.55
SIGMA: Final = 0.4
"""Line search constants of the paper, section 4.2.1."""
EPSILON: Final = 1e-5
"""Step (m) at which undamped steps, which converge quadratically, take over."""
POLISHED: Final = 1e-11
"""Step (m) that no longer needs to be done; the paper stops at 1e-4 mm."""
MAX_ITERATIONS: Final = 100
"""Damped steps after which a station is said not to settle."""
FAIR: Final = 1.0
"""Length (m) that the first step is compared with, as the others are with the one before."""
CONTRACTION: Final = 0.5
"""Share of the step before that a step may have; else the start was too far away."""
SETTLED: Final = 1e-13
"""Step (m) that no longer needs to be done."""
MAX_STEPS: Final = 12
"""Undamped steps after which a station is left to the damped ones."""


@dataclass(frozen=True, eq=False)
class Adjustment:
    """Stations, distances and targets that fit the lengths of a grid, and how well they do.

    ``stations`` (m, 3), ``distances`` (p,): the range of a strip at reading zero, ``targets``
    (n, 3), metres; m stations have p strips, see :class:`~.grid.Grid`.
    ``residual`` (p, n): observed - computed (the paper's v of Eq. 3 is computed - observed), also
    of lengths that were not used. ``std`` (p, n): standard deviation of a length as this
    variant sees it; ``redundancy`` (p, n): share of a length that the others check, zero if
    unused. ``chi2`` has mean ``dof``. ``unknowns`` counts the columns of the design matrix,
    ``rank`` those that the data determine.

    Where the targets' coordinates are observations too: ``corrections`` (n, 3) in their standard
    deviations, ``target_redundancy`` (n, 3), ``coupling`` (3, 3): squared sums of the redundancy
    matrix by pairs of axes, and ``target_test`` (n,): the largest normalised correction of a
    target. Else all zero. ``circle_coupling`` (4,): the same sums of a stated circle with the
    targets' axes, and with the lengths. ``network``: the linearisation at this very place, if
    there is one.
    ``strip_station`` (p,): station of each strip; None: strips are stations.
    """

    stations: Floats
    distances: Floats
    targets: Floats
    residual: Floats
    std: Floats
    redundancy: Floats
    chi2: float
    dof: int
    unknowns: int
    rank: int
    target_test: Floats
    corrections: Floats
    target_redundancy: Floats
    coupling: Floats
    network: Network | None = None
    strip_station: Ints | None = None
    circle_coupling: Floats = field(default_factory=lambda: np.zeros(4))

    @property
    def standing(self) -> Floats:
        """Where the station of each strip is, (p, 3)."""
        return self.stations if self.strip_station is None else self.stations[self.strip_station]

    @property
    def state(self) -> Floats:
        """Stations and distances of all strips as (p, 4), the start of the next solve."""
        return np.column_stack([self.standing, self.distances])

    @property
    def test_value(self) -> Floats:
        """Normalised residuals (p, n): residual over its own standard deviation."""
        checked = self.redundancy > MINIMAL_REDUNDANCY
        spread = self.std * np.sqrt(np.where(checked, self.redundancy, 1.0))
        return np.where(checked, self.residual / spread, 0.0)

    def unchecked(self, grid: Grid) -> int:
        """Return how many lengths of ``grid`` are used that no other checks."""
        return int((grid.used & (self.redundancy <= MINIMAL_REDUNDANCY)).sum())


class Adjuster(Protocol):
    """An adjustment of a grid from stations and distances of its strips (p, 4)."""

    def __call__(self, grid: Grid, start: Floats, targets: Floats | None = None) -> Adjustment:
        """Adjust ``grid``; ``targets`` (n, 3) of a network that was solved nearly so before."""


@dataclass(frozen=True, eq=False)
class StationCovariance:
    """Covariance (3 m, 3 m) of the stations in m^2, by source, in blocks of stations.

    ``lengths``: noise of the lengths, ``targets``: errors of the machine's coordinates, common to
    all stations; ``sensitivity`` (3 m, n, 3): what a standard error of each coordinate does to the
    stations, m. ``circle``: by how much stations leave a stated circle; None: none is.
    ``dof_effective``: the chi-squared sum is distributed like ``dof / dof_effective`` times
    chi-squared of that many degrees of freedom.
    """

    lengths: LowRank
    targets: LowRank
    sensitivity: Floats
    dof_effective: float
    circle: LowRank | None = None

    @property
    def total(self) -> LowRank:
        """Return the covariance from all sources."""
        total = self.lengths + self.targets
        return total if self.circle is None else total + self.circle

    def enlarged(self, scale: float) -> StationCovariance:
        """Return the covariance of standard deviations ``scale`` times as large."""
        square = scale**2
        circle = None if self.circle is None else self.circle.scaled(square)
        return replace(
            self,
            lengths=self.lengths.scaled(square),
            targets=self.targets.scaled(square),
            circle=circle,
        )

    def position_blocks(self) -> Floats:
        """Return the 3 by 3 covariance of every station, shape (m, 3, 3)."""
        return self.total.diagonal_blocks()


def ranges(stations: Floats, targets: Floats) -> tuple[Floats, Floats]:
    """Return distances (m, n) and unit vectors (m, n, 3) from ``targets`` to ``stations``."""
    difference = stations[:, None, :] - targets
    distance = np.sqrt(np.einsum("jia,jia->ji", difference, difference))
    return distance, difference / distance[:, :, None]


def locate_stations(
    targets: Floats, length: Floats, weights: Floats, start: Floats
) -> tuple[Floats, Bools]:
    """Return (X, Y, Z, d) of all stations (m, 4), and which have settled (m,); Eq. 5-17.

    ``targets`` (n, 3), ``length`` and ``weights`` (m, n; weight zero for a missing length),
    ``start`` (m, 4), in metres. Undamped steps where they contract, the paper's
    Levenberg-Marquardt (:func:`locate_damped`) for the other stations; the minimum is the same.
    """
    state, settled = contract(targets, length, weights, start)
    if not settled.all():
        rest = ~settled
        state, parts = state.copy(), (length[rest], weights[rest], start[rest])
        state[rest], settled[rest] = locate_damped(targets, *parts)
    return state, settled


def locate_damped(
    targets: Floats, length: Floats, weights: Floats, start: Floats
) -> tuple[Floats, Bools]:
    """Return what :func:`locate_stations` returns by Levenberg-Marquardt alone.

    Weights count relative to the largest one, so that objective
    and first damping mu = |f(x_0)| keep the paper's dimension, a length.

    Slip of Eq. 11-14: the line search is printed once per coordinate; it is one search along h,
    and it is the objective F of Eq. 6 that has to fall - by more than its rounding error. The last
    steps are undamped, so that damping leaves no trace.
    """
    misfit = Misfit(targets, length, np.sqrt(weights / weights.max()))
    state, active = start.copy(), np.ones(len(start), dtype=np.bool_)
    products = misfit(state)
    damping = np.maximum(np.sqrt(products[:, 4, 4]), misfit.floor)
    # a range r carries a rounding error of r times eps into f, and twice sum(f df) into f'f
    reach = np.abs(start[:, 3:] + length).max()
    grain = 4.0 * np.finfo(np.float64).eps * reach * np.sqrt(length.shape[1])
    for _ in range(MAX_ITERATIONS):
        h, slope = _step(products, damping)
        squared = (h * h).sum(axis=1)
        before, products = products, misfit(state + h)
        # Eq. 15, with (N + mu) h = -g put in: h'g + h'N h / 2 = (h'g - mu h'h) / 2
        predicted = 0.5 * (slope - damping * squared)
        change = 0.5 * (products[:, 4, 4] - before[:, 4, 4])
        slack = grain * np.sqrt(before[:, 4, 4])
        short = active & (change > SIGMA * slope + slack)
        if short.any():
            h, products = _search(state, h, slope, slack, before[:, 4, 4], short, misfit)
        state += h
        active &= squared > EPSILON**2
        if not active.any():
            break
        # Eq. 16-17; a predicted change that is all rounding says nothing against the step
        seen = change - slack
        good, bad = seen < 0.75 * predicted, seen > 0.25 * predicted
        damping *= np.where(good, 0.1, np.where(bad, 10.0, 1.0))
        np.maximum(damping, misfit.floor, out=damping)
    return _polish(state, h, products, misfit), ~active


class Misfit:
    """Eq. 5 and its derivative at a state (m, 4): called, it returns [J f]'[J f], (m, 5, 5).

    That one product holds the normal matrix J'J, the gradient J'f (last column) and twice the
    objective f'f (last corner); f is computed - observed, every row multiplied by ``root``.
    ``floor`` (m,) is a damping that only a singular normal matrix feels.
    """

    def __init__(self, targets: Floats, length: Floats, root: Floats) -> None:
        m, n = length.shape
        self._targets, self._length, self._root = np.ascontiguousarray(targets.T), length, root
        self._rows = np.empty((m, 5, n))
        self._rows[:, 3] = -root
        self._slopes, self._errors = self._rows[:, :3], self._rows[:, 4]
        self._transposed = self._rows.swapaxes(1, 2)
        self.floor = 1e-13 * np.einsum("ji,ji->j", root, root)

    def __call__(self, state: Floats) -> Floats:
        """Return the products (m, 5, 5) at ``state`` (m, 4)."""
        slopes = self._slopes
        np.subtract(state[:, :3, None], self._targets, out=slopes)
        distance = np.sqrt(np.einsum("jai,jai->ji", slopes, slopes))
        slopes *= (self._root / distance)[:, None]
        distance -= state[:, 3:]
        distance -= self._length
        np.multiply(distance, self._root, out=self._errors)
        return np.asarray(self._rows @ self._transposed)


def _step(products: Floats, damping: Floats) -> tuple[Floats, Floats]:
    """Return h (m, 4) of Eq. 10 and the slope h'g (m,) of the objective along it."""
    normal = products[:, :4, :4].reshape(-1, 16)
    # every fifth of the 16 entries is on the diagonal
    normal[:, ::5] += damping[:, None]
    downhill = -products[:, :4, 4:]
    h = np.asarray(np.linalg.solve(normal.reshape(-1, 4, 4), downhill)[:, :, 0], dtype=np.float64)
    return h, -(h * downhill[:, :, 0]).sum(axis=1)


def _search(
    state: Floats,
    h: Floats,
    slope: Floats,
    slack: Floats,
    objective: Floats,
    short: Bools,
    misfit: Misfit,
) -> tuple[Floats, Floats]:
    """Shorten ``h`` where F does not fall enough by powers of beta until it does (Eq. 11-14).

    ``objective`` is twice F. Returns the shortened steps and the products at their ends.
    """
    step = np.ones(len(h))
    for _ in range(60):
        step[short] *= BETA
        products = misfit(state + step[:, None] * h)
        fallen = 0.5 * (products[:, 4, 4] - objective)
        short = short & (fallen > SIGMA * step * slope + slack)
        if not short.any():
            break
    return step[:, None] * h, products


def _polish(state: Floats, last: Floats, products: Floats, misfit: Misfit) -> Floats:
    """Finish with undamped steps, after the damped step ``last`` (m, 4).

    A step that is not small tells a station that the targets do not determine; it stays.
    Convergence is at least linear: the step to come is foreseen from the last two.
    """
    before = np.abs(last).max(axis=1)
    for _ in range(8):
        h, _ = _step(products, misfit.floor)
        size = np.abs(h).max(axis=1)
        small = size < 100.0 * EPSILON
        state = state + small[:, None] * h
        if not (small & (size * size > POLISHED * before)).any():
            break
        before, products = size, misfit(state)
    return state


def adjust_stations(grid: Grid, start: Floats, targets: Floats | None = None) -> Adjustment:
    """Return the stations that fit the lengths of ``grid`` best, from ``start`` (m, 4).

    The targets stay where the machine says, whatever ``targets``. A length is weighted by the
    variance of its noise plus that of its target along the beam: within one station the targets'
    errors are independent.

    Raises ObservabilityError when the targets leave a direction of a station open, DataError
    when a station does not settle.
    """
    _, unit = ranges(start[:, :3], grid.targets)
    variance = grid.length_std**2 + np.einsum("jia,ia->ji", unit**2, grid.target_std**2)
    weights = grid.used / variance
    state, settled = locate_stations(grid.targets, grid.length, weights, start)
    distance, unit = ranges(state[:, :3], grid.targets)
    design = _station_rows(unit)
    check_station_rank(design * grid.used[:, :, None], grid.position_ids)
    if not settled.all():
        worst = grid.position_ids[np.flatnonzero(~settled)[0]]
        raise DataError(
            f"station {worst} does not settle in {MAX_ITERATIONS} iterations: its lengths do not "
            "fit the targets; check the order of the targets and the sign of the lengths"
        )
    # the diagonal of the hat matrix is what each length tells of itself; the rest checks it
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
        target_test=np.zeros(len(grid.targets)),
        corrections=np.zeros(grid.targets.shape),
        target_redundancy=np.zeros(grid.targets.shape),
        coupling=np.zeros((3, 3)),
    )


def _station_rows(unit: Floats) -> Floats:
    """Return the design (m, n, 4) of a station's X, Y, Z, d by unit vectors to it (m, n, 3)."""
    return np.concatenate([unit, -np.ones((*unit.shape[:2], 1))], axis=2)


def station_gain(grid: Grid, fit: Adjustment) -> Floats:
    """Return d station / d length (m, n, 3) of stations that are solved one by one."""
    _, unit = ranges(fit.stations, fit.targets)
    rows = _station_rows(unit)
    weighted = rows * (grid.used / fit.std**2)[:, :, None]
    gain = weighted @ np.linalg.inv(rows.swapaxes(1, 2) @ weighted)
    return np.asarray(gain[:, :, :3], dtype=np.float64)


def stations_covariance(grid: Grid, fit: Adjustment) -> StationCovariance:
    """Return the joint covariance of all stations: own noise, and the common target errors."""
    m = len(fit.stations)
    _, unit = ranges(fit.stations, grid.targets)
    gain = station_gain(grid, fit)
    root = np.sqrt(grid.used / fit.std**2)
    own = gain.swapaxes(1, 2) @ (gain * (grid.length_std**2)[:, :, None])
    sensitivity = unit * grid.target_std  # (m, n, 3): of a length to standard target errors
    common = np.einsum("jia,jic->jaic", gain, sensitivity).reshape(3 * m, -1)
    return StationCovariance(
        lengths=LowRank.of_blocks(own),
        targets=LowRank(np.zeros_like(own), common, np.eye(common.shape[1])).quick(),
        sensitivity=common.reshape(3 * m, -1, 3),
        dof_effective=_effective_dof(
            _station_rows(unit) * root[:, :, None], sensitivity * root[:, :, None], fit.dof
        ),
    )


def _effective_dof(whitened: Floats, target_errors: Floats, dof: int) -> float:
    """Return the degrees of freedom of the chi-squared sum, whose stations are correlated.

    ``whitened`` (m, n, 4) is the design, ``target_errors`` (m, n, 3) are the targets' standard
    errors, both in standard deviations of the lengths. Welch-Satterthwaite: 2 mean^2 / variance,
    where the variance of the sum is 2 sum_jk tr(R_j D_jk R_k D_jk), D_jk the correlation of
    lengths to one target from two stations and R the projection on the residuals of a station.
    """
    if not target_errors.any():
        return float(dof)
    factor = np.linalg.cholesky(whitened.swapaxes(1, 2) @ whitened)
    basis = np.linalg.solve(factor, whitened.swapaxes(1, 2))  # (m, 4, n), orthonormal rows
    leverage = (basis**2).sum(axis=1)[:, :, None]
    m = len(basis)
    # with e = target_errors: sum_jk |D_jk|^2 r_j is |sum_j e_j e_j'|^2, target by target
    squares = (target_errors[:, :, :, None] * target_errors[:, :, None, :]).reshape(
        *target_errors.shape[:2], 9
    )
    total = float((squares.sum(axis=0) * (squares * (1.0 - 2.0 * leverage)).sum(axis=0)).sum())
    total -= float((squares**2 * (1.0 - 2.0 * leverage)).sum())
    columns = basis.swapaxes(1, 2)[:, :, :, None] * target_errors[:, :, None, :]  # (m, n, 4, 3)
    columns = columns.transpose(0, 2, 1, 3).reshape(4 * m, -1)
    by_station = columns.reshape(m, 4, -1)
    total += float(((columns.T @ columns) ** 2).sum())  # of all pairs of stations
    total -= float(((by_station @ by_station.swapaxes(1, 2)) ** 2).sum())
    return dof**2 / (dof + total)


def contract(
    targets: Floats, length: Floats, weights: Floats, start: Floats
) -> tuple[Floats, Bools]:
    """Return (X, Y, Z, d) of all stations (m, 4), and for which of them (m,) the steps contract.

    Arguments as for :func:`locate_stations`; where the steps do not contract, the
    state is of no use.
    """
    m, n = length.shape
    points, root = np.ascontiguousarray(targets.T)[:, None], np.sqrt(weights)
    rows = np.empty((5, m, n))  # slopes along X, Y, Z and d, and the error f of Eq. 5
    slopes, errors = rows[:3], rows[4]
    np.negative(root, out=rows[3])
    by_station, transposed = rows.transpose(1, 0, 2), rows.transpose(1, 2, 0)
    state, contracts = start, np.ones(m, dtype=np.bool_)
    limit: Floats | float = CONTRACTION * FAIR
    settled: Floats | float = SETTLED**2
    for _ in range(MAX_STEPS):
        np.subtract(state.T[:3, :, None], points, out=slopes)
        distance = np.sqrt(np.einsum("aji,aji->ji", slopes, slopes))
        slopes *= root / distance
        distance -= state[:, 3:]
        distance -= length
        np.multiply(distance, root, out=errors)
        products = by_station @ transposed
        try:
            h = np.linalg.solve(products[:, :4, :4], products[:, :4, 4:])[:, :, 0]
        except np.linalg.LinAlgError:
            # one singular station fails the whole stack: all are left to the damped steps
            return start, np.zeros(m, dtype=np.bool_)
        state = state - h
        size = np.maximum.reduce(np.abs(h), axis=1)
        if not (size <= limit).all():
            contracts &= size <= limit
            state = np.where(contracts[:, None], state, start)
            size[~contracts] = 0.0
        moving = size * size > settled
        if not moving.any():
            return state, contracts
        # the share by which a step shrinks does not grow: so the one to come is foreseen
        limit, settled = CONTRACTION * size + SETTLED, SETTLED * size
    return state, contracts & ~moving
