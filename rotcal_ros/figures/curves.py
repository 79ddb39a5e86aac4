"""Figures that all methods share: deviations, steps, temperature.

Every function returns inline SVG, or an empty string where the result has nothing to show.
Angles are drawn in degrees, rotations in arcseconds, translations in micrometres; bands are
expanded uncertainties with k = 2.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from rotcal_ros.components import COMPONENTS, COVERAGE_FACTOR, unit_of
from rotcal_ros.figures import style
from rotcal_ros.observations import Observation
from rotcal_ros.results import Result
from rotcal_ros.units import ARCSEC, DEGREE, NANOSECOND


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


def _draw_truth(ax: style.Axes, name: str, truth: Mapping[str, Any] | None) -> None:
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
