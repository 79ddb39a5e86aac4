"""The ball plate method from a problem to the result that all methods share, and trials of it.

The estimate is linear in the centres. So one matrix tells what errors of the centres do to the
curves, and makes Monte Carlo trials without solving each.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.foundation.raw_data import MOST_INFLUENCES, Influence, RawData
from rotcal_ros.foundation.results import Residuals, Result, Verdict
from rotcal_ros.methods.ball_plate.solver import general_least_squares, model
from rotcal_ros.methods.ball_plate.solver.estimate import computed, drifted
from rotcal_ros.methods.ball_plate.solver.noise import CentreNoise
from rotcal_ros.methods.ball_plate.solver.problem import BallPlateProblem
from rotcal_ros.methods.ball_plate.solver.rejection import Fitted
from rotcal_ros.methods.ball_plate.solver.reliability import completed
from rotcal_ros.methods.ball_plate.solver.separability import MIN_BALLS, separability
from rotcal_ros.methods.ball_plate.solver.solution import (
    PlateSolution,
    PositionGroup,
    adjust,
    groups_in_words,
    turned_back,
    zeros_of,
)

METHOD = "ball_plate"
COVARIANCE_LIMIT = 720
"""Largest grid whose (N, N) covariance matrices are put into the result (25 MB)."""
MANY_REJECTED = 0.02
"""Share of rejected centres from which on a result is suspect."""


def solve(problem: BallPlateProblem) -> Result:
    """Return the table's six deviations with covariances from the centres of a ball plate.

    Screens the table, checks that the errors can be separated, solves by least squares,
    rejects centres that do not fit and looks for a moved plate. Standard deviations belong to
    the stated noise when its chi-square test passes, else to the one found in the residuals.
    Centres measured again at the end are compared with the first time instead of fitted; drift
    and motions of the plate are looked for in the order of the rows, and ``protections`` tell what
    this order cannot show. Raises DataError for a table that is not what it says and
    ObservabilityError, with the harmonics that are lost, when balls and positions do not separate
    the errors.
    """
    return result_of(adjust(problem))


def result_of(solution: PlateSolution) -> Result:
    """Return what is known of a solved problem in the form that all methods share."""
    problem = solution.problem
    noise, rejected = solution.noise, solution.rejected
    covariance = {}
    if problem.bidirectional or problem.grid <= COVARIANCE_LIMIT:
        covariance = {name: solution.covariance(name) for name in COMPONENTS}
    result = Result(
        method=METHOD,
        angles=problem.angles[solution.table_positions],
        deviations=solution.deviations(),
        std=solution.std(),
        covariance=covariance,
        sigma0=noise.sigma0,
        dof=sum(fit.solution.dof for fit in solution.fits),
        n_observations=len(problem.centres),
        rejected=rejected,
        verdict=_verdict(solution.fits, noise, len(rejected) / len(problem.centres)),
        warnings=_warnings(solution),
        residuals=_residuals(solution),
        details=_details(solution),
        raw_data=RawData(influence=_influence(solution)),
    )
    return completed(result, solution).counted_from(*zeros_of(solution))


def _warnings(solution: PlateSolution) -> tuple[str, ...]:
    """Return what is known to limit the result, in words."""
    fits, noise = solution.fits, solution.noise
    n_rejected, n_centres = len(solution.rejected), len(solution.problem.centres)
    warnings = []
    n_positions = solution.problem.n_positions
    left_out = np.setdiff1d(np.arange(n_positions), solution.table_positions)
    if len(left_out):
        warnings.append(
            f"{len(left_out)} of {n_positions} table positions have fewer than "
            f"{MIN_BALLS} balls and are left out of the result: {', '.join(map(str, left_out))}"
        )
    if len(fits) > 1:
        warnings.append(
            f"The offset between {groups_in_words(len(fits))} is not measured: each group has its "
            "own zero"
        )
    for fit in fits:
        if fit.knock is not None:
            warnings.append(fit.knock.sentence())
        weak = separability(fit.problem.grid, fit.problem.balls).sentences()
        warnings += [sentence for sentence in weak if sentence not in warnings]
    warnings += noise.sentences(own_std=solution.problem.std is not None)
    if n_rejected > MANY_REJECTED * n_centres:
        warnings.append(f"{n_rejected} of {n_centres} centres were rejected")
    return tuple(warnings)


def _verdict(fits: tuple[Fitted, ...], noise: CentreNoise, share: float) -> Verdict:
    if any(fit.knock is not None for fit in fits):
        return "failed"
    if (noise.contradicts and noise.larger) or share > MANY_REJECTED:
        return "suspect"
    return "ok"


def _residuals(solution: PlateSolution) -> Residuals:
    """One row per finite centre, in the order of the row numbers; lengths of the 3D residual."""
    whole = solution.whole
    order = np.argsort(whole.rows)
    in_order, n = whole.rows[order], len(order)
    columns = {name: np.zeros(n) for name in ("residual", "redundancy", "test_value", "std")}
    used = np.zeros(n, dtype=np.bool_)
    for group, fit in zip(solution.groups, solution.fits, strict=True):
        at = np.searchsorted(in_order, group.problem.rows)
        columns["residual"][at] = np.linalg.norm(_all_residuals(group, fit), axis=1)
        noise = solution.noise.used * group.problem.noise_unit
        columns["std"][at] = np.sqrt(np.mean(np.square(noise), axis=1))
        at = np.searchsorted(in_order, fit.problem.rows)
        columns["redundancy"][at] = fit.test.redundancy
        columns["test_value"][at] = fit.test.value
        used[at] = True
    return Residuals(
        table_position=whole.position[order],
        target=whole.ball_step[order],
        used=used,
        coordinates=3,
        **columns,
    )


def _all_residuals(group: PositionGroup, fit: Fitted) -> Floats:
    """Observed - computed (n, 3) of all rows of a group, used or not, in the group's frame.

    NaN at table positions that were left out.
    """
    solved = np.isin(group.problem.position, fit.problem.table_positions)
    problem, found = group.problem.take(solved), fit.solution.estimate
    # a rejected row may belong to a ball or CMM position that no fitted row has: no error known
    cmm = np.zeros((problem.grid, 3))
    cmm[fit.problem.cmm_positions] = found.cmm
    plate = np.zeros((problem.grid, 3))
    plate[fit.problem.balls] = found.plate
    predicted = computed(problem, found, plate[problem.ball_step], cmm[problem.cmm_index])
    predicted = predicted + drifted(problem, fit.problem, fit.solution.drift)
    residuals = np.full((len(solved), 3), np.nan)
    residuals[solved] = problem.centres - predicted
    return residuals


def _details(solution: PlateSolution) -> dict[str, Any]:
    """Everything else the method knows, in SI; one entry per group under ``groups``."""
    whole, noise = solution.whole, solution.noise
    order = np.argsort(whole.rows)
    in_order = whole.rows[order]
    residuals = np.zeros((len(order), 3))
    for group, fit in zip(solution.groups, solution.fits, strict=True):
        at = np.searchsorted(in_order, group.problem.rows)
        residuals[at] = turned_back(group, _all_residuals(group, fit))
    return {
        "grid": whole.grid,
        "radius": whole.radius,
        "sigma_centre": noise.pooled,
        "sigma_used": float(np.sqrt(np.mean(noise.used**2))),
        "axis_noise": noise.details(),
        "chi_square": {
            "dof": sum(fit.solution.dof for fit in solution.fits),
            "p_value": noise.p_value,
            "passed": not noise.contradicts,
        },
        "groups": [
            _group_details(group, fit, noise.scale)
            for group, fit in zip(solution.groups, solution.fits, strict=True)
        ],
        "residual_rows": {
            "row": in_order,
            "cmm_index": whole.cmm_index[order],
            "vector": residuals,
        },
    }


def _group_details(group: PositionGroup, fit: Fitted, scale: Floats) -> dict[str, Any]:
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
    if fit.knock is not None:
        details["knock"] = {
            "last_row": fit.knock.last,
            "first_row": fit.knock.first,
            "shift": fit.knock.shift,
            "rotation": fit.knock.rotation,
        }
    return details


@dataclass(frozen=True, eq=False)
class LinearTrials:
    """Trials by the linear map itself: ``value`` (6 M,) + noise @ ``gain`` (3 n, 6 M).

    ``std`` (3 n,), metres, belongs to the coordinates of the centres.
    """

    value: Floats
    gain: Floats
    std: Floats

    def __call__(self, rng: np.random.Generator, count: int) -> Floats:
        """Return EXC, EYC, EZC (m), EAC, EBC, ECC (rad) at all angles one after the other."""
        noise = self.std * rng.standard_normal((count, len(self.std)))
        return self.value + noise @ self.gain


@dataclass(frozen=True, eq=False)
class SolvedTrials:
    """Trials by solving each; for separate groups, an estimated drift, and too large grids.

    ``std`` (n, 3), metres, belongs to the centres of ``problem``.
    """

    problem: BallPlateProblem
    std: Floats

    def __call__(self, rng: np.random.Generator, count: int) -> Floats:
        """Return the same as :class:`LinearTrials`."""
        return np.stack([self._trial(rng.standard_normal(self.std.shape)) for _ in range(count)])

    def _trial(self, noise: Floats) -> Floats:
        centres = self.problem.centres + self.std * noise
        return _in_order(adjust(replace(self.problem, centres=centres)))


def plate_trials(problem: BallPlateProblem) -> LinearTrials | SolvedTrials:
    """Prepare Monte Carlo trials about a measured problem; refuses what ``solve`` refuses.

    Rejected centres stay rejected; the noise is the one that the standard deviations of the
    result belong to.
    """
    solution = adjust(problem)
    if _linear(problem):
        used = solution.fits[0].problem
        std = (solution.noise.scale * used.noise_unit).ravel()
        return LinearTrials(_in_order(solution), general_least_squares.table_gain(used).T, std)
    return SolvedTrials(problem, solution.noise.used * problem.noise_unit)


def _influence(solution: PlateSolution) -> Influence | None:
    """Return what a standard error of each coordinate does to the curves.

    None for what :func:`plate_trials` solves trial by trial, and for too many centres.
    """
    used = solution.fits[0].problem
    rows = len(COMPONENTS) * len(used.table_positions)
    if not _linear(solution.problem) or rows * used.centres.size > MOST_INFLUENCES:
        return None
    std = (solution.noise.scale * used.noise_unit).ravel()
    gain = general_least_squares.table_gain(used) * std
    by_component = dict(zip(COMPONENTS, np.split(gain, len(COMPONENTS)), strict=True))
    return Influence(used.rows, 3, by_component)


def _linear(problem: BallPlateProblem) -> bool:
    """Whether one matrix takes all centres to all deviations."""
    large = model.offsets(problem).total > general_least_squares.MAX_UNKNOWNS
    return not (problem.separate_groups or large or problem.drift > 0)


def _in_order(solution: PlateSolution) -> Floats:
    """Return all deviations, component by component, (6 M,)."""
    deviations = solution.deviations()
    return np.concatenate([deviations[name] for name in COMPONENTS])
