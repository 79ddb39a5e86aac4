"""Does a plan keep its promise? Its folder measured many times over, by an own simulation.

    .venv/bin/rotcal plan tracer config/tracer_goal.yaml -o out/plan
    .venv/bin/python research/plan_promise.py out/plan --need 1.202 --largest 1.32 [--runs 400]

Knows nothing of how the plan was made: it reads plan.yaml, draws stations, targets and lengths
with what is stated there, solves them as the solver of that configuration does, and counts the
runs that end ok with U (k = 2, less the mean) within the goal. A table whose error motion
plan.yaml leaves to be estimated has none here. Figures of it are in docs/evidence.md.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.methods import prepare, read_configuration
from rotcal_ros.methods.tracer.solver import TracerLimits, TracerProblem, solve

MOUNT = np.array([0.0569, -0.0318, 0.1225])


def results(folder: Path, runs: int) -> Iterator[tuple[bool, Floats]]:
    """Yield whether each run ended ok, and the U (m,) in arcsec that it states."""
    configuration = read_configuration(folder / "plan.yaml")
    plan, solver = prepare(configuration).plan, configuration.solver
    angles, said = np.array(plan.table_angles), np.array(plan.targets)
    position = np.array([step.table_position for step in plan.steps])
    target = np.array([step.target for step in plan.steps])
    turned = np.arctan2(MOUNT[1], MOUNT[0]) + angles
    outward = np.column_stack([np.cos(turned), np.sin(turned), 0.0 * turned])
    along, up = np.cross([0.0, 0.0, 1.0], outward), np.array([0.0, 0.0, 1.0])
    radius, one_zero = np.hypot(*MOUNT[:2]), solver.zero == "per_segment"
    circle, moving = solver.circle_std_m, solver.error_motion_std_m
    across = (moving or 0.0) if circle is None else circle
    for seed in range(runs):
        rng = np.random.default_rng([seed, 12])
        off = rng.standard_normal((3, len(angles), 1))
        stations = (radius + across * off[0]) * outward + (moving or 0.0) * off[1] * along
        stations = stations + (MOUNT[2] + (circle or 0.0) * off[2]) * up
        true = said + solver.target_std_m * rng.standard_normal(said.shape)
        distance = np.linalg.norm(stations[position] - true[target], axis=1)
        std = np.hypot(solver.length_std_m, solver.length_std_relative * distance)
        result = solve(TracerProblem(
            position, target, distance - 0.2 + std * rng.standard_normal(len(std)), std, said,
            solver.target_std_m, angles, error_motion_std=moving, circle_std=circle,
            segment=np.zeros_like(position) if one_zero else None, slip=solver.slip_m,
            order=np.arange(len(position)),
            settings=TracerLimits(rejection_significance=solver.rejection_significance),
        ))  # fmt: skip
        covariance = result.covariance["ECC"]
        turn = np.eye(len(covariance)) - 1.0 / len(covariance)
        about_mean = np.diagonal(turn @ covariance @ turn)
        yield result.verdict == "ok", np.asarray(2.0 * np.sqrt(about_mean) / ARCSEC)


def main() -> None:
    """Print how often the goal is met."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--need", type=float, required=True, help="arcsec, rms over the angles")
    parser.add_argument("--largest", type=float, help="arcsec; else 1.1 times the rms")
    parser.add_argument("--runs", type=int, default=400)
    given = parser.parse_args()
    largest = given.largest or 1.1 * given.need
    found = [
        (ok, float(np.sqrt((u**2).mean())), float(u.max()))
        for ok, u in results(given.folder, given.runs)
    ]
    ended = np.mean([ok for ok, _, _ in found])
    met = np.mean([ok and rms <= given.need and most <= largest for ok, rms, most in found])
    print(
        f"{given.runs} runs: {100 * ended:.1f} % end ok, {100 * met:.1f} % end ok and meet the "
        f"goal; U in the middle {np.median([rms for _, rms, _ in found]):.3f} arcsec rms"
    )


if __name__ == "__main__":
    main()
