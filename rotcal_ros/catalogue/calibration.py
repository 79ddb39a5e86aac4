"""A method with its configuration and plan, ready to take observations."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rotcal_ros.catalogue.runs import last_accepted
from rotcal_ros.configuration import Configuration
from rotcal_ros.errors import ConfigurationError
from rotcal_ros.observations import Observation
from rotcal_ros.planning.plan import Plan
from rotcal_ros.results import Result

Trials = Callable[[np.random.Generator, int], NDArray[np.float64]]
"""``trials(rng, count)`` draws measurements, solves them and returns (count, outputs)."""
Floats = NDArray[np.float64]
Curves = Mapping[str, Floats]


def counted_from_the_first(_angles: Floats, deviations: Curves) -> dict[str, Floats]:
    """Return the deviations (n,) by component, ECC counted from its first value."""
    return {
        name: values - values[0] if name == "ECC" else values
        for name, values in deviations.items()
    }


@dataclass(frozen=True)
class Method:
    """What a method brings.

    ``settings`` names its own groups of settings, from which nodes declare parameters;
    ``plan`` builds the plan from a configuration; ``solve`` turns a configuration, its plan
    and accepted observations into a result; ``topics`` are the instrument topics that must
    have delivered before the first motion; ``gauge`` takes from the true deviations (n,) at
    angles (n,) what the method cannot see, so that they can be compared with a result.

    A method whose values are relative to a zero that an interruption changes ``joins_runs``: it
    gets the accepted observations of all runs of a plan, not only the last one of each step.

    ``trials``, where there is one, prepares Monte Carlo trials about accepted observations:
    their outputs are the deviations of the result, component by component in the order of
    ``COMPONENTS``. ``check`` says in words what the observations so far tell about a person's
    work (see :class:`~rotcal_ros.planning.plan.Pause`), or raises DataError. ``solve_table``
    solves the text of a plain table, given with its name, where rows need not be steps of a plan.
    """

    name: str
    title: str
    topics: tuple[str, ...]
    settings: Mapping[str, type]
    plan: Callable[[Configuration], Plan]
    solve: Callable[[Configuration, Plan, Sequence[Observation]], Result]
    joins_runs: bool = False
    trials: Callable[[Configuration, Plan, Sequence[Observation]], Trials] | None = None
    check: Callable[[Configuration, Plan, Sequence[Observation]], tuple[str, ...]] | None = None
    solve_table: Callable[[Configuration, str, str], Result] | None = None
    gauge: Callable[[Floats, Curves], dict[str, Floats]] = counted_from_the_first


@dataclass(frozen=True)
class Calibration:
    """One configured calibration: what to measure and how to solve it."""

    configuration: Configuration
    method: Method
    plan: Plan

    def solve(self, observations: Iterable[Observation]) -> Result:
        """Solve with the observations that count; see :func:`final_observations`."""
        used = self._that_count(observations)
        return self.method.solve(self.configuration, self.plan, used)

    def trials(self, observations: Iterable[Observation]) -> Trials:
        """Prepare Monte Carlo trials about the observations that count."""
        if self.method.trials is None:
            raise ConfigurationError(f"the method {self.method.name} brings no Monte Carlo trials")
        used = self._that_count(observations)
        return self.method.trials(self.configuration, self.plan, used)

    def _that_count(self, observations: Iterable[Observation]) -> tuple[Observation, ...]:
        """Return the last accepted one of each step, for a method that joins runs in each run."""
        accepted = last_accepted(observations)
        if self.method.joins_runs:
            return tuple(accepted[key] for key in sorted(accepted))
        return final_observations(accepted.values())

    def check(self, observations: Iterable[Observation]) -> tuple[str, ...]:
        """Return in words what a person has to put right, as far as the method can tell."""
        if self.method.check is None:
            return ()
        return self.method.check(self.configuration, self.plan, final_observations(observations))


def final_observations(observations: Iterable[Observation]) -> tuple[Observation, ...]:
    """Return the accepted observation of the last attempt at every step, in step order.

    The order in which observations arrive therefore never changes a result.
    """
    last: dict[int, Observation] = {}
    for observation in observations:
        known = last.get(observation.step)
        if observation.accepted and (known is None or observation.attempt >= known.attempt):
            last[observation.step] = observation
    return tuple(last[step] for step in sorted(last))
