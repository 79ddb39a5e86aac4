"""Which order a plan is measured in: the quickest whose drifts and knocks would be seen.

The quickest order of all turns the table once round. A drift then follows the angle, and a knock
shows at one end only. So orders of several sweeps compete with it, there and back, each with its
share of the lengths of every position: what drifts is then at each position at early and late
times alike. A *closed* single sweep keeps half of the first position for its end. The quickest of
those that are protected is taken.

Protected is what the solver's own statement says at the nominal geometry: a plan is predicted
once, and judged for as many orders as wanted.

An order is an open travelling-salesman path over the pairs (table position, target). The times are
not symmetric, because a table that comes from above passes its angle and returns. A path is
improved by reversing a stretch (2-opt, Croes 1958) and by moving up to three lengths elsewhere (Or
1976), the best move of all at a time; then kicked by double bridges (Martin, Otto and Felten 1991)
and improved again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from math import inf, isfinite
from typing import Final

import numpy as np
from scipy.sparse.csgraph import minimum_spanning_tree

from rotcal_ros.adjust.effects import LargestUndetected
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.errors import PlanError
from rotcal_ros.foundation.protection import TOLERABLE
from rotcal_ros.methods.tracer.solver.prediction import Prediction, predicted
from rotcal_ros.methods.tracer.solver.problem import TracerProblem
from rotcal_ros.planning.sequence_time import sequence_duration

Blocks = Callable[[Ints], Ints]
CLOSED: Final = "closed"
MOST_SWEEPS: Final = 4
"""Each further sweep costs the table its way once more."""
SPARSE: Final = (2, 3)
"""A last sweep visits one of every so many positions once more, which saves turns."""
DRAWS: Final = 8
"""Ways of sharing the lengths among the sweeps of which the best protected one is kept."""
KICKS: Final = 20
"""Kicks for the quickest order; sweeps leave the heuristic little to choose."""
AGAIN: Final = 1e4
"""Time (s), longer than any way, of measuring a pair again without having left it."""
MOST_KICKED: Final = 200
"""Lengths beyond which the quickest order is improved once only, and shares are left as drawn."""
TRADES: Final = 150
"""Times that two lengths of a position trade sweeps, to show more of a drift or knock."""
HOPELESS: Final = 2.5
"""Times the limit from which trading would be in vain."""
SAFE: Final = 0.95
"""Share of the limit at which trading ends: the ways within a sweep are shortened afterwards."""
LONGEST_MOVED: Final = 3
"""Lengths in a row that are moved elsewhere at once."""
LEAST_GAIN: Final = 1e-5
"""Gain (s) that is none: below it is the rounding of sums with FORBIDDEN."""
FORBIDDEN: Final = 1e5
"""Time (s) of a step that leaves its sweep too early."""


@dataclass(frozen=True, slots=True)
class Forecast:
    """The largest errors that may stay unseen, in standard uncertainties; infinite: any."""

    drift: float
    knock: float

    @property
    def worst(self) -> float:
        """The larger one of the two."""
        return max(self.drift, self.knock)

    @property
    def protected(self) -> bool:
        """Whether both are small enough not to be named in a verdict."""
        return self.worst <= TOLERABLE

    def to_dict(self) -> dict[str, float | None]:
        """Return the forecast as plain data, None where nothing bounds an error."""
        return {
            name: value if isfinite(value) else None
            for name, value in (("drift", self.drift), ("knock", self.knock))
        }


class SequenceForecast:
    """Judges orders of the lengths of one plan; ``problem`` has the stations to start from.

    Raises ObservabilityError when the plan cannot determine the angle at all.
    """

    def __init__(self, problem: TracerProblem) -> None:
        self._known: Prediction = predicted(problem, problem.start_stations)

    def __call__(self, order: Ints) -> Forecast:
        """Return the forecast for ``order`` (k,): rows of the problem as they are measured."""
        hides = self._known.undetected_by_order(ranks(order))
        drift, knock = (_unseen(hides[effect]) for effect in ("drift", "knock"))
        return Forecast(drift=drift, knock=knock)


def ranks(order: Ints) -> Ints:
    """Return when each row (k,) is measured in an ``order`` (k,) of rows."""
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order))
    return rank


def _unseen(worst: LargestUndetected) -> float:
    """Return the error of a statement: none where it is harmless, any where it cannot be seen."""
    return {"harmless": 0.0, "not protected": inf, "tested": worst.error}.get(worst.treatment, inf)


@dataclass(frozen=True, eq=False)
class MeasuringOrder:
    """One order of k lengths: ``order`` (k,) are their rows as they are measured.

    ``seconds`` from the end of the first length to that of the last, which no order can do in less
    than ``bound``. ``name`` is quickest, closed, or the number of sweeps and of which positions.
    """

    name: str
    order: Ints
    seconds: float
    bound: float
    forecast: Forecast | None

    @property
    def worst(self) -> float:
        """The largest error (std) that may stay unseen; 0 where nothing is said of it."""
        return 0.0 if self.forecast is None else self.forecast.worst


def measuring_orders(
    position: Ints,
    target: Ints,
    costs: Floats,
    forecast: Callable[[Ints], Forecast] | None = None,
    *,
    limit: float = TOLERABLE,
    seed: int = 0,
    sparse: tuple[int, ...] = SPARSE,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[MeasuringOrder, ...]:
    """Return the orders that compete, the quickest first.

    ``position`` (k,), ``target`` (k,): what each length measures; ``costs`` (k, k) see
    :meth:`~.sequence_time.TimeModel.costs`. Without ``forecast`` nothing is said of drift; with it
    sweeps share the lengths so that neither drift nor knock exceeds ``limit`` (std). A pair that
    is measured several times is left and approached anew each time. ``sparse``: of every so many
    positions one is visited by a last sweep. ``progress(done, total)`` is called after each.

    Raises PlanError when nothing else could be measured between.
    """
    same = (position == position[:, None]) & (target == target[:, None])
    np.fill_diagonal(same, val=False)
    costs = costs + AGAIN * same
    rng, bound = np.random.default_rng(seed), shortest_possible(costs)
    kinds = [*_kinds(position, sparse)]
    kicks = KICKS if len(position) <= MOST_KICKED else 0
    quickest = improved(costs, nearest_next(costs), kicks, seed)
    found = [_judged("quickest", quickest, costs, bound, forecast)]
    for name, sweeps, blocks in kinds:
        if progress is not None:
            progress(len(found), 1 + len(kinds))
        draws = [blocks(share) for share in _drawn(position, sweeps, rng)]
        judged = [_judged(name, _listed(block), costs, bound, forecast) for block in draws]
        block = draws[min(range(DRAWS), key=lambda n: (judged[n].worst, judged[n].seconds))]
        trade = None if name == CLOSED or len(position) > MOST_KICKED else forecast
        sweeps_at = np.sort(block)
        block[_traded(_listed(block), position, sweeps_at, trade, SAFE * limit, rng)] = sweeps_at
        swept = _in_sweeps(costs, block)
        order = improved(swept, _start(swept, block))
        order = _traded(order, position, sweeps_at, trade, limit, rng)
        found.append(_judged(name, order, costs, bound, forecast))
    if progress is not None:
        progress(1 + len(kinds), 1 + len(kinds))
    found = [way for way in found if not same[way.order[:-1], way.order[1:]].any()]
    if not found:
        raise PlanError(
            "a pair is measured again with no other length to come between: nothing would "
            "approach it anew; list further pairs"
        )
    return tuple(sorted(found, key=lambda way: way.seconds))


def least_hidden(ways: tuple[MeasuringOrder, ...], limit: float = TOLERABLE) -> MeasuringOrder:
    """Return the quickest order that stays within ``limit``, else the one that hides least."""
    return min(ways, key=lambda way: (max(way.worst, limit), way.seconds))


def _kinds(position: Ints, sparse: tuple[int, ...]) -> Iterator[tuple[str, int, Blocks]]:
    """Yield name, number of shares, and how the shares (k,) become blocks (k,) in their order."""
    m = int(position.max()) + 1
    first = np.where(position == position.min(), 0, position)

    def closed(share: Ints) -> Ints:
        return np.where((share == 1) & (first == 0), m, first)

    def swept(share: Ints) -> Ints:
        back = share % 2 == 1
        return _dense(share * m + np.where(back, m - 1 - position, position))

    def in_part(share: Ints, sweeps: int, every: int) -> Ints:
        """Return blocks whose last sweep passes most positions by; others take their lengths."""
        passed = (share == sweeps - 1) & (position % every != 0)
        return swept(np.where(passed, position % (sweeps - 1), share))

    yield CLOSED, 2, closed
    for sweeps in range(2, MOST_SWEEPS + 1):
        yield f"{sweeps} sweeps", sweeps, swept
    for whole in range(2, MOST_SWEEPS):
        for every in sparse:
            name = f"{whole} sweeps and one of every {every} positions"
            yield name, whole + 1, partial(in_part, sweeps=whole + 1, every=every)


def _traded(
    order: Ints,
    position: Ints,
    block: Ints,
    forecast: Callable[[Ints], Forecast] | None,
    limit: float,
    rng: np.random.Generator,
) -> Ints:
    """Return a better ``order`` (k,): lengths of one position trade places while that helps.

    ``block`` (k,) of each place in the order: only places in different ones are traded.
    """
    if forecast is None:
        return order
    least = forecast(order).worst
    for _ in range(TRADES):
        if not limit < least < HOPELESS * limit:
            break
        place, at = int(rng.integers(len(order))), position[order]
        others = np.flatnonzero((at == at[place]) & (block != block[place]))
        if not len(others):
            continue
        other = int(rng.choice(others))
        changed = order.copy()
        changed[[place, other]] = order[[other, place]]
        if (found := forecast(changed).worst) < least:
            order, least = changed, found
    return order


def _drawn(position: Ints, shares: int, rng: np.random.Generator) -> Iterator[Ints]:
    """Yield the share (k,) of each length: those of a position are dealt out evenly."""
    for _ in range(DRAWS):
        share = np.empty(len(position), dtype=np.int64)
        for at in np.unique(position):
            rows = rng.permutation(np.flatnonzero(position == at))
            share[rows] = (np.arange(len(rows)) + rng.integers(shares)) % shares
        yield share


def _dense(block: Ints) -> Ints:
    return np.asarray(np.unique(block, return_inverse=True)[1], dtype=np.int64)


def _listed(block: Ints) -> Ints:
    return np.argsort(block, kind="stable")


def _start(costs: Floats, block: Ints) -> Ints:
    """Return a path that takes block after block, within each the nearest next."""
    parts: list[Ints] = []
    for number in range(int(block.max()) + 1):
        rows = np.flatnonzero(block == number)
        first = int(np.argmin(costs[parts[-1][-1], rows])) if parts else 0
        parts.append(rows[nearest_next(costs[np.ix_(rows, rows)], first)])
    return np.concatenate(parts)


def _judged(
    name: str,
    order: Ints,
    costs: Floats,
    bound: float,
    forecast: Callable[[Ints], Forecast] | None,
) -> MeasuringOrder:
    judged = None if forecast is None else forecast(order)
    return MeasuringOrder(name, order, sequence_duration(costs, order), bound, judged)


def nearest_next(costs: Floats, first: int = 0) -> Ints:
    """Return the path (k,) that always goes to the nearest length left; ``costs`` (k, k)."""
    left = np.ones(len(costs), dtype=np.bool_)
    order = np.empty(len(costs), dtype=np.int64)
    order[0] = first
    for number in range(1, len(costs)):
        left[order[number - 1]] = False
        order[number] = np.argmin(np.where(left, costs[order[number - 1]], np.inf))
    return order


def improved(costs: Floats, order: Ints, kicks: int = 0, seed: int = 0) -> Ints:
    """Return a shorter path than ``order`` (k,), or itself; ``kicks`` say how long to try."""
    best = _settled(costs, np.array(order))
    shortest, rng = sequence_duration(costs, best), np.random.default_rng(seed)
    if len(order) < 8:
        return best
    for _ in range(kicks):
        a, b, c = np.sort(rng.choice(np.arange(1, len(best)), 3, replace=False))
        kicked = np.concatenate([best[:a], best[b:c], best[a:b], best[c:]])
        kicked = _settled(costs, kicked)
        if (time := sequence_duration(costs, kicked)) < shortest - LEAST_GAIN:
            best, shortest = kicked, time
    return best


def shortest_possible(costs: Floats) -> float:
    """Return what no path through all lengths can beat, s: the lightest spanning tree.

    Of the smaller of the two directions; each path is a spanning tree.
    """
    both = np.minimum(costs, costs.T)
    least = both.min()
    # a weight of zero would be no edge
    tree = minimum_spanning_tree(both - least + 1.0)
    return float(tree.sum() + (least - 1.0) * (len(costs) - 1))


def _in_sweeps(costs: Floats, sweep: Ints) -> Floats:
    """Return ``costs`` (k, k) for paths that take the blocks ``sweep`` (k,) in their order."""
    step = sweep - sweep[:, None]
    return np.asarray(costs + FORBIDDEN * ((step < 0) | (step > 1)), dtype=np.float64)


def _settled(costs: Floats, order: Ints) -> Ints:
    """Return the path after the best moves, until none gains."""
    while True:
        gain, changed = _best_reversal(costs, order)
        for count in range(1, LONGEST_MOVED + 1):
            other, moved = _best_shift(costs, order, count)
            if other > gain:
                gain, changed = other, moved
        if gain <= LEAST_GAIN:
            return order
        order = changed


def _best_reversal(costs: Floats, order: Ints) -> tuple[float, Ints]:
    """Return the gain (s) and the path with the best stretch reversed."""
    k = len(order)
    c = costs[order[:, None], order]
    forth = np.append(0.0, np.cumsum(np.diagonal(c, 1)))
    back = np.append(0.0, np.cumsum(np.diagonal(c, -1)))
    padded = np.zeros((k + 2, k + 2))  # to leave and to come costs nothing at the ends
    padded[1:-1, 1:-1] = c
    i, j = np.triu_indices(k, 1)
    before = padded[i, i + 1] + forth[j] - forth[i] + padded[j + 1, j + 2]
    after = padded[i, j + 1] + back[j] - back[i] + padded[i + 1, j + 2]
    best = int(np.argmax(before - after))
    a, b = int(i[best]), int(j[best])
    changed = np.concatenate([order[:a], order[a : b + 1][::-1], order[b + 1 :]])
    return float(before[best] - after[best]), changed


def _best_shift(costs: Floats, order: Ints, count: int) -> tuple[float, Ints]:
    """Return the gain (s) and the path with the best ``count`` lengths moved elsewhere."""
    k = len(order)
    if k <= count + 1:
        return 0.0, order
    padded = np.zeros((k + 2, k + 2))
    padded[1:-1, 1:-1] = costs[order[:, None], order]
    start = np.arange(1, k - count + 2)[:, None]  # of the row, in padded indices
    end = start + count - 1
    gap = np.arange(k + 1)[None]  # between gap and gap + 1
    taken = padded[start - 1, start] + padded[end, end + 1] - padded[start - 1, end + 1]
    put = padded[gap, start] + padded[end, gap + 1] - padded[gap, gap + 1]
    gain = np.where((gap >= start - 1) & (gap <= end), -np.inf, taken - put)
    row, place = np.unravel_index(int(np.argmax(gain)), gain.shape)
    moved = order[row : row + count]
    rest = np.concatenate([order[:row], order[row + count :]])
    at = int(place) if place <= row else int(place) - count
    changed = np.concatenate([rest[:at], moved, rest[at:]])
    return float(gain[row, place]), changed
