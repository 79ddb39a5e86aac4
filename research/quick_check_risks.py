"""Both risks of a quick check by laser tracer, from simulated tables to the verdict.

A plan of the fewest lengths is made for an earlier result; then tables are drawn, measured with
it, solved by the solver and judged. The figures of docs/evidence.md:

    python research/quick_check_risks.py --runs 2000
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np

from rotcal_design.check_plan import CheckPlan, plan_check
from rotcal_ros.evaluation.quick_check import quick_check
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.curves.interpolation import without_harmonics
from rotcal_ros.foundation.curves.measured import MeasuredCurve, measured_curve
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.geometry.rotations import positions_on_table
from rotcal_ros.methods import changed, read_configuration
from rotcal_ros.methods.tracer.solver import TracerProblem, solve
from rotcal_ros.planning.check_rule import CheckRule
from rotcal_ros.recordings.result_sources import read_curve

ROOT = Path(__file__).parents[1]
EARLIER = ROOT / "examples" / "data" / "result_ball_plate.json"
SETUP = ROOT / "config" / "tracer.yaml"

Draw = Callable[[np.random.Generator], Floats]


def measured(plan: CheckPlan, deviation: Floats, rng: np.random.Generator) -> MeasuredCurve:
    """Return the solver's curve of a simulated table that turns by ``deviation`` (m,) rad more."""
    solver = plan.configuration.solver
    mount = plan.configuration.simulation.tracer.mount_m
    stations = positions_on_table(mount, plan.angles + deviation)
    stations[:, :2] += solver.error_motion_std_m * rng.standard_normal((len(stations), 2))
    targets = plan.targets + solver.target_std_m * rng.standard_normal(plan.targets.shape)
    position, target = plan.pairs.T
    apart = stations[position] - targets[target]
    zero = rng.uniform(-1e-3, 1e-3, len(stations))
    noise = solver.length_std_m * rng.standard_normal(len(position))
    problem = TracerProblem(
        position=position,
        target=target,
        length=np.linalg.norm(apart, axis=1) - zero[position] + noise,
        length_std=solver.length_std_m,
        targets=plan.targets,
        target_std=solver.target_std_m,
        table_angles=plan.angles,
        error_motion_std=solver.error_motion_std_m,
        settings=solver,
    )
    return measured_curve(solve(problem))


def shares(
    plan: CheckPlan, earlier: MeasuredCurve, draw: Draw, runs: int, seed: int
) -> Counter[str]:
    """Return how often each verdict came for errors of the earlier curve that ``draw`` gives."""
    rng = np.random.default_rng(seed)
    found: Counter[str] = Counter()
    base = np.interp(plan.angles, earlier.angles, earlier.deviation)
    for _ in range(runs):
        new = measured(plan, base + draw(rng), rng)
        found[quick_check(earlier, new, plan.rule).verdict] += 1
    return found


def aged(plan: CheckPlan, earlier: MeasuredCurve) -> Draw:
    """Return tables that the earlier uncertainty and the stated ageing explain."""
    rows = np.searchsorted(earlier.angles, plan.angles - 1e-9)
    covariance = plan.rule.expected(
        earlier.covariance[np.ix_(rows, rows)], without_harmonics(plan.angles, 0)
    )
    values, axes = np.linalg.eigh(covariance)
    root = axes * np.sqrt(np.maximum(values, 0.0))
    return lambda rng: root @ rng.standard_normal(len(root))


def off_at_one_angle(plan: CheckPlan, size: float) -> Draw:
    """Return tables that the earlier curve misses by ``size`` (rad) at an angle drawn anew."""
    m = len(plan.angles)
    spike = size * np.append(1.0, np.full(m - 1, -1.0 / (m - 1)))
    return lambda rng: np.roll(spike, rng.integers(m)) * rng.choice([-1.0, 1.0])


def main() -> None:
    """Plan, simulate and print the shares of the verdicts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--within", type=float, default=2.5, help="arcsec")
    parser.add_argument("--ageing", type=float, default=0.12, help="arcsec, since then")
    parser.add_argument("--set", action="append", default=["solver.length_std_m=2e-7"])
    asked = parser.parse_args()
    earlier = read_curve(EARLIER, "ECC")
    rule = CheckRule(asked.within * ARCSEC, ageing_std=asked.ageing * ARCSEC)
    plan = plan_check(changed(read_configuration(SETUP), asked.set), earlier, rule)
    print(
        f"{len(plan.pairs)} lengths to {len(plan.targets)} targets, within {asked.within:g} "
        f"arcsec; promised of tables that only aged: {100 * plan.assurance:.1f} % still valid"
    )
    print("table                        still valid  undecided  changed")
    cases = {
        "aged as stated": aged(plan, earlier),
        "off by the limit": off_at_one_angle(plan, rule.limit),
        "off by 1.5 times the limit": off_at_one_angle(plan, 1.5 * rule.limit),
    }
    for name, draw in cases.items():
        found = shares(plan, earlier, draw, asked.runs, asked.seed)
        columns = [100 * found[v] / asked.runs for v in ("still valid", "undecided", "changed")]
        print(f"{name:27}  {columns[0]:9.1f} %  {columns[1]:7.1f} %  {columns[2]:5.1f} %")


if __name__ == "__main__":
    main()
