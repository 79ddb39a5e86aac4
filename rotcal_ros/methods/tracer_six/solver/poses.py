"""Poses of a table: to start from, and the six curves in the frames that define them.

The deviations have no mean, and those across the axis no part that turns with the table: such
parts are where the axis stands and leans, in the machine and in the table's own frame.

Start values: stations by multilateration, then poses by rigid fits. Targets in one plane leave two
images of each station; the nominal places show which is meant. A position without three of its
stations starts at its commanded angle.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.geometry.rotations import (
    fit_rigid_transform,
    rotation_about_z,
    rotation_from_vector,
)
from rotcal_ros.methods.tracer.solver.problem import STATION_MINIMUM
from rotcal_ros.methods.tracer.solver.start import fit_zeros, fullest_strips, start_candidates
from rotcal_ros.methods.tracer_six.solver.problem import (
    SixProblem,
    StationLayout,
    lost_direction,
)

GAUGE_STEPS: Final = 20
"""Steps to the gauge; each takes off all but the second order."""
ROUNDING: Final = 1e-15
"""Motion of the frames (rad or m) that is none."""
TOO_FAR: Final = 0.05
"""Deviation (rad) from the commanded angles that no table has."""
NEAR: Final = 0.05
"""Distance (m) from its nominal place beyond which a multilaterated station is not believed."""
ROUNDS: Final = 2
"""Poses from places, then places from poses: each round takes nearly all that nominals lack."""


@dataclass(frozen=True, eq=False)
class Curves:
    """``translation`` (m, 3) m, ``rotation`` (m, 3) rad; the frames they are counted in.

    ``axes`` U (3, 3) and ``origin`` v (3,) m: the axis in the machine; ``table_turn`` Q (3, 3) and
    ``table_origin`` o (3,) m: the same in the frame of the places.
    """

    translation: Floats
    rotation: Floats
    axes: Floats
    origin: Floats
    table_turn: Floats
    table_origin: Floats


def table_curves(rotation: Floats, translation: Floats, angles: Floats) -> Curves:
    """Return the curves of poses ``rotation`` (m, 3, 3), ``translation`` (m, 3) at ``angles``.

    Raises DataError when the poses do not follow the angles.
    """
    axes, origin = np.eye(3), np.zeros(3)
    turn, place = np.eye(3), np.zeros(3)
    about = rotation_about_z(angles)
    _, in_plane = gauge_design(angles)
    for _ in range(GAUGE_STEPS):
        c = rotation_vector(axes.T @ rotation @ turn @ about.swapaxes(1, 2))
        d = (rotation @ place + translation - origin) @ axes
        tilt, turned = in_plane @ c[:, :2].ravel(), float(c[:, 2].mean())
        shift, height = in_plane @ d[:, :2].ravel(), float(d[:, 2].mean())
        if np.abs([*tilt, *shift, turned, height]).max() < ROUNDING:
            break
        # to first order c gains u + Rz w, d gains v + Rz o, from motions of both frames
        axes = axes @ rotation_from_vector([tilt[0], tilt[1], 0.0])
        axes = axes @ rotation_from_vector([0.0, 0.0, -_heading(axes)])
        turn = turn @ rotation_from_vector([-tilt[2], -tilt[3], -turned])
        origin = origin + axes[:, :2] @ shift[:2]
        origin = origin - axes[:, 2] * (origin[2] / axes[2, 2])
        place = place - turn @ np.array([shift[2], shift[3], height])
    _check(c, angles)
    return Curves(d, c, axes, origin, turn, place)


def gauge_design(angles: Floats) -> tuple[Floats, Floats]:
    """Return what both frames do to x and y at all angles, (2 m, 4), and its inverse (4, 2 m)."""
    about = rotation_about_z(angles)[:, :2, :2]
    upright = np.broadcast_to(np.eye(2), about.shape)
    design = np.concatenate([upright, about], axis=2).reshape(-1, 4)
    return design, np.asarray(np.linalg.pinv(design), dtype=np.float64)


def rotation_vector(matrices: Floats) -> Floats:
    """Return the vectors (..., 3), rad, that turn like ``matrices``; below a quarter turn."""
    odd = 0.5 * (matrices - np.swapaxes(matrices, -1, -2))
    vector = np.stack([odd[..., 2, 1], odd[..., 0, 2], odd[..., 1, 0]], axis=-1)
    sine = np.minimum(np.linalg.norm(vector, axis=-1), 1.0)
    angle = np.arctan2(sine, 0.5 * (np.trace(matrices, axis1=-2, axis2=-1) - 1.0))
    # angle / sine is 1 + angle^2 / 6: beyond the last digit
    tiny = sine < 1e-8
    stretch = np.where(tiny, 1.0, angle / np.where(tiny, 1.0, sine))
    return np.asarray(vector * stretch[..., None], dtype=np.float64)


def _heading(axes: Floats) -> float:
    """Return the turn about z of a rotation that is nearly one about x and y."""
    return float(np.arctan2(axes[1, 0] - axes[0, 1], axes[0, 0] + axes[1, 1]))


def _check(c: Floats, angles: Floats) -> None:
    size = np.linalg.norm(c, axis=1)
    worst = int(np.argmax(size))
    if not size[worst] < TOO_FAR:
        raise DataError(
            f"the table turned {np.degrees(size[worst]):.3g} degrees off at the commanded angle "
            f"{np.degrees(angles[worst]):g} degrees: check that the angles are counter-clockwise, "
            "in the right unit and in the order of the positions, that the machine's z is along "
            "the axis, and that its frame is right-handed"
        )


@dataclass(frozen=True, eq=False)
class StartPoses:
    """``rotation`` (m, 3, 3), ``translation`` (m, 3), m; ``places`` (p, 3), ``zeros`` (s,), m."""

    rotation: Floats
    translation: Floats
    places: Floats
    zeros: Floats


def find_start(problem: SixProblem, layout: StationLayout) -> StartPoses:
    """Return start values for ``layout``; raises DataError when places and lengths contradict."""
    grid, about = layout.grid, rotation_about_z(layout.angles)
    nominal = (about[layout.position] @ layout.places[layout.place][:, :, None])[:, :, 0]
    alone = fullest_strips(grid)
    if problem.speed is not None:  # each target counts from a zero of its own: none stands alone
        return _as_nominal(layout, nominal)
    found = start_candidates(grid.targets, alone.length, alone.used)[:, :, :3]
    away = np.linalg.norm(found - nominal, axis=2)
    best, each = np.argmin(away, axis=0), np.arange(len(nominal))
    near = away[best, each] < NEAR
    _check_near(problem, grid.position_ids, near | (alone.used.sum(axis=1) < STATION_MINIMUM),
                away[best, each])  # fmt: skip
    stations = np.where(near[:, None], found[best, each], nominal)
    rotation, translation, places = about, np.zeros((len(about), 3)), layout.places
    at_place = (layout.place == np.arange(len(places))[:, None]).astype(np.float64)
    for _ in range(ROUNDS):
        rotation, translation = _poses(layout, stations, near, places, about)
        back = (stations - translation[layout.position])[:, None] @ rotation[layout.position]
        # a place whose stations are all lost keeps its nominal one, which they then stand at
        weight = at_place * np.where(near, 1.0, 1e-9)
        places = (weight / weight.sum(axis=1, keepdims=True)) @ back[:, 0]
    stands = (rotation[layout.position] @ places[layout.place][:, :, None])[:, :, 0]
    stands = stands + translation[layout.position]
    zeros = fit_zeros(grid, stands[grid.station])[grid.first_of_zero, 3]
    return StartPoses(rotation, translation, places, zeros)


def _as_nominal(layout: StationLayout, nominal: Floats) -> StartPoses:
    """Return start values of a table that moves as commanded, with ``nominal`` stations (V, 3)."""
    grid, about = layout.grid, rotation_about_z(layout.angles)
    zeros = fit_zeros(grid, nominal[grid.station])[grid.first_of_zero, 3]
    return StartPoses(about, np.zeros((len(about), 3)), layout.places, zeros)


def _poses(
    layout: StationLayout, stations: Floats, near: Bools, places: Floats, about: Floats
) -> tuple[Floats, Floats]:
    """Return rotations (m, 3, 3) and translations (m, 3) that take ``places`` to ``stations``."""
    rotation, translation = about.copy(), np.zeros((len(about), 3))
    for i in range(len(about)):
        here = np.flatnonzero((layout.position == i) & near)
        own = places[layout.place[here]]
        if lost_direction(own) is None:
            rotation[i], translation[i] = fit_rigid_transform(own, stations[here])
    return rotation, translation


def _check_near(problem: SixProblem, station: Ints, near: Bools, away: Floats) -> None:
    if np.mean(near) > 0.5:
        return
    worst = int(np.argmax(away))
    raise DataError(
        f"{problem.station_name(station[worst])}: the lengths put the tracer {away[worst]:.3g} m "
        f"from its nominal place, and {np.count_nonzero(~near)} of {len(near)} stations are "
        f"farther than {NEAR:g} m: check the places, the numbering of the positions, the sense of "
        "the table angles, and whether the targets are in the frame of the machine with z along "
        "the axis"
    )
