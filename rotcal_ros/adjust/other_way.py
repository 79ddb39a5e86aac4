"""Values that come from other equations than those of the model, as those that a paper prints.

They are another linear map of the same observations. What the observations say of noise, outliers
and effects does not depend on who makes outputs of them; what all this does to the outputs does.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from functools import cached_property

import numpy as np

from rotcal_ros.adjust.engine import Adjusted
from rotcal_ros.adjust.fit import Fit
from rotcal_ros.adjust.look import Look
from rotcal_ros.adjust.outputs import Outputs
from rotcal_ros.adjust.sensitivity import Sensitivity
from rotcal_ros.foundation.arrays import Floats, Ints


@dataclass(frozen=True, eq=False)
class OtherWay(Fit):
    """A solution whose outputs have the ``other`` values (o,), by ``felt`` (o, n).

    That is what they are off by for an error of each observation by 1, in its unit; zero for what
    is not used.
    """

    other: Floats = field(default_factory=lambda: np.zeros(0))
    felt_by: Floats = field(default_factory=lambda: np.zeros((0, 0)))

    @property
    def value(self) -> Floats:
        """All outputs (o,)."""
        return self.other

    @cached_property
    def _white_response(self) -> Floats:
        return self.felt_by * np.where(self.used, self.std, 0.0)

    def response_of(self, rows: Ints, outputs: Outputs | None = None) -> Floats:
        """Return what whitened errors of some ``rows`` (k,) do to the outputs (o, k)."""
        return self._white_response[:, rows]

    alone = response_of

    def sensitivity(self, rows: Ints) -> Sensitivity:
        """Return the same in parts that are few."""
        return Sensitivity.whole(self.response_of(rows))

    def moved(self, white: Floats) -> Floats:
        """Return what whitened errors (n, k) do to the outputs."""
        return np.asarray(self._white_response @ white)

    def covariance(self, count: int) -> Floats:
        """Return the covariance (count, count) of the first outputs, by the noise alone."""
        return np.asarray(self._white_response[:count] @ self._white_response[:count].T)

    @cached_property
    def _plain_variance(self) -> Floats:
        return np.asarray((self._white_response**2).sum(axis=1))

    @property
    def output_std(self) -> Floats:
        """Standard deviations (o,) of the outputs."""
        return self.counting(np.sqrt(self._plain_variance))


def by_other_way(found: Adjusted, value: Floats, felt: Floats) -> Adjusted:
    """Return what was ``found``, said of other values (o,) of the same outputs.

    ``felt`` (o, n): what errors of the observations do to them, as in :class:`OtherWay`. The
    model may report nothing else.
    """
    parts = {f.name: getattr(found.fit, f.name) for f in fields(Fit)}
    fit = OtherWay(**parts, other=value, felt_by=felt)
    judged = Look(replace(found.diagnosis), fit).diagnosis
    return Adjusted(judged, fit)
