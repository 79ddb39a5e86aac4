"""Start values: stations by multilateration, then poses by rigid fits.

Targets in one plane leave two images of each station; the nominal places tell which is meant. A
position without three of its stations starts at its commanded angle.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from rotcal_ros.arrays import Bools, Floats
from rotcal_ros.errors import DataError
from rotcal_ros.geometry.rigid import align
from rotcal_ros.geometry.rotations import rotation_about_z
from rotcal_ros.methods.tracer.grid import STATION_MINIMUM
from rotcal_ros.methods.tracer.start import start_candidates
from rotcal_ros.methods.tracer_six.layout import Layout, lost_direction
from rotcal_ros.methods.tracer_six.rig import State

NEAR: Final = 0.05
"""Distance (m) from its nominal place beyond which a multilaterated station is not believed."""
ROUNDS: Final = 2
"""Poses from places, then places from poses: each round takes nearly all that nominals lack."""


def find_start(layout: Layout) -> State:
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
        weight = layout.by_place * np.where(near, 1.0, 1e-9)
        places = (weight / weight.sum(axis=1, keepdims=True)) @ back[:, 0]
    tilts = np.zeros(0 if layout.tilt_std is None else 4)
    state = State(
        rotation, translation, places, np.zeros(layout.n_zeros), grid.targets.copy(), tilts
    )
    distance = np.linalg.norm(state.stations(layout)[:, None] - grid.targets, axis=2)
    apart = np.where(grid.used, distance - grid.length, 0.0)
    total = np.bincount(layout.zero.ravel(), apart.ravel(), minlength=layout.n_zeros)
    count = np.bincount(layout.zero.ravel(), grid.used.ravel(), minlength=layout.n_zeros)
    state.zeros[:] = total / np.maximum(count, 1)
    return state


def _poses(
    layout: Layout, stations: Floats, near: Bools, places: Floats, about: Floats
) -> tuple[Floats, Floats]:
    """Return rotations (m, 3, 3) and translations (m, 3) that take ``places`` to ``stations``."""
    rotation, translation = about.copy(), np.zeros((len(about), 3))
    for i in range(len(about)):
        here = np.flatnonzero((layout.position == i) & near)
        own = places[layout.place[here]]
        if lost_direction(own) is None:
            rotation[i], translation[i] = align(own, stations[here])
    return rotation, translation


def _check_near(layout: Layout, near: Bools, away: Floats) -> None:
    if np.mean(near) > 0.5:
        return
    worst = int(np.argmax(away))
    raise DataError(
        f"{layout.station_name(worst)}: the lengths put the tracer {away[worst]:.3g} m from its "
        f"nominal place, and {np.count_nonzero(~near)} of {len(near)} stations are farther than "
        f"{NEAR:g} m: check the places, the numbering of the positions, the sense of the table "
        "angles, and whether the targets are in the frame of the machine with z along the axis"
    )
