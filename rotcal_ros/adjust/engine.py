"""From a model to a result that says what could be wrong with it: the whole of the engine.

:func:`adjust` takes a :class:`~.model.Model` and goes through these stages.

1. *Start.* Least absolute deviations, then concentration on the better half of every group, lead
   to a place that gross errors do not bend; what misses it beyond all noise waits outside.
2. *Noise.* Components are tested, and estimated where the statement is contradicted
   (:mod:`.noise`), with large residuals bent while outliers are about.
3. *Explanations.* Asked for in every round: whether some of a group are off together
   (:mod:`.judgement`), whether a declared effect is there (:mod:`.effects`), whether single
   observations stand out (Baarda's test, Sidak's limit for their number). Of what is significant
   the most probable goes first: observations are left out, an effect becomes an unknown. One that
   explains nearly as much is remembered: the difference it makes joins the covariance.
4. *Outside.* What waited and agrees after all comes back.
5. *Statement.* Covariance, doubts in words, verdict, and what each effect may do unseen.

:func:`predicted` tells the same of a plan without data.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Final, NamedTuple

import numpy as np
from scipy.special import gammaln

from rotcal_ros.adjust import effects
from rotcal_ros.adjust.distributions import chi2_isf, chi2_sf, normal_isf, t_isf
from rotcal_ros.adjust.effects import EffectTest, Seen, Unseen
from rotcal_ros.adjust.gathering import (
    SUSPECTED,
    Gathering,
    GatheringLimits,
    details,
    doubts,
    judged,
)
from rotcal_ros.adjust.groups import CHECKED, Group, SolutionView
from rotcal_ros.adjust.judgement import ALIKE, Blame, Judgement, blame
from rotcal_ros.adjust.model import (
    Disturbing,
    Fit,
    Model,
    fitted,
    gathered_of,
    members_of,
    require_determined,
)
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
from rotcal_ros.adjust.reliability import hidden
from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.errors import ObservabilityError, RotcalError
from rotcal_ros.foundation.protection import POWER, Effect, Protection, ordered
from rotcal_ros.foundation.raw_data import Influence, RawData
from rotcal_ros.foundation.results import Rejection, Residuals, Result, Verdict

HARMLESS: Final = 0.1
"""Error, in standard uncertainties, of an effect that nobody has to be told of."""
ROUNDS: Final = 30
"""Reweighted adjustments of the robust start, and concentration steps after them."""
KEPT: Final = 0.6
"""Share of each group that the robust start concentrates on."""
GROSS: Final = 5.0
"""Times the limit of an outlier, in the scatter of the others, that bends a start."""
NORMAL_QUARTILE: Final = 0.6745
"""Median of |x| for a standard normal x."""
LARGEST: Final = 1000.0
"""Errors of several observations, in their stated noise, that nobody would overlook."""
SUSPECTS: Final = 4
"""Groups of which it is asked who is to blame, the most probable ones."""
FAILED_SHARE: Final = 0.2
"""Share of rejected observations from which the rest proves nothing."""
FAILED_FACTOR: Final = 10.0
"""Times the stated noise from which the model does not describe the observations."""


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


LIMITS: Final = Limits()


class Explanation(NamedTuple):
    """What may be wrong, in words and how probably; ``reason``: why rows are left out for it.

    ``columns`` (n, k) of errors in the unit of the observations; ``rows`` are left out for it, or
    it is ``effect`` (and of a family the ``member``) and becomes an unknown. ``squares``: what
    chi-squared falls by for ``rank`` unknowns; ``support``: ln of its probability, by BIC and the
    number of alternatives of its kind. ``change`` (o,): what it does to the outputs.
    """

    what: str
    reason: str
    columns: Floats
    rows: Ints
    squares: float
    support: float
    change: Floats
    effect: Disturbing | None = None
    test: EffectTest | None = None
    blamed: Blame | None = None


@dataclass(frozen=True, eq=False)
class Noise:
    """Factors (c,) on the stated noise; ``estimated`` is None where the statements hold."""

    factors: Floats
    estimated: EstimatedFactors | None = None


@dataclass(frozen=True, eq=False)
class Adjusted:
    """A solved model, and what was found on the way.

    ``why`` says by row why an observation was left out, ``taken`` which effects became unknowns,
    ``contested`` (o, o) what ``rivals`` of either add to the covariance. ``scale``: factor on the
    covariance for noise that the components do not explain.
    """

    fit: Fit
    noise: Noise
    limits: Limits
    why: dict[int, str]
    taken: tuple[Explanation, ...]
    gathering: Gathering
    contested: Floats
    rivals: tuple[str, ...] = ()
    scale: float = 1.0

    @property
    def model(self) -> Model:
        """What was solved."""
        return self.fit.model

    @property
    def value(self) -> Floats:
        """The outputs (o,)."""
        return self.fit.value

    @cached_property
    def covariance(self) -> Floats:
        """Covariance (o, o) of the outputs, with all that is probable but not proved."""
        total = self.scale**2 * (self.fit.response @ self.fit.response.T) + self.contested
        gathers = self.gathering.covariance()
        return np.asarray(total if gathers is None else total + gathers)

    @property
    def std(self) -> Floats:
        """Standard uncertainties (o,) of the outputs."""
        return np.sqrt(np.maximum(self.covariance.diagonal(), 0.0))

    @property
    def sigma0(self) -> float:
        """Scatter of the residuals over what is stated; 1 where nothing is checked."""
        fit = self.fit
        stated = np.where(fit.used, fit.residual / self.model.std, 0.0)
        return float(np.sqrt(stated @ stated / fit.dof)) if fit.dof else 1.0

    @property
    def rejected(self) -> tuple[Rejection, ...]:
        """The observations that were left out."""
        return tuple(Rejection(row, self.why[row]) for row in sorted(self.why))

    @cached_property
    def seen(self) -> list[tuple[Disturbing, Seen]]:
        """What the solution makes of each declared effect."""
        return [
            (effect, _seen(self.fit, effect.at(self.fit.computed)))
            for effect in self.model.effects
        ]

    @cached_property
    def doubts(self) -> tuple[str, ...]:
        """A sentence about everything that is odd; any makes the result suspect."""
        return tuple(_doubts(self))

    @property
    def verdict(self) -> Verdict:
        """Whether the model describes the observations."""
        share = len(self.why) / max(int(self.model.may_go.sum()), 1)
        larger = self.scale * self.noise.factors.max(initial=1.0)
        if share > FAILED_SHARE or larger > FAILED_FACTOR:
            return "failed"
        return "suspect" if self.doubts else "ok"

    def trials(self, rng: np.random.Generator, count: int) -> Floats:
        """Draw ``count`` measurements with the noise that was used; return outputs (count, o)."""
        noise = self.scale * rng.standard_normal((count, len(self.fit.std))) * self.fit.used
        return np.asarray(self.value + noise @ self.fit.response.T)

    def protections(self) -> tuple[Protection, ...]:
        """Return what is done about each declared effect, the noise, and what gathers."""
        return tuple(_protections(self))

    def result(
        self,
        method: str,
        angles: Floats,
        components: Mapping[str, slice],
        places: tuple[Ints, Ints],
        *,
        counts_from: str = "first angle",
        doubts: Sequence[str] = (),
        protections: Sequence[Protection] = (),
        details: Mapping[str, Any] | None = None,
    ) -> Result:
        """Return the result that all methods share, the table at ``angles`` (m,), rad.

        ``components`` says which outputs are the deviations of which component. ``places``: table
        position (k,) and target (k,) of the first k observations, which a table measured; others
        are known beforehand. What the method itself doubts, protects against and tells joins what
        was found here; its word on an effect takes the place of ours.
        """
        (position, target), fit, whole = places, self.fit, self.covariance
        measured = slice(len(position))
        every = {p.effect: p for p in (*self.protections(), *protections)}
        suspect = self.verdict == "ok" and bool(doubts)
        return Result(
            method=method,
            angles=angles,
            deviations={name: self.value[part] for name, part in components.items()},
            std={name: self.std[part] for name, part in components.items()},
            covariance={name: whole[part, part] for name, part in components.items()},
            sigma0=self.sigma0,
            dof=fit.dof,
            n_observations=len(position),
            rejected=self.rejected,
            verdict="suspect" if suspect else self.verdict,
            warnings=(*doubts, *self.doubts),
            protections=ordered(every.values()),
            residuals=Residuals(
                position, target, fit.residual[measured], fit.redundancy[measured],
                fit.test_value[measured], fit.used[measured], fit.std[measured],
            ),
            raw_data=RawData(influence=self._influence(components, len(position))),
            details={**self.details(), **(details or {})},
        ).counted_from(counts_from)  # fmt: skip

    def _influence(self, components: Mapping[str, slice], measured: int) -> Influence:
        """Return what standard errors of what is used do to the deviations."""
        rows = np.flatnonzero(self.fit.used[:measured])
        known = np.arange(measured, len(self.fit.used))
        felt = self.scale * self.fit.response[:, np.append(rows, known)]
        causes = tuple(self.model.row_name(row) for row in known.tolist())
        return Influence(rows, 1, {n: felt[part] for n, part in components.items()}, causes)

    def details(self) -> dict[str, Any]:
        """Return what was found for the details of a result, SI."""
        return {
            "chi_square": {
                "value": self.fit.chi2,
                "dof": self.fit.dof,
                "p_value": chi2_sf(self.fit.chi2, self.fit.dof) if self.fit.dof else None,
            },
            "noise": dict(zip(self.model.components, self.noise.factors.tolist(), strict=True)),
            "effects_found": [
                {"effect": e.effect.effect, "size": e.test.size}
                for e in self.taken
                if e.effect is not None and e.test is not None
            ],
            "gathering": details(self.gathering, "observations"),
        }


@dataclass(frozen=True, eq=False)
class Prediction:
    """What a plan would give: ``std`` (o,), ``redundancy`` (n,), by effect what stays unseen."""

    std: Floats
    redundancy: Floats
    unseen: dict[Effect, Unseen]


def predicted(model: Model, limits: Limits = LIMITS) -> Prediction:
    """Return what ``model`` would give; its observations do not matter.

    Raises ObservabilityError where they leave a direction open.
    """
    computed, _ = model.equations(model.first)
    exact = replace(model, observed=computed)
    fit = fitted(exact, np.ones(len(computed), dtype=np.bool_), model.std, model.first)
    std = np.linalg.norm(fit.response, axis=1)
    every = {
        e.effect: _unseen(e, _seen(fit, e.at(computed)), std, _of_each(model, limits))
        for e in model.effects
    }
    return Prediction(std, fit.redundancy, every)


@dataclass(frozen=True, eq=False)
class _State:
    """What is believed so far."""

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

    @property
    def extra(self) -> Floats:
        """The columns (n, q) of the effects that became unknowns."""
        n = len(self.used)
        return np.concatenate([np.zeros((n, 0)), *(e.columns for e in self.taken)], axis=1)

    def fitted(self, factors: Floats, start: Floats) -> Fit:
        """Return the solution with ``factors`` (c,) on the stated noise."""
        std = self.model.std * factors[self.model.of_component]
        return fitted(self.model, self.used, std, start, self.extra)


def adjust(model: Model, limits: Limits = LIMITS) -> Adjusted:
    """Solve ``model`` and say what is wrong with it; see the module's docstring.

    Raises ObservabilityError where the observations leave more open than the free directions,
    DataError where they contradict each other so much that nothing settles.
    """
    require_determined(model)
    start, gross = _robust_start(model, limits)
    ones = np.ones(len(model.components))
    why = {int(row): f"{model.row_name(int(row))}: far off all others" for row in gross}
    used = np.isin(np.arange(len(model.observed)), gross, invert=True)
    state = _explained(_State(model, limits, used, Noise(ones), start, why=why))
    fit = state.fitted(state.noise.factors, state.start)
    back = gross[np.abs(fit.test_value[gross]) <= _limit(model, limits)]
    if len(back):
        used = state.used.copy()
        used[back] = True
        why = {row: text for row, text in state.why.items() if row not in back.tolist()}
        state = _explained(replace(state, used=used, why=why))
        fit = state.fitted(state.noise.factors, state.start)
    return _finished(state, fit)


def _finished(state: _State, fit: Fit) -> Adjusted:
    contested = np.zeros((len(fit.value), len(fit.value)))
    for weight, change in state.contested:
        contested += weight * np.outer(change, change)
    chance = chi2_sf(fit.chi2, fit.dof) if fit.dof else 1.0
    unexplained = float(np.sqrt(fit.chi2 / fit.dof)) if fit.dof else 1.0
    enlarged = chance < state.limits.significance and unexplained > 1.0
    return Adjusted(
        fit, state.noise, state.limits, state.why, state.taken, state.gathering, contested,
        state.rivals, unexplained if enlarged else 1.0,
    )  # fmt: skip


# ---- start ----------------------------------------------------------------------------------


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
    gross = (miss > GROSS * _limit(model, limits) * scatter) & model.may_go
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


# ---- noise ----------------------------------------------------------------------------------


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


def _settled(state: _State, bent: bool) -> tuple[Noise, Fit]:
    """Return the noise as stated, or estimated where that is contradicted, and the fit with it."""
    ones = np.ones(len(state.model.components))
    stated = state.fitted(ones, state.start)
    chance = _evidence(stated, bent).probabilities()
    if chance.min() >= state.limits.significance / len(chance):
        return Noise(ones), stated

    def at(factors: Floats, before: Fit) -> tuple[NoiseEvidence, Fit]:
        fit = state.fitted(factors, before.x)
        return _evidence(fit, bent), fit

    found, fit = estimate_factors(
        at, stated, state.noise.factors, np.eye(len(ones)) / PRIOR**2,
        NEARLY_SETTLED if bent else SETTLED,
    )  # fmt: skip
    if found.factors.min() < LEAST_FACTOR * (1.0 + 1e-9):
        return Noise(ones), stated  # no instrument scatters so little: exact, made-up data
    return Noise(found.factors, found), fit


# ---- explanations ---------------------------------------------------------------------------


def _explained(state: _State) -> _State:
    """Return the state in which nothing significant is left unexplained."""
    bent = True
    while True:
        noise, fit = _settled(state, bent)
        state = replace(state, noise=noise, start=fit.x)
        rest = (fit.chi2, float(fit.dof)) if noise.estimated else None
        state = replace(state, gathering=judged(state.gathering, _groups(state, fit), rest))
        found = sorted(_significant(state, fit, rest), key=lambda e: -e.support)
        if found and _bearable(state, found[0]):
            state = _with(state, found[0], _rivals(state, fit, rest, found[0]))
        elif bent:
            bent = False
        else:
            return state


def _bearable(state: _State, found: Explanation) -> bool:
    """Whether what is left without the rows of an explanation still determines the unknowns."""
    used = state.used.copy()
    used[found.rows] = False
    try:
        after = _with(state, found, [])
        after.fitted(state.noise.factors, state.start)
    except ObservabilityError:
        return False
    return bool(used.sum() > 0)


def _significant(
    state: _State, fit: Fit, rest: tuple[float, float] | None
) -> Iterator[Explanation]:
    """Yield all explanations that are beyond chance."""
    single = _single(state, fit, rest)
    if single is not None and _stands_out(state, fit, rest, single):
        yield single
    for found in _effects(state, fit, rest):
        each = _of_each(state.model, state.limits)
        if found.test is not None and found.test.probability < each:
            yield found
    judgement = state.gathering.judgement
    # proof by Markov's inequality takes the noise for known: of few residuals it is drawn
    if (
        judgement is not None
        and judgement.proved(state.limits.significance)
        and judgement.chance < state.limits.significance
    ):
        together = [
            found for group in _suspects(judgement) if (found := _together(state, fit, group))
        ]
        yield from sorted(together, key=lambda e: -e.support)[:1]


def _suspects(judgement: Judgement) -> list[Group]:
    """Return the groups that something may gather in, the most probable ones."""
    order = np.argsort(-judgement.by_group, kind="stable")[:SUSPECTS]
    return [judgement.groups[k] for k in order.tolist()]


def _stands_out(
    state: _State, fit: Fit, rest: tuple[float, float] | None, single: Explanation
) -> bool:
    """Whether an observation is beyond the limit; of estimated noise, that of Student's t."""
    test = abs(float(_studentised(fit, rest)[single.rows[0]]))
    if rest is None:
        return test > _limit(state.model, state.limits)
    if fit.dof < 3:
        return False
    each = _sidak(state.limits.rejection, int(state.model.may_go.sum()))
    return test > t_isf(0.5 * each, fit.dof - 1.0)


def _rivals(
    state: _State, fit: Fit, rest: tuple[float, float] | None, best: Explanation
) -> list[Explanation]:
    """Return what explains the residuals nearly as well as ``best``, by another cause."""
    tried = [*_effects(state, fit, rest), _single(state, fit, rest)]
    others = [e for e in tried if e is not None and e.what != best.what]
    return [
        e
        for e in others
        if best.support - e.support < np.log(ALIKE) and not np.isin(e.rows, best.rows).any()
    ]


def _with(state: _State, found: Explanation, rivals: Sequence[Explanation]) -> _State:
    """Return the state that holds an explanation for true, and its ``rivals`` for possible."""
    weight = np.exp([e.support - found.support for e in rivals])
    weight = weight / (1.0 + weight.sum())
    contested = [(w, e.change - found.change) for w, e in zip(weight, rivals, strict=True)]
    ambiguous = tuple(
        f"that {found.what} explains the residuals, and that {e.what} does so nearly as well "
        f"(likelihood 1 : {np.exp(found.support - e.support):.2g}): the uncertainty covers both"
        for e in rivals
    )
    state = replace(
        state,
        contested=(*state.contested, *contested),
        rivals=(*state.rivals, *ambiguous),
    )
    if found.effect is not None:
        return replace(state, taken=(*state.taken, found))
    used = state.used.copy()
    used[found.rows] = False
    reasons = {int(row): f"{state.model.row_name(int(row))}: {found.reason}" for row in found.rows}
    gathering = state.gathering
    if found.blamed is not None:
        gathering = replace(gathering, blamed=(*gathering.blamed, found.blamed))
    return replace(state, used=used, why=state.why | reasons, gathering=gathering)


def _support(fit: Fit, squares: float, rank: int, choices: float) -> float:
    """Return ln of how probable an explanation is, by BIC, among so many of its kind."""
    return 0.5 * squares - 0.5 * rank * float(np.log(max(fit.used.sum(), 2))) - choices


def _studentised(fit: Fit, rest: tuple[float, float] | None) -> Floats:
    """Return the test values (n,) of what may go; of estimated noise, over that of the others."""
    test = np.where(fit.used & fit.model.may_go, fit.test_value, 0.0)
    if rest is None or fit.dof < 2:
        return test
    return np.asarray(test / np.sqrt(np.maximum(rest[0] - test**2, 1e-300) / (fit.dof - 1)))


def _single(state: _State, fit: Fit, rest: tuple[float, float] | None) -> Explanation | None:
    """Return the observation that stands out most."""
    test = _studentised(fit, rest)
    row = int(np.argmax(np.abs(test)))
    if not abs(test[row]) > 0.0:
        return None
    column = np.zeros((len(test), 1))
    column[row] = 1.0
    size = fit.residual[row] / fit.redundancy[row]
    change = -fit.response[:, row] * size / fit.std[row]
    unit = state.model.unit
    what = f"{state.model.row_name(row)} is off by {unit.shown(size)}"
    reason = (
        f"its test value {test[row]:+.1f} is beyond {_limit(state.model, state.limits):.2f} "
        f"(residual {unit.shown(fit.residual[row])})"
    )
    rows, squares = np.array([row]), float(fit.test_value[row] ** 2)
    choices = float(np.log(state.model.may_go.sum()))
    return Explanation(
        what, reason, column, rows, squares, _support(fit, squares, 1, choices), change
    )


def _together(state: _State, fit: Fit, group: Group) -> Explanation | None:
    """Return the members of a ``group`` that most probably are off together."""
    case = blame(group)
    if case is None:
        return None
    rows = case.group.members[case.subset]
    column = np.zeros((len(fit.white), 1))
    column[rows] = 1.0
    test = effects.effect_test(_seen(fit, column))
    e, k = case.group.size, len(rows)
    subsets = max(len(case.group.gathered), 1)
    choices = np.log(len(state.gathering.counts)) + min(
        np.log(subsets), float(gammaln(e + 1) - gammaln(k + 1) - gammaln(e - k + 1)) + np.log(e)
    )
    size = state.model.unit.shown(float(np.linalg.norm(case.size)))
    what = f"{k} {state.model.words.elements} of {case.group.name} are off by {size}"
    support = _support(fit, test.squares, test.rank, float(choices))
    reason = f"one of {k} of {case.group.name} that are off together by {size}"
    return Explanation(what, reason, column, rows, test.squares, support, case.change, blamed=case)


def _effects(state: _State, fit: Fit, rest: tuple[float, float] | None) -> Iterator[Explanation]:
    """Yield how each declared effect explains the residuals, but for those that were taken up."""
    known = [e.effect for e in state.taken]
    for effect in state.model.effects:
        if effect in known:
            continue
        columns = effect.at(fit.computed)
        seen = _seen(fit, columns)
        test = (effects.family_test if effect.family else effects.effect_test)(seen, rest)
        if not test.rank:
            continue
        which = slice(test.member, test.member + 1) if effect.family else slice(None)
        choices = float(np.log(columns.shape[1])) if effect.family else 0.0
        yield Explanation(
            effect.what, "", columns[:, which], np.zeros(0, dtype=np.int64), test.squares,
            _support(fit, test.squares, test.rank, choices),
            -(test.size @ seen.moved[which]), effect, test,
        )  # fmt: skip


def _seen(fit: Fit, columns: Floats) -> Seen:
    """Return what a solution makes of ``columns`` (n, k) of errors."""
    white = np.where(fit.used[:, None], columns / fit.std[:, None], 0.0)
    left = fit.left_of(white)
    return Seen(
        (fit.response @ white).T, left.T @ left, left.T @ fit.white, (white**2).sum(axis=0)
    )


def _groups(state: _State, fit: Fit) -> list[Group]:
    """Return the groups of what is used, each with which of its members lie together."""
    n = len(fit.white)
    view = SolutionView(fit.gain @ fit.gain.T, fit.outputs)
    rows = np.where(fit.used[:, None], fit.design / fit.std[:, None], 0.0)
    found = []
    for grouping in state.model.groupings:
        for number, members in members_of(grouping, state.model.may_go).items():
            kept = members[fit.used[members]]
            if len(kept) < 2 or len(kept) == n:
                continue
            found.append(
                view.group(
                    grouping.kind,
                    f"{grouping.kind} {number}",
                    kept,
                    rows[kept][:, None, :],
                    fit.white[kept][:, None],
                    1.0 / fit.std[kept][:, None],
                    gathered_of(grouping, kept),
                    len(members) - len(kept),
                )
            )
    return found


def _limit(model: Model, limits: Limits) -> float:
    """Return the test value that no sound observation exceeds, but for ``limits.rejection``."""
    return normal_isf(0.5 * _sidak(limits.rejection, int(model.may_go.sum())))


def _of_each(model: Model, limits: Limits) -> float:
    """Return the significance of the test of each declared effect."""
    return _sidak(limits.significance, max(len(model.effects), 1))


def _sidak(significance: float, tests: int) -> float:
    return float(-np.expm1(np.log1p(-significance) / max(tests, 1)))


# ---- statement ------------------------------------------------------------------------------


def _doubts(found: Adjusted) -> Iterator[str]:
    model = found.model
    larger = found.noise.estimated is not None
    for name, factor in zip(model.components, found.noise.factors.tolist(), strict=True):
        if larger and factor > 1.0:
            yield (
                f"the scatter of {name} is {factor:.2g} times as stated: the estimate is used; "
                "state it, or look for drift"
            )
    if found.scale > 1.0:
        yield (
            f"the residuals are {found.scale:.2g} times what their standard deviations allow "
            "(chi-squared test): the uncertainty is enlarged by that factor"
        )
    for effect, test in ((e.effect, e.test) for e in found.taken):
        if effect is not None and test is not None:
            sizes = ", ".join(effect.unit.shown(s) for s in test.size.tolist())
            yield (
                f"it looks as if {effect.what}, by {sizes} (p = {test.probability:.2g}): that was "
                "taken off, and the uncertainty holds it; find out why, and measure again"
            )
    yield from found.rivals
    yield from doubts(
        found.gathering,
        GatheringLimits(found.limits.rejected_share, found.limits.significance),
        model.words,
    )
    share = len(found.why) / max(int(model.may_go.sum()), 1)
    if share > found.limits.rejected_share:
        yield (
            f"{len(found.why)} of {int(model.may_go.sum())} {model.words.elements} were left out, "
            f"more than {100 * found.limits.rejected_share:g} % is suspicious"
        )


def _protections(found: Adjusted) -> Iterator[Protection]:
    each = _of_each(found.model, found.limits)
    taken = {e.effect.effect for e in found.taken if e.effect is not None}
    worst: dict[Effect, tuple[Unseen, Disturbing]] = {}
    for effect, seen in found.seen:
        hides = _unseen(effect, seen, found.std, each)
        if effect.effect not in worst or hides.error > worst[effect.effect][0].error:
            worst[effect.effect] = hides, effect
    for name, (hides, effect) in worst.items():
        if name in taken:
            yield Protection(name, "estimated", f"it was found that {effect.what}")
        elif hides.error <= HARMLESS:
            why = f"that {effect.what} moves the result by less than a tenth of its uncertainty"
            yield Protection(name, "harmless", why)
        elif not hides.found:
            why = f"that {effect.what} leaves no residual"
            yield Protection(name, "not protected", why)
        else:
            why = f"that {effect.what} contradicts other {found.model.words.elements}"
            yield Protection(name, "tested", why, hides.error)
    yield _against_noise(found)
    yield from _against_gathering(found)


def _unseen(effect: Disturbing, seen: Seen, std: Floats, significance: float) -> Unseen:
    worst = effects.unseen_family if effect.family else effects.unseen
    return worst(seen, std, effect.largest, significance=significance, power=POWER)


def _against_noise(found: Adjusted) -> Protection:
    dof = found.fit.dof
    if not dof:
        return Protection("axis noise", "not protected", "nothing is measured twice")
    ratio = float(chi2_isf(found.limits.significance, dof) / chi2_isf(POWER, dof))
    why = f"{dof} residuals test the stated noise, which is estimated where it does not hold"
    return Protection("axis noise", "tested", why, float(np.sqrt(max(ratio - 1.0, 0.0))))


def _against_gathering(found: Adjusted) -> Iterator[Protection]:
    judgement = found.gathering.judgement
    if judgement is None:
        return
    words, unit = found.model.words, found.model.unit
    worst = hidden(
        judgement.groups, found.std, SUSPECTED, POWER, LARGEST * float(found.model.std.max())
    )
    if worst is None:
        return
    what = f"several {words.elements} that are off together ({words.cause})"
    if not worst.seen:
        yield Protection("one place", "not protected", f"{what} leave no residual")
        return
    why = (
        f"{what} are looked for; {worst.count} of {worst.name} by {unit.shown(worst.size)} are "
        "found, the worst case"
    )
    yield Protection("one place", "tested", why, worst.error)
