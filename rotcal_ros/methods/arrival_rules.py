"""Plans that come to an angle more than once: their arrivals, and trials about their mean."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.observations import Approach
from rotcal_ros.foundation.results import Result
from rotcal_ros.methods.arrivals import Arrivals, mean_curve, repeatability_std
from rotcal_ros.methods.method import Trials
from rotcal_ros.planning.table_angles import visits


def arrivals_of(angles: Sequence[float], runs: int, *, bidirectional: bool) -> Arrivals:
    """Return the arrivals of all table positions of :func:`visits` at ``angles`` (rad)."""
    every = visits(len(angles), runs, bidirectional)
    return Arrivals(
        targets=np.array(angles),
        target=np.array([visit.target for visit in every]),
        run=np.array([visit.run for visit in every]),
        upward=np.array([visit.approach is Approach.POSITIVE for visit in every]),
    )


@dataclass(frozen=True, eq=False)
class RepeatedTrials:
    """Trials of all arrivals, with their repeatability (c,), m and rad, as c mean curves."""

    arrivals: Trials
    mean: Floats
    repeatability_std: Floats

    @classmethod
    def of(
        cls, prepared: Trials, result: Result, arrivals: Arrivals, *, from_first: bool = True
    ) -> RepeatedTrials:
        """Return the trials ``prepared`` for the ``result`` of all ``arrivals`` as mean curves.

        ``from_first`` as in :func:`~rotcal_ros.methods.arrivals.mean_of_runs`.
        """
        scatter = [
            repeatability_std(result.deviations[name], result.covariance[name], arrivals)
            for name in result.components
        ]
        return cls(prepared, mean_curve(arrivals, from_first=from_first), np.array(scatter))

    def __call__(self, rng: np.random.Generator, count: int) -> Floats:
        """Return the mean deviations (count, c k), component by component, in m and rad."""
        values = self.arrivals(rng, count).reshape(count, len(self.repeatability_std), -1)
        scatter = self.repeatability_std[:, None]
        values = values + scatter * rng.standard_normal(values.shape)
        return np.asarray((values @ self.mean.T).reshape(count, -1), dtype=np.float64)
