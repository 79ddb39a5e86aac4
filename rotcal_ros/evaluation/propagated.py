"""The solver's covariance and Monte Carlo trials of the same measurement, side by side."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from rotcal_ros.evaluation.monte_carlo import (
    BLOCK,
    Progress,
    Propagation,
    compare_with_linear,
    propagate,
)
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.components import unit_of
from rotcal_ros.foundation.results import Result, plain_fields
from rotcal_ros.foundation.units import DEGREE
from rotcal_ros.methods.method import Measurements


@dataclass(frozen=True, eq=False)
class PropagatedComponent:
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
    def components(self) -> dict[str, PropagatedComponent]:
        """What solver and trials say about each component."""
        names = self.result.components
        columns = (self.spread.mean, self.spread.std, self.spread.low, self.spread.high)
        split = [np.split(column, len(names)) for column in columns]
        return {
            name: PropagatedComponent(
                self.result.deviations[name], self.result.std[name], *(part[k] for part in split)
            )
            for k, name in enumerate(names)
        }

    @cached_property
    def warnings(self) -> tuple[str, ...]:
        """Where the trials contradict the solver, in units that people read."""
        texts: list[str] = []
        for name, part in self.components.items():
            unit, label = unit_of(name)
            shown = {n: getattr(part, n) / unit for n in ("mean", "std", "low", "high")}
            texts += compare_with_linear(
                replace(self.spread, **shown),
                part.value / unit,
                part.linear_std / unit,
                [f"{name} at {a / DEGREE:.6g} deg ({label})" for a in self.result.angles],
            )
        return tuple(texts)

    def in_words(self) -> str:
        """Return the verdict in one line."""
        verdict = "CONTRADICT" if self.warnings else "confirm"
        open_zeros = self.result.zeros.in_words()
        within = f"; {open_zeros}: no trial tells it" if open_zeros else ""
        stable = "stable to" if self.spread.stable else "not yet stable to"
        return (
            f"{self.spread.trials} trials {verdict} the solver's uncertainty; {stable} "
            f"{self.spread.digits} digits, seed {self.seed}{within}"
        )

    def to_dict(self) -> dict[str, Any]:
        """Return plain types for JSON, SI."""
        facts = ("trials", "stable", "digits", "probability")
        return {
            "schema": 1,
            "method": self.result.method,
            **{name: getattr(self.spread, name) for name in facts},
            "seed": self.seed,
            "angles_rad": self.result.angles.tolist(),
            "components": {name: plain_fields(p) for name, p in self.components.items()},
            "warnings": list(self.warnings),
            "open_zeros": self.result.zeros.in_words(),
        }


def propagated(
    measured: Measurements,
    *,
    trials: int,
    digits: int,
    seed: int,
    workers: int,
    progress: Progress | None = None,
) -> Propagated:
    """Solve what was measured and run at most ``trials`` about it, see :func:`propagate`."""
    spread = propagate(
        measured.trials(),
        seed=seed,
        max_trials=trials,
        digits=digits,
        workers=workers,
        block=min(BLOCK, trials),
        progress=progress,
    )
    return Propagated(measured.solve(), spread, seed)
