"""The ball plate method from a problem to the result that all methods share."""

from __future__ import annotations

from typing import Any

import numpy as np

from rotcal_ros.arrays import Floats
from rotcal_ros.components import COMPONENTS
from rotcal_ros.geometry.rotations import rotation_about_z
from rotcal_ros.methods.ball_plate import model
from rotcal_ros.methods.ball_plate.problem import BallPlateProblem
from rotcal_ros.methods.ball_plate.rejection import Fitted
from rotcal_ros.methods.ball_plate.separability import separability
from rotcal_ros.methods.ball_plate.solution import Group, Noise, PlateSolution, adjust, turned_back
from rotcal_ros.results import Residuals, Result, Verdict
from rotcal_ros.units import MICROMETRE, MICRORADIAN

METHOD = "ball_plate"
COVARIANCE_LIMIT = 720
"""Largest grid whose (N, N) covariance matrices are put into the result (25 MB)."""
MANY_REJECTED = 0.02
"""Share of rejected centres from which on a result is suspect."""
LINEARISATION = 0.3
"""Neglected products may reach this part of a centre's standard deviation."""


def solve(problem: BallPlateProblem) -> Result:
    """Return the table's six deviations with covariances from the centres of a ball plate.

    Screens the table, checks that the errors can be separated, solves by least squares,
    rejects centres that do not fit and looks for a moved plate. Standard deviations belong to
    the stated noise when its chi-square test passes, else to the one found in the residuals.
    Raises DataError for a table that is not what it says and ObservabilityError, with the
    harmonics that are lost, when balls and positions do not separate the errors.
    """
    solution = adjust(problem)
    noise, rejected = solution.noise, solution.rejected
    variance = noise.used**2
    covariance = {}
    if problem.grid <= COVARIANCE_LIMIT:
        covariance = {name: variance * solution.unit_covariance(name) for name in COMPONENTS}
    return Result(
        method=METHOD,
        angles=problem.angles,
        deviations=solution.deviations(),
        std=solution.std(),
        covariance=covariance,
        sigma0=noise.sigma0,
        dof=noise.dof,
        n_observations=len(problem.centres),
        rejected=rejected,
        verdict=_verdict(solution.fits, noise, len(rejected) / len(problem.centres)),
        warnings=_warnings(solution),
        residuals=_residuals(solution),
        details=_details(solution),
    )


def _warnings(solution: PlateSolution) -> tuple[str, ...]:
    fits, noise = solution.fits, solution.noise
    n_rejected, n_centres = len(solution.rejected), len(solution.problem.centres)
    warnings = []
    if len(fits) > 1:
        names = f"{len(fits)} groups of" if len(fits) > 2 else "odd and even"
        warnings.append(
            f"The offset between the {names} table positions is not measured: each group has its "
            "own zero."
        )
    for fit in fits:
        if fit.knock is not None:
            warnings.append(fit.knock.sentence())
        weak = separability(fit.problem.grid, fit.problem.balls).sentences()
        warnings += [sentence for sentence in weak if sentence not in warnings]
        warnings += _linearisation(fit, noise)
    if noise.contradicts:
        follow = "larger: uncertainties follow the residuals" if noise.sigma0 > 1 else "smaller"
        warnings.append(
            f"the residuals contradict the stated noise (sigma0 = {noise.sigma0:.3f}, p = "
            f"{noise.p_value:.2g}): they are {follow}"
        )
    if n_rejected > MANY_REJECTED * n_centres:
        warnings.append(f"{n_rejected} of {n_centres} centres were rejected")
    return tuple(warnings)


def _linearisation(fit: Fitted, noise: Noise) -> list[str]:
    """Warn when the products of small quantities that Eq. 10 neglects are not small."""
    found = fit.solution.estimate
    plate, cmm = np.abs(found.plate).max(), np.abs(found.cmm).max()
    pose, table = np.abs(found.axis_rotation).max(), np.abs(found.rotation).max()
    neglected = table * plate + pose * (plate + cmm) + 0.5 * pose**2 * fit.problem.radius
    limit = LINEARISATION * noise.used
    if fit.problem.std is not None:
        limit *= float(np.median(fit.problem.std))
    if neglected < limit:
        return []
    return [
        f"terms up to {neglected / MICROMETRE:.2g} um are neglected by the linear model (plate "
        f"off by {plate / MICROMETRE:.3g} um, frame turned by {pose / MICRORADIAN:.3g} urad): "
        "align the CMM's frame with the axis and centre the plate better"
    ]


def _verdict(fits: tuple[Fitted, ...], noise: Noise, share: float) -> Verdict:
    if any(fit.knock is not None for fit in fits):
        return "failed"
    if (noise.contradicts and noise.sigma0 > 1.0) or share > MANY_REJECTED:
        return "suspect"
    return "ok"


def _residuals(solution: PlateSolution) -> Residuals:
    """One row per finite centre, in the order of the row numbers; lengths of the 3D residual."""
    whole = solution.whole
    position = {int(row): at for at, row in enumerate(np.sort(whole.rows))}
    n = len(whole.centres)
    columns = {name: np.zeros(n) for name in ("residual", "redundancy", "test_value")}
    used = np.zeros(n, dtype=np.bool_)
    for group, fit in zip(solution.groups, solution.fits, strict=True):
        at = np.array([position[int(row)] for row in group.problem.rows])
        columns["residual"][at] = np.linalg.norm(_all_residuals(group, fit), axis=1)
        at = np.array([position[int(row)] for row in fit.problem.rows])
        columns["redundancy"][at] = fit.test.redundancy
        columns["test_value"][at] = fit.test.value
        used[at] = True
    order = np.argsort(whole.rows)
    return Residuals(
        table_position=whole.position[order], target=whole.ball_step[order], used=used, **columns
    )


def _all_residuals(group: Group, fit: Fitted) -> Floats:
    """Observed - computed (n, 3) of all rows of a group, used or not, in the group's frame."""
    problem, found = group.problem, fit.solution.estimate
    turn = rotation_about_z(problem.angles)[problem.position]
    cross = problem.radius * model.cross_unit(problem.angles)[problem.cmm_index]
    cmm = np.zeros((problem.grid, 3))
    cmm[fit.problem.cmm_positions] = found.cmm
    plate = np.zeros((problem.grid, 3))
    plate[fit.problem.balls] = found.plate
    rotation = found.rotation[problem.position] + found.axis_rotation
    shift = found.translation[problem.position] + found.axis_shift
    moved = np.einsum("nij,nj->ni", turn, plate[problem.ball_step])
    turned = np.einsum("nij,nj->ni", cross, rotation)
    residuals: Floats = problem.deviations - moved - turned - shift - cmm[problem.cmm_index]
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
        "sigma_centre": noise.estimated,
        "sigma_used": noise.used,
        "chi_square": {
            "dof": noise.dof,
            "p_value": noise.p_value,
            "passed": not noise.contradicts,
        },
        "groups": [
            _group_details(group, fit, noise.used)
            for group, fit in zip(solution.groups, solution.fits, strict=True)
        ],
        "residual_rows": {
            "row": whole.rows[order],
            "cmm_index": whole.cmm_index[order],
            "vector": residuals[order],
        },
    }


def _group_details(group: Group, fit: Fitted, scale: float) -> dict[str, Any]:
    problem, solution = fit.problem, fit.solution
    names = {
        "plate": "plate_errors",
        "cmm": "cmm_errors",
        "axis_rotation": "axis_rotation",
        "axis_shift": "axis_shift",
    }
    details: dict[str, Any] = {
        "way": solution.way,
        "table_positions": group.positions,
        "turn": group.turn,
        "ball_steps": problem.balls,
        "cmm_positions": problem.cmm_positions,
    }
    for field, name in names.items():
        details[name] = getattr(solution.estimate, field)
        details[f"{name}_std"] = scale * getattr(solution.unit_std, field)
    if fit.knock is not None:
        details["knock"] = {
            "last_row": fit.knock.last,
            "first_row": fit.knock.first,
            "shift": fit.knock.shift,
            "rotation": fit.knock.rotation,
        }
    return details
