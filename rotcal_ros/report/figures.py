"""Figures of a result: deviations, steps, residuals, stations, temperature.

Every function returns inline SVG, or an empty string where the result has nothing to show.
Angles are drawn in degrees, rotations in arcseconds, translations in micrometres; bands are
expanded uncertainties with k = 2.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from rotcal_ros.observations import Observation
from rotcal_ros.report import style
from rotcal_ros.report.units import unit_of
from rotcal_ros.results import COMPONENTS, Result
from rotcal_ros.units import ARCSEC, DEGREE, MICROMETRE, NANOSECOND

COVERAGE_FACTOR = 2.0


@style.styled
def deviations(result: Result, truth: Mapping[str, Any] | None = None) -> str:
    """Draw every measured deviation over the table angle with its band, and the truth if known."""
    names = [name for name in COMPONENTS if name in result.deviations]
    angles = result.angles / DEGREE
    panels = style.grid(len(names), height=2.9)
    for ax, name in zip(panels, names, strict=True):
        factor, unit = unit_of(name)
        band = COVERAGE_FACTOR * result.std[name] / factor
        style.curve_with_band(
            ax, angles, result.deviations[name] / factor, band, "measured, k = 2"
        )
        _draw_truth(ax, name, truth)
        ax.set_ylabel(f"{name} / {unit}")
        ax.set_xlabel("commanded table angle / °")
        ax.legend(loc="best")
    return style.svg(panels[0])


def _draw_truth(ax: Axes, name: str, truth: Mapping[str, Any] | None) -> None:
    if truth is None or name not in truth.get("deviations", {}):
        return
    factor, _ = unit_of(name)
    angles = np.asarray(truth["angles_rad"]) / DEGREE
    values = np.asarray(truth["deviations"][name]) / factor
    ax.plot(
        angles, values, "--", color=style.ORANGE, linewidth=1.3, label="injected by the simulation"
    )


@style.styled
def adjacent(result: Result) -> str:
    """Draw the deviations of the steps between neighbouring angles as bars with k = 2 whiskers."""
    if result.adjacent_deviations is None:
        return ""
    (ax,) = style.grid()
    middle = (result.angles[1:] + result.angles[:-1]) / 2 / DEGREE
    width = 0.6 * np.min(np.diff(result.angles)) / DEGREE
    std = result.adjacent_std
    whiskers = None if std is None else COVERAGE_FACTOR * std / ARCSEC
    ax.bar(
        middle, result.adjacent_deviations / ARCSEC, width, yerr=whiskers,
        color=style.BLUE, alpha=0.75, ecolor=style.INK, capsize=2,
    )  # fmt: skip
    ax.axhline(0.0, color=style.GREY, linewidth=0.8)
    ax.set_xlabel("middle of the step / °")
    ax.set_ylabel("adjacent deviation / arcsec")
    return style.svg(ax)


@style.styled
def residuals(result: Result) -> str:
    """Draw residuals by table angle and by target; what was not used is marked."""
    rows = result.residuals
    if rows is None:
        return ""
    left, right = style.grid(1, 2, sharey=True)
    for ax, index, label in (
        (left, rows.table_index, "table position (index)"),
        (right, rows.target, "target (index)"),
    ):
        _scatter_residuals(ax, index, rows.residual, rows.used)
        ax.set_xlabel(label)
        style.whole_numbers(ax.xaxis)
    left.set_ylabel("residual / µm")
    right.legend(loc="best")
    return style.svg(left)


def _scatter_residuals(
    ax: Axes,
    index: NDArray[np.int64],
    residual: NDArray[np.float64],
    used: NDArray[np.bool_],
) -> None:
    ax.scatter(
        index[used], residual[used] / MICROMETRE, s=7, color=style.BLUE, alpha=0.55, label="used"
    )
    if not used.all():
        ax.scatter(
            index[~used], residual[~used] / MICROMETRE, s=26, color=style.RED, marker="x",
            label="rejected",
        )  # fmt: skip
    ax.axhline(0.0, color=style.GREY, linewidth=0.8)


@style.styled
def residual_map(result: Result) -> str:
    """Draw the normalised residual of every table position and target as a map.

    Where a cell would hold several residuals there is no map.
    """
    rows = result.residuals
    if rows is None or rows.test_value.size == 0:
        return ""
    cells = np.column_stack([rows.table_index, rows.target])
    if len(np.unique(cells, axis=0)) < len(cells):
        return ""
    grid = np.full((rows.table_index.max() + 1, rows.target.max() + 1), np.nan)
    grid[rows.table_index, rows.target] = rows.test_value
    (ax,) = style.grid(height=2.6)
    ax.grid(visible=False)
    ax.set_facecolor(style.MISSING)
    image = ax.imshow(grid, cmap="RdBu_r", vmin=-4, vmax=4, aspect="auto", interpolation="nearest")
    ax.set_xlabel("target (index)")
    ax.set_ylabel("table position")
    style.whole_numbers(ax.xaxis)
    style.whole_numbers(ax.yaxis)
    ax.figure.colorbar(image, ax=ax, label="normalised residual")
    return style.svg(ax)


@style.styled
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
    ax.plot(*(circle / 1e-3).T, color=style.GREY, linewidth=0.9, label="fitted circle")
    ax.plot(*(nominal / 1e-3).T, "o", color=style.INK, markersize=3, label="stations")
    ax.quiver(
        *(nominal / 1e-3).T, *(error * scale / 1e-3).T, color=style.ORANGE, angles="xy",
        scale_units="xy", scale=1, width=0.005, label=f"error × {scale:,.0f}",
    )  # fmt: skip
    ax.set_aspect("equal")
    ax.set_xlabel("x / mm")
    ax.set_ylabel("y / mm")
    ax.legend(loc="center")
    return style.svg(ax)


@style.styled
def temperature(observations: Sequence[Observation]) -> str:
    """Draw the temperature at the observations over the time since the first one."""
    known = [
        (o.window_end_ns, o.temperature_c) for o in observations if o.temperature_c is not None
    ]
    if len(known) < 2:
        return ""
    stamps, values = np.array(known, dtype=np.float64).T
    (ax,) = style.grid(height=2.2)
    ax.plot(
        (stamps - stamps.min()) * NANOSECOND / 60.0, values, ".", color=style.GREEN, markersize=3
    )
    ax.set_xlabel("time since the first observation / min")
    ax.set_ylabel("temperature / °C")
    return style.svg(ax)
