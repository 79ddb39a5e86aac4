"""How far balls are from where nominal axes take them: the trajectories of ISO 10791-6.

Its tests BK1 and BK2 let the linear axes follow a point of the turning table, and state the range
of what a ball bar or an R-test reads meanwhile: outward from the axis (radial), along the way of
the ball (tangential) and up (axial). A place that the ball has on the table drops out of a range;
an axis that stands elsewhere, leans, or moves does not. So these are the values of the machine as
its control knows it, before anything that the calibration finds is set.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from rotcal_ros.adjust.engine import Adjusted
from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.components import COVERAGE_FACTOR
from rotcal_ros.foundation.units import DEGREE, MICROMETRE, MILLIMETRE
from rotcal_ros.geometry.rotations import rotation_about_z
from rotcal_ros.methods.figures import style
from rotcal_ros.methods.result_tables import ResultTable
from rotcal_ros.methods.table_balls.model import BallsOnTable, around

OF_CENTRES: Final = ("radial", "tangential", "axial")
OF_LENGTHS: Final = ("length",)
"""Directions of what is read."""
SHARE: Final = 0.2
"""How far the farthest centre is drawn from its circle, per radius."""


def trajectories(balls: BallsOnTable, found: Adjusted) -> dict[str, Any]:
    """Return the means of all runs at each angle, and the ranges; metres, for details of a result.

    ``balls`` are those of what was read. ``position``, ``target``, ``tilt`` (m,): of which angle,
    ball or bar and tilt the ``value`` (m, c) is, c directions; ``std`` (m, c) as from the noise of
    the readings alone. ``ranges``: largest less smallest value of each target in each direction.
    """
    away, std, used = _readings(balls, found)
    keys = np.column_stack([balls.tilt, balls.target, balls.position])[used]
    each, which = np.unique(keys, axis=0, return_inverse=True)
    count = np.bincount(which.ravel(), minlength=len(each))[:, None]

    def total(values: Floats) -> Floats:
        found = np.zeros((len(each), values.shape[1]))
        np.add.at(found, which.ravel(), values[used])
        return found

    value, noise = total(away) / count, np.sqrt(total(std**2)) / count
    tilt, target, position = each.T
    return {
        "tilt": tilt,
        "target": target,
        "position": position,
        "directions": list(OF_LENGTHS if len(balls.bars) else OF_CENTRES),
        "value": value,
        "std": noise,
        "ranges": _ranges(each, value, noise),
    }


def _readings(balls: BallsOnTable, found: Adjusted) -> tuple[Floats, Floats, Bools]:
    """Return what each reading is off (n, c), its standard deviation, and whether it is used."""
    c, n = balls.coordinates, len(balls.target)
    read = found.model.observed[: n * c].reshape(n, c)
    std = found.fit.std[: n * c].reshape(n, c)
    used = np.asarray(found.fit.used[: n * c].reshape(n, c).all(axis=1))
    if len(balls.bars):
        return read - np.linalg.norm(balls.arms, axis=1)[balls.target][:, None], std, used
    flat = read if balls.tilting is None else balls.tilting.back(read, balls.tilt)
    turn = rotation_about_z(balls.angles[balls.position])
    on_table = np.einsum("nji,nj->ni", turn, flat - balls.origin) - balls.places[balls.target]
    away = np.einsum("nij,nj->ni", around(balls.places)[balls.target], on_table)
    return away, np.sqrt((std**2).mean(axis=1, keepdims=True)) * np.ones(c), used


def _ranges(each: Ints, value: Floats, std: Floats) -> dict[str, Any]:
    """Return the ranges (r, c) of each ball or bar at each tilt, with standard uncertainties."""
    kinds = np.unique(each[:, :2], axis=0)
    found, uncertain = np.zeros((2, len(kinds), value.shape[1]))
    for k, kind in enumerate(kinds):
        own, noise = (part[(each[:, :2] == kind).all(axis=1)] for part in (value, std))
        ends = np.array([own.argmax(axis=0), own.argmin(axis=0)])
        found[k] = np.ptp(own, axis=0)
        uncertain[k] = np.linalg.norm(np.take_along_axis(noise, ends, axis=0), axis=0)
    return {"tilt": kinds[:, 0], "target": kinds[:, 1], "value": found, "std": uncertain}


def table_of_ranges(details: Mapping[str, Any]) -> ResultTable:
    """Return the ranges as a table, with U (k = 2)."""
    told = details["trajectories"]
    ranges, columns = told["ranges"], {}
    for k, name in enumerate(told["directions"]):
        for head, values in (("", ranges["value"]), ("U_", ranges["std"])):
            factor = COVERAGE_FACTOR if head else 1.0
            columns[f"{head}{name}_um"] = factor * np.asarray(values)[:, k] / MICROMETRE
    tilts = np.asarray(details.get("tilts", [0.0])) / DEGREE
    if len(tilts) > 1:
        columns = {"tilt_deg": tilts[np.asarray(ranges["tilt"])], **columns}
    return ResultTable.of(
        "trajectories",
        "Range of the readings at each ball or bar, less the nominal way (ISO 10791-6)",
        target=ranges["target"],
        **columns,
    )


@style.styled
def circles(angles: Floats, details: Mapping[str, Any], radius: Mapping[int, float]) -> str:
    """Draw where centres were read at ``angles`` (n,), rad, enlarged, beside their circles.

    ``radius``: that of each ball, m. At the first tilt. Empty for lengths.
    """
    told = details["trajectories"]
    if tuple(told["directions"]) != OF_CENTRES:
        return ""
    first, target = np.asarray(told["tilt"]) == 0, np.asarray(told["target"])
    off = np.asarray(told["value"])[first, :2]
    off = off - [off[target[first] == t].mean(axis=0) for t in target[first]]
    by = SHARE * max(radius.values()) / np.abs(off).max()
    (ax,) = style.grid(height=5.0)
    turn = np.linspace(0.0, 2.0 * np.pi)
    for number, r in radius.items():
        ax.plot(r * np.cos(turn) / MILLIMETRE, r * np.sin(turn) / MILLIMETRE, color=style.GREY)
        of_it = target[first] == number
        at = np.asarray(angles)[np.asarray(told["position"])[first][of_it]]
        out, along = off[of_it].T * by
        x, y = (
            (r + out) * np.cos(at) - along * np.sin(at),
            (r + out) * np.sin(at) + along * np.cos(at),
        )
        ax.plot(x / MILLIMETRE, y / MILLIMETRE, "o-", label=f"ball {number}", markersize=3)
    ax.set_aspect("equal")
    ax.set_xlabel("x / mm")
    ax.set_ylabel("y / mm")
    ax.set_title(f"deviations {by:.0f} times")
    return style.svg(ax)
