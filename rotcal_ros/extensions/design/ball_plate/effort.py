"""What a wanted uncertainty needs: balls, CMM positions, size of the plate, noise of the machine.

:func:`required_effort` looks for the fewest centres of a given plate and machine.
:func:`plate_trade` measures all positions and says how large the plate or how quiet the machine
has to be. By cyclic symmetry no choice of n centres, whichever balls at whichever positions, beats
the share n of the plate that has a ball at every step: a variance of V_full N^2 / n, the
:func:`bound`. A good plate of a few balls comes within some per cent of that, so there is little
to plan but the number of centres.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from rotcal_ros.extensions.design.ball_plate.ball_layout import (
    BallLayout,
    mean_variances,
    plan_plate,
)
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.components import COMPONENTS, COVERAGE_FACTOR, unit_of
from rotcal_ros.foundation.errors import ObservabilityError, PlanError
from rotcal_ros.foundation.units import MICROMETRE
from rotcal_ros.methods.ball_plate.measuring_order import spread_out
from rotcal_ros.methods.ball_plate.solver.general_least_squares import factored
from rotcal_ros.methods.ball_plate.solver.problem import BallPlateProblem

MOST_BALLS = 24
"""Balls up to which plates are tried where no number is given."""
ECC = 0
"""Column of :func:`~.ball_layout.mean_variances`."""


@dataclass(frozen=True)
class Effort:
    """One way to reach the wanted uncertainty.

    ``layout`` are the balls, ``positions`` (S,) the CMM positions to measure them at;
    ``expanded`` is the worst predicted expanded uncertainty (k = 2) of the wanted component
    over the table positions, metres or radians; ``centres`` the number of balls to be probed.
    """

    layout: BallLayout
    positions: tuple[int, ...]
    expanded: float

    @property
    def centres(self) -> int:
        """Number of ball centres to measure."""
        return len(self.layout.steps) * len(self.positions)


def required_effort(
    grid: int,
    component: str,
    limit: float,
    *,
    sigma: float,
    radius: float,
    min_gap: int = 1,
    most_balls: int | None = None,
    seed: int = 0,
) -> tuple[Effort, ...]:
    """Find, for every number of balls, the fewest CMM positions for U(component) <= limit.

    ``sigma`` is the standard deviation of a ball centre, ``radius`` that of the ball circle, in
    metres; ``limit`` in metres or radians, with k = 2. The ways are returned in the order
    of the number of centres to be measured, the least work first. Positions are spread over the
    circle. Raises PlanError when the component is unknown or no way reaches the limit.
    """
    if component not in COMPONENTS:
        raise PlanError(f"unknown component {component!r}: one of {', '.join(COMPONENTS)}")
    if not limit > 0.0:
        raise PlanError(f"the wanted uncertainty must be positive, not {limit}")
    ways = []
    most = most_balls or MOST_BALLS
    for n_balls in range(5, min(most, grid // min_gap) + 1):
        try:
            layout = plan_plate(grid, n_balls, min_gap=min_gap, seed=seed, starts=6, exact=False)
        except PlanError:
            continue
        scale = COVERAGE_FACTOR * sigma
        if (way := _fewest_positions(layout, component, radius, limit / scale)) is not None:
            ways.append(Effort(layout, way[0], scale * way[1]))
    if not ways:
        unit, label = unit_of(component)
        raise PlanError(
            f"no layout of up to {most} balls on {grid} steps reaches "
            f"U({component}) <= {limit / unit:g} {label} with {sigma / MICROMETRE:g} um per "
            "centre: repeat the measurement n times (U falls with the square root of n), or use "
            "a larger ball circle"
        )
    return tuple(sorted(ways, key=lambda way: (way.centres, way.expanded)))


def unit_std(
    grid: int, balls: Ints | list[int], positions: Ints | list[int], radius: float
) -> dict[str, Floats]:
    """Return the standard deviations (N,) of the six components for unit noise of a centre.

    For any choice of balls and CMM positions; ObservabilityError when it separates nothing.
    """
    ball, cmm = (axis.ravel() for axis in np.meshgrid(balls, positions))
    problem = BallPlateProblem.nominal(grid, radius, (cmm - ball) % grid, ball)
    unit = factored(problem).solve(problem.deviations).unit_std
    return {name: unit.component(name) for name in COMPONENTS}


def _fewest_positions(
    layout: BallLayout, component: str, radius: float, limit: float
) -> tuple[tuple[int, ...], float] | None:
    """Bisect the number of CMM positions; None when all are not enough.

    The sets are nested, so that more positions never raise the uncertainty.
    """
    grid = layout.grid
    spread = spread_out(grid)

    @cache
    def worst(count: int) -> float:
        try:
            std = unit_std(grid, np.array(layout.steps), spread[:count], radius)[component]
        except ObservabilityError:
            return np.inf
        return float(std.max())

    if worst(grid) > limit:
        return None
    enough = bisect_left(range(grid), True, lo=4, key=lambda count: worst(count) <= limit)
    return tuple(np.sort(spread[:enough]).tolist()), worst(enough)


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
        layout = plan_plate(grid, count, weights=(1.0, 0.0, 0.0, 0.0), seed=seed, starts=6)
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
