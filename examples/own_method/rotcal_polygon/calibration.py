"""From observations to the problem, from its solution to the result that all methods share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rotcal_polygon.adjustment import Adjustment, PolygonProblem, adjust
from rotcal_polygon.plan import NAME
from rotcal_polygon.protections import protections
from rotcal_polygon.settings import PolygonPlanSettings
from rotcal_ros.adjust.distributions import chi2_sf
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.observations import Observation
from rotcal_ros.foundation.results import Rejection, Residuals, Result
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.methods.configuration import Configuration
from rotcal_ros.planning.plan import Plan

SIGNIFICANCE = 0.01
"""Level of the chi-square test of the stated noise."""
MANY_REJECTED = 0.05


@dataclass(frozen=True)
class Noise:
    """Found noise / stated noise, and how often chance gives more; None: nothing checks it.

    A closure is a position that is measured twice in a mounting: the test is that of it as well.
    """

    sigma0: float
    p_value: float | None

    @property
    def contradicts(self) -> bool:
        """Whether there is more noise than was stated."""
        return self.p_value is not None and self.p_value < SIGNIFICANCE

    @property
    def scale(self) -> float:
        """What the uncertainties are larger by than the stated noise makes them."""
        return self.sigma0 if self.contradicts else 1.0


@dataclass(frozen=True, eq=False)
class PolygonTrials:
    """Monte Carlo trials: the estimate ``value`` (N,) is linear in rows with noise ``std``."""

    value: Floats
    gain: Floats
    std: Floats

    def __call__(self, rng: np.random.Generator, count: int) -> Floats:
        """Return ECC (count, N), rad."""
        noise = self.std * rng.standard_normal((count, len(self.std)))
        return np.asarray(self.value + noise @ self.gain.T, dtype=np.float64)


def solve(configuration: Configuration, plan: Plan, observations: Sequence[Observation]) -> Result:
    """Solve accepted observations; residuals are radians, ``target`` is the face.

    Raises DataError without any observation and ObservabilityError with too few.
    """
    problem = problem_of(configuration, observations)
    found, n_readings = adjust(problem), len(problem.reading)
    noise, rows = _noise(found), slice(n_readings)
    warnings = _warnings(problem, found, noise)
    covariance = noise.scale**2 * found.covariance(found.gain_table)
    face_std = noise.scale * np.sqrt(np.diag(found.covariance(found.gain_face)))
    return Result(
        method=NAME,
        angles=np.array(plan.table_angles[: problem.faces]),
        deviations={"ECC": found.table},
        std={"ECC": np.sqrt(np.diag(covariance))},
        covariance={"ECC": covariance},
        sigma0=noise.sigma0,
        dof=found.dof,
        n_observations=n_readings,
        rejected=tuple(
            Rejection(row, f"normalised residual {found.test_value[row]:.1f}")
            for row in np.flatnonzero(~found.used).tolist()
        ),
        verdict="suspect" if warnings else "ok",
        warnings=warnings,
        protections=protections(problem),
        residuals=Residuals(
            table_position=np.array([o.table_position for o in observations], dtype=np.int64),
            target=problem.face,
            residual=found.residual[rows],
            redundancy=found.redundancy[rows],
            test_value=found.test_value[rows],
            used=found.used[rows],
        ),
        details={
            "faces_known_by": _faces_known_by(problem),
            "face_error_rad": found.face,
            "face_error_std_rad": face_std,
            "chi_square": {"dof": found.dof, "p_value": noise.p_value},
        },
    )


def trials(
    configuration: Configuration, _plan: Plan, observations: Sequence[Observation]
) -> PolygonTrials:
    """Prepare Monte Carlo trials about accepted observations."""
    found = adjust(problem_of(configuration, observations))
    return PolygonTrials(found.table, found.gain_table, _noise(found).scale * found.std)


def check(
    configuration: Configuration, _plan: Plan, observations: Sequence[Observation]
) -> tuple[str, ...]:
    """Return in words that the newest mounting is not aligned, by its first reading."""
    settings: PolygonPlanSettings = configuration.plan
    newest = max((o.station for o in observations), default=0)
    limit = settings.alignment_arcsec
    return tuple(
        f"mounting {newest} reads {o.mean[0] / ARCSEC:.4g} arcsec at position 0, allowed {limit:g}"
        for o in observations
        if (o.station, o.table_position) == (newest, 0) and abs(o.mean[0]) > limit * ARCSEC
    )


def problem_of(
    configuration: Configuration, observations: Sequence[Observation]
) -> PolygonProblem:
    """Return the problem that observations pose; position N is position 0 again."""
    if not observations:
        raise DataError("the autocollimator has read nothing: there is nothing to solve")
    settings, solver = configuration.plan, configuration.solver
    known = solver.face_errors_arcsec
    return PolygonProblem(
        faces=settings.faces,
        position=np.array(
            [o.table_position % settings.faces for o in observations], dtype=np.int64
        ),
        face=np.array([o.target for o in observations], dtype=np.int64),
        mounting=np.array([o.station for o in observations], dtype=np.int64),
        reading=np.array([o.mean[0] for o in observations]),
        sigma=solver.sigma_arcsec * ARCSEC,
        certificate=np.array(known) * ARCSEC if known else None,
        certificate_std=solver.face_std_arcsec * ARCSEC,
        unknown_faces=bool(known) or len(settings.first_faces) > 1,
    )


def _noise(found: Adjustment) -> Noise:
    if found.dof == 0:
        return Noise(1.0, None)
    return Noise(
        float(np.sqrt(found.square_sum / found.dof)), chi2_sf(found.square_sum, found.dof)
    )


def _faces_known_by(problem: PolygonProblem) -> str:
    if problem.certificate is not None:
        return "certificate and readings"
    return "the readings" if problem.unknown_faces else "nothing"


def _warnings(problem: PolygonProblem, found: Adjustment, noise: Noise) -> tuple[str, ...]:
    """Return what is odd in words; anything makes the result suspect."""
    warnings, rejected = [], ~found.used[: len(problem.reading)]
    if not problem.unknown_faces:
        warnings.append(
            "the errors of the polygon are in the result: there is one mounting and no "
            "certificate; add mountings, or solver.face_errors_arcsec"
        )
    if noise.contradicts:
        warnings.append(
            f"the readings contradict the stated noise (sigma0 = {noise.sigma0:.3f}, p = "
            f"{noise.p_value:.2g}): uncertainties follow the residuals"
        )
    warnings += [
        f"mounting {problem.mounting[row]} does not close, a reading of position 0 is off by "
        f"{found.residual[row] / ARCSEC:.3g} arcsec: something drifts or has moved"
        for row in np.flatnonzero(rejected & (problem.position == 0))
    ]
    if rejected.sum() > MANY_REJECTED * len(rejected):
        warnings.append(f"{rejected.sum()} of {len(rejected)} readings were rejected")
    return tuple(warnings)
