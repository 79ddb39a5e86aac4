"""What could be wrong with a result all the same: tests, larger uncertainties, protections.

The residuals of each fit are searched for what the fit takes no account of: a drift, a motion of
the plate, a table that does not repeat, disturbances in one place. What is found becomes a doubt;
what is probable, or allowed for by a statement, enlarges the covariances. What this order of
measurement would not show is said by the protections: one sentence for each effect that could
spoil a ball plate measurement.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from rotcal_ros.adjust.low_rank import LowRank
from rotcal_ros.adjust.reliability import Hidden
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.components import COMPONENTS, ROTATIONS
from rotcal_ros.foundation.protection import TOLERABLE, Protection, ordered
from rotcal_ros.foundation.results import Result, plain_fields
from rotcal_ros.foundation.units import MICROMETRE
from rotcal_ros.geometry.rotations import rotation_about_z
from rotcal_ros.methods.ball_plate.solver import gathering
from rotcal_ros.methods.ball_plate.solver.estimate import solved
from rotcal_ros.methods.ball_plate.solver.model import least_variance, of_component
from rotcal_ros.methods.ball_plate.solver.noise import CentreNoise
from rotcal_ros.methods.ball_plate.solver.order_effects import (
    DriftTest,
    MotionTest,
    OrderEffects,
    drift_error,
    find_drift,
    find_motion,
    knock_error,
    order_effects,
    stronger,
)
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
from rotcal_ros.methods.ball_plate.solver.solution import PlateSolution, allowed

LEAST_DOF: Final = 8
"""Degrees of freedom that a forecast of tests counts with at least."""


@dataclass(frozen=True)
class Findings:
    """What the tests in the order of measurement found, one entry per group of positions.

    ``scatters`` are the table's repeatability, None where it cannot be told.
    """

    effects: tuple[OrderEffects, ...]
    drifts: tuple[DriftTest, ...]
    motions: tuple[MotionTest, ...]
    scatters: tuple[Repeatability | None, ...]
    closures: tuple[PlateClosure, ...]


def completed(result: Result, solution: PlateSolution) -> Result:
    """Return ``result`` with the tests of its order, their doubts, and its protections.

    A repeatability that is more than noise and stated allowances enlarge the covariance.
    """
    found = _findings(solution)
    added = _added(solution, found)
    warnings = [test.sentence() for test in stronger(found.drifts, found.motions)]
    warnings += [c.sentence() for c in found.closures if not c.closed]
    gathers = [doubt for fit in solution.fits for doubt in gathering.doubts(fit.gathering)]
    warnings += gathers
    doubt = any(t.significant and not t.estimated for t in found.drifts)
    doubt |= any(t.significant for t in found.motions)
    doubt |= any(not c.closed for c in found.closures) or bool(gathers)
    std = {n: np.sqrt(values**2 + added[n].diagonal()) for n, values in result.std.items()}
    result = replace(
        result,
        std=std,
        covariance={name: c + added[name].dense() for name, c in result.covariance.items()},
        warnings=(*result.warnings, *warnings),
        verdict="suspect" if doubt and result.verdict == "ok" else result.verdict,
        details={**result.details, **_details(found, solution.fits)},
    )
    return replace(result, protections=_protections(_facts(result, solution, found)))


def _findings(solution: PlateSolution) -> Findings:
    """Run all tests; where a knock is found already, there is no second search."""
    effects, drifts, motions, scatters, closed = [], [], [], [], list[PlateClosure]()
    for group, fit in zip(solution.groups, solution.fits, strict=True):
        mine = order_effects(fit.problem, group.closing)
        effects.append(mine)
        if drift := find_drift(fit.problem, fit.solution, mine):
            drifts.append(drift)
        if fit.knock is None and (motion := find_motion(fit.problem, fit.solution, mine)):
            motions.append(motion)
        scatter = _scatter(fit)
        scatters.append(scatter)
        if group.closing is not None:
            closed += closures(
                fit.problem,
                group.closing,
                _sigma(solution.noise, fit),
                float(solution.noise.dof.sum()),
                fit.solution.drift,
                _lengths(scatter, fit.problem.radius),
            )
    return Findings(tuple(effects), tuple(drifts), tuple(motions), tuple(scatters), tuple(closed))


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


def _sigma(noise: CentreNoise, fit: Fitted) -> tuple[Floats, Floats]:
    """Return the standard deviations (3,) of fitted and of closing rows, no less than rounding."""
    least = np.sqrt(least_variance(fit.problem, fit.solution.estimate))
    fitted = np.maximum(noise.used / noise.weights, least)
    return fitted, fitted * noise.weights


def _lengths(scatter: Repeatability | None, radius: float) -> Floats:
    """Return the significant repeatability (6,) in metres, rotations times the radius."""
    if scatter is None:
        return np.zeros(6)
    lengths: Floats = scatter.significant_std * np.repeat([1.0, radius], 3)
    return lengths


def _added(solution: PlateSolution, found: Findings) -> dict[str, LowRank]:
    """Return what repeatability, the allowances and one place add to each covariance (M, M)."""
    added = {name: LowRank.outer(allowed(solution, name)) for name in COMPONENTS}
    # a uniform distribution between the limits, alike along each axis
    drift = (0.0 if solution.problem.drift else solution.problem.drift_allowance) / np.sqrt(3.0)
    count = len(solution.table_positions)
    for group, fit, place, effects, scatter in zip(
        solution.groups,
        solution.fits,
        solution.places(),
        found.effects,
        found.scatters,
        strict=True,
    ):
        local = _of_places(fit, group.turn)
        turned = _turned(effects.drift.response, group.turn)
        for row, name in enumerate(COMPONENTS):
            if drift:
                columns = np.zeros((count, turned.shape[2]))
                columns[place] = drift * turned[row]
                added[name] += LowRank.outer(columns)
            if scatter is not None:
                own = np.zeros((count, 1, 1))
                own[place] = scatter.added[row]
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


def _facts(result: Result, solution: PlateSolution, found: Findings) -> PlateEvidence:
    """Return what the protections follow from."""
    problem = solution.problem
    errors = [(0.0, 0.0)]
    tiny = np.finfo(float).tiny
    scale = np.array([[of_component(solution.noise.scale, name)] for name in COMPONENTS])
    for place, fit, effects in zip(solution.places(), solution.fits, found.effects, strict=True):
        own = fit.solution.unit_std.curves()
        stated = np.array([result.std[name][place] for name in COMPONENTS])
        std = np.maximum(stated / np.maximum(scale, tiny), own)  # per unit noise of a centre
        dof = max(fit.solution.dof, LEAST_DOF)
        errors.append((drift_error(effects, std, dof), knock_error(effects, std, dof)))
    stops = [arrivals(fit.problem) for fit in solution.fits]
    return PlateEvidence(
        drift_error=max(error for error, _ in errors),
        knock_error=max(error for _, error in errors),
        drift_degree=problem.drift,
        drift_allowance=problem.drift_allowance,
        n_repeated=sum(count for count, _ in stops),
        own_arrivals=all(balls < MIN_BALLS_PER_STOP for _, balls in stops),
        repeatability=all(scatter is not None for scatter in found.scatters),
        scale_error=_scale_error(result),
        n_groups=len(solution.groups),
        hidden=_hidden(result, solution),
        group_allowance=problem.group_allowance,
    )


def _hidden(result: Result, solution: PlateSolution) -> Hidden | None:
    """Return the worst disturbance of one place, of all groups, that stays unseen."""
    worst: Hidden | None = None
    for place, fit in zip(solution.places(), solution.fits, strict=True):
        std = np.array([result.std[name][place] for name in COMPONENTS])
        std = np.maximum(std, np.median(std, axis=1)[:, None])  # less is chance
        found = gathering.unseen(fit.problem, solution.noise.scale, std)
        if found is not None and (worst is None or found.error > worst.error):
            worst = found
    return worst


def _scale_error(result: Result) -> float:
    """Return the error of the rotations, in standard uncertainties, by the largest radius error.

    That is the one which the check of the circle does not find.
    """
    return max(
        RADIUS_TOLERANCE
        * float(np.max(np.abs(result.deviations[n]) / np.maximum(result.std[n], 1e-300)))
        for n in ROTATIONS
    )


def _details(found: Findings, fits: tuple[Fitted, ...]) -> dict[str, Any]:
    """Return the findings as entries of a result's details, SI."""
    gathers = gathering.details([fit.gathering for fit in fits])
    details: dict[str, Any] = {"gathering": gathers}
    if found.closures:
        details["closure"] = _plain(found.closures)
    if found.drifts:
        details["drift"] = _plain(found.drifts)
    if found.motions:
        details["plate_motion"] = _plain(found.motions)
    if any(found.scatters):
        details["repeatability"] = _plain([s for s in found.scatters if s is not None])
    return details


def _plain(records: Sequence[Any]) -> list[dict[str, Any]]:
    return [plain_fields(record) for record in records]


@dataclass(frozen=True)
class PlateEvidence:
    """What a result's protections follow from.

    ``drift_error`` and ``knock_error`` are the largest errors, in stated standard uncertainties,
    that the tests leave unseen with the probability of POWER; ``drift_degree`` is 0 where no drift
    is estimated; ``drift_allowance`` is stated, m over the run. ``n_repeated`` counts the stops of
    the table beyond the first at each position; ``own_arrivals``: nearly every centre has a stop
    of its own; ``repeatability``: their scatter is estimated.
    ``scale_error`` is the error, in standard uncertainties, of the largest radius error that
    passes the check; ``n_groups`` the groups with a zero of their own,
    ``group_allowance`` how far these are apart at most, m, 0 where that is not stated.
    """

    drift_error: float
    knock_error: float
    drift_degree: int
    drift_allowance: float
    n_repeated: int
    own_arrivals: bool
    repeatability: bool
    scale_error: float
    n_groups: int
    hidden: Hidden | None
    group_allowance: float


def _protections(facts: PlateEvidence) -> tuple[Protection, ...]:
    """Return all protections, of centres that do not tell which way is up."""
    return ordered(
        [
            _drift(facts),
            _knock(facts),
            Protection(
                "axis noise", "estimated", "each axis has its own, also where one was stated"
            ),
            Protection("error motion", "estimated", "all six deviations are results"),
            _repeatability(facts),
            Protection("refraction", "harmless", "no light is used"),
            _scale(facts),
            Protection(
                "tilt", "estimated", "the pose of the axis and the place of each ball are unknowns"
            ),
            _gauge(facts),
            _one_place(facts.hidden),
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
                "touch points on the upper half of the balls would tell",
            ),
        ]
    )


def _drift(facts: PlateEvidence) -> Protection:
    if facts.drift_degree:
        shape = ("linear", "quadratic")[facts.drift_degree - 1]
        return Protection("drift", "estimated", f"a {shape} drift of each axis is an unknown")
    if facts.drift_error <= TOLERABLE:
        why = "the order of measurement shows a linear drift of the CMM's origin"
        return Protection("drift", "tested", why, facts.drift_error)
    if facts.drift_allowance > 0.0:
        why = f"the budget holds {facts.drift_allowance / MICROMETRE:g} um over the run"
        return Protection("drift", "bounded", why)
    return Protection(
        "drift",
        "not protected",
        "the order of measurement hides a drift of the CMM's origin in the table's deviations: "
        "measure in the order interleaved, or state solver.drift_allowance_m",
        _finite(facts.drift_error),
    )


def _knock(facts: PlateEvidence) -> Protection:
    if facts.knock_error <= TOLERABLE:
        why = "a motion of the plate on the table contradicts earlier centres of the same balls"
        return Protection("knock", "tested", why, facts.knock_error)
    return Protection(
        "knock",
        "not protected",
        "a small motion of the plate between two stops may pass for deviations of the table: "
        "measure in the order interleaved, with more balls",
        _finite(facts.knock_error),
    )


def _repeatability(facts: PlateEvidence) -> Protection:
    if facts.repeatability:
        why = f"from {facts.n_repeated} repeated stops of the table"
        return Protection("repeatability", "estimated", why)
    if facts.own_arrivals:
        why = "every centre has a stop of its own, so it is part of the residuals"
        return Protection("repeatability", "estimated", why)
    return Protection(
        "repeatability",
        "not protected",
        "not included: the table came to each position once, or too seldom to tell",
    )


def _scale(facts: PlateEvidence) -> Protection:
    why = "a wrong radius of the ball circle shows in all centres; it scales the rotations"
    return Protection("scale", "tested", why, facts.scale_error)


def _gauge(facts: PlateEvidence) -> Protection:
    if facts.n_groups > 1 and facts.group_allowance > 0.0:
        why = f"the budget holds {facts.group_allowance / MICROMETRE:g} um between the groups"
        return Protection("gauge", "bounded", why)
    if facts.n_groups > 1:
        why = f"{facts.n_groups} groups of table positions have each a zero of their own"
        return Protection("gauge", "not protected", why)
    return Protection(
        "gauge",
        "harmless",
        "mean values, and what a shifted or tilted plate causes, are no part of the curves",
    )


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


def _finite(error: float) -> float | None:
    """Return the error, None where nothing bounds it."""
    return error if error < float("inf") else None
