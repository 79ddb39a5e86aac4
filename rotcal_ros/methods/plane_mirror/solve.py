"""The plane-mirror calibration: a frozen problem in, the angular deviations out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np

from rotcal_ros.arrays import Floats
from rotcal_ros.methods.distributions import chi2_isf
from rotcal_ros.methods.plane_mirror import outcomes, screening
from rotcal_ros.methods.plane_mirror.estimate import Prepared
from rotcal_ros.methods.plane_mirror.normals import fit_normals, incidence
from rotcal_ros.methods.plane_mirror.outcomes import Outcome
from rotcal_ros.methods.plane_mirror.prepare import prepare
from rotcal_ros.methods.plane_mirror.problem import PlaneMirrorProblem
from rotcal_ros.methods.plane_mirror.residuals import empty_residuals
from rotcal_ros.methods.plane_mirror.settings import Way
from rotcal_ros.results import Residuals, Result

METHOD: Final = "plane_mirror"

_WAYS: Final[Mapping[Way, Callable[[Prepared, Residuals], Outcome]]] = {
    "direct": outcomes.direct,
    "stitching": outcomes.stitched,
    "registration": outcomes.registered,
    "joint": outcomes.joined,
}


def solve(problem: PlaneMirrorProblem) -> Result:
    """Return the angular deviation ECC of the table at every position, with covariance.

    Deviations are actual - commanded, counter-clockwise about the axis whose sense the commanded
    angles give, and zero at the first position (no method knows that offset). The paper,
    Muralikrishnan et al., "A Method to Calibrate Angular Positioning Errors Using a Laser Tracker
    and a Plane Mirror", prints commanded - measured (equations 6 to 19): the opposite sign.
    Standard deviations follow from the stated noise; when the residuals contradict it they are
    scaled up by ``sigma0``, with a warning.

    Raises DataError, GeometryError (see :mod:`~rotcal_ros.methods.plane_mirror.screening`).
    """
    screened = prepare(problem)
    prepared = screened.prepared
    residuals = empty_residuals(problem)
    outcome = _WAYS[problem.way](prepared, residuals)
    screening.check_size(problem, prepared.angles, outcome.deviations)
    sigma0 = float(np.sqrt(outcome.chi_square / outcome.dof)) if outcome.dof else 1.0
    covariance, warnings = _judge(problem, outcome, sigma0)
    repeats, differing = screening.repeats(
        prepared.angles, outcome.deviations, covariance, problem.significance
    )
    warnings = [*screened.warnings, *warnings, *differing]
    details = {"way": problem.way, **outcome.details, **_layout_details(prepared)}
    details["repeats"] = repeats
    details.update(_closure(prepared.angles, repeats))
    steps = np.diff(np.eye(len(prepared.angles)), axis=0)
    step_covariance = steps @ covariance @ steps.T
    return Result(
        method=METHOD,
        angles=prepared.angles,
        deviations={"ECC": outcome.deviations},
        std={"ECC": np.sqrt(np.maximum(np.diag(covariance), 0.0))},
        covariance={"ECC": covariance},
        sigma0=sigma0,
        dof=outcome.dof,
        n_observations=len(problem.xyz),
        rejected=screened.rejected,
        verdict="suspect" if warnings else "ok",
        warnings=tuple(warnings),
        adjacent_deviations=np.diff(outcome.deviations),
        adjacent_std=np.sqrt(np.maximum(np.diag(step_covariance), 0.0)),
        residuals=residuals,
        details=details,
    )


def _judge(
    problem: PlaneMirrorProblem, outcome: Outcome, sigma0: float
) -> tuple[Floats, list[str]]:
    """Covariance, scaled when the residuals are larger than the stated noise allows."""
    if outcome.dof == 0:
        return outcome.covariance, ["nothing is measured twice: the noise could not be checked"]
    if outcome.chi_square <= chi2_isf(problem.significance, outcome.dof):
        return outcome.covariance, []
    text = (
        f"the residuals are {sigma0:.2f} times what the stated noise explains; the standard "
        "deviations are scaled by that: check tracker noise, nests and mirror"
    )
    return outcome.covariance * sigma0**2, [text]


def _layout_details(prepared: Prepared) -> dict[str, Any]:
    """Stations and normals for the report."""
    problem, poses = prepared.problem, prepared.poses
    details: dict[str, Any] = {}
    if len(poses.rotation) > 1:
        details["stations"] = [
            {
                "station": problem.station_name(s),
                "position_m": poses.translation[s],
                "rotation": poses.rotation[s],
            }
            for s in range(len(poses.rotation))
        ]
    pairs = prepared.pairs
    if pairs is not None:
        normals = fit_normals(problem.xyz, pairs, prepared.pair_weight)
        angle = incidence(problem.xyz, pairs, normals.normal)
        steepest = np.maximum.reduceat(angle, pairs.start)
        details["incidence_limit_rad"] = problem.incidence_limit
        details["normals"] = [
            {
                "angle_rad": prepared.angles[pairs.position[g]],
                "station": problem.station_name(int(pairs.station[g])),
                "incidence_rad": steepest[g],
                "normal": normals.normal[g],
            }
            for g in range(pairs.n_groups)
        ]
    return details


def _closure(angles: Floats, repeats: list[dict[str, float | int]]) -> dict[str, float]:
    """Return how far the table is from its first place after a whole turn, if it was measured."""
    for entry in repeats:
        first, second = int(entry["first"]), int(entry["second"])
        if abs(angles[second] - angles[first]) > np.pi:
            sign = float(np.sign(angles[second] - angles[first]))
            return {
                "closure_rad": sign * entry["difference_rad"],
                "closure_std_rad": entry["std_rad"],
            }
    return {}
