"""Figures of a polygon result, as inline SVG; the details may come from a result's JSON form."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from rotcal_ros.figures import Figure, style
from rotcal_ros.figures.residuals import residual_figures
from rotcal_ros.foundation.components import COVERAGE_FACTOR
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import ARCSEC


def figures(result: Result, _truth: Mapping[str, Any] | None) -> Sequence[Figure]:
    """Return the figures that only this method can fill."""
    caption = "How far each face is turned from its nominal direction, k = 2; the mean is zero."
    return [
        Figure("Face errors of the polygon", caption, face_errors(result.details)),
        *residual_figures(result, ARCSEC, "arcsec"),
    ]


@style.styled
def face_errors(details: Mapping[str, Any]) -> str:
    """Draw the errors of all faces with their expanded uncertainties."""
    if details.get("faces_known_by", "nothing") == "nothing":
        return ""
    error = np.asarray(details["face_error_rad"]) / ARCSEC
    band = COVERAGE_FACTOR * np.asarray(details["face_error_std_rad"]) / ARCSEC
    (ax,) = style.grid()
    ax.bar(range(len(error)), error, yerr=band, color=style.BLUE, alpha=0.75, capsize=2)
    ax.axhline(0.0, color=style.GREY, linewidth=0.8)
    style.whole_numbers(ax.xaxis)
    ax.set_xlabel("face")
    ax.set_ylabel("face error / arcsec")
    return style.svg(ax)
