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
from numpy.typing import NDArray

from rotcal_ros.adjust.engine import Adjusted
from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.components import COVERAGE_FACTOR
from rotcal_ros.foundation.language import phrase
from rotcal_ros.foundation.units import DEGREE, MICROMETRE, MILLIMETRE
from rotcal_ros.geometry.rotations import rotation_about_z
from rotcal_ros.methods.figures import Figure, style
from rotcal_ros.methods.result_tables import ResultTable
from rotcal_ros.methods.table_balls.model import BallsOnTable, local_directions

OF_CENTRES: Final = ("radial", "tangential", "axial")
OF_LENGTHS: Final = ("length",)
"""Directions of what is read."""
SHARE: Final = 0.2
"""How far the farthest centre is drawn from its circle, per radius."""


def trajectories(balls: BallsOnTable, found: Adjusted) -> dict[str, Any]:
    """Return the means of all runs at each angle, and the ranges; metres, for details of a result.

    ``balls`` are those of what was read. ``tilt``, ``target``, ``angle`` (m,): at which tilt, of
    which ball or bar, at which angle (rad, counter-clockwise) the ``value`` (m, c) is, along c
    ``directions``; ``std`` (m, c): what the noise of the readings makes of it. ``ranges``: largest
    less smallest value of each target at each tilt. ``places`` (k, 3): nominal ones of the balls
    from the nominal axis, at angle 0.
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
        "angle": balls.angles[position],
        "directions": list(OF_LENGTHS if len(balls.bars) else OF_CENTRES),
        "value": value,
        "std": noise,
        "ranges": _ranges(each, value, noise),
        "places": balls.places,
    }


def _readings(balls: BallsOnTable, found: Adjusted) -> tuple[Floats, Floats, Bools]:
    """Return what each reading is off (n, c), its standard deviation, and whether it is used."""
    c, n = balls.coordinates, len(balls.target)
    read = found.model.observed[: n * c].reshape(n, c)
    std = found.fit.std[: n * c].reshape(n, c)
    used = np.asarray(found.fit.used[: n * c].reshape(n, c).all(axis=1))
    if len(balls.bars):
        return read - np.linalg.norm(balls.arms, axis=1)[balls.target][:, None], std, used
    flat = read if balls.tilting is None else balls.tilting.remove_tilt(read, balls.tilt)
    turn = rotation_about_z(balls.angles[balls.position])
    on_table = np.einsum("nji,nj->ni", turn, flat - balls.origin) - balls.places[balls.target]
    away = np.einsum("nij,nj->ni", local_directions(balls.places)[balls.target], on_table)
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
    directions, ranges = (details["trajectories"][name] for name in ("directions", "ranges"))
    columns: dict[str, Floats] = {}
    if "tilts" in details:
        columns["tilt_deg"] = np.asarray(details["tilts"])[np.asarray(ranges["tilt"])] / DEGREE
    for k, name in enumerate(directions):
        columns[f"{name}_um"] = np.asarray(ranges["value"])[:, k] / MICROMETRE
        expanded = COVERAGE_FACTOR * np.asarray(ranges["std"])[:, k]
        columns[f"U_{name}_um"] = expanded / MICROMETRE
    return ResultTable.of(
        "trajectories",
        "Ranges of what was read beside the nominal way of each ball or bar (ISO 10791-6)",
        target=ranges["target"],
        **columns,
    )


def way_figures(ways: Mapping[str, Any]) -> list[Figure]:
    """Return the figure of :func:`trajectories`; none of lengths, which have no places."""
    if tuple(ways["directions"]) != OF_CENTRES:
        return []
    return [
        Figure(
            "Circles of centres",
            "Where the centres were read at the first tilt, less their mean place on the table; "
            "deviations from the nominal circles are enlarged.",
            _circles(ways),
        )
    ]


@style.house_style
def _circles(ways: Mapping[str, Any]) -> str:
    tilt, target = np.asarray(ways["tilt"]), np.asarray(ways["target"])
    angle, off = np.asarray(ways["angle"]), np.asarray(ways["value"]) @ [1.0, 1.0j, 0.0]
    places = np.asarray(ways["places"]) @ [1.0, 1.0j, 0.0]
    of_ball = {k: (tilt == tilt.min()) & (target == k) for k in range(len(places))}
    of_ball = {k: mine for k, mine in of_ball.items() if mine.any()}
    away = {k: off[mine] - off[mine].mean() for k, mine in of_ball.items()}
    farthest = max(np.abs(each).max() for each in away.values())
    by = float(f"{SHARE * np.abs(places).max() / farthest:.1g}") if farthest else 1.0
    (ax,) = style.grid(height=5.0)
    turn = np.exp(1j * np.linspace(0.0, 2.0 * np.pi, 181))
    for ball, each in away.items():
        _draw(ax, np.abs(places[ball]) * turn, color=style.GREY, linewidth=0.8)
        out = np.exp(1j * (angle[of_ball[ball]] + np.angle(places[ball])))
        there = (np.abs(places[ball]) + by * each) * out
        _draw(ax, there, marker="o", markersize=3, label=f"ball {ball}")
    ax.set_aspect("equal")
    ax.set_xlabel("x / mm")
    ax.set_ylabel("y / mm")
    ax.set_title(phrase("deviations {0:,.0f} times", by))
    return style.svg(ax)


def _draw(ax: style.Axes, points: NDArray[np.complex128], **look: Any) -> None:
    ax.plot(points.real / MILLIMETRE, points.imag / MILLIMETRE, **look)
