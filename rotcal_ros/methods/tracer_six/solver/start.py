"""Start values: stations by multilateration, then poses by rigid fits.

Targets in one plane leave two images of each station; the nominal places show which is meant. A
position without three of its stations starts at its commanded angle.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Bools, Floats
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.geometry.rotations import align, rotation_about_z
from rotcal_ros.methods.tracer.solver.problem import STATION_MINIMUM
from rotcal_ros.methods.tracer.solver.start import start_candidates
from rotcal_ros.methods.tracer_six.solver.problem import StationLayout, lost_direction

NEAR: Final = 0.05
"""Distance (m) from its nominal place beyond which a multilaterated station is not believed."""
ROUNDS: Final = 2
"""Poses from places, then places from poses: each round takes nearly all that nominals lack."""


@dataclass(frozen=True, eq=False)
class StartPoses:
    """``rotation`` (m, 3, 3), ``translation`` (m, 3), m; ``places`` (p, 3), ``zeros`` (s,), m."""

    rotation: Floats
    translation: Floats
    places: Floats
    zeros: Floats


def find_start(layout: StationLayout) -> StartPoses:
    """Return start values for ``layout``; raises DataError when places and lengths contradict."""
    grid = layout.grid
    about = rotation_about_z(layout.angles)
    nominal = (about[layout.position] @ layout.places[layout.place][:, :, None])[:, :, 0]
    most = layout.most
    found = start_candidates(grid.targets, grid.length, most)[:, :, :3]
    away = np.linalg.norm(found - nominal, axis=2)
    best = np.argmin(away, axis=0)
    each = np.arange(len(best))
    near = away[best, each] < NEAR
    _check_near(layout, near | (most.sum(axis=1) < STATION_MINIMUM), away[best, each])
    stations = np.where(near[:, None], found[best, each], nominal)
    rotation, translation, places = about, np.zeros((len(about), 3)), layout.places
    for _ in range(ROUNDS):
        rotation, translation = _poses(layout, stations, near, places, about)
        back = (stations - translation[layout.position])[:, None] @ rotation[layout.position]
        # a place whose stations are all lost keeps its nominal one, which they then stand at
        weight = layout.by_place * np.where(near, 1.0, 1e-9)
        places = (weight / weight.sum(axis=1, keepdims=True)) @ back[:, 0]
    stands = (rotation[layout.position] @ places[layout.place][:, :, None])[:, :, 0]
    stands = stands + translation[layout.position]
    distance = np.linalg.norm(stands[:, None] - grid.targets, axis=2)
    apart = np.where(grid.used, distance - grid.length, 0.0)
    total = np.bincount(layout.zero.ravel(), apart.ravel(), minlength=layout.n_zeros)
    count = np.bincount(layout.zero.ravel(), grid.used.ravel(), minlength=layout.n_zeros)
    return StartPoses(rotation, translation, places, total / np.maximum(count, 1))


def _poses(
    layout: StationLayout, stations: Floats, near: Bools, places: Floats, about: Floats
) -> tuple[Floats, Floats]:
    """Return rotations (m, 3, 3) and translations (m, 3) that take ``places`` to ``stations``."""
    rotation, translation = about.copy(), np.zeros((len(about), 3))
    for i in range(len(about)):
        here = np.flatnonzero((layout.position == i) & near)
        own = places[layout.place[here]]
        if lost_direction(own) is None:
            rotation[i], translation[i] = align(own, stations[here])
    return rotation, translation


def _check_near(layout: StationLayout, near: Bools, away: Floats) -> None:
    if np.mean(near) > 0.5:
        return
    worst = int(np.argmax(away))
    raise DataError(
        f"{layout.station_name(worst)}: the lengths put the tracer {away[worst]:.3g} m from its "
        f"nominal place, and {np.count_nonzero(~near)} of {len(near)} stations are farther than "
        f"{NEAR:g} m: check the places, the numbering of the positions, the sense of the table "
        "angles, and whether the targets are in the frame of the machine with z along the axis"
    )
