"""The adjustment of a problem and all that follows from it but the verdict."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from rotcal_ros.adjust.closures import closures
from rotcal_ros.adjust.error_motion import Spectrum
from rotcal_ros.adjust.groups import Group, Undivided
from rotcal_ros.adjust.low_rank import LowRank
from rotcal_ros.adjust.noise import GlobalTest, NoiseEvidence
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.errors import DataError, RotcalError
from rotcal_ros.foundation.results import ErrorMotion
from rotcal_ros.foundation.units import DEGREE
from rotcal_ros.methods.tracer.solver.adjustment import (
    Adjustment,
    StationCovariance,
    adjust_stations,
    ranges,
    stations_covariance,
)
from rotcal_ros.methods.tracer.solver.circle import TableMotion, bearing_slopes, table_motion
from rotcal_ros.methods.tracer.solver.joint import adjust_network, network_covariance
from rotcal_ros.methods.tracer.solver.network import KNOWN, network_of, view_of
from rotcal_ros.methods.tracer.solver.observability import (
    check_counts,
    check_station_spread,
    hardly_moved,
    told_of_a_turned_sign,
)
from rotcal_ros.methods.tracer.solver.problem import STATION_MINIMUM, Grid, TracerProblem, arrange
from rotcal_ros.methods.tracer.solver.screening import (
    GROSS,
    NORMAL_QUARTILE,
    Grouping,
    NoiseFactors,
    ScreenedLengths,
    adjust_and_screen,
    groups_of,
    reject_gross,
    scaled,
    without_targets,
)
from rotcal_ros.methods.tracer.solver.start import find_any_start, with_zeros
from rotcal_ros.methods.tracer.solver.uncertainty import (
    AngleUncertainty,
    CircleStatement,
    CircleTest,
    angle_uncertainty,
    circle_test,
    circle_tested,
    error_motion_of,
    likely_circle,
)
from rotcal_ros.methods.tracer.solver.verdict import Evidence, judge
from rotcal_ros.methods.tracer.solver.zeros import (
    MOST_JUMPS,
    Jump,
    Shifts,
    Slips,
    likely_walk,
    shift_search,
    slips_among,
    split,
    wandering,
)

LOST: Final = 0.1
"""Deviation (rad) beyond which the stations are not those of the commanded angles."""
FREE_CIRCLE: Final = 1e-4
"""Deviation (m) from the circle that keeps every station near it and adds no other knowledge."""
_COVARIANCE: Final = {"station": stations_covariance, "joint": network_covariance}


@dataclass(frozen=True, eq=False)
class TracerSolution:
    """A solved problem; ``grid`` has the standard deviations that were used, after ``noise``.

    ``scale`` enlarges the covariance of the stations for what the noise leaves unexplained.
    ``rejected`` says by row of the problem why a length was not used. ``spectrum``: that of the
    error motion. ``slips``: those that would not be found; None where every station has a zero of
    its own. All arrays of stations follow ``positions``.
    """

    problem: TracerProblem
    grid: Grid
    noise: NoiseFactors
    noise_evidence: NoiseEvidence
    fit: Adjustment
    covariance: StationCovariance
    motion: TableMotion
    error_motion: ErrorMotion
    spectrum: Spectrum
    angles: AngleUncertainty
    scale: float
    evidence: Evidence
    rejected: dict[int, str]
    slips: Slips | None = None

    @property
    def positions(self) -> Ints:
        """The table positions (m,) that have a station; those with too few lengths are absent."""
        return self.grid.position_ids

    @property
    def circle(self) -> CircleTest:
        """What the stations leave their circle by, with the error motion that was used."""
        return circle_tested(
            self.fit.stations, self.motion, self.covariance.total, self.error_motion.used,
            self.grid.circle_std, self.spectrum,
        )  # fmt: skip

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
        angles = angle_uncertainty(self.motion, self.fit.stations, self.covariance, 0.0, 1.0)
        return float((angles.std**2).mean())


def adjust(problem: TracerProblem) -> TracerSolution:
    """Return the solution of ``problem``; raises what :func:`~.solve.solve` raises.

    A stated circle is believed while nothing is odd. Else the lengths are asked without it: where
    the stations that they find contradict it, what they leave of it takes its place.
    """
    return told_of_a_turned_sign(problem, _with_circle, lambda found: not _doubtful(found))


def _with_circle(problem: TracerProblem) -> TracerSolution:
    solution = _adjusted(problem)
    stated = problem.circle_std
    if stated is None or not _doubtful(solution):
        return solution
    try:
        free = _adjusted(replace(problem, circle_std=FREE_CIRCLE))
    except RotcalError:
        return solution  # without the circle the lengths do not even place the stations
    fit, grid, total = free.fit, free.grid, free.covariance.enlarged(free.scale).total
    circle = circle_tested(fit.stations, free.motion, total, stated, grid.circle_std)
    used = max(stated, likely_circle(circle, stated))
    found = _statement(circle, stated, used)
    if found.probability >= problem.settings.test_significance:
        return solution
    return _adjusted(replace(problem, circle_std=used), found)


def _doubtful(solution: TracerSolution) -> bool:
    verdict, _ = judge(solution.evidence, solution.problem.settings)
    return verdict != "ok"


def _statement(circle: CircleTest, stated: float, used: float) -> CircleStatement:
    """Return what the ``circle`` says of its statement."""
    test = circle_test(circle)
    return CircleStatement(
        stated, used, circle.redundancy, circle.residuals.dof, test.sigma0, test.probability
    )


def _adjusted(problem: TracerProblem, wider: CircleStatement | None = None) -> TracerSolution:
    """Return the solution with the problem's circle, which may be ``wider`` than was stated."""
    grid, absent = arrange(problem)
    check_counts(grid, absent.unfit.values())
    commanded = problem.table_angles[grid.position_ids]
    screened, jumps, shifts, ambiguous = _started(problem, grid, commanded)
    placed = _placed(problem, grid, screened)
    motion, fit, covariance = placed.motion, placed.fit, placed.covariance
    check_sense(motion, fit.stations, commanded, grid.position_ids)
    unexplained = GlobalTest.of(fit.chi2, fit.dof, covariance.dof_effective)
    significance = problem.settings.test_significance
    scale = unexplained.enlargement(significance)
    stated = 0.0 if problem.error_motion_std is None else problem.error_motion_std
    circle_std = problem.circle_std
    seen = circle_tested(
        fit.stations, motion, covariance.enlarged(scale).total,
        stated if circle_std is None else circle_std, circle_std,
    )  # fmt: skip
    circle, statement = circle_test(seen), wider
    if circle_std is not None and wider is None:
        statement = _statement(seen, circle_std, circle_std)
    known = circle_std if problem.error_motion_std is None else problem.error_motion_std
    contradicted = (statement or circle).probability < significance
    error_motion, spectrum = error_motion_of(
        fit.stations, motion, covariance, scale, known, contradicted, circle_std
    )
    slips = slips_among(shifts, problem.slip, problem.settings.rejection_significance, scale)
    unseen = None if slips is None else slips.covariance()
    gathered = screened.gathering.covariance()
    angles = angle_uncertainty(
        motion, fit.stations, covariance, error_motion.used, scale, unseen, gathered, spectrum
    )
    evidence = Evidence(
        lengths=_stated_test(problem, screened, placed, unexplained),
        noise=screened.noise,
        unexplained=scale,
        circle=circle,
        circle_statement=statement,
        error_motion=error_motion,
        radial_rms=float(np.sqrt(np.mean(motion.radial**2))),
        closures=()
        if problem.repeated_runs
        else closures(
            commanded, motion.cumulative, LowRank.whole(angles.covariance), grid.position_ids
        ),
        n_lengths=len(problem.length) - len(absent.repeated) - len(absent.spare),
        n_rejected=len(absent.unfit) + len(screened.why),
        missing=problem.missing(grid.position_ids),
        spare=tuple(sorted({int(problem.target[row]) for row in absent.spare})),
        unchecked=fit.unchecked(placed.grid),
        mirror_ambiguous=ambiguous,
        jumps=jumps,
        fringe=problem.slip,
        scatter=_scatter(screened, fit),
        gathering=screened.gathering,
    )
    rejected = absent.repeated | absent.unfit | screened.why | placed.with_them
    return TracerSolution(
        problem, placed.grid, screened.noise, screened.evidence, fit, covariance, motion,
        error_motion, spectrum, angles, scale, evidence, rejected, slips,
    )  # fmt: skip


def _scatter(screened: ScreenedLengths, fit: Adjustment) -> float:
    """Return the scatter of all residuals over what is stated, by the median.

    A few outliers do not count, but the rejected lengths do: many of them are no outliers.
    """
    known = screened.grid.row >= 0
    ratio = np.abs(fit.residual[known] / fit.std[known])
    return float(screened.noise.factors[0] * np.median(ratio) / NORMAL_QUARTILE)


def _started(
    problem: TracerProblem, grid: Grid, commanded: Floats
) -> tuple[ScreenedLengths, tuple[Jump, ...], Shifts | None, bool]:
    """Return the grid without outliers, jumps and shifts of its zeros, and if mirror images fit.

    ``commanded`` (m,): angles of the stations, rad.
    """
    given = problem.start_stations
    given = None if given is None else given[grid.position_ids]
    start, ambiguous = find_any_start(grid, given, commanded)
    if problem.variant == "station" or grid.apart:
        return _screened(problem, grid, start), (), None, ambiguous
    return *_screened_together(problem, grid, start), ambiguous


def _screened(problem: TracerProblem, grid: Grid, start: Floats) -> ScreenedLengths:
    """Return the grid without outliers and its noise; see :mod:`.screening`."""
    limits = problem.settings
    as_network = problem.variant == "joint" or bool(grid.target_std.any())
    if not as_network:
        return adjust_and_screen(adjust_stations, grid, start, limits, _grouping(problem))
    coarse, gross = reject_gross(adjust_stations, grid, start, limits.rejection_significance)
    if problem.variant == "station":
        coarse = replace(coarse, target_std=np.maximum(coarse.target_std, KNOWN))
    screened = adjust_and_screen(adjust_network, coarse, start, limits, _grouping(problem))
    kept = replace(screened.grid, target_std=grid.target_std)
    return replace(screened, grid=kept, why=screened.why | gross)


def _grouping(problem: TracerProblem) -> Grouping:
    """Return what makes the groups of this ``problem``."""

    def grouping(grid: Grid, fit: Adjustment) -> tuple[Group | Undivided, ...]:
        if hardly_moved(fit.stations):
            return ()  # refused in words as soon as the lengths are settled
        commanded = problem.table_angles[grid.position_ids]
        network = network_of(grid, fit)
        slopes = bearing_slopes(fit.stations, table_motion(fit.stations, commanded)).from_first
        view = view_of(network, slopes)
        return groups_of(grid, fit, view, -network.f, problem.measuring_order)

    return grouping


def _screened_together(
    problem: TracerProblem, grid: Grid, start: Floats
) -> tuple[ScreenedLengths, tuple[Jump, ...], Shifts | None]:
    """Do as :func:`_screened` where stations are tied together, and split zeros where they jump.

    The shifts are those of the network that comes out. Large jumps are searched for before large
    outliers, with their margin: the errors of known targets come in the order of time.
    """
    limits, order = problem.settings, problem.measuring_order
    jumps: list[Jump] = []
    shifts: Shifts | None = None

    def broken(fit_grid: Grid, fit: Adjustment, margin: float) -> bool:
        nonlocal grid, start, shifts
        if problem.segment is None:
            return False
        search = shift_search(fit_grid, fit, order)
        shifts = search.few()
        jump = search.jump(shifts, limits.rejection_significance, margin)
        if jump is None or len(jumps) == MOST_JUMPS:
            return False
        jumps.append(replace(jump, segment=int(fit_grid.segment_numbers[jump.segment])))
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
        screened = adjust_and_screen(adjust_network, coarse, begin, limits, _grouping(problem))
        if not broken(scaled(screened.grid, screened.noise.factors), screened.fit, 1.0):
            return replace(screened, why=screened.why | gross), tuple(jumps), shifts


def _known_targets(grid: Grid, start: Floats, targets: Floats | None = None) -> Adjustment:
    """Adjust stations to targets as the machine has them, whose errors join the lengths'."""
    return adjust_network(_missing(grid), start, targets)


def _missing(grid: Grid) -> Grid:
    """Return ``grid`` with known targets, whose errors are among those of the lengths."""
    missed = (grid.target_std**2).max(axis=1)
    return replace(
        grid,
        free=False,
        length_std=np.sqrt(grid.length_std**2 + missed),
        target_std=np.full_like(grid.target_std, KNOWN),
    )


def _placed(problem: TracerProblem, grid: Grid, screened: ScreenedLengths) -> _Placed:
    """Return stations and motion from the screened lengths; ``grid`` holds all of them.

    The variant "station" is solved without whole targets too where single lengths were
    rejected: what gives the smaller uncertainty is taken.
    """
    if problem.variant == "joint":
        return _placed_by(problem, scaled(screened.grid, screened.noise.factors), screened.fit)
    start = screened.fit.state
    singly = scaled(screened.grid, screened.noise.factors)
    found = _placed_by(problem, singly, adjust_stations(singly, start))
    wholly, with_them = without_targets(grid, singly)
    # unless every station keeps what one needs to be found, twice over
    if not with_them or (wholly.used.sum(axis=1) < 2 * STATION_MINIMUM).any():
        return found
    other = _placed_by(problem, wholly, adjust_stations(wholly, start), with_them)
    return other if other.mean_variance() < found.mean_variance() else found


def _placed_by(
    problem: TracerProblem, grid: Grid, fit: Adjustment, with_them: dict[int, str] | None = None
) -> _Placed:
    covariance = _COVARIANCE[problem.variant](grid, fit)
    blocks, largest = covariance.position_blocks(), problem.settings.max_station_std
    check_station_spread(fit.stations, blocks, grid.position_ids, largest)
    motion = table_motion(fit.stations, problem.table_angles[grid.position_ids])
    return _Placed(grid, fit, covariance, motion, with_them or {})


def _stated_test(
    problem: TracerProblem, screened: ScreenedLengths, placed: _Placed, unexplained: GlobalTest
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
    return GlobalTest.of(chi2, fit.dof, placed.covariance.dof_effective)


def check_sense(motion: TableMotion, stations: Floats, commanded: Floats, positions: Ints) -> None:
    """Raise DataError when the stations (m, 3) at ``positions`` do not follow their angles."""
    worst = int(np.argmax(np.abs(motion.cumulative)))
    if abs(motion.cumulative[worst]) < LOST:
        return
    backward = table_motion(stations, -commanded)
    cure = "check the order of the stations and the start, step and unit of the table angles"
    if np.abs(backward.cumulative).max() < LOST:
        cure = (
            "they follow the angles with the opposite sign. Which way does the table turn, seen "
            "from +z, while its angle counts up? Clockwise: negate the table angles. "
            "Counter-clockwise: the frame of the targets is left-handed (an axis turned round, or "
            "two exchanged), which lengths alone cannot show"
        )
    off, order = motion.cumulative[worst] / DEGREE, commanded[worst] / DEGREE
    raise DataError(
        f"station {positions[worst]} stands at {(order + off) % 360.0:.4f} degrees where "
        f"{order:.4f} were commanded, {off:+.4f} degrees off: {cure}"
    )
