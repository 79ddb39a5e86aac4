"""The ball plate method from a problem to the result that all methods share, and trials of it.

The residuals of each fit are searched for what the fit takes no account of: a drift, a motion of
the plate, a table that does not repeat, disturbances in one place. What is found becomes a doubt;
what is probable, or allowed for by a statement, enlarges the covariances. What this order of
measurement would not show is said by the protections: one sentence for each effect that could
spoil a ball plate measurement.

The estimate is linear in the centres. So one matrix shows what errors of the centres do to the
curves, and makes Monte Carlo trials without solving each.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from rotcal_ros.adjust import gathering as engine
from rotcal_ros.adjust.engine import Trials
from rotcal_ros.adjust.low_rank import LowRank
from rotcal_ros.adjust.reliability import Hidden
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.components import COMPONENTS, ROTATIONS
from rotcal_ros.foundation.protection import TOLERABLE, Effect, Protection, ordered
from rotcal_ros.foundation.raw_data import MOST_INFLUENCES, Influence, RawData
from rotcal_ros.foundation.results import Residuals, Result, Verdict, plain_fields
from rotcal_ros.foundation.units import MICROMETRE
from rotcal_ros.geometry.rotations import rotation_about_z
from rotcal_ros.methods.ball_plate.solver import gathering, general_least_squares, model
from rotcal_ros.methods.ball_plate.solver.estimate import computed, drifted, solved
from rotcal_ros.methods.ball_plate.solver.growth import GrowthTest, likelier
from rotcal_ros.methods.ball_plate.solver.model import least_variance, of_component
from rotcal_ros.methods.ball_plate.solver.noise import CentreNoise
from rotcal_ros.methods.ball_plate.solver.order_effects import (
    DriftTest,
    OrderEffects,
    PlateMotion,
    drift_error,
    find_drift,
    find_motion,
    knock_error,
    order_effects,
)
from rotcal_ros.methods.ball_plate.solver.problem import BallPlateProblem
from rotcal_ros.methods.ball_plate.solver.rejection import Fitted
from rotcal_ros.methods.ball_plate.solver.repeated_stops import (
    MIN_BALLS_PER_STOP,
    PlateClosure,
    Repeatability,
    arrivals,
    closures,
    repeatability,
)
from rotcal_ros.methods.ball_plate.solver.screening import RADIUS_TOLERANCE
from rotcal_ros.methods.ball_plate.solver.separability import MIN_BALLS, separability
from rotcal_ros.methods.ball_plate.solver.solution import (
    PlateSolution,
    PositionGroup,
    adjust,
    allowed,
    groups_in_words,
    turned_back,
    zeros_of,
)

METHOD: Final = "ball_plate"
COVARIANCE_LIMIT = 720
"""Largest grid whose (N, N) covariance matrices are put into the result (25 MB)."""
CLOSED: Final = ("closed form", "closed form with drift")
NOT_CLOSED: Final = (
    "not all centres are left with equal weights, which the closed form needs: the least squares "
    "took its place (they are the same where both exist)"
)
MANY_REJECTED: Final = 0.02
"""Share of rejected centres from which on a result is suspect."""
LEAST_DOF: Final = 8
"""Degrees of freedom that a forecast of tests counts with at least."""


def solve(problem: BallPlateProblem) -> Result:
    """Return the table's six deviations with covariances from the centres of a ball plate.

    Screens the table, checks that the errors can be separated, solves by least squares,
    rejects centres that do not fit and looks for a moved plate. Standard deviations belong to
    the stated noise when its chi-square test passes, else to the one found in the residuals.
    Centres measured again at the end are compared with the first time instead of fitted; drift
    and motions of the plate are searched for in the order of the rows, and ``protections`` state
    what this order cannot show. Raises DataError for a table that is not what it says and
    ObservabilityError, with the harmonics that are lost, when balls and positions do not separate
    the errors.
    """
    return result_of(adjust(problem))


def result_of(solution: PlateSolution) -> Result:
    """Return what is known of a solved problem in the form that all methods share.

    A repeatability that is more than noise, stated allowances, and what probably gathers in one
    place enlarge the covariance.
    """
    problem, noise, rejected = solution.problem, solution.noise, solution.rejected
    found = [_findings(group, fit, noise, solution.whole) for group, fit in solution.parts]
    added, vectors = _added(solution, found), _residual_vectors(solution)
    covariance = {}
    if problem.bidirectional or problem.grid <= COVARIANCE_LIMIT:
        covariance = {n: solution.covariance(n) + added[n].dense() for n in COMPONENTS}
    doubts = _doubts(solution, found)
    result = Result(
        method=METHOD,
        angles=problem.angles[solution.table_positions],
        deviations=solution.deviations(),
        std={n: np.sqrt(s**2 + added[n].diagonal()) for n, s in solution.std().items()},
        covariance=covariance,
        sigma0=noise.sigma0,
        dof=sum(fit.solution.dof for _, fit in solution.parts),
        n_observations=len(problem.centres),
        rejected=rejected,
        verdict=_verdict(solution, bool(doubts)),
        warnings=(*_warnings(solution, found), *doubts),
        residuals=_residuals(solution, vectors),
        details=_details(solution, found, vectors),
        raw_data=RawData(influence=_influence(solution)),
    )
    result = replace(result, protections=_protections(result, solution, found))
    return result.counted_from(*zeros_of(solution))


@dataclass(frozen=True)
class Findings:
    """What the tests in the order of measurement found in one group of table positions.

    ``effects`` are what drift and knocks do in this order, in the frame of the group; all else is
    stated in the frame and the numbers of the whole. Drift, motion and growth of the plate and
    repeatability (``scatter``) are None where they cannot be estimated.
    """

    effects: OrderEffects
    drift: DriftTest | None
    motion: PlateMotion | None
    scatter: Repeatability | None
    growth: GrowthTest | None
    closures: tuple[PlateClosure, ...]


def _findings(
    group: PositionGroup, fit: Fitted, noise: CentreNoise, whole: BallPlateProblem
) -> Findings:
    """Run all tests of a group; where a knock is found already, there is no second search."""
    problem, solution = fit.problem, fit.solution
    effects, scatter = order_effects(problem, group.closing), _scatter(fit)
    closed: tuple[PlateClosure, ...] = ()
    grown: GrowthTest | None = None
    if group.closing is not None:
        lengths = np.zeros(6)
        if scatter is not None:
            lengths = scatter.significant_std * np.repeat([1.0, problem.radius], 3)
        # of fitted and of closing rows, no less than rounding
        least = np.sqrt(least_variance(problem, solution.estimate))
        std = np.maximum(noise.used / noise.weights, least)
        closed, grown = closures(
            problem,
            group.closing,
            (std, std * noise.weights),
            float(noise.dof.sum()),
            solution.drift,
            lengths,
        )
    fixed, on_table = rotation_about_z(group.turn), rotation_about_z(group.on_table)
    drift = find_drift(problem, solution, effects)
    motion = fit.knock or find_motion(problem, solution, effects)
    return Findings(
        effects,
        None if drift is None else drift.turned(fixed),
        None if motion is None else motion.in_whole(whole, on_table),
        None if scatter is None else scatter.turned(fixed),
        likelier([test for test in (fit.growth.test, grown) if test is not None]),
        tuple(replace(c.turned(fixed), position=int(group.positions[c.position])) for c in closed),
    )


def _scatter(fit: Fitted) -> Repeatability | None:
    """Return the table's repeatability from residuals of equal weight.

    Weights that were found for the axes already contain what the table scatters along them, as if
    it were noise: those are taken off, and all is solved once more.
    """
    problem, residuals = fit.problem, fit.solution.residuals
    if problem.std is not None and problem.weighed_alike:
        problem = replace(problem, std=None)
        residuals = solved(problem)[1].residuals
    return repeatability(problem, residuals)


def _warnings(solution: PlateSolution, found: Sequence[Findings]) -> list[str]:
    """Return what is known to limit the result, in words."""
    noise, warnings = solution.noise, list[str]()
    n_rejected, n_centres = len(solution.rejected), len(solution.problem.centres)
    n_positions = solution.problem.n_positions
    left_out = np.setdiff1d(np.arange(n_positions), solution.table_positions)
    if len(left_out):
        warnings.append(
            f"{len(left_out)} of {n_positions} table positions have fewer than "
            f"{MIN_BALLS} balls and are left out of the result: {', '.join(map(str, left_out))}"
        )
    if len(solution.parts) > 1:
        warnings.append(
            f"The offset between {groups_in_words(len(solution.parts))} is not measured: each "
            "group has its own zero"
        )
    for (_, fit), mine in zip(solution.parts, found, strict=True):
        if mine.motion is not None and mine.motion.knock:
            warnings.append(mine.motion.sentence())
        weak = separability(fit.problem.grid, fit.problem.balls).sentences()
        warnings += [sentence for sentence in weak if sentence not in warnings]
    if solution.problem.closed_form and any(
        f.solution.way not in CLOSED for _, f in solution.parts
    ):
        warnings.append(NOT_CLOSED)
    grown = any(fit.grown for _, fit in solution.parts)
    warnings += noise.sentences(own_std=solution.problem.std is not None, explained=grown)
    if n_rejected > MANY_REJECTED * n_centres:
        warnings.append(f"{n_rejected} of {n_centres} centres were rejected")
    drifts = (f.drift for f in found if f.drift is not None and f.drift.significant)
    return warnings + [drift.sentence() for drift in drifts if drift.estimated]


def _doubts(solution: PlateSolution, found: Sequence[Findings]) -> list[str]:
    """Return in words what the result takes no account of.

    A drift looks like a small motion, and either a little like a growth: only the likeliest of
    them is reported.
    """
    tests: list[DriftTest | PlateMotion | GrowthTest] = [
        *(f.growth for f in found if f.growth is not None),
        *(f.drift for f in found if f.drift is not None and not f.drift.estimated),
        *(f.motion for f in found if f.motion is not None and not f.motion.knock),
    ]
    likeliest = sorted((t for t in tests if t.significant), key=lambda t: t.p_value)[:1]
    return [
        *(test.sentence() for test in likeliest),
        *(closure.sentence() for f in found for closure in f.closures if not closure.closed),
        *(
            doubt
            for _, fit in solution.parts
            for doubt in engine.doubts(fit.gathering, gathering.LIMITS, gathering.WORDS)
        ),
    ]


def _verdict(solution: PlateSolution, doubtful: bool) -> Verdict:
    if any(fit.knock is not None for _, fit in solution.parts):
        return "failed"
    noise, share = solution.noise, len(solution.rejected) / len(solution.problem.centres)
    suspect = doubtful or (noise.contradicts and noise.larger) or share > MANY_REJECTED
    return "suspect" if suspect else "ok"


def _residual_vectors(solution: PlateSolution) -> Floats:
    """Return observed - computed (n, 3) of all rows, used or not, in the order of their numbers.

    NaN at table positions that were left out.
    """
    in_order = np.sort(solution.whole.rows)
    vectors = np.zeros((len(in_order), 3))
    for group, fit in solution.parts:
        solved_here = np.isin(group.problem.position, fit.problem.table_positions)
        problem, found = group.problem.take(solved_here), fit.solution.estimate
        # a rejected row may have a ball or a CMM position that no fitted row has: no error known
        cmm, plate = np.zeros((2, problem.grid, 3))
        cmm[fit.problem.cmm_positions] = found.cmm
        plate[fit.problem.balls] = found.plate
        predicted = computed(problem, found, plate[problem.ball_step], cmm[problem.cmm_index])
        predicted = predicted + drifted(problem, fit.problem, fit.solution.drift)
        residuals = np.full((len(solved_here), 3), np.nan)
        residuals[solved_here] = problem.centres - predicted
        vectors[np.searchsorted(in_order, group.problem.rows)] = turned_back(group, residuals)
    return vectors


def _residuals(solution: PlateSolution, vectors: Floats) -> Residuals:
    """Return one row per finite centre, in the order of their numbers, with lengths in space."""
    whole = solution.whole
    order = np.argsort(whole.rows)
    in_order, n = whole.rows[order], len(order)
    redundancy, test_value, std = np.zeros((3, n))
    used = np.zeros(n, dtype=np.bool_)
    for group, fit in solution.parts:
        noise = solution.noise.used * group.problem.noise_unit
        at = np.searchsorted(in_order, group.problem.rows)
        std[at] = np.sqrt(np.mean(np.square(noise), axis=1))
        at = np.searchsorted(in_order, fit.problem.rows)
        redundancy[at], test_value[at], used[at] = fit.test.redundancy, fit.test.value, True
    return Residuals(
        table_position=whole.position[order],
        target=whole.ball_step[order],
        residual=np.linalg.norm(vectors, axis=1),
        redundancy=redundancy,
        test_value=test_value,
        used=used,
        std=std,
        coordinates=3,
    )


def _details(
    solution: PlateSolution, found: Sequence[Findings], vectors: Floats
) -> dict[str, Any]:
    """Everything else the method knows, in SI; one entry per group under ``groups``."""
    whole, noise = solution.whole, solution.noise
    order = np.argsort(whole.rows)
    motions = [f.motion for f in found if f.motion is not None]
    findings: dict[str, list[dict[str, Any]]] = {
        "closure": [plain_fields(closure) for f in found for closure in f.closures],
        "drift": [plain_fields(f.drift) for f in found if f.drift is not None],
        "growth": [plain_fields(f.growth) for f in found if f.growth is not None],
        "plate_motion": [motion.details() for motion in motions if not motion.knock],
        "repeatability": [plain_fields(f.scatter) for f in found if f.scatter is not None],
    }
    return {
        "grid": whole.grid,
        "radius": whole.radius,
        "sigma_centre": noise.pooled,
        "sigma_used": float(np.sqrt(np.mean(noise.used**2))),
        "axis_noise": noise.details(),
        "chi_square": {
            "dof": sum(fit.solution.dof for _, fit in solution.parts),
            "p_value": noise.p_value,
            "passed": not noise.contradicts,
        },
        "groups": [
            _group_details(*part, mine.motion, noise.scale)
            for part, mine in zip(solution.parts, found, strict=True)
        ],
        "residual_rows": {
            "row": whole.rows[order],
            "cmm_index": whole.cmm_index[order],
            "vector": vectors,
        },
        "gathering": gathering.details([fit.gathering for _, fit in solution.parts]),
        **{name: each for name, each in findings.items() if each},
    }


def _group_details(
    group: PositionGroup, fit: Fitted, motion: PlateMotion | None, scale: Floats
) -> dict[str, Any]:
    problem, solution = fit.problem, fit.solution
    names = {
        "plate": "plate_errors",
        "cmm": "cmm_errors",
        "axis_rotation": "axis_rotation",
        "axis_shift": "axis_shift",
    }
    details: dict[str, Any] = {
        "way": solution.way,
        "table_positions": group.positions[problem.table_positions],
        "turn": group.turn,
        "ball_steps": problem.balls,
        "cmm_positions": problem.cmm_positions,
    }
    std = model.scaled(solution.unit_std, scale)
    for field, name in names.items():
        details[name] = getattr(solution.estimate, field)
        details[f"{name}_std"] = getattr(std, field)
    if motion is not None and motion.knock:
        details["knock"] = motion.details()
    return details


def _added(solution: PlateSolution, found: Sequence[Findings]) -> dict[str, LowRank]:
    """Return what repeatability, the allowances and one place add to each covariance (M, M)."""
    added = {name: LowRank.outer(allowed(solution, name)) for name in COMPONENTS}
    # a uniform distribution between the limits, alike along each axis
    drift = (0.0 if solution.problem.drift else solution.problem.drift_allowance) / np.sqrt(3.0)
    count = len(solution.table_positions)
    for (group, fit), place, mine in zip(solution.parts, solution.places(), found, strict=True):
        local = _of_places(fit, group.turn)
        turned = _turned(mine.effects.drift.response, group.turn)
        for row, name in enumerate(COMPONENTS):
            if drift:
                columns = np.zeros((count, turned.shape[2]))
                columns[place] = drift * turned[row]
                added[name] += LowRank.outer(columns)
            if mine.scatter is not None:
                own = np.zeros((count, 1, 1))
                own[place] = mine.scatter.added[row]
                added[name] += LowRank.of_blocks(own)
            if local is not None:
                whole = np.zeros((count, count))
                whole[np.ix_(place, place)] = local[row]
                added[name] += LowRank.whole(whole)
    return added


def _of_places(fit: Fitted, turn: float) -> Floats | None:
    """Return what disturbances that gather add to the covariances (6, M, M) of a fit.

    None where none is probable; large problems are not judged.
    """
    whole = fit.gathering.covariance()
    if whole is None:
        return None
    known, count = fit.problem.table_positions, fit.problem.n_positions
    # translations and rotations are vectors x, y, z: each is turned to the frame of the whole
    both = whole.reshape(2, 3, count, 2, 3, count)[:, :, known][..., known]
    back = rotation_about_z(turn)
    each: Floats = np.einsum("ij,bjmbkn,ik->bimn", back, both, back)
    return each.reshape(6, len(known), len(known))


def _turned(response: Floats, turn: float) -> Floats:
    """Bring the errors (6, M, m) of a group to the frame of the whole."""
    vectors = response.reshape(2, 3, *response.shape[1:])
    turned: Floats = np.einsum("ij,bj...->bi...", rotation_about_z(turn), vectors)
    return turned.reshape(response.shape)


def _protections(
    result: Result, solution: PlateSolution, found: Sequence[Findings]
) -> tuple[Protection, ...]:
    """Return all protections, of centres that do not show which way is up."""
    drift, knock, growth = _unseen_in_order(result, solution, found)
    return ordered(
        [
            _against_drift(solution.problem, drift),
            _against(
                "knock",
                knock,
                "a motion of the plate on the table contradicts earlier centres of the same balls",
                "a small motion of the plate between two stops may pass for deviations of the "
                "table: measure in the order interleaved, with more balls",
            ),
            Protection(
                "axis noise", "estimated", "each axis has its own, also where one was stated"
            ),
            Protection("error motion", "estimated", "all six deviations are results"),
            _repeatability(solution, found),
            Protection("refraction", "harmless", "no light is used"),
            Protection(
                "scale",
                "tested",
                "a wrong radius of the ball circle shows in all centres; it scales the rotations",
                _scale_error(result),
            ),
            Protection(
                "tilt", "estimated", "the pose of the axis and the place of each ball are unknowns"
            ),
            _gauge(solution),
            _against(
                "growth",
                growth,
                "a plate that warms and grows leaves residuals, or does little harm in this order",
                "a plate that warms a little may grow unseen: measure in the order interleaved, "
                "with more balls",
            ),
            _one_place(_hidden(result, solution)),
            Protection(
                "numbering",
                "not protected",
                "which table angle belongs to position 0 is taken from the table: positions that "
                "are all numbered off by one fit as well, on a plate whose ball steps are off by "
                "as many the other way",
            ),
            Protection(
                "sign of z",
                "not protected",
                "that z points away from the table is taken from the frame: a z column of the "
                "other sign fits every centre as well and turns the signs of EZC, EAC and EBC; "
                "touch points on the upper half of the balls would show which",
            ),
        ]
    )


def _unseen_in_order(
    result: Result, solution: PlateSolution, found: Sequence[Findings]
) -> tuple[float, float, float]:
    """Return the largest errors of a drift, a knock and a growth that the tests leave unseen.

    In stated standard uncertainties, with the probability of POWER.
    """
    errors, tiny = [(0.0, 0.0, 0.0)], np.finfo(float).tiny
    sigma = max(float(solution.noise.scale[0]), tiny)  # along x and y, where a growth is seen
    scale = np.array([[of_component(solution.noise.scale, name)] for name in COMPONENTS])
    for (_, fit), place, mine in zip(solution.parts, solution.places(), found, strict=True):
        stated = np.array([result.std[name][place] for name in COMPONENTS])
        # per unit noise of a centre
        std = np.maximum(stated / np.maximum(scale, tiny), fit.solution.unit_std.curves())
        dof = max(fit.solution.dof, LEAST_DOF)
        errors.append(
            (
                drift_error(mine.effects, std, dof),
                knock_error(mine.effects, std, dof),
                fit.growth.error(std, dof, sigma),
            )
        )
    drifts, knocks, growths = zip(*errors, strict=True)
    return max(drifts), max(knocks), max(growths)


def _against_drift(problem: BallPlateProblem, error: float) -> Protection:
    if problem.drift:
        shape = ("linear", "quadratic")[problem.drift - 1]
        return Protection("drift", "estimated", f"a {shape} drift of each axis is an unknown")
    if error > TOLERABLE and problem.drift_allowance > 0.0:
        why = f"the budget holds {problem.drift_allowance / MICROMETRE:g} um over the run"
        return Protection("drift", "bounded", why)
    return _against(
        "drift",
        error,
        "the order of measurement shows a linear drift of the CMM's origin",
        "the order of measurement hides a drift of the CMM's origin in the table's deviations: "
        "measure in the order interleaved, or state solver.drift_allowance_m",
    )


def _against(effect: Effect, error: float, tested: str, unprotected: str) -> Protection:
    """Return the protection by a test that leaves no more than ``error`` unseen, inf: any."""
    if error <= TOLERABLE:
        return Protection(effect, "tested", tested, error)
    bound = error if error < float("inf") else None
    return Protection(effect, "not protected", unprotected, bound)


def _repeatability(solution: PlateSolution, found: Sequence[Findings]) -> Protection:
    stops = [arrivals(fit.problem) for _, fit in solution.parts]
    if all(f.scatter is not None for f in found):
        why = f"from {sum(count for count, _ in stops)} repeated stops of the table"
        return Protection("repeatability", "estimated", why)
    if all(balls < MIN_BALLS_PER_STOP for _, balls in stops):
        why = "every centre has a stop of its own, so it is part of the residuals"
        return Protection("repeatability", "estimated", why)
    return Protection(
        "repeatability",
        "not protected",
        "not included: the table came to each position once, or too seldom to estimate it",
    )


def _scale_error(result: Result) -> float:
    """Return the error of the rotations, in standard uncertainties, by the largest radius error.

    That is the one which the check of the circle does not find.
    """
    return max(
        RADIUS_TOLERANCE
        * float(np.max(np.abs(result.deviations[n]) / np.maximum(result.std[n], 1e-300)))
        for n in ROTATIONS
    )


def _gauge(solution: PlateSolution) -> Protection:
    allowance, count = solution.problem.group_allowance, len(solution.parts)
    if count > 1 and allowance > 0.0:
        why = f"the budget holds {allowance / MICROMETRE:g} um between the groups"
        return Protection("gauge", "bounded", why)
    if count > 1:
        why = f"{count} groups of table positions have each a zero of their own"
        return Protection("gauge", "not protected", why)
    return Protection(
        "gauge",
        "harmless",
        "mean values, and what a shifted or tilted plate causes, are no part of the curves",
    )


def _hidden(result: Result, solution: PlateSolution) -> Hidden | None:
    """Return the worst disturbance of one place, of all groups, that stays unseen."""
    worst: Hidden | None = None
    for place, (_, fit) in zip(solution.places(), solution.parts, strict=True):
        std = np.array([result.std[name][place] for name in COMPONENTS])
        std = np.maximum(std, np.median(std, axis=1)[:, None])  # less is chance
        found = gathering.unseen(fit.problem, solution.noise.scale, std)
        if found is not None and (worst is None or found.error > worst.error):
            worst = found
    return worst


def _one_place(hidden: Hidden | None) -> Protection:
    if hidden is None:
        return Protection(
            "one place",
            "not protected",
            "too many positions to judge what gathers at one of them: single centres are tested",
        )
    size = hidden.size / MICROMETRE
    why = (
        "what displaces several balls at one position together is looked for, and widens U where "
        f"it can be neither proved nor excluded; of {hidden.count} neighbours it is found from "
        f"{size:.2g} um on"
    )
    return Protection("one place", "tested", why, hidden.error)


@dataclass(frozen=True, eq=False)
class SolvedTrials:
    """Trials by solving each; for separate groups, an estimated drift, and too large grids.

    ``std`` (n, 3), metres, belongs to the centres of ``problem``.
    """

    problem: BallPlateProblem
    std: Floats

    def __call__(self, rng: np.random.Generator, count: int) -> Floats:
        """Return EXC, EYC, EZC (m), EAC, EBC, ECC (rad) at all angles, one after the other."""
        return np.stack([self._trial(rng.standard_normal(self.std.shape)) for _ in range(count)])

    def _trial(self, noise: Floats) -> Floats:
        centres = self.problem.centres + self.std * noise
        return _in_order(adjust(replace(self.problem, centres=centres)))


def plate_trials(problem: BallPlateProblem) -> Trials | SolvedTrials:
    """Prepare Monte Carlo trials about a measured problem; refuses what ``solve`` refuses."""
    return trials_about(adjust(problem))


def trials_about(solution: PlateSolution) -> Trials | SolvedTrials:
    """Prepare Monte Carlo trials about a solution.

    Rejected centres stay rejected; the noise is the one that the standard deviations of the
    result belong to.
    """
    problem = solution.problem
    if _linear(problem):
        return Trials(_in_order(solution), _gain(solution))
    return SolvedTrials(problem, solution.noise.used * problem.noise_unit)


def _influence(solution: PlateSolution) -> Influence | None:
    """Return what a standard error of each coordinate does to the curves.

    None for what :func:`trials_about` solves trial by trial, and for too many centres.
    """
    used = solution.parts[0].fit.problem
    rows = len(COMPONENTS) * len(used.table_positions)
    if not _linear(solution.problem) or rows * used.centres.size > MOST_INFLUENCES:
        return None
    by_component = dict(zip(COMPONENTS, np.split(_gain(solution), len(COMPONENTS)), strict=True))
    return Influence(used.rows, 3, by_component)


def _gain(solution: PlateSolution) -> Floats:
    """Return what a standard error of each coordinate does to all deviations, (6 M, 3 n)."""
    used = solution.parts[0].fit.problem
    std = (solution.noise.scale * used.noise_unit).ravel()
    return np.asarray(general_least_squares.table_gain(used) * std)


def _linear(problem: BallPlateProblem) -> bool:
    """Whether one matrix takes all centres to all deviations."""
    large = model.n_unknowns(problem) > general_least_squares.MAX_UNKNOWNS
    return not (problem.separate_groups or large or problem.drift > 0)


def _in_order(solution: PlateSolution) -> Floats:
    """Return all deviations, component by component, (6 M,)."""
    deviations = solution.deviations()
    return np.concatenate([deviations[name] for name in COMPONENTS])
