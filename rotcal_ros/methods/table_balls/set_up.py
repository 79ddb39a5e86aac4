"""What readings of balls may be by a mistake of set-up: other signs, sense or numbering."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from dataclasses import replace
from functools import partial
from typing import Final, NamedTuple

import numpy as np

from rotcal_ros.adjust import alternatives
from rotcal_ros.adjust.alternatives import Alternative, WeighedAlternative
from rotcal_ros.adjust.model import Model
from rotcal_ros.foundation.arrays import Ints
from rotcal_ros.foundation.language import phrase
from rotcal_ros.foundation.protection import Effect
from rotcal_ros.foundation.units import DEGREE
from rotcal_ros.methods.configuration import Configuration
from rotcal_ros.methods.table_balls.model import BallsOnTable
from rotcal_ros.methods.table_balls.settings import BAR, DISPLACEMENT, below_the_table
from rotcal_ros.planning.readings import Readings
from rotcal_ros.planning.table_angles import table_angles

AXES: Final[tuple[tuple[str, tuple[tuple[int, ...], ...]], ...]] = (
    ("displacements are those of the nest from the ball", ((-1, 0, 0), (0, -1, 0), (0, 0, -1))),
    ("dx counts the other way", ((-1, 0, 0), (0, 1, 0), (0, 0, 1))),
    ("dy counts the other way", ((1, 0, 0), (0, -1, 0), (0, 0, 1))),
    ("dz counts the other way", ((1, 0, 0), (0, 1, 0), (0, 0, -1))),
    ("dx and dy are exchanged", ((0, 1, 0), (1, 0, 0), (0, 0, 1))),
    ("the nest is turned by 90 deg about z", ((0, -1, 0), (1, 0, 0), (0, 0, 1))),
    ("the nest is turned by -90 deg about z", ((0, 1, 0), (-1, 0, 0), (0, 0, 1))),
)
"""Other axes of displacements, and what takes them to those of the machine."""
DOWN: Final = (("z points into the table", ((1, 0, 0), (0, 1, 0), (0, 0, -1))),)
"""The same of centres."""
MOST_ANGLES: Final = 24
"""Table angles that are compared, evenly out of more: they show a mistake of set-up as well."""


class AlternativeSetup(NamedTuple):
    """That ``what`` holds, by a mistake like ``effect``: then this set-up and these readings."""

    effect: Effect
    what: str
    configuration: Configuration
    read: Readings


def alternative_setups(configuration: Configuration, read: Readings) -> Iterator[AlternativeSetup]:
    """Yield what else was read may be."""
    plan = configuration.plan
    for letter in (below_the_table(plan.chain), "C"):
        if letter:
            chain = plan.chain.replace(letter, f"-{letter}").replace("--", "")
            turned = replace(configuration, plan=replace(plan, chain=chain))
            yield AlternativeSetup(
                "sense", phrase("{0} turns the other way", letter), turned, read
            )
    step = float(np.median(np.diff(table_angles(plan)))) / DEGREE
    for on, what in (
        (step, "the table stood one position behind the one that is stated"),
        (-step, "the table stood one position before the one that is stated"),
    ):
        angles = tuple(angle / DEGREE + on for angle in table_angles(plan))
        turned = replace(configuration, plan=replace(plan, table_angles_deg=angles))
        yield AlternativeSetup("numbering", what, turned, read)
    for what, target in _exchanged(configuration, read):
        yield AlternativeSetup("numbering", what, configuration, replace(read, target=target))
    yield from _signs(configuration, read)


def _exchanged(configuration: Configuration, read: Readings) -> Iterator[tuple[str, np.ndarray]]:
    """Yield the targets (n,) were two neighbours, set-ups or balls, taken for each other."""
    plan = configuration.plan
    every, other = len(plan.balls_m) // 3, np.zeros(len(read.target), np.int64)
    number = read.target
    if plan.measure == BAR:
        every = len(plan.bars_m) // 3
        other, number = read.target // every * every, read.target % every
    for k in range(every if every > 2 else every - 1):
        pair = k, (k + 1) % every
        first, second = number == pair[0], number == pair[1]
        found = np.where(first, pair[1], np.where(second, pair[0], number))
        a, b = sorted(pair)
        both = (
            phrase("set-ups {0} and {1}", a, b)
            if plan.measure == BAR
            else phrase("balls {0} and {1}", a, b)
        )
        yield phrase("{0} are taken for each other", both), other + found


def _signs(configuration: Configuration, read: Readings) -> Iterator[AlternativeSetup]:
    """Yield readings that count the other way, or along other axes."""
    plan = configuration.plan
    if plan.measure == BAR:
        balls = BallsOnTable.of(plan, configuration.solver)
        wanted = np.linalg.norm(balls.arms, axis=1)[read.target]
        found = replace(read, value=2.0 * wanted - read.value)
        what = "a bar that grows longer shows less"
        yield AlternativeSetup("sign of readings", what, configuration, found)
        return
    signs = AXES if plan.measure == DISPLACEMENT else DOWN
    for what, axes in signs:
        points = read.points @ np.array(axes, dtype=np.float64).T
        found = replace(read, points=points, value=points[:, 0])
        effect: Effect = "sign of readings" if plan.measure == DISPLACEMENT else "sign of z"
        yield AlternativeSetup(effect, what, configuration, found)


def _thinned(configuration: Configuration, read: Readings) -> tuple[Configuration, Readings, Ints]:
    """Return the same at MOST_ANGLES or fewer, evenly, and which (k,) readings these are."""
    angles = np.array(table_angles(configuration.plan)) / DEGREE
    every = -(-len(angles) // MOST_ANGLES)
    rows = np.flatnonzero(read.position % every == 0)
    plan = replace(configuration.plan, table_angles_deg=tuple(angles[::every].tolist()))
    points = read.points[rows] if len(read.points) else read.points
    found = Readings(
        read.position[rows] // every, read.target[rows], read.station[rows], read.value[rows],
        read.order[rows], points,
    )  # fmt: skip
    return replace(configuration, plan=plan), found, rows


def compare_setups(
    configuration: Configuration,
    read: Readings,
    left_out: Collection[int],
    model: Callable[[Configuration, Readings], Model],
) -> list[WeighedAlternative]:
    """Return what speaks for readings meant otherwise, without rows that are ``left_out``.

    ``model`` makes that of a set-up and readings; all motions must be stated in it.
    """

    def of(configuration: Configuration, read: Readings) -> Model:
        return model(*_thinned(configuration, read)[:2])

    each = [
        Alternative(o.effect, o.what, partial(of, o.configuration, o.read))
        for o in alternative_setups(configuration, read)
    ]
    rows = _thinned(configuration, read)[2]
    count = 1 if configuration.plan.measure == BAR else 3
    kept = np.repeat(rows * count, count) + np.tile(np.arange(count), len(rows))
    number = {row: k for k, row in enumerate(kept.tolist())}
    left_out = [number[row] for row in left_out if row in number]
    return alternatives.compare_alternatives(of(configuration, read), left_out, each)
