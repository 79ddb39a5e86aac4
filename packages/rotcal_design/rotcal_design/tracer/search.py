"""From a goal to a plan: candidates, the ideal plan with its bound, and whole lengths.

What the lengths of a plan check of each other (Baarda, W. (1968), A testing procedure for use in
geodetic networks): a length with redundancy r shows an error in it with power beta when the error
is delta0 sigma / sqrt(r); delta0 is the limit of the solver's test of single lengths plus the
quantile of beta. An error just below, undetected, moves the angles by F^-1 g / v times it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import ceil
from typing import Any, Final

import numpy as np

from rotcal_design.settings import PER_STATION, TracerDesignSettings
from rotcal_design.tracer.candidates import candidates, make_scene
from rotcal_design.tracer.optimum import Optimum, ideal_plan
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.components import COVERAGE_FACTOR
from rotcal_ros.foundation.errors import PlanError
from rotcal_ros.foundation.results import json_value
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.methods.tracer.policy.exchange import Demands, Progress, fewest_lengths
from rotcal_ros.methods.tracer.policy.information import (
    LEAST_DEPTH,
    Information,
    Lengths,
    Scene,
    Spread,
    detectable_in_std,
)
from rotcal_ros.methods.tracer.solver.problem import station_minimum

IDEAL_GAP: Final = 0.05
"""Share by which the ideal plan may lie above its bound: what follows rounds to whole lengths."""
STRICTER: Final = (4.0, 16.0, 64.0)
"""Divisors of the goal's variance, to find targets that check each other."""
POOL_TARGETS: Final = 64
ENOUGH_TARGETS: Final = 40
POOL_SPACINGS: Final = 1.8
"""Whole plans are sought among all pairs of so many good targets, so many spacings apart."""
START_CHECKED: Final = 14
"""Lengths per station to begin with, where each is to be checked."""
START_PLAIN: Final = 6
"""The same for the plain minimum."""
OFF_PLANE: Final = 2
"""Lengths off the plane of the others to begin with, at each station."""
DEEP: Final = 0.5
"""Share of the largest depth that such a length gives."""
ROUNDING: Final = 1e-6
"""Redundancy that is none: an error of that length shows nowhere, however large."""
UNCHECKED: Final = 1e-3
"""Redundancy of which is said that nothing checks the length: it takes an error of 150 times its
noise to show."""


@dataclass(frozen=True, eq=False)
class LengthReliability:
    """``redundancy`` (N,) of N lengths, ``detectable`` (N,) error in m, ``effect`` (N, m) in rad.

    ``effect``: what the smallest detectable error does to the angles less their mean. ``share``
    (N,): the largest effect of each length in expanded uncertainties (k = 2) of the same angle.
    """

    redundancy: Floats
    detectable: Floats
    effect: Floats
    share: Floats


def length_reliability(known: Information, significance: float, power: float) -> LengthReliability:
    """Return what the lengths in ``known`` check of each other."""
    beams = known.beams(known.lengths)
    delta0 = detectable_in_std(len(known.lengths), significance, power)
    redundancy = np.clip(known.redundancy, 0.0, 1.0)
    redundancy[redundancy < ROUNDING] = 0.0
    with np.errstate(divide="ignore"):
        detectable = delta0 * np.sqrt(beams.variance / redundancy)
    effect = beams.angles * (detectable / beams.variance)[:, None]
    expanded = COVERAGE_FACTOR * np.sqrt(known.variances())
    share = (np.abs(effect) / expanded).max(axis=1)
    return LengthReliability(redundancy, detectable, effect, share)


@dataclass(frozen=True, eq=False)
class TracerDesign:
    """A plan for a goal, and what is known of it before it is measured.

    ``lengths`` (N) are ordered by position and target, the latter indices into ``targets`` (n, 3),
    which are those in use. ``bound``: no plan that reaches the goal has fewer lengths, checked or
    not; ``checked_bound``: none with the wanted redundancy, as far as counting shows.
    """

    settings: TracerDesignSettings
    scene: Scene
    lengths: Lengths
    known: Information
    checks: LengthReliability
    ideal: Optimum
    checked_bound: int

    @property
    def bound(self) -> int:
        """Least whole number of lengths of any plan that reaches the goal."""
        return ceil(self.ideal.bound - 1e-9)

    def to_dict(self) -> dict[str, Any]:
        """Return plain types for JSON, SI but for names that carry a unit."""
        return {
            "lengths": len(self.lengths),
            "targets": len(self.scene.targets),
            "stations": len(self.scene.stations),
            "ideal": self.ideal.count,
            "bound": self.bound,
            "gap": self.ideal.gap,
            "checked_bound": self.checked_bound,
            "checked": self.settings.checked,
            "smallest_redundancy": float(self.checks.redundancy.min()),
            "unchecked": int((self.checks.redundancy < UNCHECKED).sum()),
            "largest_detectable_m": json_value(self.checks.detectable.max()),
            "largest_undetected_in_u": json_value(self.checks.share.max()),
            "largest_undetected_arcsec": json_value(np.abs(self.checks.effect).max() / ARCSEC),
        }


class DesignSearch:
    """The search for a plan that reaches the goal of ``settings``; see docs/planning.md.

    ``targets`` (n, 3), m: the only places of the reflector, else all of the volume.
    Raises PlanError when the goal is out of reach of any plan.
    """

    def __init__(
        self,
        settings: TracerDesignSettings,
        targets: Floats | None = None,
        progress: Progress | None = None,
    ) -> None:
        self.settings = settings
        self.scene = make_scene(settings, targets)
        self.demands = design_demands(self.scene, settings)
        self.segments = zero_count(self.scene, settings)
        self._parts = _Parts(progress, 2 + settings.starts)
        self._pairs = candidates(self.scene, settings)
        self._floor = _floor(self.scene, self.demands, settings)
        self.ideal = self._ideal(self.demands.mean)
        self._offer(self.ideal)

    def first(self) -> TracerDesign:
        """Return the best plan of all starts; PlanError when none was found.

        An ideal plan for a loose goal has too few lengths to show which targets check each other:
        where none is found, those of the ideal plan for a stricter goal are offered.
        """
        plans = self._of_all_starts()
        for stricter in STRICTER:
            if plans or not self.settings.checked:
                break
            try:
                left = (self.demands.mean - self._floor) / stricter
                self._offer(self._ideal(self._floor + left))
            except PlanError:  # out of reach of any plan
                break
            plans = self._of_all_starts()
        return self._best(plans)

    def _ideal(self, goal: float) -> Optimum:
        return ideal_plan(
            self.scene, self._pairs, self.segments, goal,
            repeats=self.settings.repeats, gap=IDEAL_GAP, progress=self._parts.part(0),
        )  # fmt: skip

    def _offer(self, ideal: Optimum) -> None:
        """Seek whole plans among the targets that the ``ideal`` plan likes."""
        self._pool, self._start = _pool_and_start(ideal, self._pairs, self.scene, self.settings)
        if flat_stations(self.scene, self._pool).size:  # nothing else is offered
            self.demands = replace(self.demands, depth=0.0)

    def _of_all_starts(self) -> list[Ints]:
        plans = (
            self._fewest(self.demands, self.settings.seed + number, 1 + number)
            for number in range(self.settings.starts)
        )
        return [plan for plan in plans if plan is not None]

    def continued(self, found: TracerDesign, mean: float, largest: float) -> TracerDesign:
        """Search on for a plan whose variances are ``mean`` and ``largest`` times those ``found``.

        Never larger than the goal's. The error motion, which no length changes, is left as it is.
        Where the targets that were offered do not suffice, those are that the ideal plan for it
        likes. Raises PlanError when no plan was found.
        """
        constant, known = np.diagonal(self.scene.error_motion_angles), found.known.variances()
        lengths = known - constant
        demands = replace(
            self.demands,
            mean=min(self.demands.mean, float((constant + mean * lengths).mean())),
            largest=min(self.demands.largest, float((constant + largest * lengths).max())),
        )
        part = 1 + self.settings.starts
        plan = self._fewest(demands, self.settings.seed, part)
        if plan is None:
            self._offer(self._ideal(demands.mean))
            plan = self._fewest(demands, self.settings.seed, part)
        return self._best([] if plan is None else [plan])

    def _fewest(self, demands: Demands, seed: int, part: int) -> Ints | None:
        return fewest_lengths(
            self.scene, self._pool, self.segments, demands, self._start,
            repeats=self.settings.repeats, seed=seed, exchanges=self.settings.exchanges,
            progress=self._parts.part(part),
        )  # fmt: skip

    def _best(self, plans: list[Ints]) -> TracerDesign:
        if not plans:
            raise PlanError(
                f"no plan that meets all demands was found in {self.settings.exchanges} "
                "exchanges: widen the volume, allow repeats, or raise exchanges"
            )
        self._start = np.sort(min(plans, key=len))
        lengths = self._pool[self._start]
        return _finished(self.settings, self.scene, lengths, self.segments, self.ideal)


def flat_stations(scene: Scene, lengths: Lengths) -> Ints:
    """Return the stations whose targets are not deep enough."""
    return np.flatnonzero(Spread.of(scene, lengths).depth < LEAST_DEPTH)


def zero_count(scene: Scene, settings: TracerDesignSettings) -> int:
    """Return how many zeros the lengths have."""
    return len(scene.stations) if settings.zero == PER_STATION else 1


def _floor(scene: Scene, demands: Demands, settings: TracerDesignSettings) -> float:
    """Return the mean variance (rad^2) of exact lengths, by the error motion alone."""
    constant = float(np.trace(scene.error_motion_angles)) / len(scene.stations)
    if demands.mean <= constant:
        raise PlanError(
            f"the error motion alone makes U(ECC) {COVERAGE_FACTOR * constant**0.5 / ARCSEC:.3g} "
            f"arcsec, the goal is {settings.need_arcsec:g}, and more lengths do not help: ask for "
            "less, or check error_motion_std_m"
        )
    return constant


def design_demands(scene: Scene, settings: TracerDesignSettings) -> Demands:
    """Return what ``settings`` ask of a plan in the ``scene``."""
    return Demands(
        mean=(settings.need_arcsec * ARCSEC / COVERAGE_FACTOR) ** 2,
        largest=(settings.largest_arcsec * ARCSEC / COVERAGE_FACTOR) ** 2,
        redundancy=settings.min_redundancy,
        share=settings.max_undetected,
        per_station=_per_station(settings),
        significance=settings.rejection_significance,
        power=settings.power,
        checked=settings.checked,
        depth=LEAST_DEPTH,
    )


def _finished(
    settings: TracerDesignSettings, scene: Scene, lengths: Lengths, segments: int, ideal: Optimum
) -> TracerDesign:
    """Return the design with the targets in use only."""
    used, numbers = np.unique(lengths.target, return_inverse=True)
    fewer = scene.with_targets(used)
    own = Lengths.of(lengths.position, numbers, lengths.segment)
    known = Information(fewer, own, segments)
    checks = length_reliability(known, settings.rejection_significance, settings.power)
    return TracerDesign(
        settings, fewer, own, known, checks, ideal, _checked_bound(settings, scene)
    )


def _per_station(settings: TracerDesignSettings) -> int:
    """Return how many lengths the solver needs at each station."""
    return station_minimum(settings.zero == PER_STATION, settings.circle_std_m is not None)


def _checked_bound(settings: TracerDesignSettings, scene: Scene) -> int:
    """Return how many lengths the redundancy alone requires.

    The leverages of a station's lengths add up to at least its own unknowns, 4 with a zero of its
    own and 3 without; each is at most 1 - redundancy. A circle knows some of them in advance.
    """
    if not settings.checked or settings.circle_std_m is not None:
        return 0
    per_station = ceil(_per_station(settings) / (1.0 - settings.min_redundancy) - 1e-9)
    return len(scene.stations) * per_station


class _Parts:
    """One progress bar for several searches of equal weight."""

    def __init__(self, progress: Progress | None, parts: int) -> None:
        self._progress, self._parts = progress, parts

    def part(self, number: int) -> Progress:
        """Return the progress of one search."""

        def shown(done: int, total: int) -> None:
            if self._progress is not None:
                self._progress(number * total + done, self._parts * total)

        return shown


def _pool_and_start(
    ideal: Optimum, pairs: Lengths, scene: Scene, settings: TracerDesignSettings
) -> tuple[Lengths, Ints]:
    """Return the pairs among which whole plans are sought, and with which of them to begin.

    All pairs of few good targets: shared targets check their lengths. They are those that the
    start takes.
    """
    good = _good_targets(ideal, pairs, scene, settings)
    which = np.flatnonzero(np.isin(pairs.target, good))
    liked = ideal.weight[which] + 1e-6 * ideal.slopes[which] / ideal.slopes.max()
    pool = pairs[which]
    start = _start(liked, pool, ideal.count, settings)
    start = _deepened(start, liked, pool, scene)
    few = np.flatnonzero(np.isin(pool.target, pool.target[start]))
    return pool[few], np.searchsorted(few, start)


def _good_targets(
    ideal: Optimum, pairs: Lengths, scene: Scene, settings: TracerDesignSettings
) -> list[int]:
    """Return the targets that the ideal plan likes, apart where there are enough of them."""
    apart = POOL_SPACINGS * settings.spacing_m if settings.repeats == 1 else 0.0
    by_target = np.bincount(pairs.target, weights=ideal.weight, minlength=len(scene.targets))
    best = np.argsort(-by_target, kind="stable").tolist()
    good: list[int] = []
    for target in best:
        away = np.linalg.norm(scene.targets[good] - scene.targets[target], axis=1)
        if len(good) < POOL_TARGETS and (away >= apart).all():
            good.append(target)
    return good if len(good) >= ENOUGH_TARGETS else best[:POOL_TARGETS]


def _start(weight: Floats, pool: Lengths, count: float, settings: TracerDesignSettings) -> Ints:
    """Return lengths to begin with: more than the ideal plan has, the best of each station."""
    stations = int(pool.position.max()) + 1
    least = START_CHECKED if settings.checked else START_PLAIN
    if settings.zero != PER_STATION:
        least = min(least, 9)
    each = max(least, ceil(1.15 * count / stations))
    chosen = []
    for station in range(stations):
        own = np.flatnonzero(pool.position == station)
        best = own[np.argsort(-weight[own], kind="stable")]
        rounds = np.ceil(np.clip(weight[best] * each * stations / count, 1.0, settings.repeats))
        chosen.append(np.repeat(best, rounds.astype(np.int64))[:each])
    return np.concatenate(chosen)


def _deepened(start: Ints, liked: Floats, pool: Lengths, scene: Scene) -> Ints:
    """Return ``start`` with lengths off the plane of each station's targets, where there are any.

    The ideal plan knows no mirror images, and is content with one level. They go to the targets
    that all stations together like best, for a target that few see checks no length.
    """
    popular = np.bincount(pool.target, weights=liked, minlength=len(scene.targets))
    chosen = Spread.of(scene, pool[start])
    more = [start]
    for station in flat_stations(scene, pool[start]).tolist():
        own = np.flatnonzero(pool.position == station)
        depth = chosen.depth_after(scene, pool[own], 1.0)
        deep = own[depth >= DEEP * depth.max()]
        best = np.argsort(-popular[pool.target[deep]], kind="stable")
        more.append(deep[best[:OFF_PLANE]])
    return np.concatenate(more)
