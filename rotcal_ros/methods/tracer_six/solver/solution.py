"""The rigid table's network of lengths as an adjustment, and all that follows but the verdict.

The tracer's screening and noise estimate work on it as on any other adjustment. Stations are the
arrivals of the table at a position in one run; their scatter from arrival to arrival is adjusted
beside the unknowns.

Start values: stations by multilateration, then poses by rigid fits. Targets in one plane leave two
images of each station; the nominal places show which is meant. A position without three of its
stations starts at its commanded angle.

Jumps of a zero are searched for as with a single place (:mod:`~..lengths.zeros`). Lengths
of a run that grow by the same amount from some moment on look like a place that rose there, and
three places always have a plane: where no angle is measured again in the same run, most of a slip
is taken for tilts and heights of the table.

Trials: each is solved to the end, by Gauss-Newton with its exact slopes and the normal matrix of
the measurement; one by one, for the table turns in space.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Final

import numpy as np

from rotcal_ros.adjust.closures import Closure, closures
from rotcal_ros.adjust.groups import Group, Undivided
from rotcal_ros.adjust.low_rank import LowRank
from rotcal_ros.adjust.noise import GlobalTest
from rotcal_ros.adjust.sensitivity import Sensitivity
from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.components import COMPONENTS, unit_of
from rotcal_ros.foundation.errors import DataError, ObservabilityError
from rotcal_ros.geometry.rotations import align, rotation_about_z
from rotcal_ros.methods.tracer.solver.observability import or_prior, told_of_a_turned_sign
from rotcal_ros.methods.tracer.solver.problem import STATION_MINIMUM, Grid
from rotcal_ros.methods.tracer.solver.start import start_candidates
from rotcal_ros.methods.tracer_six.lengths.adjustment import Adjustment, adjust_stations
from rotcal_ros.methods.tracer_six.lengths.joint import felt_by_targets, target_test
from rotcal_ros.methods.tracer_six.lengths.network import LengthView
from rotcal_ros.methods.tracer_six.lengths.screening import (
    Grouping,
    ScreenedLengths,
    adjust_and_screen,
    groups_of,
    reject_gross,
    scaled,
)
from rotcal_ros.methods.tracer_six.lengths.verdict import LengthEvidence
from rotcal_ros.methods.tracer_six.lengths.zeros import (
    MOST_JUMPS,
    Jump,
    ShiftResponse,
    Shifts,
    ShiftSearch,
    Slips,
    TimedLengths,
    slips_among,
)
from rotcal_ros.methods.tracer_six.solver.network import (
    CurvePosterior,
    LengthNetwork,
    NetworkState,
    Posterior,
    curve_posterior,
    pattern_gradient,
    posterior,
    pulled,
    relax,
    scattered,
    slopes,
    table_curves,
)
from rotcal_ros.methods.tracer_six.solver.problem import (
    SixProblem,
    StationLayout,
    lay_out,
    lost_direction,
    timing,
)
from rotcal_ros.methods.tracer_six.solver.scatter import (
    Moves,
    Scatter,
    contrasts,
    enlargement,
    estimate,
    moves,
    roots_of,
    stated,
    turned,
)

MOST_STEPS: Final = 6
"""Steps of a trial; what has not settled then is quicker solved alone."""
SETTLED: Final = 1e-10
"""Squared length, in standard deviations, of a last step that left nothing to do."""
RANK_TOLERANCE: Final = 1e-13
"""Eigenvalue, as a share of the largest, of a direction that the lengths leave open."""
CURE: Final = (
    "measure more targets, spread low around the table, from places 120 degrees apart, or keep "
    "the beam unbroken (fewer zeros)"
)
NEAR: Final = 0.05
"""Distance (m) from its nominal place beyond which a multilaterated station is not believed."""
ROUNDS: Final = 2
"""Poses from places, then places from poses: each round takes nearly all that nominals lack."""
NONE: Final = stated(0.0, 0.0)
"""The scatter of a table that repeats."""


@dataclass(frozen=True, eq=False)
class RigidAdjustment(Adjustment):
    """An adjustment whose stations follow a rigid table, ``posterior`` and ``scatter`` with it."""

    posterior: Posterior = None  # type: ignore[assignment]
    scatter: Scatter = NONE


@dataclass(frozen=True, eq=False)
class RigidAdjuster:
    """Adjusts a grid with the table rigid, from one ``state``; ``stated`` scatter in m and rad.

    A scatter that is not known is estimated anew each time, so that it does not pass for noise.
    """

    layout: StationLayout
    state: NetworkState
    stated: tuple[float | None, float | None]
    significance: float

    def __call__(
        self, grid: Grid, start: Floats, targets: Floats | None = None
    ) -> RigidAdjustment:
        """Return the adjustment of ``grid``; it starts from its own state, whatever is given."""
        network, scatter = _solve_network(
            grid, self.layout, self.state, self.stated, self.significance
        )
        return _adjustment(network, scatter)


def _solve_network(
    grid: Grid,
    layout: StationLayout,
    state: NetworkState,
    known: tuple[float | None, float | None],
    significance: float,
) -> tuple[LengthNetwork, Scatter]:
    """Return the network at its minimum with the scatter that it shows, or that is ``known``."""
    network = relax(grid, layout, None, state)
    _check_determined(network)
    arms = network.state.arms(layout)
    scatter = estimate(contrasts(network, arms), *known, significance)
    roots = scatter.roots(arms)
    if roots is not None:
        network = relax(grid, layout, roots, network.state)
    return network, scatter


def _adjustment(network: LengthNetwork, scatter: Scatter) -> RigidAdjustment:
    grid, layout, state = network.grid, network.layout, network.state
    after = posterior(network)
    felt = (network.slopes.unit @ after.arrived[:, :, None])[:, :, 0]
    corrections, redundancy, coupling = felt_by_targets(grid, state.targets, after.targets)
    unknowns = layout.size + 6 * len(layout.angles)
    rank = unknowns - network.reduced.constraints.shape[1]
    extra = 0 if grid.free else state.targets.size
    extra += 0 if layout.tilt_std is None else 2 * len(layout.angles)
    return RigidAdjustment(
        stations=state.stations(layout) + after.arrived,
        distances=state.zeros[layout.zero[:, 0]],
        targets=state.targets,
        residual=-(network.slopes.error + felt),
        std=grid.length_std,
        redundancy=grid.used - grid.weights * after.leverage,
        chi2=network.slopes.chi2,
        dof=int(grid.used.sum()) + extra - rank,
        unknowns=unknowns,
        rank=rank,
        target_test=target_test(corrections, redundancy),
        corrections=corrections,
        target_redundancy=np.diagonal(redundancy, axis1=1, axis2=2),
        coupling=coupling,
        posterior=after,
        scatter=scatter,
    )


def _check_determined(network: LengthNetwork) -> None:
    """Raise ObservabilityError where more stays open than is known in advance."""
    values, vectors = np.linalg.eigh(network.reduced.regular())
    missing = int((values < RANK_TOLERANCE * values[-1]).sum())
    if missing:
        raise ObservabilityError(
            f"the lengths leave {missing} more direction(s) open than expected; the weakest moves "
            f"most {_unknown(network, network.reduced.scale * vectors[:, 0])}: {CURE}"
            f"{or_prior(free=network.layout.grid.free)}"
        )


def check_curves(table: CurvePosterior, places: Floats, limit: float) -> None:
    """Raise ObservabilityError where a curve is known worse than ``limit`` of the radius.

    ``places`` (p, 3): of the tracer on the table, m.
    """
    m = len(table.curves.rotation)
    std = np.sqrt(np.maximum(table.covariance.diagonal(), 0.0)).reshape(2, m, 3)
    radius = float(np.linalg.norm(places - places.mean(axis=0), axis=1).max())
    share = std / np.array([radius, 1.0])[:, None, None]
    kind, position, axis = np.unravel_index(np.argmax(share), share.shape)
    if share[kind, position, axis] > limit:
        factor, unit = unit_of(COMPONENTS[3 * kind + axis])
        raise ObservabilityError(
            f"{COMPONENTS[3 * kind + axis]} at position {position} is known to "
            f"{std[kind, position, axis] / factor:.2g} {unit} only (standard deviation): {CURE}"
        )


def _unknown(network: LengthNetwork, direction: Floats) -> str:
    layout = network.layout
    index = int(np.argmax(np.abs(direction)))
    n, p = len(network.state.targets), len(network.state.places)
    if index < 3 * n:
        return f"target {layout.grid.target_ids[index // 3]} along {'xyz'[index % 3]}"
    if index < 3 * (n + p):
        place = layout.place_ids[index // 3 - n]
        return f"the tracer's place {place} along {'xyz'[index % 3]}"
    if index < 3 * (n + p) + layout.n_zeros:
        return "a zero of the lengths"
    return "the tilt of the table in the machine"


def find_start(layout: StationLayout) -> NetworkState:
    """Return start values for ``layout``; raises DataError when places and lengths contradict."""
    grid = layout.grid
    about = rotation_about_z(layout.angles)
    nominal = (about[layout.position] @ layout.places[layout.place][:, :, None])[:, :, 0]
    most = layout.most
    found = start_candidates(grid.targets, grid.length, most)[:, :, :3]
    away = np.linalg.norm(found - nominal, axis=2)
    best = np.argmin(away, axis=0)
    each = np.arange(len(best))
    near = away[best, each] < NEAR
    _check_near(layout, near | (most.sum(axis=1) < STATION_MINIMUM), away[best, each])
    stations = np.where(near[:, None], found[best, each], nominal)
    rotation, translation, places = about, np.zeros((len(about), 3)), layout.places
    for _ in range(ROUNDS):
        rotation, translation = _poses(layout, stations, near, places, about)
        back = (stations - translation[layout.position])[:, None] @ rotation[layout.position]
        # a place whose stations are all lost keeps its nominal one, which they then stand at
        weight = layout.by_place * np.where(near, 1.0, 1e-9)
        places = (weight / weight.sum(axis=1, keepdims=True)) @ back[:, 0]
    tilts = np.zeros(0 if layout.tilt_std is None else 4)
    state = NetworkState(
        rotation, translation, places, np.zeros(layout.n_zeros), grid.targets.copy(), tilts
    )
    distance = np.linalg.norm(state.stations(layout)[:, None] - grid.targets, axis=2)
    apart = np.where(grid.used, distance - grid.length, 0.0)
    total = np.bincount(layout.zero.ravel(), apart.ravel(), minlength=layout.n_zeros)
    count = np.bincount(layout.zero.ravel(), grid.used.ravel(), minlength=layout.n_zeros)
    state.zeros[:] = total / np.maximum(count, 1)
    return state


def _poses(
    layout: StationLayout, stations: Floats, near: Bools, places: Floats, about: Floats
) -> tuple[Floats, Floats]:
    """Return rotations (m, 3, 3) and translations (m, 3) that take ``places`` to ``stations``."""
    rotation, translation = about.copy(), np.zeros((len(about), 3))
    for i in range(len(about)):
        here = np.flatnonzero((layout.position == i) & near)
        own = places[layout.place[here]]
        if lost_direction(own) is None:
            rotation[i], translation[i] = align(own, stations[here])
    return rotation, translation


def _check_near(layout: StationLayout, near: Bools, away: Floats) -> None:
    if np.mean(near) > 0.5:
        return
    worst = int(np.argmax(away))
    raise DataError(
        f"{layout.station_name(worst)}: the lengths put the tracer {away[worst]:.3g} m from its "
        f"nominal place, and {np.count_nonzero(~near)} of {len(near)} stations are farther than "
        f"{NEAR:g} m: check the places, the numbering of the positions, the sense of the table "
        "angles, and whether the targets are in the frame of the machine with z along the axis"
    )


@dataclass(frozen=True, eq=False)
class _RigidView(LengthView):
    """The linear view at a network whose stations follow a rigid table.

    Its outputs are the curves (6 m,): d of all positions, then c.
    """

    fit: RigidAdjustment

    @cached_property
    def _carried(self) -> Floats:
        """What the unknowns' errors of unit variance do to the curves, (6 m, T)."""
        network, covariance = self.fit.posterior.network, self.fit.posterior.covariance
        outputs = np.zeros((6 * len(network.layout.angles), len(covariance)))
        outputs[:, network.layout.size :] = curve_posterior(network, covariance).jacobian
        return np.asarray(outputs @ covariance)

    @cached_property
    def _stations(self) -> tuple[Floats, Floats]:
        """The own covariance (V, 3, 3) of stations, and how unknowns move them (V, 3, T)."""
        _, own, response = scattered(self.fit.posterior.network)
        return own, response.reshape(len(own), 3, -1)

    def _design(self, station: Ints, target: Ints) -> Floats:
        """Return what the unknowns do to lengths, (e, T)."""
        network, each = self.fit.posterior.network, np.arange(len(station))
        layout, towards = network.layout, network.slopes.unit[station, target]
        design = (towards[:, None] @ self._stations[1][station])[:, 0]
        design[each[:, None], 3 * target[:, None] + np.arange(3)] -= towards
        first_zero = 3 * (network.slopes.unit.shape[1] + len(layout.places))
        design[each, first_zero + layout.zero[station, target]] -= 1.0
        return np.asarray(design)

    def leverage(self, strip: Ints, target: Ints) -> Floats:
        towards = self.fit.posterior.network.slopes.unit[strip, target]
        beside = (towards[:, None] @ self._stations[0][strip])[:, 0] @ towards.T
        beside *= strip[:, None] == strip
        design = self._design(strip, target)
        return np.asarray(design @ self.fit.posterior.covariance @ design.T + beside)

    def sensitivity(self, strip: Ints, target: Ints) -> Sensitivity:
        return Sensitivity.whole(self._carried @ self._design(strip, target).T)


def respond(fit: RigidAdjustment, jacobian: Floats, patterns: Floats | Bools) -> ShiftResponse:
    """Return what ``patterns`` (k, V, n) of errors of the lengths, m, do to a network.

    And to its curves, by the ``jacobian`` (6 m, 6 m) of the poses.
    """
    network = fit.posterior.network
    here = pattern_gradient(network, patterns)
    step = here.slope @ fit.posterior.covariance
    both = (here.weighted[1:] * patterns[:-1]).sum(axis=(1, 2))
    both -= (step[1:] * here.slope[:-1]).sum(axis=1)
    return ShiftResponse(
        total=(here.weighted * patterns).sum(axis=(1, 2)),
        taken=(step * here.slope).sum(axis=1),
        both=both,
        moved=step[:, network.layout.size :] @ jacobian.T,
    )


def shift_search(fit: RigidAdjustment, order: Ints) -> ShiftSearch:
    """Return the search for shifts of the zeros, which move the curves (6 m).

    ``order`` (k,): when each row was taken. A jump's segment is the zero that broke.
    """
    network = fit.posterior.network
    jacobian = curve_posterior(network, fit.posterior.covariance).jacobian
    moments = TimedLengths.of(network.grid, order, network.layout.zero)
    found = partial(respond, fit, jacobian)
    return ShiftSearch(network.grid, fit, moments, found, len(jacobian), overlap=1)


def split(
    layout: StationLayout, state: NetworkState, grid: Grid, jump: Jump, order: Ints
) -> tuple[StationLayout, NetworkState]:
    """Return ``layout`` and ``state`` with a new zero from ``jump`` on."""
    filled = grid.row >= 0
    time = np.where(filled, order[grid.row], order.max())
    time = np.where(filled, time, time.min(axis=1, keepdims=True))
    later = (layout.zero == jump.segment) & (time >= order[jump.row])
    return replace(
        layout,
        zero=np.where(later, layout.n_zeros, layout.zero),
        offset=np.append(layout.offset, layout.offset[jump.segment]),
    ), replace(state, zeros=np.append(state.zeros, state.zeros[jump.segment]))


FITTING: Final = 3.0
"""Times the stated noise up to which lengths of the opposite sign are said to fit."""
PLACE: Final = {name: index for index, name in enumerate(COMPONENTS)}


@dataclass(frozen=True, eq=False)
class SixSolution:
    """A solved problem; ``grid`` has the standard deviations that were used, after ``noise``.

    ``table``: curves with their covariance as the network gives it; ``covariance`` (6, m, 6, m),
    in the order of COMPONENTS, what is known of them in the end: enlarged by ``scale`` for what
    the noise leaves unexplained, and for a scatter that few contrasts determine, and with what
    unseen ``slips`` of a fringe add. ``closures`` are tested without these: such a slip may open
    them. ``rejected`` says by row why a length was not used. ``evidence``: its test is with the
    noise that was used; what gathers in one place may do is in the covariance too; the segment of
    a jump is a zero of the ``layout``.
    """

    problem: SixProblem
    layout: StationLayout
    grid: Grid
    fit: RigidAdjustment
    table: CurvePosterior
    covariance: Floats
    scale: float
    closures: dict[str, tuple[Closure, ...]]
    rejected: dict[int, str]
    evidence: LengthEvidence
    slips: Slips | None = None

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
        return self.problem.missing(self.positions)

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
        lambda found: bool((found.scale * found.evidence.noise.factors < FITTING).all()),
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
    why = {row: layout.named(text) for row, text in (why | screened.why).items()}
    table = curve_posterior(fit.posterior.network, fit.posterior.covariance)
    lengths = GlobalTest.of(fit.chi2, fit.dof)
    scale = lengths.enlargement(limits.test_significance)
    covariance = scale**2 * _enlarged(fit, table)
    slips = slips_among(shifts, problem.slip, limits.rejection_significance, scale, asked=True)
    unseen = 0.0 if slips is None else _by_curve(slips.covariance())
    gathered = screened.gathering.covariance()
    unseen += 0.0 if gathered is None else _by_curve(gathered)
    check_curves(table, fit.posterior.network.state.places, limits.max_station_std)
    idle = {row for row, text in absent.items() if text.startswith("repeats")}
    return SixSolution(
        problem=problem,
        layout=layout,
        grid=scaled(screened.grid, screened.noise.factors),
        fit=fit,
        table=table,
        covariance=covariance + unseen,
        scale=scale,
        closures=_closures(layout, table, covariance, problem.upward),
        rejected=absent | why,
        evidence=LengthEvidence(
            lengths=lengths,
            noise=screened.noise,
            unexplained=scale,
            n_lengths=len(problem.length) - len(idle),
            n_rejected=len(absent) - len(idle) + len(why),
            unchecked=fit.unchecked(screened.grid),
            gathering=screened.gathering,
            jumps=jumps,
        ),
        slips=slips,
    )


def _grouping(problem: SixProblem) -> Grouping:
    """Return what makes the groups of this ``problem``."""
    order = problem.measuring_order

    def grouping(grid: Grid, fit: Adjustment) -> tuple[Group | Undivided, ...]:
        assert isinstance(fit, RigidAdjustment)
        return groups_of(grid, fit, _RigidView(fit), fit.residual, order)

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
        search = shift_search(fit, order)
        shifts = search.few()
        jump = search.jump(shifts, problem.settings.rejection_significance)
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
) -> dict[str, tuple[Closure, ...]]:
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


@dataclass(frozen=True, eq=False)
class SixTrials:
    """Draws measurements like the given one, without rejected lengths, and solves them.

    The measured lengths, targets and stated tilts get fresh noise, every arrival a fresh scatter,
    and a fringe slips as often as it would stay unseen. How large the scatter is follows that of
    the solution: as stated, or as likely as it was found.
    """

    solution: SixSolution

    @property
    def network(self) -> LengthNetwork:
        """The network of the measurement."""
        return self.solution.network

    def __call__(self, rng: np.random.Generator, count: int) -> Floats:
        """Return EXC, EYC, EZC (m), EAC, EBC, ECC (rad) at all angles, (count, 6 m)."""
        return np.array([self._solved(*self._drawn(rng)) for _ in range(count)])

    def _drawn(self, rng: np.random.Generator) -> tuple[Grid, StationLayout]:
        grid, layout, scale = self.network.grid, self.network.layout, self.solution.scale
        known = self.solution.scatter
        arms = self.network.state.arms(layout)
        shift, turn = known.variances[rng.choice(len(known.weights), p=known.weights)]
        spread = roots_of(shift, turn, arms) @ rng.standard_normal((len(arms), 3, 1))
        noise = scale * grid.length_std * rng.standard_normal(grid.length.shape)
        length = grid.length + noise + (self.network.slopes.unit @ spread)[:, :, 0]
        if self.solution.slips is not None:
            length += self.solution.slips.draw(grid, rng, 1)[0]
        if layout.tilt_std is not None:
            tilts = scale * layout.tilt_std * rng.standard_normal((len(layout.angles), 2))
            layout = replace(layout, tilts=tilts)
        if grid.free:
            return replace(grid, length=length), layout
        missed = scale * grid.target_std * rng.standard_normal(grid.targets.shape)
        return replace(grid, length=length, targets=grid.targets + missed), layout

    def _solved(self, grid: Grid, layout: StationLayout) -> Floats:
        state = self._settled(grid, layout)
        curves = table_curves(state.rotation, state.translation, self.network.layout.angles)
        return np.concatenate([curves.translation.T.ravel(), curves.rotation.T.ravel()])

    def _settled(self, grid: Grid, layout: StationLayout) -> NetworkState:
        state = self.network.state
        for _ in range(MOST_STEPS):
            here = slopes(grid, layout, self.network.scatter, state)
            kept, poses = self._step(-here.kept, -here.poses)
            state = state.moved(kept, poses.reshape(-1, 6))
            if abs(float(here.kept @ kept + here.poses.ravel() @ poses)) < SETTLED:
                return state
        return relax(grid, layout, self.network.scatter, state).state

    def _step(self, kept: Floats, poses: Floats) -> tuple[Floats, Floats]:
        """Return the steps (K,) and (6 m,) for right-hand sides (K,) and (m, 6)."""
        reduced = self.network.reduced
        x = reduced.covariance() @ (kept - reduced.transfer @ poses.ravel())
        own = (reduced.inverse @ poses[:, :, None]).ravel()
        return x, own - reduced.transfer.T @ x
