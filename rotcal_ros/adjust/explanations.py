"""What could explain the residuals of a group, and how much they speak for it.

An explanation is a number of columns A of errors with sizes a ~ N(0, t^2 I) beside the noise:

shift
    a subset of the elements is off by the same, one size per axis (all too long by so much);
free
    a subset is off by something in common and each element by something of its own;
scatter
    all elements of the group are noisier.

Against nothing its Bayes factor is, with S = A'RA = V diag(s) V', u = V'A'r,

    ln B = 1/2 sum (u^2 t^2 / (1 + t^2 s) - ln(1 + t^2 s)),

its sizes are N(t^2 u / (1 + t^2 s), t^2 / (1 + t^2 s)) along V, and the outputs are off by B A a
(normal linear model with conjugate prior; Koch, Introduction to Bayesian Statistics, 2007, section
4.2). What the residuals cannot show (s = 0) keeps its prior. Sizes are those of a list, alike
probable: so a disturbance of any size from half a standard deviation up is met.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final

import numpy as np
from scipy.special import gammaln

from rotcal_ros.adjust.groups import Group
from rotcal_ros.adjust.sensitivity import ErrorMoments
from rotcal_ros.adjust.subsets import LEAST, distinct_subsets, largest_wrong_count, run_bounds
from rotcal_ros.foundation.arrays import Bools, Floats, Ints

SIZES: Final[Floats] = np.array([0.5, 2.0, 8.0, 32.0, 128.0])
"""Standard deviations t of a disturbance, in usual standard deviations of the noise."""
UNSEEN: Final = -1e-6
"""Square of a shift, less than rounding makes of zero: adjusted and stated noise differ a little.

No residual shows such a shift, so what seems to is nothing."""
OWN: Final = 0.3
"""Of a free subset: what each is off by itself, as a share of what all have in common."""
LARGE: Final = 200
"""Elements of a group from which on runs are leading sums: products cost their square."""
MOST_NUMBERS: Final = 250_000
"""Numbers of subsets of groups, or of what they do, that are worked out at once."""
MOST_STEPS: Final = 60
"""Exchanges after which a search ends anyway."""


@dataclass(frozen=True, eq=False)
class Hypotheses:
    """q explanations of the same form, each with d sizes along its own axes.

    ``values`` (q, d): s, ``along`` (q, d): u. ``mixing``: what a unit of each is on the n rows of
    its ``group``, (n, q, d), worked out when it is asked for.
    ``axes`` (q, d, d): V, where d sizes are not their own axes already.
    ``times``: a matrix (r, n) times the mixing, (r, q, d), where that is quicker without it.
    """

    values: Floats
    along: Floats
    mixing: Callable[[], Floats]
    group: Group
    axes: Floats | None = None
    times: Callable[[Floats], Floats] | None = None

    def reach(self, std: Floats) -> Floats:
        """Return by how much a unit of each (q, d) moves any output at most.

        In the standard uncertainties ``std`` (o,); zero or infinite: one that does not count.
        """
        counts = (std > 0.0) & np.isfinite(std)
        most = np.zeros(self.values.shape)
        for influence in self.of_many(self.group.sensitivity.dense()[counts] / std[counts, None]):
            np.maximum(most, np.abs(influence, out=influence).max(axis=0, initial=0.0), out=most)
        return most

    def of_many(self, matrix: Floats) -> Iterator[Floats]:
        """Yield :meth:`of_rows` of some rows of a ``matrix`` (r, n) after the other."""
        parts = matrix.shape[0] * self.values.size // MOST_NUMBERS + 1
        for some in np.array_split(matrix, parts) if parts > 1 else (matrix,):
            yield self.of_rows(some)

    def of_rows(self, matrix: Floats) -> Floats:
        """Return a ``matrix`` (r, n) of the rows times the mixing, (r, q, d)."""
        if self.times is not None:
            return self.times(matrix)
        mix = self.mixing()
        return (matrix @ mix.reshape(len(mix), -1)).reshape(len(matrix), *mix.shape[1:])

    def take(self, which: slice) -> Hypotheses:
        """Return some of them."""
        axes, times = (None if self.axes is None else self.axes[which]), self.times
        return Hypotheses(
            self.values[which],
            self.along[which],
            lambda: self.mixing()[:, which],
            self.group,
            axes,
            None if times is None else lambda matrix: times(matrix)[:, which],
        )

    def log_bayes(self) -> Floats:
        """Return ln B (q, t) for the prior standard deviations SIZES (t,)."""
        return log_bayes(self.values, self.along)

    def moment(self, weights: Floats) -> ErrorMoments:
        """Return what the rows are off by, and its square, in sums over all of them.

        ``weights`` (q, t): posterior probabilities.
        """
        variance = SIZES**2
        left = variance / (1.0 + variance * self.values[:, :, None])
        at = left * self.along[:, :, None]  # (q, d, t)
        first = (at @ weights[:, :, None])[:, :, 0]
        second = (at * weights[:, None]) @ at.swapaxes(1, 2)
        each = np.arange(self.values.shape[1])
        second[:, each, each] += (left @ weights[:, :, None])[:, :, 0]
        mix = self.mixing()
        flat = mix.reshape(len(mix), -1)
        spread = (mix.swapaxes(0, 1) @ second).swapaxes(0, 1).reshape(flat.shape)
        return ErrorMoments(self.group.sensitivity, flat @ first.ravel(), spread @ flat.T)


def log_bayes_of_groups(found: Sequence[Hypotheses]) -> list[Floats]:
    """Return ln B (q, t) of each, those with as many sizes at once."""
    logs, alike = dict[int, Floats](), dict[int, list[int]]()
    for k, each in enumerate(found):
        alike.setdefault(each.values.shape[1], []).append(k)
    for every in alike.values():
        whole = log_bayes(*(np.concatenate([getattr(found[k], name) for k in every])
                            for name in ("values", "along")))  # fmt: skip
        ends = np.cumsum([len(found[k].values) for k in every])
        logs |= zip(every, np.split(whole, ends[:-1]), strict=True)
    return [logs[k] for k in range(len(found))]


def log_bayes(values: Floats, along: Floats) -> Floats:
    """Return ln B (q, t) of ``values`` and ``along`` (q, d), for the prior deviations SIZES."""
    variance = SIZES**2
    grown = 1.0 + variance * values[:, :, None]
    gain = variance * along[:, :, None] ** 2 / grown
    return np.asarray(0.5 * (gain - np.log(grown)).sum(axis=1))


def shift_hypotheses(group: Group, subsets: Bools) -> Hypotheses:
    """Return that each of the ``subsets`` (q, e) is off by the same along each axis."""
    large = group.residual.shape[1] == 1 and group.size >= LARGE
    square, score = (_of_runs if large else _of_any)(group, subsets)
    found = _along_axes(group, subsets, *_own_axes(square, score))
    if not large:
        return found
    where = run_bounds(subsets)
    return replace(found, times=lambda matrix: _times_runs(group, subsets, where, matrix))


def shift_hypotheses_of_groups(
    groups: Sequence[Group], subsets: Sequence[Bools]
) -> list[Hypotheses]:
    """Return :func:`shift_hypotheses` of each group, those of one size with one axis at once."""
    found, alike = dict[int, Hypotheses](), dict[int, list[int]]()
    for k, group in enumerate(groups):
        if group.residual.shape[1] > 1 or group.size >= LARGE:
            found[k] = shift_hypotheses(group, subsets[k])
        else:
            alike.setdefault(group.size, []).append(k)
    for size, every in alike.items():
        many = max(len(subsets[k]) for k in every)
        parts = min(-(-len(every) * many * size // MOST_NUMBERS), len(every))
        for some in np.array_split(every, parts):
            part = np.zeros((len(some), many, size))
            for at, k in enumerate(some.tolist()):
                part[at, : len(subsets[k])] = subsets[k]
            relative = np.stack([groups[k].relative[:, 0] for k in some])
            cofactor = np.stack([groups[k].cofactor[:, 0, :, 0] for k in some])
            score = np.stack([groups[k].score for k in some])
            mine = part * relative[:, None]
            square = ((mine @ cofactor) * mine).sum(axis=2)
            own = _own_axes(square[:, :, None, None], part @ score)
            for at, k in enumerate(some.tolist()):
                mine = (each[at, : len(subsets[k])] for each in own)
                found[k] = _along_axes(groups[k], subsets[k], *mine)
    return [found[k] for k in range(len(groups))]


def _along_axes(
    group: Group, subsets: Bools, values: Floats, along: Floats, vectors: Floats
) -> Hypotheses:
    def on_rows() -> Floats:
        part = subsets.astype(np.float64)
        mix = np.einsum("qe,ea,qab->eaqb", part, group.relative, vectors)
        return np.asarray(mix.reshape(group.residual.size, *along.shape))

    return Hypotheses(values, along, on_rows, group, vectors)


def _of_any(group: Group, subsets: Bools) -> tuple[Floats, Floats]:
    """Return S (q, c, c) and A'r (q, c) of shifts A of each of the ``subsets`` (q, e)."""
    part = subsets.astype(np.float64)
    return _squares(group, part)[1], part @ group.score


def _of_runs(group: Group, subsets: Bools) -> tuple[Floats, Floats]:
    """Return the same of elements with one axis, of runs by differences of leading sums."""
    (first, end, run), sums = run_bounds(subsets), group.leading
    square = sums[end, end] - 2.0 * sums[first, end] + sums[first, first]
    scores = np.append(0.0, group.score.cumsum())
    square, score = square[:, None, None], (scores[end] - scores[first])[:, None]
    square[~run], score[~run] = _of_any(group, subsets[~run])
    return square, score


def _times_runs(
    group: Group, subsets: Bools, where: tuple[Ints, Ints, Bools], matrix: Floats
) -> Floats:
    """Return a ``matrix`` (r, e) times unit shifts of elements with one axis, (r, q, 1).

    ``where``: the :func:`~.subsets.run_bounds` of the subsets.
    """
    first, end, run = where
    unit = matrix * group.relative[:, 0]
    leading = np.pad(unit.cumsum(axis=1), ((0, 0), (1, 0)))
    found = leading[:, end] - leading[:, first]
    found[:, ~run] = unit @ subsets[~run].T
    return np.asarray(found[:, :, None])


def _squares(group: Group, part: Floats) -> tuple[Floats, Floats]:
    """Return what shifts of subsets ``part`` (q, e) share with each element, and S of each.

    (q, e, c, c) and (q, c, c): scalar products of what is left of them in the residuals.
    """
    e, c = group.residual.shape
    shared = (part @ group.weight.reshape(e, -1)).reshape(-1, c, e, c)
    if c == 1:
        square = (shared[:, 0, :, 0] * part).sum(axis=1)[:, None, None]
    else:
        square = (shared.swapaxes(2, 3) @ part[:, None, :, None])[..., 0]
    return shared.swapaxes(1, 2), square


def _own_axes(square: Floats, score: Floats) -> tuple[Floats, Floats, Floats]:
    """Return s and u (..., c) of S ``square`` (..., c, c) and V'u = ``score`` (..., c), and V."""
    if square.shape[-1] == 1:
        values, vectors, along = square[..., 0], np.broadcast_to(1.0, square.shape), score
    else:
        values, vectors = np.linalg.eigh(square)
        along = (score[..., None, :] @ vectors)[..., 0, :]
    along = np.where(values < UNSEEN, 0.0, along)
    return np.maximum(values, 0.0), along, vectors


def scatter_hypothesis(group: Group) -> Hypotheses:
    """Return that all rows of the ``group`` are noisier, each by itself."""
    values, along = group.along_axes
    return Hypotheses(values[None], along[None], lambda: group.axes[1][:, None], group)


def free_errors(group: Group, subset: Bools) -> Hypotheses:
    """Return that the elements of one ``subset`` (e,) are off together, and each by itself."""
    c = group.residual.shape[1]
    k = int(subset.sum())
    weight = group.weight[subset][:, :, subset].reshape(k * c, k * c)
    mixing = _free_mixing(k, c)
    values, vectors = np.linalg.eigh(mixing.T @ weight @ mixing)
    axes = mixing @ vectors
    along = group.score[subset].ravel() @ axes

    def on_rows() -> Floats:
        mix = np.zeros((*group.residual.shape, k * c))
        mix[subset] = group.relative[subset][:, :, None] * axes.reshape(k, c, -1)
        return mix.reshape(-1, 1, k * c)

    return Hypotheses(np.maximum(values, 0.0)[None], along[None], on_rows, group)


@lru_cache(maxsize=256)
def _free_mixing(k: int, c: int) -> Floats:
    """Return what k elements with c axes are off by, (k c, k c), per independent size."""
    together = np.linalg.cholesky(np.ones((k, k)) + OWN**2 * np.eye(k))
    mixing = np.kron(together, np.eye(c))
    mixing.setflags(write=False)
    return mixing


def output_change_without(group: Group, subset: Bools) -> Floats:
    """Return what the outputs (o,) change by when a ``subset`` (e,) is left out."""
    rows = np.broadcast_to(subset[:, None], group.residual.shape).ravel()
    n = group.residual.size
    part = group.cofactor.reshape(n, n)[np.ix_(rows, rows)]
    errors = np.linalg.lstsq(part, group.residual.ravel()[rows], rcond=1e-9)[0]
    spoiled = np.zeros((n, 1))
    spoiled[rows, 0] = errors
    return -group.sensitivity.of(spoiled)[:, 0]


def log_sum(logs: Floats) -> Floats:
    """Return ln of the sum of exp(``logs``) along the last axis."""
    largest = logs.max(axis=-1)
    return np.asarray(largest + np.log(np.exp(logs - largest[..., None]).sum(axis=-1)))


def log_prior_of_subset(size: int, count: Floats) -> Floats:
    """Return ln of the prior of one subset with ``count`` of ``size`` elements, any as probable.

    First the count is drawn from LEAST to half of them, then which they are.
    """
    chosen = gammaln(size + 1.0) - gammaln(count + 1.0) - gammaln(size - count + 1.0)
    return np.asarray(-chosen - np.log(max(largest_wrong_count(size) - LEAST + 1, 1)))


def search_subsets(group: Group, most: int = 12) -> Bools:
    """Return the subsets (q, e) whose shift explains the residuals best, the best first.

    Forward search with exchange: from the best gathered subset, the largest elements of either
    sign, and halves ordered by residual, elements are taken in and put back, each time the one
    that gains most, as long as the Bayes factor times the prior of :func:`log_prior_of_subset`
    grows.
    """
    part = _starts(group)
    if not len(part):
        return part
    each = np.arange(len(part))
    for _ in range(MOST_STEPS):
        value = _merit(shift_hypotheses(group, part), part)
        flipped = _flipped(group, part)
        best = np.argmax(flipped, axis=1)
        better = flipped[each, best] > value + 1e-9
        if not better.any():
            break
        part[each[better], best[better]] ^= True
    part = distinct_subsets(part)
    rank = np.argsort(-_merit(shift_hypotheses(group, part), part), kind="stable")
    return np.asarray(part[rank[:most]])


def _merit(found: Hypotheses, part: Bools) -> Floats:
    count = part.sum(axis=1).astype(np.float64)
    return np.asarray(log_sum(found.log_bayes()) + log_prior_of_subset(part.shape[1], count))


def _flipped(group: Group, subsets: Bools) -> Floats:
    """Return the merit (q, e) of every subset with one element taken in or put back."""
    e = subsets.shape[1]
    count = subsets.sum(axis=1)[:, None] + np.where(subsets, -1, 1)
    value = log_sum(log_bayes_of_flips(group, subsets)) + log_prior_of_subset(
        e, count.astype(np.float64)
    )
    return np.where((count >= LEAST) & (count <= largest_wrong_count(e)), value, -np.inf)


def log_bayes_of_flips(group: Group, subsets: Bools) -> Floats:
    """Return ln B (q, e, t) of shifts of each of the ``subsets`` (q, e) but for one element.

    Which is taken in, or put back.
    """
    part = subsets.astype(np.float64)
    each, change = np.arange(part.shape[1]), np.where(subsets, -1, 1)
    shared, square = _squares(group, part)
    both = shared + shared.swapaxes(2, 3)
    square = square[:, None] + change[..., None, None] * both + group.weight[each, :, each]
    score = (part @ group.score)[:, None] + change[..., None] * group.score
    values, along, _ = _own_axes(square, score)
    c = square.shape[-1]
    bayes = log_bayes(values.reshape(-1, c), along.reshape(-1, c))
    return bayes.reshape(*change.shape, len(SIZES))


class FreeExchange:
    """The Bayes factors of free subsets that differ from one in a single element, all at once.

    As of :func:`free_errors`, where each costs the cube of the elements; here all cost the square.
    Of a subset T of k elements with own errors of variance v = (OWN t)^2, M = W + I / v and
    P = (M_TT)^-1, the common shift keeps the information G = k I / v - 1'P1 / v^2 and the score
    h = 1'Ps / v:

        ln B = 1/2 (s'Ps - ln det(v M_TT) + h'(I / t^2 + G)^-1 h - ln det(I + t^2 G)).

    Sweeps of [M, B; B', 0], B = (1, s), take an element in or put it back (Goodnight, The American
    Statistician 33, 149, 1979), and say beforehand what of -B'PB comes of each.
    """

    def __init__(self, group: Group, subset: Bools) -> None:
        e, c = group.residual.shape
        own = (OWN * SIZES) ** 2
        self.subset = np.zeros(e, dtype=np.bool_)
        self._places, self._sides = np.arange(e * c).reshape(e, c), e * c + np.arange(c + 1)
        self._swept = np.zeros((len(SIZES), e * c + c + 1, e * c + c + 1))
        self._swept[:, : e * c, : e * c] = group.weight.reshape(e * c, e * c)
        self._swept[:, self._places.ravel(), self._places.ravel()] += 1.0 / own[:, None]
        sides = np.column_stack([np.tile(np.eye(c), (e, 1)), group.score.ravel()])
        self._swept[:, : e * c, e * c :], self._swept[:, e * c :, : e * c] = sides, sides.T
        self._log = np.zeros(len(SIZES))
        for k in np.flatnonzero(subset).tolist():
            self.flip(k)

    def flip(self, k: int) -> None:
        """Take the element ``k`` in, or put it back."""
        at = self._places[k]
        pivot, column = self._swept[:, at[:, None], at], self._swept[:, :, at]
        toward = column @ np.linalg.inv(pivot)
        self._swept -= toward @ column.swapaxes(1, 2)
        signed = -toward if self.subset[k] else toward
        self._swept[:, :, at], self._swept[:, at] = signed, signed.swapaxes(1, 2)
        self._swept[:, at[:, None], at] = -np.linalg.inv(pivot)
        self._log += np.linalg.slogdet(pivot)[1]
        self.subset[k] ^= True

    def flipped(self) -> Floats:
        """Return ln B (e, t) of the subset with each element taken in, or put back."""
        c, variance = self._places.shape[1], SIZES[:, None, None, None] ** 2
        own = OWN**2 * variance
        pivot = self._swept[:, self._places[:, :, None], self._places[:, None]]  # (t, e, c, c)
        sides = self._swept[:, self._places][..., self._sides]  # (t, e, c, c + 1)
        whole = self._swept[:, self._sides][:, :, self._sides]
        products = sides.swapaxes(2, 3) @ np.linalg.solve(pivot, sides) - whole[:, None]
        count = self.subset.sum() + np.where(self.subset, -1.0, 1.0)[:, None, None]
        common = count * np.eye(c) / own - products[..., :c, :c] / own**2
        score = products[..., :c, c:] / own
        gain = products[..., c, c] + _squared(score, np.eye(c) / variance + common)
        volume = self._log[:, None] + np.linalg.slogdet(pivot)[1]
        volume += count[:, 0, 0] * c * np.log(own[:, :, 0, 0])
        volume += np.linalg.slogdet(np.eye(c) + variance * common)[1]
        return np.asarray(0.5 * (gain - volume).T)


def _squared(score: Floats, information: Floats) -> Floats:
    """Return h'N^-1 h (...,) of a ``score`` h (..., c, 1) and an ``information`` N (..., c, c)."""
    return np.asarray((score * np.linalg.solve(information, score)).sum(axis=(-2, -1)))


def _starts(group: Group) -> Bools:
    """Return subsets (q, e) to search from."""
    e, most = group.size, largest_wrong_count(group.size)
    if most < LEAST:
        return np.zeros((0, e), dtype=np.bool_)
    found = []
    if len(group.gathered):
        merit = log_sum(shift_hypotheses(group, group.gathered).log_bayes())
        found.append(group.gathered[np.argsort(-merit, kind="stable")[:3]])
    counts = {LEAST, max(most // 2, LEAST), most}
    for axis in group.score.T:
        order = np.argsort(axis, kind="stable")
        for count in sorted(counts):
            found += [_members(order[:count], e), _members(order[-count:], e)]
    return distinct_subsets(*found)


def _members(which: Ints, size: int) -> Bools:
    part = np.zeros((1, size), dtype=np.bool_)
    part[0, which] = True
    return part


def rescale_to_variance(group: Group, variance: float) -> Group:
    """Return ``group`` as seen with noise of ``variance`` per whitened unit."""
    root, (values, along) = float(np.sqrt(variance)), group.along_axes
    return replace(
        group,
        residual=group.residual / root,
        spectrum=(values, along / root),
        influence=lambda: group.influence().weighted(root),
        unit=group.unit / root,
    )
