"""What a method sees of six deviations if it knows neither axis nor artefact beforehand."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.language import phrase
from rotcal_ros.foundation.results import Result

_PAIRS: Final = (("EXC", "EYC"), ("EAC", "EBC"))


def describe(result: Result) -> tuple[str, ...]:
    """Return what the curves of such a method count from."""
    over = phrase("the measured angles")
    if result.zeros.counts_from == "mean of each group":
        over = phrase("the measured angles of each group")
    nothing = phrase(": steps from group to group, and with them the ranges, mean nothing")
    return (
        phrase(
            "Every deviation has zero mean over {0} (zero-mean gauge){1}.",
            over,
            nothing if result.zeros.free else "",
        ),
        phrase(
            "In EXC, EYC and in EAC, EBC the part that turns with the table belongs to what "
            "stands on it and is removed."
        ),
    )


def without_axis_and_artefact(
    angles: Floats, deviations: Mapping[str, Floats]
) -> dict[str, Floats]:
    """Return the visible part of six deviations (n,) at ``angles`` (n,), rad.

    A mean belongs to the axis. In the pairs EXC, EYC and EAC, EBC the part that turns with the
    table belongs to an artefact or instrument that stands on it. Both are removed by least squares
    over the angles, which need not be equidistant.
    """
    seen = {name: values - values.mean() for name, values in deviations.items()}
    fixed_and_turning = np.column_stack([np.ones(len(angles)), np.exp(1j * angles)])
    for x, y in _PAIRS:
        if x in seen and y in seen:
            plane = seen[x] + 1j * seen[y]
            part, *_ = np.linalg.lstsq(fixed_and_turning, plane, rcond=None)
            plane = plane - fixed_and_turning @ part
            seen[x], seen[y] = plane.real.copy(), plane.imag.copy()
    return seen
