"""Figures of a result whose details contain tracker stations, nests and mirror normals.

Like :mod:`~rotcal_ros.methods.figures.curves`: inline SVG, or an empty string where there is
nothing to show. The details may come from a solution or from its JSON form.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.components import COVERAGE_FACTOR
from rotcal_ros.foundation.language import phrase
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import ARCSEC, DEGREE, MICROMETRE, MILLIMETRE
from rotcal_ros.methods.figures import Figure, style
from rotcal_ros.methods.figures.curves import injected
from rotcal_ros.methods.figures.residuals import residual_figures
from rotcal_ros.methods.result_tables import ResultTable, by_axis

_TURNS = ((2, style.BLUE, "azimuth"), (0, style.ORANGE, "tilt x"), (1, style.GREEN, "tilt y"))


def figures(result: Result, truth: Mapping[str, Any] | None = None) -> list[Figure]:
    """Return the figures that only this method can fill."""
    reference = phrase("the injected deviations") if truth else phrase("the chosen way")
    return [
        Figure(
            "The ways side by side",
            phrase(
                "The same points solved in every way, the chosen one first. Above the "
                "deviations, below their difference from {0}; the bands are expanded "
                "uncertainties (k = 2).",
                reference,
            ),
            ways(result, truth),
        ),
        Figure(
            "Tracker stations and nests",
            "Plan view along the table axis, in the frame of the first station: where the nests "
            "put each station of the tracker.",
            station_map(result.details),
            "set-up",
        ),
        Figure(
            "Angles of incidence",
            "Angle between the beam and the mirror's normal at each position, by tracker station.",
            incidence(result.details),
            "set-up",
        ),
        Figure(
            "Nest residuals",
            "Length of the residual in micrometres of each nest seen from each station, the "
            "largest of several rounds; the colour is the normalised residual, for which 1 is "
            "expected.",
            nest_residuals(result.details),
            "residuals",
        ),
        Figure(
            "Drift of the tracker",
            "What the nests measured again show at each station, from its first nest to its last: "
            "taken away, with expanded uncertainties (k = 2).",
            drift(result.details),
        ),
        *residual_figures(result),
    ]


@style.house_style
def ways(result: Result, truth: Mapping[str, Any] | None = None) -> str:
    """Draw the deviation curves of all ways with their bands, and their differences."""
    others = [way for way in result.details.get("ways", ()) if "ecc_rad" in way]
    if not others:
        return ""
    own: tuple[Floats, ...] = (result.angles, result.deviations["ECC"], result.std["ECC"])
    curves = {str(result.details["way"]): own}
    names = ("angles_rad", "ecc_rad", "ecc_std_rad")
    curves |= {str(way["way"]): tuple(_array(way[name]) for name in names) for way in others}
    panels = style.grid(2, len(curves), height=2.5, sharex=True, sharey="row")
    for number, (name, (angles, ecc, std)) in enumerate(curves.items()):
        top, bottom = panels[number], panels[number + len(curves)]
        band = COVERAGE_FACTOR * std / ARCSEC
        known = injected(truth, "ECC", angles)
        reference = np.interp(angles, own[0], own[1]) if known is None else known
        style.curve_with_band(top, angles / DEGREE, ecc / ARCSEC, band, "measured")
        if known is not None:
            top.plot(angles / DEGREE, known / ARCSEC, "--", color=style.ORANGE, linewidth=1.2,
                     label="injected")  # fmt: skip
        style.curve_with_band(
            bottom, angles / DEGREE, (ecc - reference) / ARCSEC, band, "difference"
        )
        top.set_title(name, fontsize=10)
        style.angle_axis(bottom, angles / DEGREE, "table angle / °")
    panels[0].set_ylabel("ECC / arcsec")
    panels[len(curves)].set_ylabel("difference / arcsec")
    return style.svg(panels[0])


@style.house_style
def station_map(details: Mapping[str, Any]) -> str:
    """Draw stations and nests in plan view, with a line from each station to what it saw."""
    stands, nests = details.get("stations", ()), details.get("nests", ())
    if not (_mappings(stands) and _mappings(nests) and "axis" in details):
        return ""
    axis, x = _array(details["axis"]), np.array([1.0, 0.0, 0.0])
    first = x - (x @ axis) * axis  # across the axis, as much along x as can be
    first = first / np.linalg.norm(first)
    across = np.column_stack([first, np.cross(axis, first)])
    places = {s["station"]: _array(s["position_m"]) @ across for s in stands}
    (ax,) = style.grid(height=5.4)
    for nest in nests:
        line = np.array([places[nest["station"]], _array(nest["position_m"]) @ across])
        ax.plot(*line.T, color=style.MISSING, linewidth=0.6, zorder=1)
    seen = {n["nest"]: _array(n["position_m"]) @ across for n in nests}
    _draw_points(ax, seen, "s", style.GREEN, "nests")
    _draw_points(ax, places, "o", style.BLUE, "tracker stations")
    ax.set_aspect("equal")
    ax.set_xlabel("m")
    ax.set_ylabel("m")
    return style.svg(ax)


@style.house_style
def incidence(details: Mapping[str, Any]) -> str:
    """Draw the angle of incidence over the table angle, one colour per station."""
    normals = details.get("normals", ())
    if not _mappings(normals):
        return ""
    (ax,) = style.grid(height=2.6)
    colours = (style.BLUE, style.ORANGE, style.GREEN, style.RED, style.INK, style.GREY)
    names = list(dict.fromkeys(normal["station"] for normal in normals))
    for number, name in enumerate(names):
        own = [normal for normal in normals if normal["station"] == name]
        x = [normal["angle_rad"] / DEGREE for normal in own]
        y = [normal["incidence_rad"] / DEGREE for normal in own]
        ax.plot(x, y, "o-", color=colours[number % len(colours)], markersize=4, linewidth=1.0,
                label=phrase("station {0}", name))  # fmt: skip
    if "incidence_limit_rad" in details:
        ax.axhline(details["incidence_limit_rad"] / DEGREE, color=style.RED, linestyle="--",
                   linewidth=1.0, label="limit")  # fmt: skip
    ax.set_ylim(bottom=0.0)
    style.angle_axis(ax, np.array([n["angle_rad"] / DEGREE for n in normals]))
    ax.set_ylabel("incidence / °")
    return style.svg(ax)


@style.house_style
def nest_residuals(details: Mapping[str, Any]) -> str:
    """Draw the residual of every nest from every station as a map with its lengths."""
    nests = details.get("nests", ())
    if not _mappings(nests):
        return ""
    rows = sorted({nest["nest"] for nest in nests})
    columns = list(dict.fromkeys(stand["station"] for stand in details["stations"]))
    test = np.full((len(rows), len(columns)), np.nan)
    (ax,) = style.grid(height=0.8 + 0.36 * len(rows))
    longest: dict[tuple[int, int], float] = {}
    for nest in nests:
        at = rows.index(nest["nest"]), columns.index(nest["station"])
        test[at] = np.fmax(test[at], nest["test_value"])
        length = float(np.linalg.norm(_array(nest["residual_m"]))) / MICROMETRE
        longest[at] = max(longest.get(at, 0.0), length)
    for (row, column), length in longest.items():
        ax.text(column, row, f"{length:.1f}", ha="center", va="center", fontsize=8)
    ax.grid(visible=False)
    ax.set_facecolor(style.MISSING)
    image = ax.imshow(test, cmap="Oranges", vmin=0.0, vmax=4.0, aspect="auto")
    ax.set_xticks(range(len(columns)), [str(name) for name in columns])
    ax.set_yticks(range(len(rows)), [str(name) for name in rows])
    ax.set_xlabel("tracker station")
    ax.set_ylabel("nest")
    ax.figure.colorbar(image, ax=ax, label="normalised residual")
    return style.svg(ax)


@style.house_style
def drift(details: Mapping[str, Any]) -> str:
    """Draw how the tracker turned and how its range grew at each station, from round to round."""
    stations = details.get("drift", ())
    if not _mappings(stations):
        return ""
    turned, ranged = style.grid(1, 2, height=2.8)
    for number, station in enumerate(stations):
        knots = _array(station["knots"])
        x = number + 0.8 * (knots - knots[0]) / (knots[-1] - knots[0])
        turn, turn_std = _array(station["turn_rad"]), _array(station["turn_std_rad"])
        for axis, colour, label in _TURNS:
            _draw_course(turned, x, turn[:, axis] / ARCSEC, turn_std[:, axis] / ARCSEC, colour,
                         label if number == 0 else "")  # fmt: skip
        _draw_course(ranged, x, _array(station["range_m"]) / MICROMETRE,
                     _array(station["range_std_m"]) / MICROMETRE, style.BLUE, "")  # fmt: skip
    for ax, label in ((turned, "turn / arcsec"), (ranged, "range / µm")):
        ax.set_xticks(np.arange(len(stations)) + 0.4, [str(s["station"]) for s in stations])
        ax.set_xlabel("tracker station")
        ax.set_ylabel(label)
    return style.svg(turned)


def _draw_course(
    ax: style.Axes, x: Floats, change: Floats, std: Floats, colour: str, label: str
) -> None:
    """Draw changes (R,) from knot to knot ``x`` (R + 1,), each with its own bar at its end."""
    course = np.concatenate([[0.0], np.cumsum(change)])
    ax.plot(x, course, "-", color=colour, linewidth=1.0, label=label or None)
    ax.errorbar(x[1:], course[1:], COVERAGE_FACTOR * std, fmt=".", color=colour, capsize=2)


def _draw_points(
    ax: style.Axes, points: Mapping[Any, Floats], marker: str, colour: str, label: str
) -> None:
    ax.plot(*np.array(list(points.values())).T, marker, color=colour, markersize=7, label=label)
    for name, point in points.items():
        ax.annotate(
            str(name),
            (point[0], point[1]),
            xytext=(7, 5),
            textcoords="offset points",
            color=colour,
        )


def _mappings(values: Sequence[Any]) -> bool:
    return len(values) > 0 and all(isinstance(value, Mapping) for value in values)


def _array(values: Any) -> Floats:
    return np.asarray(values, dtype=np.float64)


def tables(result: Result) -> list[ResultTable]:
    """Return the stations of the tracker, the mirror's normals, and what was measured twice."""
    details, found = result.details, list[ResultTable]()
    if stands := details.get("stations"):
        columns = by_axis("{}_mm", [stand["position_m"] for stand in stands], MILLIMETRE)
        names = [str(stand["station"]) for stand in stands]
        found.append(
            ResultTable.of("stations", "Stations of the tracker", station=names, **columns)
        )
    if normals := details.get("normals"):
        found.append(
            ResultTable.of(
                "normals",
                "Normals of the mirror, each as its station saw it; a position of two overlaps",
                station=[str(normal["station"]) for normal in normals],
                angle_deg=[float(normal["angle_rad"]) / DEGREE for normal in normals],
                incidence_deg=[float(normal["incidence_rad"]) / DEGREE for normal in normals],
                **by_axis("{}", [normal["normal"] for normal in normals]),
            )
        )
    if again := details.get("repeats"):
        found.append(
            ResultTable.of(
                "closure",
                "Positions at the same angle: second less first",
                first=[int(pair["first"]) for pair in again],
                second=[int(pair["second"]) for pair in again],
                difference_arcsec=[float(pair["difference_rad"]) / ARCSEC for pair in again],
                U_difference_arcsec=[
                    COVERAGE_FACTOR * float(pair["std_rad"]) / ARCSEC for pair in again
                ],
            )
        )
    return found
