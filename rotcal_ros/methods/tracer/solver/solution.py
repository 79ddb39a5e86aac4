"""A problem solved by the engine: the error motion that nobody stated, slips, the paper's own way.

What nobody stated is asked of a first solution without it, and stated for the last one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from math import sqrt
from typing import Final, NamedTuple

import numpy as np
from scipy.sparse import csr_array, hstack, identity, kron
from scipy.special import ndtr

from rotcal_ros.adjust.bordered import SparseDesign
from rotcal_ros.adjust.causes import start_diagnosis
from rotcal_ros.adjust.effects import family_limit
from rotcal_ros.adjust.engine import Adjusted, Trials
from rotcal_ros.adjust.engine import adjust as adjusted
from rotcal_ros.adjust.fit import Fit, fit_model
from rotcal_ros.adjust.look import SolutionView
from rotcal_ros.adjust.mapped import with_outputs_of_map
from rotcal_ros.adjust.model import CurveModel
from rotcal_ros.adjust.observable import observe_family
from rotcal_ros.adjust.outputs import Outputs
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.compact import CompactCovariance, Spread, written
from rotcal_ros.foundation.errors import DataError, ObservabilityError, RotcalError
from rotcal_ros.foundation.language import noted, phrase
from rotcal_ros.foundation.protection import POWER, TOLERABLE, Protection
from rotcal_ros.foundation.results import ErrorMotion
from rotcal_ros.geometry.rotations import rotation_about_z
from rotcal_ros.methods.tracer.solver.carried_lengths import CarriedLengths
from rotcal_ros.methods.tracer.solver.circle import (
    ABSORBED,
    TableMotion,
    bearing_slopes,
    check_sense,
    from_first,
    table_motion,
)
from rotcal_ros.methods.tracer.solver.observability import (
    check_station_rank,
    check_station_spread,
    limits_of,
    told_of_a_turned_sign,
)
from rotcal_ros.methods.tracer.solver.posed import (
    ERROR_MOTION,
    FREE_CIRCLE,
    ROUND,
    STATED_CIRCLE,
    AssumedParameters,
    PosedProblem,
)
from rotcal_ros.methods.tracer.solver.problem import Grid, TracerProblem
from rotcal_ros.methods.tracer.solver.reported import (
    ReportedPlaceWeight,
    nearest_weight,
    weigh_reported_places,
)
from rotcal_ros.methods.tracer.solver.station_by_station import (
    distances_and_directions,
    locate_stations,
)
from rotcal_ros.methods.tracer.solver.turning import (
    TimeCorrelatedLengths,
    TurningRuns,
    in_time,
    scatter_beside_low_orders,
)
from rotcal_ros.methods.tracer.solver.turning_report import TurningReport

SLIPS_FOUND: Final = noted(
    "{0} is found in {1:.0f} % of the cases, by these lengths in this order; the uncertainty "
    "holds what the others do"
)

NEARLY: Final = 1e-3
"""How well (m) the targets of a free network are known where it starts."""
CANDIDATES: Final = 256
"""Moments that stand for all at which a counter may slip."""
SLIPPED: Final = 0.5
"""Probability that a measurement holds a slip."""
LIKELY_WALK: Final = 2e-8
"""Walk of a zero (m) from which an unknown one is searched for."""
LEAST_WALK: Final = 1e-9
"""Walk that is none."""
LEAN: Final = 1e-4
"""Angle (rad) of an axis whose square is nothing."""
MOST_STEPS: Final = 6
SMALL: Final = 1e-3
"""Variance, as a share of that of the lengths, that is too small to matter."""


class UnseenSlips(NamedTuple):
    """A fringe of ``size`` (m) slipped unseen: the ``root`` (m, s) of what it adds, rad.

    ``found``: how probably one at any moment is found; ``worst``: what one that is not may do, in
    standard uncertainties.
    """

    size: float
    found: float
    root: Floats
    worst: float

    @property
    def variances(self) -> Floats:
        """What it adds to the variances (m,) of ECC, rad^2."""
        return np.asarray((self.root**2).sum(axis=1))

    def protection(self) -> Protection:
        """Return the statement about slips."""
        what = phrase("a counter that slips a fringe of {0:.3g} m", self.size)
        why = phrase(SLIPS_FOUND, what, 100 * self.found)
        if self.worst > TOLERABLE:
            return Protection("slip", "not protected", phrase("{0} on average", why), self.worst)
        if self.found >= POWER:
            why = phrase("{0} makes the lengths disagree, and is found", what)
            return Protection("slip", "tested", why, self.worst)
        return Protection("slip", "bounded", why, self.worst)


@dataclass(frozen=True, eq=False)
class TracerSolution:
    """A solved problem: how it was ``posed``, what the engine ``found`` with what is ``supposed``.

    ``contradicted``: the error motion that was stated, where stations leave their circle by more.
    ``printed`` (m, 4): stations and distances by the paper's equations; None: those of the model.
    ``slips``: those that would not be found; None where every station has a zero of its own. All
    arrays of stations follow ``positions``.
    """

    posed: PosedProblem
    found: Adjusted
    supposed: AssumedParameters
    contradicted: float | None = None
    printed: Floats | None = None
    slips: UnseenSlips | None = None
    reported: ReportedPlaceWeight | None = None
    in_time: TimeCorrelatedLengths | None = None

    @property
    def problem(self) -> TracerProblem:
        """What was asked."""
        return self.posed.problem

    @property
    def grid(self) -> Grid:
        """The lengths in their places."""
        return self.posed.grid

    @cached_property
    def lengths(self) -> CarriedLengths:
        """The lengths, with the unknowns that were solved."""
        return self.posed.lengths_of(self.supposed)

    @property
    def positions(self) -> Ints:
        """The table positions (m,) that have a station; those with too few lengths are absent."""
        return self.grid.position_ids

    @property
    def table_angles(self) -> Floats:
        """The commanded angles (m,) of the positions, rad."""
        return self.posed.lengths.angles

    @property
    def deviations(self) -> Floats:
        """ECC (m,) from the first, rad."""
        return self.found.value

    @cached_property
    def covariance(self) -> Floats:
        """Covariance (m, m) of ECC, rad^2."""
        return written(self.spread)

    @cached_property
    def spread(self) -> Spread:
        """The same in the form in which it is kept."""
        spread = self.found.spread
        if self.slips is None:
            return spread
        if isinstance(spread, CompactCovariance):
            return spread.plus(CompactCovariance.shared(self.slips.root))
        return np.asarray(spread + self.slips.root @ self.slips.root.T)

    @cached_property
    def std(self) -> Floats:
        """Standard uncertainties (m,) of ECC, rad."""
        unseen = 0.0 if self.slips is None else self.slips.variances
        return np.sqrt(self.found.std**2 + unseen)

    @cached_property
    def error_motion(self) -> ErrorMotion:
        """What is stated of the error motion, and what the circle of the stations shows."""
        model, fit, stated = self.found.model, self.found.fit, self.posed.motion
        name = ERROR_MOTION if self.problem.circle_std is None else STATED_CIRCLE
        rows = np.flatnonzero(model.of_component == model.components.index(name))
        checked, used = float(fit.redundancy[rows].sum()), float(fit.std[rows[0]])
        squares = float(((fit.residual[rows] / used) ** 2).sum())
        likely = used * sqrt(squares / checked) if checked > 0.0 else 0.0
        dof = max(len(self.stations) - ABSORBED, 0)
        if stated is not None and model.scatterings:
            used = stated
        elif model.scatterings:
            stated = self.contradicted
            used = sqrt(fit.sizes[model.scatterings[0]].squares.sum())
        return ErrorMotion(stated, likely, max(likely, used), dof, used)

    @property
    def _unknowns(self) -> Floats:
        x = self.found.fit.x[: self.found.model.size[1]]
        return x if self.in_time is None else np.asarray(self.in_time.places @ x)

    @cached_property
    def turns(self) -> TurningReport:
        """What is known of a table that turned."""
        again = self.problem.earlier[self.lengths.row]
        return TurningReport(self.lengths, again, self.found, self.in_time)

    @cached_property
    def stations(self) -> Floats:
        """Where the tracer stood (m, 3), m."""
        if self.printed is not None:
            return self.printed[:, :3]
        return self.posed.lengths.standing(self._unknowns)

    @property
    def distances(self) -> Floats:
        """Ranges (s,) at reading zero, m, of the zeros that lengths count from."""
        if self.printed is not None:
            return self.printed[:, 3]
        zeros = self.posed.lengths.zeros
        return zeros if self.supposed.walk else zeros + self.lengths.part(self._unknowns, "zero")

    @cached_property
    def targets(self) -> Floats:
        """Where the targets stood (n, 3), m."""
        if self.printed is not None:
            return self.grid.targets
        return np.asarray(self.grid.targets + self.lengths.part(self._unknowns, "target"))

    @cached_property
    def trials(self) -> Trials:
        """Measurements like this one, with all that its uncertainty holds."""
        trials = self.found.trials
        if self.slips is None:
            return trials
        return replace(trials, causes=np.hstack([trials.causes, self.slips.root]))

    @cached_property
    def motion(self) -> TableMotion:
        """Plane, circle and angles of the stations."""
        return table_motion(self.stations, self.table_angles)

    @property
    def lean(self) -> float:
        """Angle, rad, between the axis of the stations and that which they were posed about."""
        axis = self.posed.lengths.axes[:, 2]
        return float(np.linalg.norm(np.cross(axis, self.motion.plane.normal)))

    @cached_property
    def station_blocks(self) -> Floats:
        """The covariances (m, 3, 3) of the stations, each by itself, m^2."""
        fit, m = self.found.fit, len(self.stations)
        if self.printed is not None:
            white = _gains(self.posed, fit, self.printed) * np.where(fit.used, fit.std, 0.0)
            each = [csr_array(white)[a::3] for a in range(3)]
            every = [[np.asarray((a * b).sum(axis=1)) for b in each] for a in each]
            return np.asarray(self.found.scale**2 * np.moveaxis(np.array(every), 2, 0))
        # the variances of x, y, z and of the sums of two say what two have in common
        both = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0], [0, 1, 1], [1, 0, 1]])
        unknown, felt = self._moved_by
        begin = np.arange(0, 6 * unknown.size + 1, unknown.shape[1])
        rows = (both @ felt).ravel(), np.repeat(unknown, 6, axis=0).ravel(), begin
        places = csr_array(rows, shape=(6 * m, self.found.model.size[1]))
        if self.in_time is not None:
            places = csr_array(places @ self.in_time.places)
        outputs = Outputs.alone(places)
        variance = fit.kernel.variances_of(outputs).reshape(m, 6)
        blocks = np.zeros((m, 3, 3))
        for a, (first, second) in enumerate(((0, 1), (1, 2), (0, 2))):
            blocks[:, a, a] = variance[:, a]
            between = 0.5 * (variance[:, 3 + a] - variance[:, first] - variance[:, second])
            blocks[:, first, second] = blocks[:, second, first] = between
        return np.asarray(self.found.scale**2 * blocks)

    @property
    def _moved_by(self) -> tuple[Ints, Floats]:
        """The unknowns (m, 5) that each station moves with, and by how much, (m, 3, 5)."""
        lengths, x, at = self.posed.lengths, self._unknowns, np.arange(len(self.stations))
        first = lengths.first
        arm = (self.stations - lengths.origin) @ lengths.axes
        arm = arm - lengths.part(x, "shift")
        turned = np.column_stack([-arm[:, 1], arm[:, 0], 0.0 * arm[:, 0]]) @ lengths.axes.T
        carry = rotation_about_z(lengths.angles + lengths.part(x, "turn")[:, 2])
        out = carry @ lengths.place_ways[:, 0] @ lengths.axes.T
        own = np.broadcast_to(lengths.axes, (len(at), 3, 3))
        felt = np.concatenate([own, turned[:, :, None], out[:, :, None]], axis=2)
        shifts = [3 * at, 3 * at + 1, 3 * at + 2]
        place = np.full(len(at), first["place"])
        return np.column_stack([*shifts, first["turn"] + at, place]), felt


def adjust(problem: TracerProblem) -> TracerSolution:
    """Return the solution of ``problem``; raises what :func:`~.solve.solve` raises."""
    return told_of_a_turned_sign(problem, _adjusted, lambda found: found.found.verdict == "ok")


def _adjusted(problem: TracerProblem) -> TracerSolution:
    posed = PosedProblem.of(problem)
    walk = LIKELY_WALK if problem.zero_walk_std is None else problem.zero_walk_std
    begin, along = AssumedParameters(walk=walk, weight=0.0), posed.moved
    begin = replace(
        begin, weight=1.0 if along is None else nearest_weight(posed.model(begin), along)
    )
    solution = _first(posed, begin)
    for _ in range(MOST_STEPS):
        if solution.lean < LEAN:
            break
        posed = posed.again(solution.stations)
        solution = _first(posed, begin)
    solution = _weighed(solution)
    scales = (e.sizes for e in solution.found.found_effects if e.effect.effect == "scale")
    if any(sizes.min() < -1.0 for sizes in scales):
        raise DataError("the lengths shrink while the distance grows")
    if problem.zero_walk_std is None:
        solution = _walking(solution)
    solution = _contradicted(solution)
    check_sense(solution.motion, solution.stations, solution.table_angles, solution.positions)
    if problem.variant == "station":
        solution = as_printed(solution)
    else:
        found = solution.found
        slips = unseen_slips(problem, found.fit, found.std, found.scale)
        solution = replace(solution, slips=slips)
    if not posed.grid.free:  # there a place depends on what defines it, and the angle does not
        check_station_spread(
            solution.stations, solution.station_blocks, solution.positions,
            problem.settings.max_station_std,
        )  # fmt: skip
    return solution


def _first(posed: PosedProblem, supposed: AssumedParameters) -> TracerSolution:
    found, noise = _solved(posed, supposed)
    return TracerSolution(posed, found, supposed, in_time=noise)


def _solved(
    posed: PosedProblem, supposed: AssumedParameters
) -> tuple[Adjusted, TimeCorrelatedLengths | None]:
    model, limits = posed.model(supposed), limits_of(posed.problem.settings)
    if posed.lengths.speed is not None:
        return _turned(posed, supposed)
    if posed.grid.free:  # too limber to be found from afar
        std = np.full_like(posed.grid.target_std, NEARLY)
        near = replace(posed, grid=replace(posed.grid, free=False, target_std=std))
        loose = near.model(supposed)
        every = np.ones(loose.size[0], dtype=np.bool_)
        missed = np.abs(loose.observed - loose.equations(loose.first)[0])
        model = replace(model, start=fit_model(loose, every, loose.std + missed, loose.first).x)
    return adjusted(model, limits), None


def _turned(
    posed: PosedProblem, supposed: AssumedParameters
) -> tuple[Adjusted, TimeCorrelatedLengths | None]:
    """Return the solution of a table that turned, with the noise in time that a first one shows.

    That takes readings to be independent, and places to be free across their circle.
    """
    model, limits = posed.model(supposed), limits_of(posed.problem.settings)
    first, lengths = start_diagnosis(model, limits), posed.lengths_of(supposed)
    if posed.motion is None:
        rows = np.flatnonzero(model.of_component == model.components.index(ERROR_MOTION))[0::2]
        runs = TurningRuns.of(lengths)
        other = max(
            scatter_beside_low_orders(runs, lengths.angles, first.fit.residual[rows]), ROUND
        )
        model = posed.model(replace(supposed, other=(other, other)))
        first = replace(first, model=model, start=first.fit.x).with_likely_scatter
    return in_time(first, lengths, posed.problem.earlier[lengths.row], limits)


def _weighed(solution: TracerSolution) -> TracerSolution:
    """Return the solution with the weight that the lengths give the reported places."""
    begin, posed = solution.supposed, solution.posed

    def again(weight: float, left: float) -> TracerSolution:
        return _again(solution, replace(begin, weight=weight, left=left))

    found, reported = weigh_reported_places(
        solution, begin.weight, posed.lengths, posed.moved, again
    )
    return replace(found, reported=reported)


def _again(solution: TracerSolution, supposed: AssumedParameters) -> TracerSolution:
    found, noise = _solved(solution.posed, supposed)
    return replace(solution, found=found, supposed=supposed, in_time=noise)


def _contradicted(solution: TracerSolution) -> TracerSolution:
    """Return the solution with the error motion that the stations show, if it is larger.

    Larger than stated; the lengths alone have to place them.
    """
    sizes, stated = next(iter(solution.found.fit.sizes.values()), None), solution.posed.motion
    significance = solution.problem.settings.test_significance
    if stated is None or sizes is None or sizes.probability >= significance:
        return solution
    unstated = replace(solution.problem, circle_std=None, error_motion_std=None)
    here = replace(solution, posed=replace(solution.posed, problem=unstated))
    try:
        alone = _again(here, solution.supposed)
    except RotcalError:
        return solution  # without the circle the lengths do not even place the stations
    stated = solution.problem.circle_std or stated
    if alone.error_motion.used <= stated:
        return solution
    return replace(alone, contradicted=stated)


def _walking(solution: TracerSolution) -> TracerSolution:
    """Return the solution with the walk of its zeros that the lengths support."""
    for _ in range(MOST_STEPS):
        components = list(solution.found.model.components)
        at = components.index("the walk of the zero")
        factor = float(solution.found.diagnosis.noise.factors[at])
        if factor == 1.0:
            break
        walk = solution.supposed.walk * factor
        if walk < LEAST_WALK:
            return _again(solution, replace(solution.supposed, walk=0.0))
        solution = _again(solution, replace(solution.supposed, walk=walk))
    return solution


def unseen_slips(
    problem: TracerProblem, fit: Fit, std: Floats, scale: float = 1.0
) -> UnseenSlips | None:
    """Return what a fringe that slipped unseen does, where lengths share zeros; else None.

    A measurement with one slip is taken to be as likely as one with none, and any moment of it as
    any other. What the test misses of each adds its expected square. ``std`` (m,) of ECC; the
    noise is ``scale`` times that of the ``fit``.
    """
    if problem.segment is None or not problem.slip:
        return None
    effect = next(e for e in fit.model.effects if e.effect == "slip")
    steps = effect.whole(fit.computed)
    steps = steps[:, :: max(1, -(-steps.shape[1] // CANDIDATES))]
    if not steps.shape[1]:
        return None
    seen = observe_family(fit, steps)
    limit = family_limit(problem.settings.rejection_significance, seen.alike)
    apart = problem.slip * np.sqrt(np.maximum(seen.information[:, 0, 0], 0.0)) / scale
    missed = 1.0 - ndtr(apart - limit)
    moved = problem.slip * seen.moved[:]
    root = moved.T * np.sqrt(SLIPPED / len(missed) * missed)
    counts = std > 0.0
    hidden = moved[missed > 1.0 - POWER][:, counts] / std[counts]
    worst = float(np.abs(hidden).max(initial=0.0))
    return UnseenSlips(problem.slip, 1.0 - float(missed.mean()), root, worst)


def as_printed(solution: TracerSolution) -> TracerSolution:
    """Return what the paper's equations make of the same lengths, and what that is off by.

    Station by station (Eq. 5-17), plane, circle and angles (Eq. 18-33), from the lengths that were
    not left out, less the effects that were found.
    """
    posed, found = solution.posed, solution.found
    lengths, fit, grid = posed.lengths, found.fit, posed.grid
    k = len(lengths.row)
    effects = fit.x[found.model.size[1] :]
    taken = [e.columns for e in found.diagnosis.nuisance]
    read = found.model.observed[:k]
    if taken:
        read = read - np.hstack(taken)[:k] @ effects
    length, used = np.zeros(grid.used.shape), np.zeros(grid.used.shape, dtype=np.bool_)
    strip = lengths.position  # every station has a zero of its own
    length[strip, lengths.target], used[strip, lengths.target] = read, fit.used[:k]
    start = np.column_stack([solution.stations, solution.distances])
    weights = np.zeros(used.shape)
    weights[strip, lengths.target] = fit.used[:k] / _variance(posed, fit, start)
    _, unit = distances_and_directions(start[:, :3], grid.targets)
    rows = np.concatenate([unit, -np.ones((*used.shape, 1))], axis=2)
    check_station_rank(rows * used[:, :, None], grid.position_ids)
    state, settled = locate_stations(grid.targets, length, weights, start)
    if not settled.all():
        worst = grid.position_ids[np.flatnonzero(~settled)[0]]
        raise ObservabilityError(f"station {worst} does not settle by its own lengths alone")
    here = replace(solution, printed=state)
    felt = from_first(bearing_slopes(state[:, :3], here.motion)).after(_gains(posed, fit, state))
    if taken:
        own = slice(found.model.size[1], len(fit.x))
        felt = felt.fixed(np.hstack(taken), fit.gain(own) / fit.std)
    white = felt.weighted(np.where(fit.used, fit.std, 0.0))
    other = with_outputs_of_map(found, here.motion.cumulative, white, np.zeros(len(white)))
    judged = SolutionView(found.diagnosis, other.fit).diagnosis
    return replace(here, found=Adjusted(judged, other.fit))


def ecc_of_stations(posed: PosedProblem, fit: Fit, state: Floats) -> Floats:
    """Return the covariance (m, m) of ECC by the paper's equations, at stations (m, 4), rad^2."""
    stations = state[:, :3]
    slopes = from_first(bearing_slopes(stations, table_motion(stations, posed.lengths.angles)))
    white = slopes.after(_gains(posed, fit, state)).weighted(np.where(fit.used, fit.std, 0.0))
    return white.products()


def _variance(posed: PosedProblem, fit: Fit, state: Floats) -> Floats:
    """Return the variances (k,) of lengths to targets that are taken as known, m^2."""
    lengths, k = posed.lengths, len(posed.lengths.row)
    _, unit = distances_and_directions(state[:, :3], posed.grid.targets)
    beam = unit[lengths.position, lengths.target]
    target = (beam**2 * posed.grid.target_std[lengths.target] ** 2).sum(axis=1)
    return np.asarray(fit.std[:k] ** 2 + target)


def _gains(posed: PosedProblem, fit: Fit, state: Floats) -> csr_array:
    """Return by how much stations (m, 4) are off for errors of all observations, (3 m, n).

    Of what is stated beside the lengths: a target's coordinate that is off makes its lengths so;
    an error motion carries the station away.
    """
    lengths, m = posed.lengths, len(state)
    k = len(lengths.row)
    _, unit = distances_and_directions(state[:, :3], posed.grid.targets)
    beam = unit[lengths.position, lengths.target]
    rows = np.column_stack([beam, -np.ones(k)])
    weight = fit.used[:k] / _variance(posed, fit, state)
    normal = np.zeros((m, 4, 4))
    np.add.at(normal, lengths.position, rows[:, :, None] * (rows * weight[:, None])[:, None])
    own = np.einsum("kab,kb->ka", np.linalg.inv(normal)[lengths.position], rows * weight[:, None])
    design, begin = fit.model.linearised(fit.x[: fit.model.size[1]])[1], lengths.first["target"]
    few = (
        design.few[k:]
        if isinstance(design, SparseDesign)
        else design.rows(np.arange(k, len(fit.std)))
    )
    known, axis = csr_array(few), np.arange(3)
    coordinate = 3 * lengths.position[:, None] + axis
    row = coordinate.ravel(), np.repeat(coordinate, 3, axis=1).ravel()
    column = np.repeat(np.arange(k), 3), np.tile(3 * lengths.target[:, None] + axis, 3).ravel()
    by_length = csr_array((own[:, :3].ravel(), (row[0], column[0])), shape=(3 * m, k))
    each = (own[:, :3, None] * beam[:, None]).ravel(), (row[1], column[1])
    by_target = csr_array(each, shape=(3 * m, posed.grid.targets.size))
    moves = kron(identity(m), lengths.axes, format="csr")
    of_known = by_target @ known[:, begin : begin + posed.grid.targets.size].T
    return csr_array(hstack([by_length, of_known + moves @ known[:, : 3 * m].T], format="csr"))


def curve_model(problem: TracerProblem, solution: TracerSolution | None = None) -> CurveModel:
    """Return the lengths over ECC at their positions, to be solved with other instruments.

    What these lengths say of the error motion, their zeros and reported places comes from their
    ``solution``; None where they have none alone, and then ObservabilityError if no error motion
    is stated. Slips that would not be found are errors that lengths have in common.
    """
    if solution is not None:
        posed, supposed = solution.posed, solution.supposed
    else:
        if problem.error_motion_std is None and problem.circle_std is None:
            raise ObservabilityError(
                "these lengths alone do not determine the error motion of the table, which they "
                "have to be weighed by beside other instruments: state solver.error_motion_std_m"
            )
        joint = replace(problem, variant="joint")
        # as many lengths as a circle asks for: the error motion ties stations to theirs
        few = replace(joint, circle_std=problem.circle_std or FREE_CIRCLE)
        posed = replace(PosedProblem.of(few, alone=False), problem=joint)
        supposed = AssumedParameters(walk=problem.zero_walk_std or 0.0)
    model = posed.model(supposed)
    m, begin = len(posed.lengths.angles), posed.lengths.first["turn"]
    model = replace(model, outputs=np.zeros((0, model.size[1])))
    lengths = posed.lengths
    if problem.segment is not None and problem.slip:
        found = 0.0 if solution is None or solution.slips is None else solution.slips.found
        step = problem.slip * sqrt(SLIPPED / len(lengths.row) * (1.0 - found))
        slips = slips_of(lengths.zero, lengths.order, step, float(lengths.std.min()))
        if slips.shape[1]:
            model = model.with_common_errors(
                np.pad(slips, ((0, model.size[0] - len(slips)), (0, 0)))
            )
    curve = np.eye(m, model.size[1], begin)
    return CurveModel(model, lengths.angles, {"ECC": curve})


def slips_of(zero: Ints, order: Ints, step_std: float, std: float) -> Floats:
    """Return columns (k, r) of what slips by ``step_std`` (m) at any moment do to the lengths.

    ``zero``, ``order`` (k,): which zero each has, and when it was taken. What is small against
    noise of ``std``, m, is left out.
    """
    found = [np.zeros((len(zero), 0))]
    for number in np.unique(zero) if step_std else ():
        rows = np.flatnonzero(zero == number)
        rows = rows[np.argsort(order[rows], kind="stable")]
        later = np.tri(len(rows))[:, 1:]
        size, ways = np.linalg.eigh(step_std**2 * later @ later.T)
        large = size > SMALL * std**2
        columns = np.zeros((len(zero), int(large.sum())))
        columns[rows] = ways[:, large] * np.sqrt(size[large])
        found.append(columns)
    return np.hstack(found)
