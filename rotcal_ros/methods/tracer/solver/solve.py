"""The tracer method from problem to result."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from rotcal_ros.adjust import gathering
from rotcal_ros.foundation.arrays import Bools, Floats
from rotcal_ros.foundation.components import HALF_OF_95_PERCENT
from rotcal_ros.foundation.protection import ordered
from rotcal_ros.foundation.raw_data import RawData
from rotcal_ros.foundation.results import Placement, Rejection, Residuals, Result, Zeros
from rotcal_ros.methods.tracer.solver.adjustment import Adjustment
from rotcal_ros.methods.tracer.solver.circle import TableMotion, algorithm_error, scatter
from rotcal_ros.methods.tracer.solver.joint import target_corrections
from rotcal_ros.methods.tracer.solver.observability import Numbering, turned_by, weakest_direction
from rotcal_ros.methods.tracer.solver.problem import Grid, LengthProblem, TracerProblem
from rotcal_ros.methods.tracer.solver.protections import influence_of, protections, returned
from rotcal_ros.methods.tracer.solver.screening import WORDS, rejection_limit
from rotcal_ros.methods.tracer.solver.solution import TracerSolution, adjust
from rotcal_ros.methods.tracer.solver.verdict import judge
from rotcal_ros.methods.tracer.solver.zeros import segment_report

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

    Raises ObservabilityError when the geometry cannot determine the angle (it names the weak
    direction or both sides of Eq. 2), DataError for contradictory or implausible data.
    """
    return result_of(adjust(problem))


def result_of(solution: TracerSolution) -> Result:
    """Return what is known of a solved problem in the form that all methods share."""
    problem, motion, angles = solution.problem, solution.motion, solution.angles
    numbering = _numbering(solution)
    verdict, warnings = numbering.judged(*judge(solution.evidence, problem.settings))
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
        details=_details(solution),
        protections=ordered((*protections(solution), numbering.protection())),
        raw_data=RawData(influence=influence_of(solution)),
        zeros=Zeros("first angle"),
        budget=solution.angles.budget,
        placement=Placement.upwards(
            motion.centre, motion.plane.normal, solution.grid.position_ids, solution.fit.stations
        ),
        error_motion=solution.error_motion,
    )


def _numbering(solution: TracerSolution) -> Numbering:
    """Return how the stations stand to the start values that a plan or a person has stated."""
    stated, stations = solution.problem.start_stations, solution.fit.stations
    bearing = None if stated is None else turned_by(stations, stated[solution.positions])
    return Numbering.of("plan.tracer_m", solution.table_angles, solution.motion.radius, bearing)


def _residuals(solution: TracerSolution) -> Residuals:
    """Return one row per length; NaN where the station or target was dropped altogether."""
    problem, grid, fit = solution.problem, solution.grid, solution.fit
    place_of = np.full(len(problem.table_angles), -1)
    place_of[grid.position_ids] = grid.first_strip
    target_at = np.full(len(problem.targets), -1)
    target_at[grid.target_ids] = np.arange(len(grid.target_ids))
    j, i = place_of[problem.position], target_at[problem.target]
    known = (j >= 0) & (i >= 0)
    if grid.zero is not None:
        at, filled = np.nonzero(grid.row >= 0)
        j[:] = -1
        j[grid.row[at, filled]] = at
        known = j >= 0
    distance = np.linalg.norm(fit.standing[j] - fit.targets[i], axis=1) - fit.distances[j]
    return residual_table(problem, grid, fit, np.where(known, problem.length - distance, np.nan))


def residual_table(
    problem: LengthProblem, grid: Grid, fit: Adjustment, residual: Floats
) -> Residuals:
    """Return one row per length (k,) with its ``residual``, and a test of what is on the grid."""
    there = grid.row >= 0

    def of_rows(values: Floats | Bools, otherwise: Floats | float) -> Floats:
        column = np.full(len(problem.length), otherwise, dtype=np.float64)
        column[grid.row[there]] = values[there]
        return column

    return Residuals(
        table_position=problem.position,
        target=problem.target,
        residual=residual,
        redundancy=of_rows(fit.redundancy, 0.0),
        test_value=of_rows(fit.test_value, 0.0),
        used=of_rows(grid.used, 0.0).astype(np.bool_),
        std=of_rows(fit.std, problem.length_std),
    )


def _details(solution: TracerSolution) -> dict[str, Any]:
    """Return the method's own part of the result.

    ``station_ids`` (m,), which are table positions, and ``target_ids`` (n,) are the problem's
    indices of ``stations`` (m, 3) and ``targets`` (n, 3), all other arrays follow them.
    ``distances``: range at reading zero. ``radial``, ``axial``: distances of the stations from
    circle and plane. ``algorithm_error``: Eq. 36 at the commanded steps, ``scatter``: Eq. 34.
    ``returned``: positions at the same angle, and by less than what (m, 95 %) their stations lie
    apart along the circle.
    """
    problem = solution.problem
    stated = solution.evidence.circle_statement
    return {
        "variant": problem.variant,
        "datum": problem.datum if problem.variant == "joint" else "targets",
        **_network(solution),
        **circle_details(solution.motion, solution.fit.stations, solution.table_angles),
        "covariance_scale": solution.scale * float(solution.noise.factors[0]),
        "coverage_factor": HALF_OF_95_PERCENT,
        **_tests(solution),
        **({} if stated is None else {"circle_prior": asdict(stated)}),
        **_zeros(solution),
        "closure": [asdict(closure) for closure in solution.evidence.closures],
        "returned": [asdict(closing) for closing in returned(solution)],
    }


def circle_details(motion: TableMotion, stations: Floats, angles: Floats) -> dict[str, Any]:
    """Return what ``stations`` (m, 3), m, at table ``angles`` (m,), rad, show of their circle."""
    return {
        "plane": {"normal": motion.plane.normal, "offset": motion.plane.offset},
        "circle": {"centre": motion.centre, "radius": motion.radius},
        "radial": motion.radial,
        "axial": motion.plane.distances(stations),
        "tilt": motion.tilt,
        "algorithm_error": algorithm_error(np.diff(angles), motion.tilt),
        "scatter": scatter(motion.adjacent),
    }


def _network(solution: TracerSolution) -> dict[str, Any]:
    """Return stations, distances and targets, and which direction is known worst."""
    grid, fit = solution.grid, solution.fit
    blocks = solution.scale**2 * solution.covariance.position_blocks()
    weak, std, direction = weakest_direction(blocks)
    return {
        "station_ids": grid.position_ids,
        "stations": fit.stations,
        "station_std": np.sqrt(np.diagonal(blocks, axis1=1, axis2=2)),
        "station_covariance": blocks,
        "distances": fit.distances[grid.first_strip],
        "target_ids": grid.target_ids,
        "targets": fit.targets,
        **_corrections(solution),
        "unknowns": fit.unknowns,
        "rank": fit.rank,
        "weakest": {"station": int(grid.position_ids[weak]), "direction": direction, "std": std},
    }


def _corrections(solution: TracerSolution) -> dict[str, Any]:
    """Return by what the targets were corrected; nothing where they are taken as known."""
    if solution.problem.variant == "station":
        return {}
    moved, std = target_corrections(solution.grid, solution.fit)
    return {"target_corrections": moved, "target_corrections_std": solution.scale * std}


def _tests(solution: TracerSolution) -> dict[str, Any]:
    """Return the outcomes of the tests, and residuals judged per station."""
    grid, fit, evidence = solution.grid, solution.fit, solution.evidence
    redundancy = grid.per_station(fit.redundancy)
    squared = grid.per_station(grid.used * (fit.residual / fit.std) ** 2)
    return {
        "dof_effective": solution.covariance.dof_effective,
        "noise": solution.noise.details(),
        "length_test": asdict(evidence.lengths),
        "circle_test": asdict(evidence.circle),
        "redundancy_per_station": redundancy,
        "sigma0_per_station": np.sqrt(squared / np.maximum(redundancy, 1e-9)),
        "gathering": gathering.details(evidence.gathering, WORDS.elements),
        "rejection_limit": rejection_limit(grid, solution.problem.settings.rejection_significance),
    }


def _zeros(solution: TracerSolution) -> dict[str, Any]:
    """Return the zeros of segments, their walk per length that was used, m, and slips.

    ``slips``: size of a fringe, m, and how probably one at any moment is found.
    """
    if solution.problem.segment is None:
        return {}
    walk, slips = solution.grid.walk, solution.slips
    return {
        "segments": segment_report(
            solution.grid, solution.fit, solution.problem.measuring_order, solution.scale
        ),
        "zero_walk_std": 0.0 if walk is None else float(walk.min()),
        "slips": None if slips is None else {"size": slips.size, "found": slips.found},
    }
