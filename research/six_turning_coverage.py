"""How often the stated uncertainty of six deviations of a table that turned holds the truth.

    python research/six_turning_coverage.py [RUNS] [--angles N] [--targets N] [--noise CASE ...]

Worlds in the time domain (``test/methods/tracer_six/six_turning_scene.py``, no code of the
solver): readings at 1 kHz with 0.2 um, 12 deg/s and back, a lag of 1 ms, targets 0.5 m away with
1 um, a tracer at three places, each missed by 0.3 mm. White readings, and such that are correlated
over 0.1 s. For each deviation U (k = 2), twice the rms error in each direction, and how many of
the angles are within the 95 % interval. Figures of it are in docs/tracer_turning.md.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).parent.parent / "test" / "methods" / "tracer_six"))
from six_turning_scene import ARCSEC, NAMES, six_turning_scene
from test_six_turning import CORRELATED, WHITE, normalised, problem_of

from rotcal_ros.methods.tracer_six.solver.solve import adjust, result_of

NOISES = {"white": (0.0, WHITE), "correlated": (0.1, CORRELATED)}
SIZES = np.array([*3 * [1e-6], *3 * [ARCSEC]])


def main() -> None:
    """Print, for either noise, a row for each deviation."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("runs", nargs="?", type=int, default=20)
    parser.add_argument("--angles", type=int, default=24)
    parser.add_argument("--targets", type=int, default=4)
    parser.add_argument("--noise", choices=NOISES, nargs="+", default=NOISES)
    asked = parser.parse_args()
    for case in asked.noise:
        correlated, std = NOISES[case]
        began, errors, sizes, alarms = time.process_time(), [], [], 0
        for seed in range(asked.runs):
            scene = six_turning_scene(
                1000 + seed, angles=asked.angles, targets=asked.targets, correlated_s=correlated
            )
            found = adjust(problem_of(scene, std))
            alarms += result_of(found).verdict != "ok"
            errors.append(normalised(scene, found))
            sizes.append(found.found.std.reshape(6, -1))
        error, u = np.array(errors), np.array(sizes)
        print(
            f"{case}: {alarms} of {asked.runs} not ok, "
            f"{100.0 * np.mean(np.abs(error) < 1.96):.1f} % within, "
            f"{(time.process_time() - began) / asked.runs:.1f} s of processor time each\n"
            "           U       2 rms error  within/%   (um, arcsec)"
        )
        for k, name in enumerate(NAMES):
            own = 2.0 * np.sqrt(np.mean(u[:, k] ** 2)) / SIZES[k]
            off = 2.0 * np.sqrt(np.mean((error[:, k] * u[:, k]) ** 2)) / SIZES[k]
            within = 100.0 * np.mean(np.abs(error[:, k]) < 1.96)
            print(f"  {name}  {own:8.3f}  {off:11.3f}  {within:8.1f}", flush=True)


if __name__ == "__main__":
    main()
