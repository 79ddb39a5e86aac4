"""A zero that wanders within its segment: dead path and temperature move it a little all the time.

Every length gets a zero of its own, and the steps from one to the next, in the order of measuring,
are observations: none, with the standard deviation of the walk. That is exact; the steps make a
band in the normal matrix of the zeros. An unknown standard deviation is estimated by restricted
maximum likelihood, from the same normal matrix.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from rotcal_ros.arrays import Floats, Ints
from rotcal_ros.errors import DataError
from rotcal_ros.methods.tracer.grid import Grid
from rotcal_ros.methods.tracer.network import relax
from rotcal_ros.methods.tracer.shared_start import with_zeros

MOST_LENGTHS: Final = 3000
LEAST_STD, LARGEST_STD = 1e-9, 1e-6
"""Walks (m) among which an unknown one is looked for; the least is none."""
NEAR: Final = 0.05
"""Relative precision of an estimated walk: far below what the data tell."""


def wandering(grid: Grid, order: Ints, std: float) -> tuple[Grid, Ints]:
    """Return ``grid`` with zeros that wander by ``std`` (m) per length, and each strip's old one.

    ``order`` (k,): when each row of the problem was taken.
    """
    strip, target = np.nonzero(grid.row >= 0)
    if len(strip) > MOST_LENGTHS:
        raise DataError(
            f"{len(strip)} lengths are too many for a zero that wanders: up to {MOST_LENGTHS} are "
            "solved; set zero_walk_std_m to 0"
        )
    assert grid.zero is not None
    assert grid.segment_ids is not None
    in_time = np.lexsort((order[grid.row[strip, target]], grid.zero[strip]))
    strip, target = strip[in_time], target[in_time]
    chain = grid.zero[strip]
    part = np.zeros((len(strip), grid.used.shape[1]), dtype=np.bool_)
    part[np.arange(len(strip)), target] = True
    walk = np.where(np.append(np.diff(chain) == 0, False), std, np.inf)
    every = np.arange(len(strip))
    free = replace(
        grid.take(strip, part), zero=every, segment_ids=grid.segment_ids[chain], walk=walk
    )
    return free, strip


def likely_walk(grid: Grid, start: Floats, order: Ints) -> float:
    """Return the standard deviation (m) per length that ``grid`` tells best, 0 if it tells none.

    ``start`` (p, 4): state of the strips of ``grid``.
    """
    at = start

    def deviance(log_std: float) -> float:
        wide, source = wandering(grid, order, float(np.exp(log_std)))
        network = relax(wide, with_zeros(wide, at[source, :3]), grid.targets)
        reduced = network.reduced
        steps = int(np.isfinite(wide.walk).sum()) if wide.walk is not None else 0
        size = np.linalg.slogdet(reduced.regular())[1] - 2.0 * np.log(reduced.scale).sum()
        size -= np.linalg.slogdet(reduced.inverse)[1].sum()
        return float(network.chi2 + 2.0 * steps * log_std + size)

    from scipy.optimize import minimize_scalar  # slow to load, and rarely needed

    bounds = (np.log(LEAST_STD), np.log(LARGEST_STD))
    found = minimize_scalar(deviance, bounds=bounds, method="bounded", options={"xatol": NEAR})
    nothing = deviance(bounds[0])
    return float(np.exp(found.x)) if found.fun < nothing else 0.0
