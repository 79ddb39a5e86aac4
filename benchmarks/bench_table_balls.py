"""Balls on the table by the engine: one fit against scipy with the same equations and derivatives.

And the same fit with all derivatives in one matrix, where every step costs the cube of the
unknowns. ``rows()`` yields one measurement each; both sides run alternately, the best time of each
counts.
"""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import json
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
from racing import Row, race
from scipy.optimize import least_squares

from rotcal_ros.adjust.designs import dense
from rotcal_ros.adjust.engine import adjust
from rotcal_ros.adjust.fit import fit_model
from rotcal_ros.adjust.model import Model
from rotcal_ros.methods.table_balls.model import model_of
from rotcal_ros.methods.table_balls.settings import BallsPlanSettings

sys.path.insert(0, str(Path(__file__).parents[1] / "test"))
from ball_world import THREE, World

SIGMA_M, TRIALS = 1e-6, 1000


def measurement(chain: str = "C", tilts: tuple[float, ...] = ()) -> Model:
    """72 angles, 3 balls, twice: 1296 coordinates, 451 unknowns with six motions at each angle.

    At two tilts these are 899.
    """
    plan = BallsPlanSettings(
        balls_m=THREE, axis_m=(0.0, 0.0, 0.06), table_step_deg=5.0, table_positions=72,
        runs=1 if tilts else 2, chain=chain, tilts_deg=tilts,
    )  # fmt: skip
    random = np.random.default_rng(20)
    world = World.drawn(plan, random)
    return model_of(plan, world.solver, world.readings(SIGMA_M, random))


def solving(model: Model) -> Callable[[], np.ndarray]:
    """Return what solves a model, from start values to the deviations."""
    every = np.ones(model.size[0], dtype=np.bool_)
    return lambda: fit_model(model, every, model.std, model.first).value


def whole_matrix(model: Model) -> Model:
    """Return the same model with one matrix of derivatives."""

    def equations(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        computed, design = model.equations(x)
        return computed, dense(design)

    return replace(model, equations=equations)


def one_fit() -> Row:
    """Against scipy's solver for any least squares."""
    model = measurement()

    def opponent() -> np.ndarray:
        best = least_squares(
            lambda x: (model.equations(x)[0] - model.observed) / model.std,
            model.first,
            lambda x: dense(model.equations(x)[1]) / model.std[:, None],
            x_scale="jac",
            xtol=1e-12,
            ftol=1e-12,
            gtol=1e-12,
        )
        return model.every_output @ best.x

    a, b, difference = race(solving(model), opponent, (10, 2))
    return Row("one fit, 72 angles x 3 balls x 2", a, b, b / a, difference)


def by_blocks() -> Row:
    """Against the engine itself without blocks."""
    model = measurement("AC", (-45.0, 45.0))
    a, b, difference = race(solving(model), solving(whole_matrix(model)), (10, 3))
    return Row("the same at 2 tilts, and as one matrix", a, b, b / a, difference)


def whole(model: Model) -> Iterator[Row]:
    """The whole adjustment, what is said of it, trials about it; nothing to compare with."""
    moments = [time.process_time()]

    def row(name: str) -> Row:
        moments.append(time.process_time())
        return Row(name, moments[-1] - moments[-2], None, None, None)

    found = adjust(model)
    yield row("whole adjustment")
    assert found.verdict == "ok"
    found.protections()
    yield row("its verdict and protections")
    found.trials(np.random.default_rng(1), TRIALS)
    yield row(f"{TRIALS} trials")


def rows() -> Iterator[Row]:
    """Run everything, one row after the other."""
    yield one_fit()
    yield by_blocks()
    yield from whole(measurement())


if __name__ == "__main__":
    print(json.dumps([asdict(row) for row in rows()], indent=1))
