"""The solver's covariance and Monte Carlo trials of the same measurement, side by side."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from rotcal_ros.arrays import Floats
from rotcal_ros.components import unit_of
from rotcal_ros.evaluation.monte_carlo import Propagation, compare_with_linear
from rotcal_ros.results import Result
from rotcal_ros.units import DEGREE


@dataclass(frozen=True, eq=False)
class Part:
    """One component at all angles (n,), rad or m; ``value`` and ``linear_std`` of the solver."""

    value: Floats
    linear_std: Floats
    mean: Floats
    std: Floats
    low: Floats
    high: Floats


@dataclass(frozen=True, eq=False)
class Propagated:
    """A result and the trials about it; ``seed`` makes them again."""

    result: Result
    spread: Propagation
    seed: int

    @cached_property
    def components(self) -> dict[str, Part]:
        """What solver and trials say about each component."""
        names = self.result.components
        columns = (self.spread.mean, self.spread.std, self.spread.low, self.spread.high)
        split = [np.split(column, len(names)) for column in columns]
        return {
            name: Part(
                self.result.deviations[name], self.result.std[name], *(part[k] for part in split)
            )
            for k, name in enumerate(names)
        }

    @cached_property
    def warnings(self) -> tuple[str, ...]:
        """Where the trials contradict the solver, in units that people read."""
        texts: list[str] = []
        for k, (name, part) in enumerate(self.components.items()):
            unit, label = unit_of(name)
            at = slice(k * len(part.value), (k + 1) * len(part.value))
            texts += compare_with_linear(
                _cut(self.spread, at, unit),
                part.value / unit,
                part.linear_std / unit,
                [f"{name} at {a / DEGREE:.6g} deg ({label})" for a in self.result.angles],
            )
        return tuple(texts)

    def in_words(self) -> str:
        """Return the verdict in one line."""
        verdict = "CONTRADICT" if self.warnings else "confirm"
        stable = "stable to" if self.spread.stable else "not yet stable to"
        return (
            f"{self.spread.trials} trials {verdict} the solver's uncertainty; {stable} "
            f"{self.spread.digits} digits, seed {self.seed}"
        )

    def to_dict(self) -> dict[str, Any]:
        """Return plain types for JSON, SI."""
        spread = self.spread
        return {
            "schema": 1,
            "method": self.result.method,
            "trials": spread.trials,
            "stable": spread.stable,
            "digits": spread.digits,
            "probability": spread.probability,
            "seed": self.seed,
            "angles_rad": self.result.angles.tolist(),
            "components": {
                name: {key: values.tolist() for key, values in vars(part).items()}
                for name, part in self.components.items()
            },
            "warnings": list(self.warnings),
        }


def _cut(spread: Propagation, at: slice, unit: float) -> Propagation:
    """Return the outputs ``at`` in another unit."""
    return Propagation(
        mean=spread.mean[at] / unit,
        std=spread.std[at] / unit,
        low=spread.low[at] / unit,
        high=spread.high[at] / unit,
        covariance=spread.covariance[at, at] / unit**2,
        probability=spread.probability,
        digits=spread.digits,
        trials=spread.trials,
        stable=spread.stable,
    )
