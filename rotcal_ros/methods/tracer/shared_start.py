"""Start values of stations that share zeros: by way of their fullest strips, or of a circle."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rotcal_ros.arrays import Floats
from rotcal_ros.methods.tracer.adjustment import ranges
from rotcal_ros.methods.tracer.grid import STATION_MINIMUM, Grid
from rotcal_ros.methods.tracer.start import find_start


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
            given = _stations_on_circle(grid, angles)
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


def _stations_on_circle(grid: Grid, angles: Floats) -> Floats:
    """Return stations (m, 3) at the commanded ``angles`` (m,), rad, that fit linearly.

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
    arm, cos, sin = found[3:5], np.cos(angles), np.sin(angles)
    flat = np.column_stack([arm[0] * cos - arm[1] * sin, arm[0] * sin + arm[1] * cos])
    stations = np.tile(found[:3], (m, 1))
    stations[:, :2] += flat
    return np.asarray(stations * scale + centre, dtype=np.float64)
