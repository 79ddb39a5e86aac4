"""How often the stated intervals of balls on the table hold the truth.

    python research/ball_coverage.py [RUNS] [--case WORDS] [--whole] [--motions]

Worlds of the tests' own generator (``test/ball_world.py``) whose errors are drawn from what is
stated of them: the axis, its motions, the linear axes' scales and squareness, where the balls
stand; in two cases lobes of the probe, with 1 um of play in the linear axes as well. Of each case:
how many of the 95 % intervals hold the truth, of each curve in the mean of its angles, and of the
lines one by one; with --whole through the whole engine, and how often the verdict was ok. Figures
of it are in docs/evidence.md.
"""

from __future__ import annotations

import argparse
import os
import sys
from dataclasses import dataclass, replace
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from rotcal_ros.adjust.engine import adjust
from rotcal_ros.adjust.fit import fit_model
from rotcal_ros.adjust.model import Model
from rotcal_ros.foundation.arrays import Bools, Floats
from rotcal_ros.foundation.components import HALF_OF_95_PERCENT
from rotcal_ros.foundation.units import MICROMETRE
from rotcal_ros.methods.table_balls.model import AXIS, BallsOnTable, components_of, model_of
from rotcal_ros.methods.table_balls.settings import BallsPlanSettings, BallsSolverSettings

sys.path.insert(0, str(Path(__file__).parents[1] / "test"))
sys.path.insert(0, str(Path(__file__).parents[1] / "test" / "methods" / "table_balls"))
from ball_world import AS_DRAWN, COLUMN, LEVEL, NAMES, ONE, THREE, World
from test_motions import MEASURES, STATED, WORLDS, covered, planned, stated

NOISE_M, PLAY_M, TIP_M = 1e-6, 1e-6, 2e-6
ORTHOGONAL = {"measure": "bar", "bars_m": (0.1, 0.0, 0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 0.1)}
SLANTED = {"measure": "bar", "bars_m": (0.06, 0.05, 0.07, 0.0, 0.1, 0.0, 0.0, 0.0, 0.1)}
TILTS = {
    "chain": "AC", "tilts_deg": (-60.0, 0.0, 50.0, 90.0), "tilting_axis_m": (0.02, 0.01, -0.1),
    "table_step_deg": 45.0, "table_positions": 8, "runs": 1,
}  # fmt: skip


@dataclass(frozen=True)
class Case:
    """What is measured: ``balls``, ``more`` of the plan, and whether there are lobes and play."""

    balls: tuple[float, ...]
    more: dict[str, object]
    spoiled: bool = False

    def world(self, rng: np.random.Generator) -> World:
        """Return a world drawn from what is stated of it; play counts as noise of three balls."""
        plan = BallsPlanSettings(balls_m=self.balls, axis_m=(0.0, 0.0, 0.06), **self.more)
        if not self.spoiled:
            return World.drawn(plan, rng, AS_DRAWN)
        sigma = NOISE_M if self.balls == ONE else float(np.hypot(NOISE_M, 0.5 * PLAY_M))
        world = World.drawn(plan, rng, replace(AS_DRAWN, tip_std_m=TIP_M, sigma_centre_m=sigma))
        world.lobing = MICROMETRE
        shift = np.abs(world.touched()[0]) / MICROMETRE
        world.lobing = complex(*(TIP_M / shift * rng.standard_normal(2)))
        world.play = PLAY_M
        return world


CASES = {
    "one ball": Case(ONE, {}),
    "two balls of one height": Case(LEVEL, {}),
    "two balls of one radius": Case(COLUMN, {}),
    "three balls": Case(THREE, {}),
    "one ball, lobes and play": Case(ONE, {}, spoiled=True),
    "three balls, lobes and play": Case(THREE, {"runs": 1}, spoiled=True),
    "one ball, four tilts": Case(ONE, TILTS),
    "three balls, four tilts": Case(THREE, TILTS),
    "ball bar, one ball": Case(ONE, ORTHOGONAL),
    "slanted ball bar, one ball": Case(ONE, SLANTED),
    "ball bar, three balls": Case(THREE, ORTHOGONAL),
    "ball bar, three balls, four tilts": Case(THREE, {**ORTHOGONAL, **TILTS}),
}


def solved(model: Model, whole: bool) -> tuple[Floats, Floats, bool]:
    """Return outputs (o,) with their standard uncertainties, and whether the verdict is ok."""
    if whole:
        found = adjust(model)
        return found.value, found.std, found.verdict == "ok"
    fit = fit_model(model, np.ones(model.size[0], dtype=np.bool_), model.std, model.first)
    count = len(model.outputs)
    return fit.value[:count], np.linalg.norm(fit.response, axis=1)[:count], True


def held(world: World, rng: np.random.Generator, whole: bool) -> tuple[Bools, bool]:
    """Return which intervals (o,) of a measurement hold the truth, and whether it is ok."""
    model = model_of(world.plan, world.solver, world.readings(NOISE_M, rng))
    value, std, good = solved(model, whole)
    balls = BallsOnTable.of(world.plan, world.solver)
    if balls.tilting is None:
        motions, line = world.truth()
    else:  # they obey the definitions as they were drawn
        motions = world.motions.reshape(6, balls.tilts, -1).mean(axis=1)
        line = np.concatenate([world.axis, world.line])
    told = [motions[NAMES.index(name)] for name in components_of(balls)]
    return np.abs(value - np.concatenate([*told, line])) < HALF_OF_95_PERCENT * std, good


def row(name: str, runs: int, whole: bool) -> str:
    """Return the line of one case."""
    case, rng = CASES[name], np.random.default_rng(20)
    tried = [held(case.world(rng), rng, whole) for _ in range(runs)]
    share, good = (
        np.mean([inside for inside, _ in tried], axis=0),
        np.mean([ok for _, ok in tried]),
    )
    balls = BallsOnTable.of(case.world(rng).plan, BallsSolverSettings())
    names = components_of(balls)
    lines = AXIS if balls.tilting is None else (*AXIS, *balls.tilting.line)
    curves = share[: -len(lines)].reshape(len(names), -1).mean(axis=1)
    told = dict(zip((*names, *lines), (*curves, *share[-len(lines) :]), strict=True))
    each = ", ".join(f"{what} {100.0 * part:.1f}" for what, part in told.items())
    return f"| {name} | {each} | {f'{100.0 * good:.1f} %' if whole else '-'} |"


def motion_row(orders: str, count: int, measure: str, knows: str, runs: int) -> str:
    """Return the line of one ball on a table that moves in some orders; ``knows``: as stated."""
    solver = stated(**STATED.get(knows, {}))
    share = covered(planned(count, **MEASURES.get(measure, {})), solver, WORLDS[orders], runs)
    each = " | ".join(f"{100.0 * part:.1f}" for part in share)
    return f"| {orders} | {knows} | {measure} | {count} | {each} |"


def print_motions(runs: int) -> None:
    """Print how often intervals of one ball hold the truth where motions have orders."""
    print("| motion | stated | measure | angles | ECC | XOC | YOC | AOC | BOC |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- | --- |")
    for count in (12, 36, 72):
        for orders in WORLDS:
            print(motion_row(orders, count, "touch", "any", runs), flush=True)
    for orders in STATED:
        print(motion_row(orders, 12, "touch", orders, runs), flush=True)
    for measure in MEASURES:
        for orders in WORLDS:
            print(motion_row(orders, 12, measure, "any", runs), flush=True)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("runs", nargs="?", type=int, default=1000)
    parser.add_argument("--case", action="append", choices=CASES)
    parser.add_argument("--whole", action="store_true", help="with the verdict of the engine")
    parser.add_argument("--motions", action="store_true", help="one ball, motions in orders")
    given = parser.parse_args()
    if given.motions:
        print_motions(given.runs)
        return
    print("| case | intervals that hold the truth / % | ok |")
    print("| --- | --- | --- |")
    for name in given.case or CASES:
        print(row(name, given.runs, given.whole), flush=True)


if __name__ == "__main__":
    main()
