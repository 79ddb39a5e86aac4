"""From a solved problem to a result that says what could be wrong with it all the same.

Tests of a fit in its order of measurement, for a CMM that drifts and a plate that moves.

Both look for patterns that :mod:`order_effects` predicts, in the residuals of the fit. The search
for a knock in :mod:`knock` has the last word on a plate that jumped; the one here finds what is
too small for it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from rotcal_ros.adjust.distributions import f_sf
from rotcal_ros.adjust.low_rank import LowRank
from rotcal_ros.adjust.reliability import Hidden
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.components import COMPONENTS, ROTATIONS
from rotcal_ros.foundation.results import Result, plain_fields
from rotcal_ros.foundation.units import ARCSEC, MICROMETRE
from rotcal_ros.geometry.rotations import rotation_about_z
from rotcal_ros.methods.ball_plate.solver import gathering, repeatability
from rotcal_ros.methods.ball_plate.solver.closure import PlateClosure, closures
from rotcal_ros.methods.ball_plate.solver.disturbance_response import unit_std, weights
from rotcal_ros.methods.ball_plate.solver.drift import VISIBLE, drift_columns
from rotcal_ros.methods.ball_plate.solver.estimate import solved
from rotcal_ros.methods.ball_plate.solver.model import (
    OriginDrift,
    Solution,
    least_variance,
    of_component,
)
from rotcal_ros.methods.ball_plate.solver.noise import CentreNoise
from rotcal_ros.methods.ball_plate.solver.order_effects import (
    SIGNIFICANCE,
    DisplacementPatterns,
    OrderEffects,
    drift_error,
    knock_error,
    motion_columns,
    order_effects,
)
from rotcal_ros.methods.ball_plate.solver.problem import BallPlateProblem
from rotcal_ros.methods.ball_plate.solver.protections import PlateEvidence, protections
from rotcal_ros.methods.ball_plate.solver.rejection import Fitted
from rotcal_ros.methods.ball_plate.solver.repeatability import Repeatability
from rotcal_ros.methods.ball_plate.solver.screening import RADIUS_TOLERANCE
from rotcal_ros.methods.ball_plate.solver.solution import PlateSolution
from rotcal_ros.methods.ball_plate.solver.zeros import allowed


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
    return replace(result, protections=protections(_facts(result, solution, found)))


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

    Weights found for the axes hold what the table scatters along them, as if it were noise.
    """
    problem, residuals = fit.problem, fit.solution.residuals
    if problem.std is not None and not np.ptp(problem.std, axis=0).any():
        problem = replace(problem, std=None)
        residuals = solved(problem)[1].residuals
    return repeatability.repeatability(problem, residuals)


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


def _facts(result: Result, solution: PlateSolution, found: Findings) -> PlateEvidence:
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
    return PlateEvidence(
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


SPARE: Final = 8
"""Degrees of freedom below which nothing can be tested."""
SETTLED: Final = 0.01
"""Share of the stated noise that the iteration of the exact model may leave in the residuals."""


@dataclass(frozen=True)
class DriftTest:
    """Linear drift of the CMM's origin: ``amount`` (3,), m over the run, with ``std``; p value.

    ``estimated``: part of the fit, and so no reason for doubt.
    """

    amount: Floats
    std: Floats
    p_value: float
    estimated: bool

    @property
    def significant(self) -> bool:
        """Whether there is a drift."""
        return self.p_value < SIGNIFICANCE

    def sentence(self) -> str:
        """Say in words how much drifts."""
        shown = ", ".join(
            f"{a / MICROMETRE:.3f} +- {2.0 * s / MICROMETRE:.3f}"
            for a, s in zip(self.amount, self.std, strict=True)
        )
        found = f"the origin of the CMM drifts by ({shown}) um over the run in x, y, z"
        if self.estimated:
            return f"{found}; it is estimated and taken off"
        return (
            f"{found} (p = {self.p_value:.2g}): solver.drift: linear takes it off, with its "
            "uncertainty"
        )


@dataclass(frozen=True)
class MotionTest:
    """The most likely motion of the plate: from ``row`` on, shift (3,) m, rotation (3,) rad."""

    row: int
    shift: Floats
    rotation: Floats
    p_value: float

    @property
    def significant(self) -> bool:
        """Whether the plate has moved."""
        return self.p_value < SIGNIFICANCE

    def sentence(self) -> str:
        """Say in words what seems to have moved when."""
        x, y, z = self.shift / MICROMETRE
        a, b, c = self.rotation / ARCSEC
        return (
            f"the plate seems to have moved on the table near row {self.row} by ({x:.3f}, "
            f"{y:.3f}, {z:.3f}) um and ({a:.3f}, {b:.3f}, {c:.3f}) arcsec (p = "
            f"{self.p_value:.2g}): look at its clamping, or measure again"
        )


def find_drift(
    problem: BallPlateProblem, solution: Solution, effects: OrderEffects
) -> DriftTest | None:
    """Test the three linear drifts together; None where the residuals do not keep them."""
    if solution.drift is not None:
        return _estimated(solution, solution.drift)
    columns = drift_columns(problem.run_time, 1)
    centred = columns - columns.mean(axis=0)
    weight = weights(problem)
    total = np.einsum("nia,ni,nia->a", centred, weight, centred)
    scale = 1.0 / np.sqrt(total)
    kept = np.linalg.eigvalsh(effects.drift.information * np.outer(scale, scale))
    if kept[0] < VISIBLE or solution.dof < SPARE:
        return None
    right = np.einsum("nia,ni->a", columns, weight * solution.residuals)
    least = _least(problem, solution)
    amount, inverse, p_value, variance = _tested(effects.drift, right, solution, least)
    return DriftTest(amount, np.sqrt(variance * np.diag(inverse)), p_value, estimated=False)


def find_motion(
    problem: BallPlateProblem, solution: Solution, effects: OrderEffects
) -> MotionTest | None:
    """Look for a motion of the plate at each of the moments of ``effects``."""
    if solution.dof < SPARE:
        return None
    order = np.argsort(problem.rows, kind="stable")
    pulled = (weights(problem) * solution.residuals)[order]
    each = np.einsum("nia,ni->na", motion_columns(problem)[order], pulled)
    later = np.cumsum(each[::-1], axis=0)[::-1]
    best: MotionTest | None = None
    least = _least(problem, solution)
    for moment, knock in zip(effects.moments, effects.knocks, strict=True):
        if moment >= len(order):
            continue
        amount, _, p_value, _ = _tested(knock, later[moment], solution, least)
        p_value = min(1.0, p_value * len(effects.knocks))
        if best is None or p_value < best.p_value:
            row = int(problem.rows[order[moment]])
            best = MotionTest(row, amount[:3], amount[3:] / problem.radius, p_value)
    return best


def _least(problem: BallPlateProblem, solution: Solution) -> float:
    """Return the variance below which the rest is no noise; in units of ``std``, if given."""
    stated = 1.0 if problem.std is not None else problem.sigma or 0.0
    return max(least_variance(problem, solution.estimate), (SETTLED * stated) ** 2)


def _tested(
    pattern: DisplacementPatterns, right: Floats, solution: Solution, floor: float
) -> tuple[Floats, Floats, float, float]:
    """Return amount, unit covariance, p value of its F test, and the variance of the rest."""
    values, vectors = np.linalg.eigh(pattern.information)
    seen = values > pattern.seen
    rank = int(np.count_nonzero(seen))
    inverse = (vectors[:, seen] / values[seen]) @ vectors[:, seen].T
    amount: Floats = inverse @ right
    gain = float(right @ amount)
    dof = solution.dof - rank
    if not rank:
        return amount, inverse, 1.0, floor
    variance = max((solution.weighted_square_sum - gain) / dof, floor)
    return amount, inverse, f_sf(gain / rank / variance, rank, dof), variance


def _estimated(solution: Solution, drift: OriginDrift) -> DriftTest:
    linear = drift.unit_covariance[:3, :3]
    variance = solution.weighted_square_sum / solution.dof
    amount = drift.amount[0]
    value = float(amount @ np.linalg.solve(linear, amount)) / 3.0 / max(variance, 1e-300)
    std = np.sqrt(variance * np.diag(linear))
    return DriftTest(amount, std, f_sf(value, 3, solution.dof), estimated=True)


def stronger(
    drifts: Sequence[DriftTest], motions: Sequence[MotionTest]
) -> list[DriftTest | MotionTest]:
    """Return the significant findings worth telling; of a drift and a motion the likelier one.

    A drift looks like a small motion and the other way round.
    """
    every: list[DriftTest | MotionTest] = [*drifts, *motions]
    found = [t for t in every if t.significant]
    known: list[DriftTest | MotionTest] = [d for d in drifts if d.significant and d.estimated]
    doubts = sorted((t for t in found if t not in known), key=lambda t: t.p_value)
    return known + doubts[:1]
