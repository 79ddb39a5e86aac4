"""What gathers in one place: the lengths of a rigid network as groups for the engine.

As in :mod:`rotcal_ros.methods.tracer.gathering`, with the arrivals of the table at a position in
one run as stations. Their scatter from arrival to arrival is adjusted beside the unknowns.
"""

from __future__ import annotations

import numpy as np

from rotcal_ros.adjust.felt import Felt
from rotcal_ros.adjust.groups import Group
from rotcal_ros.arrays import Ints
from rotcal_ros.methods.tracer.gathering import group_at, places_of
from rotcal_ros.methods.tracer.grid import Grid
from rotcal_ros.methods.tracer_six.adjustment import RigidAdjustment
from rotcal_ros.methods.tracer_six.posterior import curve_posterior, scattered


def groups_of(grid: Grid, fit: RigidAdjustment, order: Ints) -> tuple[Group, ...]:
    """Return the groups of a network; outputs are its curves (6 m,): d of all positions, then c.

    ``order`` (k,): when each row of the problem was taken.
    """
    rig, covariance = fit.posterior.rig, fit.posterior.covariance
    layout, unit = rig.layout, rig.slopes.unit
    outputs = np.zeros((6 * len(layout.angles), len(covariance)))
    outputs[:, layout.size :] = curve_posterior(rig, covariance).jacobian
    carried = outputs @ covariance
    _, own, response = scattered(rig)
    moved = response.reshape(len(unit), 3, -1)
    first_zero = 3 * (unit.shape[1] + len(layout.places))
    found = []
    for places in places_of(grid, fit, order):
        station, target = places.at.T
        each, towards = np.arange(len(station)), unit[station, target]
        design = (towards[:, None] @ moved[station])[:, 0]
        design[each[:, None], 3 * target[:, None] + np.arange(3)] -= towards
        design[each, first_zero + layout.zero[station, target]] -= 1.0
        beside = (towards[:, None] @ own[station])[:, 0] @ towards.T
        beside *= station[:, None] == station
        felt = Felt.whole(carried @ design.T)
        found.append(
            group_at(grid, places, fit.residual, design @ covariance @ design.T + beside, felt)
        )
    return tuple(found)
