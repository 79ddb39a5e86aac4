"""The sources of the uncertainty of a result, as far as the result holds them.

The ``budget`` of a result splits the uncertainty of ECC. Of everything else only the whole is
known and reported.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.results import Result

SOURCES: Final[Mapping[str, str]] = {
    "lengths": "Lengths: noise, return of table and machine, air",
    "targets": "Places of the targets",
    "error_motion": "Error motion of the table",
    "circle": "Stated circle of the stations",
    "slips": "Unseen slips of the counter",
    "clocks": "Clocks that may differ, while the table creeps",
}
"""The names that methods give their sources, in words."""
WHOLE: Final = "Observations and all that is estimated with them"
REST: Final = "Not separated"
NOTHING: Final = 1e-3
"""Share of the variance below which a rest is rounding."""


@dataclass(frozen=True, eq=False, slots=True)
class Contribution:
    """One source with its standard uncertainty ``std`` (n,) at every angle, SI."""

    source: str
    std: Floats


def contributions(result: Result, component: str) -> tuple[Contribution, ...]:
    """Return the sources of the uncertainty of ``component``; their squares add up to its."""
    total = result.std[component] ** 2
    parts = [
        Contribution(SOURCES.get(name, name.replace("_", " ")), std)
        for name, std in (result.budget if component == "ECC" else {}).items()
    ]
    if not parts:
        return (Contribution(WHOLE, result.std[component]),)
    rest = total - np.sum([part.std**2 for part in parts], axis=0)
    if np.any(rest > NOTHING * total.max()):
        parts.append(Contribution(REST, np.sqrt(np.maximum(rest, 0.0))))
    return tuple(parts)
