"""Figures of the tracer at several places: residuals, and where places and targets are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from rotcal_ros.arrays import Floats
from rotcal_ros.figures import Figure, style
from rotcal_ros.figures.residuals import residual_figures
from rotcal_ros.results import Result
from rotcal_ros.units import MILLIMETRE

COVERED_MM: Final = 20.0
"""Places nearer to each other than that in a view share a name there."""


def figures(result: Result, _truth: Mapping[str, Any] | None = None) -> list[Figure]:
    """Return the figures that only this method can fill."""
    return [
        *residual_figures(result),
        Figure(
            "Places and targets",
            "Solved places of the tracer with the table at angle zero, and the targets, from "
            "above (left) and from the side (right). Tilts and heights are told by beams in many "
            "directions, the turns by places far from each other.",
            places_and_targets(result),
            "set-up",
        ),
    ]


@style.styled
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
        for names, at in _named(details["place_ids"], places[:, [0, upward]]):
            ax.annotate(names, at, xytext=(4, 4), textcoords="offset points")
        ax.set_aspect("equal")
        ax.set_xlabel("x / mm")
        ax.set_ylabel(f"{name} / mm")
    axes[1].legend(loc="center right")
    return style.svg(axes[0])


def _named(numbers: Sequence[int], points: Floats) -> list[tuple[str, tuple[float, float]]]:
    """Return names and points (mm), joined where ``points`` (p, 2) would cover each other."""
    named: list[tuple[str, tuple[float, float]]] = []
    left = list(zip(numbers, points.tolist(), strict=True))
    while left:
        x, y = left[0][1]
        near = [number for number, at in left if np.hypot(at[0] - x, at[1] - y) < COVERED_MM]
        left = [pair for pair in left if pair[0] not in near]
        named.append((", ".join(map(str, near)), (x, y)))
    return named
