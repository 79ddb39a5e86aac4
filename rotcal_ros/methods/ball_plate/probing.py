"""From what the probe reports to ball centres: touch points and tables."""

from __future__ import annotations

import csv
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rotcal_ros.errors import DataError
from rotcal_ros.geometry.sphere import Spheres, fit_spheres
from rotcal_ros.methods.ball_plate.plate import Plate
from rotcal_ros.methods.ball_plate.problem import BallPlateProblem, Floats, Ints
from rotcal_ros.results import Rejection
from rotcal_ros.units import MILLIMETRE

HEADER = ("table_index", "ball_step", "x_m", "y_m", "z_m")
DIAMETER_TOLERANCE = 20e-6
"""Largest accepted difference between fitted and stated ball radius, metres (median)."""


@dataclass(frozen=True)
class Touches:
    """Touch points of all balls, arrays of shape (m,) and (m, 3).

    ``measurement`` numbers the ball measurements in their order (all touches of one ball at one
    table position share it); ``position`` is the centre of the probe tip in metres.
    """

    measurement: Ints
    table_index: Ints
    ball_step: Ints
    position: Floats


@dataclass(frozen=True)
class Centres:
    """Ball centres from touch points: the problem, the refused balls, and all fits.

    ``problem`` holds the good balls; its row numbers are the measurement numbers. ``spheres``
    holds all fits in the order of ``measurement`` (B,).
    """

    problem: BallPlateProblem
    rejected: tuple[Rejection, ...]
    spheres: Spheres
    measurement: Ints


def problem_of(
    plate: Plate, table_index: Ints, ball_step: Ints, centres: Floats, row: Ints | None = None
) -> BallPlateProblem:
    """Return the problem for ball centres (n, 3), in metres, measured on a plate.

    Raises DataError when a ball step is none of the plate's.
    """
    ball_step = np.asarray(ball_step, dtype=np.int64)
    strange = np.setdiff1d(ball_step, plate.ball_steps)
    if len(strange):
        first = int(np.flatnonzero(np.isin(ball_step, strange))[0])
        number = first if row is None else int(row[first])
        raise DataError(
            f"row {number}: the plate has no ball at step {ball_step[first]}; its balls are at "
            f"{list(plate.ball_steps)} of {plate.grid}"
        )
    return BallPlateProblem(
        grid=plate.grid,
        radius=plate.circle_radius,
        table_index=table_index,
        ball_step=ball_step,
        centres=centres,
        sigma=plate.sigma_centre,
        row=row,
        separate_groups=plate.separate_groups,
    )


def centres_from_touches(
    plate: Plate, touches: Touches, tip_radius: float, *, sigma_touch: float | None = None
) -> Centres:
    """Fit all balls at once and return their centres.

    ``tip_radius`` in metres; ``sigma_touch`` is the standard deviation of a touch point, from
    the residuals when None. Raises DataError when the balls are not of the plate's diameter, or
    when the touches of one measurement name different balls or positions.
    """
    numbers, points, used, first = _grouped(touches)
    radius = 0.5 * plate.ball_diameter
    _check_diameter(points, used, radius, tip_radius)
    spheres = fit_spheres(
        points, radius=radius, tip_radius=tip_radius, used=used, sigma=sigma_touch
    )
    table, ball = touches.table_index[first], touches.ball_step[first]
    good = np.array([not reason for reason in spheres.reason])
    rejected = tuple(
        Rejection(
            int(numbers[b]),
            f"row {numbers[b]} (ball step {ball[b]}, table position {table[b]}): "
            f"{spheres.reason[b]}",
        )
        for b in np.flatnonzero(~good)
    )
    if not good.any():
        raise DataError(f"no ball could be fitted; the first: {rejected[0].why}")
    problem = problem_of(plate, table[good], ball[good], spheres.centres[good], row=numbers[good])
    return Centres(problem, rejected, spheres, numbers)


def read_centres(path: Path, plate: Plate) -> BallPlateProblem:
    """Read a table of ball centres (CSV with the header ``HEADER``, metres).

    Raises DataError with file and line for a wrong header, a missing column or a value that is
    no number; ``nan`` is read, and set aside later with its row.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            return parse_centres(file, plate, str(path))
    except OSError as error:
        raise DataError(f"cannot read {path}: {error.strerror}") from None
    except UnicodeDecodeError:
        raise DataError(f"{path} is not a text file in UTF-8") from None


def parse_centres(lines: Iterable[str], plate: Plate, where: str) -> BallPlateProblem:
    """Like :func:`read_centres`, from lines of text; row numbers count from 0 after the header."""
    reader = csv.reader(lines)
    header = tuple(name.strip() for name in next(reader, []))
    if header != HEADER:
        raise DataError(f"{where}: the header must be {','.join(HEADER)}, not {','.join(header)}")
    index: list[tuple[int, int]] = []
    centres: list[tuple[float, ...]] = []
    for fields in reader:
        if not fields:
            continue
        try:
            table, ball, x, y, z = fields
            index.append((int(table), int(ball)))
            centres.append((float(x), float(y), float(z)))
        except ValueError:
            raise DataError(
                f"{where}, line {reader.line_num}: expected two whole numbers and three lengths "
                f"in metres, found {','.join(fields)!r}"
            ) from None
    if not index:
        raise DataError(f"{where}: there is no row below the header")
    columns = np.array(index, dtype=np.int64)
    return problem_of(plate, columns[:, 0], columns[:, 1], np.array(centres))


def _grouped(touches: Touches) -> tuple[Ints, Floats, np.ndarray, Ints]:
    """Sort touches into (B, n, 3) with a mask; also the first touch of every measurement."""
    numbers, first, group, count = np.unique(
        touches.measurement, return_index=True, return_inverse=True, return_counts=True
    )
    for name in ("table_index", "ball_step"):
        column = getattr(touches, name)
        mixed = np.flatnonzero(column != column[first][group])
        if len(mixed):
            raise DataError(
                f"measurement {touches.measurement[mixed[0]]}: its touches name {name} "
                f"{column[mixed[0]]} and {column[first[group[mixed[0]]]]}"
            )
    order = np.argsort(group, kind="stable")
    place = np.arange(len(order)) - np.repeat(np.cumsum(count) - count, count)
    points = np.full((len(numbers), int(count.max()), 3), np.nan)
    points[group[order], place] = touches.position[order]
    used = np.zeros(points.shape[:2], dtype=np.bool_)
    used[group[order], place] = True
    return numbers, points, used, first


def _check_diameter(points: Floats, used: np.ndarray, radius: float, tip_radius: float) -> None:
    """Compare freely fitted radii with the stated one: they tell a wrong ball or tip."""
    free = fit_spheres(points, radius=None, tip_radius=tip_radius, used=used, reject=False)
    good = np.array([not reason for reason in free.reason])
    if not good.any():
        return  # refused one by one later, with the reason
    found = float(np.median(free.radii[good]))
    doubt = float(np.median(free.std[good]))
    if abs(found - radius) > max(DIAMETER_TOLERANCE, 5.0 * doubt):
        raise DataError(
            f"the touch points lie on balls of diameter {2.0 * found / MILLIMETRE:.4f} mm with "
            f"the tip radius {tip_radius / MILLIMETRE:.4f} mm, the plate says "
            f"{2.0 * radius / MILLIMETRE:.4f} mm: check ball diameter and tip radius"
        )
