"""What a report of the tracer method needs beside the deviations; SI, plain arrays and numbers."""

from __future__ import annotations

from typing import Any

import numpy as np

from rotcal_ros.methods.tracer.angles import algorithm_error, scatter
from rotcal_ros.methods.tracer.observability import weakest_direction
from rotcal_ros.methods.tracer.screening import rejection_limit
from rotcal_ros.methods.tracer.solution import TracerSolution
from rotcal_ros.methods.tracer.uncertainty import HALF_OF_95_PERCENT


def details(solution: TracerSolution) -> dict[str, Any]:
    """Return the method's own part of the result.

    ``station_ids`` (m,), which are table positions, and ``target_ids`` (n,) are the problem's
    indices of ``stations`` (m, 3) and ``targets`` (n, 3), all other arrays follow them.
    ``distances``: range at reading zero. ``radial``, ``axial``: distances of the stations from
    circle and plane. ``budget``: shares of the cumulative standard deviation by source, which add
    in squares. ``algorithm_error``: Eq. 36
    at the commanded steps, ``scatter``: Eq. 34.
    """
    problem, motion = solution.problem, solution.motion
    return {
        "variant": problem.variant,
        "datum": problem.datum if problem.variant == "joint" else "targets",
        **_network(solution),
        "plane": {"normal": motion.plane.normal, "offset": motion.plane.offset},
        "circle": {"centre": motion.centre, "radius": motion.radius},
        "radial": motion.radial,
        "axial": motion.plane.distances(solution.fit.stations),
        "tilt": motion.tilt,
        "algorithm_error": algorithm_error(np.diff(solution.table_angles), motion.tilt),
        "scatter": scatter(motion.adjacent),
        "budget": dict(solution.angles.budget),
        "covariance_scale": solution.scale,
        "coverage_factor": HALF_OF_95_PERCENT,
        **_tests(solution),
        "closure": [
            {"first": c.first, "last": c.last, "error": c.error, "std": c.std}
            for c in solution.evidence.closures
        ],
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
        "distances": fit.distances,
        "target_ids": grid.target_ids,
        "targets": fit.targets,
        "unknowns": fit.unknowns,
        "rank": fit.rank,
        "weakest": {
            "station": int(grid.position_ids[weak]),
            "direction": direction,
            "std": std,
        },
    }


def _tests(solution: TracerSolution) -> dict[str, Any]:
    """Return the outcomes of the tests, and residuals judged per station."""
    grid, fit, evidence = solution.grid, solution.fit, solution.evidence
    redundancy = fit.redundancy.sum(axis=1)
    squared = (grid.used * (fit.residual / fit.std) ** 2).sum(axis=1)
    return {
        "dof_effective": solution.covariance.dof_effective,
        "length_test": {
            "sigma0": evidence.lengths.sigma0,
            "probability": evidence.lengths.probability,
        },
        "circle_test": {
            "sigma0": evidence.circle.sigma0,
            "probability": evidence.circle.probability,
        },
        "redundancy_per_station": redundancy,
        "sigma0_per_station": np.sqrt(squared / np.maximum(redundancy, 1e-9)),
        "rejection_limit": rejection_limit(grid, solution.problem.settings.rejection_significance),
    }
