"""Start values without a guess: linear multilateration with an unknown zero of the lengths.

With r = d + l the squared range |x - P|^2 = (d + l)^2 turns into

    |x|^2 - l^2 = 2 x . P + 2 l d - s,      s = |P|^2 - d^2,

which is linear in (P, d, s): five unknowns, one row per target. Targets in one plane leave one
direction of the five free; the definition of s then is a quadratic equation along it, whose two
roots are the tracer and its mirror image in that plane.

That finds a station with five lengths from one zero. Stations that share zeros, or have fewer
lengths, are found together, at the commanded angles of one circle: linearly, and then with the
lengths themselves, which places them to what the table deviates.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.methods.tracer.solver.problem import STATION_MINIMUM, Grid
from rotcal_ros.methods.tracer.solver.station_by_station import (
    distances_and_directions,
    locate_stations,
)

NEARLY_FLAT: Final = 3e-3
"""Ratio of singular values below which the linear solution alone is not trusted."""
CHANCE: Final = 25.0
"""Difference of chi-squared (5 standard deviations) that does not distinguish two candidates."""
MIRROR: Final = 1e-5
"""Distance (m) from which two candidates are two places, not one found twice."""
DEVIATES: Final = 1e-5
"""How far (m) stations may be off their commanded places on the circle."""
GROSS: Final = 1e-3
"""Misfit (m) of a length from which a start by all of them is bent."""
FAIR: Final = 1e-4
"""Misfit (m) up to which a length counts in full where others are gross."""
UNBENDING: Final = 12
"""Times that gross lengths are weighed anew."""
SHOWING: Final = 100
"""Stations that show a circle as well as any more."""
LOST: Final = 1e-3
"""Root mean square misfit (m) of stations that are not where the commanded angles say."""


def start_candidates(targets: Floats, length: Floats, used: Bools) -> Floats:
    """Return start values (c, m, 4) of (X, Y, Z, d) for ``targets`` (n, 3), ``length`` (m, n).

    One candidate (c = 1) where the targets determine all stations linearly; otherwise three: the
    linear solution and both roots along the free direction. Metres.
    """
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
    # targets exactly in a plane: what the linear solution says along the free direction is void
    weakest = np.maximum(singular[:, 4], 1e-12 * singular[:, 0])
    candidates = [trusted + (along[:, 4] / weakest)[:, None] * last]
    if (singular[:, 4] < NEARLY_FLAT * singular[:, 0]).any():
        candidates += [trusted + root[:, None] * last for root in _roots(trusted, last)]
    start = np.stack(candidates)[:, :, :4] * scale
    start[..., :3] += centre
    start[..., 3] -= zero
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
    # a = 0 leaves a linear equation, whose only root is the second
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
        distance, _ = distances_and_directions(given, grid.targets)
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


def find_any_start(grid: Grid, given: Floats | None, angles: Floats) -> tuple[Floats, bool]:
    """Return start values (p, 4) for ``grid``, and whether mirror images fit equally well.

    ``given`` (m, 3), if any, are approximate stations; ``angles`` (m,) rad are the commanded ones.
    """
    if grid.zero is None and (given is not None or grid.apart):
        state, ambiguous = find_start(grid, given)
        return _unbent(grid, state), ambiguous
    return _find_shared_start(grid, given, angles)


def _unbent(grid: Grid, state: Floats) -> Floats:
    """Return start values (m, 4) that gross errors do not bend: of least absolute misfits.

    Of stations that have lengths to spare; others stay.
    """
    spare = grid.used.sum(axis=1) > STATION_MINIMUM
    for _ in range(UNBENDING):
        miss = np.abs(
            distances_and_directions(state[:, :3], grid.targets)[0] - state[:, 3:] - grid.length
        )
        bent = spare & ((miss * grid.used).max(axis=1) > GROSS)
        if not bent.any():
            break
        weights = grid.weights[bent] / np.maximum(miss[bent] / FAIR, 1.0)
        found, settled = locate_stations(grid.targets, grid.length[bent], weights, state[bent])
        state = state.copy()
        state[np.flatnonzero(bent)[settled]] = found[settled]
    return state


def _find_shared_start(grid: Grid, given: Floats | None, angles: Floats) -> tuple[Floats, bool]:
    """Return start values (p, 4) for ``grid``, and whether mirror images fit equally well.

    ``given`` (m, 3), when there is one, are approximate stations. Otherwise they are
    found one by one in their fullest strips, or, where these are too short, at the commanded
    ``angles`` (m,) of a circle. The zeros follow from the stations.
    """
    ambiguous = False
    if given is None:
        fullest = fullest_strips(grid)
        if (fullest.used.sum(axis=1) >= STATION_MINIMUM).all():
            state, ambiguous = find_start(fullest, None)
            given = _unbent(fullest, state)[:, :3]
        else:
            given, ambiguous = _on_circle(grid, angles)
    return fit_zeros(grid, given[grid.station]), ambiguous


def fit_zeros(grid: Grid, standing: Floats) -> Floats:
    """Return the state (p, 4) of strips that are ``standing`` (p, 3) there, zeros as they fit."""
    distance, _ = distances_and_directions(standing, grid.targets)
    zero = grid.station if grid.zero is None else grid.zero
    weight = np.bincount(zero, weights=grid.weights.sum(axis=1))
    total = np.bincount(zero, weights=(grid.weights * (distance - grid.length)).sum(axis=1))
    # a zero that has lost all its lengths stays at nothing
    return np.column_stack([standing, (total / np.maximum(weight, 1e-300))[zero]])


def fullest_strips(grid: Grid) -> Grid:
    """Return the grid of the fullest strip of each station, each with a zero of its own."""
    order = np.lexsort((-grid.used.sum(axis=1), grid.station))
    best = order[np.unique(grid.station[order], return_index=True)[1]]
    fullest = grid.take(best, grid.row[best] >= 0)
    return replace(fullest, zero=None, segment_ids=None)


@dataclass(frozen=True, eq=False)
class _Carried:
    """A tracer carried round a circle: the lengths in use, by zero and by station's angle."""

    targets: Floats
    length: Floats
    zero: Ints
    cos: Floats
    sin: Floats

    def stations(self, x: Floats) -> Floats:
        """Return where each length's station is, (k, 3); x: centre (3,), arm (2,), zeros (s,)."""
        flat = [x[0] + self.cos * x[3] - self.sin * x[4], x[1] + self.sin * x[3] + self.cos * x[4]]
        return np.column_stack([*flat, np.full(len(self.cos), x[2])])

    def misfit(self, x: Floats) -> Floats:
        """Return computed - read lengths (k,), m."""
        apart = self.stations(x) - self.targets
        return np.asarray(np.linalg.norm(apart, axis=1) - x[5:][self.zero] - self.length)

    def slope(self, x: Floats) -> Floats:
        """Return the derivative (k, 5 + s) of the misfit."""
        apart = self.stations(x) - self.targets
        unit = apart / np.linalg.norm(apart, axis=1)[:, None]
        rows = np.zeros((len(unit), len(x)))
        rows[:, :3] = unit
        rows[:, 3] = unit[:, 0] * self.cos + unit[:, 1] * self.sin
        rows[:, 4] = unit[:, 1] * self.cos - unit[:, 0] * self.sin
        rows[np.arange(len(unit)), 5 + self.zero] = -1.0
        return rows


def _on_circle(grid: Grid, angles: Floats) -> tuple[Floats, bool]:
    """Return stations (m, 3) at the commanded ``angles`` (m,), rad, of the circle that fits best.

    And whether a mirror image fits as well. Where none fits, the table may count clockwise.
    """
    found = [*_circles(grid, angles)]
    if min(misfit for misfit, _ in found) > LOST**2:
        found += _circles(grid, -angles)
    least = min(misfit for misfit, _ in found)
    length_std = float(grid.length_std[grid.used].max())
    variance = DEVIATES**2 + length_std**2 + float((grid.target_std**2).max())
    equal = (least + CHANCE * variance / grid.used.sum()) >= np.array([m for m, _ in found])
    alike = [each for (_, each), close in zip(found, equal.tolist(), strict=True) if close]
    lowest = min(alike, key=lambda each: float(each[:, 2].mean()))
    apart = max(float(np.abs(each - lowest).max()) for each in alike)
    return lowest, apart > max(MIRROR, 3.0 * DEVIATES)


def _circles(grid: Grid, angles: Floats) -> list[tuple[float, Floats]]:
    """Return mean square misfits (m^2) and stations (m, 3) from several heights to start from.

    Of very many stations some, evenly, show the circle.
    """
    from scipy.optimize import least_squares  # slow to load, and rarely needed

    some = grid.station % -(-grid.n_stations // SHOWING) == 0
    used = grid.used & some[:, None]
    linear = _linear_circle(replace(grid, used=used), angles)
    strip, target = np.nonzero(used)
    station = grid.station[strip]
    zero = station if grid.zero is None else grid.zero[strip]
    cos, sin = np.cos(angles), np.sin(angles)
    carried = _Carried(
        grid.targets[target], grid.length[strip, target], zero, cos[station], sin[station]
    )
    every = replace(carried, cos=cos, sin=sin)
    height = float(np.ptp(grid.targets, axis=0).max())
    found = []
    for up in (0.0, height, -height):
        begin = np.append(linear + up * np.eye(5)[2], np.zeros(grid.n_zeros))
        ranges_there = carried.misfit(begin)
        count = np.bincount(zero, minlength=grid.n_zeros)
        total = np.bincount(zero, weights=ranges_there, minlength=grid.n_zeros)
        begin[5:] = total / np.maximum(count, 1)
        fit = least_squares(carried.misfit, begin, carried.slope, x_scale="jac", xtol=1e-12)
        found.append((float((fit.fun**2).mean()), every.stations(fit.x)))
    return found


def _linear_circle(grid: Grid, angles: Floats) -> Floats:
    """Return centre (3,) and arm (2,) of stations at ``angles`` (m,), rad, that fit linearly.

    With P = c + R(angle) q the squared ranges are linear in c, q and the zeros, in a number |P|^2
    of each station, and in one d^2 of each zero.
    """
    zero = grid.station if grid.zero is None else grid.zero
    p, i = np.nonzero(grid.used)
    centre = grid.targets.mean(axis=0)
    scale = float(np.abs(grid.targets - centre).max()) or 1.0
    x = (grid.targets[i] - centre) / scale
    of_zero = zero[p]
    seen, station = np.unique(grid.station[p], return_inverse=True)
    count = np.bincount(of_zero, minlength=grid.n_zeros)
    total = np.bincount(of_zero, weights=grid.length[p, i], minlength=grid.n_zeros)
    mean = total / np.maximum(count, 1)
    reading = (grid.length[p, i] - mean[of_zero]) / scale
    cos, sin = np.cos(angles[seen])[station], np.sin(angles[seen])[station]
    turned = np.column_stack([x[:, 0] * cos + x[:, 1] * sin, x[:, 1] * cos - x[:, 0] * sin])
    k, m, s = len(p), len(seen), grid.n_zeros
    system = np.zeros((k, 5 + m + 2 * s))
    system[:, :5] = 2.0 * np.column_stack([x, turned])
    rows = np.arange(k)
    system[rows, 5 + station] = -1.0
    system[rows, 5 + m + of_zero] = 1.0
    system[rows, 5 + m + s + of_zero] = 2.0 * reading
    # all |P|^2 and all d^2 may grow together without a change: the smallest solution will do
    found = np.linalg.lstsq(system, (x**2).sum(axis=1) - reading**2, rcond=1e-12)[0]
    return np.asarray(found[:5] * scale + np.append(centre, [0.0, 0.0]), dtype=np.float64)
