"""Which further steps are worth their time: the best gain per second, spread over the stations."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.methods.tracer.design.information import Information
from rotcal_ros.methods.tracer.design.scene import Lengths
from rotcal_ros.methods.tracer.policy.lengths import LengthExperiment, rms
from rotcal_ros.methods.tracer.policy.measured_lengths import MeasuredLengths

ROUNDS: Final = 6
"""In about so many rounds further steps are put together."""
SHORTLIST: Final = 700
"""Only so many of the best candidates are looked at again in every round."""
MOST_PER_STATION: Final = 3
"""No more lengths of a station are taken in one round: they would all be alike."""
MOST_AT_ONCE: Final = 60
"""So many further lengths are planned at once: choosing has to be quick."""
LEAST_GAIN: Final = 5e-4
"""A length that lowers the mean variance by less than this share is not worth its time."""


@dataclass(frozen=True, slots=True)
class Wish:
    """What a set of steps has to reach: ``uncertainty`` (rad) with this noise and coverage factor.

    ``noise`` is a factor on the planned standard deviation of a length.
    """

    uncertainty: float
    noise: float
    coverage_factor: float

    def excess(self, known: Information) -> float:
        """Return by which share the mean variance is too large."""
        return float((self.coverage_factor * rms(known) / self.uncertainty) ** 2 - 1.0)


def pick(
    of: LengthExperiment,
    measured: MeasuredLengths,
    allowed: Bools,
    chance: Floats,
    wish: Wish,
    *,
    sweep: bool = False,
) -> list[int]:
    """Return further steps that grant the wish, the best gain per time first.

    ``allowed`` (k,): candidates; ``chance`` (k,): how probably the beam is free. ``sweep``:
    all stations are visited anyway, so that a turn of the table costs nothing extra. Stops
    short of the wish when no candidate helps, and where very many are needed.
    """
    chosen: list[int] = []
    free = allowed.copy()
    free[list(measured.steps)] = False
    known = of.information(measured, wish.noise)
    visited = np.full(of.stations, sweep)
    shortlist = _shortlist(of, known, np.flatnonzero(free), measured, chance)
    batch = 0
    while len(shortlist) and (sweep or len(chosen) < MOST_AT_ONCE):
        missing = wish.excess(known)
        lacking = of.lacking(known.lengths)
        if missing <= 0.0 and not lacking.any():
            break
        batch = 1 if sweep else _batch(of, known, missing, batch)  # at first there is time
        offered = of.lengths(shortlist, measured)
        value = _value(of, known, offered, chance[shortlist], visited)
        if lacking.any():
            value = value * lacking[offered.position]
            batch = len(visited)
        elif not (value > LEAST_GAIN * known.mean_variance / of.costs.dearest_s).any():
            break
        best = _spread_out(of, shortlist, value, batch)
        if not best:
            break
        chosen += best
        visited[of.position[best]] = True
        shortlist = shortlist[~np.isin(shortlist, best)]
        known = of.information(measured, wish.noise, chosen)
    return chosen


def _batch(of: LengthExperiment, known: Information, missing: float, before: int) -> int:
    """Return how many lengths the next round takes; ``before``: the round before, 0 at first."""
    needed = max(missing, 0.0) * max(len(known.lengths), of.minimum)
    batch = before or max(1, round(needed / ROUNDS))
    return min(batch, MOST_PER_STATION * of.stations, max(1, round(0.5 * needed)))


def best_at(
    of: LengthExperiment,
    position: int | None,
    measured: MeasuredLengths,
    queued: Collection[int],
    allowed: Bools,
    chance: Floats,
    noise: float,
) -> int | None:
    """Return the step with the largest gain beside those ``measured`` and ``queued``.

    ``position``: of the table, None for any. None if there is none.
    """
    done = measured.steps
    further = [step for step in queued if step not in done]
    free = allowed.copy() if position is None else allowed & (of.position == position)
    free[[*done, *further]] = False
    candidates = np.flatnonzero(free)
    if not len(candidates):
        return None
    known = of.information(measured, noise, further)
    gains = known.gains(of.lengths(candidates, measured))
    return int(candidates[np.argmax(gains * chance[candidates])])


def as_sweep(of: LengthExperiment, steps: Collection[int], at: int | None) -> list[int]:
    """Return ``steps`` station by station, from the end that is nearer to position ``at``."""
    ordered = sorted(steps, key=lambda step: (of.position[step], step))
    if not ordered or at is None:
        return ordered
    first, last = of.position[ordered[0]], of.position[ordered[-1]]
    if abs(last - at) < abs(first - at):
        return sorted(steps, key=lambda step: (-of.position[step], step))
    return ordered


def _shortlist(
    of: LengthExperiment,
    known: Information,
    candidates: Ints,
    measured: MeasuredLengths,
    chance: Floats,
) -> Ints:
    """Return some candidates of each station: the best ones, and some of all directions."""
    if len(candidates) <= SHORTLIST:
        return candidates
    share = SHORTLIST // (2 * of.stations)
    gains = known.gains(of.lengths(candidates, measured)) * chance[candidates]
    kept = []
    for position in np.unique(of.position[candidates]):
        here = np.flatnonzero(of.position[candidates] == position)
        kept.append(here[np.argsort(-gains[here], kind="stable")[:share]])
        kept.append(here[np.linspace(0, len(here) - 1, share).astype(np.int64)])
    return np.asarray(candidates[np.unique(np.concatenate(kept))])


def _value(
    of: LengthExperiment, known: Information, offered: Lengths, chance: Floats, visited: Bools
) -> Floats:
    """Return by how much the mean variance falls per second, (c,)."""
    turn = np.where(visited[offered.position], 0.0, of.costs.turn_s)
    return np.asarray(known.gains(offered) * chance / (of.costs.step_s + turn))


def _spread_out(of: LengthExperiment, candidates: Ints, value: Floats, count: int) -> list[int]:
    """Return up to ``count`` of the best candidates, shared among the stations."""
    order = np.argsort(-value, kind="stable")
    order = order[value[order] > 0.0]
    position = of.position[candidates[order]]
    by_station = np.argsort(position, kind="stable")
    sorted_position = position[by_station]
    rank = np.empty(len(order), dtype=np.int64)
    rank[by_station] = np.arange(len(order)) - np.searchsorted(sorted_position, sorted_position)
    most = -(-count // of.stations)
    best: list[int] = candidates[order[rank < most][:count]].tolist()
    return best
