"""How many balls and CMM positions a wanted uncertainty needs."""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass
from functools import cache

import numpy as np

from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.components import COMPONENTS, COVERAGE_FACTOR, unit_of
from rotcal_ros.foundation.errors import ObservabilityError, PlanError
from rotcal_ros.foundation.units import MICROMETRE
from rotcal_ros.methods.ball_plate.design.ball_layout import BallLayout, best_layout
from rotcal_ros.methods.ball_plate.design.ball_plan import spread_out
from rotcal_ros.methods.ball_plate.solver.general_least_squares import solve_general
from rotcal_ros.methods.ball_plate.solver.problem import BallPlateProblem, grid_angles

MOST_BALLS = 24


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
            layout = best_layout(grid, n_balls, min_gap=min_gap, seed=seed, starts=6, exact=False)
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
    angle = grid_angles(grid)[cmm]
    nominal = radius * np.column_stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)])
    problem = BallPlateProblem(grid, radius, (cmm - ball) % grid, ball, nominal)
    unit = solve_general(problem).unit_std
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
