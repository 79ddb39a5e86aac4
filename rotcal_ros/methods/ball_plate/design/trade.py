"""How many balls, how large a plate, how quiet a machine: the ball plate's trade, with its bound.

By cyclic symmetry no choice of n centres, whichever balls at whichever positions, beats the share
n of the plate that has a ball at every step: a variance of V_full N^2 / n. A good plate of a few
balls comes within some per cent of that, so there is nothing to plan but the number of centres.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rotcal_ros.foundation.components import COVERAGE_FACTOR
from rotcal_ros.methods.ball_plate.design.ball_layout import best_layout
from rotcal_ros.methods.ball_plate.design.layout_variance import mean_variances

ECC = 0
"""Column of :func:`~.layout_variance.mean_variances`."""


@dataclass(frozen=True)
class PlateTrade:
    """What a plate of ``balls`` at the steps ``ball_steps`` gives, all positions measured.

    ``centres`` are measured in ``seconds``; ``expanded``: U (k = 2) of ECC, rad. ``radius`` and
    ``sigma`` (m) are what the wanted uncertainty takes, the other one as given. ``saving``: share
    of the centres that the best of all plans could save.
    """

    balls: int
    ball_steps: tuple[int, ...]
    centres: int
    seconds: float
    expanded: float
    radius: float
    sigma: float
    saving: float


def plate_trade(
    grid: int,
    balls: Sequence[int],
    limit: float,
    *,
    radius: float,
    sigma: float,
    centre_s: float,
    seed: int = 0,
) -> tuple[PlateTrade, ...]:
    """Return the trade for U(ECC) <= ``limit`` (rad) on ``grid`` table positions.

    ``radius`` (m) of the ball circle, ``sigma`` (m, k = 1) of a centre coordinate, ``centre_s``
    (s) for one centre with all that it takes. Raises PlanError for plates that separate nothing.
    """
    rows = []
    for count in balls:
        layout = best_layout(grid, count, weights=(1.0, 0.0, 0.0, 0.0), seed=seed, starts=6)
        unit = float(mean_variances(grid, np.array(layout.steps))[0, ECC])
        turn = COVERAGE_FACTOR * np.sqrt(unit)  # times sigma / radius
        rows.append(
            PlateTrade(
                balls=count,
                ball_steps=tuple(layout.steps),
                centres=grid * count,
                seconds=grid * count * centre_s,
                expanded=float(turn * sigma / radius),
                radius=float(turn * sigma / limit),
                sigma=float(limit * radius / turn),
                saving=1.0 - bound(grid, grid * count) / unit,
            )
        )
    return tuple(rows)


def bound(grid: int, centres: int) -> float:
    """Return the mean variance of ECC for unit noise and radius that no plan can beat."""
    full = float(mean_variances(grid, np.arange(grid))[0, ECC])
    return full * grid**2 / centres
