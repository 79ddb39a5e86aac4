"""Finds the smallest detectable error in one observation, and the effect of an undetected one.

Internal reliability: the minimal detectable error of an observation, std * sqrt(lambda0 / r)
with its redundancy r. External reliability: what that error does to the deviations, in their
standard uncertainties: at most sqrt(lambda0 (1 - r) / r) for anything computed from the unknowns.
Source: Baarda, W. (1968), A testing procedure for use in geodetic networks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, Literal

import numpy as np

from rotcal_ros.adjust.distributions import noncentrality
from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.observations import Observation
from rotcal_ros.foundation.results import Residuals, Result, json_value
from rotcal_ros.methods import Calibration

ALPHA: Final = 0.001
"""Significance of the test of one observation, as is usual in geodesy."""
POWER: Final = 0.80
"""Probability with which an error of the minimal detectable size is found."""
CHECKED: Final = 1e-6
"""Below this redundancy nothing checks an observation."""
NUDGE: Final = 0.01
"""An error of this many standard deviations has a linear effect on a result."""


@dataclass(frozen=True, eq=False)
class Reliability:
    """Reliability of the n used observations, in the order of the residuals.

    ``row`` (n,) are their rows among the residuals. ``detectable`` (n,) is the minimal detectable
    error in standard deviations of the observation, for one of several coordinates in the mean
    over the directions; inf if nothing checks it. ``effect`` (n,) bounds what such an error does
    to any deviation, in standard uncertainties of that. ``std`` (n,) is the standard deviation of
    the observations in their ``unit``, None if it is not known.
    """

    alpha: float
    power: float
    lambda0: float
    row: Ints
    table_position: Ints
    target: Ints
    redundancy: Floats
    detectable: Floats
    effect: Floats
    std: Floats | None
    unit: Literal["m", "rad"]

    @property
    def unchecked(self) -> Bools:
        """Mask (n,) of the observations that nothing checks."""
        return np.asarray(~np.isfinite(self.detectable), dtype=np.bool_)

    def worst(self, count: int) -> Ints:
        """Return up to ``count`` observations, the largest effect first."""
        order = np.lexsort((self.row, -self.effect))
        return np.asarray(order[:count], dtype=np.int64)

    def detectable_error(self) -> Floats | None:
        """Return the minimal detectable errors (n,) in ``unit``; None if no std is stated."""
        return None if self.std is None else np.asarray(self.std * self.detectable)

    def to_dict(self, count: int, effects: Floats | None = None) -> dict[str, Any]:
        """Return plain types for JSON with the ``count`` worst, SI.

        ``effects`` are those on the deviations, see :func:`effects_on_deviations`.
        """
        worst, errors = self.worst(count), self.detectable_error()
        columns: dict[str, Any] = {
            "row": self.row[worst],
            "table_index": self.table_position[worst],
            "target": self.target[worst],
            "redundancy": self.redundancy[worst],
            "detectable_std": self.detectable[worst],
            "effect_bound_std": self.effect[worst],
        }
        if errors is not None:
            columns[f"detectable_{self.unit}"] = errors[worst]
        if effects is not None:
            columns["effect_std"] = effects
        return {
            "schema": 1,
            "alpha": self.alpha,
            "power": self.power,
            "lambda0": self.lambda0,
            "n_observations": len(self.row),
            "n_unchecked": int(self.unchecked.sum()),
            "mean_redundancy": float(self.redundancy.mean()) if len(self.row) else 0.0,
            "worst": [
                dict(zip(columns, row, strict=True))
                for row in zip(*map(json_value, columns.values()), strict=True)
            ],
        }


def reliability(residuals: Residuals, alpha: float = ALPHA, power: float = POWER) -> Reliability:
    """Return the reliability of the used observations of a solution.

    A point is tested as a whole: chi-squared with three degrees of freedom.
    """
    row = np.flatnonzero(residuals.used)
    share = np.clip(residuals.redundancy[row], 0.0, 1.0)
    checked = share > CHECKED
    lambda0 = noncentrality(alpha, power, residuals.coordinates)
    safe = np.where(checked, share, 1.0)
    detectable = np.where(checked, np.sqrt(lambda0 / safe), np.inf)
    effect = np.where(checked, np.sqrt(lambda0 * (1.0 - safe) / safe), np.inf)
    return Reliability(
        alpha=alpha,
        power=power,
        lambda0=lambda0,
        row=row,
        table_position=residuals.table_position[row],
        target=residuals.target[row],
        redundancy=share,
        detectable=detectable,
        effect=effect,
        std=None if residuals.std is None else residuals.std[row],
        unit=residuals.unit,
    )


def effects_on_deviations(
    calibration: Calibration,
    observations: Sequence[Observation],
    result: Result,
    found: Reliability,
    which: Ints,
) -> Floats:
    """Return what the minimal detectable errors of ``which`` do to the deviations, in their std.

    It is the largest over all angles and components, found by solving again with a small error in
    each coordinate; inf if nothing checks the observation. ``observations`` (n,) are those of
    ``result``; an observation that only closes a plan has no residual. Raises DataError if a
    residual belongs to none of them, or if they have no standard deviation.
    """
    errors = found.detectable_error()
    if result.residuals is None:
        raise DataError("the result has no residuals: no effect can be calculated")
    # both are in the order of measurement
    position, target = result.residuals.table_position, result.residuals.target
    rows, places = list(zip(position.tolist(), target.tolist(), strict=True)), list[int]()
    for index, o in enumerate(observations):
        if len(places) < len(rows) and (o.table_position, o.target) == rows[len(places)]:
            places.append(index)
    if len(places) < len(rows):
        raise DataError(
            f"{len(rows) - len(places)} residuals do not belong to one observation each: no "
            "effect can be calculated"
        )
    if found.std is None or errors is None or not np.all(found.std[which] > 0.0):
        raise DataError("the observations have no standard deviation: state the noise in solver")
    effects = np.full(len(which), np.inf)
    for k, index in enumerate(which.tolist()):
        if np.isfinite(errors[index]):
            row, step = int(found.row[index]), NUDGE * float(found.std[index])
            gain = _gain(calibration, observations, result, places[row], step)
            effects[k] = errors[index] * float(gain.max(initial=0.0))
    return effects


def _gain(
    calibration: Calibration,
    observations: Sequence[Observation],
    result: Result,
    row: int,
    step: float,
) -> Floats:
    """Return the change of every deviation per metre of error in its worst direction, in std."""
    squares = np.zeros(1)
    for axis in range(len(observations[row].mean)):
        mean = list(observations[row].mean)
        mean[axis] += step
        changed = [*observations]
        changed[row] = replace(observations[row], mean=tuple(mean))
        again = calibration.solve(changed)
        if not np.array_equal(again.angles, result.angles):
            raise DataError(
                "a small error changes which angles are solved: the plan is too weak; add lengths"
            )
        stated = {name: std > 0.0 for name, std in result.std.items()}
        changes = [
            (again.deviations[c] - result.deviations[c])[stated[c]] / result.std[c][stated[c]]
            for c in result.components
        ]
        squares = squares + np.square(np.concatenate(changes) / step)
    return np.asarray(np.sqrt(squares), dtype=np.float64)
