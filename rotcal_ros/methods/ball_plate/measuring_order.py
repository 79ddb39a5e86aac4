"""The order in which a ball plate is measured: little motion, one direction, known duration."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.errors import PlanError
from rotcal_ros.planning.sequence_time import Drive

Order = Literal["interleaved", "table_once", "probe_rests"]
DEFAULT_ORDER: Final[Order] = "interleaved"
ROUNDS: Final = 4
"""Turns of the table in the interleaved order where none are asked for."""
CLOSING_BALLS: Final = 3
"""Balls at a table position below which its repetition shows no motion."""
_GOLDEN: Final = 0.5 * (np.sqrt(5.0) - 1.0)
"""Steps of this part of a turn never come back near to an earlier one: no period, even spread."""


@dataclass(frozen=True)
class Kinematics:
    """What moves how fast: rad/s, rad/s^2, m/s, m/s^2, m, s.

    ``settle`` is waited after every table move, ``touch`` is the time of one touch point with
    its approach, ``clearance`` the height at which the probe crosses the plate.
    """

    table_velocity: float = 0.2
    table_acceleration: float = 0.5
    probe_velocity: float = 0.1
    probe_acceleration: float = 0.5
    settle: float = 1.0
    touch: float = 2.0
    touches_per_ball: int = 15
    clearance: float = 0.05


@dataclass(frozen=True)
class BallPlan:
    """One row per ball centre, in the order of measurement; arrays of shape (n,).

    ``position`` is the grid step at which the table stands, ``upward`` whether it was reached with
    increasing angle. ``table_angle`` is unwrapped, in radians: the table turns to it from the row
    before. ``table_travel`` (rad) adds up all its motion, ``reversals`` counts changes of
    direction, ``duration`` is predicted in seconds, ``lead_in`` the angle from which the first
    position is approached so that all are approached from the same side. The last ``closing`` rows
    measure the first table position again.
    """

    grid: int
    position: Ints
    ball_step: Ints
    table_angle: Floats
    upward: Bools
    closing: int
    lead_in: float
    table_travel: float
    reversals: int
    duration: float

    @property
    def cmm_index(self) -> Ints:
        """CMM position of every row."""
        return (self.position + self.ball_step) % self.grid


def plan_measurement(
    grid: int,
    balls: list[int] | Ints,
    *,
    positions: list[int] | Ints | None = None,
    order: Order = DEFAULT_ORDER,
    rounds: int = 0,
    closing: bool = True,
    backlash: bool = True,
    bidirectional: bool = False,
    radius: float = 0.185,
    kinematics: Kinematics | None = None,
) -> BallPlan:
    """Order the centres of all balls at the CMM positions (all when None).

    ``interleaved`` turns the table around ``rounds`` times (ROUNDS when 0) and measures a share
    of the balls at every stop, another one each time: every ball, every table position and every
    CMM position is met early and late, so that nothing can take a drift or a knock for its own.
    ``table_once`` turns the table once around in all and lets the probe visit all balls at every
    position, to and fro; with ``rounds`` > 1 it goes around so often, each time for a share of
    the CMM positions. ``probe_rests`` keeps the probe at one CMM position and turns all balls to
    it, as in the paper. ``closing`` measures the first table position again at the end (the first
    with most balls, where positions are left out). With
    ``backlash`` every position is approached in the positive direction: no reversals, and a
    lead-in of one step. ``bidirectional``: every turn of the table is measured upward and once
    more downward, its positions then approached in the negative direction. ``radius`` of the ball
    circle in metres. Raises PlanError for steps outside the grid, and for both directions without
    backlash.
    """
    if bidirectional and not backlash:
        raise PlanError(
            "both directions are distinguished by the side of the approach: set backlash to true"
        )
    balls, cmm = np.unique(balls), np.arange(grid) if positions is None else np.unique(positions)
    for name, steps in (("ball steps", balls), ("CMM positions", cmm)):
        if not len(steps) or steps[0] < 0 or steps[-1] >= grid:
            raise PlanError(f"{name} must lie in 0..{grid - 1}, found {steps.tolist()}")
    turns, ball = _ordered(order, grid, balls, cmm, rounds, backlash)
    upward = np.ones(len(turns), dtype=np.bool_)
    if bidirectional:
        turns, ball, upward = _to_and_back(grid, turns, ball)
    n_once = len(turns)
    if closing:
        turns, ball = _closed(grid, turns, ball, backlash)
        upward = np.append(upward, np.full(len(turns) - n_once, True))
    angle = np.asarray(turns * 2.0 * np.pi / grid, dtype=np.float64)
    lead_in, moves = _moves(angle, upward, 2.0 * np.pi / grid, backlash, bidirectional)
    directions = np.sign(moves[moves != 0.0])
    return BallPlan(
        grid=grid,
        position=turns % grid,
        ball_step=ball,
        table_angle=angle,
        upward=upward,
        closing=len(turns) - n_once,
        lead_in=lead_in,
        table_travel=float(np.abs(moves).sum()),
        reversals=int(np.count_nonzero(np.diff(directions))),
        duration=_duration(grid, turns, ball, moves, radius, kinematics or Kinematics()),
    )


def _moves(
    angle: Floats, upward: Bools, step: float, backlash: bool, bidirectional: bool
) -> tuple[float, Floats]:
    """Return the angle from which the first of ``angle`` (n,) is approached, and all ways (n,)."""
    lead_in = float(angle[0]) - (step if backlash else 0.0)
    moves = np.diff(angle, prepend=lead_in)
    if not bidirectional:
        return lead_in, moves
    direction = np.where(upward, 1.0, -1.0)  # a grid step there and back where the side changes
    along = moves * direction
    far = (along < 0.0) | (np.diff(upward, prepend=True) & (along <= 0.0))
    return lead_in, np.where(far, direction * (np.abs(moves) + 2.0 * step), moves)


def _ordered(
    order: Order, grid: int, balls: Ints, cmm: Ints, rounds: int, backlash: bool
) -> tuple[Ints, Ints]:
    if order == "interleaved":
        return _interleaved(grid, balls, cmm, rounds or min(ROUNDS, len(balls)))
    if order == "table_once":
        return _in_rounds(grid, balls, cmm, rounds or 1)
    if order == "probe_rests":
        return (_probe_rests if backlash else _to_and_fro)(grid, balls, cmm)
    raise PlanError(f"unknown order {order!r}: choose interleaved, table_once or probe_rests")


def _to_and_back(grid: int, turns: Ints, ball: Ints) -> tuple[Ints, Ints, Bools]:
    """Measure every turn of the table from both sides, and say which rows go up.

    Up and down, down and up, and so on: what drifts linearly is in the mean no reversal where the
    turns are even in number. The table stays within its first turn and the one before.
    """
    number = (turns - turns[0]) // grid
    order, upward = [], []
    for n in range(int(number[-1]) + 1):
        rows, first_up = np.flatnonzero(number == n), n % 2 == 0
        order += [rows, rows[::-1]] if first_up else [rows[::-1], rows]
        upward.append(np.repeat([first_up, not first_up], len(rows)))
    rows = np.concatenate(order)
    turns = turns - grid * (number + number % 2)
    return turns[rows], ball[rows], np.concatenate(upward)


def _closed(grid: int, turns: Ints, ball: Ints, backlash: bool) -> tuple[Ints, Ints]:
    """Add the balls of the first table position that has most of them once more."""
    position = turns % grid
    count = np.bincount(position, minlength=grid)[position]
    reference = position[int(np.argmax(count))]
    again = _from_largest_gap(grid, np.unique(ball[position == reference]))
    if len(again) < CLOSING_BALLS:
        return turns, ball
    onward = int(reference - turns[-1]) % grid
    if not backlash and onward > grid // 2:
        onward -= grid
    last = np.full(len(again), turns[-1] + onward)
    return np.concatenate([turns, last]), np.concatenate([ball, again])


def _interleaved(grid: int, balls: Ints, cmm: Ints, rounds: int) -> tuple[Ints, Ints]:
    """Go around ``rounds`` times; every stop takes each ``rounds``-th ball along the circle.

    Which ball begins changes from stop to stop without a period that the grid could share.
    """
    if not 1 <= rounds <= len(balls):
        raise PlanError(
            f"{len(balls)} balls cannot be shared out among {rounds} rounds: set plan.rounds to "
            f"at most {len(balls)}"
        )
    around = _from_largest_gap(grid, balls)
    first = np.floor(np.arange(grid) * _GOLDEN * rounds).astype(np.int64)
    turns, visited = [], []
    forward = True
    for number in range(rounds):
        for position in range(grid):
            taken = (np.arange(len(around)) + first[position]) % rounds == number
            here = around[taken & np.isin((position + around) % grid, cmm)]
            visited.append(here if forward else here[::-1])
            turns.append(np.full(len(here), number * grid + position))
            forward = forward != bool(len(here))
    return np.concatenate(turns), np.concatenate(visited)


def spread_out(grid: int) -> Ints:
    """Order the positions so that any first few are spread over the circle without a period."""
    return np.argsort(np.argsort(np.arange(grid) * _GOLDEN % 1.0))


def _in_rounds(grid: int, balls: Ints, cmm: Ints, rounds: int) -> tuple[Ints, Ints]:
    """Go around once for every share of the CMM positions, the table always onward."""
    if not 1 <= rounds <= len(cmm):
        raise PlanError(
            f"{len(cmm)} CMM positions cannot be shared out among {rounds} rounds: set "
            f"plan.rounds to at most {len(cmm)}"
        )
    spread = spread_out(grid)
    shares = np.array_split(spread[np.isin(spread, cmm)], rounds)
    turns, visited = [], []
    for number, share in enumerate(shares):
        turn, ball = _table_once(grid, balls, share)
        turns.append(turn + number * grid)
        visited.append(ball)
    return np.concatenate(turns), np.concatenate(visited)


def _table_once(grid: int, balls: Ints, cmm: Ints) -> tuple[Ints, Ints]:
    """Table position by position; the probe sweeps around, leaving out the largest gap."""
    wanted = np.zeros(grid, dtype=np.bool_)
    wanted[cmm] = True
    around = _from_largest_gap(grid, balls)
    turns, visited = [], []
    forward = True
    for position in range(grid):
        here = around[wanted[(position + around) % grid]]
        visited.append(here if forward else here[::-1])
        turns.append(np.full(len(here), position))
        forward = forward != bool(len(here))
    return np.concatenate(turns), np.concatenate(visited)


def _from_largest_gap(grid: int, steps: Ints) -> Ints:
    """Order steps around the circle so that the largest gap is never crossed."""
    gaps = np.diff(steps, append=steps[0] + grid)
    return np.roll(steps, -(int(np.argmax(gaps)) + 1))


def _probe_rests(grid: int, balls: Ints, cmm: Ints) -> tuple[Ints, Ints]:
    """CMM position by position, the table always onward to the next ball."""
    turns, visited = [], []
    now = 0
    for position in cmm:
        ahead = (position - balls - now) % grid  # steps onward to bring each ball there
        order = np.argsort(ahead, kind="stable")
        turns.append(now + ahead[order])
        visited.append(balls[order])
        now = int(turns[-1][-1])
    return np.concatenate(turns), np.concatenate(visited)


def _to_and_fro(grid: int, balls: Ints, cmm: Ints) -> tuple[Ints, Ints]:
    """CMM position by position, the table turning back where the largest gap begins."""
    around = _from_largest_gap(grid, balls)
    along = around[0] + np.cumsum(np.diff(around, prepend=around[0]) % grid)  # never wraps
    turns, visited = [], []
    for sweep, position in enumerate(cmm):
        order = slice(None, None, -1 if sweep % 2 == 0 else 1)
        turns.append(position - along[order])
        visited.append(around[order])
    return np.concatenate(turns), np.concatenate(visited)


def _duration(
    grid: int, turns: Ints, ball: Ints, moves: Floats, radius: float, kinematics: Kinematics
) -> float:
    k = kinematics
    table = Drive(k.table_velocity, k.table_acceleration).moving(np.abs(moves))
    settling = k.settle * np.count_nonzero(moves)
    place = 2.0 * np.pi * (turns + ball) / grid
    across = 2.0 * radius * np.abs(np.sin(0.5 * np.diff(place)))  # the chord
    probe = Drive(k.probe_velocity, k.probe_acceleration)
    crossing, lift = probe.moving(across), float(probe.moving(np.array(k.clearance)))
    # the probe lifts whenever the table turns or it goes to another place
    lifts = 1 + np.count_nonzero((np.abs(moves[1:]) > 0.0) | (across > 1e-9 * radius))
    touching = len(ball) * k.touches_per_ball * k.touch
    return float(table.sum() + settling + crossing.sum() + 2.0 * lift * lifts + touching)
