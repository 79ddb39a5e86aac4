"""Why two curves may disagree altogether: a wrong unit, sign or sense of rotation."""

from __future__ import annotations

from math import pi
from typing import Final

import numpy as np

from rotcal_ros.arrays import Floats

ALIKE: Final = 0.9
"""Correlation from which on two curves have the same shape."""
SCALES: Final = {
    1.0: "",
    3600.0: "degrees taken for arcseconds",
    180.0 / pi * 3600.0: "radians taken for arcseconds",
    60.0: "arcminutes taken for arcseconds",
    180.0 * 3600.0 / pi / 1e6: "microradians and arcseconds exchanged",
}


def suspicion(first: Floats, second: Floats, second_mirrored: Floats | None) -> str:
    """Return what may be wrong with one of two curves, or an empty text.

    ``first`` and ``second`` are the values at the same angles, ``second_mirrored`` the negative
    values of the second curve at the negative angles, if it goes round.
    """
    if second_mirrored is not None:
        straight, mirrored = _alike(first, second), _alike(first, second_mirrored)
        if mirrored > ALIKE and mirrored > abs(straight) + 0.2:
            return (
                "the curves fit when one is turned the other way round: is its angle counted "
                "clockwise?"
            )
    likeness = _alike(first, second)
    if abs(likeness) < ALIKE:
        return ""
    ratio = float(np.std(first) / np.std(second))
    sign = "its sign is turned (commanded - actual?)" if likeness < 0.0 else ""
    scale = next(
        (
            why
            for factor, why in SCALES.items()
            if abs(ratio / factor - 1.0) < 0.2 or abs(ratio * factor - 1.0) < 0.2
        ),
        "",
    )
    wrong = " and ".join(text for text in (sign, scale) if text)
    return f"both curves have one shape, but for one of them {wrong}" if wrong else ""


def _alike(first: Floats, second: Floats) -> float:
    a, b = first - np.mean(first), second - np.mean(second)
    size = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(a @ b) / size if size > 0.0 else 0.0
