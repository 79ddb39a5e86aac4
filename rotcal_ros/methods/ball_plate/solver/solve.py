"""The ball plate method from a problem to the result that all methods share."""

from __future__ import annotations

from typing import Any

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.foundation.raw_data import RawData
from rotcal_ros.foundation.results import Residuals, Result, Verdict
from rotcal_ros.methods.ball_plate.solver import model, rigorous
from rotcal_ros.methods.ball_plate.solver.drift import drifted
from rotcal_ros.methods.ball_plate.solver.general_least_squares import MIN_BALLS
from rotcal_ros.methods.ball_plate.solver.noise import CentreNoise
from rotcal_ros.methods.ball_plate.solver.problem import BallPlateProblem
from rotcal_ros.methods.ball_plate.solver.rejection import Fitted
from rotcal_ros.methods.ball_plate.solver.reliability import completed
from rotcal_ros.methods.ball_plate.solver.separability import separability
from rotcal_ros.methods.ball_plate.solver.solution import (
    PlateSolution,
    PositionGroup,
    adjust,
    turned_back,
)
from rotcal_ros.methods.ball_plate.solver.trials import influence_of
from rotcal_ros.methods.ball_plate.solver.zeros import groups_in_words, zeros_of

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
        raw_data=RawData(influence=influence_of(solution)),
    )
    return completed(result, solution).counted_from(*zeros_of(solution))


def _warnings(solution: PlateSolution) -> tuple[str, ...]:
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
    position = {int(row): at for at, row in enumerate(np.sort(whole.rows))}
    n = len(whole.centres)
    columns = {name: np.zeros(n) for name in ("residual", "redundancy", "test_value", "std")}
    used = np.zeros(n, dtype=np.bool_)
    for group, fit in zip(solution.groups, solution.fits, strict=True):
        at = np.array([position[int(row)] for row in group.problem.rows])
        columns["residual"][at] = np.linalg.norm(_all_residuals(group, fit), axis=1)
        own = np.ones((len(at), 3)) if group.problem.std is None else group.problem.std
        columns["std"][at] = np.sqrt(np.mean(np.square(solution.noise.used * own), axis=1))
        at = np.array([position[int(row)] for row in fit.problem.rows])
        columns["redundancy"][at] = fit.test.redundancy
        columns["test_value"][at] = fit.test.value
        used[at] = True
    order = np.argsort(whole.rows)
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
    cmm = np.zeros((problem.grid, 3))
    cmm[fit.problem.cmm_positions] = found.cmm
    plate = np.zeros((problem.grid, 3))
    plate[fit.problem.balls] = found.plate
    predicted = rigorous.computed(problem, found, plate[problem.ball_step], cmm[problem.cmm_index])
    predicted = predicted + drifted(problem, fit.problem, fit.solution.drift)
    residuals = np.full((len(solved), 3), np.nan)
    residuals[solved] = problem.centres - predicted
    return residuals


def _details(solution: PlateSolution) -> dict[str, Any]:
    """Everything else the method knows, in SI; one entry per group under ``groups``."""
    whole, noise = solution.whole, solution.noise
    order = np.argsort(whole.rows)
    residuals = np.zeros((len(whole.centres), 3))
    where = {int(row): at for at, row in enumerate(whole.rows)}
    for group, fit in zip(solution.groups, solution.fits, strict=True):
        at = np.array([where[int(row)] for row in group.problem.rows])
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
            "row": whole.rows[order],
            "cmm_index": whole.cmm_index[order],
            "vector": residuals[order],
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
