"""The reduced three-rosette paper: its plate, its uncertainties, its four evaluations.

The words stand in ``templates/three_rosette.yaml``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import combinations
from typing import Final

import numpy as np

from rotcal_papers.reproduction import PrintedTable, Reproduction
from rotcal_papers.simulated_plates import (
    CENTRE_STD,
    RADIUS,
    PlateMeasurement,
    draw_components,
    largest_expanded,
    true_deviations,
)
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.components import COMPONENTS, COVERAGE_FACTOR, unit_of
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import MICROMETRE
from rotcal_ros.methods.ball_plate.solver import select, solve
from rotcal_ros.methods.ball_plate.solver.layout import PlateLayout
from rotcal_ros.methods.ball_plate.solver.problem import BallPlateProblem, grid_angles
from rotcal_ros.methods.ball_plate.solver.separability import separability
from rotcal_ros.methods.figures import Figure, style

GRID: Final = 72
PLATE: Final = (0, 8, 12, 18, 21, 28, 32, 37, 42, 50, 58, 62)
"""Steps of 5 degrees at which the new plate has its balls."""
SIX: Final = (0, 12, 28, 37, 50, 58)
"""The six of them that are best for the tilts; the paper does not say which it took."""
FIRST_SIX: Final = (0, 8, 12, 18, 21, 28)
MICRORADIAN: Final = 1e-6
RANDOM_LAYOUTS: Final = 300
SMALL_GRIDS: Final = (10, 12, 14, 16)
"""Grids of which all layouts of four and five balls are tried."""


def reproduce() -> Reproduction:
    """Return the paper's figures and claims, computed again."""
    results = evaluations()
    return Reproduction.of("three_rosette", _values(results), _tables(results), _figures(results))


def evaluations() -> dict[str, Result]:
    """Return the four evaluations of Fig. 5: one plate a year earlier, three of one recording."""
    old = PlateMeasurement(12, tuple(range(12)), seed=1).problem()
    new = PlateMeasurement(GRID, PLATE, seed=2).problem()
    return {
        "12 equidistant balls, 30°": solve(old),
        "12 balls, 5°": solve(new),
        "10 of them, 10°": solve(select(new, coarser=2)),
        "6 of them, 5°": solve(select(new, balls=list(SIX))),
    }


def unit_uncertainty(balls: tuple[int, ...], grid: int = GRID) -> dict[str, float]:
    """Return U (k = 2) of each component, rms over the angles, with the paper's noise, m, rad."""
    cmm, ball = (a.ravel() for a in np.meshgrid(np.arange(grid), balls, indexing="ij"))
    layout = BallPlateProblem.nominal(grid, RADIUS, (cmm - ball) % grid, ball)
    std = PlateLayout(layout).unit_std()
    return {
        name: COVERAGE_FACTOR * CENTRE_STD * float(np.sqrt(np.mean(own**2)))
        for name, own in std.items()
    }


def _values(results: Mapping[str, Result]) -> dict[str, float]:
    old, new, ten, six = results.values()
    whole, best, first = (unit_uncertainty(balls) for balls in (PLATE, SIX, FIRST_SIX))
    shifts, turns = largest_apart(new, old)
    six_shift, six_turn = largest_apart(new, six)
    ten_shift, ten_turn = largest_apart(new, ten)
    four_lost, four_all = counterexamples(4)
    five_lost, five_all = counterexamples(5)
    layout = PlateLayout(PlateMeasurement(GRID, PLATE, seed=2).problem())
    pose = 6  # of the axis, which Eq. 15 takes off what the machine has at its positions
    unknowns = layout.unknowns + pose
    values = {
        "u_shift_um": whole["EXC"] / MICROMETRE,
        "u_tilt_urad": whole["EAC"] / MICRORADIAN,
        "u_ecc_urad": whole["ECC"] / MICRORADIAN,
        "six_ratio": best["ECC"] / whole["ECC"],
        "six_tilt_ratio": best["EAC"] / whole["EAC"],
        "first_six_ratio": first["ECC"] / whole["ECC"],
        "first_six_tilt_ratio": first["EAC"] / whole["EAC"],
        "null_directions": unknowns - np.linalg.matrix_rank(layout.rows.toarray()),
        "constraints": len(layout.definitions) + pose,
        "unknowns": unknowns,
        "effort": GRID / len(PLATE),
        "old_shift_um": shifts / MICROMETRE,
        "old_turn_urad": turns / MICRORADIAN,
        "six_shift_um": six_shift / MICROMETRE,
        "six_turn_urad": six_turn / MICRORADIAN,
        "ten_shift_um": ten_shift / MICROMETRE,
        "ten_turn_urad": ten_turn / MICRORADIAN,
        "four_lost": four_lost,
        "four_all": four_all,
        "five_lost": five_lost,
        "five_all": five_all,
        "plate_over_best": whole["ECC"] / best_random_layout(),
        "centre_u_um": COVERAGE_FACTOR * np.sqrt(_variance(new)) / MICROMETRE,
    }
    return {name: float(value) for name, value in values.items()}


def _variance(result: Result) -> float:
    """Return the variance of a ball centre along an axis by the residuals, m^2."""
    assert result.residuals is not None
    return float((result.residuals.residual[result.residuals.used] ** 2).sum() / result.dof)


def largest_apart(first: Result, second: Result) -> tuple[float, float]:
    """Return by how much two results differ at most at their common angles, m and rad.

    The mean of each component over these angles is undetermined: both lose it.
    """
    near = np.abs(first.angles[:, None] - second.angles) < 1e-9
    here, there = np.nonzero(near)

    def apart(name: str) -> float:
        off = first.deviations[name][here] - second.deviations[name][there]
        return float(np.abs(off - off.mean()).max())

    shifts, turns = (
        max(apart(name) for name in COMPONENTS if unit_of(name)[1] == unit)
        for unit in ("µm", "arcsec")
    )
    return shifts, turns


def best_random_layout() -> float:
    """Return the smallest U of crz, rad, of RANDOM_LAYOUTS with as many balls as the plate."""
    rng = np.random.default_rng(RANDOM_LAYOUTS)
    drawn = (rng.choice(GRID, len(PLATE), replace=False) for _ in range(RANDOM_LAYOUTS))
    layouts = [tuple(sorted(balls.tolist())) for balls in drawn]
    able = [balls for balls in layouts if separability(GRID, np.array(balls)).separable]
    return min(unit_uncertainty(balls)["ECC"] for balls in able)


def counterexamples(count: int) -> tuple[int, int]:
    """Return how many layouts of ``count`` balls do not separate though Eq. 22 holds, of how many.

    All layouts with a ball at step 0, on small grids.
    """
    lost = total = 0
    for grid in SMALL_GRIDS:
        for others in combinations(range(1, grid), count - 1):
            found = separability(grid, np.array((0, *others)))
            if found.common_divisor == 1:
                total += 1
                lost += not found.separable
    return lost, total


def _tables(results: Mapping[str, Result]) -> Iterator[PrintedTable]:
    units = [(name, *unit_of(name)) for name in COMPONENTS]
    yield PrintedTable.of(
        "Largest U (k = 2) of each evaluation, from its own residuals",
        ("evaluation", *(f"{name} / {unit}" for name, _, unit in units)),
        ("", *([".3f"] * 6)),
        [
            (words, *(largest_expanded(result)[name] / factor for name, factor, _ in units))
            for words, result in results.items()
        ],
    )
    yield PrintedTable.of(
        "U (k = 2), rms over the angles, by the layout alone, with U = 0.1 µm of a ball centre",
        ("layout", *(f"{name} / {unit}" for name, _, unit in units)),
        ("", *([".3f"] * 6)),
        [
            (words, *(unit_uncertainty(balls, grid)[name] / factor for name, factor, _ in units))
            for words, balls, grid in (
                ("all 12 balls, 72 positions", PLATE, GRID),
                (f"the best six for the tilts: {', '.join(map(str, SIX))}", SIX, GRID),
                (f"the first six: {', '.join(map(str, FIRST_SIX))}", FIRST_SIX, GRID),
                ("12 equidistant balls, 12 positions", tuple(range(12)), 12),
            )
        ],
    )


def _figures(results: Mapping[str, Result]) -> tuple[Figure, ...]:
    angles = grid_angles(GRID)
    curves: dict[str, tuple[Floats, Mapping[str, Floats]]] = {
        name: (result.angles, result.deviations) for name, result in results.items()
    }
    return (
        Figure(
            "Fig. 1: order of the complete method, six balls",
            "In a row the probe rests, and the table brings one ball after the other; the number "
            "in each circle is the position of the table. The reduced method leaves out columns "
            "(balls) or rows (places of the probe).",
            draw_order(6),
        ),
        Figure(
            "Fig. 5: deviations of the table, all four evaluations",
            "SIMULATED: the paper prints no measurement. Three evaluations rest on one recording; "
            "the table's true errors are drawn as a line of their own.",
            draw_components({**curves, "injected": (angles, true_deviations(angles))}),
        ),
    )


@style.house_style
def draw_order(count: int) -> str:
    """Draw which ball is measured where, for a plate with ``count`` balls and as many steps."""
    (ax,) = style.grid(height=3.4)
    for place in range(count):
        for ball in range(count):
            position = (place - ball) % count
            ax.annotate(
                str(position), (ball, place), ha="center", va="center", fontsize=8,
                bbox={"boxstyle": "circle", "facecolor": style.PAPER, "edgecolor": style.BLUE},
            )  # fmt: skip
    ax.set_xlim(-0.6, count - 0.4)
    ax.set_ylim(count - 0.4, -0.6)
    ax.set_xlabel("ball")
    ax.set_ylabel("place of the probe")
    ax.set_aspect("equal")
    return style.svg(ax)
