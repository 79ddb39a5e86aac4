"""Expanded uncertainty (k = 2) of the six curves for places, heights and zeros.

usage: python benchmarks/six_uncertainty.py
"""

import numpy as np
from six_scene import on_circle, scene

from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.methods.tracer_six.solver import SixProblem, solve

CASES = {
    "120 degrees apart, zero per run": {},
    "the same, zero per station": {"zero": "per_station"},
    "the same, heights 0, 40, 80 mm": {"zero": "per_station", "heights": [0.0, 0.04, 0.08]},
    "90 degrees apart": {"spacing_deg": 90.0},
    "60 degrees apart": {"spacing_deg": 60.0},
    "30 degrees apart": {"spacing_deg": 30.0},
    "r = 75 mm": {"radius": 0.075},
    "free targets": {"datum": "free"},
    "two places, tilts known to 10 urad": {"n_places": 2, "tilt_std": 1e-5},
}


def expanded(zero="per_run", datum="prior", tilt_std=None, slip=0.0, **layout):
    places = on_circle(**layout)
    quiet = {"noise": 0.0, "mounted": 0.0, "curves": (0.0, 0.0)}
    rows = scene(np.random.default_rng(1), places=places, zero=zero, **quiet).rows
    problem = SixProblem(
        **rows, datum=datum, tilt_std=tilt_std, slip=slip,
        scatter_translation_std=0.0, scatter_rotation_std=0.0,
    )  # fmt: skip
    std = solve(problem).std
    return [2e6 * float(np.sqrt(np.mean(std[name] ** 2))) for name in COMPONENTS]


def main():
    print(f"{'U (k = 2), um and urad':38}" + "".join(f"{name:>8}" for name in COMPONENTS))
    for name, options in CASES.items():
        print(f"{name:38}" + "".join(f"{value:8.3f}" for value in expanded(**options)))


if __name__ == "__main__":
    main()
