"""The tracer method from problem to result."""

from __future__ import annotations

import numpy as np

from rotcal_ros.arrays import Floats
from rotcal_ros.errors import DataError
from rotcal_ros.methods.tracer import joint, station
from rotcal_ros.methods.tracer.adjustment import MINIMAL_REDUNDANCY
from rotcal_ros.methods.tracer.angles import TableMotion, table_motion
from rotcal_ros.methods.tracer.details import Solution, details
from rotcal_ros.methods.tracer.grid import Grid, arrange
from rotcal_ros.methods.tracer.observability import (
    check_counts,
    check_station_spread,
)
from rotcal_ros.methods.tracer.problem import TracerProblem
from rotcal_ros.methods.tracer.screening import adjust_and_screen, reject_gross
from rotcal_ros.methods.tracer.start import find_start
from rotcal_ros.methods.tracer.uncertainty import (
    angle_uncertainty,
    circle_test,
    error_motion_covariance,
    length_test,
)
from rotcal_ros.methods.tracer.verdict import Evidence, closures, judge
from rotcal_ros.results import Rejection, Residuals, Result

METHOD = "tracer_multistation"
LOST = 0.1
"""Deviation (rad) beyond which the stations are not those of the commanded angles."""


def solve(problem: TracerProblem) -> Result:
    """Return the angular positioning deviations ECC of the table at the commanded angles.

    ``deviations["ECC"]`` (radians, actual - commanded) are *cumulative*, counted from the first
    angle with usable lengths, where deviation and standard deviation are zero;
    ``adjacent_deviations`` are those of the steps between neighbouring angles (the paper's
    Table 3). Standard deviations are for a normal distribution, see :mod:`.uncertainty`; the rules
    of rejection are in :mod:`.screening`, those of the verdict in :mod:`.verdict`. Angles whose
    station has too few lengths are absent from the result; ``details["station_ids"]`` maps.
    Method: Laser tracer multi-station paper, Eq. 1-36. The order of the rows of ``problem`` does
    not change a bit of the result.

    Raises ObservabilityError when the geometry cannot tell the angle (it names the weak direction
    or both sides of Eq. 2), DataError for contradictory or implausible data.
    """
    solution = adjusted(problem)
    verdict, warnings = judge(solution.evidence, problem.settings)
    motion, angles = solution.motion, solution.angles
    return Result(
        method=METHOD,
        angles=problem.table_angles[solution.grid.station_ids],
        deviations={"ECC": motion.cumulative},
        std={"ECC": angles.std},
        covariance={"ECC": angles.covariance},
        sigma0=solution.evidence.lengths.sigma0,
        dof=solution.fit.dof,
        n_observations=len(problem.length),
        rejected=tuple(Rejection(row, why) for row, why in sorted(solution.rejected.items())),
        verdict=verdict,
        warnings=warnings,
        adjacent_deviations=motion.adjacent,
        adjacent_std=angles.adjacent_std,
        residuals=_residuals(problem, solution),
        details=details(problem, solution),
    )


def adjusted(problem: TracerProblem) -> Solution:
    """Return the adjustment of ``problem`` and all that follows from it but the verdict."""
    grid, repeated, unfit = arrange(problem)
    check_counts(grid)
    missing = tuple(np.setdiff1d(np.arange(len(problem.table_angles)), grid.station_ids).tolist())
    given = problem.start_stations
    start, ambiguous = find_start(grid, None if given is None else given[grid.station_ids])
    significance = problem.settings.rejection_significance
    adjust, covariance_of = _VARIANTS[problem.variant]
    gross: dict[int, str] = {}
    if problem.variant == "joint":
        grid, gross = reject_gross(station.adjust_stations, grid, start, significance)
    grid, fit, outliers = adjust_and_screen(adjust, grid, start, significance)
    outliers |= gross
    covariance = covariance_of(grid, fit)
    check_station_spread(
        fit.stations,
        covariance.position_blocks(),
        grid.station_ids,
        problem.settings.max_station_std,
    )
    commanded = problem.table_angles[grid.station_ids]
    motion = table_motion(fit.stations, commanded)
    _check_sense(motion, fit.stations, commanded, grid)
    lengths = length_test(fit, covariance.dof_effective)
    failed = lengths.probability < problem.settings.test_significance
    scale = lengths.sigma0 if failed and lengths.sigma0 > 1.0 else 1.0
    angles = angle_uncertainty(motion, fit, covariance, problem.error_motion_std, scale)
    total = scale**2 * (covariance.lengths + covariance.targets)
    total += error_motion_covariance(motion, problem.error_motion_std)
    evidence = Evidence(
        lengths=lengths,
        circle=circle_test(motion, total),
        radial_rms=float(np.sqrt(np.mean(motion.radial**2))),
        closures=()
        if problem.repeated_runs
        else closures(commanded, motion.cumulative, angles.covariance, grid.station_ids),
        n_lengths=len(problem.length) - len(repeated),
        n_rejected=len(unfit) + len(outliers),
        missing=missing,
        unchecked=int((grid.used & (fit.redundancy <= MINIMAL_REDUNDANCY)).sum()),
        mirror_ambiguous=ambiguous,
    )
    return Solution(
        grid, fit, covariance, motion, angles, scale, evidence, repeated | unfit | outliers
    )


_VARIANTS = {
    "station": (station.adjust_stations, station.stations_covariance),
    "joint": (joint.adjust_network, joint.network_covariance),
}


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
        f"station {grid.station_ids[worst]} stands {motion.cumulative[worst]:.3f} rad from its "
        f"commanded angle of {commanded[worst]:.3f} rad: {cure}"
    )


def _residuals(problem: TracerProblem, solution: Solution) -> Residuals:
    """Return one row per length; NaN where the station or target was dropped altogether."""
    grid, fit = solution.grid, solution.fit
    station_at = np.full(len(problem.table_angles), -1)
    station_at[grid.station_ids] = np.arange(len(grid.station_ids))
    target_at = np.full(len(problem.targets), -1)
    target_at[grid.target_ids] = np.arange(len(grid.target_ids))
    j, i = station_at[problem.station], target_at[problem.target]
    known = (j >= 0) & (i >= 0)
    distance = np.linalg.norm(fit.stations[j] - fit.targets[i], axis=1) - fit.distances[j]
    placed = known & (grid.row[j, i] == np.arange(len(j)))
    return Residuals(
        table_index=problem.station,
        target=problem.target,
        residual=np.where(known, problem.length - distance, np.nan),
        redundancy=np.where(placed, fit.redundancy[j, i], 0.0),
        test_value=np.where(placed, fit.test_value[j, i], 0.0),
        used=placed & grid.used[j, i],
    )
