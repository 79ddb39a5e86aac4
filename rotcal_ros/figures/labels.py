"""Names of places in a plan view, joined where they would cover each other."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from rotcal_ros.figures import style
from rotcal_ros.foundation.arrays import Floats

COVERED_MM: Final = 20.0
"""Places nearer to each other than that in a view share a name there."""


def name_places(
    ax: style.Axes, numbers: Sequence[int], points: Floats, covered: float = COVERED_MM
) -> None:
    """Write names beside ``points`` (p, 2); those within ``covered`` of each other share one."""
    left = list(zip(numbers, points.tolist(), strict=True))
    while left:
        x, y = left[0][1]
        near = [number for number, at in left if np.hypot(at[0] - x, at[1] - y) < covered]
        left = [pair for pair in left if pair[0] not in near]
        names = ", ".join(map(str, near))
        ax.annotate(names, (x, y), xytext=(4, 4), textcoords="offset points", fontsize=7)
