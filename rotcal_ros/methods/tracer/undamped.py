"""Undamped Gauss-Newton steps for all stations at once, as long as they contract.

From a fair start they converge quadratically, and the damping and line search of the paper
(:mod:`.station`) only cost time; a station whose steps do not shrink fast is left to them. The
normal equations lose digits of a step, not of the answer: that is where the gradient of the
residuals vanishes, and each step takes these anew in full precision.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from rotcal_ros.arrays import Bools, Floats

FAIR: Final = 1.0
"""Length (m) that the first step is compared with, as the others are with the one before."""
CONTRACTION: Final = 0.5
"""Share of the step before that a step may have; else the start was too far away."""
SETTLED: Final = 1e-13
"""Step (m) that no longer needs to be done."""
MAX_STEPS: Final = 12


def contract(
    targets: Floats, length: Floats, weights: Floats, start: Floats
) -> tuple[Floats, Bools]:
    """Return (X, Y, Z, d) of all stations (m, 4), and for which of them (m,) the steps contract.

    Arguments as for :func:`~.station.locate_stations`; where the steps do not contract, the
    state is of no use.
    """
    m, n = length.shape
    points, root = np.ascontiguousarray(targets.T)[:, None], np.sqrt(weights)
    rows = np.empty((5, m, n))  # slopes along X, Y, Z and d, and the error f of Eq. 5
    slopes, errors = rows[:3], rows[4]
    np.negative(root, out=rows[3])
    by_station, transposed = rows.transpose(1, 0, 2), rows.transpose(1, 2, 0)
    state, contracts = start, np.ones(m, dtype=np.bool_)
    limit: Floats | float = CONTRACTION * FAIR
    settled: Floats | float = SETTLED**2
    for _ in range(MAX_STEPS):
        np.subtract(state.T[:3, :, None], points, out=slopes)
        distance = np.sqrt(np.einsum("aji,aji->ji", slopes, slopes))
        slopes *= root / distance
        distance -= state[:, 3:]
        distance -= length
        np.multiply(distance, root, out=errors)
        products = by_station @ transposed
        try:
            h = np.linalg.solve(products[:, :4, :4], products[:, :4, 4:])[:, :, 0]
        except np.linalg.LinAlgError:
            return start, np.zeros(m, dtype=np.bool_)
        state = state - h
        size = np.maximum.reduce(np.abs(h), axis=1)
        if not (size <= limit).all():
            contracts &= size <= limit
            state = np.where(contracts[:, None], state, start)
            size[~contracts] = 0.0
        moving = size * size > settled
        if not moving.any():
            return state, contracts
        # the share by which a step shrinks does not grow: so the one to come is foreseen
        limit, settled = CONTRACTION * size + SETTLED, SETTLED * size
    return state, contracts & ~moving
