"""Whether the uncertainty of a result may be stated to people, and if not, why.

A band that is drawn or a U that is printed is believed, whatever is written beside it. So neither
is shown as valid where something contradicts the model behind it: the verdict, or the truth that a
simulation injected. The numbers stay in result.json.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from rotcal_ros.foundation.arrays import Bools, Floats
from rotcal_ros.foundation.components import COVERAGE_FACTOR, unit_of
from rotcal_ros.foundation.gum_numbers import uncertainty
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import DEGREE

SURELY_WRONG: Final = 2.0
"""Times U, hence four standard uncertainties: no honest curve is that far from the truth."""


def withheld(result: Result, truth: Mapping[str, Any] | None = None) -> str:
    """Return why no uncertainty of ``result`` may be stated; empty where it may.

    ``truth`` is the content of the truth.json of a simulation.
    """
    if why := withheld_by(result.verdict, result.warnings):
        return why
    return _contradicted(result, truth) if truth is not None else ""


def withheld_by(verdict: str, warnings: Sequence[str]) -> str:
    """Return why a verdict forbids to state an uncertainty; empty where it does not."""
    if verdict == "ok":
        return ""
    return f"the verdict is {verdict}: {'; '.join(warnings) or 'its reason is not recorded'}"


def not_covered(result: Result) -> str:
    """Return what a stated uncertainty leaves out, in words; empty where that is nothing."""
    if not result.protections:
        return "what drift, knocks and the like may have done (not stated by the method)"
    return ", ".join(result.unprotected)


def at_angles(angles: Floats, truth: Mapping[str, Any], component: str) -> tuple[Floats, Bools]:
    """Return the injected values (n,), SI, at ``angles`` (n,), and where they are known."""
    values = truth.get("deviations", {}).get(component)
    if values is None:
        return np.zeros(len(angles)), np.zeros(len(angles), dtype=np.bool_)
    known = np.asarray(truth["angles_rad"], dtype=np.float64)
    apart = np.abs(angles[:, None] - known)
    nearest = apart.argmin(axis=1)
    return np.asarray(values, dtype=np.float64)[nearest], apart.min(axis=1) < 1e-9


def _contradicted(result: Result, truth: Mapping[str, Any]) -> str:
    """Return where the injected deviations lie far outside the band, in words."""
    for name in result.components:
        injected, known = at_angles(result.angles, truth, name)
        expanded = COVERAGE_FACTOR * result.std[name]
        error = np.abs(result.deviations[name] - injected)
        times = np.divide(error, expanded, out=np.zeros_like(error), where=known & (expanded > 0))
        worst = int(times.argmax())
        if times[worst] > SURELY_WRONG:
            unit, label = unit_of(name)
            stated = uncertainty(float(expanded[worst]) / unit)
            return (
                f"{name} at {result.angles[worst] / DEGREE:g} degrees is "
                f"{error[worst] / unit:.2g} {label} off what the simulation injected, "
                f"{times[worst]:.1f} times its U of {stated} {label}: "
                "the model lacks something"
            )
    return ""
