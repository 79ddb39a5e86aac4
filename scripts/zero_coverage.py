"""How often the stated intervals hold the truth when the tracer's zero is shared, breaks or slips.

    python scripts/zero_coverage.py [RUNS] [--plan NAME] [--case NAME]
    python scripts/zero_coverage.py --best          # what the best test of slips could find

Simulated runs with an own generator: a table with deviations of a few arcsec, a tracer 65 mm off
its axis; targets low around it, in the paper's block above it, each measured from everywhere, or a
plan of few lengths as `rotcal plan tracer` makes them; lengths with 0.2 um, the machine with 1 um.
Of each case: how many of the 95 % intervals of ECC hold the truth, how often a jump was found, and
how often the verdict was ok. Figures of it are in docs/evidence_methods.md.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy import logaddexp
from scipy.special import logsumexp

from rotcal_ros.extensions.design.settings import TracerDesignSettings
from rotcal_ros.extensions.design.tracer.ordering import ordered_design
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.methods.tracer.solver import TracerProblem
from rotcal_ros.methods.tracer.solver.circle import bearing_slopes
from rotcal_ros.methods.tracer.solver.network import NetworkGain
from rotcal_ros.methods.tracer.solver.solution import TracerSolution, adjust
from rotcal_ros.methods.tracer.solver.verdict import judge
from rotcal_ros.methods.tracer.solver.zeros import Shifts, shift_search

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
        verdict, _ = judge(solution.evidence, problem.settings)
        std, error = solution.angles.std, solution.motion.cumulative - truth
        hits.append(np.mean(np.abs(error)[1:] <= 1.96 * std[1:]))
        spread.append(np.sqrt(np.mean(error[1:] ** 2)) / ARCSEC)
        found += bool(solution.evidence.jumps)
        good += verdict == "ok"
    return (
        f"{100 * np.mean(hits):.1f} % | {np.mean(spread):.2f} "
        f"| {100 * found / runs:.0f} % | {100 * good / runs:.0f} %"
    )


def best(order: str, where: Places, runs: int) -> str:
    """Return how many slips of a fringe, at any moment, two tests find at FALSE_ALARM.

    The largest score of any size, as the solver does, and the mean of the likelihood ratios of all
    slips of a fringe: no test finds more of them (Neyman and Pearson). Their scores are drawn.
    """
    solution = adjust(measured(CASES[1], order, where, 0)[0])
    search = shift_search(solution.grid, solution.fit, solution.problem.measuring_order)
    shifts = search.at(np.flatnonzero(search.moments.side > 0))
    apart = FRINGE * np.sqrt(shifts.information)
    alike = correlation(solution, shifts)
    values, axes = np.linalg.eigh(alike)
    root = axes * np.sqrt(np.maximum(values, 0.0))
    rng = np.random.default_rng(0)
    none = rng.standard_normal((runs, len(apart))) @ root.T
    at = rng.integers(0, len(apart), runs)
    slipped = rng.standard_normal((runs, len(apart))) @ root.T + apart[at, None] * alike[at]

    def free(score: Floats) -> Floats:
        return np.asarray(np.abs(score[:, shifts.enough]).max(axis=1))

    def known(score: Floats) -> Floats:
        ratio = logaddexp(score * apart, -score * apart) - 0.5 * apart**2
        return np.asarray(logsumexp(ratio, axis=1))

    power = [
        float(np.mean(test(slipped) > np.quantile(test(none), 1.0 - FALSE_ALARM)))
        for test in (free, known)
    ]
    felt = np.abs(FRINGE * shifts.moved @ bearing_of(solution).T)[:, 1:]
    return (
        f"{np.median(apart):.1f} | {100 * power[0]:.0f} % | {100 * power[1]:.0f} % "
        f"| {np.median((felt / solution.angles.std[1:]).max(axis=1)):.2f} "
        f"| {(felt / solution.angles.std[1:]).max():.2f}"
    )


def correlation(solution: TracerSolution, shifts: Shifts) -> Floats:
    """Return the correlations (t, t) of the scores of all shifts."""
    grid, network = solution.grid, solution.fit.network
    assert network is not None
    later = shifts.moments.later(grid, shifts.at)
    pull = network.weights * later
    by_strip = np.einsum("tpi,pia->tpa", pull, network.rows)
    by_target = -np.einsum("tpi,pia->tia", pull, network.rows[:, :, :3])
    x, y = NetworkGain.of(network).step(by_strip, by_target)
    count = len(later)
    shared = pull.reshape(count, -1) @ later.reshape(count, -1).T
    shared -= by_strip.reshape(count, -1) @ x.reshape(count, -1).T
    shared -= by_target.reshape(count, -1) @ y.reshape(count, -1).T
    size = np.sqrt(shared.diagonal())
    return np.asarray(0.5 * (shared + shared.T) / size / size[:, None], dtype=np.float64)


def bearing_of(solution: TracerSolution) -> Floats:
    """Return what moves of the stations (3 m) do to the deviations (m,), rad/m."""
    return bearing_slopes(solution.fit.stations, solution.motion).from_first.dense()


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("runs", nargs="?", type=int, default=1000)
    parser.add_argument("--positions", type=int, default=11)
    parser.add_argument("--targets", type=int, default=64)
    parser.add_argument("--plan", action="append", choices=PLANS)
    parser.add_argument("--case", action="append", choices=CASES)
    parser.add_argument("--best", action="store_true", help="what tests of slips can find")
    given = parser.parse_args()
    for line in table(given):
        print(line, flush=True)


def table(given: argparse.Namespace) -> Iterator[str]:
    """Yield the lines of the table that was asked for."""
    both = [(plan, order) for plan in given.plan or PLANS for order in ORDERS]
    if given.best:
        yield "| plan | order | median d | any size | best test | median effect | largest |"
        yield "| --- | --- | --- | --- | --- | --- | --- |"
        for plan, order in both:
            where = places(plan, given.positions, given.targets)
            yield f"| {plan} | {order} | {best(order, where, 20 * given.runs)} |"
        return
    yield "| plan | order | zero | coverage | error/arcsec | jump found | ok |"
    yield "| --- | --- | --- | --- | --- | --- | --- |"
    for plan, order in both:
        for case in given.case or CASES:
            where = places(plan, given.positions, given.targets)
            yield f"| {plan} | {order} | {case} | {row(given.runs, case, order, where)} |"


if __name__ == "__main__":
    main()
