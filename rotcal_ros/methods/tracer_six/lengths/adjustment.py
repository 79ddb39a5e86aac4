"""What an adjustment of lengths returns; and the simplest one: station by station.

Laser tracer paper, section 3.1 (Eq. 5-17): the targets are known, and each station has four
unknowns (X, Y, Z, d). All stations are solved at once, by undamped Gauss-Newton steps as long as
these contract (:func:`contract`), else by damped ones (:func:`locate_damped`). The paper damps all
steps and searches along each; from a fair start undamped steps converge quadratically, and the
minimum is the same. The normal equations lose digits of a step, not of the
answer: that is where the gradient of the residuals vanishes, which each step works out anew in
full precision.

The stations share the targets and hence the targets' errors; their joint covariance keeps that,
because errors common to all stations largely cancel in the angle.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final, Protocol

import numpy as np

from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.results import Residuals
from rotcal_ros.methods.tracer.solver.observability import check_station_rank
from rotcal_ros.methods.tracer.solver.problem import Grid, LengthProblem
from rotcal_ros.methods.tracer.solver.station_by_station import (
    MAX_ITERATIONS,
    locate_stations,
    ranges,
)

MINIMAL_REDUNDANCY: Final = 1e-6
"""Below this share a length is checked by nothing: its test value is zero."""


@dataclass(frozen=True, eq=False)
class Adjustment:
    """Stations, distances and targets that fit the lengths of a grid, and how well they do.

    ``stations`` (m, 3), ``distances`` (p,): the range of a strip at reading zero, ``targets``
    (n, 3), metres; m stations have p strips, see :class:`~.problem.Grid`.
    ``residual`` (p, n): observed - computed (the paper's v of Eq. 3 is computed - observed), also
    of lengths that were not used. ``std`` (p, n): standard deviation of a length as this
    variant sees it; ``redundancy`` (p, n): share of a length that the others check, zero if
    unused. ``chi2`` has mean ``dof``. ``unknowns`` counts the columns of the design matrix,
    ``rank`` those that the data determine.

    Where the targets' coordinates are observations too: ``corrections`` (n, 3) in their standard
    deviations, ``target_redundancy`` (n, 3), ``coupling`` (3, 3): squared sums of the redundancy
    matrix by pairs of axes, and ``target_test`` (n,): the largest normalised correction of a
    target. Else all zero. ``circle_coupling`` (4,): the same sums of a stated circle with the
    targets' axes, and with the lengths.
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
    # the diagonal of the hat matrix is what each length determines of itself; the rest checks it
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


def residual_table(
    problem: LengthProblem, grid: Grid, fit: Adjustment, residual: Floats
) -> Residuals:
    """Return one row per length (k,) with its ``residual``, and a test of what is on the grid."""
    there = grid.row >= 0

    def of_rows(values: Floats | Bools, otherwise: Floats | float) -> Floats:
        column = np.full(len(problem.length), otherwise, dtype=np.float64)
        column[grid.row[there]] = values[there]
        return column

    return Residuals(
        table_position=problem.position,
        target=problem.target,
        residual=residual,
        redundancy=of_rows(fit.redundancy, 0.0),
        test_value=of_rows(fit.test_value, 0.0),
        used=of_rows(grid.used, 0.0).astype(np.bool_),
        std=of_rows(fit.std, problem.length_std),
    )
