"""How often the stated intervals hold the truth when the tracer's zero is shared, breaks or slips.

    python research/zero_coverage.py [RUNS] [--plan NAME] [--case NAME]

Simulated runs with an own generator: a table with deviations of a few arcsec, a tracer 65 mm off
its axis; targets low around it, in the paper's block above it, each measured from everywhere, or a
plan of few lengths as `rotcal plan tracer` makes them; lengths with 0.2 um, the machine with 1 um.
Of each case: how many of the 95 % intervals of ECC hold the truth, how often a jump was found, and
how often the verdict was ok. Figures of it are in docs/evidence.md.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache

import numpy as np

from rotcal_design.settings import TracerDesignSettings
from rotcal_design.tracer.ordering import ordered_design
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.methods.tracer.solver import TracerProblem
from rotcal_ros.methods.tracer.solver.solution import adjust

LENGTH_STD, TARGET_STD = 0.2e-6, 1e-6
FRINGE = 632.8e-9 / 2
WALK_STD = 0.02e-6
CASES = ("a zero per station", "one segment", "three breaks", "slip of a fringe", "wandering zero")
ORDERS = ("stations per target", "targets per station")
PLANS = ("low", "block", "fewest", "110 lengths")
MOUNT = np.array([0.065, 0.0, 0.12])
FALSE_ALARM = 0.01


@dataclass(frozen=True, eq=False)
class Places:
    """Table angles (m,), targets (n, 3), and which pairs (k,) of them are measured."""

    angles: Floats
    targets: Floats
    position: Ints
    target: Ints


@cache
def places(plan: str, m: int, n: int) -> Places:
    """Return what is measured, the same in every run."""
    rng = np.random.default_rng(99)
    if plan == "fewest":
        goal = TracerDesignSettings(
            zero="one", circle_std_m=7e-8, need_arcsec=1.202, error_motion_std_m=0.0
        )
        few = ordered_design(goal)
        scene, lengths = few.design.scene, few.lengths
        return Places(scene.table_angles, scene.targets, lengths.position, lengths.target)
    if plan == "110 lengths":
        m, n = 11, 24
    angles = np.linspace(0.0, 2.0 * np.pi, m, endpoint=False)
    position, target = np.divmod(np.arange(m * n), n)
    if plan == "block":
        targets = rng.uniform([-0.225, -0.3, 0.5], [0.225, 0.3, 0.95], size=(n, 3))
        return Places(angles, targets, position, target)
    around, radius = rng.uniform(0.0, 2.0 * np.pi, n), rng.uniform(0.3, 0.6, n)
    flat = np.column_stack([radius * np.cos(around), radius * np.sin(around)])
    targets = np.column_stack([flat, rng.uniform(0.0, 0.6, n)])
    if plan == "110 lengths":
        kept = np.concatenate([n * j + np.sort(rng.permutation(n)[:10]) for j in range(m)])
        position, target = position[kept], target[kept]
    return Places(angles, targets, position, target)


def zero_of(case: str, count: int, rng: np.random.Generator) -> tuple[Floats, Ints]:
    """Return zeros (m) and segments of ``count`` lengths in the order of measuring."""
    zero, segment = np.full(count, 0.5), np.zeros(count, dtype=np.int64)
    if case == "three breaks":
        segment = np.searchsorted(np.sort(rng.integers(1, count, 3)), np.arange(count), "right")
        zero = zero + 1e-3 * rng.standard_normal(4)[segment]
    elif case == "slip of a fringe":
        zero[rng.integers(1, count) :] += FRINGE * rng.choice([-1.0, 1.0])
    elif case == "wandering zero":
        zero = zero + np.cumsum(WALK_STD * rng.standard_normal(count))
    return zero, segment


def measured(case: str, order: str, where: Places, seed: int) -> tuple[TracerProblem, Floats]:
    """Return the problem of one run, and its true deviations (m,) in rad."""
    rng = np.random.default_rng([seed, CASES.index(case), ORDERS.index(order)])
    angles, position, target = where.angles, where.position, where.target
    shape = np.sin(angles) + 0.5 * np.cos(3.0 * angles)
    deviation = 5.0 * ARCSEC * (shape - shape[0])
    cos, sin = np.cos(angles + deviation), np.sin(angles + deviation)
    stations = np.column_stack([MOUNT[0] * cos, MOUNT[0] * sin, MOUNT[2] + 0.0 * cos])
    seen = where.targets + TARGET_STD * rng.standard_normal(where.targets.shape)
    keys = (position, target) if order == ORDERS[0] else (target, position)
    rank = np.lexsort(keys).argsort()
    zero, segment = zero_of(case, len(rank), rng)
    length = np.linalg.norm(stations[position] - seen[target], axis=1) - zero[rank]
    length += LENGTH_STD * rng.standard_normal(len(rank))
    return TracerProblem(
        position, target, length, np.full(len(rank), LENGTH_STD), where.targets,
        np.full(where.targets.shape, TARGET_STD), angles,
        error_motion_std=0.0,
        order=rank,
        segment=None if case == CASES[0] else segment[rank],
        zero_walk_std=WALK_STD if case == "wandering zero" else 0.0,
    ), deviation  # fmt: skip


def row(runs: int, case: str, order: str, where: Places) -> str:
    """Return the figures of one case."""
    hits, spread, found, good = [], [], 0, 0
    for seed in range(runs):
        problem, truth = measured(case, order, where, seed)
        solution = adjust(problem)
        std, error = solution.std, solution.deviations - truth
        hits.append(np.mean(np.abs(error)[1:] <= 1.96 * std[1:]))
        spread.append(np.sqrt(np.mean(error[1:] ** 2)) / ARCSEC)
        found += any(e.effect.effect == "slip" for e in solution.found.found_effects)
        good += solution.found.verdict == "ok"
    return (
        f"{100 * np.mean(hits):.1f} % | {np.mean(spread):.2f} "
        f"| {100 * found / runs:.0f} % | {100 * good / runs:.0f} %"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("runs", nargs="?", type=int, default=1000)
    parser.add_argument("--positions", type=int, default=11)
    parser.add_argument("--targets", type=int, default=64)
    parser.add_argument("--plan", action="append", choices=PLANS)
    parser.add_argument("--case", action="append", choices=CASES)
    given = parser.parse_args()
    for line in table(given):
        print(line, flush=True)


def table(given: argparse.Namespace) -> Iterator[str]:
    """Yield the lines of the table that was asked for."""
    both = [(plan, order) for plan in given.plan or PLANS for order in ORDERS]
    yield "| plan | order | zero | coverage | error/arcsec | jump found | ok |"
    yield "| --- | --- | --- | --- | --- | --- | --- |"
    for plan, order in both:
        for case in given.case or CASES:
            where = places(plan, given.positions, given.targets)
            yield f"| {plan} | {order} | {case} | {row(given.runs, case, order, where)} |"


if __name__ == "__main__":
    main()
