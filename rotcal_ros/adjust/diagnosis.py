"""What is believed: which observations are wrong, how large the noise is, which effects exist."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial, reduce
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from rotcal_ros.adjust.distributions import chi2_isf, normal_isf, sidak
from rotcal_ros.adjust.fit import Fit, fit_model
from rotcal_ros.adjust.gathering import Gathering
from rotcal_ros.adjust.judgement import BlamedSubset
from rotcal_ros.adjust.model import Disturbing, Model
from rotcal_ros.adjust.noise import EstimatedFactors
from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.language import Phrase, join_texts, phrase

SIZE_ROUNDS: Final = 5
"""Solutions of which each is weighed by the size of a scatter that the one before makes likely."""
SAME_SIZE: Final = 0.05
"""Relative change of the size of a scatter that is no matter to what is judged."""


@dataclass(frozen=True, slots=True)
class Limits:
    """How rarely sound data alarm.

    ``rejection``: probability that they lose any observation. ``significance``: of the test of
    the noise, of all groups and of all effects together. ``rejected_share``: of outliers that is
    nothing unusual; ``gathered_share``: the same where they are of one group.
    """

    rejection: float = 0.01
    significance: float = 0.01
    rejected_share: float = 0.05
    gathered_share: float = 0.05

    def outlier(self, model: Model) -> float:
        """Return the test value that no sound row exceeds, but for ``rejection``."""
        return normal_isf(0.5 * self.of_each_observation(model))

    def of_each_observation(self, model: Model) -> float:
        """Return the significance of the test of each single observation."""
        return sidak(self.rejection, model.rejectable_elements)

    def of_squares(self, model: Model, rank: ArrayLike) -> Floats:
        """Return the same of squared test values (m,) of elements with so many rows each."""
        return chi2_isf(self.of_each_observation(model), np.maximum(rank, 1))

    def of_each_effect(self, model: Model) -> float:
        """Return the significance of the test of each declared effect."""
        return sidak(self.significance, len(model.effects))


@dataclass(frozen=True, eq=False)
class Noise:
    """Factors (c,) on the stated noise; ``estimated`` is None where the statements hold."""

    factors: Floats
    estimated: EstimatedFactors | None = None


class Explanation(NamedTuple):
    """What may be wrong, in words and how probably; ``reason``: why rows are left out for it.

    ``columns`` (n, r) of errors in the unit of the observations; ``rows`` are left out for it, or
    it is ``effect`` and its columns become unknowns, which ``mixing`` (k, r) takes to sizes of the
    effect. ``support``: ln of its probability, by BIC, at a ``price`` of unknowns and of
    alternatives of its kind. ``change`` (o + a,): what it does to all outputs; ``hidden``
    (o + a, s): what the same does that leaves no residual, as large as what does, in s ways.
    """

    what: Phrase
    reason: Phrase
    columns: Floats
    rows: Ints
    support: float
    price: float
    change: Floats
    effect: Disturbing | None = None
    mixing: Floats | None = None
    probability: float = 0.0
    blamed: BlamedSubset | None = None
    hidden: Floats | None = None


class ContestedExplanation(NamedTuple):
    """An explanation that was taken for true, and others that are nearly as probable."""

    best: Explanation
    rivals: tuple[Explanation, ...]


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """What is believed so far: observations in use, noise, what was found and what rivals it.

    ``why`` says by row why an observation was left out, ``taken`` which effects became unknowns.
    ``price`` is that of all that was found, see :class:`Explanation`.
    """

    model: Model
    limits: Limits
    noise: Noise
    start: Floats
    gathering: Gathering = field(default_factory=Gathering)
    why: dict[int, Phrase] = field(default_factory=dict)
    nuisance: tuple[Explanation, ...] = ()
    contests: tuple[ContestedExplanation, ...] = ()
    price: float = 0.0

    @property
    def lost(self) -> int:
        """How many elements were left out."""
        return len({self.model.of_element[row] for row in self.why})

    @cached_property
    def used(self) -> Bools:
        """The observations (n,) in use: those that nothing was said against."""
        return np.isin(np.arange(len(self.model.observed)), list(self.why), invert=True)

    def fitted(self, factors: Floats, start: Floats) -> Fit:
        """Return the solution with ``factors`` (c,) on the stated noise."""
        extra = np.column_stack(
            [np.zeros((len(self.used), 0)), *(e.columns for e in self.nuisance)]
        )
        std = self.model.std * factors[self.model.of_component]
        return fit_model(self.model, self.used, std, start, extra)

    @cached_property
    def fit(self) -> Fit:
        """The solution with the noise that is believed."""
        return self.fitted(self.noise.factors, self.start)

    @property
    def with_likely_scatter(self) -> Diagnosis:
        """The same, with what scatters weighed by the size that its own solution makes likely.

        That of a solution which is weighed by other sizes may be far off: then derivatives are
        not those of the observations, and what these show best drowns in rounding.
        """
        found = self
        for _ in range(SIZE_ROUNDS):
            sizes = [found.fit.sizes[each].median_size for each in found.model.scatterings]
            if found.weighs(sizes):
                break
            found = replace(found, model=found.model.scattered(sizes), start=found.fit.x)
        return found

    def weighs(self, sizes: Sequence[float]) -> bool:
        """Whether what scatters is weighed by such ``sizes``, but for what is no matter."""
        now = [float(self.model.std[each.rows[0]]) for each in self.model.scatterings]
        return np.allclose(sizes, now, rtol=SAME_SIZE)

    def solved(self, fit: Fit) -> Diagnosis:
        """Return the same, which ``fit`` is the solution of."""
        found = replace(self, start=fit.x)
        found.__dict__["fit"] = fit  # it is known already
        return found

    @cached_property
    def bic(self) -> float:
        """BIC: twice -ln of the probability, by which whole beliefs are compared.

        As in :meth:`Look._support`; an observation that waits outside is explained by itself.
        """
        fit, n = self.fit, len(self.used)
        factors = self.noise.factors[self.model.of_component[self.used]]
        unknowns = fit.kernel.rank - sum(e.columns.shape[1] for e in self.nuisance)
        spread = 2.0 * float(np.log(factors).sum())
        return float(fit.chi2 + spread + unknowns * np.log(n) + self.price)

    def describe(self) -> Phrase:
        """Return what is wrong with the observations."""
        name = self.model.name_of_row
        every = list(dict.fromkeys(name(row) for row in sorted(self.why)))
        gone = join_texts(every[:8], ", ")
        if len(every) > 8:
            gone = phrase("{0} and {1} others", gone, len(every) - 8)
        parts = [phrase("{0} are wrong", gone)] if gone else []
        parts += [e.what for e in self.nuisance]
        return reduce(partial(phrase, "{0} and {1}"), parts or [phrase("nothing is wrong")])

    def holding(self, found: Explanation, rivals: Sequence[Explanation] = ()) -> Diagnosis:
        """Return the diagnosis that ``found`` is true, and that its ``rivals`` are possible."""
        contests = (
            (*self.contests, ContestedExplanation(found, tuple(rivals)))
            if rivals
            else self.contests
        )
        here = replace(self, contests=contests, price=self.price + found.price)
        if found.effect is not None:
            return replace(here, nuisance=(*here.nuisance, found))
        name, gathering = self.model.name_of_row, self.gathering
        if found.blamed is not None:
            gathering = gathering.without(found.blamed)
        reasons = {row: phrase("{0}: {1}", name(row), found.reason) for row in found.rows.tolist()}
        return replace(here, why=self.why | reasons, gathering=gathering)

    @property
    def unresolved_contests(self) -> tuple[ContestedExplanation, ...]:
        """The contests without rivals that were taken for true as well, later on."""
        taken = [e.what for e in self.nuisance]
        remaining = (
            ContestedExplanation(c.best, tuple(e for e in c.rivals if not self._holds(e, taken)))
            for c in self.contests
        )
        return tuple(contest for contest in remaining if contest.rivals)

    def _holds(self, rival: Explanation, taken: Sequence[str]) -> bool:
        if rival.effect is not None:
            return rival.what in taken
        return bool(len(rival.rows)) and all(row in self.why for row in rival.rows.tolist())

    def possible(self) -> Iterator[Floats]:
        """Yield what is possible, (o + a, k) per unit normal each: rivals, and what is hidden."""
        for best, rivals in self.unresolved_contests:
            weight = np.exp([min(e.support - best.support, 0.0) for e in rivals])
            for share, e in zip(weight / (1.0 + weight.sum()), rivals, strict=True):
                hidden = [] if e.hidden is None else [e.hidden]
                moved = np.column_stack([e.change - best.change, *hidden])
                yield np.asarray(np.sqrt(share) * moved)
        yield from (e.hidden for e in self.nuisance if e.hidden is not None)
