"""The adjustment of a problem and all that follows from it but the verdict."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from rotcal_ros.arrays import Floats, Ints
from rotcal_ros.errors import DataError
from rotcal_ros.methods.tracer import joint, station
from rotcal_ros.methods.tracer.adjustment import MINIMAL_REDUNDANCY, Adjustment, StationCovariance
from rotcal_ros.methods.tracer.angles import TableMotion, table_motion
from rotcal_ros.methods.tracer.grid import Grid, arrange
from rotcal_ros.methods.tracer.observability import check_counts, check_station_spread
from rotcal_ros.methods.tracer.problem import TracerProblem
from rotcal_ros.methods.tracer.screening import adjust_and_screen, reject_gross
from rotcal_ros.methods.tracer.start import find_start
from rotcal_ros.methods.tracer.uncertainty import (
    AngleUncertainty,
    angle_uncertainty,
    circle_test,
    length_test,
)
from rotcal_ros.methods.tracer.verdict import Evidence, closures

LOST: Final = 0.1
"""Deviation (rad) beyond which the stations are not those of the commanded angles."""

_ADJUST: Final = {"station": station.adjust_stations, "joint": joint.adjust_network}
_COVARIANCE: Final = {"station": station.stations_covariance, "joint": joint.network_covariance}


@dataclass(frozen=True, eq=False)
class TracerSolution:
    """A solved problem; ``scale`` enlarges the covariance of the stations.

    ``rejected`` says by row of the problem why a length was not used. All arrays of stations
    follow ``positions``.
    """

    problem: TracerProblem
    grid: Grid
    fit: Adjustment
    covariance: StationCovariance
    motion: TableMotion
    angles: AngleUncertainty
    scale: float
    evidence: Evidence
    rejected: dict[int, str]

    @property
    def positions(self) -> Ints:
        """The table positions (m,) that have a station; those with too few lengths are absent."""
        return self.grid.position_ids

    @property
    def table_angles(self) -> Floats:
        """The commanded angles (m,) of the positions, rad."""
        return self.problem.table_angles[self.positions]


def adjust(problem: TracerProblem) -> TracerSolution:
    """Return the solution of ``problem``; raises what :func:`~.solve.solve` raises."""
    grid, repeated, unfit = arrange(problem)
    check_counts(grid)
    given = problem.start_stations
    start, ambiguous = find_start(grid, None if given is None else given[grid.position_ids])
    grid, fit, outliers = _screened(problem, grid, start)
    covariance = _COVARIANCE[problem.variant](grid, fit)
    blocks, largest = covariance.position_blocks(), problem.settings.max_station_std
    check_station_spread(fit.stations, blocks, grid.position_ids, largest)
    commanded = problem.table_angles[grid.position_ids]
    motion = table_motion(fit.stations, commanded)
    _check_sense(motion, fit.stations, commanded, grid)
    lengths = length_test(fit, covariance.dof_effective)
    failed = lengths.probability < problem.settings.test_significance
    scale = lengths.sigma0 if failed and lengths.sigma0 > 1.0 else 1.0
    angles = angle_uncertainty(motion, fit, covariance, problem.error_motion_std, scale)
    evidence = Evidence(
        lengths=lengths,
        circle=circle_test(motion, covariance, problem.error_motion_std, scale),
        radial_rms=float(np.sqrt(np.mean(motion.radial**2))),
        closures=()
        if problem.repeated_runs
        else closures(commanded, motion.cumulative, angles.covariance, grid.position_ids),
        n_lengths=len(problem.length) - len(repeated),
        n_rejected=len(unfit) + len(outliers),
        missing=tuple(
            np.setdiff1d(np.arange(len(problem.table_angles)), grid.position_ids).tolist()
        ),
        unchecked=int((grid.used & (fit.redundancy <= MINIMAL_REDUNDANCY)).sum()),
        mirror_ambiguous=ambiguous,
    )
    rejected = repeated | unfit | outliers
    return TracerSolution(
        problem, grid, fit, covariance, motion, angles, scale, evidence, rejected
    )


def _screened(
    problem: TracerProblem, grid: Grid, start: Floats
) -> tuple[Grid, Adjustment, dict[int, str]]:
    """Return the grid without outliers, its adjustment, and why those were outliers, by row."""
    significance = problem.settings.rejection_significance
    gross: dict[int, str] = {}
    if problem.variant == "joint":
        grid, gross = reject_gross(station.adjust_stations, grid, start, significance)
    grid, fit, outliers = adjust_and_screen(_ADJUST[problem.variant], grid, start, significance)
    return grid, fit, outliers | gross


def _check_sense(motion: TableMotion, stations: Floats, commanded: Floats, grid: Grid) -> None:
    """Raise DataError when the stations do not follow the commanded angles."""
    worst = int(np.argmax(np.abs(motion.cumulative)))
    if abs(motion.cumulative[worst]) < LOST:
        return
    backward = table_motion(stations, -commanded)
    cure = "check the order of the stations and the unit of the table angles (radians)"
    if np.abs(backward.cumulative).max() < LOST:
        cure = (
            "they follow the angles with the opposite sign: this table counts clockwise about +z, "
            "so negate the table angles"
        )
    raise DataError(
        f"station {grid.position_ids[worst]} stands {motion.cumulative[worst]:.3f} rad from its "
        f"commanded angle of {commanded[worst]:.3f} rad: {cure}"
    )
