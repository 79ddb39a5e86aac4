"""Start values of stations that share zeros, or have few lengths: by strips, or by a circle.

A station with five lengths from one zero is found by itself (:mod:`.start`). Others are found
together, at the commanded angles of one circle: linearly, and then with the lengths themselves,
which places them to what the table deviates.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.methods.tracer.solver.adjustment import ranges
from rotcal_ros.methods.tracer.solver.grid import STATION_MINIMUM, Grid
from rotcal_ros.methods.tracer.solver.start import CHANCE, MIRROR, find_start

DEVIATES: Final = 1e-5
"""By how much (m) stations may be off their commanded places on the circle."""
LOST: Final = 1e-3
"""Root mean square misfit (m) of stations that are not where the commanded angles say."""


def find_any_start(grid: Grid, given: Floats | None, angles: Floats) -> tuple[Floats, bool]:
    """Return start values (p, 4) for ``grid``, and whether mirror images fit equally well.

    ``given`` (m, 3), if any, are approximate stations; ``angles`` (m,) rad are the commanded ones.
    """
    if grid.zero is None and (given is not None or grid.apart):
        return find_start(grid, given)
    return find_shared_start(grid, given, angles)


def find_shared_start(grid: Grid, given: Floats | None, angles: Floats) -> tuple[Floats, bool]:
    """Return start values (p, 4) for ``grid``, and whether mirror images fit equally well.

    ``given`` (m, 3), when there is one, are approximate stations. Otherwise they are
    found one by one in their fullest strips, or, where these are too short, at the commanded
    ``angles`` (m,) of a circle. The zeros follow from the stations.
    """
    ambiguous = False
    if given is None:
        fullest = _fullest_strips(grid)
        if (fullest.used.sum(axis=1) >= STATION_MINIMUM).all():
            state, ambiguous = find_start(fullest, None)
            given = state[:, :3]
        else:
            given, ambiguous = _on_circle(grid, angles)
    return with_zeros(grid, given[grid.station]), ambiguous


def with_zeros(grid: Grid, standing: Floats) -> Floats:
    """Return the state (p, 4) of strips that are ``standing`` (p, 3) there, zeros as they fit."""
    distance, _ = ranges(standing, grid.targets)
    zero = grid.station if grid.zero is None else grid.zero
    weight = np.bincount(zero, weights=grid.weights.sum(axis=1))
    total = np.bincount(zero, weights=(grid.weights * (distance - grid.length)).sum(axis=1))
    return np.column_stack([standing, (total / np.maximum(weight, 1e-300))[zero]])


def _fullest_strips(grid: Grid) -> Grid:
    """Return the grid of the fullest strip of each station, each with a zero of its own."""
    order = np.lexsort((-grid.used.sum(axis=1), grid.station))
    best = order[np.unique(grid.station[order], return_index=True)[1]]
    fullest = grid.take(best, grid.row[best] >= 0)
    return replace(fullest, zero=None, segment_ids=None, walk=None)


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
        flat = [
            x[0] + self.cos * x[3] - self.sin * x[4],
            x[1] + self.sin * x[3] + self.cos * x[4],
        ]
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
    variance = DEVIATES**2 + float((grid.length_std**2).max() + (grid.target_std**2).max())
    equal = (least + CHANCE * variance / grid.used.sum()) >= np.array([m for m, _ in found])
    alike = [each for (_, each), close in zip(found, equal.tolist(), strict=True) if close]
    lowest = min(alike, key=lambda each: float(each[:, 2].mean()))
    apart = max(float(np.abs(each - lowest).max()) for each in alike)
    return lowest, apart > max(MIRROR, 3.0 * DEVIATES)


def _circles(grid: Grid, angles: Floats) -> list[tuple[float, Floats]]:
    """Return mean square misfits (m^2) and stations (m, 3) from several heights to start from."""
    from scipy.optimize import least_squares  # slow to load, and rarely needed

    linear = _linear_circle(grid, angles)
    strip, target = np.nonzero(grid.used)
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
    of_zero, station = zero[p], grid.station[p]
    count = np.bincount(of_zero)
    mean = np.bincount(of_zero, weights=grid.length[p, i]) / np.maximum(count, 1)
    reading = (grid.length[p, i] - mean[of_zero]) / scale
    cos, sin = np.cos(angles[station]), np.sin(angles[station])
    turned = np.column_stack([x[:, 0] * cos + x[:, 1] * sin, x[:, 1] * cos - x[:, 0] * sin])
    k, m, s = len(p), grid.n_stations, grid.n_zeros
    system = np.zeros((k, 5 + m + 2 * s))
    system[:, :5] = 2.0 * np.column_stack([x, turned])
    rows = np.arange(k)
    system[rows, 5 + station] = -1.0
    system[rows, 5 + m + of_zero] = 1.0
    system[rows, 5 + m + s + of_zero] = 2.0 * reading
    found = np.linalg.lstsq(system, (x**2).sum(axis=1) - reading**2, rcond=1e-12)[0]
    return np.asarray(found[:5] * scale + np.append(centre, [0.0, 0.0]), dtype=np.float64)
