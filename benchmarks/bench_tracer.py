"""Tracer solvers against scipy's Levenberg-Marquardt with analytic Jacobians, side by side.

``rows()`` yields one measurement each. Both sides run alternately; the least processor time of
each counts. Beside scipy's own the opponents are the strongest that are known: for the stations a
batched Gauss-Newton, also compiled by JAX, for the network a few lines of Gauss-Newton with a
sparse Jacobian, and Ceres; JAX and Ceres where they are installed (extra ``peers``).
"""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import json
import time
from collections.abc import Iterator
from dataclasses import asdict
from functools import partial
from importlib.util import find_spec

import numpy as np
from racing import Row, race
from scipy_tracer import DenseNetwork, SparseNetwork, locate_station, locate_stations_batched

from rotcal_ros.adjust.fit import fit_model
from rotcal_ros.methods.tracer.solver import TracerProblem, solve
from rotcal_ros.methods.tracer.solver.posed import AssumedParameters, PosedProblem
from rotcal_ros.methods.tracer.solver.problem import arrange_grid
from rotcal_ros.methods.tracer.solver.start import find_start
from rotcal_ros.methods.tracer.solver.station_by_station import locate_stations

LENGTH_STD, TARGET_STD = 2e-7, 1e-6


def problem(m: int, n: int, step_deg: float, **options: object) -> TracerProblem:
    """The paper's geometry: n targets in 450 x 600 x 450 mm, m stations on a 65 mm circle."""
    rng = np.random.default_rng(1)
    angles = np.radians(-145.0 + step_deg * np.arange(m))
    stations = np.column_stack([0.065 * np.cos(angles), 0.065 * np.sin(angles), 0.12 + 0 * angles])
    targets = rng.uniform([-0.225, -0.3, 0.5], [0.225, 0.3, 0.95], size=(n, 3))
    true_targets = targets + rng.normal(scale=TARGET_STD, size=(n, 3))
    distance = np.linalg.norm(stations[:, None] - true_targets, axis=2)
    length = distance - distance[:, :1] + rng.normal(scale=LENGTH_STD, size=(m, n))
    station, target = np.divmod(np.arange(m * n), n)
    return TracerProblem(
        station, target, length.ravel(), LENGTH_STD, targets, TARGET_STD, angles, **options
    )


def station_by_station(same_start: bool, m: int = 11, n: int = 64) -> Iterator[Row]:
    """All stations; others start at the paper's start values, ours there too or without any."""
    grid, _ = arrange_grid(problem(m, n, 30.0))
    start = np.array([-0.0649938, -0.0066256, 0.1225133, 0.0])
    start[3] = np.linalg.norm(start[:3] - grid.targets[0])
    everywhere = np.tile(start, (m, 1))

    def ours() -> np.ndarray:
        begin = everywhere if same_start else find_start(grid, None)[0]
        return locate_stations(grid.targets, grid.length, grid.weights, begin)[0]

    def opponent() -> np.ndarray:
        return np.array([locate_station(grid.targets, row, start) for row in grid.length])

    def batched() -> np.ndarray:
        return locate_stations_batched(grid.targets, grid.length, start)

    name = "same start" if same_start else "no start values"
    opponents = [("scipy lm", opponent, 40), ("batched", batched, 400)]
    if find_spec("jax") is not None:
        from jax_tracer import locate_stations_jax

        compiled = partial(locate_stations_jax, grid.targets, grid.length, start)
        opponents.append(("JAX", compiled, 400))
    for label, other, repeats in opponents:
        a, b, difference = race(ours, other, (400, repeats))
        yield Row(f"stations {m} x {n}, {name}, {label}", a, b, b / a, difference)


def joint(datum: str, m: int = 6, n: int = 108) -> Iterator[Row]:
    """Stations, distances and targets together, both from the station by station solution."""
    # an error motion of 10 mm says nothing of where stations are
    task = problem(m, n, 60.0, variant="joint", datum=datum, error_motion_std=1e-2)
    grid, absent = arrange_grid(task)
    begin = find_start(grid, None)[0]
    begin = locate_stations(grid.targets, grid.length, grid.weights, begin)[0]
    flat = np.concatenate([begin.ravel(), grid.targets.ravel()])
    posed = PosedProblem.at(task, grid, absent, begin)
    model, lengths = posed.model(AssumedParameters()), posed.lengths
    every, first = np.ones(model.size[0], dtype=np.bool_), lengths.first

    def ours() -> np.ndarray:
        x = fit_model(model, every, model.std, model.first).x
        zeros = lengths.zeros + x[first["zero"] : first["target"]]
        targets = grid.targets.ravel() + x[first["target"] : first["frame"]]
        return np.append(np.column_stack([lengths.standing(x), zeros]).ravel(), targets)

    stations = ours()[: 4 * m].reshape(m, 4)[:, :3]
    radius = np.sqrt(((stations - stations.mean(axis=0)) ** 2).sum() / m)
    target_std = TARGET_STD if datum == "prior" else None
    data = (grid.targets, grid.length, LENGTH_STD, target_std, float(radius))
    dense, sparse = DenseNetwork(*data), SparseNetwork(*data)
    opponents = [
        ("dense lm", dense.solve, 3),
        ("sparse Gauss-Newton", sparse.gauss_newton, 15),
    ]
    if target_std is not None:  # on the stiff rows of a free datum lsmr takes minutes
        opponents.append(("sparse trf lsmr", sparse.solve, 2))
    if target_std is not None and find_spec("pyceres") is not None:
        from ceres_tracer import solve_network

        opponents.append(("Ceres", partial(solve_network, *data[:4]), 5))
    for label, opponent, repeats in opponents:
        a, b, difference = race(ours, lambda solve=opponent: solve(flat), (30, repeats))
        yield Row(f"joint {m} x {n}, {datum}, {label}", a, b, b / a, difference)


def whole(variant: str, datum: str, m: int = 72, n: int = 500) -> Row:
    """From the rows to the result: screening, covariance and verdict included."""
    task = problem(m, n, 5.0, variant=variant, datum=datum)
    best = np.inf
    for _ in range(3):
        start = time.process_time()
        solve(task)
        best = min(best, time.process_time() - start)
    name = variant if variant == "station" else f"{variant}, {datum}"
    return Row(f"solve() {m} x {n}, {name}", best, None, None, None)


def rows() -> Iterator[Row]:
    """Run everything, one row after the other."""
    yield from station_by_station(same_start=False)
    yield from station_by_station(same_start=True)
    yield from joint("prior")
    yield from joint("free")
    yield whole("station", "prior")
    yield whole("joint", "prior")
    yield whole("joint", "free")


if __name__ == "__main__":
    print(json.dumps([asdict(row) for row in rows()], indent=1))
