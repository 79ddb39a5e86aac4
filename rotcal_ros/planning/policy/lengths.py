"""The lengths of a laser tracer as an experiment: what any choice of steps would give.

Everything is linear about the nominal place of the tracer (:class:`Information`); what was
observed enters only the estimate of the noise and the tests.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np

from rotcal_ros.arrays import Bools, Floats, Ints
from rotcal_ros.components import COVERAGE_FACTOR
from rotcal_ros.methods.tracer.grid import STATION_MINIMUM
from rotcal_ros.observations import Observation
from rotcal_ros.planning.plan import Plan
from rotcal_ros.planning.policy.noise import (
    LengthNoise,
    estimate_noise,
    judge_lengths,
    suspect_length,
)
from rotcal_ros.planning.tracer_design.information import Information
from rotcal_ros.planning.tracer_design.scene import Lengths, Scene

ROUNDS: Final = 12
"""In about so many rounds a sweep is put together."""
SHORTLIST: Final = 1200
"""Only so many of the best candidates are looked at again in every round."""
PLACING_STEPS: Final = 8
"""Gauss-Newton steps that place a station from its nominal place, a few centimetres off."""
MOST_PER_STATION: Final = 3
"""No more lengths of a station are taken in one round: they would all be alike."""
LEAST_GAIN: Final = 5e-4
"""A length that lowers the mean variance by less than this share is not worth its time."""


@dataclass(frozen=True, slots=True)
class Costs:
    """Seconds that a step takes, and that a turn of the table takes."""

    step_s: float
    turn_s: float


@dataclass(frozen=True, slots=True)
class Wish:
    """What a set of steps has to reach: ``uncertainty`` (rad) with this noise and coverage factor.

    ``noise`` is a factor on the planned standard deviation of a length.
    """

    uncertainty: float
    noise: float
    coverage_factor: float


class LengthExperiment:
    """The steps of ``plan`` as lengths in ``scene``, each station with a zero of its own."""

    def __init__(self, plan: Plan, scene: Scene, costs: Costs) -> None:
        self.plan, self.scene, self.costs = plan, scene, costs
        self.position = np.array([step.table_position for step in plan.steps], dtype=np.int64)
        self.target = np.array([step.target for step in plan.steps], dtype=np.int64)
        self._first: dict[float, list[int]] = {}
        self._scenes: dict[float, Scene] = {}

    @cached_property
    def directions(self) -> Floats:
        """Unit vectors (k, 3) of the beams, from target to station, machine's frame."""
        return self.scene.beams(self.position, self.target)[0]

    def information(self, steps: Collection[int], noise: float) -> Information:
        """Return what the lengths of ``steps`` tell."""
        return Information(self._noisier(noise), self._lengths(steps), len(self.plan.table_angles))

    def uncertainty(self, steps: Collection[int], noise: float, coverage_factor: float) -> float:
        """Return the expanded uncertainty (rad, rms over the angles) that ``steps`` give.

        Infinite while the solver could not solve them.
        """
        if not self.solvable(steps):
            return np.inf
        return coverage_factor * _rms(self.information(steps, noise))

    def share_of_noise(self, steps: Collection[int], noise: float) -> float:
        """Return d ln(variance) / d ln(noise^2): how much of the mean variance the noise makes."""
        low, high = (self.information(steps, noise * f).variances().mean() for f in (0.95, 1.05))
        return float(np.log(high / low) / (2.0 * np.log(1.05 / 0.95)))

    def solvable(self, steps: Collection[int]) -> bool:
        """Whether every station has enough lengths."""
        return not self._lacking(steps).any()

    def lacking_in_words(self, steps: Collection[int]) -> str:
        """Return which stations have too few lengths; empty when all have enough."""
        found = np.bincount(self.position[list(steps)], minlength=len(self.plan.table_angles))
        return ", ".join(
            f"table position {position} has {found[position]} lengths of {STATION_MINIMUM} needed"
            for position in np.flatnonzero(self._lacking(steps))
        )

    def _lacking(self, steps: Collection[int]) -> Bools:
        found = np.bincount(self.position[list(steps)], minlength=len(self.plan.table_angles))
        return np.asarray(found < STATION_MINIMUM)

    def first_sweep(self, uncertainty: float) -> list[int]:
        """Return the steps that reach ``uncertainty`` (rad) with the planned noise, as a sweep."""
        if uncertainty not in self._first:
            every = np.ones(len(self.plan.steps), dtype=np.bool_)
            wish = Wish(uncertainty, 1.0, COVERAGE_FACTOR)
            steps = self.pick((), every, np.ones(len(every)), wish, sweep=True)
            self._first[uncertainty] = self.as_sweep(steps, None)
        return list(self._first[uncertainty])

    def pick(
        self, done: Collection[int], allowed: Bools, chance: Floats, wish: Wish, sweep: bool
    ) -> list[int]:
        """Return further steps that grant the wish, the best gain per time first.

        ``allowed`` (k,): candidates; ``chance`` (k,): how probably the beam is free. ``sweep``:
        all stations are visited anyway, so that a turn of the table costs nothing extra. Stops
        short of the wish when no candidate helps.
        """
        chosen: list[int] = []
        free = allowed.copy()
        free[list(done)] = False
        known = self.information(done, wish.noise)
        visited = np.full(len(self.plan.table_angles), sweep)
        shortlist = self._shortlist(known, np.flatnonzero(free), chance)
        batch = 0
        while len(shortlist):
            missing = self._excess(known, wish)
            lacking = self._lacking([*done, *chosen])
            if missing <= 0.0 and not lacking.any():
                break
            needed = max(missing, 0.0) * max(len(done) + len(chosen), STATION_MINIMUM)
            batch = batch or max(1, round(needed / ROUNDS))
            batch = min(batch, MOST_PER_STATION * len(visited), max(1, round(0.5 * needed)))
            batch = 1 if sweep else batch  # before anything moves there is time
            value = self._value(known, shortlist, chance, visited)
            if lacking.any():
                value = value * lacking[self.position[shortlist]]
                batch = len(visited)
            elif not (value > LEAST_GAIN * known.mean_variance / self._dearest).any():
                break
            best = self._spread_out(shortlist, value, batch)
            if not best:
                break
            chosen += best
            visited[self.position[best]] = True
            shortlist = shortlist[~np.isin(shortlist, best)]
            known = self.information([*done, *chosen], wish.noise)
        return chosen

    @property
    def _dearest(self) -> float:
        return self.costs.step_s + self.costs.turn_s

    def _excess(self, known: Information, wish: Wish) -> float:
        """Return by which share the mean variance is too large."""
        return float((wish.coverage_factor * _rms(known) / wish.uncertainty) ** 2 - 1.0)

    def _shortlist(self, known: Information, candidates: Ints, chance: Floats) -> Ints:
        """Return some candidates of each station: the best ones, and some of all directions."""
        if len(candidates) <= SHORTLIST:
            return candidates
        share = SHORTLIST // (2 * len(self.plan.table_angles))
        gains = known.gains(self._lengths(candidates)) * chance[candidates]
        kept = []
        for position in np.unique(self.position[candidates]):
            here = np.flatnonzero(self.position[candidates] == position)
            kept.append(here[np.argsort(-gains[here], kind="stable")[:share]])
            kept.append(here[np.linspace(0, len(here) - 1, share).astype(np.int64)])
        return np.asarray(candidates[np.unique(np.concatenate(kept))])

    def _value(
        self, known: Information, candidates: Ints, chance: Floats, visited: Bools
    ) -> Floats:
        """Return by how much the mean variance falls per second, (c,)."""
        turn = np.where(visited[self.position[candidates]], 0.0, self.costs.turn_s)
        gains = known.gains(self._lengths(candidates))
        return np.asarray(gains * chance[candidates] / (self.costs.step_s + turn))

    def _spread_out(self, candidates: Ints, value: Floats, count: int) -> list[int]:
        """Return up to ``count`` of the best candidates, shared among the stations."""
        order = np.argsort(-value, kind="stable")
        order = order[value[order] > 0.0]
        position = self.position[candidates[order]]
        by_station = np.argsort(position, kind="stable")
        sorted_position = position[by_station]
        rank = np.empty(len(order), dtype=np.int64)
        rank[by_station] = np.arange(len(order)) - np.searchsorted(
            sorted_position, sorted_position
        )
        most = -(-count // len(self.plan.table_angles))
        best: list[int] = candidates[order[rank < most][:count]].tolist()
        return best

    def instead(
        self, position: int, done: Collection[int], allowed: Bools, chance: Floats, noise: float
    ) -> int | None:
        """Return the step at table ``position`` with the largest gain, None if there is none."""
        free = allowed & (self.position == position)
        free[list(done)] = False
        candidates = np.flatnonzero(free)
        if not len(candidates):
            return None
        gains = self.information(done, noise).gains(self._lengths(candidates))
        return int(candidates[np.argmax(gains * chance[candidates])])

    def as_sweep(self, steps: Collection[int], at: int | None) -> list[int]:
        """Return ``steps`` station by station, from the end that is nearer to position ``at``."""
        ordered = sorted(steps, key=lambda step: (self.position[step], step))
        if not ordered or at is None:
            return ordered
        first, last = self.position[ordered[0]], self.position[ordered[-1]]
        if abs(last - at) < abs(first - at):
            return sorted(steps, key=lambda step: (-self.position[step], step))
        return ordered

    def noise(
        self, observed: Mapping[int, Observation], significance: float, factor: float | None = None
    ) -> tuple[LengthNoise, tuple[int, float] | None]:
        """Return the noise of the lengths ``observed`` by step, and the most suspect step.

        That comes with its test value; None: no length is suspect. With a ``factor``
        that is known already only the tests are new. Stations with too few lengths take no part.
        """
        lacking = self._lacking(list(observed))
        steps = [step for step in sorted(observed) if not lacking[self.position[step]]]
        if not steps:
            return LengthNoise(1.0, 0.0, np.zeros(0), 0.0), None
        kept = [observed[step] for step in steps]
        position, target = self.position[steps], self.target[steps]
        length = np.array([o.mean[0] for o in kept])
        seen, own = np.unique(target, return_inverse=True)
        places = _mean_places(np.array([o.probe_position for o in kept]), own, len(seen))
        unit, y = _placed(self.scene.stations, position, places[own], length)
        std = np.sqrt(self.scene.beams(position, target)[1])
        run = np.array([o.run for o in kept])
        design = _design(position, unit, run)
        errors = np.zeros((len(steps), len(seen), 3))
        errors[np.arange(len(steps)), own] = unit * self.scene.target_std[seen][own]
        time = np.array([o.window_end_ns for o in kept], dtype=np.float64)
        errors = errors.reshape(len(steps), -1) / std[:, None]
        scaled = (design / std[:, None], errors, y / std, time - time[0])
        found = estimate_noise(*scaled) if factor is None else judge_lengths(*scaled, factor)
        suspect = suspect_length(scaled, found, significance)
        return found, None if suspect is None else (steps[suspect[0]], suspect[1])

    def _noisier(self, factor: float) -> Scene:
        """Return the scene with ``factor`` times the noise; the last few are kept."""
        found = self._scenes.get(factor)
        if found is None:
            if len(self._scenes) > 8:
                self._scenes.clear()
            found = self._scenes[factor] = replace(
                self.scene,
                length_std=factor * self.scene.length_std,
                length_std_relative=factor * self.scene.length_std_relative,
            )
            found.__dict__.update(motion=self.scene.motion, bearing=self.scene.bearing)
        return found

    def _lengths(self, steps: Collection[int] | Ints) -> Lengths:
        rows = np.fromiter(steps, dtype=np.int64, count=len(steps))
        return Lengths.of(self.position[rows], self.target[rows], self.position[rows])


def _rms(known: Information) -> float:
    return float(np.sqrt(known.variances().mean()))


def _mean_places(reported: Floats, own: Ints, count: int) -> Floats:
    """Return the mean reported place (count, 3) of each target."""
    total = np.zeros((count, 3))
    np.add.at(total, own, reported)
    return np.asarray(total / np.bincount(own, minlength=count)[:, None])


def _placed(
    nominal: Floats, position: Ints, targets: Floats, length: Floats
) -> tuple[Floats, Floats]:
    """Return unit vectors (k, 3) and lengths less computed ones (k,), from stations in place.

    Gauss-Newton on each station by its own lengths, targets (k, 3) being known.
    """
    ids, own = np.unique(position, return_inverse=True)
    stations = nominal[ids].copy()
    zeros = np.zeros(len(ids))
    count = np.bincount(own)
    for _ in range(PLACING_STEPS):
        apart = stations[own] - targets
        distance = np.linalg.norm(apart, axis=1)
        unit = apart / distance[:, None]
        y = length - distance + zeros[own]
        rows = np.column_stack([unit, -np.ones(len(y))])
        normal = np.zeros((len(ids), 4, 4))
        np.add.at(normal, own, rows[:, :, None] * rows[:, None])
        right = np.zeros((len(ids), 4))
        np.add.at(right, own, rows * y[:, None])
        normal += 1e-12 * count[:, None, None] * np.eye(4)
        step = np.linalg.solve(normal, right[:, :, None])[:, :, 0]
        stations, zeros = stations + step[:, :3], zeros + step[:, 3]
    apart = stations[own] - targets
    distance = np.linalg.norm(apart, axis=1)
    return apart / distance[:, None], length - distance + zeros[own]


def _design(position: Ints, unit: Floats, run: Ints) -> Floats:
    """Return the columns of stations and their zeros, and of the zeros of later runs."""
    ids, own = np.unique(position, return_inverse=True)
    k, each = len(position), np.arange(len(position))
    stations = np.zeros((k, len(ids), 4))
    stations[each, own, :3] = unit
    stations[each, own, 3] = -1.0
    later: Sequence[Floats] = [(run == r).astype(np.float64)[:, None] for r in np.unique(run)[1:]]
    return np.column_stack([stations.reshape(k, -1), *later])
