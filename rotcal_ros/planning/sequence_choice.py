"""Which order a plan is measured in: the quickest whose drifts and knocks would be seen.

The quickest order of all turns the table once round. A drift then follows the angle, and a knock
shows at one end only. So orders of several sweeps compete with it, there and back, each with its
share of the lengths of every position: what drifts is then at each position at early and late
times alike. A *closed* single sweep keeps half of the first position for its end. The solver's own
forecast says which of them is protected; the quickest of those is taken.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from rotcal_ros.arrays import Floats, Ints
from rotcal_ros.errors import PlanError
from rotcal_ros.planning.sequence import improved, in_sweeps, nearest_next, shortest_possible
from rotcal_ros.planning.sequence_forecast import Forecast
from rotcal_ros.planning.sequence_time import duration
from rotcal_ros.protection import TOLERABLE

MOST_SWEEPS: Final = 4
DRAWS: Final = 8
"""Ways of sharing the lengths among the sweeps of which the best protected one is kept."""
KICKS: Final = 20
"""Of the quickest order; sweeps leave the heuristic little to choose."""
MOST_KICKED: Final = 200
"""Lengths beyond which the quickest order is improved once only."""


@dataclass(frozen=True, eq=False)
class MeasuringOrder:
    """One order of k lengths: ``order`` (k,) are their rows as they are measured.

    ``seconds`` from the end of the first length to that of the last, which no order can do in less
    than ``bound``. ``name`` is quickest, closed, or the number of sweeps.
    """

    name: str
    order: Ints
    seconds: float
    bound: float
    forecast: Forecast | None


def measuring_orders(
    position: Ints,
    target: Ints,
    costs: Floats,
    forecast: Callable[[Ints], Forecast] | None = None,
    *,
    seed: int = 0,
    most_sweeps: int = MOST_SWEEPS,
) -> tuple[MeasuringOrder, ...]:
    """Return the orders that compete, the quickest first.

    ``position`` (k,), ``target`` (k,): what each length measures; ``costs`` (k, k) see
    :meth:`~.sequence_time.TimeModel.costs`. Without ``forecast`` nothing is said of drift.
    """
    if len({*zip(position.tolist(), target.tolist(), strict=True)}) < len(position):
        raise PlanError("a pair of table position and target is listed twice")
    rng, bound = np.random.default_rng(seed), shortest_possible(costs)
    kicks = KICKS if len(position) <= MOST_KICKED else 0
    quickest = improved(costs, nearest_next(costs), kicks, seed)
    found = [_judged("quickest", quickest, costs, bound, forecast)]
    for name, draws in _shares(position, most_sweeps, rng):
        drawn = [_judged(name, _listed(block), costs, bound, forecast) for block in draws]
        best = min(range(len(drawn)), key=lambda number: _badness(drawn[number]))
        bound_costs = in_sweeps(costs, draws[best])
        order = improved(bound_costs, _start(bound_costs, draws[best]))
        found.append(_judged(name, order, costs, bound, forecast))
    return tuple(sorted(found, key=lambda way: way.seconds))


def best_order(ways: tuple[MeasuringOrder, ...], limit: float = TOLERABLE) -> MeasuringOrder:
    """Return the quickest order whose unseen drift and knock stay within ``limit`` (std).

    Raises PlanError, with the best that there is, when none does.
    """
    for way in sorted(ways, key=lambda way: way.seconds):
        if _worst(way) <= limit:
            return way
    best = min(ways, key=_worst)
    raise PlanError(
        f"no order of these lengths shows every drift and knock before it causes {limit:g} "
        f"standard uncertainties; the best ({best.name}) leaves {_worst(best):.2g}: measure more "
        "lengths, or allow it"
    )


def _shares(
    position: Ints, most_sweeps: int, rng: np.random.Generator
) -> Iterator[tuple[str, list[Ints]]]:
    """Yield names and draws: the block (k,) of each length, in the order of the blocks."""
    m = int(position.max()) + 1
    first = np.where(position == position.min(), 0, position)
    yield "closed", [np.where(late & (first == 0), m, first) for late in _drawn(position, 2, rng)]
    for sweeps in range(2, most_sweeps + 1):
        draws = []
        for share in _drawn(position, sweeps, rng):
            back = share % 2 == 1
            draws.append(share * m + np.where(back, m - 1 - position, position))
        yield f"{sweeps} sweeps", [_dense(block) for block in draws]


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
    return MeasuringOrder(name, order, duration(costs, order), bound, judged)


def _worst(way: MeasuringOrder) -> float:
    return 0.0 if way.forecast is None else max(way.forecast.drift, way.forecast.knock)


def _badness(way: MeasuringOrder) -> tuple[float, float]:
    return _worst(way), way.seconds
