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
from scipy.sparse import csr_array, diags_array
from scipy.special import gammaln

from rotcal_ros.adjust.arrow import dense
from rotcal_ros.adjust.circles import Circular
from rotcal_ros.adjust.distributions import normal_isf, sidak, t_isf
from rotcal_ros.adjust.effects import EffectTest, Seen, effect_test, family_test, member_squares
from rotcal_ros.adjust.fit import Fit, Whole, fitted
from rotcal_ros.adjust.gathering import Gathering, judged
from rotcal_ros.adjust.groups import CHECKED, Group, JudgedWhole, Undivided
from rotcal_ros.adjust.judgement import ALIKE, Blame, blame
from rotcal_ros.adjust.low_rank import LowRank
from rotcal_ros.adjust.model import Disturbing, Grouping, Model, Steps, gathered_of, members_of
from rotcal_ros.adjust.noise import (
    LEAST_FACTOR,
    LEAST_REDUNDANCY,
    NEARLY_SETTLED,
    PRIOR,
    SETTLED,
    EstimatedFactors,
    NoiseEvidence,
    bent_squares,
    estimate_factors,
)
from rotcal_ros.adjust.sensitivity import Sensitivity
from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.errors import DataError, ObservabilityError, RotcalError

ROUNDS: Final = 30
"""Reweighted adjustments of the robust start, and concentration steps after them."""
KEPT: Final = 0.6
"""Share of each group that the robust start concentrates on."""
FAR_WORSE: Final = 5.0
"""Times the standard uncertainty that all give an output: a part that does worse misses some."""
GROSS: Final = 5.0
"""Times the limit of an outlier, in the scatter of the others, that bends a start."""
NORMAL_QUARTILE: Final = 0.6745
"""Median of |x| for a standard normal x."""
RARER: Final = 3.0
"""How much rarer an effect or a gathering is held to be than a single wrong observation."""
ALL_BUT_NOTHING: Final = 1.0 - 1e-12
"""Share of chi-squared, at most, that is said to be explained."""
NOTHING: Final = 1e-300
"""Chi-squared of exact observations, by which may be divided."""
TIED: Final = 1e-6
"""Difference of two supports, or improbabilities, that is rounding: the first asked goes first."""
MOST_RIVALS: Final = 12
"""Other causes that are compared with the best of a kind."""
WEAK: Final = 1e-4
"""Information of a size, per that of its errors without the unknowns, below which digits go."""
FEW: Final = 0.1
"""Share of entries that are not zero below which columns are sparse."""
FEW_EFFECTS: Final = 3
"""Effects that are taken up, one after the other, instead of larger noise."""
LARGEST_GROUP: Final = 720
"""Observations of a group up to which it is asked which of them are off together."""
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
        return sidak(self.rejection, int(model.may_go.sum()))

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
    alternatives of its kind. ``change`` (o + a,): what it does to all outputs.
    """

    what: str
    reason: str
    columns: Floats
    rows: Ints
    support: float
    price: float
    change: Floats
    effect: Disturbing | None = None
    mixing: Floats | None = None
    probability: float = 0.0
    blamed: Blame | None = None


class Contest(NamedTuple):
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
    why: dict[int, str] = field(default_factory=dict)
    taken: tuple[Explanation, ...] = ()
    contests: tuple[Contest, ...] = ()
    price: float = 0.0

    @cached_property
    def used(self) -> Bools:
        """The observations (n,) in use: those that nothing was said against."""
        return np.isin(np.arange(len(self.model.observed)), list(self.why), invert=True)

    def fitted(self, factors: Floats, start: Floats) -> Fit:
        """Return the solution with ``factors`` (c,) on the stated noise."""
        extra = np.column_stack([np.zeros((len(self.used), 0)), *(e.columns for e in self.taken)])
        std = self.model.std * factors[self.model.of_component]
        return fitted(self.model, self.used, std, start, extra)

    @cached_property
    def fit(self) -> Fit:
        """The solution with the noise that is believed."""
        return self.fitted(self.noise.factors, self.start)

    def in_words(self) -> str:
        """Return what is wrong with the observations."""
        name = self.model.names
        gone = ", ".join(name[row] for row in sorted(self.why)[:8])
        if len(self.why) > 8:
            gone = f"{gone} and {len(self.why) - 8} others"
        parts = [f"{gone} are wrong"] if gone else []
        return " and ".join([*parts, *(e.what for e in self.taken)]) or "nothing is wrong"

    def holding(self, found: Explanation, rivals: Sequence[Explanation] = ()) -> Diagnosis:
        """Return the diagnosis that ``found`` is true, and that its ``rivals`` are possible."""
        contests = (*self.contests, Contest(found, tuple(rivals))) if rivals else self.contests
        here = replace(self, contests=contests, price=self.price + found.price)
        if found.effect is not None:
            return replace(here, taken=(*here.taken, found))
        name, gathering = self.model.names, self.gathering
        if found.blamed is not None:
            gathering = gathering.without(found.blamed)
        reasons = {row: f"{name[row]}: {found.reason}" for row in found.rows.tolist()}
        return replace(here, why=self.why | reasons, gathering=gathering)

    @property
    def open_contests(self) -> tuple[Contest, ...]:
        """The contests without rivals that were taken for true as well, later on."""
        taken = [e.what for e in self.taken]
        remaining = (
            Contest(c.best, tuple(e for e in c.rivals if not self._holds(e, taken)))
            for c in self.contests
        )
        return tuple(contest for contest in remaining if contest.rivals)

    def _holds(self, rival: Explanation, taken: Sequence[str]) -> bool:
        if rival.effect is not None:
            return rival.what in taken
        return bool(len(rival.rows)) and all(row in self.why for row in rival.rows.tolist())

    def contested(self) -> Iterator[tuple[float, Floats]]:
        """Yield the probability of each rival, and by how much (o,) it moves the outputs."""
        for best, rivals in self.open_contests:
            weight = np.exp([min(e.support - best.support, 0.0) for e in rivals])
            for share, e in zip(weight / (1.0 + weight.sum()), rivals, strict=True):
                yield float(share), e.change - best.change


def found_causes(model: Model, limits: Limits) -> Diagnosis:
    """Return what is believed when nothing significant is left unexplained.

    Gross errors wait outside from the start, and come back where they agree after all, or where
    something explains them together.
    """
    start, gross = _robust_start(model, limits)
    whole = Diagnosis(model, limits, Noise(np.ones(len(model.components))), start)
    if not len(gross):
        return _explained(whole)
    apart = _come_back(_explained(_outside(whole, gross)), gross)
    try:
        together = _explained(whole)
    except RotcalError:
        return apart  # gross errors in all directions let nothing settle
    if _improbability(apart) < _improbability(together) - TIED:
        return _contested_by(apart, together)
    return _contested_by(together, apart)  # it says what else may be wrong


def _contested_by(best: Diagnosis, other: Diagnosis) -> Diagnosis:
    """Return the ``best`` of two diagnoses, and that the ``other`` is possible where it is."""
    apart, change = _improbability(other) - _improbability(best), other.fit.value - best.fit.value
    if apart >= 2.0 * np.log(ALIKE) or not best.fit.felt(change):
        return best
    none, nothing = np.zeros((len(best.used), 0)), np.zeros(0, dtype=np.int64)
    chosen = Explanation(best.in_words(), "", none, nothing, 0.0, 0.0, 0.0 * change)
    rival = chosen._replace(what=other.in_words(), support=-0.5 * apart, change=change)
    return replace(best, contests=(*best.contests, Contest(chosen, (rival,))))


def _outside(diagnosis: Diagnosis, gross: Ints) -> Diagnosis:
    name = diagnosis.model.names
    why = {row: f"{name[row]}: far off all others" for row in gross.tolist()}
    return replace(diagnosis, why=why, price=_price_of_single(diagnosis) * len(gross))


def _price_of_single(diagnosis: Diagnosis) -> float:
    """Return the price of one observation that explains itself, of as many as there are."""
    return 3.0 * float(np.log(len(diagnosis.model.observed)))


def _come_back(diagnosis: Diagnosis, gross: Ints) -> Diagnosis:
    """Return the diagnosis with those of the ``gross`` observations that agree after all."""
    limit = diagnosis.limits.outlier(diagnosis.model)
    back = gross[np.abs(diagnosis.fit.test_value[gross]) <= limit].tolist()
    if not back:
        return diagnosis
    why = {row: text for row, text in diagnosis.why.items() if row not in back}
    price = diagnosis.price - _price_of_single(diagnosis) * len(back)
    return _explained(replace(diagnosis, why=why, price=price))


def _improbability(diagnosis: Diagnosis) -> float:
    """Return BIC: twice -ln of the probability, by which whole beliefs are compared.

    As in :meth:`Look._support`; an observation that waits outside is explained by itself.
    """
    fit, n = diagnosis.fit, len(diagnosis.used)
    factors = diagnosis.noise.factors[diagnosis.model.of_component[diagnosis.used]]
    unknowns = fit.cofactors.rank - sum(e.columns.shape[1] for e in diagnosis.taken)
    spread = 2.0 * float(np.log(factors).sum())
    return float(fit.chi2 + spread + unknowns * np.log(n) + diagnosis.price)


def _explained(diagnosis: Diagnosis) -> Diagnosis:
    """Return what explains the residuals; effects may do so far better than larger noise.

    Far, for noise that is stated too small is no rare thing.
    """
    found = _explained_beside_noise(diagnosis)
    if found.noise.factors.max() <= 1.0:
        return found
    other = _by_effects(diagnosis)
    if other is None:
        return found
    # what the unknowns take up says nothing of the noise: its restricted likelihood
    used = found.used
    taken_up = 1.0 - found.fit.redundancy[used]
    spread = 2.0 * taken_up @ np.log(found.noise.factors[found.model.of_component[used]])
    if _improbability(other) < _improbability(found) - spread - 2.0 * np.log(ALIKE):
        return other
    return found


def _by_effects(diagnosis: Diagnosis) -> Diagnosis | None:
    """Return how few effects explain what else had to be noise; None if they do not."""
    ones = np.ones(len(diagnosis.model.components))
    for _ in range(FEW_EFFECTS):
        fit = diagnosis.fitted(ones, diagnosis.start)
        look = Look(replace(diagnosis, noise=Noise(ones), start=fit.x), fit)
        found = [e for e in look.significant() if _bearable(look.before, e)]
        best = max(found, key=lambda e: e.support, default=None)
        if best is None or best.effect is None:
            return None
        diagnosis = look.diagnosis.holding(best, look.rivals(best))
        try:
            after = _explained_beside_noise(diagnosis)
        except DataError:
            return None  # it does not settle: no explanation
        if after.noise.estimated is None:
            return after
    return None


def _explained_beside_noise(diagnosis: Diagnosis) -> Diagnosis:
    bent = True
    while True:
        noise, fit = _settled_noise(diagnosis, bent)
        # what was judged before is judged anew: large groups are not kept twice
        gathering = replace(diagnosis.gathering, judgement=None)
        diagnosis = replace(diagnosis, noise=noise, start=fit.x, gathering=gathering)
        look = Look(diagnosis, fit)
        diagnosis = look.diagnosis
        found = sorted(look.significant(), key=lambda e: -round(e.support / TIED))
        best = next((e for e in found if _bearable(diagnosis, e)), None)
        if best is not None:
            diagnosis = diagnosis.holding(best, look.rivals(best))
        elif not bent:
            return diagnosis
        elif noise.estimated is None and _as_stated(diagnosis, fit, bent=False):
            return replace(diagnosis, start=diagnosis.fit.x)  # whole squares show the same
        else:
            bent = False


def _bearable(diagnosis: Diagnosis, found: Explanation) -> bool:
    """Whether what is left with an explanation still determines the unknowns, and settles."""
    after = diagnosis.holding(found)
    try:
        after.fitted(diagnosis.noise.factors, diagnosis.start)
    except (DataError, ObservabilityError):
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
        """Yield the best explanation of each kind that is beyond chance."""
        model, limits = self.before.model, self.before.limits
        if self.singles and self._stands_out(self.singles[0]):
            yield self.singles[0]
        for members in self.effects:
            if members[0].probability < limits.of_each_effect(model):
                yield members[0]
        judgement = self.diagnosis.gathering.judgement
        # proof takes the noise for known; of few residuals its chance is drawn
        if (
            judgement is not None
            and judgement.proved(limits.significance)
            and judgement.chance < limits.significance
        ):
            yield from self.groups[:1]

    def rivals(self, best: Explanation) -> list[Explanation]:
        """Return what explains the residuals nearly as well as ``best``, to another result."""
        tried = [*self.singles, *(e for members in self.effects for e in members)]
        if best.blamed is not None:
            tried += self.groups
        near = [
            e
            for e in tried
            if e.what != best.what
            and best.support - e.support < np.log(ALIKE)
            and self.fit.felt(e.change - best.change)
        ]
        return sorted(near, key=lambda e: -e.support)[:MOST_RIVALS]

    @cached_property
    def test_value(self) -> Floats:
        """Test values (n,) of what may go; of estimated noise, over the scatter of the others."""
        fit = self.fit
        test = np.where(fit.used & fit.model.may_go, fit.test_value, 0.0)
        if self.rest is None or fit.dof < 2:
            return test
        others = np.maximum(self.rest[0] - test**2, NOTHING) / (fit.dof - 1)
        return np.asarray(test / np.sqrt(others))

    @property
    def outlier(self) -> float:
        """Limit of a test value; of estimated noise, that of Student's t."""
        model, limits = self.before.model, self.before.limits
        if self.rest is None:
            return limits.outlier(model)
        if self.fit.dof < 3:
            return np.inf  # one more or less, and nothing is left to compare it with
        return t_isf(0.5 * limits.of_each_observation(model), self.fit.dof - 1.0)

    def _stands_out(self, single: Explanation) -> bool:
        return abs(float(self.test_value[single.rows[0]])) > self.outlier

    def _support(self, squares: float, rank: int, alternatives: float) -> tuple[float, float]:
        """Return ln of how probable an explanation is, by BIC, among so many of its kind.

        And its price in BIC. Where the noise was estimated it holds what is explained: then the
        likelihood is that of noise which is not known beforehand.
        """
        count, fall = max(int(self.fit.used.sum()), 2), squares
        if self.rest is not None:
            share = min(squares / max(self.rest[0], NOTHING), ALL_BUT_NOTHING)
            fall = -self.rest[1] * float(np.log1p(-share))
        price = rank * float(np.log(count)) + 2.0 * float(np.log(alternatives))
        return 0.5 * (fall - price), price

    @cached_property
    def singles(self) -> list[Explanation]:
        """That one observation is wrong, those first that stand out most."""
        test = np.abs(self.test_value)
        order = np.argsort(-test, kind="stable")[: MOST_RIVALS + 1]
        return [self._single(row) for row in order.tolist() if test[row] > 0.0]

    def _single(self, row: int) -> Explanation:
        fit, model = self.fit, self.before.model
        size = float(fit.residual[row] / fit.redundancy[row])
        reason = (
            f"its test value {self.test_value[row]:+.1f} is beyond {self.outlier:.2f} (residual "
            f"{model.unit.shown(fit.residual[row])})"
        )
        support, price = self._support(float(fit.test_value[row] ** 2), 1, model.may_go.sum())
        return Explanation(
            f"{model.names[row]} is off by {model.unit.shown(size)}", reason,
            np.eye(len(fit.white), 1, -row), np.array([row]), support, price,
            -fit.response_of(np.array([row]))[:, 0] * size / fit.std[row],
        )  # fmt: skip

    @cached_property
    def groups(self) -> list[Explanation]:
        """That some of a group are off together, for the groups that look most like it."""
        judgement = self.diagnosis.gathering.judgement
        assert judgement is not None
        order = np.argsort(-judgement.by_group, kind="stable")[:SUSPECTS]
        tried = [self._together(judgement.groups[k]) for k in order.tolist()]
        return sorted((e for e in tried if e is not None), key=lambda e: -e.support)

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
        subsets = float(np.exp(min(np.log(listed), any_of_them)))
        groups = len(self.diagnosis.gathering.counts)
        support, price = self._support(test.squares, test.rank, RARER * groups * subsets)
        size = model.unit.shown(float(np.linalg.norm(case.size)))
        return Explanation(
            f"{k} {model.words.elements} of {case.group.name} are off by {size}",
            f"one of {k} of {case.group.name} that are off together by {size}", column, rows,
            support, price + k - 1.0, case.change, blamed=case,
        )  # fmt: skip

    @cached_property
    def effects(self) -> list[list[Explanation]]:
        """That a declared effect is there: each a list, of a family the best members first.

        Of a family another member may be there, too; the one before leaves no residual any more.
        """
        taken = [e.effect for e in self.before.taken]
        asked = (e for e in self.before.model.effects if e.family or e not in taken)
        tried = [self._effect(effect) for effect in asked]
        return [members for members in tried if members]

    def _effect(self, effect: Disturbing) -> list[Explanation]:
        columns = effect.at(self.fit.computed)
        seen = seen_by(self.fit, columns, family=effect.family)
        if not effect.family:
            test = effect_test(seen, self.rest, largest=effect.largest)
            whole = _columns(columns, slice(None))
            return [self._explanation(effect, whole, seen, test)] if test.rank else []
        squares = member_squares(seen)
        if not squares.any():
            return []
        chance, found = family_test(seen, self.rest).probability, []
        for k in np.argsort(-squares, kind="stable")[: MOST_RIVALS + 1].tolist():
            member = slice(k, k + 1)
            test = effect_test(seen.part(member), self.rest)._replace(probability=chance)
            if test.rank:
                found.append(
                    self._explanation(effect, _columns(columns, member), seen.part(member), test)
                )
        return found

    def _explanation(
        self, effect: Disturbing, columns: Floats, seen: Seen, test: EffectTest
    ) -> Explanation:
        """Return what the ``columns`` (n, k) of an effect explain, as far as residuals show."""
        members = effect.at(self.fit.computed).shape[1] if effect.family else 1
        support, price = self._support(test.squares, test.rank, RARER * members)
        where = ""
        if effect.family:
            touched = np.flatnonzero(columns[:, 0])
            if len(np.unique(columns[touched, 0])) == 2 and columns[touched, 0].max() > 0.0:
                touched = np.flatnonzero(columns[:, 0] > 0.0)  # a shift counted from its mean
            first, last = (self.before.model.names[k] for k in touched[[0, -1]].tolist())
            stays = np.ptp(columns[touched, 0]) == 0.0
            where = f" from {first} on" if stays else f" from {first} to {last}"
        return Explanation(
            f"{effect.what}{where}", "", columns @ test.axes, np.zeros(0, dtype=np.int64),
            support, price, -(test.size @ seen.moved[:]), effect, test.axes, test.probability,
        )  # fmt: skip

    def _groups(self) -> list[Group | JudgedWhole | Undivided]:
        """Return the groups of what is used, with which of their members lie together."""
        fit, model, found = self.fit, self.before.model, list[Group | JudgedWhole | Undivided]()
        for grouping in model.groupings:
            for number, members in members_of(grouping, model.may_go).items():
                kept = members[fit.used[members]]
                if not 1 < len(kept) < len(fit.used):
                    continue
                name, lost = f"{grouping.kind} {number}", len(members) - len(kept)
                if len(kept) > LARGEST_GROUP and isinstance(fit.jacobian, Circular):
                    found.append(_as_a_whole(fit, grouping.kind, name, kept, lost))
                    continue
                parts = _parts(grouping, members)
                for k, part in enumerate(parts):
                    here = part[fit.used[part]]
                    if len(here) > 1:
                        of = f"{name}, part {k + 1} of {len(parts)}" if len(parts) > 1 else name
                        found.append(self._group(grouping, of, here, len(part) - len(here)))
        return found

    def _group(self, grouping: Grouping, name: str, rows: Ints, lost: int) -> Group:
        """Return the group of ``rows`` (e,) that are used, of which ``lost`` ones are not."""
        fit, gathered = self.fit, gathered_of(grouping, rows)
        # of others it is not asked what gathers, nor what that would do
        felt = fit.response_of(rows) if len(gathered) else np.zeros((0, len(rows)))
        return Group.of(
            grouping.kind, name, rows, fit.white[rows][:, None], 1.0 / fit.std[rows][:, None],
            fit.cofactors.among(rows), Sensitivity.whole(felt), gathered, lost,
        )  # fmt: skip


def _parts(grouping: Grouping, members: Ints) -> list[Ints]:
    """Return the ``members`` (e,) of a group in parts that are not too large, one after the other.

    What is asked of a group costs the cube of its members; those of a part are neighbours.
    """
    count = -(-len(members) // LARGEST_GROUP)
    if count == 1:
        return [members]
    along = members if grouping.along is None else grouping.along[members]
    ordered = members[np.argsort(along, kind="stable")]
    return [np.sort(part) for part in np.array_split(ordered, count)]


def _as_a_whole(fit: Fit, kind: str, name: str, rows: Ints, lost: int) -> JudgedWhole | Undivided:
    """Return a group of very many ``rows`` (e,), of which ``lost`` ones are left out.

    T is what chi-squared is less by in the solution without them, where that is firm.
    """
    rest = fit.without(rows)
    if rest is None:
        cofactor = LowRank.whole(np.eye(len(rows)) - fit.cofactors.among(rows))
        return Undivided(kind, name, fit.white[rows], cofactor, lost)
    rank = len(rows) - (fit.cofactors.rank - rest[1])
    checked = float(fit.redundancy[rows].sum())
    together, checks = (fit.chi2 - rest[0], rank), (checked, len(rows))
    return JudgedWhole(kind, name, len(rows), together, checks, lost)


def _columns(columns: Floats | Steps, which: slice) -> Floats:
    return columns.whole(which) if isinstance(columns, Steps) else columns[:, which]


def seen_by(fit: Fit, columns: Floats | Steps, *, family: bool = False) -> Seen:
    """Return what a solution makes of ``columns`` (n, k) of errors, of a ``family`` or together.

    Of a family, which may have as many columns as there are observations, neighbours alone.
    """
    if isinstance(columns, Steps):
        if not isinstance(fit.cofactors, Whole):
            return _steps_seen_by(fit, columns)
        white = columns.few()
        white.data /= np.repeat(np.where(fit.used, fit.std, np.inf), np.diff(white.indptr))
        white.eliminate_zeros()
        return _family_seen_by(fit, fit.cofactors, white)
    white = np.where(fit.used[:, None], columns / fit.std[:, None], 0.0)
    if family and isinstance(fit.cofactors, Whole):
        few = np.count_nonzero(white) < FEW * white.size
        return _family_seen_by(fit, fit.cofactors, csr_array(white) if few else white)
    left = fit.left_of(white)
    return Seen(fit.moved(white).T, left.T @ left, left.T @ fit.white, (white**2).sum(axis=0))


def _family_seen_by(fit: Fit, cofactors: Whole, white: Floats | csr_array) -> Seen:
    """Return what a solution makes of whitened columns (n, k), sparse if most of them is zeros."""
    taken = cofactors.along(white).T  # (k, rank): what the unknowns take up of them
    whole = np.asarray((white * white).sum(axis=0))
    beside = np.asarray((white[:, :-1] * white[:, 1:]).sum(axis=0))
    beside = beside - (taken[:-1] * taken[1:]).sum(axis=1)
    own = whole - (taken**2).sum(axis=1)
    weak = np.flatnonzero(own < WEAK * whole)  # a small difference of large numbers
    own[weak] = (fit.left_of(dense(white[:, weak])) ** 2).sum(axis=0)
    information = diags_array([beside, own, beside], offsets=[-1, 0, 1], format="csr")
    moved = taken @ cofactors.felt_by(fit.outputs).T
    return Seen(moved, information, np.asarray(white.T @ fit.white), whole)


def _steps_seen_by(fit: Fit, steps: Steps) -> Seen:
    """Return what a solution order by order makes of steps, by running sums along each run."""
    moves = StepMoves(fit, steps)
    parts = [np.zeros((4, 0)), *(_run_seen_by(fit, moves.root, *run) for run in steps.runs)]
    own, beside, score, whole = np.concatenate(parts, axis=1)
    ends = np.cumsum([len(first) for _, first in steps.runs])[:-1]
    for end in ends[(ends > 0) & (ends < len(own))].tolist():
        left = fit.left_of(moves.white(slice(end - 1, end + 1)))
        beside[end - 1] = left[:, 0] @ left[:, 1]
    for k in np.flatnonzero(own < WEAK * whole).tolist():  # a small difference of large numbers
        own[k] = (fit.left_of(moves.white(slice(k, k + 1))) ** 2).sum()
    between = beside[:-1]
    information = diags_array([between, own, between], offsets=[-1, 0, 1], format="csr")
    return Seen(moves, information, score, whole)


def _run_seen_by(fit: Fit, root: Floats, rows: Ints, first: Ints) -> Floats:
    """Return of the steps of one run: S of each and of it and the next, u, and whole, (4, m)."""
    mine = root[rows]
    taken = _later(_later(mine[:, None] * fit.cofactors.among(rows) * mine).T)
    square = _later(mine**2)[first]
    own = square - taken[first, first]
    beside = np.append(square[1:] - taken[first[:-1], first[1:]], [0.0] * (len(first) > 0))
    return np.stack([own, beside, _later(mine * fit.white[rows])[first], square])


@dataclass(frozen=True, eq=False)
class StepMoves:
    """What ``steps`` do to the outputs: (k, o + a), too many numbers to be kept."""

    fit: Fit
    steps: Steps

    @cached_property
    def root(self) -> Floats:
        """By what an error is whitened (n,)."""
        return np.where(self.fit.used, 1.0 / self.fit.std, 0.0)

    def white(self, which: slice) -> Floats:
        """Return some columns (n, m), whitened."""
        return np.asarray(self.steps.whole(which) * self.root[:, None])

    def __getitem__(self, which: slice) -> Floats:
        """Return what some columns do, (m, o + a)."""
        return np.asarray(self.fit.moved(self.white(which)).T)

    def worst(self, std: Floats) -> Floats:
        """Return the most (k,) that each does to an output, in their ``std`` (o + a,)."""
        counts = np.isfinite(std) & (std > 0.0)
        found = [np.zeros(0)]
        for rows, first in self.steps.runs:
            felt = self.fit.response_of(rows)[counts] * self.root[rows] / std[counts, None]
            found.append(np.abs(_later(felt.T)[first]).max(axis=1, initial=0.0))
        return np.concatenate(found)


def _later(rows: Floats) -> Floats:
    """Return the sums of each of the ``rows`` (e, ...) and all that come later."""
    return np.cumsum(rows[::-1], axis=0)[::-1]


def _robust_start(model: Model, limits: Limits) -> tuple[Floats, Ints]:
    """Return unknowns (p,) that gross errors do not bend, and the observations that are gross.

    From start values that are too poor for that, plain least squares may settle all the same.
    """
    try:
        return _unbent(model, limits)
    except DataError:
        every = np.ones(len(model.observed), dtype=np.bool_)
        return fitted(model, every, model.std, model.first).x, np.zeros(0, dtype=np.int64)


def _unbent(model: Model, limits: Limits) -> tuple[Floats, Ints]:
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

    Least trimmed squares (Rousseeuw and Van Driessen 2006). Where that part determines an output
    not at all, or far worse than the whole, the fit stays as it is.
    """
    used, usual = fit.used, fit
    for _ in range(ROUNDS):
        better = _better(model, fit)
        if (better == used).all():
            break
        try:
            after = fitted(model, better, model.std, fit.x)
            if after.far_worse_than(usual, FAR_WORSE):
                break
        except RotcalError:
            break
        fit, used = after, better
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

    ``bent``: large residuals count no more than some, while outliers are about. A component that
    scatters less than any instrument is exact, made-up data: its statement stays.
    """
    ones = np.ones(len(diagnosis.model.components))
    stated = diagnosis.fitted(ones, diagnosis.start)
    if _as_stated(diagnosis, stated, bent):
        return Noise(ones), stated
    checked = _evidence(stated, bent).redundancy > LEAST_REDUNDANCY
    held = np.zeros(len(ones), dtype=np.bool_)
    while True:
        found, fit = _estimated_noise(diagnosis, stated, bent, held)
        exact = ~held & (found.factors < LEAST_FACTOR * (1.0 + 1e-9))
        if not exact.any():
            return Noise(found.factors, found), fit
        held |= exact
        if held[checked].all():
            return Noise(ones), stated


def _as_stated(diagnosis: Diagnosis, fit: Fit, bent: bool) -> bool:
    """Whether a fit with the noise as stated contradicts no component of it."""
    chance = _evidence(fit, bent).probabilities()
    return bool(chance.min() >= diagnosis.limits.significance / len(chance))


def _estimated_noise(
    diagnosis: Diagnosis, stated: Fit, bent: bool, held: Bools
) -> tuple[EstimatedFactors, Fit]:
    """Return the factors of the components but those that are ``held`` (c,) at one."""

    def at(factors: Floats, before: Fit) -> tuple[NoiseEvidence, Fit]:
        fit = diagnosis.fitted(factors, before.x)
        evidence = _evidence(fit, bent)
        return replace(evidence, present=evidence.present & ~held), fit

    start = np.where(held, 1.0, diagnosis.noise.factors)
    prior = np.eye(len(held)) / PRIOR**2
    return estimate_factors(at, stated, start, prior, NEARLY_SETTLED if bent else SETTLED)


def _evidence(fit: Fit, bent: bool) -> NoiseEvidence:
    """Return what the residuals say of each component of the noise."""
    model, count = fit.model, len(fit.model.components)
    squares, redundancy = fit.white**2, fit.redundancy
    if bent:
        squares = bent_squares(squares, redundancy, CHECKED)
    part = (model.of_component == np.arange(count)[:, None]) & fit.used
    # R is a projection: the squared sums of its blocks follow from those of its complement
    information = fit.cofactors.shared(part) + np.diag(part @ (2.0 * redundancy - 1.0))
    return NoiseEvidence(part.any(axis=1), part @ squares, part @ redundancy, information)
