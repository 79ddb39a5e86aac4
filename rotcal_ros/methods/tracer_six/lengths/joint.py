"""Joint self-calibration: stations, distances and targets adjusted together.

Laser tracer paper, section 2 (Eq. 1-4). Two data:

prior
    the machine's coordinates are observations, weighted by ``target_std``;
free
    they are start values only. Lengths do not feel a rigid motion of the whole network: six
    directions stay open. And a table carries the tracer round a plane circle, which leaves a
    *seventh*: with the circle's centre as origin and z along the axis, let the targets move by
    (x, y, -(x^2 + y^2 - R^2) / z) and the stations by (-X, -Y, 0), times any small number: no
    length changes to first order. (Complete bipartite frameworks flex when one side lies on a
    conic: Bolker and Roth, Pacific J. Math. 90 (1980) 27.) It scales the circle, so the angle does
    not feel it either. The seven are fixed while solving: no shift and turn of the stations, and
    their rms distance from their centroid stays what the machine's coordinates give. Then the
    network is moved rigidly to the inner constraints on the targets: no mean shift and turn
    against the machine's coordinates.

The paper solves Eq. 4 by a dense SVD with a threshold, which hides the seven among other small
singular values; here they are known in closed form, and the rank is counted beside them.
Every length touches one station and one target; one side is eliminated: with a prior the one
with more unknowns, in a free network always the targets.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.methods.tracer.solver.problem import Grid

CHECKED: Final = 0.01
"""Redundancy from which a coordinate is held to be checked by the lengths."""


def felt_by_targets(
    grid: Grid, targets: Floats, covariance: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return corrections (n, 3), redundancy (n, 3, 3) and coupling (3, 3) of the coordinates.

    Of adjusted ``targets`` (n, 3) with their ``covariance`` (3 n, 3 n), m^2, in standard
    deviations of the machine's coordinates; zero where these are start values only. The redundancy
    matrix M of all observations is a projection; the coupling of two axes is the sum of the
    squares of its entries between them, which is half the covariance of their sums of squared
    corrections.
    """
    n, std = len(targets), grid.target_std
    if grid.free:
        return np.zeros((n, 3)), np.zeros((n, 3, 3)), np.zeros((3, 3))
    whole = -covariance.reshape(n, 3, n, 3) / (std[:, :, None, None] * std)
    each = np.arange(n)
    whole[each, :, each] += np.eye(3)
    coupling = np.einsum("iajb,iajb->ab", whole, whole)
    return (targets - grid.targets) / std, whole[each, :, each], coupling


def target_test(corrections: Floats, redundancy: Floats) -> Floats:
    """Return (n,) the largest normalised correction of each target's machine coordinates.

    In the directions that the lengths check at all (redundancy above CHECKED), each correction is
    compared with its own standard deviation, like a residual.
    """
    checked, axes = np.linalg.eigh(redundancy)
    along = np.abs(np.einsum("ic,ice->ie", corrections, axes))
    value = along / np.sqrt(np.maximum(checked, CHECKED))
    return np.asarray(np.where(checked > CHECKED, value, 0.0).max(axis=1), dtype=np.float64)
