"""How often the stated intervals hold the truth when the circle of the stations is stated.

    python research/circle_coverage.py [RUNS] [--each LENGTHS]
    python research/circle_coverage.py [RUNS] --error-motion

Simulated runs with an own generator: a tracer 65 mm off the axis of a table with deviations of a
few arcsec, 24 targets low around it, of which every station sees a few, all lengths from one zero
or a zero per station; lengths with 0.2 um, the machine with 1 um. The stations leave their circle
by 0.07 um radially and axially, which is what is stated; in the last cases they go round a rosette
of 1.5 um, which was not stated. Of each case: how many of the 95 % intervals of ECC hold the
truth, and how often the verdict was ok. With --error-motion nothing is stated of the circle, and
the stations leave it by an error motion along x and y that the solver has to estimate: coverage by
its size. Figures of it are in docs/evidence.md.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.components import HALF_OF_95_PERCENT
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.methods.tracer.solver import TracerProblem, solve

LENGTH_STD, TARGET_STD, CIRCLE_STD = 0.2e-6, 1e-6, 0.07e-6
ROSETTE = 1.5e-6
RADIUS, HEIGHT = 0.065, 0.12
POSITIONS, TARGETS = 11, 24


@dataclass(frozen=True)
class Case:
    """What is simulated: ``along`` says that stations are off along the circle as well.

    ``rosette`` (m): radial amplitude, twice round the circle.
    """

    name: str
    one_zero: bool = True
    along: bool = False
    rosette: float = 0.0


CASES = (
    Case("one zero, table round"),
    Case("one zero, error motion along the circle too", along=True),
    Case("zero per station, table round", one_zero=False),
    Case("one zero, rosette of 1.5 um", rosette=ROSETTE),
)


def low_targets() -> Floats:
    """Return the targets (n, 3), m, the same in every run."""
    rng = np.random.default_rng(99)
    angle, radius = rng.uniform(0.0, 2.0 * np.pi, TARGETS), rng.uniform(0.3, 0.6, TARGETS)
    flat = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
    return np.column_stack([flat, rng.uniform(0.17, 0.8, TARGETS)])


def measured(case: Case, each: int, seed: int) -> tuple[TracerProblem, Floats]:
    """Return the problem of one run with ``each`` lengths per station, and the truth (m,), rad."""
    rng, m = np.random.default_rng([seed, CASES.index(case)]), POSITIONS
    angles = np.linspace(0.0, 2.0 * np.pi, m, endpoint=False)
    deviation = 5.0 * ARCSEC * (np.sin(angles) + 0.5 * (np.cos(3.0 * angles) - 1.0))
    turned = angles + deviation
    outward = np.column_stack([np.cos(turned), np.sin(turned), 0.0 * turned])
    along = np.column_stack([-np.sin(turned), np.cos(turned), 0.0 * turned])
    off = CIRCLE_STD * rng.standard_normal((m, 3)) * [1.0, float(case.along), 1.0]
    off[:, 0] += case.rosette * np.cos(2.0 * turned)
    stations = (RADIUS + off[:, :1]) * outward + off[:, 1:2] * along
    stations[:, 2] += HEIGHT + off[:, 2]
    targets = low_targets()
    seen = targets + TARGET_STD * rng.standard_normal(targets.shape)
    position = np.repeat(np.arange(m), each)
    target = np.concatenate([np.sort(rng.permutation(TARGETS)[:each]) for _ in range(m)])
    length = np.linalg.norm(stations[position] - seen[target], axis=1) - 0.5
    length += LENGTH_STD * rng.standard_normal(len(length))
    return TracerProblem(
        position, target, length, LENGTH_STD, targets, TARGET_STD, angles,
        error_motion_std=None if case.along else 0.0,
        circle_std=CIRCLE_STD,
        segment=np.zeros_like(position) if case.one_zero else None,
        slip=0.0,
    ), deviation  # fmt: skip


def row(case: Case, runs: int, each: int) -> str:
    """Return the line of one case."""
    hits, spread, expanded, good = [], [], [], 0
    for seed in range(runs):
        problem, truth = measured(case, each, seed)
        result = solve(problem)
        std = result.std["ECC"][1:]
        error = (result.deviations["ECC"] - truth)[1:]
        hits.append(np.mean(np.abs(error) <= HALF_OF_95_PERCENT * std))
        spread.append(np.sqrt(np.mean(error**2)) / ARCSEC)
        expanded.append(2.0 * np.sqrt(np.mean(std**2)) / ARCSEC)
        good += result.verdict == "ok"
    return (
        f"| {each} | {case.name} | {100 * np.mean(hits):.1f} % | {np.mean(spread):.2f} "
        f"| {np.mean(expanded):.2f} | {100 * good / runs:.0f} % |"
    )


SIZES = (0.0, 0.05e-6, 0.1e-6, 0.2e-6, 0.3e-6, 1e-6, 3e-6)
"""Error motions (m, k = 1) that were not stated."""
LAYOUTS = {
    "11 angles of 12, 20 low targets": (11, 12, 20, False),
    "12 angles, 20 low targets": (12, 12, 20, False),
    "24 angles, 20 low targets": (24, 24, 20, False),
    "36 angles, 12 low targets": (36, 36, 12, False),
    "11 angles of 12, 64 in the paper's block": (11, 12, 64, True),
}
"""Table positions of how many in a turn, targets, and whether these lie in the paper's block."""
ORDERS: dict[str, tuple[int, ...]] = {
    "white": (), "orders 2 to 4": (2, 3, 4), "orders 2 to 10": tuple(range(2, 11)),
}  # fmt: skip
"""What the error motions consist of, each order alike."""


def moved(rng: np.random.Generator, angles: Floats, orders: tuple[int, ...]) -> Floats:
    """Return an error motion (m, 2) of size 1."""
    if not orders:
        return rng.standard_normal((len(angles), 2))
    phase = np.outer(angles, orders)
    waves = np.concatenate([np.cos(phase), np.sin(phase)], axis=1) / np.sqrt(len(orders))
    return np.asarray(waves @ rng.standard_normal((2 * len(orders), 2)))


def unstated(
    layout: tuple[int, int, int, bool], size: float, seed: int, orders: tuple[int, ...]
) -> TracerProblem:
    """Return the problem of a perfect table with an error motion of ``size`` (m) in ``orders``."""
    m, turn, n, block = layout
    rng, fixed = np.random.default_rng([seed, 7]), np.random.default_rng(99)
    angles = 2.0 * np.pi * np.arange(m) / turn
    stations = np.column_stack(
        [RADIUS * np.cos(angles), RADIUS * np.sin(angles), np.full(m, HEIGHT)]
    )
    stations[:, :2] += size * moved(rng, angles, orders)
    around, far = fixed.uniform(0.0, 2.0 * np.pi, n), fixed.uniform(0.3, 0.6, n)
    height = fixed.uniform(0.17, 0.8, n)
    targets = np.column_stack([far * np.cos(around), far * np.sin(around), height])
    if block:
        targets = fixed.uniform([-0.225, -0.3, 0.5], [0.225, 0.3, 0.95], size=(n, 3))
    seen = targets + TARGET_STD * rng.standard_normal(targets.shape)
    position, target = np.divmod(np.arange(m * n), n)
    length = np.linalg.norm(stations[position] - seen[target], axis=1) - 0.3
    length += LENGTH_STD * rng.standard_normal(len(length))
    return TracerProblem(position, target, length, LENGTH_STD, targets, TARGET_STD, angles)


def unstated_row(name: str, kind: str, runs: int) -> str:
    """Return the line of one layout: coverage of its 95 % intervals for each of the sizes."""
    shares = []
    for size in SIZES:
        hits = []
        for seed in range(runs):
            result = solve(unstated(LAYOUTS[name], size, seed, ORDERS[kind]))
            std = result.std["ECC"][1:]
            hits.append(np.mean(np.abs(result.deviations["ECC"][1:]) <= HALF_OF_95_PERCENT * std))
        shares.append(f"{100 * np.mean(hits):.1f} %")
    return f"| {name} | {kind} | {' | '.join(shares)} |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("runs", nargs="?", type=int, default=1000)
    parser.add_argument("--each", type=int, action="append")
    parser.add_argument("--error-motion", action="store_true", help="none is stated")
    given = parser.parse_args()
    if given.error_motion:
        print(f"| error motion/um | | {' | '.join(f'{size * 1e6:g}' for size in SIZES)} |")
        print(f"|{' --- |' * (2 + len(SIZES))}")
        for name in LAYOUTS:
            for kind in ORDERS:
                print(unstated_row(name, kind, given.runs), flush=True)
        return
    print("| lengths per station | case | coverage | error/arcsec | U/arcsec | ok |")
    print("| --- | --- | --- | --- | --- | --- |")
    for each in given.each or [6]:
        for case in CASES:
            print(row(case, given.runs, each), flush=True)


if __name__ == "__main__":
    main()
