"""Figures of the tracer at several places: residuals, and where places and targets are."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import MILLIMETRE
from rotcal_ros.methods.figures import Figure, style
from rotcal_ros.methods.figures.residuals import residual_figures
from rotcal_ros.methods.figures.style import name_places
from rotcal_ros.methods.result_tables import ResultTable, by_axis, corrections_table
from rotcal_ros.methods.tracer.figures import lines_table


def figures(result: Result, _truth: Mapping[str, Any] | None = None) -> list[Figure]:
    """Return the figures that only this method can fill."""
    return [
        *residual_figures(result),
        Figure(
            "Places and targets",
            "Solved places of the tracer with the table at angle zero, and the targets, from "
            "above (left) and from the side (right). Tilts and heights are determined by beams in "
            "many directions, the turns by places far from each other.",
            places_and_targets(result),
            "set-up",
        ),
    ]


@style.house_style
def places_and_targets(result: Result) -> str:
    """Draw the places on the table and the targets around it, from above and from the side."""
    details = result.details
    if "places" not in details or "targets" not in details:
        return ""
    places = np.asarray(details["places"], dtype=np.float64) / MILLIMETRE
    targets = np.asarray(details["targets"], dtype=np.float64) / MILLIMETRE
    axes = style.grid(1, 2, height=4.2)
    for ax, upward, name in zip(axes, (1, 2), "yz", strict=True):
        ax.plot(targets[:, 0], targets[:, upward], "x", color=style.GREY, label="targets")
        ax.plot(places[:, 0], places[:, upward], "o", color=style.BLUE, label="places")
        name_places(ax, details["place_ids"], places[:, [0, upward]])
        ax.set_aspect("equal")
        ax.set_xlabel("x / mm")
        ax.set_ylabel(f"{name} / mm")
    axes[1].legend(loc="center right")
    return style.svg(axes[0])


def tables(result: Result) -> list[ResultTable]:
    """Return the places of the tracer on the table, and the targets with their corrections."""
    details, found = result.details, list[ResultTable]()
    for name, title, number in (
        ("places", "Places of the tracer, in the frame that turns with the table", "place"),
        ("targets", "Targets", "target"),
    ):
        if name in details:
            columns = by_axis("{}_mm", details[name], MILLIMETRE)
            found.append(
                ResultTable.of(name, title, **{number: details[f"{number}_ids"], **columns})
            )
    if "places" in details:
        places = np.asarray(details["places"], dtype=np.float64)
        found += lines_table(details, float(np.hypot(*places[:, :2].T).mean()))
    return [*found, *corrections_table(details)]
