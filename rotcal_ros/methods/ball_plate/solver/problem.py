"""What the ball plate method is given: centres of balls at table positions.

For a ball j at the table position i the method knows the CMM position k = i + j (mod N) where it
stands, when it was measured, and how far it was found from its nominal place.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final

import numpy as np

from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.errors import DataError, PlanError
from rotcal_ros.foundation.language import Phrase, phrase

COLUMNS: Final = {
    **dict.fromkeys(("position", "ball_step", "row"), np.int64),
    **dict.fromkeys(("centres", "std", "time"), np.float64),
}
"""What a problem holds row by row."""


@dataclass(frozen=True)
class BallPlateProblem:
    """Ball centres measured on a plate that stands on a rotary table.

    Row ``r`` is the centre ``centres[r]`` (n, 3), in metres, of the ball on grid step
    ``ball_step[r]`` while the table stood at position ``position[r]``; the table turns
    counter-clockwise by ``2 pi / grid`` per position. The frame is fixed to the CMM: z along
    the table axis, origin on the axis at the height of the ball centres, ball step 0 at table
    position 0 near the +x axis. ``radius`` is the nominal radius of the ball circle in metres.
    ``bidirectional``: position 2 grid - 1 - i stands at the angle of position i, reached from the
    other side, with errors of its own.

    ``sigma`` is the standard deviation of a centre coordinate in metres, None when it shall be
    taken from the residuals. ``std`` (n, 3), in metres, gives every coordinate its own standard
    deviation instead. ``row`` (n,) numbers the rows in the order of measurement: the numbers
    appear in every message, and a plate that moved is searched for along them.
    ``time`` (n,), s, says when each was measured; without it the rows count as equally long. A
    drift of the CMM's origin, ``drift`` of 0 (none), 1 (linear) or 2 (quadratic in time), is
    estimated along; a drift within +- ``drift_allowance``, m over the run along each axis, is
    covered by the uncertainty. ``separate_groups`` accepts a plate whose ball steps share a
    factor with the grid: the groups of table positions are then solved separately, each with its
    own zero. ``group_allowance``, m on the circle of the balls, bounds how far apart these are,
    and the uncertainty covers it; 0 states nothing, and the offset between the groups stays open.
    ``closed_form`` takes the table's deviations from means (second paper, Eq. 1 to 12).
    ``material`` of the plate turns its growth into kelvin; empty: not stated.

    Rows are kept in a canonical order (ball step, table position, row number), so that the
    order of the table cannot change a bit of the result. Raises DataError for wrong shapes and
    indices outside the grid.
    """

    grid: int
    radius: float
    position: Ints
    ball_step: Ints
    centres: Floats
    sigma: float | None = None
    std: Floats | None = None
    row: Ints | None = None
    separate_groups: bool = False
    time: Floats | None = None
    drift: int = 0
    drift_allowance: float = 0.0
    bidirectional: bool = False
    group_allowance: float = 0.0
    closed_form: bool = False
    material: str = ""

    def __post_init__(self) -> None:
        if self.row is None:
            object.__setattr__(self, "row", np.arange(len(self.position)))
        columns = {
            name: np.asarray(values, dtype=kind)
            for name, kind in COLUMNS.items()
            if (values := getattr(self, name)) is not None
        }
        _check_statements(self)
        _check_columns(self, columns)
        order = np.lexsort((columns["row"], columns["position"], columns["ball_step"]))
        for name, column in columns.items():
            object.__setattr__(self, name, column[order])

    @classmethod
    def nominal(
        cls, grid: int, radius: float, position: Ints, ball_step: Ints, **fields: Any
    ) -> BallPlateProblem:
        """Return a problem with nominal centres, for all that follows from the layout alone."""
        angle = grid_angles(grid)[(grid_step(position, grid) + ball_step) % grid]
        return cls(grid, radius, position, ball_step, radius * on_circle(angle), **fields)

    @cached_property
    def rows(self) -> Ints:
        """Row numbers (n,) in the order of measurement."""
        return np.asarray(self.row, dtype=np.int64)

    @cached_property
    def run_time(self) -> Floats:
        """When each row was measured, -0.5 at the first and 0.5 at the last, (n,)."""
        when = self.rows if self.time is None else self.time
        first, span = float(when.min()), float(np.ptp(when)) or 1.0
        return np.asarray((when - first) / span - 0.5, dtype=np.float64)

    @cached_property
    def cmm_index(self) -> Ints:
        """CMM position k = grid step of the table + ball step, modulo the grid, (n,)."""
        return (grid_step(self.position, self.grid) + self.ball_step) % self.grid

    @property
    def n_positions(self) -> int:
        """Number N of table positions, those from either side counted on their own."""
        return self.grid * (1 + self.bidirectional)

    @cached_property
    def cell(self) -> Ints:
        """A number for each pair of table position and ball step, (n,)."""
        return self.position * self.grid + self.ball_step

    @cached_property
    def stop(self) -> Ints:
        """Number of the table's stop at which each row was measured, in their order, (n,)."""
        order = np.argsort(self.rows, kind="stable")
        stops = np.empty(len(order), dtype=np.int64)
        stops[order] = np.cumsum(np.diff(self.position[order], prepend=-1) != 0) - 1
        return stops

    @cached_property
    def weighed_alike(self) -> bool:
        """Whether all rows have the same standard deviations of x, y, z, or none of their own."""
        return self.std is None or not np.ptp(self.std, axis=0).any()

    @cached_property
    def balls(self) -> Ints:
        """The ball steps in use, ascending, (R,)."""
        return _in_use(self.ball_step)

    @cached_property
    def cmm_positions(self) -> Ints:
        """The CMM positions in use, ascending, (S,)."""
        return _in_use(self.cmm_index)

    @cached_property
    def table_positions(self) -> Ints:
        """The table positions in use, ascending, (M,); all of them unless some are missing."""
        return _in_use(self.position)

    @cached_property
    def angles(self) -> Floats:
        """Commanded table angles in radians, (n_positions,)."""
        return grid_angles(self.grid)[grid_step(np.arange(self.n_positions), self.grid)]

    @cached_property
    def complete(self) -> bool:
        """Whether every ball was measured exactly once at every table position, from one side."""
        if self.bidirectional or len(self.cell) != len(self.balls) * self.grid:
            return False
        return bool(np.diff(self.cell).all())  # in canonical order doubles are neighbours

    @cached_property
    def deviations(self) -> Floats:
        """Measured minus nominal centres m - p_k, metres, (n, 3)."""
        return self.centres - self.radius * on_circle(self.angles[self.cmm_index])

    def row_name(self, r: int | np.integer) -> Phrase:
        """Return what a row is, for messages."""
        return phrase(
            "row {0} (ball step {1}, table position {2})", self.rows[r], self.ball_step[r],
            self.position[r]
        )  # fmt: skip

    def take(self, keep: Bools | Ints) -> BallPlateProblem:
        """Return the problem with only the rows ``keep`` (mask or indices, canonical order)."""
        if keep.dtype == np.bool_ and keep.all():
            return self
        columns = {name: getattr(self, name) for name in COLUMNS}
        return replace(self, **{n: c[keep] for n, c in columns.items() if c is not None})


def select(
    problem: BallPlateProblem,
    *,
    balls: Ints | list[int] | None = None,
    cmm_positions: Ints | list[int] | None = None,
    coarser: int = 1,
) -> BallPlateProblem:
    """Evaluate the same data with fewer balls, fewer CMM positions or a coarser grid.

    ``coarser`` = 2 turns a 5 degree grid into a 10 degree grid: only balls and table positions
    on the coarse grid stay and are renumbered. Raises PlanError when a wanted ball or position
    was not measured, when ``coarser`` does not divide the grid, or when nothing is left.
    """
    if coarser < 1 or problem.grid % coarser:
        raise PlanError(
            f"a grid of {problem.grid} steps cannot be made {coarser} times coarser: choose a "
            "divisor of it"
        )
    step = grid_step(problem.position, problem.grid)
    keep = (problem.ball_step % coarser == 0) & (step % coarser == 0)
    for wanted, column, name in (
        (balls, problem.ball_step, "ball steps"),
        (cmm_positions, problem.cmm_index, "CMM positions"),
    ):
        if wanted is None:
            continue
        missing = np.setdiff1d(wanted, column)
        if len(missing):
            raise PlanError(
                f"{name} {missing.tolist()} were not measured: choose among "
                f"{np.unique(column).tolist()}"
            )
        keep &= np.isin(column, wanted)
    if not keep.any():
        raise PlanError(
            "no centre is left after the selection of balls, positions and grid: choose more"
        )
    part, upward = problem.take(keep), problem.position[keep] < problem.grid
    grid = part.grid // coarser
    return replace(
        part,
        grid=grid,
        position=position_of(step[keep] // coarser, upward, grid),
        ball_step=part.ball_step // coarser,
    )


def _in_use(column: Ints) -> Ints:
    """Return the different values of a column of small numbers, ascending."""
    return np.flatnonzero(np.bincount(column))


def grid_step(position: Ints, grid: int) -> Ints:
    """Return the grid step (n,) of table positions: 0 to grid - 1, then down again."""
    return np.where(position < grid, position, 2 * grid - 1 - position)


def position_of(step: Ints, upward: Bools, grid: int) -> Ints:
    """Return the table position (n,) at a grid ``step`` that is reached from one side."""
    return np.where(upward, step, 2 * grid - 1 - step)


def grid_angles(grid: int) -> Floats:
    """Return the angles 2 pi i / grid in radians, (grid,)."""
    return 2.0 * np.pi * np.arange(grid) / grid


def on_circle(angle: Floats) -> Floats:
    """Return the points (n, 3) of the unit circle at ``angle`` (n,), rad from +x."""
    return np.column_stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)])


def _check_statements(problem: BallPlateProblem) -> None:
    if problem.grid < 3:
        raise DataError(f"a grid of {problem.grid} table positions: give at least 3")
    if problem.drift not in (0, 1, 2):
        raise DataError(
            f"drift of degree {problem.drift}: choose 0 (none), 1 (linear) or 2 (quadratic)"
        )
    positive, some = "a positive length is needed", "a length is needed, 0 for none"
    for name, length, needed in (
        ("radius of the ball circle", problem.radius, positive),
        ("stated noise of a centre", problem.sigma, positive),
        ("drift allowance", problem.drift_allowance, some),
        ("group allowance", problem.group_allowance, some),
    ):
        if length is None or (np.isfinite(length) and length > 0.0):
            continue
        if length != 0.0 or needed is positive:
            raise DataError(f"{name} is {length} m: {needed}")


def _check_columns(problem: BallPlateProblem, columns: Mapping[str, np.ndarray]) -> None:
    n, std, time = len(columns["position"]), columns.get("std"), columns.get("time")
    shapes = {"position": (n,), "ball_step": (n,), "row": (n,), "centres": (n, 3)}
    if std is not None and (std.shape != (n, 3) or not np.all(std > 0.0)):
        raise DataError(f"std must hold {n} x 3 positive lengths, found {std.shape}")
    wrong = [f"{k} {columns[k].shape}" for k, shape in shapes.items() if columns[k].shape != shape]
    if wrong or n == 0:
        raise DataError(f"columns do not fit together: {', '.join(wrong) or 'no rows at all'}")
    for name, what, count in (
        ("position", "table position", problem.n_positions),
        ("ball_step", "ball step", problem.grid),
    ):
        outside = np.flatnonzero((columns[name] < 0) | (columns[name] >= count))
        if len(outside):
            first = outside[0]
            raise DataError(
                f"row {columns['row'][first]}: {what} {columns[name][first]} is outside "
                f"0..{count - 1} ({len(outside)} such rows); check the grid of the plate"
            )
    if time is not None and (time.shape != (n,) or not np.isfinite(time).all()):
        raise DataError(f"time must hold {n} finite seconds, found {time.shape}")
