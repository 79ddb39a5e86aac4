"""Plane mirror: the joint solution against scipy; both sides run alternately, the best counts."""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import json
import sys
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path

import numpy as np
from racing import Row, race
from scipy.optimize import least_squares
from scipy.sparse import csr_array
from scipy_plane_mirror import deviations_of, joint_residual

from rotcal_ros.methods.plane_mirror.solver import PlaneMirrorProblem, solve

sys.path.insert(0, str(Path(__file__).parents[1] / "test"))
from mirror_cell import measure, ring_cell


def problem() -> PlaneMirrorProblem:
    """6 stations, 72 positions, 3 reflectors at each, 6 fixed nests; neighbours share one."""
    angles = np.arange(73) * 2.0 * np.pi / 72
    visits = tuple(tuple(range(12 * s, 12 * s + 13)) for s in range(6))
    cell = ring_cell(angles, visits, n_nests=6, reflectors=3)
    deviations = np.zeros((73, 6))
    rng = np.random.default_rng(1)
    deviations[:, 3:] = rng.normal(0.0, 5e-6, (73, 3))
    return measure(cell, deviations, rng=rng)


def joint() -> Row:
    """From the rows to the whole result, against scipy from the same approximate values.

    scipy is given which unknown touches which residual; without that it takes ten times longer.
    """
    task = problem()
    residual, start, n = joint_residual(task)
    pattern = sparsity(residual, start)

    def opponent() -> np.ndarray:
        best = least_squares(residual, start, jac_sparsity=pattern, x_scale="jac",
                             tr_solver="lsmr", xtol=1e-12, ftol=1e-12)  # fmt: skip
        return deviations_of(task, best.x[:n])

    a, b, difference = race(lambda: solve(task).deviations["ECC"], opponent, (20, 2))
    return Row("joint 6 stations x 72 positions x 3", a, b, b / a, difference)


def sparsity(residual: Callable[[np.ndarray], np.ndarray], start: np.ndarray) -> csr_array:
    """Which unknown touches which residual, by trial near the start."""
    rng = np.random.default_rng(2)
    at = start + 1e-3 * rng.normal(size=start.shape)
    base = residual(at)
    columns = []
    for k in range(len(at)):
        at[k] += 1e-3
        columns.append(np.abs(residual(at) - base) > 1e-9)
        at[k] -= 1e-3
    return csr_array(np.array(columns).T)


def rows() -> Iterator[Row]:
    """Run everything, one row after the other."""
    yield joint()


if __name__ == "__main__":
    print(json.dumps([asdict(row) for row in rows()], indent=1))
