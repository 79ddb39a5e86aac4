"""Figures and tables of the laser-tracer method: residuals, and the stations on their circle."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.components import COVERAGE_FACTOR
from rotcal_ros.foundation.language import phrase
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import ARCSEC, DEGREE, MICROMETRE, MILLIMETRE
from rotcal_ros.methods.figures import Figure, style
from rotcal_ros.methods.figures.residuals import residual_figures
from rotcal_ros.methods.figures.style import name_places
from rotcal_ros.methods.result_tables import ResultTable, by_axis, corrections_table

MOST_NAMES: Final = 40
"""Targets whose numbers still fit into the plan view."""


def figures(result: Result, _truth: Mapping[str, Any] | None = None) -> list[Figure]:
    """Return the figures that only this method can fill."""
    return [
        *residual_figures(result),
        Figure(
            "Set-up in plan view",
            "Axis of the table, stations of the tracer on their circle, and targets, from above.",
            set_up(result),
            "set-up",
        ),
        Figure(
            "Stations on their circle",
            "Solved stations on their circle with strongly exaggerated errors.",
            stations(result),
        ),
    ]


@style.house_style
def set_up(result: Result) -> str:
    """Draw the circle of the stations about the axis and the targets, from above, to scale."""
    details = result.details
    if not {"stations", "targets", "circle"} <= details.keys():
        return ""
    stations_mm = np.asarray(details["stations"], dtype=np.float64)[:, :2] / MILLIMETRE
    targets_mm = np.asarray(details["targets"], dtype=np.float64)[:, :2] / MILLIMETRE
    centre = np.asarray(details["circle"]["centre"], dtype=np.float64)[:2] / MILLIMETRE
    (ax,) = style.grid(height=5.2)
    turn = np.linspace(0.0, 2.0 * np.pi, 181)
    radius = float(details["circle"]["radius"]) / MILLIMETRE
    circle = centre + radius * np.column_stack([np.cos(turn), np.sin(turn)])
    ax.plot(*circle.T, color=style.GREY, linewidth=0.9, label="circle of the stations")
    ax.plot(*stations_mm.T, "o", color=style.BLUE, markersize=4, label="stations of the tracer")
    ax.plot(*targets_mm.T, "x", color=style.ORANGE, label="targets")
    ax.plot(*centre, "+", color=style.INK, markersize=10, label="axis of the table")
    if len(targets_mm) <= MOST_NAMES:
        name_places(ax, details["target_ids"], targets_mm)
    ax.set_aspect("equal")
    ax.set_xlabel("x / mm")
    ax.set_ylabel("y / mm")
    return style.svg(ax)


@style.house_style
def stations(result: Result) -> str:
    """Draw the stations in plan view with the fitted circle, their errors exaggerated."""
    details = result.details
    if "stations" not in details or "circle" not in details:
        return ""
    points = np.asarray(details["stations"], dtype=np.float64)[:, :2]
    centre = np.asarray(details["circle"]["centre"], dtype=np.float64)[:2]
    radius = float(details["circle"]["radius"])
    arms = points - centre
    nominal = centre + radius * arms / np.linalg.norm(arms, axis=1, keepdims=True)
    tangent = np.column_stack([-arms[:, 1], arms[:, 0]]) / radius
    turned = np.asarray(details.get("station_deviations", result.deviations["ECC"]))
    error = (points - nominal) + tangent * (radius * turned)[:, None]
    largest = float(np.max(np.linalg.norm(error, axis=1)))
    scale = 0.25 * radius / largest if largest > 0 else 1.0
    (ax,) = style.grid(height=5.6)
    turn = np.linspace(0.0, 2.0 * np.pi, 361)
    circle = centre + radius * np.column_stack([np.cos(turn), np.sin(turn)])
    ax.plot(*(circle / MILLIMETRE).T, color=style.GREY, linewidth=0.9, label="fitted circle")
    ax.plot(*(nominal / MILLIMETRE).T, "o", color=style.INK, markersize=3, label="stations")
    ax.quiver(
        *(nominal / MILLIMETRE).T, *(error * scale / MILLIMETRE).T, color=style.ORANGE,
        angles="xy", scale_units="xy", scale=1, width=0.005,
        label=phrase("error × {0:,.0f}", scale),
    )  # fmt: skip
    ax.set_aspect("equal")
    ax.set_xlabel("x / mm")
    ax.set_ylabel("y / mm")
    return style.svg(ax)


def tables(result: Result) -> list[ResultTable]:
    """Return stations with what they leave plane and circle by, targets, and the circle."""
    details = result.details
    if not {"stations", "circle", "plane"} <= details.keys():
        return []
    places = _array(details["stations"])
    normal, axial = _array(details["plane"]["normal"]), _array(details["axial"])
    columns: dict[str, Any] = {"position": details["station_ids"]}
    projected = places - axial[:, None] * normal
    columns |= by_axis("{}_mm", places, MILLIMETRE)
    columns |= by_axis("projected_{}_mm", projected, MILLIMETRE)
    if "station_std" in details:
        expanded = COVERAGE_FACTOR * _array(details["station_std"])
        columns |= by_axis("U_{}_um", expanded, MICROMETRE)
    if "distances" in details:
        columns["d_mm"] = _array(details["distances"]) / MILLIMETRE
    columns["axial_um"] = axial / MICROMETRE
    columns["radial_um"] = _array(details["radial"]) / MICROMETRE
    return [
        ResultTable.of(
            "stations", "Stations of the tracer, and as projected on their plane", **columns
        ),
        *lines_table(details, float(details["circle"]["radius"])),
        *_targets(details),
        *corrections_table(details),
        _circle(details),
    ]


def lines_table(details: Mapping[str, Any], radius: float) -> list[ResultTable]:
    """Return the lines in what a table that turned left of the lengths, if there are any.

    ``radius`` (m) of the circle of the tracer.
    """
    lines = details.get("turning", {}).get("lines", [])
    if not lines:
        return []
    column = {name: _array([line[name] for line in lines]) for name in lines[0]}
    return [
        ResultTable.of(
            "lines",
            "Lines in the spectrum of the residuals; ECC: were they as large along the circle",
            **{
                "speed_deg/s": column["speed"] / DEGREE,
                "order": column["order"],
                "frequency_Hz": column["frequency"],
                "amplitude_um": column["amplitude"] / MICROMETRE,
                "ECC_arcsec": column["amplitude"] / radius / ARCSEC,
                "likeness": np.round(column["likeness"], 2),
            },
        )
    ]


def _targets(details: Mapping[str, Any]) -> list[ResultTable]:
    if "targets" not in details:
        return []
    columns = by_axis("{}_mm", details["targets"], MILLIMETRE)
    return [ResultTable.of("targets", "Targets", target=details["target_ids"], **columns)]


def _circle(details: Mapping[str, Any]) -> ResultTable:
    """Return plane and circle of the stations, and the figures of Eq. 34 and 36."""
    centre, normal = details["circle"]["centre"], details["plane"]["normal"]
    errors = np.abs(_array(details["algorithm_error"]))
    rows = [
        *(
            (phrase("normal {0}", axis), float(n), "1")
            for axis, n in zip("xyz", normal, strict=True)
        ),
        *(
            (phrase("centre {0}", axis), float(c) / MILLIMETRE, "mm")
            for axis, c in zip("xyz", centre, strict=True)
        ),
        ("radius", float(details["circle"]["radius"]) / MILLIMETRE, "mm"),
        ("lean of the axis (Eq. 35)", float(details["tilt"]) / ARCSEC, "arcsec"),
        (
            "sigma of the steps (Eq. 34, with their number)",
            float(details["scatter"]) / ARCSEC,
            "arcsec",
        ),
        ("largest algorithm error (Eq. 36)", float(errors.max(initial=0.0)) / ARCSEC, "arcsec"),
    ]
    return ResultTable(
        "circle", "Plane and circle of the stations", ("quantity", "value", "unit"), tuple(rows)
    )


def _array(values: Any) -> Floats:
    return np.asarray(values, dtype=np.float64)
