"""How often the stated 95 % intervals of the six curves hold the truth.

usage: python benchmarks/six_coverage.py [RUNS]
"""

import sys
from dataclasses import dataclass, replace

import numpy as np
from six_scene import scene

from rotcal_ros.components import COMPONENTS, HALF_OF_95_PERCENT
from rotcal_ros.methods.tracer_six import SixProblem
from rotcal_ros.methods.tracer_six.solution import adjust

LEVELS = (0.0, 0.5, 1.0, 2.0)
UNIT = (1e-7, 5e-7)
"""Scatter (m, rad) that doubles about the variance of the curves that the lengths leave."""


@dataclass(frozen=True)
class Coverage:
    """``share`` (6,) of true values inside, and rms of ``error`` and ``std`` (6,), m and rad."""

    share: np.ndarray
    error: np.ndarray
    std: np.ndarray


def coverage(runs, scatter, *, arrivals=1, seed=0, ignored=False, **options):
    """Simulate ``runs`` measurements with ``scatter`` (m, rad) and solve each.

    ``ignored``: the scatter is stated to be none, and believed whatever the places say.
    """
    rng, inside, errors, stds = np.random.default_rng(seed), [], [], []
    if ignored:
        options = {"scatter_translation_std": 0.0, "scatter_rotation_std": 0.0}
    for _ in range(runs):
        truth = scene(rng, scatter=scatter, arrivals=arrivals)
        problem = SixProblem(**truth.rows, **options)
        if ignored:
            sure = replace(problem.settings, test_significance=1e-30)
            problem = replace(problem, settings=sure)
        solution = adjust(problem)
        found = solution.deviations()
        error = np.array([found[name] for name in COMPONENTS]) - truth.truth
        std = np.sqrt(np.einsum("ajaj->aj", solution.covariance))
        inside.append((np.abs(error) < HALF_OF_95_PERCENT * std).mean(axis=1))
        errors.append((error**2).mean(axis=1))
        stds.append((std**2).mean(axis=1))
    return Coverage(
        np.mean(inside, axis=0), np.sqrt(np.mean(errors, axis=0)), np.sqrt(np.mean(stds, axis=0))
    )


def main():
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else 1000
    none = {"scatter_translation_std": 0.0, "scatter_rotation_std": 0.0}
    cases = [("no scatter, known", 0.0, 1, none)]
    cases += [("estimated", level, 1, {}) for level in LEVELS]
    cases += [("estimated, two arrivals", 1.0, 2, {}), ("ignored", 1.0, 1, {"ignored": True})]
    print(f"{'':26}level  " + "  ".join(f"{name:>6}" for name in COMPONENTS))
    for name, level, arrivals, options in cases:
        found = coverage(runs, (level * UNIT[0], level * UNIT[1]), arrivals=arrivals, **options)
        share = "  ".join(f"{100 * value:6.1f}" for value in found.share)
        print(f"{name:26}{level:5.1f}  {share}", flush=True)


if __name__ == "__main__":
    main()
