"""The adjustment of a problem and all that follows from it but the verdict."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Final

import numpy as np

from rotcal_ros.adjust.distributions import chi2_sf
from rotcal_ros.adjust.gathering import Gathering
from rotcal_ros.adjust.groups import Group
from rotcal_ros.adjust.low_rank import LowRank
from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.methods.tracer.solver.adjustment import Adjustment, adjust_stations
from rotcal_ros.methods.tracer.solver.grid import STATION_MINIMUM, Grid
from rotcal_ros.methods.tracer.solver.observability import told_of_a_turned_sign
from rotcal_ros.methods.tracer.solver.screening import (
    Grouping,
    NoiseFactors,
    ScreenedLengths,
    adjust_and_screen,
    reject_gross,
    scaled,
)
from rotcal_ros.methods.tracer.solver.uncertainty import GlobalTest
from rotcal_ros.methods.tracer.solver.verdict import CircleClosure, closures
from rotcal_ros.methods.tracer.solver.zeros import MOST_JUMPS, Jump, Shifts, Slips, slips_among
from rotcal_ros.methods.tracer_six.solver.adjustment import (
    RigidAdjuster,
    RigidAdjustment,
    check_curves,
    find_broken_zero,
    find_shifts,
    find_start,
    groups_of,
    split,
)
from rotcal_ros.methods.tracer_six.solver.layout import StationLayout, lay_out, renamed
from rotcal_ros.methods.tracer_six.solver.network import (
    CurvePosterior,
    LengthNetwork,
    NetworkState,
    curve_posterior,
    pulled,
)
from rotcal_ros.methods.tracer_six.solver.problem import SixProblem, timing
from rotcal_ros.methods.tracer_six.solver.scatter import Moves, Scatter, enlargement, moves, turned

FITTING: Final = 3.0
"""Times the stated noise up to which lengths of the opposite sign are said to fit."""
PLACE: Final = {name: index for index, name in enumerate(COMPONENTS)}


@dataclass(frozen=True, eq=False)
class SixSolution:
    """A solved problem; ``grid`` has the standard deviations that were used, after ``noise``.

    ``table``: curves with their covariance as the network gives it; ``covariance`` (6, m, 6, m),
    in the order of COMPONENTS, what is known of them in the end: enlarged by ``scale`` for what
    the noise leaves unexplained, and for a scatter that few contrasts tell, and with what unseen
    ``slips`` of a fringe add. ``closures`` are tested without these: such a slip may open them.
    ``lengths``: test of chi-squared with the noise that was used. ``rejected`` says by row why a
    length was not used; ``n_lengths`` could have been used, ``n_rejected`` of them were not.
    ``gathering``: what was found of disturbances in one place; what they may do is in the
    covariance too. ``jumps`` of zeros, whose segment is a zero of the ``layout``.
    """

    problem: SixProblem
    layout: StationLayout
    grid: Grid
    noise: NoiseFactors
    fit: RigidAdjustment
    table: CurvePosterior
    covariance: Floats
    lengths: GlobalTest
    scale: float
    closures: dict[str, tuple[CircleClosure, ...]]
    rejected: dict[int, str]
    n_lengths: int
    n_rejected: int
    jumps: tuple[Jump, ...] = ()
    slips: Slips | None = None
    gathering: Gathering = field(default_factory=Gathering)

    @property
    def network(self) -> LengthNetwork:
        """The network at its minimum."""
        return self.fit.posterior.network

    @property
    def scatter(self) -> Scatter:
        """The scatter from run to run that was used."""
        return self.fit.scatter

    @cached_property
    def moves(self) -> Moves:
        """The tests of what moved between the runs, and within them."""
        problem, grid = self.problem, self.grid
        known = (problem.scatter_translation_std, problem.scatter_rotation_std)
        when = (timing(problem, grid).own * grid.used).sum(axis=1) / grid.used.sum(axis=1)
        return moves(self.network, when, known, problem.settings.test_significance)

    @property
    def zeros(self) -> Floats:
        """The zeros (s,) of the counter as the lengths of the problem have them, m."""
        return self.network.state.zeros + self.layout.offset

    @property
    def places(self) -> Floats:
        """The places (p, 3), m, in the frame that turns with the table, z along the axis."""
        curves = self.table.curves
        places = (self.network.state.places - curves.table_origin) @ curves.table_turn
        return np.asarray(places, dtype=np.float64)

    @property
    def positions(self) -> Ints:
        """The table positions (m,) that have a result."""
        return self.layout.position_ids

    @property
    def missing(self) -> tuple[int, ...]:
        """The table positions without a result."""
        every = np.arange(len(self.problem.table_angles))
        return tuple(np.setdiff1d(every, self.positions).tolist())

    def deviations(self) -> dict[str, Floats]:
        """Return the six curves (m,), m and rad."""
        curves = self.table.curves
        columns = np.concatenate([curves.translation, curves.rotation], axis=1)
        return {name: columns[:, at].copy() for name, at in PLACE.items()}

    def covariance_of(self, name: str) -> Floats:
        """Return the covariance (m, m) of one curve."""
        return np.ascontiguousarray(self.covariance[PLACE[name], :, PLACE[name]])


def adjust(problem: SixProblem) -> SixSolution:
    """Return the solution of ``problem``; raises what :func:`~.solve.solve` raises."""
    return told_of_a_turned_sign(
        problem,
        _adjusted,
        lambda found: bool((found.scale * found.noise.factors < FITTING).all()),
    )


def _adjusted(problem: SixProblem) -> SixSolution:
    layout, absent = lay_out(problem)
    limits = problem.settings
    state = find_start(layout)
    coarse, start, why = _without_gross(layout, state, limits.rejection_significance)
    stated = (problem.scatter_translation_std, problem.scatter_rotation_std)
    adjuster = RigidAdjuster(layout, state, stated, limits.test_significance)
    screened = adjust_and_screen(adjuster, coarse, start, limits, _grouping(problem))
    screened, jumps, shifts = _unbroken(problem, adjuster, screened, coarse, start)
    fit = screened.fit
    assert isinstance(fit, RigidAdjustment)
    layout = fit.posterior.network.layout
    names = {int(s): layout.station_name(j) for j, s in enumerate(layout.grid.position_ids)}
    why = {row: renamed(text, names) for row, text in (why | screened.why).items()}
    table = curve_posterior(fit.posterior.network, fit.posterior.covariance)
    lengths, scale = _length_test(fit, limits.test_significance)
    covariance = scale**2 * _enlarged(fit, table)
    slips = None
    if shifts is not None:
        slips = slips_among(shifts, problem.slip, limits.rejection_significance, scale)
    unseen = 0.0 if slips is None else _by_curve(slips.covariance())
    gathered = screened.gathering.covariance()
    unseen += 0.0 if gathered is None else _by_curve(gathered)
    check_curves(table, fit.posterior.network.state.places, limits.max_station_std)
    idle = {row for row, text in absent.items() if text.startswith("repeats")}
    return SixSolution(
        problem=problem,
        layout=layout,
        grid=scaled(screened.grid, screened.noise.factors),
        noise=screened.noise,
        fit=fit,
        table=table,
        covariance=covariance + unseen,
        lengths=lengths,
        scale=scale,
        closures=_closures(layout, table, covariance, problem.upward),
        rejected=absent | why,
        n_lengths=len(problem.length) - len(idle),
        n_rejected=len(absent) - len(idle) + len(why),
        jumps=jumps,
        slips=slips,
        gathering=screened.gathering,
    )


def _grouping(problem: SixProblem) -> Grouping:
    """Return what makes the groups of this ``problem``."""
    order = problem.measuring_order

    def grouping(grid: Grid, fit: Adjustment) -> tuple[Group, ...]:
        assert isinstance(fit, RigidAdjustment)
        return groups_of(grid, fit, order)

    return grouping


def _unbroken(
    problem: SixProblem,
    adjuster: RigidAdjuster,
    screened: ScreenedLengths,
    coarse: Grid,
    start: Floats,
) -> tuple[ScreenedLengths, tuple[Jump, ...], Shifts | None]:
    """Return ``screened`` with zeros split where they jump, the jumps, and what shifts would do.

    Zeros that belong to a single station are not looked at: their jumps are outliers.
    """
    jumps: list[Jump] = []
    if problem.zero == "per_station" or problem.slip == 0.0:
        return screened, (), None
    order = problem.measuring_order
    while True:
        fit = screened.fit
        assert isinstance(fit, RigidAdjustment)
        shifts = find_shifts(fit, order)
        jump = find_broken_zero(fit, shifts, problem.settings.rejection_significance)
        if jump is None or len(jumps) == MOST_JUMPS:
            return screened, tuple(jumps), shifts
        jumps.append(jump)
        layout, state = split(adjuster.layout, adjuster.state, coarse, jump, order)
        adjuster = replace(adjuster, layout=layout, state=state)
        screened = adjust_and_screen(adjuster, coarse, start, problem.settings, _grouping(problem))


def _without_gross(
    layout: StationLayout, state: NetworkState, significance: float
) -> tuple[Grid, Floats, dict[int, str]]:
    """Return the grid without gross errors, start values (V, 4), and why lengths were rejected.

    Station by station, as far as the lengths of a station have one zero; where these are too few,
    it is left to the network.
    """
    grid, most = layout.grid, layout.most
    zero = layout.zero[np.arange(len(most)), np.argmax(most, axis=1)]
    start = np.column_stack([state.stations(layout), state.zeros[zero]])
    if (most.sum(axis=1) < STATION_MINIMUM).any():
        return grid, start, {}
    coarse, why = reject_gross(adjust_stations, replace(grid, used=most), start, significance)
    return replace(coarse, used=coarse.used | (grid.used & ~most)), start, why


def _length_test(fit: RigidAdjustment, significance: float) -> tuple[GlobalTest, float]:
    """Return the test of chi-squared, and the factor by which noise is larger than it allows."""
    dof = max(fit.dof, 1)
    test = GlobalTest(float(np.sqrt(fit.chi2 / dof)), chi2_sf(fit.chi2, dof))
    return test, test.enlargement(significance) if fit.dof > 0 else 1.0


def _enlarged(fit: RigidAdjustment, table: CurvePosterior) -> Floats:
    """Return the covariance (6, m, 6, m) with what is not known of the scatter."""
    network, after = fit.posterior.network, fit.posterior
    covariance = table.covariance
    if fit.scatter.estimated:
        gain = table.jacobian @ after.covariance[network.layout.size :] @ pulled(network).T
        by_station = gain.reshape(len(gain), -1, 3)
        arms = network.state.arms(network.layout)
        across = turned(arms)
        # what a unit of squared shift, and of squared turn, of all stations adds to each variance
        slope = np.stack(
            [
                (by_station**2).sum(axis=(1, 2)),
                ((by_station.swapaxes(0, 1) @ across).swapaxes(0, 1) * by_station).sum(
                    axis=(1, 2)
                ),
            ]
        )
        used = fit.scatter.weighing(arms)
        factor = enlargement(fit.scatter, used, covariance.diagonal(), slope)
        covariance = covariance * factor * factor[:, None]
    return _by_curve(covariance)


def _by_curve(covariance: Floats) -> Floats:
    """Return (6, m, 6, m) of a covariance (6 m, 6 m): d of all positions, then c."""
    m = len(covariance) // 6
    ordered = covariance.reshape(2, m, 3, 2, m, 3).transpose(0, 2, 1, 3, 5, 4)
    return np.ascontiguousarray(ordered.reshape(6, m, 6, m))


def _closures(
    layout: StationLayout, table: CurvePosterior, covariance: Floats, upward: Bools | None
) -> dict[str, tuple[CircleClosure, ...]]:
    """Return for each component what whole turns apart should agree."""
    ids = layout.position_ids
    side = None if upward is None else upward[ids]
    columns = np.concatenate([table.curves.translation, table.curves.rotation], axis=1)
    return {
        name: closures(
            layout.angles, columns[:, at], LowRank.whole(covariance[at, :, at]), ids, side
        )
        for name, at in PLACE.items()
    }
