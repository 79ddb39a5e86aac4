"""The plane-mirror calibration: a frozen problem in, the angular deviations out."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from rotcal_ros.adjust.distributions import chi2_isf
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.protection import ordered
from rotcal_ros.foundation.results import FreeDirection, Result
from rotcal_ros.methods.plane_mirror.solver import gathering, screening
from rotcal_ros.methods.plane_mirror.solver.correction import correct, drift_details, large_drifts
from rotcal_ros.methods.plane_mirror.solver.normals import incidence
from rotcal_ros.methods.plane_mirror.solver.outcomes import (
    AdjustedCurve,
    empty_residuals,
    outcome_of,
)
from rotcal_ros.methods.plane_mirror.solver.prepare import (
    PreparedNormals,
    PreparedPoints,
    PreparedWay,
)
from rotcal_ros.methods.plane_mirror.solver.problem import PlaneMirrorProblem
from rotcal_ros.methods.plane_mirror.solver.protections import MirrorEvidence, protections
from rotcal_ros.methods.plane_mirror.solver.stitching import islands
from rotcal_ros.methods.plane_mirror.solver.swing import swing_covariance

METHOD: Final = "plane_mirror"
UNTIED: Final = "table positions that share no reflector"


def solve(problem: PlaneMirrorProblem) -> Result:
    """Return the angular deviation ECC of the table at every position, with covariance.

    Deviations are actual - commanded, counter-clockwise about the axis whose sense the commanded
    angles give, and zero at the first position (no method knows that offset). The paper,
    Muralikrishnan et al., "A Method to Calibrate Angular Positioning Errors Using a Laser Tracker
    and a Plane Mirror", prints commanded - measured (equations 6 to 19): the opposite sign.
    Standard deviations follow from the stated noise; when the residuals contradict it they are
    scaled up by ``sigma0``, with a warning.

    Raises DataError, GeometryError (see :mod:`~rotcal_ros.methods.plane_mirror.solver.screening`).
    """
    (screened, gathered, points), residuals = gathering.settled(problem), empty_residuals(problem)
    prepared = screened.prepared
    outcome, correction = correct(prepared, outcome_of(prepared, residuals))
    screening.check_size(problem, prepared.angles, outcome.deviations)
    sigma0 = float(np.sqrt(outcome.chi_square / outcome.dof)) if outcome.dof else 1.0
    covariance, warnings = _judge(problem, outcome, sigma0)
    if (added := gathered.covariance()) is not None:
        covariance = covariance + added
    if points is not None:
        covariance = covariance + swing_covariance(prepared, points)
    curve = prepared.angles, outcome.deviations, covariance
    side = None if problem.upward is None else problem.upward[prepared.positions]
    repeats, differing = screening.repeats(*curve, problem.significance, side)
    std, closure = _std(covariance), _closure(prepared.angles, repeats)
    drifted = large_drifts(prepared, correction, std)
    gathers = gathering.doubts(gathered, problem)
    warnings = [*screened.warnings, *gathers, *warnings, *drifted, *differing]
    closes = closure.get("closure_std_rad")
    facts = MirrorEvidence(prepared, correction, std, outcome.dof, closes, points is not None)
    details = {**_details(prepared, outcome), "repeats": repeats, **closure}
    details |= gathering.details(gathered)
    steps = np.diff(np.eye(len(prepared.angles)), axis=0)
    result = Result(
        method=METHOD,
        angles=prepared.angles,
        deviations={"ECC": outcome.deviations},
        std={"ECC": std},
        covariance={"ECC": covariance},
        sigma0=sigma0,
        dof=outcome.dof,
        n_observations=len(problem.xyz),
        rejected=screened.rejected,
        verdict="suspect" if warnings else "ok",
        warnings=tuple(warnings),
        adjacent_deviations=np.diff(outcome.deviations),
        adjacent_std=_std(steps @ covariance @ steps.T),
        residuals=residuals,
        details={**details, **drift_details(prepared, correction, std)},
        protections=ordered((*protections(facts), *gathering.protection(gathered, prepared, std))),
    )
    return result.counted_from(*_zeros(prepared))


def _zeros(prepared: PreparedWay) -> tuple[str, tuple[FreeDirection, ...]]:
    """Return what ECC counts from, and the offsets of positions that no reflector ties together.

    With a mirror all positions are tied: see :func:`~.stitching.require_overlap`.
    """
    if not isinstance(prepared, PreparedPoints):
        return "first angle", ()
    seen = prepared.reflectors
    label, _ = islands(seen.position, seen.reflector, len(prepared.angles))
    free = tuple(
        FreeDirection(UNTIED, {"ECC": (label == own).astype(np.float64)})
        for own in range(1, int(label.max()) + 1)
    )
    return "first angle of each group" if free else "first angle", free


def _std(covariance: Floats) -> Floats:
    return np.sqrt(np.maximum(np.diag(covariance), 0.0))


def _details(prepared: PreparedWay, outcome: AdjustedCurve) -> dict[str, Any]:
    """Return the method's own part of the result; SI, plain arrays and numbers."""
    return {
        "way": prepared.problem.way,
        **outcome.details,
        **_stations(prepared),
        **_normals(prepared),
        **({} if prepared.problem.upward is None else {"table_positions": prepared.positions}),
    }


def _judge(
    problem: PlaneMirrorProblem, outcome: AdjustedCurve, sigma0: float
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


def _stations(prepared: PreparedWay) -> dict[str, Any]:
    """Return where the tracker stood, if the way brings its stations together."""
    poses = prepared.poses
    if len(poses.rotation) == 1:
        return {}
    return {
        "stations": [
            {
                "station": prepared.problem.station_name(s),
                "position_m": poses.translation[s],
                "rotation": poses.rotation[s],
            }
            for s in range(len(poses.rotation))
        ]
    }


def _normals(prepared: PreparedWay) -> dict[str, Any]:
    """Return the mirror's normals and how steeply they were seen, if there is a mirror."""
    if not isinstance(prepared, PreparedNormals):
        return {}
    problem, pairs = prepared.problem, prepared.pairs
    normals = prepared.normals(problem.xyz)
    angle = incidence(problem.xyz, pairs, normals.normal)
    steepest = np.maximum.reduceat(angle, pairs.start)
    return {
        "incidence_limit_rad": problem.incidence_limit,
        "normals": [
            {
                "angle_rad": prepared.angles[pairs.position[g]],
                "station": problem.station_name(int(pairs.station[g])),
                "incidence_rad": steepest[g],
                "normal": normals.normal[g],
            }
            for g in range(pairs.n_groups)
        ],
    }


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
