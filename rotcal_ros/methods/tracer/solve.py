"""The tracer method from problem to result."""

from __future__ import annotations

import numpy as np

from rotcal_ros.methods.tracer.details import details
from rotcal_ros.methods.tracer.problem import TracerProblem
from rotcal_ros.methods.tracer.solution import TracerSolution, adjust
from rotcal_ros.methods.tracer.verdict import judge
from rotcal_ros.results import Rejection, Residuals, Result

METHOD = "tracer_multistation"


def solve(problem: TracerProblem) -> Result:
    """Return the angular positioning deviations ECC of the table at the commanded angles.

    ``deviations["ECC"]`` (radians, actual - commanded) are *cumulative*, counted from the first
    angle with usable lengths, where deviation and standard deviation are zero;
    ``adjacent_deviations`` are those of the steps between neighbouring angles (the paper's
    Table 3). Standard deviations are for a normal distribution, see :mod:`.uncertainty`; the rules
    of rejection are in :mod:`.screening`, those of the verdict in :mod:`.verdict`. Angles whose
    station has too few lengths are absent from the result.
    Method: Laser tracer multi-station paper, Eq. 1-36. The order of the rows of ``problem`` does
    not change a bit of the result.

    Raises ObservabilityError when the geometry cannot tell the angle (it names the weak direction
    or both sides of Eq. 2), DataError for contradictory or implausible data.
    """
    return result_of(adjust(problem))


def result_of(solution: TracerSolution) -> Result:
    """Return what is known of a solved problem in the form that all methods share."""
    problem, motion, angles = solution.problem, solution.motion, solution.angles
    verdict, warnings = judge(solution.evidence, problem.settings)
    return Result(
        method=METHOD,
        angles=solution.table_angles,
        deviations={"ECC": motion.cumulative},
        std={"ECC": angles.std},
        covariance={"ECC": angles.covariance},
        sigma0=solution.evidence.lengths.sigma0,
        dof=solution.fit.dof,
        n_observations=len(problem.length),
        rejected=tuple(Rejection(row, why) for row, why in sorted(solution.rejected.items())),
        verdict=verdict,
        warnings=warnings,
        adjacent_deviations=motion.adjacent,
        adjacent_std=angles.adjacent_std,
        residuals=_residuals(solution),
        details=details(solution),
    )


def _residuals(solution: TracerSolution) -> Residuals:
    """Return one row per length; NaN where the station or target was dropped altogether."""
    problem, grid, fit = solution.problem, solution.grid, solution.fit
    place_of = np.full(len(problem.table_angles), -1)
    place_of[grid.position_ids] = np.arange(len(grid.position_ids))
    target_at = np.full(len(problem.targets), -1)
    target_at[grid.target_ids] = np.arange(len(grid.target_ids))
    j, i = place_of[problem.position], target_at[problem.target]
    known = (j >= 0) & (i >= 0)
    distance = np.linalg.norm(fit.stations[j] - fit.targets[i], axis=1) - fit.distances[j]
    placed = known & (grid.row[j, i] == np.arange(len(j)))
    return Residuals(
        table_index=problem.position,
        target=problem.target,
        residual=np.where(known, problem.length - distance, np.nan),
        redundancy=np.where(placed, fit.redundancy[j, i], 0.0),
        test_value=np.where(placed, fit.test_value[j, i], 0.0),
        used=placed & grid.used[j, i],
    )
