"""What became of each segment's zero: where it is, and its step against the segment before."""

from __future__ import annotations

from typing import Any

import numpy as np

from rotcal_ros.adjust.distributions import chi2_sf
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.methods.tracer.solver.network import linearise
from rotcal_ros.methods.tracer.solver.solution import TracerSolution


def segment_report(solution: TracerSolution) -> list[dict[str, Any]]:
    """Return one entry per unbroken zero, in the order of time; none for a zero per station.

    ``zero``, ``std``: range at reading zero where the segment begins, m. ``step``, ``step_std``:
    the zero less that at the end of the segment before, as stations and targets that both have
    measured tell it, m; ``probability``: how likely it would be if the zero had stayed.
    """
    grid, fit = solution.grid, solution.fit
    if grid.zero is None or grid.segment_ids is None:
        return []
    network = fit.network or linearise(grid, fit.state, fit.targets)
    zeros = slice(len(network.layout.places), None)
    covariance = solution.scale**2 * network.reduced.covariance()[zeros, zeros]
    value = fit.distances[grid.first_of_zero]
    linked = np.zeros(grid.n_zeros) if grid.walk is None else np.isfinite(grid.walk)
    last = np.flatnonzero(~linked.astype(bool))
    first = np.append(0, last[:-1] + 1)
    order = solution.problem.measuring_order
    taken = np.where(grid.row >= 0, order[grid.row], order.max() + 1).min(axis=1)
    when = np.array([taken[grid.zero == z].min() for z in first])
    chain = np.searchsorted(last, grid.zero)
    count = np.bincount(chain, weights=grid.used.sum(axis=1), minlength=len(last))
    found: list[dict[str, Any]] = []
    before = None
    for k in np.argsort(when, kind="stable").tolist():
        z = first[k]
        entry = {
            "segment": int(grid.segment_ids[z]),
            "lengths": int(count[k]),
            "zero": float(value[z]),
            "std": float(np.sqrt(covariance[z, z])),
        }
        if before is not None:
            entry |= step_between(value, covariance, before, z)
        found.append(entry)
        before = last[k]
    return found


def step_between(value: Floats, covariance: Floats, before: int, after: int) -> dict[str, float]:
    """Return by how much one zero (m) is larger than the one ``before`` it, and how sure that is.

    ``value`` (s,), ``covariance`` (s, s) of all zeros; ``probability``: of such a step by chance.
    """
    step = float(value[after] - value[before])
    pair = [before, after]
    (a, b), (_, c) = covariance[np.ix_(pair, pair)].tolist()
    variance = c + a - 2 * b
    return {
        "step": step,
        "step_std": float(np.sqrt(variance)),
        "probability": chi2_sf(step**2 / variance, 1.0),
    }
