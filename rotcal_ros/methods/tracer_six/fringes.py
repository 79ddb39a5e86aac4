"""Fringes that the counter slips while nobody notices: found by the lengths, or not.

The search of :mod:`rotcal_ros.methods.tracer.jumps`, on the network of a rigid table. Lengths of a
run that grow by the same amount from some moment on look like a place that rose there, and three
places always have a plane: where no angle is measured again in the same run, most of a slip is
taken for tilts and heights of the table. The uncertainty allows for what stays unseen as for the
tracer (:mod:`rotcal_ros.methods.tracer.slips`).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from rotcal_ros.arrays import Floats, Ints
from rotcal_ros.methods.tracer.grid import Grid
from rotcal_ros.methods.tracer.jumps import Jump, find_jump
from rotcal_ros.methods.tracer.shifts import PLACES, Moments, Shifts
from rotcal_ros.methods.tracer_six.adjustment import RigidAdjustment
from rotcal_ros.methods.tracer_six.layout import Layout
from rotcal_ros.methods.tracer_six.patterns import felt
from rotcal_ros.methods.tracer_six.posterior import curve_posterior
from rotcal_ros.methods.tracer_six.rig import State

MOST_JUMPS: Final = 10
"""Jumps after which no further ones are looked for: the beam is no beam."""


def find_shifts(fit: RigidAdjustment, order: Ints) -> Shifts:
    """Return shifts of the zeros at some moments, and what they do to the curves (t, 6 m).

    ``order`` (k,): when each row of the problem was taken.
    """
    rig = fit.posterior.rig
    moments = Moments.of(rig.grid, order, rig.layout.zero)
    jacobian = curve_posterior(rig, fit.posterior.covariance).jacobian
    return shifts_at(fit, jacobian, moments, moments.few())


def shifts_at(fit: RigidAdjustment, jacobian: Floats, moments: Moments, at: Ints) -> Shifts:
    """Return the shifts that begin ``at`` (t,) some of the ``moments``."""
    after, grid = fit.posterior, fit.posterior.rig.grid
    score, information, alike = np.zeros(len(at)), np.zeros(len(at)), np.ones(len(at))
    moved = np.zeros((len(at), len(jacobian)))
    size = max(2, PLACES // grid.weights.size)
    for begin in range(0, len(at), size - 1):  # the last of a chunk is the first of the next
        part = slice(begin, begin + size)
        later = moments.later(grid, at[part]).astype(np.float64)
        here = felt(after.rig, later)
        step = here.slope @ after.covariance
        total = (here.weighted * later).sum(axis=(1, 2))
        left = np.maximum(total - (step * here.slope).sum(axis=1), 1e-9 * total)
        both = (here.weighted[1:] * later[:-1]).sum(axis=(1, 2))
        both -= (step[1:] * here.slope[:-1]).sum(axis=1)
        root = np.sqrt(left)
        score[part] = (later * (grid.weights * fit.residual)).sum(axis=(1, 2))
        information[part] = left
        alike[part][1:] = both / (root[1:] * root[:-1])
        moved[part] = step[:, after.rig.layout.size :] @ jacobian.T
    return Shifts(moments, at, score, information, alike, moved)


def find(fit: RigidAdjustment, shifts: Shifts, significance: float) -> Jump | None:
    """Return the jump of a zero that stands out most, None if none does.

    ``significance``: of the largest at any moment. The jump's segment is the zero that broke.
    """

    def near(at: Ints) -> Shifts:
        return shifts_at(
            fit, np.zeros((0, 6 * len(fit.posterior.rig.layout.angles))), shifts.moments, at
        )

    return find_jump(fit.posterior.rig.grid, fit, shifts, significance, at=near)


def split(
    layout: Layout, state: State, grid: Grid, jump: Jump, order: Ints
) -> tuple[Layout, State]:
    """Return ``layout`` and ``state`` with a new zero from ``jump`` on."""
    filled = grid.row >= 0
    time = np.where(filled, order[grid.row], order.max())
    time = np.where(filled, time, time.min(axis=1, keepdims=True))
    later = (layout.zero == jump.segment) & (time >= order[jump.row])
    return replace(
        layout,
        zero=np.where(later, layout.n_zeros, layout.zero),
        offset=np.append(layout.offset, layout.offset[jump.segment]),
    ), replace(state, zeros=np.append(state.zeros, state.zeros[jump.segment]))
