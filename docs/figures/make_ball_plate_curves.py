"""Draw docs/figures/ball_plate_curves.svg: a simulated table, its truth and the result."""

from pathlib import Path

import matplotlib as mpl
import numpy as np

mpl.use("svg")
import matplotlib.pyplot as plt

from rotcal_ros.methods.ball_plate import BallPlateProblem, select, solve
from rotcal_ros.methods.ball_plate.model import cross_unit, rotations
from rotcal_ros.units import ARCSEC, MICROMETRE

GRID, RADIUS, SIGMA = 72, 0.185, 5e-8
BALLS = np.array([0, 8, 12, 18, 21, 28, 32, 37, 42, 50, 58, 62])
UNITS = {"EXC": MICROMETRE, "EYC": MICROMETRE, "EZC": MICROMETRE}


def table_errors(rng: np.random.Generator) -> np.ndarray:
    """Six smooth sequences (6, N) of harmonics 2 to 6, in metres (rotations times radius)."""
    q = np.arange(2, 7)
    phase = 2.0 * np.pi * q[:, None] * np.arange(GRID) / GRID
    weights = 0.4e-6 * rng.normal(size=(2, 6, len(q))) / q
    return weights[0] @ np.cos(phase) + weights[1] @ np.sin(phase)


def main() -> None:
    """Simulate, solve, draw."""
    rng = np.random.default_rng(5)
    truth = table_errors(rng)
    truth[3:] /= RADIUS
    ball, table = np.repeat(BALLS, GRID), np.tile(np.arange(GRID), len(BALLS))
    angles = 2.0 * np.pi * np.arange(GRID) / GRID
    k = (ball + table) % GRID
    nominal = RADIUS * rotations(angles)[k][:, :, 0]
    plate, cmm = 1e-5 * rng.normal(size=(GRID, 3)), 1e-6 * rng.normal(size=(GRID, 3))
    centres = nominal + RADIUS * np.einsum("nij,nj->ni", cross_unit(angles)[k], truth[3:].T[table])
    centres += truth[:3].T[table] + cmm[k]
    centres += np.einsum("nij,nj->ni", rotations(angles)[table], plate[ball])
    centres += SIGMA * rng.normal(size=centres.shape)
    problem = BallPlateProblem(GRID, RADIUS, table, ball, centres)
    whole, six = solve(problem), solve(select(problem, balls=[0, 12, 28, 37, 50, 58]))
    figure, axes = plt.subplots(2, 4, figsize=(13, 5), sharex=True, layout="constrained")
    degrees = np.degrees(angles)
    panels = [*whole.deviations, "ECC"]
    for axis, name, result in zip(axes.flat, panels, [whole] * 6 + [six], strict=False):
        unit = UNITS.get(name, ARCSEC)
        value, std = result.deviations[name] / unit, result.std[name] / unit
        axis.fill_between(degrees, value - 1.96 * std, value + 1.96 * std, alpha=0.4, lw=0)
        axis.plot(degrees, value, lw=1)
        axis.plot(degrees, truth[list(whole.deviations).index(name)] / unit, "k.", ms=2)
        balls = "" if result is whole else ", 6 balls"
        axis.set_title(f"{name}{balls} ({'um' if unit == MICROMETRE else 'arcsec'})", fontsize=10)
    axes[1, 3].set_axis_off()
    for axis in axes[1]:
        axis.set_xlabel("table angle (degrees)")
    figure.savefig(Path(__file__).with_name("ball_plate_curves.svg"), metadata={"Date": None})


if __name__ == "__main__":
    main()
