"""What no length feels: frames, and the flex of places on one circle.

Right motions: the table's own frame may lie anywhere, q -> W q + w with the poses to match. Left
motions: without a prior on the targets the whole network may, too. And with free targets, places
at one height on one circle about the axis leave a seventh: targets and circle as in
:mod:`rotcal_ros.methods.tracer.joint`. None of them is felt by the curves.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from rotcal_ros.arrays import Floats
from rotcal_ros.methods.tracer.network import rigid
from rotcal_ros.methods.tracer_six.curves import table_curves
from rotcal_ros.methods.tracer_six.layout import Layout

if TYPE_CHECKING:
    from rotcal_ros.methods.tracer_six.rig import State

FLAT: Final = 1e-4
"""Difference of the places' heights and radii (m) up to which they lie on one circle: what they
tell then about the flex is below any noise."""


def constraints(layout: Layout, state: State, *, free: bool) -> Floats:
    """Return the kept part (K, c) of all motions that no length feels.

    Poses follow by the lengths; what moves no kept unknown cannot be open.
    """
    n, p, s = len(state.targets), len(state.places), len(state.zeros)
    tilts = len(state.lean)
    right = np.zeros((3 * n + 3 * p + s + tilts, 6))
    right[3 * n : 3 * (n + p)] = rigid(state.places)
    if tilts:
        right[-2:, 3:5] = -np.eye(2)
    if not free:
        return right
    left = np.zeros_like(right)
    left[: 3 * n] = rigid(state.targets)
    if tilts:
        left[-4:-2, 3:5] = np.eye(2)
    flex = _flex(layout, state)
    return np.concatenate([right, left, *([] if flex is None else [flex[:, None]])], axis=1)


def _flex(layout: Layout, state: State) -> Floats | None:
    """Return the kept part (K,) of the seventh motion, None where the places do not leave it."""
    curves = table_curves(state.rotation, state.translation, layout.angles)
    places = (state.places - curves.table_origin) @ curves.table_turn
    radius = np.hypot(places[:, 0], places[:, 1])
    if np.ptp(radius) > FLAT or np.ptp(places[:, 2]) > FLAT:
        return None
    height = places[:, 2].mean()
    targets = (state.targets - curves.origin) @ curves.axes - [0.0, 0.0, height]
    bend = (targets[:, :2] ** 2).sum(axis=1) - radius.mean() ** 2
    moved = np.column_stack([targets[:, :2], -bend / targets[:, 2]])
    flex = np.zeros(layout.size)
    n, p = len(targets), len(places)
    flex[: 3 * n] = (moved @ curves.axes.T).ravel()
    shrunk = np.column_stack([-places[:, :2], np.zeros(p)])
    flex[3 * n : 3 * (n + p)] = (shrunk @ curves.table_turn.T).ravel()
    return flex
