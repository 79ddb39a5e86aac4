"""When each length was taken, as a share of all runs and of its own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.methods.tracer.solver.grid import Grid
from rotcal_ros.methods.tracer_six.solver.problem import SixProblem


@dataclass(frozen=True, eq=False)
class NetworkTiming:
    """Shares (V, n), 0 to 1, that had gone of all runs, and of the own run."""

    whole: Floats
    own: Floats


def taken(problem: SixProblem) -> Ints:
    """Return when each length (k,) was taken, in growing numbers."""
    if problem.order is not None:
        return problem.order
    arrival = np.zeros_like(problem.place) if problem.arrival is None else problem.arrival
    return np.lexsort((problem.target, problem.position, arrival, problem.place)).argsort()


def timing(problem: SixProblem, grid: Grid) -> NetworkTiming:
    """Return when the lengths of ``grid`` were taken; see SixProblem.order."""
    row, order = grid.row, taken(problem)
    whole = _share(order, np.ones(len(order), dtype=np.bool_))
    own = np.zeros(len(order))
    for place in np.unique(problem.place):
        here = problem.place == place
        own[here] = _share(order, here)[here]
    there = row >= 0
    return NetworkTiming(np.where(there, whole[row], 0.0), np.where(there, own[row], 0.0))


def _share(order: Ints, here: Bools) -> Floats:
    share = np.zeros(len(order))
    rows = np.flatnonzero(here)
    share[rows[np.argsort(order[rows], kind="stable")]] = np.linspace(0.0, 1.0, len(rows))
    return share
