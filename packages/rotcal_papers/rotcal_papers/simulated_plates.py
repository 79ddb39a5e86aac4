"""The table and the machine of the two ball plate papers, as plain physics with a fixed seed.

Neither paper prints a measurement. So their plates are measured here by a machine with systematic
errors, on a table with known ones, with the noise that the first paper states.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.components import COMPONENTS, COVERAGE_FACTOR, unit_of
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import ARCSEC, DEGREE, MICROMETRE
from rotcal_ros.geometry.rotations import rotation_about_z, rotation_from_vector
from rotcal_ros.methods.ball_plate.solver.problem import BallPlateProblem, on_circle
from rotcal_ros.methods.figures import style

RADIUS: Final = 0.185
"""Radius of the circle of the balls in both papers, m."""
CENTRE_STD: Final = 0.05e-6
"""Noise of a ball centre along each axis, m: U = 0.1 um (k = 2), first paper, section 5."""
MANUFACTURE_STD: Final = 5e-6
MACHINE_STD: Final = 0.8e-6
AXIS_TURN: Final = np.array([3.0, -2.0, 5.0]) * ARCSEC
AXIS_SHIFT: Final = np.array([12.0, -7.0, 4.0]) * MICROMETRE
"""How the axis stands in the frame of the machine: its tilt, with the turn of the plate, and m."""
HARMONICS: Final[Mapping[str, Mapping[int, tuple[float, float]]]] = {
    "EXC": {2: (0.12, 35.0), 3: (0.08, -110.0), 5: (0.04, 15.0)},
    "EYC": {2: (0.10, -50.0), 3: (0.09, 15.0), 4: (0.05, 80.0)},
    "EZC": {1: (0.30, 80.0), 2: (0.25, -20.0), 6: (0.05, 130.0)},
    "EAC": {2: (0.30, 10.0), 3: (0.15, -60.0)},
    "EBC": {2: (0.25, 100.0), 4: (0.20, 35.0)},
    "ECC": {1: (2.0, 20.0), 2: (0.9, -75.0), 4: (0.3, 140.0), 7: (0.2, 60.0)},
}
"""The table's errors: harmonic, amplitude (um, arcsec) and phase in degrees. What turns with the
table, the first of the radial ones, no plate can separate from its own place."""
MARKERS: Final = ("o", "s", "^", "D", "x", "+")
"""Curves that are drawn together can be distinguished without colours."""


def true_deviations(angles: Floats) -> dict[str, Floats]:
    """Return the table's errors (n,) at ``angles`` (n,) rad by component, m and rad."""
    return {
        name: unit_of(name)[0]
        * np.sum(
            [a * np.cos(order * angles + phase * DEGREE) for order, (a, phase) in parts.items()],
            axis=0,
        )
        for name, parts in HARMONICS.items()
    }


@dataclass(frozen=True)
class PlateMeasurement:
    """One set-up of a plate with ``balls`` on a ``grid``; all chance comes from ``seed``."""

    grid: int
    balls: tuple[int, ...]
    seed: int
    noisy: bool = True

    def problem(self, **options: bool) -> BallPlateProblem:
        """Return the centres of all balls at all table positions, the probe resting (paper)."""
        rng = np.random.default_rng(self.seed)
        count, grid = len(self.balls), self.grid
        cmm, ball = (a.ravel() for a in np.meshgrid(np.arange(grid), self.balls, indexing="ij"))
        nominal = BallPlateProblem.nominal(grid, RADIUS, (cmm - ball) % grid, ball, **options)
        plate = MANUFACTURE_STD * rng.standard_normal((count, 3))
        machine = MACHINE_STD * rng.standard_normal((grid, 3))
        truth = true_deviations(nominal.angles)
        at, own = nominal.position, np.searchsorted(nominal.balls, nominal.ball_step)
        places = RADIUS * on_circle(nominal.angles[nominal.ball_step]) + plate[own]
        lean = np.column_stack([truth["EAC"], truth["EBC"], np.zeros(grid)])
        table = rotation_from_vector(lean) @ rotation_about_z(nominal.angles + truth["ECC"])
        shift = np.column_stack([truth[name] for name in ("EXC", "EYC", "EZC")])
        there = (table[at] @ (rotation_about_z(AXIS_TURN[2]) @ places.T).T[:, :, None])[:, :, 0]
        there = there + shift[at] + machine[nominal.cmm_index]
        tilt = rotation_from_vector(AXIS_TURN * [1.0, 1.0, 0.0])
        centres = AXIS_SHIFT + there @ tilt.T
        noise = self.noisy * CENTRE_STD * rng.standard_normal(centres.shape)
        return replace(nominal, centres=centres + noise)


def largest_expanded(result: Result) -> dict[str, float]:
    """Return the largest U (k = 2) of each component, m and rad."""
    return {name: COVERAGE_FACTOR * float(result.std[name].max()) for name in COMPONENTS}


@style.house_style
def draw_components(
    curves: Mapping[str, tuple[Floats, Mapping[str, Floats]]], names: Sequence[str] = COMPONENTS
) -> str:
    """Draw ``curves``, angles (n,) rad and components (n,) by name, in a panel per component."""
    columns = 3 if len(names) > 2 else len(names)
    panels = style.grid(-(-len(names) // columns), columns, height=2.5, sharex=True)
    for ax, name in zip(panels, names, strict=True):
        factor, unit = unit_of(name)
        for number, (label, (angles, values)) in enumerate(curves.items()):
            ax.plot(
                angles / DEGREE, values[name] / factor, linewidth=0.9, markersize=3.5,
                marker=MARKERS[number], color=style.COLOURS[number], label=label,
                markerfacecolor="none", markevery=max(len(angles) // 36, 1),
            )  # fmt: skip
        ax.set_ylabel(f"{name} / {unit}")
    for ax in panels[-columns:]:
        style.angle_axis(ax, np.array([0.0, 360.0]))
    return style.svg(panels[0])
