"""Values that another linear map than least squares takes from the same observations.

A paper's own way finds v; errors e of whitened observations move it by B e. What is to be said
of v follows from the solution of a model of the same observations: covariance B B', what effects
do to it, B A, while the residuals that show them are those of the model.

Of what is known beforehand, K x = k, the way knows nothing, and takes the unknowns for zero. So B
of these rows follows from B J = C, which holds for the columns that K knows. What else B J - C is
not zero for, the way leaves out: it is off by (B J - C) x.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np

from rotcal_ros.adjust.engine import Adjusted
from rotcal_ros.adjust.fit import Fit
from rotcal_ros.adjust.outputs import Outputs
from rotcal_ros.adjust.sensitivity import Sensitivity
from rotcal_ros.foundation.arrays import Floats, Ints


@dataclass(frozen=True, eq=False, kw_only=True)
class MappedFit(Fit):
    """The residuals of a solution, with outputs ``found`` (o,) of another map ``by`` (o, n).

    ``left_out`` (o,): by how much these are off for what the map leaves out, which the covariance
    holds (GUM F.2.4.5).
    """

    found: Floats
    by: Floats
    left_out: Floats

    @property
    def value(self) -> Floats:
        """All outputs (o,)."""
        return self.found

    def alone(self, rows: Ints) -> Floats:
        """Return what whitened errors of some ``rows`` (k,) do to the outputs (o, k)."""
        return self.by[:, rows]

    @cached_property
    def response(self) -> Floats:
        """The same of all, correlated ones as independent, (o, n)."""
        found = self.by
        if self.model.correlated:
            found = found.copy()
            for rows, spread in self.in_common():
                found[:, rows] = spread
        return found

    def response_of(self, rows: Ints, outputs: Outputs | None = None) -> Floats:
        """Return the same of some ``rows`` (k,)."""
        return self.response[:, rows]

    def response_to(self, asked: Floats) -> Floats:
        """Return what whitened errors do to combinations ``asked`` (k, o) of the outputs, (k, n).

        Correlated ones as independent.
        """
        return np.asarray(asked @ self.response[: asked.shape[1]])

    def sensitivity(self, rows: Ints) -> Sensitivity:
        """Return the same in parts that are few."""
        return Sensitivity.whole(self.by[:, rows])

    def moved(self, white: Floats) -> Floats:
        """Return what whitened errors (n, k) do to the outputs."""
        return np.asarray(self.by @ white)

    def moved_by(self, _gain: Floats, white: Floats) -> Floats:
        """Return the same."""
        return self.moved(white)

    def covariance(self, part: slice) -> Floats:
        """Return the covariance (k, k) of a ``part`` of the outputs."""
        by, left = self.response[part], self.left_out[part]
        return np.asarray(by @ by.T + np.outer(left, left))

    @cached_property
    def variance(self) -> Floats:
        """Variances (o,) of the outputs."""
        return np.asarray(np.einsum("on,on->o", self.response, self.response) + self.left_out**2)

    def products_of(self, first: Ints, second: Ints, weight: Floats) -> Floats:
        """Return sums (o, c) over pairs of rows, as of :class:`Fit`."""
        # output by output: the pairs of all are several times as large as the map
        return np.stack([weight @ (own[first] * own[second]) for own in self.by])

    @property
    def output_std(self) -> Floats:
        """Standard deviations (o,) of the outputs, those that nothing correlates."""
        return self.counting(np.sqrt(np.einsum("on,on->o", self.by, self.by) + self.left_out**2))


def mapped(found: Adjusted, value: Floats, by: Floats) -> Adjusted:
    """Return a solution whose outputs are the ``value`` (o,) of another map.

    ``by`` (o, n): what errors of the observations do to it; those of what is known beforehand and
    of what is not used do not matter.
    """
    fit, model = found.fit, found.model
    white = np.where(fit.used & model.rejectable, by * fit.std, 0.0)
    design = fit.design[:, : model.size[1]] / fit.std[:, None]
    beyond = white @ design - model.outputs
    known = design[~model.rejectable]
    if len(known):
        white[:, ~model.rejectable] = -beyond @ np.linalg.pinv(known)
        beyond = beyond + white[:, ~model.rejectable] @ known
    return replaced(found, value, white, beyond @ fit.x[: model.size[1]])


def replaced(found: Adjusted, value: Floats, by: Floats, left_out: Floats) -> Adjusted:
    """Return a solution whose outputs are those of a map that is known: see :class:`MappedFit`."""
    own = {f.name: getattr(found.fit, f.name) for f in fields(Fit)}
    other = MappedFit(**own, found=value, by=by, left_out=left_out)
    return replace(found, fit=other)
