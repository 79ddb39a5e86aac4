"""The same data evaluated in several ways: fewer balls, a coarser grid, side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np

from rotcal_ros.evaluation.marks import why_withheld
from rotcal_ros.foundation.components import COVERAGE_FACTOR, unit_of
from rotcal_ros.foundation.curves.interpolation import SAME_ANGLE
from rotcal_ros.foundation.observations import Observation
from rotcal_ros.foundation.results import Result
from rotcal_ros.methods import Calibration, Method, changed

EVALUATIONS = "evaluations"
"""The entry of a file with several evaluations."""


def way_name(changes: Sequence[str]) -> str:
    """Return the changes of a way, in words."""
    shown = (str(change).removeprefix("solver.").removeprefix("plan.plate.") for change in changes)
    return ", ".join(shown) or "all data"


@dataclass(frozen=True)
class Evaluation:
    """One way to evaluate the data, its result, and how far it is from the first way.

    ``differences`` holds for each component the largest distance (m or rad) at the common
    angles, both curves in the gauge of those angles; empty for the first way, and where groups
    have zeros of their own.
    """

    changes: tuple[str, ...]
    result: Result
    differences: Mapping[str, float]

    @property
    def name(self) -> str:
        """The changes in words."""
        return way_name(self.changes)

    def to_dict(self) -> dict[str, Any]:
        """Return plain types for JSON."""
        return {
            "changes": list(self.changes),
            "largest_differences": dict(self.differences),
            "result": self.result.to_dict(),
        }


def setting_combinations(
    balls: Sequence[str], coarser: Sequence[int], *, separate: bool | None = None
) -> tuple[tuple[str, ...], ...]:
    """Return the changes of settings for every combination of ball lists and grids.

    ``balls`` holds lists of grid steps such as "0,12,28", or "all". ``separate``: where steps
    share a factor with the grid, each group of table positions is solved with a zero of its own,
    or refused; None: as the set-up says.
    """
    found = []
    for steps, factor in product(balls or ["all"], coarser or [1]):
        changes = [] if steps == "all" else [f"solver.balls=[{steps}]"]
        changes += [] if factor == 1 else [f"solver.coarser={factor}"]
        if separate is not None:
            changes.append(f"plan.plate.separate_groups={str(separate).lower()}")
        found.append(tuple(changes))
    return tuple(found)


def evaluate(
    calibration: Calibration,
    observations: Sequence[Observation],
    wanted: Sequence[tuple[str, ...]],
) -> tuple[Evaluation, ...]:
    """Solve the observations in every wanted way and compare with the first one."""
    done: list[Evaluation] = []
    for changes in wanted:
        configuration = changed(calibration.configuration, changes)
        result = replace(calibration, configuration=configuration).solve(observations)
        # the offset between groups with zeros of their own is no difference of the curves
        known = [e.result for e in done[:1] if not (e.result.zeros.free or result.zeros.free)]
        differences = largest_differences(calibration.method, known[0], result) if known else {}
        done.append(Evaluation(changes, result, differences))
    return tuple(done)


def largest_differences(method: Method, first: Result, second: Result) -> dict[str, float]:
    """Return by component the largest distance of two results at their common angles."""
    near = np.abs(first.angles[:, None] - second.angles) < SAME_ANGLE
    here, there = np.nonzero(near)
    if not len(here):
        return {}
    angles = first.angles[here]
    names = [name for name in first.components if name in second.deviations]
    left = method.gauge(angles, {name: first.deviations[name][here] for name in names})
    right = method.gauge(angles, {name: second.deviations[name][there] for name in names})
    return {name: float(np.abs(left[name] - right[name]).max()) for name in names}


def describe_evaluations(evaluations: Sequence[Evaluation]) -> list[str]:
    """Return lines for people: each way with its largest U (k = 2), if it may be stated."""
    lines = []
    for evaluation in evaluations:
        result = evaluation.result
        lines.append(
            f"{evaluation.name}: {result.n_observations} observations, {result.dof} degrees of "
            f"freedom, verdict {result.verdict_line}"
        )
        for name in result.components:
            unit, label = unit_of(name)
            expanded = COVERAGE_FACTOR * float(result.std[name].max()) / unit
            shown = "not stated" if why_withheld(result) else f"{expanded:.3f} {label}"
            line = f"  {name}  U (k = {COVERAGE_FACTOR:g}) {shown}"
            if name in evaluation.differences:
                line += (
                    f", at most {evaluation.differences[name] / unit:.3f} {label} from the first"
                )
            lines.append(line)
    return lines
