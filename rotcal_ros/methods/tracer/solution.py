"""The adjustment of a problem and all that follows from it but the verdict."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from rotcal_ros.arrays import Floats, Ints
from rotcal_ros.errors import DataError
from rotcal_ros.methods.tracer import joint, station
from rotcal_ros.methods.tracer.adjustment import (
    MINIMAL_REDUNDANCY,
    Adjustment,
    StationCovariance,
    ranges,
)
from rotcal_ros.methods.tracer.angles import TableMotion, table_motion
from rotcal_ros.methods.tracer.error_motion import ErrorMotion, error_motion_of
from rotcal_ros.methods.tracer.grid import STATION_MINIMUM, Grid, arrange
from rotcal_ros.methods.tracer.jumps import Jump, find_jump, split
from rotcal_ros.methods.tracer.noise import Noise, NoiseEvidence, scaled
from rotcal_ros.methods.tracer.observability import check_counts, check_station_spread
from rotcal_ros.methods.tracer.problem import TracerProblem
from rotcal_ros.methods.tracer.screening import (
    GROSS,
    Screened,
    adjust_and_screen,
    reject_gross,
    without_targets,
)
from rotcal_ros.methods.tracer.shared_start import find_shared_start, with_zeros
from rotcal_ros.methods.tracer.start import find_start
from rotcal_ros.methods.tracer.uncertainty import (
    AngleUncertainty,
    GlobalTest,
    angle_uncertainty,
    circle_test,
    length_test,
)
from rotcal_ros.methods.tracer.verdict import Evidence, closures
from rotcal_ros.methods.tracer.zero_walk import likely_walk, wandering

LOST: Final = 0.1
"""Deviation (rad) beyond which the stations are not those of the commanded angles."""
MOST_JUMPS: Final = 10
"""Jumps of the zero after which no further ones are looked for: the beam is no beam."""
KNOWN: Final = 1e-9
"""Standard deviation (m) of a coordinate that is called known, where others have errors."""

_COVARIANCE: Final = {"station": station.stations_covariance, "joint": joint.network_covariance}


@dataclass(frozen=True, eq=False)
class TracerSolution:
    """A solved problem; ``grid`` has the standard deviations that were used, after ``noise``.

    ``scale`` enlarges the covariance of the stations for what the noise leaves unexplained.
    ``rejected`` says by row of the problem why a length was not used. All arrays of stations
    follow ``positions``.
    """

    problem: TracerProblem
    grid: Grid
    noise: Noise
    noise_evidence: NoiseEvidence
    fit: Adjustment
    covariance: StationCovariance
    motion: TableMotion
    error_motion: ErrorMotion
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


@dataclass(frozen=True, eq=False)
class _Placed:
    """Stations and their motion from the lengths in use; ``with_them``: see without_targets."""

    grid: Grid
    fit: Adjustment
    covariance: StationCovariance
    motion: TableMotion
    with_them: dict[int, str]

    def mean_variance(self) -> float:
        """Return the mean variance of the deviations without error motion, rad^2."""
        angles = angle_uncertainty(self.motion, self.fit, self.covariance, 0.0, 1.0)
        return float((angles.std**2).mean())


def adjust(problem: TracerProblem) -> TracerSolution:
    """Return the solution of ``problem``; raises what :func:`~.solve.solve` raises."""
    grid, absent = arrange(problem)
    check_counts(grid)
    given = problem.start_stations
    commanded = problem.table_angles[grid.position_ids]
    given = None if given is None else given[grid.position_ids]
    if grid.zero is None:
        start, ambiguous = find_start(grid, given)
    else:
        start, ambiguous = find_shared_start(grid, given, commanded)
    jumps: tuple[Jump, ...] = ()
    if grid.zero is None:
        screened = _screened(problem, grid, start)
    else:
        screened, jumps = _screened_together(problem, grid, start)
    placed = _placed(problem, grid, screened)
    motion, fit, covariance = placed.motion, placed.fit, placed.covariance
    _check_sense(motion, fit.stations, commanded, grid)
    unexplained = length_test(fit, covariance.dof_effective)
    significance = problem.settings.test_significance
    failed = unexplained.probability < significance
    scale = unexplained.sigma0 if failed and unexplained.sigma0 > 1.0 else 1.0
    stated = 0.0 if problem.error_motion_std is None else problem.error_motion_std
    circle = circle_test(motion, covariance, stated, scale)
    error_motion = error_motion_of(
        motion, covariance, scale, problem.error_motion_std, circle.probability < significance
    )
    angles = angle_uncertainty(motion, fit, covariance, error_motion.used, scale)
    evidence = Evidence(
        lengths=_stated_test(problem, screened, placed, unexplained),
        noise=screened.noise,
        unexplained=scale,
        circle=circle,
        error_motion=error_motion,
        radial_rms=float(np.sqrt(np.mean(motion.radial**2))),
        closures=()
        if problem.repeated_runs
        else closures(commanded, motion.cumulative, angles.covariance, grid.position_ids),
        n_lengths=len(problem.length) - len(absent.repeated) - len(absent.spare),
        n_rejected=len(absent.unfit) + len(screened.why),
        missing=tuple(
            np.setdiff1d(np.arange(len(problem.table_angles)), grid.position_ids).tolist()
        ),
        spare=tuple(sorted({int(problem.target[row]) for row in absent.spare})),
        unchecked=int((placed.grid.used & (fit.redundancy <= MINIMAL_REDUNDANCY)).sum()),
        mirror_ambiguous=ambiguous,
        jumps=jumps,
    )
    rejected = absent.repeated | absent.unfit | screened.why | placed.with_them
    return TracerSolution(
        problem, placed.grid, screened.noise, screened.evidence, fit, covariance, motion,
        error_motion, angles, scale, evidence, rejected,
    )  # fmt: skip


def _screened(problem: TracerProblem, grid: Grid, start: Floats) -> Screened:
    """Return the grid without outliers and its noise; see :mod:`.screening`."""
    limits = problem.settings
    as_network = problem.variant == "joint" or bool(grid.target_std.any())
    if not as_network:
        return adjust_and_screen(station.adjust_stations, grid, start, limits)
    coarse, gross = reject_gross(
        station.adjust_stations, grid, start, limits.rejection_significance
    )
    if problem.variant == "station":
        coarse = replace(coarse, target_std=np.maximum(coarse.target_std, KNOWN))
    screened = adjust_and_screen(joint.adjust_network, coarse, start, limits)
    kept = replace(screened.grid, target_std=grid.target_std)
    return replace(screened, grid=kept, why=screened.why | gross)


def _screened_together(
    problem: TracerProblem, grid: Grid, start: Floats
) -> tuple[Screened, tuple[Jump, ...]]:
    """Do as :func:`_screened` where stations share zeros, and split these where they jump.

    Large jumps are looked for before large outliers, with their margin: the errors of known
    targets come in the order of time.
    """
    limits, order = problem.settings, problem.measuring_order
    jumps: list[Jump] = []

    def broken(fit_grid: Grid, fit: Adjustment, margin: float) -> bool:
        nonlocal grid, start
        jump = find_jump(fit_grid, fit, order, limits.rejection_significance, margin)
        if jump is None or len(jumps) == MOST_JUMPS:
            return False
        jumps.append(jump)
        grid, source = split(grid, jump, order)
        start = with_zeros(grid, start[source, :3])
        return True

    walk = problem.zero_walk_std
    while walk == 0.0 and broken(_missing(grid), _known_targets(grid, start), GROSS):
        pass
    while True:
        coarse, gross = reject_gross(_known_targets, grid, start, limits.rejection_significance)
        std = likely_walk(coarse, start, order) if walk is None else walk
        begin = start
        if std:
            coarse, source = wandering(coarse, order, std)
            begin = with_zeros(coarse, start[source, :3])
        screened = adjust_and_screen(joint.adjust_network, coarse, begin, limits)
        if not broken(scaled(screened.grid, screened.noise.factors), screened.fit, 1.0):
            return replace(screened, why=screened.why | gross), tuple(jumps)


def _known_targets(grid: Grid, start: Floats, targets: Floats | None = None) -> Adjustment:
    """Adjust stations to targets as the machine has them, whose errors join the lengths'."""
    return joint.adjust_network(_missing(grid), start, targets)


def _missing(grid: Grid) -> Grid:
    """Return ``grid`` with known targets, whose errors are among those of the lengths."""
    missed = (grid.target_std**2).max(axis=1)
    return replace(
        grid,
        free=False,
        length_std=np.sqrt(grid.length_std**2 + missed),
        target_std=np.full_like(grid.target_std, KNOWN),
    )


def _placed(problem: TracerProblem, grid: Grid, screened: Screened) -> _Placed:
    """Return stations and motion from the screened lengths; ``grid`` holds all of them.

    The variant "station" is solved without whole targets too where single lengths were
    rejected: what gives the smaller uncertainty is taken.
    """
    if problem.variant == "joint":
        return _placed_by(problem, scaled(screened.grid, screened.noise.factors), screened.fit)
    start = screened.fit.state
    singly = scaled(screened.grid, screened.noise.factors)
    found = _placed_by(problem, singly, station.adjust_stations(singly, start))
    wholly, with_them = without_targets(grid, singly)
    if not with_them or not _enough(wholly):
        return found
    other = _placed_by(problem, wholly, station.adjust_stations(wholly, start), with_them)
    return other if other.mean_variance() < found.mean_variance() else found


def _placed_by(
    problem: TracerProblem, grid: Grid, fit: Adjustment, with_them: dict[int, str] | None = None
) -> _Placed:
    covariance = _COVARIANCE[problem.variant](grid, fit)
    blocks, largest = covariance.position_blocks(), problem.settings.max_station_std
    check_station_spread(fit.stations, blocks, grid.position_ids, largest)
    motion = table_motion(fit.stations, problem.table_angles[grid.position_ids])
    return _Placed(grid, fit, covariance, motion, with_them or {})


def _enough(grid: Grid) -> bool:
    """Whether every station still has what one needs to be found, twice over."""
    return bool((grid.used.sum(axis=1) >= 2 * STATION_MINIMUM).all())


def _stated_test(
    problem: TracerProblem, screened: Screened, placed: _Placed, unexplained: GlobalTest
) -> GlobalTest:
    """Return the chi-squared test of the residuals against the noise as it was stated."""
    if not screened.noise.estimated:
        return unexplained
    grid, fit = screened.grid, placed.fit
    variance = grid.length_std**2
    if problem.variant == "station":
        _, unit = ranges(fit.stations, grid.targets)
        variance = variance + np.einsum("jia,ia->ji", unit**2, grid.target_std**2)
    chi2 = float((placed.grid.used * fit.residual**2 / variance).sum())
    chi2 += float(((fit.corrections * screened.noise.factors[2:]) ** 2).sum())
    return length_test(replace(fit, chi2=chi2), placed.covariance.dof_effective)


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
