"""Start values without a guess: linear multilateration with an unknown zero of the lengths.

With r = d + l the squared range |x - P|^2 = (d + l)^2 turns into

    |x|^2 - l^2 = 2 x . P + 2 l d - s,      s = |P|^2 - d^2,

which is linear in (P, d, s): five unknowns, one row per target. Without gaps all stations share
four of the five columns, so that d and P follow from one small eigenproblem for all of them.
Targets in one plane leave one direction of the five free; the definition of s then is a
quadratic equation along it, whose two roots are the tracer and its mirror image in that plane.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Bools, Floats
from rotcal_ros.methods.tracer.solver.adjustment import ranges
from rotcal_ros.methods.tracer.solver.grid import Grid
from rotcal_ros.methods.tracer.solver.station import locate_stations

NEARLY_FLAT: Final = 3e-3
"""Ratio of singular values below which the linear solution alone is not trusted."""
CHANCE: Final = 25.0
"""Difference of chi-squared (5 standard deviations) that does not tell two candidates apart."""
MIRROR: Final = 1e-5
"""Distance (m) from which two candidates are two places, not one found twice."""


def start_candidates(targets: Floats, length: Floats, used: Bools) -> Floats:
    """Return start values (c, m, 4) of (X, Y, Z, d) for ``targets`` (n, 3), ``length`` (m, n).

    One candidate (c = 1) where the targets determine all stations linearly; otherwise three: the
    linear solution and both roots along the free direction. Metres.
    """
    if used.all() and (shared := _without_gaps(targets, length)) is not None:
        return shared[None]
    centre = targets.mean(axis=0)
    scale = float(np.abs(targets - centre).max()) or 1.0
    points = (targets - centre) / scale
    count = used.sum(axis=1)
    zero = np.where(used, length, 0.0).sum(axis=1) / count
    reading = np.where(used, length - zero[:, None], 0.0) / scale
    system, right = _rows(points, reading, used)
    u, singular, vt = np.linalg.svd(system, full_matrices=False)
    along = np.matmul(right[:, None, :], u)[:, 0]  # (m, 5)
    last = vt[:, 4]
    trusted = np.matmul((along[:, :4] / singular[:, :4])[:, None, :], vt[:, :4])[:, 0]
    weakest = np.maximum(singular[:, 4], 1e-12 * singular[:, 0])
    candidates = [trusted + (along[:, 4] / weakest)[:, None] * last]
    if (singular[:, 4] < NEARLY_FLAT * singular[:, 0]).any():
        candidates += [trusted + root[:, None] * last for root in _roots(trusted, last)]
    start = np.stack(candidates)[:, :, :4] * scale
    start[..., :3] += centre
    start[..., 3] -= zero
    return start


def _without_gaps(targets: Floats, length: Floats) -> Floats | None:
    """Return start values (m, 4) of stations that all see all targets; None if nearly flat.

    The part of l that no linear function of x explains tells d, the rest then tells P.
    """
    centre = targets.mean(axis=0)
    points = targets - centre
    spread, axes = np.linalg.eigh(points.T @ points)
    if spread[0] < NEARLY_FLAT**2 * spread[2]:
        return None
    to_place = axes / np.sqrt(spread)
    basis = points @ to_place
    zero = length.mean(axis=1, keepdims=True)
    reading = length - zero
    right = (points * points).sum(axis=1) - reading * reading
    right -= right.mean(axis=1, keepdims=True)
    curved = reading - (reading @ basis) @ basis.T
    bend = np.einsum("ji,ji->j", curved, curved)
    if (bend < NEARLY_FLAT**2 * np.einsum("ji,ji->j", reading, reading)).any():
        return None
    twice = np.einsum("ji,ji->j", curved, right)[:, None] / bend[:, None]
    start = np.empty((len(length), 4))
    start[:, :3] = centre + 0.5 * ((right - twice * reading) @ basis) @ to_place.T
    start[:, 3:] = 0.5 * twice - zero
    return start


def _rows(points: Floats, reading: Floats, used: Bools) -> tuple[Floats, Floats]:
    """Return the linear systems (m, n, 5) and right-hand sides (m, n), zero where unused."""
    system = np.empty((*reading.shape, 5))
    system[..., :3] = 2.0 * points
    system[..., 3] = 2.0 * reading
    system[..., 4] = -1.0
    system *= used[:, :, None]
    right = ((points**2).sum(axis=1) - reading**2) * used
    return system, np.asarray(right, dtype=np.float64)


def _roots(base: Floats, free: Floats) -> tuple[Floats, Floats]:
    """Return both t (m,) where ``base + t free`` obeys s = |P|^2 - d^2; the vertex if none."""
    metric = np.array([1.0, 1.0, 1.0, -1.0, 0.0])
    a = (free**2 * metric).sum(axis=1)
    half = (base * free * metric).sum(axis=1) - 0.5 * free[:, 4]
    c = (base**2 * metric).sum(axis=1) - base[:, 4]
    root = np.sqrt(np.maximum(half**2 - a * c, 0.0))
    # the stable pair: q carries no cancellation, the other root is c / q
    q = -(half + np.where(half >= 0.0, root, -root))
    tiny = np.finfo(np.float64).tiny
    first = q / np.where(np.abs(a) > 1e-12, a, np.inf)
    second = c / np.where(q != 0.0, q, np.inf)
    return np.where(np.abs(first) > tiny, first, second), second


def find_start(grid: Grid, given: Floats | None) -> tuple[Floats, bool]:
    """Return start values (m, 4) for ``grid``, and whether mirror images fit equally well.

    ``given`` (m, 3), when there is one, are approximate stations. Otherwise each candidate of
    :func:`start_candidates` is brought to its minimum and the best one is taken; candidates
    whose chi-squared differs by less than chance are mirror images, and the lower one is taken.
    """
    if given is not None:
        distance, _ = ranges(given, grid.targets)
        zero = (grid.used * (distance - grid.length)).sum(axis=1) / grid.used.sum(axis=1)
        return np.column_stack([given, zero]), False
    candidates = start_candidates(grid.targets, grid.length, grid.used)
    if len(candidates) == 1:
        return candidates[0], False
    settled = np.stack(
        [
            locate_stations(grid.targets, grid.length, grid.weights, candidate)[0]
            for candidate in candidates
        ]
    )
    variance = grid.length_std**2 + (grid.target_std**2).max(axis=1)
    distance = np.linalg.norm(settled[:, :, None, :3] - grid.targets, axis=3)
    misfit = (distance - settled[:, :, 3:] - grid.length) ** 2 * grid.used / variance
    chi2 = misfit.sum(axis=2)
    equal = chi2 <= chi2.min(axis=0) + CHANCE
    height = np.where(equal, settled[:, :, 2], np.inf)
    lowest = np.argmin(height, axis=0)
    best = settled[lowest, np.arange(len(lowest))]
    apart = np.abs(settled[:, :, :3] - best[:, :3]).max(axis=2)
    return best, bool((equal & (apart > MIRROR)).any())
