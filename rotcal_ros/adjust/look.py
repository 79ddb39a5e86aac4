"""One look at a solution: its groups are judged, and explanations of its residuals asked for.

Whether some of a group are off together (:mod:`.judgement`), whether a declared effect is there
(:mod:`.effects`), and whether a single observation stands out (Baarda's test, Sidak's limit for
their number).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import groupby
from typing import Final, NamedTuple

import numpy as np
from scipy.special import gammaln

from rotcal_ros.adjust.diagnosis import Diagnosis, Explanation
from rotcal_ros.adjust.distributions import f_isf
from rotcal_ros.adjust.effects import (
    EffectTest,
    ObservableEffect,
    ObservableFamily,
    chance_beside_scatter,
    chance_in_family,
    effect_test,
    family_test,
    unresolved_sizes,
)
from rotcal_ros.adjust.fit import Fit
from rotcal_ros.adjust.gathering import SUSPECTED, judge_gathering
from rotcal_ros.adjust.groups import CHECKED, Group, JudgedGroup
from rotcal_ros.adjust.judgement import ALIKE, most_probable_subset
from rotcal_ros.adjust.model import Disturbing, Grouping, Steps, gathered_subsets, members_by_group
from rotcal_ros.adjust.observable import dense_columns, observe_columns, observe_effect
from rotcal_ros.adjust.sensitivity import Sensitivity
from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.language import Phrase, join_texts, noted, phrase

IN_A_GROUP: Final = noted("one of {0} of {1} that are off together by {2}")
BEYOND: Final = noted("its test value {0:+.1f} is beyond {1:.2f} (residual {2})")

RARER: Final = 3.0
"""How much rarer an effect or a gathering is held to be than a single wrong observation."""
ALL_BUT_NOTHING: Final = 1.0 - 1e-12
"""Share of chi-squared, at most, that is said to be explained."""
NOTHING: Final = 1e-300
"""Chi-squared of exact observations, by which may be divided."""
EXACT: Final = 1e-6
"""Chi-squared per degree of freedom of made-up observations, whose residuals are rounding."""
MOST_RIVALS: Final = 12
"""Other causes that are compared with the best of a kind."""
LARGEST_GROUP: Final = 720
"""Observations of a group up to which it is asked which of them are off together."""
MANY_ROWS: Final = 100
"""The same from which on it is asked what little they have in common."""
MOST_NUMBERS: Final = 4_000_000
"""Numbers of what rows of groups have in common that are worked out at once (32 MB)."""
SUSPECTS: Final = 4
"""Groups of which it is asked who is to blame, the most probable ones."""


@dataclass(frozen=True, eq=False)
class SolutionView:
    """What a solution says: its groups are judged, and explanations can be asked for."""

    before: Diagnosis
    fit: Fit

    @cached_property
    def diagnosis(self) -> Diagnosis:
        """The diagnosis with what its groups say."""
        gathering = judge_gathering(self.before.gathering, self._groups(), self.rest)
        return replace(self.before, gathering=gathering)

    @cached_property
    def rest(self) -> tuple[float, float] | None:
        """Chi-squared and degrees of freedom where the noise was estimated; None: it is known.

        Of what it was estimated from: components that are exact say nothing of it.
        """
        estimated, fit = self.before.noise.estimated, self.fit
        if estimated is None:
            return None
        mine = np.isfinite(estimated.log_std)[self.before.model.of_component]
        dof = float(fit.redundancy[mine].sum())
        return max(float(fit.white[mine] @ fit.white[mine]), EXACT * dof), dof

    def significant(self) -> Iterator[Explanation]:
        """Yield the best explanation of each kind that is beyond chance."""
        limits = self.before.limits
        if len(self._oddest):
            value, limit = self._test(self._oddest[0])
            if value > limit and not self._with_others:
                yield self.singles[0]
        yield from self.significant_effects()
        judgement = self.diagnosis.gathering.judgement
        # proof takes the noise for known; of few residuals its chance is drawn
        if (
            judgement is not None
            and judgement.proved(limits.significance)
            and judgement.false_alarm_probability < limits.significance
        ):
            yield from self.groups[:1]

    @property
    def _with_others(self) -> bool:
        """Whether several of a group are suspected, rather than its oddest one alone.

        That one may be sound. Where it is not proved which ones are off, all stay in, and the
        covariance holds what they may do.
        """
        if self.diagnosis.gathering.false_alarm_probability >= SUSPECTED:
            return False
        oddest, single = self._oddest[0], self.singles[0]
        return any(
            e.support > single.support
            and e.blamed is not None
            and oddest in e.blamed.group.members
            for e in self.groups
        )

    def significant_effects(self) -> Iterator[Explanation]:
        """Yield the best explanation by each effect that is beyond chance."""
        limit = self.before.limits.of_each_effect(self.before.model)
        if any(test.probability < limit for _, _, test in self._tested):
            yield from (each[0] for each in self.effects if each[0].probability < limit)

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
            and self.fit.influenced(e.change - best.change)
        ]
        return sorted(near, key=lambda e: -e.support)[:MOST_RIVALS]

    def _test(self, element: int) -> tuple[float, float]:
        """Return the root of T of an element, and its limit.

        Of estimated noise T is over the scatter of the others, and the limit that of F.
        """
        model, limits = self.before.model, self.before.limits
        squares, rank = (float(each[element]) for each in self.fit.element_test)
        if self.rest is None:
            return float(np.sqrt(squares)), float(np.sqrt(limits.of_squares(model, rank)))
        left = self.fit.dof - rank
        if left < 2.0:
            return float(np.sqrt(squares)), np.inf  # nothing is left to compare it with
        others = max(self.rest[0] - squares, NOTHING) / left
        limit = rank * float(f_isf(limits.of_each_observation(model), max(rank, 1.0), left))
        return float(np.sqrt(squares / others)), float(np.sqrt(limit))

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
        """That one element is wrong, those first that stand out most."""
        return [self._single(k) for k in self._oddest.tolist()]

    @cached_property
    def _oddest(self) -> Ints:
        """The elements that stand out most, the first ones most."""
        fit, model = self.fit, self.before.model
        first, (squares, rank) = model.elements[:, 0], fit.element_test
        test = np.where((fit.used & model.rejectable)[first], squares, 0.0)
        merit = test - (rank - 1) * np.log(max(int(fit.used.sum()), 2))
        order = np.argsort(-merit, kind="stable")[: MOST_RIVALS + 1]
        return order[test[order] > 0.0]

    def _single(self, element: int) -> Explanation:
        fit, model = self.fit, self.before.model
        rows = model.rows_of(np.array([element]))
        residual, (value, limit) = fit.residual[rows], self._test(element)
        squares, rank = (float(each[element]) for each in fit.element_test)
        cofactor = np.eye(len(rows)) - fit.kernel.hat_block(rows)
        missed = np.linalg.lstsq(cofactor, fit.white[rows], rcond=CHECKED)[0]
        off, left = (float(np.linalg.norm(each)) for each in (missed * fit.std[rows], residual))
        sign = float(np.sign(residual[0])) if len(rows) == 1 else 1.0
        columns = np.zeros((len(fit.white), len(rows)))
        columns[rows, np.arange(len(rows))] = 1.0
        reason = phrase(BEYOND, sign * value, limit, model.unit.shown(sign * left))
        support, price = self._support(squares, int(rank), model.rejectable_elements)
        return Explanation(
            phrase("{0} is off by {1}", model.name_of_row(rows[0]), model.unit.shown(sign * off)),
            reason, columns, rows, support, price, -fit.response_of(rows) @ missed,
        )  # fmt: skip

    @cached_property
    def groups(self) -> list[Explanation]:
        """That some of a group are off together, for the groups that look most like it."""
        judgement = self.diagnosis.gathering.judgement
        assert judgement is not None
        order = np.argsort(-judgement.by_group, kind="stable")[:SUSPECTS]
        tried = [self._together(judgement.groups[k]) for k in order.tolist()]
        return sorted((e for e in tried if e is not None), key=lambda e: -e.support)

    def together(self, name: str) -> Explanation | None:
        """Return that some of the group of this ``name`` are off together; None: not judged."""
        judgement = self.diagnosis.gathering.judgement
        groups = judgement.groups if judgement is not None else ()
        return next((self._together(g) for g in groups if g.name == name), None)

    def _together(self, group: Group) -> Explanation | None:
        """Return that some members of a ``group`` are off together, those which probably are."""
        case, model = most_probable_subset(group), self.before.model
        if case is None:
            return None
        members = case.group.members[case.subset]
        rows, column = model.rows_of(members), np.zeros((*self.fit.white.shape, case.size.size))
        by_axis = model.elements[members, : case.size.size]
        frame = next(g.frame for g in model.groupings if g.kind == case.group.kind)
        if frame is None:
            column[by_axis, np.arange(case.size.size)] = 1.0
        else:
            column[by_axis] = np.swapaxes(frame[by_axis[:, 0]], 1, 2)
        test = effect_test(observe_columns(self.fit, column))
        e, k, listed = case.group.size, len(members), max(len(case.group.gathered), 1)
        any_of_them = gammaln(e + 1) - gammaln(k + 1) - gammaln(e - k + 1) + np.log(e)
        subsets = float(np.exp(min(np.log(listed), any_of_them)))
        groups = len(self.diagnosis.gathering.counts)
        support, price = self._support(test.squares, test.rank, RARER * groups * subsets)
        name, size = case.group.name, model.unit.shown(float(np.linalg.norm(case.size)))
        return Explanation(
            phrase("{0} {1} of {2} are off by {3}", k, phrase(model.words.elements), name, size),
            phrase(IN_A_GROUP, k, name, size), column, rows,
            support, price + len(rows) - test.rank, case.change, blamed=case,
        )  # fmt: skip

    @cached_property
    def effects(self) -> list[list[Explanation]]:
        """That a declared effect is there: each a list, of a family the best members first.

        What moves may do so in one way alone, which costs less.
        """
        tried = [list(self._members(*each)) for each in self._tested]
        return [members for members in tried if members]

    @property
    def squares(self) -> list[float]:
        """What chi-squared falls by for each declared effect alone."""
        return [test.squares for _, _, test in self._tested]

    @cached_property
    def _tested(self) -> list[tuple[Disturbing, ObservableEffect | ObservableFamily, EffectTest]]:
        """The declared effects that residuals can show, with their tests.

        Of a family another member may be there, too; the one before leaves no residual any more.
        """
        taken, found = [e.effect for e in self.before.nuisance], []
        for effect in self.before.model.effects:
            if not effect.family and effect in taken:
                continue
            seen = observe_effect(self.fit, effect)
            if isinstance(seen, ObservableFamily):
                test = family_test(seen, self.rest)
            else:
                test = effect_test(seen, self.rest, largest=effect.largest)
            if test.rank:
                found.append((effect, seen, test))
        return found

    def _members(
        self, effect: Disturbing, seen: ObservableEffect | ObservableFamily, test: EffectTest
    ) -> Iterator[Explanation]:
        """Yield what an effect explains; of a family its best members, the best first."""
        columns, width = effect.at(self.fit.computed), effect.width
        if isinstance(seen, ObservableEffect):
            written = dense_columns(columns, slice(None))
            test = test._replace(probability=self._chance(written, seen, test))
            yield self._explanation(effect, written, seen, test, 1)
            return
        tried = [(seen.member(k), k * width, width) for k in _largest(seen.squares)]
        if width > 1:
            tried += [(seen.column(j), j, 1) for j in _largest(seen.squares_of_one)]
        found = []
        for member, first, count in tried:
            alone = effect_test(member, self.rest, largest=effect.largest)
            if alone.rank:
                written = dense_columns(columns, slice(first, first + count))
                chance = self._chance(written, member, alone)
                if chance > alone.probability:
                    chance = chance_in_family(alone._replace(probability=chance), seen)
                alone = alone._replace(probability=max(chance, test.probability))
                among = effect.stands_for * columns.shape[1] / count
                found.append(self._explanation(effect, written, member, alone, among))
        yield from sorted(found, key=lambda e: -e.support)

    def _chance(self, columns: Floats, seen: ObservableEffect, test: EffectTest) -> float:
        """Return how probable the ``test`` of ``columns`` (n, k) is by what scatters as it does.

        Rows weigh as if each scattered by itself, by a size that is known.
        """
        fit, chance = self.fit, test.probability
        for each in self.before.model.scatterings if test.rank else ():
            white = np.where(fit.used[:, None], columns / fit.std[:, None], 0.0) @ test.axes
            information = test.axes.T @ seen.information @ test.axes
            beside = each.squares_of(fit, white, test.axes.T @ seen.score, information)
            own = chance_beside_scatter(test, *beside, self.rest)
            chance = max(chance, own)
        return chance

    def _explanation(
        self,
        effect: Disturbing,
        columns: Floats,
        seen: ObservableEffect,
        test: EffectTest,
        among: float,
    ) -> Explanation:
        """Return what the ``columns`` (n, k) of an effect explain, as far as residuals show.

        ``among``: how many of their kind there are.
        """
        every = effect.at(self.fit.computed)
        support, price = self._support(test.squares, test.rank, RARER * among)
        what = phrase(effect.what)
        if isinstance(every, Steps):
            touched = np.flatnonzero((columns > 0.0 if every.centred else columns).any(axis=1))
            what = phrase(
                "{0} from {1} on", what,
                self.before.model.name_of_row(touched[every.when[touched].argmin()]),
            )  # fmt: skip
        elif effect.family:
            touched = np.flatnonzero(columns.any(axis=1))
            if len(np.unique(columns[touched, 0])) == 2 and columns[touched, 0].max() > 0.0:
                touched = np.flatnonzero(columns[:, 0] > 0.0)  # a shift counted from its mean
            first, last = (self.before.model.name_of_row(k) for k in touched[[0, -1]].tolist())
            stays = effect.stays or np.ptp(columns[touched, 0]) == 0.0
            begins = phrase("{0} from {1} on", what, first)
            what = begins if stays else phrase("{0} from {1} to {2}", what, first, last)
        return Explanation(
            what, join_texts(()), columns @ test.axes, np.zeros(0, dtype=np.int64),
            support, price, -(test.size @ seen.moved), effect, test.axes, test.probability,
            hidden=unresolved_sizes(test, seen),
        )  # fmt: skip

    def _groups(self) -> list[Group | JudgedGroup]:
        """Return the groups of what is used, with which of their members lie together."""
        fit, model = self.fit, self.before.model
        found = list[Group | JudgedGroup | _Members]()
        first, each = model.elements[:, 0], model.elements.shape[1]
        used, rejectable = fit.used[first], model.rejectable[first]
        for grouping in (g.at(first) for g in model.groupings):
            if not grouping.gathers:
                found.extend(self._together_each(grouping))
                continue
            for number, members in members_by_group(grouping, rejectable).items():
                kept = members[used[members]]
                if not 1 < len(kept) < len(used):
                    continue
                name, lost = grouping.name_of(number), len(members) - len(kept)
                if len(kept) * each > LARGEST_GROUP and not fit.jacobian.divided:
                    rows = model.rows_of(kept)
                    found.append(_as_a_whole(fit, grouping.kind, name, rows, lost))
                    continue
                parts = split_group(grouping, members, each)
                for k, part in enumerate(parts):
                    here = part[used[part]]
                    if len(here) > 1:
                        of = (
                            phrase("{0}, part {1} of {2}", name, k + 1, len(parts))
                            if parts[1:]
                            else name
                        )
                        found.append(_Members(grouping, of, here, len(part) - len(here)))
        groups = self._of_one_size([each for each in found if isinstance(each, _Members)])
        return [next(groups) if isinstance(each, _Members) else each for each in found]

    def _of_one_size(self, asked: Sequence[_Members]) -> Iterator[Group]:
        """Return the groups that are asked for, those of as many rows at once."""
        found, alike = dict[int, Group](), dict[int, list[int]]()
        table = self.fit.model.elements
        for k, each in enumerate(asked):
            alike.setdefault(
                len(each.members) * int((table[each.members[0]] >= 0).sum()), []
            ).append(k)
        for size, every in alike.items():
            for some in np.array_split(every, -(-len(every) * size**2 // MOST_NUMBERS)):
                members = [asked[k].members for k in some]
                rows = [table[m, : size // len(m)].ravel() for m in members]
                among, kind = self.fit.kernel.hat_blocks(np.stack(rows))
                gathered = _gathered_of([asked[k] for k in some])
                groups = [
                    self._group(asked[k], *of)
                    for k, *of in zip(some, among[kind], gathered, strict=True)
                ]
                cofactors = [group.cofactor.reshape(size, size) for group in groups]
                values, vectors = np.linalg.eigh(np.stack(cofactors))
                white = np.stack([group.residual.ravel() for group in groups])
                along = (white[:, None] @ vectors)[:, 0]
                spectra = zip(np.clip(values, 0.0, 1.0), along, strict=True)
                for k, group, own in zip(some.tolist(), groups, spectra, strict=True):
                    found[k] = replace(group, spectrum=own)
        return iter([found[k] for k in range(len(asked))])

    def _together_each(self, grouping: Grouping) -> Iterator[JudgedGroup]:
        """Yield groups of which it is not asked what gathers; those of one size at once."""
        fit, model = self.fit, self.before.model
        first = model.elements[:, 0]
        members = np.flatnonzero(model.rejectable[first] & (grouping.number >= 0))
        members = members[np.argsort(grouping.number[members], kind="stable")]
        number, of, whole = np.unique(
            grouping.number[members], return_inverse=True, return_counts=True
        )
        used = fit.used[first]
        kept = np.bincount(of, used[members]).astype(np.int64)
        members, of = members[used[members]], of[used[members]]
        real = model.elements[members] >= 0
        rows, of_row = model.elements[members][real], np.repeat(of, real.sum(axis=1))
        sizes = np.bincount(of_row, minlength=len(number))
        sizes[(kept < 2) | (kept == len(used))] = 0
        few = (sizes > 0) & (sizes <= MANY_ROWS)
        judged = np.zeros((3, len(number)))
        for size in np.unique(sizes[few]).tolist():
            alike = sizes == size
            judged[:, alike] = self._judged(rows[alike[of_row]].reshape(-1, size))
        names = grouping.names_of(number.tolist())
        columns = (each.tolist() for each in (sizes, whole - kept, kept, few, judged.T))
        for k, (name, size, lost, left, asked, found) in enumerate(
            zip(names, *columns, strict=True)
        ):
            if asked:
                squares, rank, share = found
                checks = share, size
                yield JudgedGroup(grouping.kind, name, left, (squares, int(rank)), checks, lost)
            elif size:
                yield _as_a_whole(fit, grouping.kind, name, rows[of_row == k], lost)

    def _judged(self, rows: Ints) -> Floats:
        """Return T, its degrees of freedom and the share that others check of groups (g, e)."""
        among, kind = self.fit.kernel.hat_blocks(rows)
        values, vectors = np.linalg.eigh(np.eye(rows.shape[1]) - among)
        values, seen = values[kind], values[kind] > CHECKED
        turn = vectors[kind] if len(vectors) > 1 else vectors  # as of a circle
        along = (self.fit.white[rows][:, None] @ turn)[:, 0]
        squares = np.where(seen, along**2 / np.where(seen, values, 1.0), 0.0).sum(axis=1)
        return np.stack([squares, seen.sum(axis=1), np.clip(values, 0.0, 1.0).sum(axis=1)])

    def _group(self, asked: _Members, leverage: Floats, gathered: Bools) -> Group:
        """Return a group whose rows have this ``leverage`` (e c, e c).

        ``gathered`` (q, e): which of its members lie together.
        """
        grouping, name, members, lost = asked
        fit, table = self.fit, self.fit.model.elements
        rows = table[members][:, : len(leverage) // len(members)]
        white = fit.white[rows]
        frame = None if grouping.frame is None else grouping.frame[members]

        def turned(values: Floats) -> Floats:
            if frame is None:
                return values
            return np.asarray((frame @ values.reshape(*rows.shape, -1)).reshape(rows.size, -1))

        def influence() -> Sensitivity:
            found = fit.sensitivity(rows.ravel())
            if frame is None:
                return found
            return replace(found, along=turned(found.along.T).T, own=turned(found.own.T).T)

        return Group.of(
            grouping.kind, name, members, turned(white).reshape(rows.shape), 1.0 / fit.std[rows],
            turned(turned(leverage).T), influence, gathered, lost,
        )  # fmt: skip


class _Members(NamedTuple):
    """A group of elements ``members`` (e,) that are used, of which ``lost`` ones are not."""

    grouping: Grouping
    name: Phrase
    members: Ints
    lost: int


def _gathered_of(asked: Sequence[_Members]) -> Iterator[Bools]:
    """Yield which members of each group lie together, of neighbours in one grouping at once."""
    for _, some in groupby(asked, key=lambda each: (id(each.grouping), len(each.members))):
        alike = list(some)
        yield from gathered_subsets(alike[0].grouping, np.stack([each.members for each in alike]))


def _largest(squares: Floats) -> list[int]:
    """Return the best of a kind and its rivals, the largest first."""
    order: list[int] = np.argsort(-squares, kind="stable")[: MOST_RIVALS + 1].tolist()
    return order


def split_group(grouping: Grouping, members: Ints, each: int = 1) -> list[Ints]:
    """Return the ``members`` (e,) of a group in parts that are not too large, one after the other.

    What is asked of a group costs the cube of its members, of ``each`` so many rows; those of a
    part are neighbours.
    """
    count = -(-len(members) * each // LARGEST_GROUP)
    if count == 1:
        return [members]
    along = members if grouping.along is None else grouping.along[members]
    ordered = members[np.argsort(along, kind="stable")]
    return [np.sort(part) for part in np.array_split(ordered, count)]


def _as_a_whole(fit: Fit, kind: str, name: Phrase, rows: Ints, lost: int) -> JudgedGroup:
    """Return a group of very many ``rows`` (e,), of which ``lost`` ones are left out.

    Of circles T is what chi-squared is less by in the solution without them, where that is firm.
    """
    rest = None if fit.jacobian.divided else fit.without(rows)
    if rest is None:
        together = fit.kernel.together(rows, fit.white[rows])
    else:
        together = fit.chi2 - rest[0], len(rows) - (fit.kernel.rank - rest[1])
    elements = len(np.unique(fit.model.of_element[rows]))
    checks = float(fit.redundancy[rows].sum()), len(rows)
    return JudgedGroup(kind, name, elements, together, checks, lost)
