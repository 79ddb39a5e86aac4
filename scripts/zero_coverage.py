"""How often the stated intervals hold the truth when the tracer's zero is shared, breaks or slips.

    python scripts/zero_coverage.py [RUNS] [--positions M] [--targets N]

Simulated runs with an own generator: a table with deviations of a few arcsec, a tracer 65 mm off
its axis, targets low around it or in the paper's block above it; lengths with 0.2 um, the
machine with 1 um. Of each case: how many of the 95 % intervals of ECC hold the truth, how often a
jump was found, and how often the verdict was ok. Figures of it are in docs/tracer.md.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator

import numpy as np

from rotcal_ros.arrays import Floats, Ints
from rotcal_ros.methods.tracer import TracerProblem, solve
from rotcal_ros.units import ARCSEC

LENGTH_STD, TARGET_STD = 0.2e-6, 1e-6
FRINGE = 632.8e-9 / 2
WALK_STD = 0.02e-6
CASES = ("a zero per station", "one segment", "three breaks", "slip of a fringe", "wandering zero")
ORDERS = ("stations per target", "targets per station")
LAYOUTS = ("low", "block")


def places(layout: str, n: int) -> Floats:
    """Return n targets (n, 3), m, the same in every run."""
    rng = np.random.default_rng(99)
    if layout == "block":
        return rng.uniform([-0.225, -0.3, 0.5], [0.225, 0.3, 0.95], size=(n, 3))
    angle, radius = rng.uniform(0.0, 2.0 * np.pi, n), rng.uniform(0.3, 0.6, n)
    flat = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
    return np.column_stack([flat, rng.uniform(0.0, 0.6, n)])


def zero_of(case: str, count: int, rng: np.random.Generator) -> tuple[Floats, Ints]:
    """Return zeros (m) and segments of ``count`` lengths in the order of measuring."""
    zero, segment = np.full(count, 0.5), np.zeros(count, dtype=np.int64)
    if case == "three breaks":
        segment = np.searchsorted(np.sort(rng.integers(1, count, 3)), np.arange(count), "right")
        zero = zero + 1e-3 * rng.standard_normal(4)[segment]
    elif case == "slip of a fringe":
        zero[rng.integers(1, count) :] += FRINGE
    elif case == "wandering zero":
        zero = zero + np.cumsum(WALK_STD * rng.standard_normal(count))
    return zero, segment


def measured(
    case: str, order: str, layout: str, m: int, n: int, seed: int
) -> tuple[TracerProblem, Floats]:
    """Return the problem of one run, and its true deviations (m,) in rad."""
    rng = np.random.default_rng([seed, CASES.index(case), ORDERS.index(order)])
    angles = np.linspace(0.0, 2.0 * np.pi, m, endpoint=False)
    deviation = 5.0 * ARCSEC * (np.sin(angles) + 0.5 * (np.cos(3.0 * angles) - 1.0))
    turned = angles + deviation
    stations = np.column_stack([0.065 * np.cos(turned), 0.065 * np.sin(turned), 0.12 + 0 * angles])
    targets = places(layout, n)
    seen = targets + TARGET_STD * rng.standard_normal((n, 3))
    position, target = np.divmod(np.arange(m * n), n)
    keys = (position, target) if order == ORDERS[0] else (target, position)
    rank = np.lexsort(keys).argsort()
    zero, segment = zero_of(case, m * n, rng)
    length = np.linalg.norm(stations[position] - seen[target], axis=1) - zero[rank]
    length += LENGTH_STD * rng.standard_normal(m * n)
    return TracerProblem(
        position, target, length, LENGTH_STD, targets, TARGET_STD, angles,
        error_motion_std=0.0,
        order=rank,
        segment=None if case == CASES[0] else segment[rank],
        zero_walk_std=WALK_STD if case == "wandering zero" else 0.0,
    ), deviation  # fmt: skip


def rows(runs: int, m: int, n: int, cases: list[str]) -> Iterator[str]:
    """Yield one line per case."""
    for layout in LAYOUTS:
        for order in ORDERS:
            for case in cases:
                hits, spread, found, good = [], [], 0, 0
                for seed in range(runs):
                    problem, truth = measured(case, order, layout, m, n, seed)
                    result = solve(problem)
                    std = result.std["ECC"]
                    error = result.deviations["ECC"] - truth
                    hits.append(np.mean(np.abs(error)[1:] <= 1.96 * std[1:]))
                    spread.append(np.sqrt(np.mean(error[1:] ** 2)) / ARCSEC)
                    found += any("jumps by" in text for text in result.warnings)
                    good += result.verdict == "ok"
                yield (
                    f"| {layout} | {order} | {case} | {100 * np.mean(hits):.1f} % "
                    f"| {np.mean(spread):.2f} | {100 * found / runs:.0f} % "
                    f"| {100 * good / runs:.0f} % |"
                )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("runs", nargs="?", type=int, default=1000)
    parser.add_argument("--positions", type=int, default=11)
    parser.add_argument("--targets", type=int, default=64)
    parser.add_argument("--case", action="append", choices=CASES)
    given = parser.parse_args()
    print("| targets | order | zero | coverage | error/arcsec | jump found | ok |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for row in rows(given.runs, given.positions, given.targets, given.case or list(CASES)):
        print(row, flush=True)


if __name__ == "__main__":
    main()
