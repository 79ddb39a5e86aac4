"""Figures that all methods share: deviations, steps, temperature.

Every function returns inline SVG, or an empty string where the result has nothing to show.
Angles are drawn in degrees, rotations in arcseconds, translations in micrometres; bands are
expanded uncertainties with k = 2.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.components import COVERAGE_FACTOR, unit_of
from rotcal_ros.foundation.language import phrase
from rotcal_ros.foundation.observations import Observation
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import ARCSEC, DEGREE, NANOSECOND
from rotcal_ros.methods.figures import style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MEASURED: Final = "measured, with U (k = 2)"
LARGE: Final = 12.0
"""Times its widest band that a curve spans when the band can no longer be seen beside it."""


@style.house_style
def deviations(
    result: Result, truth: Mapping[str, Any] | None = None, *, valid: bool = True
) -> str:
    """Draw every measured deviation over the table angle with its band, and the truth if known.

    Where the curve is large beside its band, a panel below has the band on its own scale, about
    zero, and in it what the injected truth is off. ``valid``: whether the band may be believed.
    """
    return style.svg(_deviation_panels(result, truth, valid=valid))


@style.house_style
def plot(result: Result, truth: Mapping[str, Any] | None = None) -> Figure:
    """Return the same as a figure of Matplotlib; see :meth:`~.results.Result.plot`."""
    return style.finish_figure(_deviation_panels(result, truth, valid=result.verdict == "ok"))


def _deviation_panels(
    result: Result, truth: Mapping[str, Any] | None, *, valid: bool
) -> style.Axes:
    names = result.components
    band = {name: COVERAGE_FACTOR * float(result.std[name].max()) for name in names}
    large = any(np.ptp(result.deviations[name]) > LARGE * band[name] > 0.0 for name in names)
    columns = 1 if len(names) <= 2 else 3
    blocks = -(-len(names) // columns)
    tall = 2.2 if columns == 1 else 1.6
    heights = [tall, 0.55 * tall] if large else [1.2 * tall]
    panels = style.grid(
        blocks * len(heights), columns, height=sum(heights) / len(heights),
        height_ratios=heights * blocks, sharex="col",
    )  # fmt: skip
    for number, name in enumerate(names):
        block, column = divmod(number, columns)
        top = panels[block * columns * len(heights) + column]
        _draw_curve(top, result, name, truth, valid=valid)
        if large:
            own = panels[(block * len(heights) + 1) * columns + column]
            _draw_band(own, result, name, truth, valid=valid)
    for ax in panels[-columns:]:
        style.angle_axis(ax, result.angles / DEGREE)
    for ax in panels:
        if not ax.has_data():
            ax.set_axis_off()
    return panels[0]


def _draw_curve(
    ax: style.Axes, result: Result, name: str, truth: Mapping[str, Any] | None, *, valid: bool
) -> None:
    factor, unit = unit_of(name)
    band = COVERAGE_FACTOR * result.std[name] / factor
    angles, values = result.angles / DEGREE, result.deviations[name] / factor
    both = result.directions.get(name)
    label = MEASURED if both is None else phrase("mean of ↑ and ↓, {0}", phrase(MEASURED))
    style.curve_with_band(ax, angles, values, band, label, valid=valid)
    if both is not None:
        x = both.angles / DEGREE
        ax.plot(x, both.forward / factor, color=style.GREEN, lw=0.9, label="↑ forward")
        ax.plot(x, both.reverse / factor, color=style.INK, lw=0.9, label="↓ reverse")
    _draw_truth(ax, name, truth)
    ax.set_ylabel(f"{name} / {unit}")


def _draw_band(
    ax: style.Axes, result: Result, name: str, truth: Mapping[str, Any] | None, *, valid: bool
) -> None:
    factor, unit = unit_of(name)
    band = COVERAGE_FACTOR * result.std[name] / factor
    angles = result.angles / DEGREE
    style.band_about(ax, angles, np.zeros_like(band), band, style.BLUE, valid=valid)
    ax.axhline(0.0, color=style.GREY, linewidth=0.8)
    ax.set_ylabel(f"±U / {unit}")
    known = injected(truth, name, result.angles)
    if known is None:
        return
    error = (result.deviations[name] - known) / factor
    ax.plot(angles, error, "s:", color=style.ORANGE, ms=3, lw=0.9, label="measured − injected")
    ax.set_ylabel(phrase("error, ±U / {0}", unit))


def injected(truth: Mapping[str, Any] | None, name: str, angles: Floats) -> Floats | None:
    """Return what a simulation injected at ``angles`` (n,), rad; None where it does not say."""
    if truth is None or name not in truth.get("deviations", {}):
        return None
    known_at, first = np.unique(np.asarray(truth["angles_rad"]), return_index=True)
    known = np.asarray(truth["deviations"][name], dtype=np.float64)[first]
    return np.asarray(np.interp(angles, known_at, known), dtype=np.float64)


def _draw_truth(ax: style.Axes, name: str, truth: Mapping[str, Any] | None) -> None:
    if truth is None or name not in truth.get("deviations", {}):
        return
    factor, _ = unit_of(name)
    angles = np.asarray(truth["angles_rad"]) / DEGREE
    values = np.asarray(truth["deviations"][name]) / factor
    ax.plot(
        angles, values, "--", color=style.ORANGE, linewidth=1.3, label="injected by the simulation"
    )


Motion = tuple[str, Floats, Floats, float, str]
"""Name, values and standard uncertainties (n,), factor and label of the unit that is drawn."""


@style.house_style
def polar(angles: Floats, motions: Sequence[Motion]) -> str:
    """Draw ``motions`` at ``angles`` (n,), rad, each about a circle on which it is zero."""
    columns, turn = min(len(motions), 3), np.append(angles, angles[0] + 2.0 * np.pi)
    rows = -(-len(motions) // columns)
    panels = style.grid(rows, columns, height=2.8, subplot_kw={"projection": "polar"})
    for ax, (name, values, std, factor, unit) in zip(panels, motions, strict=False):
        shown, band = np.asarray(values) / factor, COVERAGE_FACTOR * np.asarray(std) / factor
        circle = 2.0 * float((np.abs(shown) + band).max())
        around, width = (np.append(v, v[0]) for v in (shown + circle, band))
        style.band_about(ax, turn, around, width, style.BLUE)
        ax.plot(turn, around, "o-", color=style.BLUE, markersize=3)
        ax.plot(np.linspace(0.0, 2.0 * np.pi, 90), np.full(90, circle), color=style.GREY)
        ax.set_yticklabels([])
        ax.set_title(phrase("{0}, circle: {1:.3g} {2}", name, circle, unit), fontsize=8)
    for ax in panels[len(motions) :]:
        ax.set_visible(False)
    return style.svg(panels[0])


@style.house_style
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
    style.angle_axis(ax, result.angles / DEGREE, "middle of the step / °")
    ax.set_ylabel("adjacent deviation / arcsec")
    return style.svg(ax)


@style.house_style
def temperature(observations: Sequence[Observation]) -> str:
    """Draw the temperature at the observations over the time since the first one."""
    readings = [
        (o.window_end_ns, o.temperature_c) for o in observations if o.temperature_c is not None
    ]
    if len(readings) < 2:
        return ""
    stamps, values = np.array(readings, dtype=np.float64).T
    (ax,) = style.grid(height=2.2)
    ax.plot(
        (stamps - stamps.min()) * NANOSECOND / 60.0, values, ".", color=style.GREEN, markersize=3
    )
    ax.set_xlabel("time since the first observation / min")
    ax.set_ylabel("temperature / °C")
    return style.svg(ax)
