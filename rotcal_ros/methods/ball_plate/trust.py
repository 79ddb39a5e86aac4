"""From a solved problem to a result that says what could be wrong with it all the same."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from rotcal_ros.adjust.low_rank import LowRank
from rotcal_ros.adjust.reliability import Hidden
from rotcal_ros.arrays import Floats, Ints
from rotcal_ros.components import COMPONENTS, ROTATIONS
from rotcal_ros.geometry.rotations import rotation_about_z
from rotcal_ros.methods.ball_plate import gathering, repeatability
from rotcal_ros.methods.ball_plate.closure import Closure, closures
from rotcal_ros.methods.ball_plate.estimate import solved
from rotcal_ros.methods.ball_plate.evidence import (
    DriftTest,
    MotionTest,
    find_drift,
    find_motion,
    stronger,
)
from rotcal_ros.methods.ball_plate.model import least_variance, of_component
from rotcal_ros.methods.ball_plate.noise import Noise
from rotcal_ros.methods.ball_plate.order_effects import (
    OrderEffects,
    drift_error,
    knock_error,
    order_effects,
)
from rotcal_ros.methods.ball_plate.protections import Facts, protections
from rotcal_ros.methods.ball_plate.rejection import Fitted
from rotcal_ros.methods.ball_plate.repeatability import Repeatability
from rotcal_ros.methods.ball_plate.response import unit_std
from rotcal_ros.methods.ball_plate.screening import RADIUS_TOLERANCE
from rotcal_ros.methods.ball_plate.solution import PlateSolution
from rotcal_ros.methods.ball_plate.zeros import allowed
from rotcal_ros.results import Result, plain_fields


@dataclass(frozen=True)
class Findings:
    """What the tests in the order of measurement found, one entry per group of positions.

    ``scatters`` are the table's repeatability, None where it cannot be told.
    """

    effects: tuple[OrderEffects, ...]
    drifts: tuple[DriftTest, ...]
    motions: tuple[MotionTest, ...]
    scatters: tuple[Repeatability | None, ...]
    closures: tuple[Closure, ...]


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
    return replace(result, protections=protections(_facts(result, solution, found)))


def _findings(solution: PlateSolution) -> Findings:
    """Run all tests; where a knock is found already, there is no second search."""
    effects, drifts, motions, scatters, closed = [], [], [], [], list[Closure]()
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

    Weights found for the axes hold what the table scatters along them, as if it were noise.
    """
    problem, residuals = fit.problem, fit.solution.residuals
    if problem.std is not None and not np.ptp(problem.std, axis=0).any():
        problem = replace(problem, std=None)
        residuals = solved(problem)[1].residuals
    return repeatability.repeatability(problem, residuals)


def _sigma(noise: Noise, fit: Fitted) -> tuple[Floats, Floats]:
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
    places, count = _places(solution), len(solution.table_positions)
    for group, fit, place, effects, scatter in zip(
        solution.groups, solution.fits, places, found.effects, found.scatters, strict=True
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
    both = whole.reshape(2, 3, count, 2, 3, count)[:, :, known][..., known]
    back = rotation_about_z(turn)
    each: Floats = np.einsum("ij,bjmbkn,ik->bimn", back, both, back)
    return each.reshape(6, len(known), len(known))


def _places(solution: PlateSolution) -> list[Ints]:
    """Return where the solved positions of each group stand in the result."""
    return [
        np.searchsorted(solution.table_positions, group.positions[fit.problem.table_positions])
        for group, fit in zip(solution.groups, solution.fits, strict=True)
    ]


def _turned(response: Floats, turn: float) -> Floats:
    """Bring the errors (6, M, m) of a group to the frame of the whole."""
    vectors = response.reshape(2, 3, *response.shape[1:])
    turned: Floats = np.einsum("ij,bj...->bi...", rotation_about_z(turn), vectors)
    return turned.reshape(response.shape)


def _facts(result: Result, solution: PlateSolution, found: Findings) -> Facts:
    problem = solution.problem
    errors = [(0.0, 0.0)]
    tiny = np.finfo(float).tiny
    scale = np.array([[of_component(solution.noise.scale, name)] for name in COMPONENTS])
    for place, fit, effects in zip(_places(solution), solution.fits, found.effects, strict=True):
        own = unit_std(fit.solution.unit_std)
        stated = np.array([result.std[name][place] for name in COMPONENTS])
        std = np.maximum(stated / np.maximum(scale, tiny), own)
        dof = max(fit.solution.dof, 8)
        errors.append((drift_error(effects, std, dof), knock_error(effects, std, dof)))
    stops = [repeatability.arrivals(fit.problem) for fit in solution.fits]
    return Facts(
        drift_error=max(error for error, _ in errors),
        knock_error=max(error for _, error in errors),
        drift_degree=problem.drift,
        drift_allowance=problem.drift_allowance,
        n_repeated=sum(count for count, _ in stops),
        own_arrivals=all(balls < repeatability.MIN_BALLS for _, balls in stops),
        repeatability=all(scatter is not None for scatter in found.scatters),
        scale_error=_scale_error(result),
        n_groups=len(solution.groups),
        hidden=_hidden(result, solution),
        group_allowance=problem.group_allowance,
    )


def _hidden(result: Result, solution: PlateSolution) -> Hidden | None:
    """Return the worst disturbance of one place, of all groups, that stays unseen."""
    worst: Hidden | None = None
    for place, fit in zip(_places(solution), solution.fits, strict=True):
        std = np.array([result.std[name][place] for name in COMPONENTS])
        std = np.maximum(std, np.median(std, axis=1)[:, None])  # less is chance
        found = gathering.unseen(fit.problem, (solution.noise.scale, std))
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
