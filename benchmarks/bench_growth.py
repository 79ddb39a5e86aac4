"""How processor time and memory grow with the size of a problem, from usual to large ones.

Every row is solved in a process of its own, so that the peak is that of this problem, imports
included: ``python benchmarks/run.py growth``, the table of docs/evidence.md.
"""

import multiprocessing
import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import resource
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.sparse import csr_array

from rotcal_ros.adjust.designs import dense
from rotcal_ros.adjust.engine import adjust
from rotcal_ros.adjust.model import linear
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.methods.angle_comparison.model import model_of, readings_of
from rotcal_ros.methods.angle_comparison.settings import (
    ComparisonPlanSettings,
    ComparisonSolverSettings,
)
from rotcal_ros.methods.ball_plate import solver as ball_plate
from rotcal_ros.methods.tracer import solver as tracer

PLATE = (0, 1, 3, 5, 7, 10, 13, 17, 23, 31, 43, 57)
"""Ball steps of a grid of 72."""


@dataclass(frozen=True)
class Row:
    """Processor time of one solution, s; memory at its peak and before it, MB."""

    name: str
    cpu_s: float
    peak_mb: float
    before_mb: float


def full_circle(m: int, n: int, **options: object) -> tracer.TracerProblem:
    """Lengths from m positions to each of n targets, noise 0.2 um, targets known to 1 um."""
    rng = np.random.default_rng(1)
    angles = 2.0 * np.pi * np.arange(m) / m
    targets = rng.uniform(-1.0, 1.0, (n, 3)) * [0.5, 0.5, 0.3] + [0.0, 0.0, 0.5]
    stations = np.column_stack([0.3 * np.cos(angles), 0.3 * np.sin(angles), np.full(m, -0.3)])
    position, target = np.divmod(np.arange(m * n), n)
    length = np.linalg.norm(stations[position] - targets[target], axis=1) + 0.1
    return tracer.TracerProblem(
        position=position,
        target=target,
        length=length + rng.normal(0.0, 2e-7, m * n),
        length_std=2e-7,
        targets=targets + rng.normal(0.0, 1e-6, targets.shape),
        target_std=1e-6,
        table_angles=angles,
        **{"error_motion_std": 0.0, **options},
    )


def plate(grid: int) -> ball_plate.BallPlateProblem:
    """Twelve balls at all positions of a grid, noise 0.2 um."""
    steps = np.array(PLATE) * grid // 72
    steps += np.arange(len(steps)) % 7 if grid > 72 else 0  # nothing in common with the grid
    ball, table = np.repeat(steps, grid), np.tile(np.arange(grid), len(steps))
    angle = 2.0 * np.pi * ((table + ball) % grid) / grid
    nominal = 0.15 * np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle])
    noise = np.random.default_rng(1).normal(0.0, 2e-7, nominal.shape)
    return ball_plate.BallPlateProblem(grid, 0.15, table, ball, nominal + noise)


def two_circles(angles: int, settings: int, whole: bool = False) -> None:
    """Solve a closed circle of so many angles, read in settings one to so many steps apart.

    ``whole``: by the whole matrix, as where the grid is not complete.
    """
    step = 360.0 / angles
    shifts = tuple(step * (k * (k + 1) // 2) for k in range(settings))
    plan = ComparisonPlanSettings(
        table_positions=angles + 1, table_step_deg=step, shifts_deg=shifts
    )
    read = readings_of(plan)
    noise = np.random.default_rng(1).normal(0.0, ARCSEC, len(read.value))
    model = model_of(plan, ComparisonSolverSettings(sigma_arcsec=1.0), replace(read, value=noise))
    if whole:
        design = csr_array(dense(model.equations(model.first)[1]))
        model = replace(model, equations=linear(design))
    found = adjust(model)
    assert found.verdict != "failed"
    assert len(found.protections())


def by_tracer(m: int, n: int, shared: bool, **options: object) -> None:
    """Solve a full circle; ``shared``: one zero for all lengths."""
    segment = {"segment": np.zeros(m * n, dtype=np.int64)} if shared else {}
    tracer.solve(full_circle(m, n, **segment, **options))


def by_plate(grid: int) -> None:
    """Solve a plate."""
    ball_plate.solve(plate(grid))


TRACER = [
    (f"tracer, zero per station, {m} x {n}", partial(by_tracer, m, n, False, variant="joint"))
    for m, n in ((36, 12), (36, 64), (360, 12), (720, 12), (3600, 12))
]
WHOLE = [
    (f"tracer, {name}, {m} x 12", partial(by_tracer, m, 12, shared, variant="joint", **options))
    for name, shared, options in (
        ("one zero", True, {}),
        ("stated circle", False, {"circle_std": 1e-6}),
        ("free network", False, {"datum": "free"}),
    )
    for m in (36, 180)
]
PLATES = [(f"ball plate, {grid} positions, 12 balls", partial(by_plate, grid))
          for grid in (72, 720, 3600)]  # fmt: skip


CIRCLES = [
    (
        f"two circles, {angles} angles, {settings} settings{', whole matrix' * whole}",
        partial(two_circles, angles, settings, whole),
    )
    for angles, settings, whole in (
        (72, 8, False), (72, 8, True), (360, 4, False), (360, 4, True), (360, 12, False),
        (360, 12, True), (720, 4, False), (1440, 4, False), (3600, 12, False),
    )
]  # fmt: skip


def measured(name: str, solve: Callable[[], None]) -> Row:
    """Return the row of one solution, in this process."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    start = time.process_time()
    solve()
    seconds = time.process_time() - start
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return Row(name, seconds, peak / 1024, before / 1024)


def rows() -> Iterator[Row]:
    """Yield one row per problem."""
    with multiprocessing.get_context("spawn").Pool(1, maxtasksperchild=1) as pool:
        for task in (*TRACER, *WHOLE, *PLATES, *CIRCLES):
            yield pool.apply(measured, task)


if __name__ == "__main__":
    for row in rows():
        print(row)
