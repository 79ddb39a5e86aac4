"""What a plan would give: the solver's own covariance on the nominal geometry, without data."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.methods.tracer.solver import joint, station
from rotcal_ros.methods.tracer.solver.adjustment import Adjustment, StationCovariance
from rotcal_ros.methods.tracer.solver.angles import TableMotion, table_motion
from rotcal_ros.methods.tracer.solver.grid import Grid, arrange
from rotcal_ros.methods.tracer.solver.observability import check_counts
from rotcal_ros.methods.tracer.solver.problem import TracerProblem
from rotcal_ros.methods.tracer.solver.slips import slips_among
from rotcal_ros.methods.tracer.solver.uncertainty import AngleUncertainty, angle_uncertainty
from rotcal_ros.methods.tracer.solver.zero_shifts import find_shifts


@dataclass(frozen=True, eq=False)
class Prediction:
    """What a problem would give: ``angles`` holds the covariance (m, m) of ECC in rad^2.

    ``redundancy`` (k,) by row of the problem; NaN for lengths that have no place on the ``grid``.
    ``fit``, ``stations`` and ``motion`` are as in a solution.
    """

    grid: Grid
    fit: Adjustment
    stations: StationCovariance
    motion: TableMotion
    angles: AngleUncertainty
    redundancy: Floats


def predicted(problem: TracerProblem, stations: Floats) -> Prediction:
    """Return what ``problem`` would give with its tracer at ``stations`` (one per table angle, m).

    Its lengths do not matter: exact ones take their place. Noise is as stated, and nothing is
    rejected. The table's error motion is taken as stated, None as none.

    Raises ObservabilityError when the lengths are too few or leave a direction open.
    """
    apart = stations[problem.position] - problem.targets[problem.target]
    exact = replace(problem, length=np.sqrt((apart**2).sum(axis=1)))
    grid, _ = arrange(exact)
    check_counts(grid)
    standing = stations[grid.position_ids][grid.station]
    start = np.column_stack([standing, np.zeros(len(standing))])
    if problem.variant == "joint":
        fit = joint.adjust_network(grid, start, grid.targets)
        covariance = joint.network_covariance(grid, fit)
    else:
        fit = station.adjust_stations(grid, start)
        covariance = station.stations_covariance(grid, fit)
    motion = table_motion(fit.stations, problem.table_angles[grid.position_ids])
    error_motion = problem.error_motion_std or 0.0
    slips = None
    if grid.zero is not None:
        shifts = find_shifts(grid, fit, problem.measuring_order)
        slips = slips_among(shifts, problem.slip, problem.settings.rejection_significance)
    unseen = None if slips is None else slips.covariance()
    angles = angle_uncertainty(motion, fit, covariance, error_motion, 1.0, unseen)
    redundancy = np.full(len(problem.position), np.nan)
    placed = grid.row >= 0
    redundancy[grid.row[placed]] = fit.redundancy[placed]
    return Prediction(grid, fit, covariance, motion, angles, redundancy)
