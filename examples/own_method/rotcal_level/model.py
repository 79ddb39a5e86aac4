"""What levels on a table read, for the engine: nothing else is about levels.

    reading = EAC[position] sin(a) - EBC[position] cos(a) + zero[level] + noise
    a = table angle + azimuth[level] + azimuth error[level]

All in radians. A level reads how much higher than its other end the end is to which its azimuth
points. EAC and EBC, rotations about the fixed x and y, hold the lean of the axis (AOC and BOC of
ISO 230-7, against gravity) as their means. As complex numbers w = EAC + j EBC it reads
-Im(w exp(-j a)): to a part of w that turns with the table, c exp(j table angle), every level adds
a constant, as its zero does. Mean and turning part are taken off.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from rotcal_level.settings import LevelPlanSettings, LevelSolverSettings
from rotcal_ros.adjust.gathering import Words
from rotcal_ros.adjust.model import Disturbing, Grouping, Model, indicators, instrument_effects
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.units import ARCSEC, DEGREE
from rotcal_ros.planning.readings import Readings
from rotcal_ros.planning.table_angles import table_angles

LARGEST: Final = 10.0 * ARCSEC
"""A drift or a shift of this size nobody would overlook."""


def model_of(plan: LevelPlanSettings, solver: LevelSolverSettings, read: Readings) -> Model:
    """Return unknowns, readings and what could spoil them; a target is a level in a setting."""
    angles, azimuths = np.array(table_angles(plan)), np.array(plan.azimuths_deg) * DEGREE
    n, k = len(angles), len(azimuths)
    position, level, when = read.position, read.target, read.when
    blocks = {"EAC": n, "EBC": n, "zero of level": k, "azimuth error": k}
    sizes = tuple(blocks.values())
    mine = indicators(*zip((position, position, level, level), sizes, strict=True))
    points = angles[position] + azimuths[level]

    def equations(x: Floats) -> tuple[Floats, Floats]:
        a = points + x[-k:][level]
        eac, ebc = x[:n][position], x[n : 2 * n][position]
        turned = eac * np.cos(a) + ebc * np.sin(a)
        factors = np.column_stack([np.sin(a), -np.cos(a), np.ones_like(a), turned])
        design = mine * np.repeat(factors, sizes, axis=1)
        return design[:, :-k] @ x[:-k], design

    one, c, s = (v[:, None] for v in (np.ones(n), np.cos(angles), np.sin(angles)))
    unseen = np.block([[one, 0.0 * one, c, -s], [0.0 * one, one, s, c]])
    share = np.linalg.pinv(unseen)  # of the mean and of what turns, in EAC and EBC
    age = (when - when.mean()) / max(np.ptp(when), 1.0)
    tilting = age[:, None] * np.column_stack([np.sin(points), -np.cos(points)])
    model = Model(
        blocks=blocks,
        observed=read.value,
        std=np.full(len(when), solver.sigma_arcsec * ARCSEC),
        equations=equations,
        outputs=np.eye(2 * n, sum(sizes)) - np.pad(unseen @ share, ((0, 0), (0, 2 * k))),
        further={
            "lean of the axis": np.pad(share[:2], ((0, 0), (0, 2 * k))),
            "azimuth error": np.eye(k, sum(sizes), 2 * n + k),
        },
        words=Words("readings", "somebody who walks or leans", "at the table", "at the table"),
        components=("the readings",),
        groupings=(Grouping("level", level, along=when), Grouping("position", position)),
        effects=(
            *instrument_effects("the level", level, when, LARGEST),
            Disturbing("drift", "the base of the table tilts", tilting, LARGEST),
        ),
    )
    known = np.eye(k, sum(sizes), 2 * n + k)
    return model.with_prior("the azimuths", known, np.zeros(k), solver.azimuth_std_deg * DEGREE)
