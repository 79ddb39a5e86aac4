"""What is wrong with observations: a robust start, the noise, and explanations one by one.

:func:`found_causes` goes on until nothing significant is left unexplained. In each round a
:class:`Look` at the solution asks whether some of a group are off together
(:mod:`.judgement`), whether a declared effect is there (:mod:`.effects`), and whether a single
observation stands out (Baarda's test, Sidak's limit for their number). The most probable goes
first: observations are left out, an effect becomes an unknown. What explains nearly as much is
remembered, and the difference it makes joins the covariance.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np
from scipy.special import gammaln

from rotcal_ros.adjust.distributions import normal_isf, t_isf
from rotcal_ros.adjust.effects import EffectTest, Seen, effect_test, family_test
from rotcal_ros.adjust.gathering import Gathering, judged
from rotcal_ros.adjust.groups import CHECKED, Group, SolutionView
from rotcal_ros.adjust.judgement import ALIKE, Blame, blame
from rotcal_ros.adjust.model import Disturbing, Fit, Model, fitted, gathered_of, members_of
from rotcal_ros.adjust.noise import (
    LEAST_FACTOR,
    NEARLY_SETTLED,
    PRIOR,
    SETTLED,
    EstimatedFactors,
    NoiseEvidence,
    bent_squares,
    estimate_factors,
)
from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.errors import ObservabilityError, RotcalError

ROUNDS: Final = 30
"""Reweighted adjustments of the robust start, and concentration steps after them."""
KEPT: Final = 0.6
"""Share of each group that the robust start concentrates on."""
GROSS: Final = 5.0
"""Times the limit of an outlier, in the scatter of the others, that bends a start."""
NORMAL_QUARTILE: Final = 0.6745
"""Median of |x| for a standard normal x."""
RARER: Final = 3.0
"""How much rarer an effect or a gathering is held to be than a single wrong observation."""
SAME: Final = 0.01
"""Difference of the outputs, in their uncertainty, that makes it no matter which cause it was."""
ALL_BUT_NOTHING: Final = 1.0 - 1e-12
"""Share of chi-squared, at most, that is said to be explained."""
SUSPECTS: Final = 4
"""Groups of which it is asked who is to blame, the most probable ones."""


@dataclass(frozen=True, slots=True)
class Limits:
    """How rarely sound data alarm.

    ``rejection``: probability that they lose any observation. ``significance``: of the test of
    the noise, of all groups and of all effects together. ``rejected_share``: of outliers that is
    nothing unusual.
    """

    rejection: float = 0.01
    significance: float = 0.01
    rejected_share: float = 0.05

    def outlier(self, model: Model) -> float:
        """Return the test value that no sound observation exceeds, but for ``rejection``."""
        return normal_isf(0.5 * self.of_each_observation(model))

    def of_each_observation(self, model: Model) -> float:
        """Return the significance of the test of each single observation."""
        return _sidak(self.rejection, int(model.may_go.sum()))

    def of_each_effect(self, model: Model) -> float:
        """Return the significance of the test of each declared effect."""
        return _sidak(self.significance, len(model.effects))


def _sidak(significance: float, tests: int) -> float:
    """Return the significance of each of several tests that have one together."""
    return float(-np.expm1(np.log1p(-significance) / max(tests, 1)))


@dataclass(frozen=True, eq=False)
class Noise:
    """Factors (c,) on the stated noise; ``estimated`` is None where the statements hold."""

    factors: Floats
    estimated: EstimatedFactors | None = None


class Explanation(NamedTuple):
    """What may be wrong, in words and how probably; ``reason``: why rows are left out for it.

    ``columns`` (n, k) of errors in the unit of the observations; ``rows`` are left out for it, or
    it is ``effect`` and becomes an unknown. ``support``: ln of its probability, by BIC and the
    number of alternatives of its kind. ``change`` (o,): what it does to the outputs.
    """

    what: str
    reason: str
    columns: Floats
    rows: Ints
    support: float
    change: Floats
    effect: Disturbing | None = None
    test: EffectTest | None = None
    blamed: Blame | None = None


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """What is believed so far: observations in use, noise, what was found and what rivals it.

    ``why`` says by row why an observation was left out, ``taken`` which effects became unknowns.
    ``contested``: weights and changes (o,) of the outputs by ``rivals``, which are told in words.
    """

    model: Model
    limits: Limits
    used: Bools
    noise: Noise
    start: Floats
    gathering: Gathering = field(default_factory=Gathering)
    why: dict[int, str] = field(default_factory=dict)
    taken: tuple[Explanation, ...] = ()
    contested: tuple[tuple[float, Floats], ...] = ()
    rivals: tuple[str, ...] = ()

    def fitted(self, factors: Floats, start: Floats) -> Fit:
        """Return the solution with ``factors`` (c,) on the stated noise."""
        extra = np.column_stack([np.zeros((len(self.used), 0)), *(e.columns for e in self.taken)])
        std = self.model.std * factors[self.model.of_component]
        return fitted(self.model, self.used, std, start, extra)

    @property
    def fit(self) -> Fit:
        """The solution with the noise that is believed."""
        return self.fitted(self.noise.factors, self.start)

    def leaving_out(self, found: Explanation) -> Diagnosis:
        """Return the diagnosis without the rows of an explanation."""
        used, name = self.used.copy(), self.model.row_name
        used[found.rows] = False
        reasons = {row: f"{name(row)}: {found.reason}" for row in found.rows.tolist()}
        gathering = self.gathering
        if found.blamed is not None:
            gathering = replace(gathering, blamed=(*gathering.blamed, found.blamed))
        return replace(self, used=used, why=self.why | reasons, gathering=gathering)

    def holding(self, found: Explanation, rivals: Sequence[Explanation]) -> Diagnosis:
        """Return the diagnosis that ``found`` is true, and that its ``rivals`` are possible."""
        weight = np.exp([e.support - found.support for e in rivals])
        weight = weight / (1.0 + weight.sum())
        contested = [(w, e.change - found.change) for w, e in zip(weight, rivals, strict=True)]
        ambiguous = [
            f"that {found.what} explains the residuals, and that {e.what} does so nearly as well "
            f"(likelihood 1 : {np.exp(found.support - e.support):.2g}): U covers both"
            for e in rivals
        ]
        here = replace(
            self, contested=(*self.contested, *contested), rivals=(*self.rivals, *ambiguous)
        )
        if found.effect is not None:
            return replace(here, taken=(*here.taken, found))
        return here.leaving_out(found)


def found_causes(model: Model, limits: Limits) -> Diagnosis:
    """Return what is believed when nothing significant is left unexplained.

    Gross errors wait outside from the start, and come back where they agree after all, or where
    something explains them together.
    """
    start, gross = _robust_start(model, limits)
    noise, every = Noise(np.ones(len(model.components))), np.ones(len(model.observed), np.bool_)
    whole = Diagnosis(model, limits, every, noise, start)
    if not len(gross):
        return _explained(whole)
    apart = _come_back(_explained(_outside(whole, gross)), gross)
    try:
        together = _explained(whole)
    except RotcalError:
        return apart  # gross errors in all directions let nothing settle
    return min(apart, together, key=_improbability)


def _outside(diagnosis: Diagnosis, gross: Ints) -> Diagnosis:
    used = np.isin(np.arange(len(diagnosis.used)), gross, invert=True)
    name = diagnosis.model.row_name
    why = {row: f"{name(row)}: far off all others" for row in gross.tolist()}
    return replace(diagnosis, used=used, why=why)


def _come_back(diagnosis: Diagnosis, gross: Ints) -> Diagnosis:
    """Return the diagnosis with those of the ``gross`` observations that agree after all."""
    limit = diagnosis.limits.outlier(diagnosis.model)
    back = gross[np.abs(diagnosis.fit.test_value[gross]) <= limit].tolist()
    if not back:
        return diagnosis
    used = diagnosis.used | np.isin(np.arange(len(diagnosis.used)), back)
    why = {row: text for row, text in diagnosis.why.items() if row not in back}
    return _explained(replace(diagnosis, used=used, why=why))


def _improbability(diagnosis: Diagnosis) -> float:
    """Return BIC: twice -ln of the probability, by which whole beliefs are compared.

    As in :meth:`Look._support`; an observation that is left out is explained by itself.
    """
    fit, n = diagnosis.fit, len(diagnosis.used)
    factors = diagnosis.noise.factors[diagnosis.model.of_component[diagnosis.used]]
    families = [e.effect for e in diagnosis.taken if e.effect is not None and e.effect.family]
    alternatives = [effect.at(fit.computed).shape[1] for effect in families]
    unknowns = fit.basis.shape[1] + 3 * len(diagnosis.why)
    spread = 2.0 * float(np.log(factors).sum() + np.log(alternatives).sum())
    return float(fit.chi2 + spread + unknowns * np.log(n))


def _explained(diagnosis: Diagnosis) -> Diagnosis:
    bent = True
    while True:
        noise, fit = _settled_noise(diagnosis, bent)
        look = Look(replace(diagnosis, noise=noise, start=fit.x), fit)
        diagnosis = look.diagnosis
        best = max(look.significant(), key=lambda e: e.support, default=None)
        if best is not None and _bearable(diagnosis, best):
            diagnosis = diagnosis.holding(best, look.rivals(best))
        elif bent:
            bent = False
        else:
            return diagnosis


def _bearable(diagnosis: Diagnosis, found: Explanation) -> bool:
    """Whether what is left with an explanation still determines the unknowns."""
    after = diagnosis.holding(found, [])
    try:
        after.fitted(diagnosis.noise.factors, diagnosis.start)
    except ObservabilityError:
        return False
    return bool(after.used.any())


@dataclass(frozen=True, eq=False)
class Look:
    """What a solution says: its groups are judged, and explanations can be asked for."""

    before: Diagnosis
    fit: Fit

    @cached_property
    def diagnosis(self) -> Diagnosis:
        """The diagnosis with what its groups say."""
        gathering = judged(self.before.gathering, self._groups(), self.rest)
        return replace(self.before, gathering=gathering)

    @property
    def rest(self) -> tuple[float, float] | None:
        """Chi-squared and degrees of freedom where the noise was estimated; None: it is known."""
        return (self.fit.chi2, float(self.fit.dof)) if self.before.noise.estimated else None

    def significant(self) -> Iterator[Explanation]:
        """Yield all explanations that are beyond chance."""
        model, limits = self.before.model, self.before.limits
        if self.single is not None and self._stands_out(self.single):
            yield self.single
        for found in self.effects:
            if found.test is not None and found.test.probability < limits.of_each_effect(model):
                yield found
        judgement = self.diagnosis.gathering.judgement
        if judgement is None or not judgement.proved(limits.significance):
            return
        # that proof takes the noise for known; of few residuals its chance is drawn
        if judgement.chance < limits.significance:
            order = np.argsort(-judgement.by_group, kind="stable")[:SUSPECTS]
            tried = [self._together(judgement.groups[k]) for k in order.tolist()]
            yield from sorted(filter(None, tried), key=lambda e: -e.support)[:1]

    def rivals(self, best: Explanation) -> list[Explanation]:
        """Return what explains the residuals nearly as well as ``best``, by another cause."""
        std = np.linalg.norm(self.fit.response, axis=1)
        return [
            e
            for e in (*self.effects, self.single)
            if e is not None
            and e.what != best.what
            and best.support - e.support < np.log(ALIKE)
            and not np.isin(e.rows, best.rows).any()
            and (np.abs(e.change - best.change) > SAME * std).any()
        ]

    @cached_property
    def test_value(self) -> Floats:
        """Test values (n,) of what may go; of estimated noise, over the scatter of the others."""
        fit = self.fit
        test = np.where(fit.used & fit.model.may_go, fit.test_value, 0.0)
        if self.rest is None or fit.dof < 2:
            return test
        others = np.maximum(self.rest[0] - test**2, 1e-300) / (fit.dof - 1)
        return np.asarray(test / np.sqrt(others))

    def _stands_out(self, single: Explanation) -> bool:
        """Whether an observation is beyond the limit; of estimated noise, Student's t."""
        model, limits = self.before.model, self.before.limits
        test = abs(float(self.test_value[single.rows[0]]))
        if self.rest is None:
            return test > limits.outlier(model)
        if self.fit.dof < 3:
            return False
        return test > t_isf(0.5 * limits.of_each_observation(model), self.fit.dof - 1.0)

    def _support(self, squares: float, rank: int, choices: float) -> float:
        """Return ln of how probable an explanation is, by BIC, among e^choices of its kind.

        Where the noise was estimated it holds what is explained: then the likelihood is that of
        noise which is not known beforehand.
        """
        count, fall = max(int(self.fit.used.sum()), 2), squares
        if self.rest is not None:
            fall = -self.rest[1] * float(np.log1p(-min(squares / self.rest[0], ALL_BUT_NOTHING)))
        return 0.5 * fall - 0.5 * rank * float(np.log(count)) - choices

    @cached_property
    def single(self) -> Explanation | None:
        """That the observation which stands out most is wrong."""
        fit, model = self.fit, self.before.model
        row = int(np.argmax(np.abs(self.test_value)))
        if not abs(self.test_value[row]) > 0.0:
            return None
        column = np.eye(len(fit.white), 1, -row)
        size = float(fit.residual[row] / fit.redundancy[row])
        reason = (
            f"its test value {self.test_value[row]:+.1f} is beyond "
            f"{self.before.limits.outlier(model):.2f} (residual "
            f"{model.unit.shown(fit.residual[row])})"
        )
        squares = float(fit.test_value[row] ** 2)
        return Explanation(
            f"{model.row_name(row)} is off by {model.unit.shown(size)}", reason, column,
            np.array([row]), self._support(squares, 1, float(np.log(model.may_go.sum()))),
            -fit.response[:, row] * size / fit.std[row],
        )  # fmt: skip

    def _together(self, group: Group) -> Explanation | None:
        """Return that some members of a ``group`` are off together, those which probably are."""
        case, model = blame(group), self.before.model
        if case is None:
            return None
        rows = case.group.members[case.subset]
        column = np.isin(np.arange(len(self.fit.white)), rows).astype(np.float64)[:, None]
        test = effect_test(seen_by(self.fit, column))
        e, k, listed = case.group.size, len(rows), max(len(case.group.gathered), 1)
        any_of_them = gammaln(e + 1) - gammaln(k + 1) - gammaln(e - k + 1) + np.log(e)
        groups = len(self.diagnosis.gathering.counts)
        choices = np.log(RARER * groups) + min(np.log(listed), any_of_them)
        size = model.unit.shown(float(np.linalg.norm(case.size)))
        return Explanation(
            f"{k} {model.words.elements} of {case.group.name} are off by {size}",
            f"one of {k} of {case.group.name} that are off together by {size}", column, rows,
            self._support(test.squares, test.rank, float(choices)), case.change, blamed=case,
        )  # fmt: skip

    @cached_property
    def effects(self) -> list[Explanation]:
        """That a declared effect is there which was not taken up before."""
        taken = [e.effect for e in self.before.taken]
        tried = [self._effect(e) for e in self.before.model.effects if e not in taken]
        return [e for e in tried if e is not None]

    def _effect(self, effect: Disturbing) -> Explanation | None:
        columns = effect.at(self.fit.computed)
        seen = seen_by(self.fit, columns)
        test = (family_test if effect.family else effect_test)(seen, self.rest)
        if not test.rank:
            return None
        which = slice(test.member, test.member + 1) if effect.family else slice(None)
        choices = float(np.log(RARER * (columns.shape[1] if effect.family else 1)))
        return Explanation(
            effect.what, "", columns[:, which], np.zeros(0, dtype=np.int64),
            self._support(test.squares, test.rank, choices), -(test.size @ seen.moved[which]),
            effect, test,
        )  # fmt: skip

    def _groups(self) -> list[Group]:
        """Return the groups of what is used, with which of their members lie together."""
        fit, model, found = self.fit, self.before.model, list[Group]()
        view = SolutionView(fit.gain @ fit.gain.T, fit.outputs)
        rows = np.where(fit.used[:, None], fit.design / fit.std[:, None], 0.0)
        for grouping in model.groupings:
            for number, members in members_of(grouping, model.may_go).items():
                kept = members[fit.used[members]]
                if not 1 < len(kept) < len(rows):
                    continue
                group = view.group(
                    grouping.kind, f"{grouping.kind} {number}", kept, rows[kept][:, None],
                    fit.white[kept][:, None], 1.0 / fit.std[kept][:, None],
                    gathered_of(grouping, kept), len(members) - len(kept),
                )  # fmt: skip
                found.append(group)
        return found


def seen_by(fit: Fit, columns: Floats) -> Seen:
    """Return what a solution makes of ``columns`` (n, k) of errors."""
    white = np.where(fit.used[:, None], columns / fit.std[:, None], 0.0)
    left = fit.left_of(white)
    return Seen(
        (fit.response @ white).T, left.T @ left, left.T @ fit.white, (white**2).sum(axis=0)
    )


def _robust_start(model: Model, limits: Limits) -> tuple[Floats, Ints]:
    """Return unknowns (p,) that gross errors do not bend, and the observations that are gross."""
    n, p = model.size
    every = np.ones(n, dtype=np.bool_)
    # at first each by what it misses the start values by: a gross error cannot pull them away
    miss = np.maximum(np.abs(model.observed - model.equations(model.first)[0]) / model.std, 1.0)
    fit = fitted(model, every, model.std * miss, model.first)
    for _ in range(ROUNDS):
        # weights of least absolute deviations, which are those of least squares for small ones
        miss = np.maximum(np.abs(fit.residual) / model.std, 1.0)
        after = fitted(model, every, model.std * np.sqrt(miss), fit.x)
        moved = np.abs((after.residual - fit.residual) / model.std).max()
        fit = after
        if moved < 0.01:
            break
    fit = _concentrated(model, fit)
    miss = np.abs(fit.residual) / model.std
    scatter = max(float(np.median(miss)) / NORMAL_QUARTILE, 1.0)
    gross = (miss > GROSS * limits.outlier(model) * scatter) & model.may_go
    try:
        fitted(model, ~gross, model.std, fit.x)
    except RotcalError:
        return fit.x[:p], np.zeros(0, dtype=np.int64)  # too many: they are judged with the rest
    return fit.x[:p], np.flatnonzero(gross)


def _concentrated(model: Model, fit: Fit) -> Fit:
    """Return the fit to the better part of every group, by concentration steps.

    Least trimmed squares (Rousseeuw and Van Driessen 2006). Where that part determines too little
    the fit stays as it is.
    """
    used = fit.used
    for _ in range(ROUNDS):
        better = _better(model, fit)
        if (better == used).all():
            break
        try:
            fit = fitted(model, better, model.std, fit.x)
        except RotcalError:
            break
        used = better
    return fit


def _better(model: Model, fit: Fit) -> Bools:
    """Return the observations (n,) that miss least in every group of the first grouping."""
    miss = np.abs(fit.residual) / model.std
    kept = ~model.may_go
    number = model.groupings[0].number if model.groupings else np.zeros(len(miss), dtype=np.int64)
    for group in np.unique(number):
        rows = np.flatnonzero((number == group) & model.may_go)
        count = int(np.ceil(KEPT * len(rows)))
        kept[rows[np.argsort(miss[rows], kind="stable")[:count]]] = True
    return kept


def _settled_noise(diagnosis: Diagnosis, bent: bool) -> tuple[Noise, Fit]:
    """Return the noise as stated, or estimated where that is contradicted, and the fit with it.

    ``bent``: large residuals count no more than some, while outliers are about.
    """
    ones = np.ones(len(diagnosis.model.components))
    stated = diagnosis.fitted(ones, diagnosis.start)
    chance = _evidence(stated, bent).probabilities()
    if chance.min() >= diagnosis.limits.significance / len(chance):
        return Noise(ones), stated

    def at(factors: Floats, before: Fit) -> tuple[NoiseEvidence, Fit]:
        fit = diagnosis.fitted(factors, before.x)
        return _evidence(fit, bent), fit

    found, fit = estimate_factors(
        at, stated, diagnosis.noise.factors, np.eye(len(ones)) / PRIOR**2,
        NEARLY_SETTLED if bent else SETTLED,
    )  # fmt: skip
    if found.factors.min() < LEAST_FACTOR * (1.0 + 1e-9):
        return Noise(ones), stated  # no instrument scatters so little: exact, made-up data
    return Noise(found.factors, found), fit


def _evidence(fit: Fit, bent: bool) -> NoiseEvidence:
    """Return what the residuals say of each component of the noise."""
    model, count = fit.model, len(fit.model.components)
    squares, redundancy = fit.white**2, fit.redundancy
    if bent:
        squares = bent_squares(squares, redundancy, CHECKED)
    of = model.of_component
    part = np.zeros((len(of), count))
    part[np.arange(len(of)), of] = fit.used
    # R is a projection: the squared sums of its blocks, by way of the basis of its complement
    between = part.T @ (fit.basis @ fit.basis.T) ** 2 @ part
    information = between + np.diag(part.T @ (2.0 * redundancy - 1.0))
    return NoiseEvidence(
        np.asarray(part.any(axis=0)), part.T @ squares, part.T @ redundancy, information
    )
