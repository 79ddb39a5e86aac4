"""Ball plate against its opponents, side by side in one run, one thread each.

Every function returns rows (name, ours_s, opponent_s, ratio, difference): seconds of one call,
opponent / ours, and the largest relative difference between the two results. Run alone with
``OMP_NUM_THREADS=1 python benchmarks/bench_ball_plate.py``.
"""

from __future__ import annotations

import time
import tracemalloc
from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from dense_ball_plate import DenseSolution, solve_dense
from scipy.optimize import least_squares

from rotcal_design.ball_plate.ball_layout import mean_variances, plan_plate
from rotcal_ros.adjust.kernels import ConstrainedKernel
from rotcal_ros.adjust.outputs import Outputs
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.geometry.sphere import fit_spheres
from rotcal_ros.methods.ball_plate.solver.layout import PlateLayout
from rotcal_ros.methods.ball_plate.solver.problem import BallPlateProblem

PLATE = (0, 8, 12, 18, 21, 28, 32, 37, 42, 50, 58, 62)
RADIUS = 0.185


@dataclass(frozen=True)
class Row:
    """One line of the table; ``difference`` is relative, NaN where there is nothing to compare."""

    name: str
    ours_s: float
    opponent_s: float
    ratio: float
    difference: float


def best_time(call: Callable[[], Any], repeats: int) -> float:
    """Seconds of the fastest of some calls: what the machine can do when left alone."""
    times = []
    for _ in range(repeats):
        start = time.process_time()
        call()
        times.append(time.process_time() - start)
    return min(times)


def median_times(
    ours: Callable[[], Any], opponent: Callable[[], Any], rounds: int = 9, calls: int = 60
) -> tuple[float, float]:
    """Median processor seconds of both, taken in turn: other work does not count."""
    times: tuple[list[float], list[float]] = ([], [])
    for _ in range(rounds):
        for call, repeats, found in ((ours, calls, times[0]), (opponent, 1, times[1])):
            for _ in range(repeats):
                start = time.process_time()
                call()
                found.append(time.process_time() - start)
    return float(np.median(times[0])), float(np.median(times[1]))


def measurement(grid: int, balls: tuple[int, ...], seed: int = 0) -> BallPlateProblem:
    """Centres scattered by 1 um about their places."""
    ball = np.repeat(balls, grid)
    table = np.tile(np.arange(grid), len(balls))
    angle = 2.0 * np.pi * ((table + ball) % grid) / grid
    nominal = RADIUS * np.column_stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)])
    scatter = 1e-6 * np.random.default_rng(seed).normal(size=nominal.shape)
    return BallPlateProblem(grid, RADIUS, table, ball, nominal + scatter)


def by_orders(problem: BallPlateProblem) -> tuple[Floats, Floats]:
    """Return the six deviations (6 M,) of the linear model, and their unit standard deviations."""
    layout = PlateLayout(problem)
    circles = layout.circular
    kernel = None if circles is None else circles.kernel()
    assert kernel is not None
    defined = ConstrainedKernel.of(kernel, layout.definitions)
    outputs = Outputs.alone(layout.curves())
    read = (layout.radial @ problem.deviations[layout.row][:, :, None]).ravel()
    return outputs.times(defined.solve(read)), np.sqrt(defined.variances_of(outputs))


def _difference(dense: DenseSolution, ours: tuple[Floats, Floats]) -> float:
    worst = 0.0
    for of, found in zip((dense.component, dense.std), ours, strict=True):
        every = np.array([of(name) for name in COMPONENTS])
        apart = np.abs(found.reshape(every.shape) - every).max(axis=1)
        worst = max(worst, float((apart / np.abs(every).max(axis=1)).max()))
    return worst


def bench_solve() -> list[Row]:
    """Deviations and standard deviations: order by order against the dense form."""
    paper = measurement(72, PLATE)
    ours_s, dense_s = median_times(lambda: by_orders(paper), lambda: solve_dense(paper), calls=9)
    difference = _difference(solve_dense(paper), by_orders(paper))
    fine = measurement(3600, tuple(50 * step + step % 7 for step in PLATE))
    fine_s = best_time(lambda: by_orders(fine), 5)
    return [
        Row("solve N=72 R=12, dense", ours_s, dense_s, dense_s / ours_s, difference),
        Row("solve N=3600 R=12, dense at N=72", fine_s, dense_s, dense_s / fine_s, float("nan")),
    ]


def peak_memory() -> float:
    """Largest memory in bytes that a solution with N = 3600 takes on top."""
    fine = measurement(3600, tuple(50 * step + step % 7 for step in PLATE))
    tracemalloc.start()
    by_orders(fine)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return float(peak)


def bench_layouts() -> list[Row]:
    """924 six-ball subsets ranked, against one dense solution each."""
    layouts = np.array(list(combinations(PLATE, 6)), dtype=np.int64)
    ours_s = best_time(lambda: mean_variances(72, layouts), 10)
    variances = mean_variances(72, layouts)
    separable = np.flatnonzero(np.isfinite(variances[:, 0]))  # of the others no variance exists
    chosen = separable[:: len(separable) // 3]
    checked = layouts[chosen]
    start = time.process_time()
    dense = [solve_dense(measurement(72, tuple(layout.tolist()))) for layout in checked]
    dense_s = (time.process_time() - start) / len(checked) * len(layouts)
    found = [np.mean(s.std("ECC") ** 2) * RADIUS**2 for s in dense]
    ranked = variances[chosen, 0]
    difference = float(np.abs(np.array(found) / ranked - 1.0).max())
    return [
        Row("rank 924 six-ball subsets, dense each", ours_s, dense_s, dense_s / ours_s, difference)
    ]


def layouts_per_second() -> float:
    """Layouts per second of an exhaustive search (4 of 60 steps and up to symmetry)."""
    start = time.process_time()
    found = plan_plate(60, 5)
    return found.evaluated / (time.process_time() - start)


def bench_spheres(n_balls: int = 864, n_opponent: int = 60) -> list[Row]:
    """Sphere fits of 15 touches: all at once, against scipy ball by ball."""
    rng = np.random.default_rng(1)
    height = (np.arange(15) + 0.5) / 15
    around, flat = 2.399963 * np.arange(15), np.sqrt(1.0 - height**2)
    direction = np.column_stack([flat * np.cos(around), flat * np.sin(around), height])
    centres = 0.2 * rng.normal(size=(n_balls, 3))
    points = centres[:, None] + 0.014 * direction + 1e-7 * rng.normal(size=(n_balls, 15, 3))
    rows = []
    for name, radius in (("known radius", 0.0125), ("free radius", None)):
        ours_s = best_time(lambda r=radius: fit_spheres(points, radius=r, tip_radius=0.0015), 5)
        ours_s /= n_balls
        ours = fit_spheres(points, radius=radius, tip_radius=0.0015, reject=False)
        start = time.process_time()
        theirs = np.array([_scipy_sphere(cloud, radius) for cloud in points[:n_opponent]])
        theirs_s = (time.process_time() - start) / n_opponent
        difference = float(np.abs(theirs - ours.centres[:n_opponent]).max() / 0.014)
        label = f"sphere fit, {name}, scipy per ball"
        rows.append(Row(label, ours_s, theirs_s, theirs_s / ours_s, difference))
    return rows


def _scipy_sphere(cloud: np.ndarray, radius: float | None) -> np.ndarray:
    start = np.r_[cloud.mean(axis=0) - [0.0, 0.0, 0.007], [] if radius else [0.014]]

    def distance(x: np.ndarray) -> np.ndarray:
        size = 0.014 if radius else x[3]
        return np.linalg.norm(cloud - x[:3], axis=1) - size

    return least_squares(distance, start, method="lm").x[:3]


def rows() -> list[Row]:
    """Return all rows."""
    return bench_solve() + bench_layouts() + bench_spheres()


def main() -> None:
    """Print the table."""
    print(f"{'':44s} {'ours':>10s} {'opponent':>10s} {'ratio':>8s} {'difference':>11s}")
    for row in rows():
        print(
            f"{row.name:44s} {row.ours_s * 1e3:8.3f}ms {row.opponent_s * 1e3:8.1f}ms "
            f"{row.ratio:8.1f} {row.difference:11.1e}"
        )
    print(f"layouts per second: {layouts_per_second():.0f}")
    print(f"peak memory of the solution at N = 3600: {peak_memory() / 1e6:.0f} MB")


if __name__ == "__main__":
    main()
