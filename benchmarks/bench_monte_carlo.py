"""Monte Carlo: seconds per trial, vectorised, against a plain loop over ``solve``.

Both sides solve the same numbers; the best time of each counts.
"""

import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from racing import Row

from rotcal_ros.methods.ball_plate import solver as ball_plate

sys.path.insert(0, str(Path(__file__).parents[1] / "test"))
sys.path.insert(0, str(Path(__file__).parents[1] / "test" / "evaluation"))
import one_table

TRIALS, LOOPS = 1000, 20
BALLS = (0, 8, 12, 18, 21, 28, 32, 37, 42, 50, 58, 62)


Model = Callable[[np.random.Generator, int], np.ndarray]


def race(name: str, model: Model, plain: Callable[[], np.ndarray]) -> Row:
    """Time ``model`` per trial and ``plain``, which solves the first LOOPS trials of seed 1."""
    ours, theirs = np.inf, np.inf
    difference = float(np.abs(model(np.random.default_rng(1), LOOPS) - plain()).max())
    for _ in range(3):
        start = time.process_time()
        model(np.random.default_rng(1), TRIALS)
        middle = time.process_time()
        plain()
        ours = min(ours, (middle - start) / TRIALS)
        theirs = min(theirs, (time.process_time() - middle) / LOOPS)
    return Row(f"Monte Carlo trial, {name}", ours, theirs, theirs / ours, difference)


# Problems without noise of their own: a trial then carries the noise of one measurement, and the
# solver rejects nothing that the trials keep.
EXACT = one_table.Instruments(1e-15, 1e-15, 1e-15, motion=0.0, tilt=0.0)
CENTRE = 0.1e-6


def plate() -> Row:
    """12 balls at 72 table positions."""
    rng = np.random.default_rng(0)
    table = one_table.table_deviations(72, rng, EXACT)
    task = replace(one_table.by_ball_plate(table, rng, BALLS, 0.185, EXACT), sigma=CENTRE)
    trials = ball_plate.plate_trials(task)
    noise = CENTRE * np.random.default_rng(1).standard_normal((LOOPS, *task.centres.shape))

    def plain() -> np.ndarray:
        results = (ball_plate.solve(replace(task, centres=task.centres + e)) for e in noise)
        return np.array([np.concatenate(list(r.deviations.values())) for r in results])

    return race("ball plate, 72 positions", trials, plain)


def rows() -> Iterator[Row]:
    """Run everything, one row after the other."""
    yield plate()


if __name__ == "__main__":
    for row in rows():
        print(row)
