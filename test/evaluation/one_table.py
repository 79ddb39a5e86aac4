"""One simulated table, measured by every method: they should find the same table.

Plain physics, every instrument with errors of its own. ``deviations`` (N, 6) are EXC, EYC, EZC
(m), EAC, EBC, ECC (rad) of the table at N even steps of the full circle.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
from mirror_cell import measure, ring_cell, table_pose

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.curves.measured import MeasuredCurve
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import ARCSEC, TURN
from rotcal_ros.methods.ball_plate import solver as ball_plate
from rotcal_ros.methods.ball_plate.solver import BallPlateProblem
from rotcal_ros.methods.plane_mirror import solver as plane_mirror
from rotcal_ros.methods.plane_mirror.solver import PlaneMirrorProblem
from rotcal_ros.methods.tracer import solver as tracer
from rotcal_ros.methods.tracer.settings import TracerPlanSettings
from rotcal_ros.methods.tracer.solver import TracerProblem
from rotcal_ros.methods.tracer_six import solver as tracer_six
from rotcal_ros.methods.tracer_six.solver import SixProblem
from rotcal_ros.planning.points import serpentine_grid

BALLS: Final = (0, 3, 4, 9, 14, 20)
MOUNT: Final = np.array([0.065, 0.0, 0.12])
"""Where the tracer stands on the table, m."""


@dataclass(frozen=True)
class Instruments:
    """Standard deviations (m, rad) of the instruments, and of the table's small motions.

    ``length``: of a tracer length, ``target``: of a reflector's coordinate on the CMM, ``centre``:
    of a ball centre, ``cmm``: of the CMM's errors, which the ball plate method separates,
    ``plate``: of the places of the balls, ``reading``: of the autocollimator, ``motion`` and
    ``tilt``: of the table's translations and tilts, independent from angle to angle.
    """

    length: float = 0.2e-6
    target: float = 1e-6
    centre: float = 0.1e-6
    cmm: float = 1e-6
    plate: float = 10e-6
    reading: float = 0.1 * ARCSEC
    motion: float = 0.05e-6
    tilt: float = 0.3 * ARCSEC


def angles_of(count: int) -> Floats:
    """Return ``count`` even steps of the full circle, rad."""
    return np.asarray(np.arange(count) * TURN / count, dtype=np.float64)


def table_deviations(
    count: int, rng: np.random.Generator, instruments: Instruments | None = None
) -> Floats:
    """Return deviations (count, 6): a positioning curve of a few arcsec, small other motions."""
    own = instruments or Instruments()
    angles = angles_of(count)
    values = np.empty((count, 6))
    values[:, :3] = rng.normal(0.0, own.motion, (count, 3))
    values[:, 3:5] = rng.normal(0.0, own.tilt, (count, 2))
    values[:, 5] = 4.0 * np.sin(angles + 0.4) + 1.5 * np.cos(2 * angles) + np.sin(5 * angles + 1.0)
    values[:, 5] *= ARCSEC
    return values


def by_tracer(
    deviations: Floats,
    rng: np.random.Generator,
    every: int = 1,
    instruments: Instruments | None = None,
) -> TracerProblem:
    """Measure with a laser tracer on the table, at every ``every``-th angle.

    The tracer cannot separate the angle from what moves it sideways: the table's translations, and
    its tilts times the height at which the tracer stands.
    """
    own = instruments or Instruments()
    rows = np.arange(0, len(deviations), every)
    angles = angles_of(len(deviations))[rows]
    box = TracerPlanSettings(box_size_m=(0.9, 0.9, 0.4), box_points=(4, 4, 3))
    targets = np.array(box.block)
    places = targets + rng.normal(0.0, own.target, targets.shape)
    stations = _carried(MOUNT[None], angles, deviations[rows])[:, 0]
    length = np.linalg.norm(stations[:, None] - places, axis=2)
    position, target = np.divmod(np.arange(length.size), len(targets))
    return TracerProblem(
        position=position,
        target=target,
        length=length.ravel() - 0.5 + rng.normal(0.0, own.length, length.size),
        length_std=np.full(length.size, own.length),
        targets=targets,
        target_std=np.full(targets.shape, own.target),
        table_angles=angles,
        variant="joint",
        error_motion_std=float(np.hypot(own.motion, MOUNT[2] * own.tilt)),
    )


def by_tracer_at_places(
    deviations: Floats,
    rng: np.random.Generator,
    every: int = 1,
    instruments: Instruments | None = None,
) -> SixProblem:
    """Measure with a laser tracer at three places of the table, at every ``every``-th angle."""
    own = instruments or Instruments()
    rows = np.arange(0, len(deviations), every)
    angles = angles_of(len(deviations))[rows]
    targets = np.array(serpentine_grid((0.0, 0.0, 0.62), (1.2, 1.0, 0.8), (3, 2, 2)))
    seen = targets + rng.normal(0.0, own.target, targets.shape)
    around = TURN / 3 * np.arange(3)
    places = np.column_stack([0.15 * np.cos(around), 0.15 * np.sin(around), np.full(3, 0.12)])
    fixed = places + rng.normal(0.0, 1e-3, places.shape)  # to a millimetre
    stations = _carried(fixed, angles, deviations[rows])
    length = np.linalg.norm(stations[:, :, None] - seen, axis=3) + rng.normal(0.0, 1e-4, (3, 1))
    position, place, target = (axis.ravel() for axis in np.indices(length.shape))
    return SixProblem(
        position=position,
        place=place,
        target=target,
        length=length.ravel() + rng.normal(0.0, own.length, length.size),
        length_std=np.full(length.size, own.length),
        targets=targets,
        target_std=np.full(targets.shape, own.target),
        table_angles=angles,
        places=places,
        scatter_translation_std=0.0,  # this table comes back to the same place
        scatter_rotation_std=0.0,
        slip=0.0,  # and its tracer's counter does not slip
    )


def by_ball_plate(
    deviations: Floats,
    rng: np.random.Generator,
    balls: tuple[int, ...],
    radius: float = 0.185,
    instruments: Instruments | None = None,
) -> BallPlateProblem:
    """Measure with a plate of ``balls`` (steps of the table's grid) at all angles."""
    own = instruments or Instruments()
    grid, steps = len(deviations), np.array(balls)
    plate = np.stack([np.cos(angles_of(grid)), np.sin(angles_of(grid)), np.zeros(grid)], axis=1)
    places = radius * plate[steps] + rng.normal(0.0, own.plate, (len(steps), 3))
    centres = _carried(places, angles_of(grid), deviations)
    table, ball = np.repeat(np.arange(grid), len(steps)), np.tile(steps, grid)
    cmm = rng.normal(0.0, own.cmm, (grid, 3))
    measured = centres.reshape(-1, 3) + cmm[(table + ball) % grid]
    measured += rng.normal(0.0, own.centre, measured.shape)
    return BallPlateProblem(grid, radius, table, ball, measured, sigma=own.centre)


def by_mirror(
    deviations: Floats,
    rng: np.random.Generator,
    stations: int = 6,
    instruments: Instruments | None = None,
) -> PlaneMirrorProblem:
    """Measure with a laser tracker and a plane mirror; the last angle is the first again."""
    own = instruments or Instruments()
    grid = len(deviations)
    angles = np.append(angles_of(grid), TURN)
    ends = np.linspace(0, grid, stations + 1).round().astype(int)
    visits = tuple(tuple(range(a, b + 1)) for a, b in pairwise(ends.tolist()))
    cell = ring_cell(angles, visits, n_nests=6, reflectors=2)
    around = np.vstack([deviations, deviations[:1]])
    return measure(cell, around, rng=rng, tilt_std=own.tilt)


def by_autocollimator(
    deviations: Floats,
    rng: np.random.Generator,
    faces: Floats | None = None,
    instruments: Instruments | None = None,
) -> MeasuredCurve:
    """Measure with an autocollimator and a polygon whose faces err by ``faces`` (N,) rad."""
    own = instruments or Instruments()
    count = len(deviations)
    reading = deviations[:, 5] + rng.normal(0.0, own.reading, count)
    reading = reading if faces is None else reading + faces
    return MeasuredCurve(angles_of(count), reading, own.reading**2 * np.eye(count), TURN)


def _carried(points: Floats, angles: Floats, deviations: Floats) -> Floats:
    """Return where the table carries ``points`` (k, 3) of its own frame, (n, k, 3)."""
    poses = [table_pose(a, d) for a, d in zip(angles.tolist(), deviations, strict=True)]
    return np.stack([points @ rotation.T + shift for rotation, shift in poses])


def by_every_method(seed: int) -> tuple[Floats, dict[str, Result]]:
    """Draw a table of 24 steps and all instruments; return its deviations and the results."""
    rng = np.random.default_rng(seed)
    table = table_deviations(24, rng)
    places = by_tracer_at_places(table, np.random.default_rng([seed, 1]), every=2)
    return table, {
        "tracer": tracer.solve(by_tracer(table, rng, every=2)),
        "plate": ball_plate.solve(by_ball_plate(table, rng, BALLS)),
        "mirror": plane_mirror.solve(by_mirror(table, rng)),
        "six": tracer_six.solve(places),
    }
