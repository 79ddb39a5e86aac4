"""The six-deviations method from problem to result."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from rotcal_ros.components import COMPONENTS, HALF_OF_95_PERCENT
from rotcal_ros.methods.tracer.gathering import details as gathering_details
from rotcal_ros.methods.tracer.numbering import Numbering
from rotcal_ros.methods.tracer.screening import rejection_limit
from rotcal_ros.methods.tracer_six.problem import SixProblem
from rotcal_ros.methods.tracer_six.protections import protections
from rotcal_ros.methods.tracer_six.response import influence_of
from rotcal_ros.methods.tracer_six.segments import segment_report
from rotcal_ros.methods.tracer_six.solution import SixSolution, adjust
from rotcal_ros.methods.tracer_six.upward import Upward
from rotcal_ros.methods.tracer_six.verdict import judge
from rotcal_ros.protection import ordered
from rotcal_ros.raw_data import RawData
from rotcal_ros.results import Rejection, Residuals, Result, Zeros

METHOD = "tracer_six"


def solve(problem: SixProblem) -> Result:
    """Return EXC, EYC, EZC (m), EAC, EBC, ECC (rad) of the table at the commanded angles.

    Actual - commanded, of the point of the axis at the machine's z = 0, in a frame along the axis
    with x towards the machine's x. Each curve has zero mean; EXC, EYC and EAC, EBC have no part
    that turns with the table, for that is how the axis itself is defined. Standard deviations
    come from the lengths, the targets' prior and the scatter of the table from run to run;
    positions whose places leave a direction open are absent. The order of the rows does not
    change a bit of the result.

    Raises ObservabilityError where the places or the lengths cannot tell all six (it names the
    lost direction), DataError for contradictory or implausible data.
    """
    return result_of(adjust(problem))


def result_of(solution: SixSolution) -> Result:
    """Return what is known of a solved problem in the form that all methods share."""
    covariance = {name: solution.covariance_of(name) for name in COMPONENTS}
    numbering = _numbering(solution)
    upward = Upward.of(solution)
    verdict, warnings = upward.judged(*numbering.judged(*judge(solution)))
    return Result(
        method=METHOD,
        angles=solution.layout.angles,
        deviations=solution.deviations(),
        std={name: np.sqrt(matrix.diagonal()) for name, matrix in covariance.items()},
        covariance=covariance,
        sigma0=solution.lengths.sigma0,
        dof=solution.fit.dof,
        n_observations=len(solution.problem.length),
        rejected=tuple(Rejection(row, why) for row, why in sorted(solution.rejected.items())),
        verdict=verdict,
        warnings=warnings,
        residuals=_residuals(solution),
        details=_details(solution),
        protections=ordered((*protections(solution), numbering.protection(), upward.protection())),
        raw_data=RawData(influence=influence_of(solution)),
        zeros=Zeros("mean"),
    )


def _numbering(solution: SixSolution) -> Numbering:
    """Return how the places found stand round the axis to those that the plan states."""
    found = solution.places[:, :2] @ (1.0, 1j)
    stated = solution.problem.places[solution.layout.place_ids, :2] @ (1.0, 1j)
    return Numbering.of(
        "the plan (places, azimuth_deg)",
        solution.layout.angles,
        float(np.abs(found).mean()),
        float(np.angle(np.vdot(stated, found))),
        solution.problem.place_tolerance,
    )


def _residuals(solution: SixSolution) -> Residuals:
    """Return one row per length; NaN where the position or target was dropped altogether."""
    problem, grid, fit = solution.problem, solution.grid, solution.fit
    k = len(problem.length)
    residual, std = np.full(k, np.nan), problem.length_std.copy()
    redundancy, test_value = np.zeros(k), np.zeros(k)
    used = np.zeros(k, dtype=np.bool_)
    there = grid.row >= 0
    row = grid.row[there]
    residual[row], std[row] = fit.residual[there], fit.std[there]
    used[row] = grid.used[there]
    checked = there & grid.used
    row = grid.row[checked]
    redundancy[row], test_value[row] = fit.redundancy[checked], fit.test_value[checked]
    return Residuals(
        table_position=problem.position,
        target=problem.target,
        residual=residual,
        redundancy=redundancy,
        test_value=test_value,
        used=used,
        std=std,
    )


def _details(solution: SixSolution) -> dict[str, Any]:
    """Return the method's own part of the result, SI.

    ``places`` (p, 3) in the frame that turns with the table, z along the axis; ``place_ids`` are
    the problem's; ``axis``: where the axis meets the machine's z = 0, and its direction.
    ``slips``: size of a fringe, m, and how probably one at any moment is found.
    """
    problem, rig, curves = solution.problem, solution.rig, solution.table.curves
    slips = solution.slips
    return {
        "datum": problem.datum,
        "zero": problem.zero,
        "position_ids": solution.positions,
        "place_ids": solution.layout.place_ids,
        "places": solution.places,
        "zeros": solution.zeros,
        "segments": segment_report(solution),
        "target_ids": solution.grid.target_ids,
        "targets": rig.state.targets,
        "axis": {"origin": curves.origin, "direction": curves.axes[:, 2]},
        "unknowns": solution.fit.unknowns,
        "rank": solution.fit.rank,
        "covariance_scale": solution.scale,
        "coverage_factor": HALF_OF_95_PERCENT,
        "scatter": _scatter(solution),
        "noise": solution.noise.details(),
        "slips": None if slips is None else {"size": slips.size, "found": slips.found},
        "length_test": asdict(solution.lengths),
        "gathering": gathering_details(solution.gathering),
        "rejection_limit": rejection_limit(solution.grid, problem.settings.rejection_significance),
        "closure": {
            name: [asdict(closure) for closure in found]
            for name, found in solution.closures.items()
            if found
        },
        "moves": [
            {
                "kind": test.kind,
                "place_ids": solution.layout.place_ids[test.places].tolist(),
                "moved": test.moved.tolist(),
                "p_value": test.probability,
            }
            for test in solution.moves.tests
        ],
    }


def _scatter(solution: SixSolution) -> dict[str, Any]:
    scatter = solution.scatter
    return {
        "translation": scatter.translation,
        "rotation": scatter.rotation,
        "estimated": scatter.estimated,
        "n_contrasts": scatter.n_contrasts,
        "p_value": scatter.probability,
    }
