"""The plane-mirror calibration: a frozen problem in, the angular deviations out.

:func:`solve` makes the result of one measurement, :func:`mirror_trials` prepares simulated ones
about it, of which a thousand are solved in one go.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from rotcal_ros.adjust.distributions import chi2_isf
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.protection import ordered
from rotcal_ros.foundation.results import FreeDirection, Result
from rotcal_ros.methods.plane_mirror.solver import gathering, screening
from rotcal_ros.methods.plane_mirror.solver.drift import DriftCorrection, swings
from rotcal_ros.methods.plane_mirror.solver.normals import (
    fit_cone,
    image_response,
    incidence,
    tangent_frame,
)
from rotcal_ros.methods.plane_mirror.solver.prepare import (
    PreparedNormals,
    PreparedPoints,
    PreparedWay,
)
from rotcal_ros.methods.plane_mirror.solver.problem import PlaneMirrorProblem
from rotcal_ros.methods.plane_mirror.solver.protections import MirrorEvidence, protections
from rotcal_ros.methods.plane_mirror.solver.readings import islands, station_cones
from rotcal_ros.methods.plane_mirror.solver.ways import (
    AdjustedCurve,
    adjusted_curve,
    empty_residuals,
)
from rotcal_ros.methods.plane_mirror.solver_settings import STITCHING

METHOD: Final = "plane_mirror"
UNTIED: Final = "table positions that share no reflector"
_CHUNK: Final = 250  # trials at a time keep the arrays small enough for the cache


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
    curve, correction = _with_drift(prepared, adjusted_curve(prepared, residuals))
    angles, deviations = prepared.angles, curve.deviations
    screening.check_size(problem, angles, deviations)
    sigma0 = float(np.sqrt(curve.chi_square / curve.dof)) if curve.dof else 1.0
    covariance, warnings = _judge(problem, curve, sigma0)
    # To the noise come errors that may gather in one place, and drift that the nests cannot show.
    if (added := gathered.covariance()) is not None:
        covariance = covariance + added
    if points is not None:
        swung = points.response(swings(prepared.problem, prepared.drift))
        covariance = covariance + swung @ swung.T
    side = None if problem.upward is None else problem.upward[prepared.positions]
    repeats, differing = screening.repeats(
        angles, deviations, covariance, problem.significance, side
    )
    std, closure = _std(covariance), _closure(angles, repeats)
    gathers = gathering.doubts(gathered, problem)
    warnings = [
        *screened.warnings, *gathers, *warnings, *correction.doubts(std), *differing
    ]  # fmt: skip
    closes = closure.get("closure_std_rad")
    facts = MirrorEvidence(prepared, correction, std, curve.dof, closes, points is not None)
    details = {**_details(prepared, curve), "repeats": repeats, **closure}
    details |= gathering.details(gathered)
    steps = np.diff(np.eye(len(angles)), axis=0)
    result = Result(
        method=METHOD,
        angles=angles,
        deviations={"ECC": deviations},
        std={"ECC": std},
        covariance={"ECC": covariance},
        sigma0=sigma0,
        dof=curve.dof,
        n_observations=len(problem.xyz),
        rejected=screened.rejected,
        verdict="suspect" if warnings else "ok",
        warnings=tuple(warnings),
        adjacent_deviations=np.diff(deviations),
        adjacent_std=_std(steps @ covariance @ steps.T),
        residuals=residuals,
        details={**details, **correction.details(std)},
        protections=ordered((*protections(facts), *gathering.protection(gathered, prepared, std))),
    )
    return result.counted_from(*_zeros(prepared))


def _with_drift(
    prepared: PreparedWay, curve: AdjustedCurve
) -> tuple[AdjustedCurve, DriftCorrection]:
    """Return the curve with the uncertainty of the drift in it, and what the drift did."""
    drift = prepared.drift
    correction = DriftCorrection.of(prepared.problem, drift, prepared.drift_response())
    if not drift.size:
        return curve, correction
    curve = replace(curve, covariance=curve.covariance + correction.covariance)
    if not len(prepared.nests.row):  # else the nests are in the fit, with what the drift took
        curve = replace(
            curve,
            chi_square=curve.chi_square + sum(s.chi_square for s in drift.stations),
            dof=curve.dof + sum(s.dof for s in drift.stations),
        )
    return curve, correction


def _zeros(prepared: PreparedWay) -> tuple[str, tuple[FreeDirection, ...]]:
    """Return what ECC counts from, and the offsets of positions that no reflector ties together.

    With a mirror all positions are tied: see :func:`~.readings.require_overlap`.
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
    """Return standard deviations (n,); rounding may leave a variance of zero below it."""
    return np.sqrt(np.maximum(np.diag(covariance), 0.0))


def _details(prepared: PreparedWay, curve: AdjustedCurve) -> dict[str, Any]:
    """Return the method's own part of the result; SI, plain arrays and numbers."""
    return {
        "way": prepared.problem.way,
        **curve.details,
        **_stations(prepared),
        **_normals(prepared),
        **({} if prepared.problem.upward is None else {"table_positions": prepared.positions}),
    }


def _judge(
    problem: PlaneMirrorProblem, curve: AdjustedCurve, sigma0: float
) -> tuple[Floats, list[str]]:
    """Return the covariance, and a warning where it could not be trusted as it is.

    It is scaled when the residuals are larger than the stated noise allows.
    """
    if curve.dof == 0:
        return curve.covariance, ["nothing is measured twice: the noise could not be checked"]
    if curve.chi_square <= chi2_isf(problem.significance, curve.dof):
        return curve.covariance, []
    text = (
        f"the residuals are {sigma0:.2f} times what the stated noise explains; the standard "
        "deviations are scaled by that: check tracker noise, nests and mirror"
    )
    return curve.covariance * sigma0**2, [text]


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


@dataclass(frozen=True)
class MirrorTrials:
    """Draws measurements like the given one and solves them; made by :func:`mirror_trials`.

    ``factor`` (n, 3, 3) are Cholesky factors of the points' covariances, ``tilt`` (2 N, 3 n) the
    movement of all coordinates per tilt (rad) of the table across and along the normal, ``swing``
    (K, 3 n) the same per standard deviation of the tracker's :func:`~.drift.swings`.
    """

    prepared: PreparedWay
    factor: Floats
    tilt: Floats
    swing: Floats

    def __call__(self, rng: np.random.Generator, count: int) -> Floats:
        """Return the deviations (count, N) in rad of ``count`` simulated measurements."""
        parts = [
            self.prepared.estimate(self.draw(rng, min(_CHUNK, count - done)))
            for done in range(0, count, _CHUNK)
        ]
        return np.concatenate(parts)

    def draw(self, rng: np.random.Generator, count: int) -> Floats:
        """Return points (count, n, 3): the measured ones with fresh noise and table tilts."""
        xyz = self.prepared.problem.xyz
        noise = rng.standard_normal((count, *xyz.shape))
        tilts = self.prepared.problem.tilt_std * rng.standard_normal((count, len(self.tilt)))
        points: Floats = xyz + (self.factor @ noise[..., None])[..., 0]
        points += (tilts @ self.tilt).reshape(points.shape)
        if len(self.swing):
            amplitudes = rng.standard_normal((count, len(self.swing)))
            points += (amplitudes @ self.swing).reshape(points.shape)
        return points


def mirror_trials(problem: PlaneMirrorProblem) -> MirrorTrials:
    """Prepare Monte Carlo trials about a measured problem; refuses what ``solve`` refuses."""
    prepared = gathering.settled(problem).screened.prepared
    swing = swings(prepared.problem, prepared.drift).reshape(problem.xyz.size, -1).T
    covariance = problem.noise.covariance(problem.xyz)
    if isinstance(prepared, PreparedPoints):
        none = np.zeros((0, problem.xyz.size))
        return MirrorTrials(prepared, _factor(covariance), none, none)
    pairs, normals = prepared.pairs, prepared.normals(problem.xyz)
    response = image_response(
        problem.xyz[pairs.direct],
        problem.xyz[pairs.mirrored],
        normals.normal[pairs.group],
        normals.offset[pairs.group],
    )
    # The glass is not flat: it gives each mirrored point a normal of its own.
    slope = problem.noise.mirror_slope_std * response
    covariance[pairs.mirrored] += slope @ np.swapaxes(slope, 1, 2)
    axes, height = _axes(prepared, normals.normal)
    t, b = tangent_frame(normals.normal, axes)
    tilt = np.zeros((len(prepared.angles), 2, *problem.xyz.shape))
    # A tilt of the table across the normal moves it along b; one about the normal's own horizontal
    # direction moves it along t, by sin(beta) of the tilt.
    for which, change in enumerate((b, height * t)):
        moved = (response @ change[pairs.group][..., None])[..., 0]
        tilt[pairs.position[pairs.group], which, pairs.mirrored] = moved
    tilt = tilt.reshape(-1, problem.xyz.size)
    return MirrorTrials(prepared, _factor(covariance), tilt, swing)


def _factor(covariance: Floats) -> Floats:
    """Return the Cholesky factors of covariances (n, 3, 3)."""
    return np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)


def _axes(prepared: PreparedNormals, normals: Floats) -> tuple[Floats, float]:
    """Return the table axis (G, 3) as each group's station sees it, and the height of the cone."""
    angles, pairs = prepared.angles, prepared.pairs
    if prepared.problem.way == STITCHING:
        axes, height = station_cones(normals, pairs, angles)
        return axes, float(height)
    placed = prepared.poses.turned(normals, pairs.station)
    axis, common = fit_cone(placed, angles[pairs.position])
    return axis @ prepared.poses.rotation[pairs.station], float(common)
