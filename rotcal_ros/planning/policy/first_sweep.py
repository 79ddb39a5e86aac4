"""The first sweep: few steps that reach an uncertainty, in an order that hides little.

With known noise this is all that there is to plan. The fewest steps are found by exchange; they
are then shared among sweeps there and back, so that neither a drift of the machine nor a knock of
the tracer is mistaken for a deviation (:mod:`rotcal_ros.planning.sequence_choice`).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from rotcal_ros.components import COVERAGE_FACTOR
from rotcal_ros.planning.policy.further import Wish, as_sweep, pick
from rotcal_ros.planning.policy.lengths import LengthExperiment
from rotcal_ros.planning.sequence_choice import least_hidden, measuring_orders
from rotcal_ros.planning.sequence_forecast import OrderForecast
from rotcal_ros.planning.sequence_time import stated_time
from rotcal_ros.planning.tracer_design.exchange import fewest_lengths
from rotcal_ros.planning.tracer_design.penalty import Demands
from rotcal_ros.protection import TOLERABLE

EXCHANGES: Final = 300
CHECKED_EXCHANGES: Final = 40
"""So long the first sweep is sought by exchange, before anything moves: about a second."""
LEAST_REDUNDANCY: Final = 0.02
"""Of each length of the first sweep: an error of 33 standard deviations shows."""
HIDDEN: Final = 0.9 * TOLERABLE
"""What a drift or knock may do unseen (std); below the limit, as the noise is not known yet."""
NEARLY_HIDDEN: Final = 0.95 * TOLERABLE
"""No larger set is measured for what is nearly as little."""
SHARES: Final = (1.0, 0.93)
"""Of the uncertainty that is wanted: some lengths more may need a sweep less to be protected, and
the quickest of both is taken."""
TRIES: Final = 3
"""Times that a smaller uncertainty is tried, to make room for what the solver allows for slips."""


def first_sweep(of: LengthExperiment, uncertainty: float) -> list[int]:
    """Return the steps that reach ``uncertainty`` (rad) with the planned noise, in their order.

    Takes some seconds, once for each uncertainty.
    """
    if uncertainty not in of.sweeps:
        ways = [_reaching(of, share * uncertainty) for share in SHARES]
        best = min(ways, key=lambda way: (max(way.unseen, NEARLY_HIDDEN), way.seconds))
        of.sweeps[uncertainty] = best.steps
    return list(of.sweeps[uncertainty])


class Sweep(NamedTuple):
    """``steps`` in their order, their time (s), and what drift or knock may do unseen (std)."""

    steps: tuple[int, ...]
    seconds: float
    unseen: float


def _reaching(of: LengthExperiment, uncertainty: float) -> Sweep:
    """Return the fewest steps that reach ``uncertainty`` (rad), in their order."""
    aim = uncertainty
    for _ in range(TRIES):
        steps = _fewest(of, aim)
        found = of.uncertainty(of.nothing, 1.0, COVERAGE_FACTOR, steps)
        if not uncertainty < found < np.inf:
            break
        aim *= uncertainty / found
    return protected(of, steps)


def protected(of: LengthExperiment, steps: list[int]) -> Sweep:
    """Return ``steps`` in the quickest order that shows drift and knock in time, or most of it."""
    if not of.solvable(of.nothing, steps):
        return Sweep(tuple(as_sweep(of, steps, None)), np.inf, np.inf)
    rows = np.array(as_sweep(of, steps, None))
    position, target = of.position[rows], of.target[rows]
    time = stated_time(of.costs.turn_s, of.costs.step_s)
    costs = time.costs(of.scene.table_angles, of.scene.targets, position, target)
    forecast = OrderForecast(of.posed(of.nothing, 1.0, rows))
    # whole sweeps only: what is added later has to find each position early and late alike
    ways = measuring_orders(position, target, costs, forecast, limit=HIDDEN, sparse=())
    best = least_hidden(ways, HIDDEN)
    unseen = np.inf if best.forecast is None else best.forecast.worst
    return Sweep(tuple(rows[best.order].tolist()), best.seconds, unseen)


def _fewest(of: LengthExperiment, uncertainty: float) -> list[int]:
    every = np.ones(len(of.plan.steps), dtype=np.bool_)
    wish = Wish(uncertainty, 1.0, COVERAGE_FACTOR)
    steps = pick(of, of.nothing, every, np.ones(len(every)), wish, sweep=True)
    return _exchanged(of, steps, uncertainty)


def _exchanged(of: LengthExperiment, steps: list[int], uncertainty: float) -> list[int]:
    """Return fewer steps that reach as much, all stations being visited anyway.

    The fewest are nearly the same with and without a check, and sooner found without.
    """
    plain = Demands(
        mean=(uncertainty / COVERAGE_FACTOR) ** 2,
        largest=np.inf,
        redundancy=LEAST_REDUNDANCY,
        share=np.inf,
        per_station=of.minimum,
        checked=False,
    )
    every = of.lengths(range(len(of.plan.steps)), of.nothing)
    near = np.flatnonzero(np.isin(every.target, every.target[steps]))
    pool, best = every[near], np.searchsorted(near, np.sort(steps))
    zeros = 1 if of.per_segment else of.stations
    for demands, exchanges in (
        (plain, EXCHANGES),
        (replace(plain, checked=True), CHECKED_EXCHANGES),
    ):
        found = fewest_lengths(of.scene, pool, zeros, demands, best, exchanges=exchanges)
        best = best if found is None else found
    return [int(step) for step in near[best]]
