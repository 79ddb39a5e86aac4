"""How often the stated uncertainty of a table that turned under a tracer holds the truth.

    python research/turning_coverage.py [RUNS] [--angles N] [--targets N]

Worlds in the time domain (``test/methods/tracer/turning_scene.py``, no code of the solver):
readings at 1 kHz with 0.2 um, 12 deg/s and back, a lag of 1 ms, targets 0.5 m away with 1 um, a
tracer 65 mm off the axis. White readings, and such that are correlated over 0.1 s; no error
motion, stated as none, and 0.1 um in the orders 2 to 7, not stated. U (k = 2) of ECC about its
mean, in each direction, and for the mean of both. Figures of it are in docs/tracer_turning.md.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).parent.parent / "test" / "methods" / "tracer"))
from test_turning_lengths import CORRELATED, WHITE, problem_of
from turning_scene import ARCSEC, turning_scene

from rotcal_ros.methods.tracer.solver.solution import adjust

CASES = {
    "white": (0.0, 0.0),
    "correlated": (0.1, 0.0),
    "white, motion": (0.0, 1e-7),
    "correlated, motion": (0.1, 1e-7),
}


def main() -> None:
    """Print a row for each case."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("runs", nargs="?", type=int, default=20)
    parser.add_argument("--angles", type=int, default=120)
    parser.add_argument("--targets", type=int, default=4)
    asked = parser.parse_args()
    n = asked.angles
    centring = np.eye(n) - 1.0 / n
    print("case                  U/arcsec  2 rms error  mean: U  2 rms  within/%  not ok")
    for case, (correlated, motion) in CASES.items():
        within, sizes, alarms = [], [], 0
        for seed in range(asked.runs):
            scene = turning_scene(
                1000 + seed, angles=n, targets=asked.targets, correlated_s=correlated,
                motion=motion, window_deg=min(0.5, 180.0 / n),
            )  # fmt: skip
            std = CORRELATED if correlated else WHITE
            found = adjust(problem_of(scene, std, None if motion else 0.0))
            alarms += found.found.verdict != "ok"
            error = found.deviations.reshape(2, n) - scene.ecc
            covariance = found.covariance.reshape(2, n, 2, n).swapaxes(1, 2)
            own = [(error[0], covariance[0, 0]), (error[1], covariance[1, 1])]
            mean = [(error.mean(axis=0), covariance.sum(axis=(0, 1)) / 4.0)]
            squares = []
            for each, matrix in (*own, *mean):
                variance = (centring @ matrix @ centring).diagonal()
                within.append((np.abs(each - each.mean()) < 1.96 * np.sqrt(variance)).mean())
                squares.append((variance.mean(), each.var()))
            sizes.append([*np.mean(squares[:2], axis=0), *squares[2]])
        u, e, mean_u, mean_e = 2.0 * np.sqrt(np.mean(sizes, axis=0)) / ARCSEC
        print(
            f"{case:20}  {u:8.3f}  {e:11.3f}  {mean_u:7.3f}  {mean_e:5.3f}  "
            f"{100 * np.mean(within):8.1f}  {alarms} of {asked.runs}",
            flush=True,
        )


if __name__ == "__main__":
    main()
