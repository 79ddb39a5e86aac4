"""Which disturbance is probable, what it may have done to the outputs, and what to leave out.

Every group of a kind is held to be disturbed with a small probability stated beforehand
(:class:`PriorBelief`); every explanation of :mod:`.explanations` then has a posterior probability
p.

* The Bayes factor of all of them together against nothing is the test of largest power on average
  over what was believed beforehand. On sound data it exceeds 1/x with a probability below x
  (Markov's inequality), which *proves* a disturbance; how probably it is exceeded exactly
  (:meth:`Judgement.false_alarm_probability`), which makes one *suspected*, is drawn where that is
  in doubt.
* A probable but unproved effect adds its expected square: the sum of p (d d' + D), d what an
  explanation does to the outputs and D its covariance. Methods add it where something is
  :attr:`Judgement.possible`; sound data keep their covariance to the last bit.
* Where a subset is blamed, rivals that explain the residuals nearly as well stay in the
  covariance by the difference that it makes which of them is left out.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np

from rotcal_ros.adjust.distributions import chi2_sf
from rotcal_ros.adjust.explanations import (
    SIZES,
    FreeExchange,
    Hypotheses,
    free_errors,
    log_bayes,
    log_bayes_of_flips,
    log_bayes_of_groups,
    log_prior_of_subset,
    log_sum,
    output_change_without,
    rescale_to_variance,
    scatter_hypothesis,
    search_subsets,
    shift_hypotheses,
    shift_hypotheses_of_groups,
)
from rotcal_ros.adjust.groups import Group
from rotcal_ros.adjust.sensitivity import sum_moments
from rotcal_ros.adjust.subsets import LEAST, distinct_subsets, largest_wrong_count
from rotcal_ros.foundation.arrays import Bools, Floats
from rotcal_ros.foundation.compact import Spread

ALIKE: Final = 20.0
"""Likelihood ratio below which two explanations are called nearly as good."""
CANDIDATES: Final = 12
"""Best shifts of either kind that are tried as what to leave out."""
DRAWS: Final = (100, 400)
"""Sets of sound residuals that show how probable a Bayes factor is on sound data, in turn."""
OFTEN: Final = 10
"""Draws that exceed a Bayes factor, with which its probability is known well enough."""
POSSIBLE: Final = 0.9
"""Bayes factor below which nothing is suspected."""
LARGEST_LOG: Final = 690.0
"""Of a Bayes factor; exp of it, a million times over, is still a number."""
SEARCHED: Final = 0.01
"""Probability of a group below which any subset of it is searched for."""
AT_ONCE: Final = 512
"""Groups that are judged at once."""
POLISHED: Final = 20
"""Exchanges of single elements after which a blamed subset stays as it is."""


@dataclass(frozen=True, slots=True)
class PriorBelief:
    """What is held to be probable before the residuals are seen.

    ``disturbed``: that something gathers in one of the groups; ``outlier``: that one element is
    wrong, which is left to screening but competes. Of what gathers, the shares ``gathered`` (a
    shift of elements that lie together), ``scattered`` (a shift of any subset), and the rest: the
    group is noisier.
    """

    disturbed: float = 0.5
    outlier: float = 0.2
    gathered: float = 0.6
    scattered: float = 0.2


BELIEF: Final = PriorBelief()


class WeighedHypotheses(NamedTuple):
    """Hypotheses of one ``group``, with ln of the prior (q,) of each and one of its sizes.

    ``single`` (q,): which are single outliers, and nothing that gathers.
    """

    group: int
    found: Hypotheses
    log_prior: Floats
    single: Bools


@dataclass(frozen=True, eq=False)
class Judgement:
    """What is believed after the residuals were seen.

    ``freedom``: degrees of freedom from which each group's noise was estimated; inf: it is known.
    ``log_bayes``: ln of the Bayes factor of a disturbance that gathers against none (which may
    hold single outliers); -inf without groups. ``weighed``: what it is made of, ``log_weight``: ln
    of the sum of prior times Bayes factor of all that gathers.
    """

    groups: tuple[Group, ...]
    freedom: tuple[float, ...]
    log_bayes: float
    weighed: tuple[WeighedHypotheses, ...]
    log_weight: float = 0.0

    @cached_property
    def by_group(self) -> Floats:
        """Posterior probability (G,) that it is in each group."""
        found = np.zeros(len(self.groups))
        for hypotheses, weights in self._weights():
            found[hypotheses.group] += weights.sum()
        return found

    @cached_property
    def moments(self) -> tuple[Floats, Spread]:
        """Expected error (o,) of the outputs, and its square (o, o)."""
        outputs = self.groups[0].sensitivity.outputs if self.groups else 0
        return sum_moments(
            (each.found.moment(weights) for each, weights in self._weights()), outputs
        )

    def _weights(self) -> Iterator[tuple[WeighedHypotheses, Floats]]:
        """Yield what gathers with its posterior probabilities (q, t)."""
        odds = np.log(BELIEF.disturbed) + self.log_bayes
        evidence = np.logaddexp(np.log(1.0 - BELIEF.disturbed), odds)
        shift = odds - evidence - self.log_weight
        for hypotheses in self.weighed:
            logs = hypotheses.found.log_bayes() + hypotheses.log_prior[:, None]
            yield hypotheses, np.exp(logs + shift) * ~hypotheses.single[:, None]

    @property
    def gathered(self) -> tuple[Hypotheses, ...]:
        """What the gathered subsets of each group would do, in their order."""
        forms = [hypotheses.found for hypotheses in self.weighed if len(hypotheses.single) > 1]
        ends = [(group.size, group.size + len(group.gathered)) for group in self.groups]
        return tuple(found.take(slice(a, b)) for found, (a, b) in zip(forms, ends, strict=True))

    @property
    def worst(self) -> int:
        """The group that is most probably disturbed."""
        return int(np.argmax(self.by_group))

    def proved(self, significance: float) -> bool:
        """Whether a disturbance is proved; on sound data with less than this probability."""
        return self.log_bayes > -float(np.log(significance))

    @property
    def possible(self) -> bool:
        """Whether the residuals speak for a disturbance rather than against one."""
        return self.log_bayes > float(np.log(POSSIBLE))

    @cached_property
    def false_alarm_probability(self) -> float:
        """How probably sound data have a Bayes factor as large as this one.

        By DRAWS sets of residuals with the cofactor of each group, from a fixed seed, each over
        noise that is estimated as that of the data was; subsets that were searched for are not
        searched for again. One where nothing is possible.
        """
        if not self.possible:
            return 1.0
        rng, exceeded, drawn = np.random.default_rng(0), 0, 0
        for count in DRAWS:
            total: list[Floats] = []
            single = [np.full(count, np.log(1.0 - BELIEF.outlier))]
            for group, freedom in zip(self.groups, self.freedom, strict=True):
                for part, prior, counts in _drawn(group, freedom, rng, count):
                    (total if counts else single).append(part + prior - np.log(len(self.groups)))
            logs = log_sum(np.array(total).T) - log_sum(np.array(single).T)
            exceeded, drawn = exceeded + int((logs >= self.log_bayes).sum()), drawn + count
            if exceeded >= OFTEN:
                break
        return (1 + exceeded) / (1 + drawn)

    def covariance(self) -> Spread:
        """Return what the probable errors add to the covariance (o, o) of the outputs."""
        return self.moments[1]


def judge(groups: Sequence[Group], rest: tuple[float, float] | None = None) -> Judgement:
    """Return what the residuals of ``groups`` say of disturbances that gather in one of them.

    ``rest``: chi-squared and degrees of freedom of the adjustment where the noise was estimated,
    see :func:`~.groups.group_tests`. Any subset is searched for in groups whose own test has a
    probability below SEARCHED.
    """
    if not groups:
        return Judgement((), (), -np.inf, ())
    groups, freedom, chance = zip(*(_seen(group, rest) for group in groups), strict=True)
    weighed, alone, gathers = list[WeighedHypotheses](), list[float](), list[float]()
    for begin in range(0, len(groups), AT_ONCE):
        some = slice(begin, begin + AT_ONCE)
        found = list(_weighed(groups[some], chance[some], begin))
        each = log_bayes_of_groups([w.found for w in found])
        logs = np.concatenate(
            [(b + w.log_prior[:, None]).ravel() for b, w in zip(each, found, strict=True)]
        )
        single = np.concatenate([np.repeat(w.single, len(SIZES)) for w in found])
        alone.append(float(log_sum(logs[single])))
        gathers.append(float(log_sum(logs[~single])))
        weighed += found
    many, whole = float(np.log(len(groups))), float(log_sum(np.array(gathers)))
    calm = float(log_sum(np.append(np.array(alone) - many, np.log(1.0 - BELIEF.outlier))))
    return Judgement(groups, freedom, whole - many - calm, tuple(weighed), whole)


def _seen(group: Group, rest: tuple[float, float] | None) -> tuple[Group, float, float]:
    """Return ``group`` with the noise that the others show, where it was estimated.

    And from how many degrees of freedom that is, and how probably chance scatters more.
    """
    squares, rank = group.together
    left = np.inf if rest is None else rest[1] - rank
    if rest is None or left < 1.0:
        return group, np.inf, chi2_sf(squares, rank)
    variance = max((rest[0] - squares) / left, 1e-9)
    return rescale_to_variance(group, variance), left, chi2_sf(squares / variance, rank)


def _families(group: Group) -> tuple[list[tuple[Bools, Floats]], float]:
    """Return subsets (q, e) of each family of shifts with their priors (q,), singles first.

    And the prior of a group that is noisier.
    """
    e, many = group.size, len(group.gathered)
    single = (np.eye(e, dtype=np.bool_), np.full(e, BELIEF.outlier / e))
    noisier = 1.0 - BELIEF.gathered - BELIEF.scattered
    if not many:
        return [single], noisier + BELIEF.gathered
    return [single, (group.gathered, np.full(many, BELIEF.gathered / many))], noisier


def _weighed(
    groups: Sequence[Group], chance: Sequence[float], begin: int
) -> Iterator[WeighedHypotheses]:
    """Yield the families of each group, each with priors that add up to its share of belief.

    ``chance``: how probably a group scatters more. ``begin``: the number of the first.
    """
    parts, priors, noisier = list[Bools](), list[Floats](), list[float]()
    for group, rare in zip(groups, chance, strict=True):
        families, noisy = _families(group)
        if rare < SEARCHED and len(other := search_subsets(group)):
            count = other.sum(axis=1).astype(np.float64)
            families.append(
                (other, BELIEF.scattered * np.exp(log_prior_of_subset(group.size, count)))
            )
        parts.append(np.concatenate([subsets for subsets, _ in families]))
        priors.append(np.concatenate([prior for _, prior in families]))
        noisier.append(noisy)
    alike, nothing = float(np.log(len(SIZES))), np.zeros(1, dtype=np.bool_)
    every = zip(groups, shift_hypotheses_of_groups(groups, parts), priors, noisier, strict=True)
    for g, (group, shift, prior, noisy) in enumerate(every, begin):
        single = np.arange(len(prior)) < group.size
        yield WeighedHypotheses(g, shift, np.log(prior) - alike, single)
        yield WeighedHypotheses(g, scatter_hypothesis(group), np.log([noisy]) - alike, nothing)


def _drawn(
    group: Group, freedom: float, rng: np.random.Generator, count: int
) -> list[tuple[Floats, float, bool]]:
    """Return ln of the mean Bayes factor (count,) of each family on sound residuals.

    With ln of its prior, and whether it gathers.
    """
    values, vectors = group.axes
    normal = rng.standard_normal((len(values), count))
    # by the symmetric root: vectors of equal values may turn with the rounding
    drawn = vectors @ (np.sqrt(values)[:, None] * (vectors.T @ normal))
    if np.isfinite(freedom):
        drawn /= np.sqrt(rng.chisquare(freedom, count) / freedom)
    whole = log_bayes(np.tile(values, (count, 1)), (vectors.T @ drawn).T)
    families, noisier = _families(group)
    alike = np.log(len(SIZES))
    found = [(log_sum(whole) - alike, float(np.log(noisier)), True)]
    for k, (subsets, prior) in enumerate(families):
        form = shift_hypotheses(group, subsets)
        score = drawn.reshape(*group.residual.shape, count) * group.relative[:, :, None]
        along = subsets.astype(np.float64) @ np.moveaxis(score, 0, 1)  # (c, q, r)
        along = np.moveaxis(along, 2, 0).swapaxes(1, 2)
        if form.axes is not None:
            along = (along[:, :, None] @ form.axes)[:, :, 0]
        along *= form.values > 0.0  # no residual shows the others, see UNSEEN
        mean = _mean_bayes(form.values, along)
        found.append((mean, float(np.log(prior.sum())), k > 0))
    return found


def _mean_bayes(values: Floats, along: Floats) -> Floats:
    """Return ln of the mean over subsets and sizes of the Bayes factor, ``along`` (r, q, c)."""
    total = np.zeros(len(along))
    for size in SIZES:
        grown = 1.0 + size**2 * values
        gain = along**2 / (grown / size**2)
        # noise from few degrees of freedom is drawn next to none at times: never beyond a float
        each = np.minimum(0.5 * (gain - np.log(grown)).sum(axis=2), LARGEST_LOG)
        total += np.exp(each).sum(axis=1)
    return np.asarray(np.log(total / (len(SIZES) * along.shape[1])))


@dataclass(frozen=True, eq=False)
class BlamedSubset:
    """Which elements of a group to leave out, and what else explains the residuals as well.

    ``subset`` (e,), its ``size`` (c,): by how much its elements are off together, in the unit of
    a shift. ``change`` (o,): what leaving it out does to the outputs. ``rivals`` (q, e), best
    first, with their ``ratios`` (q,) of likelihood, best to rival; ``root`` (o, s): of the
    covariance that the choice among all of them adds.
    """

    group: Group
    subset: Bools
    size: Floats
    change: Floats
    rivals: Bools
    ratios: Floats
    root: Floats

    @property
    def ambiguous(self) -> bool:
        """Whether another explanation is nearly as good and changes who is to blame."""
        return bool((self.ratios < ALIKE).any())


def most_probable_subset(group: Group) -> BlamedSubset | None:
    """Return the subset of ``group`` that most probably is wrong; None where none can be.

    Candidates: shifts of gathered and of any subsets, their complements, and what a forward
    search by free errors finds; the best is polished by exchange of single elements. Compared is
    that they are off by the same or, alike probable, each a little otherwise
    (:func:`~.explanations.free_errors`): what noise lends to errors of their own does not show a
    shift of one half from that of the other. ``group``: as in a :class:`Judgement`.
    """
    if largest_wrong_count(group.size) < LEAST:
        return None
    tried = _Tried(group)
    part = _candidates(group, tried)
    merit = np.array([tried.merit(subset) for subset in part])
    best = tried.polished(part[int(np.argmax(merit))])
    part = distinct_subsets(best[None], part)
    merit = np.array([tried.merit(subset) for subset in part])
    rank = np.argsort(-merit, kind="stable")
    part, merit = part[rank], merit[rank]
    probability = np.exp(merit - log_sum(merit))
    change = output_change_without(group, part[0])
    likely = probability > 1e-4
    apart = np.array([output_change_without(group, subset) - change for subset in part[likely]])
    rivals = [k for k in range(1, len(part)) if _different(part[0], part[k])]
    return BlamedSubset(
        group=group,
        subset=part[0],
        size=_common(group, part[0]),
        change=change,
        rivals=part[rivals],
        ratios=np.exp(np.minimum(merit[0] - merit[rivals], 700.0)),
        root=apart.T * np.sqrt(probability[likely]),
    )


def _different(subset: Bools, other: Bools) -> bool:
    """Whether two subsets blame others, rather than the same and some more or less."""
    return int((subset & other).sum()) <= 0.5 * min(int(subset.sum()), int(other.sum()))


def _common(group: Group, subset: Bools) -> Floats:
    """Return by how much a ``subset`` (e,) is off together, (c,), by least squares."""
    part = subset.astype(np.float64)
    square = np.einsum("e,eafb,f->ab", part, group.weight, part)
    size = np.linalg.lstsq(square, part @ group.score, rcond=1e-9)[0]
    return np.asarray(size * group.usual_std)


class _Tried:
    """Merits of subsets that are off together, each worked out once: ``known`` by its bytes."""

    def __init__(self, group: Group) -> None:
        self.group = group
        self.known: dict[bytes, float] = {}
        self._gathered = {subset.tobytes() for subset in group.gathered}

    def merit(self, subset: Bools) -> float:
        """Return ln of prior times Bayes factor."""
        key = subset.tobytes()
        if key not in self.known:
            alike, apart = (
                shift_hypotheses(self.group, subset[None]),
                free_errors(self.group, subset),
            )
            bayes = np.concatenate([alike.log_bayes()[0], apart.log_bayes()[0]])
            self.known[key] = float(self._weighed(bayes[None], subset[None])[0])
        return self.known[key]

    def flipped(self, here: FreeExchange) -> Floats:
        """Return the merits (e,) of the subset of ``here`` with one element in or out.

        -inf where too few or too many are left.
        """
        alike = log_bayes_of_flips(self.group, here.subset[None])[0]
        other = here.subset ^ np.eye(len(here.subset), dtype=np.bool_)
        merit = self._weighed(np.concatenate([alike, here.flipped()], axis=1), other)
        count = other.sum(axis=1)
        return np.where((count >= 1) & (count <= largest_wrong_count(len(count))), merit, -np.inf)

    def _weighed(self, bayes: Floats, subsets: Bools) -> Floats:
        """Return ln of the mean of Bayes factors (q, t) times the prior of ``subsets`` (q, e)."""
        count, size = subsets.sum(axis=1).astype(np.float64), subsets.shape[1]
        any_ = np.where(
            count > 1.0, log_prior_of_subset(size, np.maximum(count, 1.0)), -np.log(size)
        )
        prior = np.log(BELIEF.scattered) + any_
        if self._gathered:
            listed = np.array([subset.tobytes() in self._gathered for subset in subsets])
            share = np.log(BELIEF.gathered / len(self._gathered))
            prior = np.where(listed, np.logaddexp(prior, share), prior)
        return np.asarray(prior + log_sum(bayes) - np.log(bayes.shape[1]))

    def polished(self, subset: Bools) -> Bools:
        """Return ``subset`` with elements taken in and put back while that gains."""
        here = FreeExchange(self.group, subset)
        value = self.merit(subset)
        for _ in range(POLISHED):
            merit = self.flipped(here)
            best = int(np.argmax(merit))
            if merit[best] <= value + 1e-9:
                break
            here.flip(best)
            value = float(merit[best])
        return here.subset


def _candidates(group: Group, tried: _Tried) -> Bools:
    """Return subsets (q, e) that may be to blame, each once."""
    found = [search_subsets(group, CANDIDATES), _forward(group, tried)]
    if len(group.gathered):
        merit = log_sum(shift_hypotheses(group, group.gathered).log_bayes())
        found.append(group.gathered[np.argsort(-merit, kind="stable")[:CANDIDATES]])
    part = distinct_subsets(*found)
    part = distinct_subsets(part, ~part)
    count = part.sum(axis=1)
    return np.asarray(part[(count >= 1) & (count <= largest_wrong_count(group.size))])


def _forward(group: Group, tried: _Tried) -> Bools:
    """Return the subsets that a forward search by free errors passes through."""
    here = FreeExchange(group, np.zeros(group.size, dtype=np.bool_))
    path = []
    for _ in range(largest_wrong_count(group.size)):
        merit = np.where(here.subset, -np.inf, tried.flipped(here))
        best = int(np.argmax(merit))
        here.flip(best)
        path.append(here.subset.copy())
        tried.known[path[-1].tobytes()] = float(merit[best])
    return np.array(path)
