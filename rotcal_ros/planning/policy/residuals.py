"""What observed lengths say against each other, stations and zeros being unknown."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from rotcal_ros.arrays import Floats, Ints
from rotcal_ros.observations import Observation
from rotcal_ros.planning.policy.contrasts import Contrasts
from rotcal_ros.planning.tracer_design.scene import Scene

PLACING_STEPS: Final = 8
"""Gauss-Newton steps that place the stations from nominal places, a few centimetres off."""
RIDGE: Final = 1e-12
"""Share of the diagonal that keeps a station in place where its lengths leave a direction open."""


def contrasts(scene: Scene, observations: Sequence[Observation], zero: Ints | None) -> Contrasts:
    """Return what the lengths (k,) of ``scene`` tell about their noise.

    ``zero`` (k,): the unknown zero of each length; None: every station has its own, and a later
    run an offset to the first. Times in ns.
    """
    position = np.array([o.table_position for o in observations])
    target = np.array([o.target for o in observations])
    seen, own = np.unique(target, return_inverse=True)
    places = np.array([o.probe_position for o in observations])
    zeros = [_columns(position if zero is None else zero)]
    if zero is None:
        zeros.append(_columns(np.array([o.run for o in observations]))[:, 1:])
    length = np.array([o.mean[0] for o in observations])
    unit, design, y = _placed(scene.stations, position, places, length, np.hstack(zeros))
    errors = np.zeros((len(target), len(seen), 3))
    errors[np.arange(len(target)), own] = unit * scene.target_std[seen][own]
    std = np.sqrt(scene.beams(position, target)[1])
    time = np.array([o.window_end_ns for o in observations], dtype=np.float64)
    errors = errors.reshape(len(target), -1) / std[:, None]
    return Contrasts(design / std[:, None], errors, y / std, time - time[0])


def _columns(group: Ints) -> Floats:
    """Return a column of ones and zeros for each group, (k, groups)."""
    return np.asarray(group[:, None] == np.unique(group), dtype=np.float64)


def _placed(
    nominal: Floats, position: Ints, targets: Floats, length: Floats, zeros: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return unit vectors (k, 3), design (k, p) and lengths less computed ones (k,).

    Gauss-Newton on all stations and ``zeros`` (k, q) together, targets (k, 3) being known.
    """
    ids, own = np.unique(position, return_inverse=True)
    stations, offsets = nominal[ids].copy(), np.zeros(zeros.shape[1])
    each, moved = np.arange(len(own)), 3 * len(ids)
    for turn in range(PLACING_STEPS + 1):
        apart = stations[own] - targets
        distance = np.linalg.norm(apart, axis=1)
        unit = apart / distance[:, None]
        y = length - distance + zeros @ offsets
        by_station = np.zeros((len(own), len(ids), 3))
        by_station[each, own] = unit
        design = np.hstack([by_station.reshape(len(own), -1), -zeros])
        if turn == PLACING_STEPS:
            break
        normal = design.T @ design
        normal.flat[:: len(normal) + 1] *= 1.0 + RIDGE
        step = np.linalg.solve(normal, design.T @ y)
        stations += step[:moved].reshape(-1, 3)
        offsets += step[moved:]
    return unit, design, y
