"""The ball plate method from a problem to the result that all methods share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from rotcal_ros.arrays import Floats
from rotcal_ros.components import COMPONENTS
from rotcal_ros.methods.ball_plate import model
from rotcal_ros.methods.ball_plate.problem import BallPlateProblem
from rotcal_ros.methods.ball_plate.rejection import Fitted, fit_and_reject
from rotcal_ros.methods.ball_plate.screening import screen
from rotcal_ros.methods.ball_plate.separability import separability
from rotcal_ros.methods.ball_plate.two_groups import (
    Group,
    offset_warning,
    split,
    turned_back,
    turned_covariance,
)
from rotcal_ros.methods.distributions import chi2_sf
from rotcal_ros.results import Residuals, Result, Verdict
from rotcal_ros.units import MICROMETRE, MICRORADIAN

METHOD = "ball_plate"
SIGNIFICANCE = 0.01
"""Level of the chi-square test of the stated noise."""
COVARIANCE_LIMIT = 720
"""Largest grid whose (N, N) covariance matrices are put into the result (25 MB)."""
MANY_REJECTED = 0.02
LINEARISATION = 0.3
"""Neglected products may reach this part of a centre's standard deviation."""


@dataclass(frozen=True)
class Noise:
    """Standard deviation of a centre: ``used`` (m, or of unit weight), stated or estimated.

    ``sigma0`` is estimate / statement, 1 when nothing was stated; ``p_value`` belongs to the
    two-sided chi-square test of the statement, None when nothing was stated.
    """

    used: float
    estimated: float
    sigma0: float
    p_value: float | None
    dof: int

    @property
    def contradicts(self) -> bool:
        """Whether the residuals contradict the stated noise."""
        return self.p_value is not None and self.p_value < SIGNIFICANCE


def solve(problem: BallPlateProblem) -> Result:
    """Return the table's six deviations with covariances from the centres of a ball plate.

    Screens the table, checks that the errors can be separated, solves by least squares,
    rejects centres that do not fit and looks for a moved plate. Standard deviations belong to
    the stated noise when its chi-square test passes, else to the one found in the residuals.
    Raises DataError for a table that is not what it says and ObservabilityError, with the
    harmonics that are lost, when balls and positions do not separate the errors.
    """
    screened = screen(problem)
    whole = screened.problem
    groups = split(whole) if problem.separate_groups else (_whole(whole),)
    fits = tuple(fit_and_reject(group.problem) for group in groups)
    noise = _noise(problem, fits)
    rejected = screened.rejected + tuple(r for fit in fits for r in fit.rejected)
    warnings = _warnings(problem, fits, noise, len(rejected))
    variance = noise.used**2
    covariance = {}
    if problem.grid <= COVARIANCE_LIMIT:
        covariance = {name: variance * _covariance(groups, fits, name) for name in COMPONENTS}
    return Result(
        method=METHOD,
        angles=problem.angles,
        deviations=_deviations(groups, fits),
        std=_std(groups, fits, noise.used),
        covariance=covariance,
        sigma0=noise.sigma0,
        dof=noise.dof,
        n_observations=len(problem.centres),
        rejected=tuple(sorted(rejected, key=lambda r: r.index)),
        verdict=_verdict(fits, noise, len(rejected) / len(problem.centres)),
        warnings=warnings,
        residuals=_residuals(whole, groups, fits),
        details=_details(whole, groups, fits, noise),
    )


def _whole(problem: BallPlateProblem) -> Group:
    return Group(np.arange(problem.grid), 0.0, problem)


def _noise(problem: BallPlateProblem, fits: tuple[Fitted, ...]) -> Noise:
    """Pool the residuals of all groups and test the stated noise."""
    total = sum(fit.solution.weighted_square_sum for fit in fits)
    dof = sum(fit.solution.dof for fit in fits)
    estimated = float(np.sqrt(total / dof))
    stated = 1.0 if problem.std is not None else problem.sigma
    if stated is None:
        return Noise(estimated, estimated, 1.0, None, dof)
    tail = chi2_sf(total / stated**2, dof)
    p_value = 2.0 * min(tail, 1.0 - tail)
    used = estimated if p_value < SIGNIFICANCE and estimated > stated else stated
    return Noise(used, estimated, estimated / stated, p_value, dof)


def _deviations(groups: tuple[Group, ...], fits: tuple[Fitted, ...]) -> dict[str, Floats]:
    n = sum(len(group.positions) for group in groups)
    fields = {"translation": np.empty((n, 3)), "rotation": np.empty((n, 3))}
    for group, fit in zip(groups, fits, strict=True):
        for name, field in fields.items():
            field[group.positions] = turned_back(group, getattr(fit.solution.estimate, name))
    return {name: fields[f][:, axis] for name, (f, axis) in model.TABLE_COMPONENTS.items()}


def _covariance(groups: tuple[Group, ...], fits: tuple[Fitted, ...], name: str) -> Floats:
    """Return the (N, N) unit covariance of a component; zero between groups."""
    if len(groups) == 1:
        return turned_covariance(groups[0], fits[0].solution, name)
    n = sum(len(group.positions) for group in groups)
    covariance = np.zeros((n, n))
    for group, fit in zip(groups, fits, strict=True):
        place = np.ix_(group.positions, group.positions)
        covariance[place] = turned_covariance(group, fit.solution, name)
    return covariance


def _std(groups: tuple[Group, ...], fits: tuple[Fitted, ...], scale: float) -> dict[str, Floats]:
    if len(groups) == 1:
        unit = fits[0].solution.unit_std
        return {name: scale * unit.component(name) for name in COMPONENTS}
    return {name: scale * np.sqrt(np.diag(_covariance(groups, fits, name))) for name in COMPONENTS}


def _warnings(
    problem: BallPlateProblem, fits: tuple[Fitted, ...], noise: Noise, n_rejected: int
) -> tuple[str, ...]:
    warnings = []
    if len(fits) > 1:
        warnings.append(offset_warning(len(fits)))
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
    if n_rejected > MANY_REJECTED * len(problem.centres):
        warnings.append(f"{n_rejected} of {len(problem.centres)} centres were rejected")
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


def _residuals(
    whole: BallPlateProblem, groups: tuple[Group, ...], fits: tuple[Fitted, ...]
) -> Residuals:
    """One row per finite centre, in the order of the row numbers; lengths of the 3D residual."""
    position = {int(row): at for at, row in enumerate(np.sort(whole.rows))}
    n = len(whole.centres)
    columns = {name: np.zeros(n) for name in ("residual", "redundancy", "test_value")}
    used = np.zeros(n, dtype=np.bool_)
    for group, fit in zip(groups, fits, strict=True):
        at = np.array([position[int(row)] for row in group.problem.rows])
        columns["residual"][at] = np.linalg.norm(_all_residuals(group, fit), axis=1)
        at = np.array([position[int(row)] for row in fit.problem.rows])
        columns["redundancy"][at] = fit.test.redundancy
        columns["test_value"][at] = fit.test.value
        used[at] = True
    order = np.argsort(whole.rows)
    return Residuals(
        table_index=whole.table_index[order], target=whole.ball_step[order], used=used, **columns
    )


def _all_residuals(group: Group, fit: Fitted) -> Floats:
    """Observed - computed (n, 3) of all rows of a group, used or not, in the group's frame."""
    problem, found = group.problem, fit.solution.estimate
    turn = model.rotations(problem.angles)[problem.table_index]
    cross = problem.radius * model.cross_unit(problem.angles)[problem.cmm_index]
    cmm = np.zeros((problem.grid, 3))
    cmm[fit.problem.positions] = found.cmm
    plate = np.zeros((problem.grid, 3))
    plate[fit.problem.balls] = found.plate
    rotation = found.rotation[problem.table_index] + found.axis_rotation
    shift = found.translation[problem.table_index] + found.axis_shift
    moved = np.einsum("nij,nj->ni", turn, plate[problem.ball_step])
    turned = np.einsum("nij,nj->ni", cross, rotation)
    residuals: Floats = problem.deviations - moved - turned - shift - cmm[problem.cmm_index]
    return residuals


def _details(
    whole: BallPlateProblem, groups: tuple[Group, ...], fits: tuple[Fitted, ...], noise: Noise
) -> dict[str, Any]:
    """Everything else the method knows, in SI; one entry per group under ``groups``."""
    order = np.argsort(whole.rows)
    residuals = np.zeros((len(whole.centres), 3))
    where = {int(row): at for at, row in enumerate(whole.rows)}
    for group, fit in zip(groups, fits, strict=True):
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
            _group_details(g, fit, noise.used) for g, fit in zip(groups, fits, strict=True)
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
        "cmm_positions": problem.positions,
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
