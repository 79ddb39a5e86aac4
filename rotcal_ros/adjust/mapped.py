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
from scipy.sparse import csr_array

from rotcal_ros.adjust.engine import Adjusted
from rotcal_ros.adjust.fit import Fit
from rotcal_ros.adjust.outputs import FEW_ROWS, Outputs
from rotcal_ros.adjust.sensitivity import Sensitivity
from rotcal_ros.foundation.arrays import Floats, Ints


@dataclass(frozen=True, eq=False, kw_only=True)
class MappedFit(Fit):
    """The residuals of a solution, with outputs ``found`` (o,) of another map ``by`` (o, n).

    ``left_out`` (o,): by how much these are off for what the map leaves out, which the covariance
    holds (GUM F.2.4.5).
    """

    found: Floats
    by: Outputs
    left_out: Floats

    @property
    def value(self) -> Floats:
        """All outputs (o,)."""
        return self.found

    def alone(self, rows: Ints) -> Floats:
        """Return what whitened errors of some ``rows`` (k,) do to the outputs (o, k)."""
        return self.by.columns(rows)

    def response_of(self, rows: Ints, outputs: Outputs | None = None) -> Floats:
        """Return the same, correlated ones as independent."""
        return super().response_of(rows)

    def response_to(self, asked: Floats) -> Floats:
        """Return what whitened errors do to combinations ``asked`` (k, o) of the outputs, (k, n).

        Correlated ones as independent.
        """
        by = self.by.part(slice(asked.shape[1]))
        found = np.asarray((by.few.T @ asked.T).T + (asked @ by.share) @ by.common)
        for mine, spread in self.correlated_rows():
            found[:, mine] = asked @ spread[: asked.shape[1]]
        return found

    def sensitivity(self, rows: Ints) -> Sensitivity:
        """Return what whitened errors of some ``rows`` (k,) do to the outputs, in few parts."""
        return self.by.sensitivity(rows)

    def moved(self, white: Floats) -> Floats:
        """Return what whitened errors (n, k) do to the outputs."""
        return self.by.times(white)

    def moved_by(self, _gain: Floats, white: Floats) -> Floats:
        """Return the same."""
        return self.moved(white)

    def _plain_covariance(self, part: slice) -> Floats:
        left = self.left_out[part]
        return np.asarray(self.by.part(part).products() + np.outer(left, left))

    def compact(self, part: slice) -> None:
        """Return None: a map may feel anything."""

    @cached_property
    def _plain_variance(self) -> Floats:
        return np.asarray(self.by.lengths(np.ones(self.by.shape[1])) ** 2 + self.left_out**2)

    def output_products(self, first: Ints, second: Ints, weight: Floats) -> Floats:
        """Return sums (o, c) over pairs of rows, as of :class:`Fit`."""
        found = np.zeros((len(self.found), len(weight)))
        for some in np.array_split(np.arange(len(first)), len(first) // FEW_ROWS + 1):
            pairs = self.alone(first[some]) * self.alone(second[some])
            found += pairs @ weight[:, some].T
        return found

    @property
    def output_std(self) -> Floats:
        """Standard deviations (o,) of the outputs, those that nothing correlates."""
        return self.counting(np.sqrt(self._plain_variance))


def with_other_outputs(found: Adjusted, value: Floats, sensitivity: Floats) -> Adjusted:
    """Return a solution whose outputs are the ``value`` (o,) of another map.

    ``sensitivity`` (o, n): what errors of the observations do to it; those of what is known
    beforehand and of what is not used do not matter.
    """
    fit, model = found.fit, found.model
    white = np.where(fit.used & model.rejectable, sensitivity * fit.std, 0.0)
    design = fit.design[:, : model.size[1]] / fit.std[:, None]
    beyond = white @ design - model.outputs
    known = design[~model.rejectable]
    if len(known):
        white[:, ~model.rejectable] = -beyond @ np.linalg.pinv(known)
        beyond = beyond + white[:, ~model.rejectable] @ known
    every = Outputs.alone(csr_array(white))
    return with_outputs_of_map(found, value, every, beyond @ fit.x[: model.size[1]])


def with_outputs_of_map(found: Adjusted, value: Floats, by: Outputs, left_out: Floats) -> Adjusted:
    """Return a solution whose outputs are those of a map that is known: see :class:`MappedFit`."""
    own = {f.name: getattr(found.fit, f.name) for f in fields(Fit)}
    other = MappedFit(**own, found=value, by=by, left_out=left_out)
    return replace(found, fit=other)
