"""From a goal to a plan: candidates, the ideal plan with its bound, and whole lengths."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil
from typing import Any, Final

import numpy as np

from rotcal_ros.arrays import Floats, Ints
from rotcal_ros.components import COVERAGE_FACTOR, unit_of
from rotcal_ros.errors import PlanError
from rotcal_ros.methods.tracer.grid import STATION_MINIMUM
from rotcal_ros.planning.tracer_design.candidates import candidates, scene_of
from rotcal_ros.planning.tracer_design.checks import Checks, checks_of
from rotcal_ros.planning.tracer_design.exchange import Demands, fewest_lengths
from rotcal_ros.planning.tracer_design.information import Information, error_motion_angles
from rotcal_ros.planning.tracer_design.optimum import Optimum, Progress, ideal_plan
from rotcal_ros.planning.tracer_design.scene import Lengths, Scene
from rotcal_ros.planning.tracer_design.settings import PER_STATION, TracerDesignSettings

ARCSEC: Final = unit_of("ECC")[0]
POOL_TARGETS: Final = 64
ENOUGH_TARGETS: Final = 40
POOL_SPACINGS: Final = 1.8
"""Whole plans are sought among all pairs of so many good targets, so many spacings apart."""
START_CHECKED: Final = 14
START_PLAIN: Final = 6
"""Lengths per station to begin with."""
IDEAL_GAP: Final = 0.05


@dataclass(frozen=True, eq=False)
class TracerDesign:
    """A plan for a goal, and what is known of it before it is measured.

    ``lengths`` (N) are ordered by position and target, the latter indices into ``targets`` (n, 3),
    which are those in use. ``bound``: no plan that reaches the goal has fewer lengths, checked or
    not; ``checked_bound``: none with the wanted redundancy, as far as counting tells.
    """

    settings: TracerDesignSettings
    scene: Scene
    lengths: Lengths
    known: Information
    checks: Checks
    ideal: Optimum
    checked_bound: int

    @property
    def bound(self) -> int:
        """Least whole number of lengths of any plan that reaches the goal."""
        return ceil(self.ideal.bound - 1e-9)

    @property
    def expanded(self) -> Floats:
        """U (m,) of ECC less its mean, k = 2, rad."""
        return np.asarray(COVERAGE_FACTOR * np.sqrt(self.known.variances()), dtype=np.float64)

    def to_dict(self) -> dict[str, Any]:
        """Return plain types for JSON, SI but for names that tell a unit."""
        expanded = self.expanded / ARCSEC
        return {
            "lengths": len(self.lengths),
            "targets": len(self.scene.targets),
            "stations": len(self.scene.stations),
            "expanded_rms_arcsec": float(np.sqrt((expanded**2).mean())),
            "expanded_largest_arcsec": float(expanded.max()),
            "ideal": self.ideal.count,
            "bound": self.bound,
            "gap": self.ideal.gap,
            "checked_bound": self.checked_bound,
            "checked": self.settings.checked,
            "smallest_redundancy": float(self.checks.redundancy.min()),
            "largest_detectable_m": _finite(self.checks.detectable.max()),
            "largest_undetected_in_u": _finite(self.checks.share.max()),
            "largest_undetected_arcsec": _finite(np.abs(self.checks.effect).max() / ARCSEC),
        }


def design(
    settings: TracerDesignSettings,
    *,
    targets: Floats | None = None,
    progress: Progress | None = None,
) -> TracerDesign:
    """Return a plan that reaches the goal of ``settings`` with few lengths; see docs/planning.md.

    ``targets`` (n, 3), m: the only places of the reflector, else all of the volume.
    Raises PlanError when the goal is out of reach, or no plan was found that checks every length.
    """
    scene = scene_of(settings, targets)
    pairs = candidates(scene, settings)
    segments = len(scene.stations) if settings.zero == PER_STATION else 1
    demands = _demands(scene, settings)
    constant = float(np.trace(error_motion_angles(scene))) / len(scene.stations)
    goal = demands.mean - constant
    if goal <= 0.0:
        raise PlanError(
            f"the error motion alone makes U(ECC) {COVERAGE_FACTOR * constant**0.5 / ARCSEC:.3g} "
            f"arcsec, wanted is {settings.need_arcsec:g}: no number of lengths helps"
        )
    parts = _Parts(progress, 1 + settings.starts)
    ideal = ideal_plan(
        scene, pairs, segments, goal,
        repeats=settings.repeats, gap=IDEAL_GAP, progress=parts.part(0),
    )  # fmt: skip
    apart = POOL_SPACINGS * settings.spacing_m if settings.repeats == 1 else 0.0
    which, weight = _pool(ideal, pairs, scene, apart)
    pool = pairs[which]
    start = _start(weight, pool, ideal.count, settings)
    found: list[Ints] = []
    for number in range(settings.starts):
        plan = fewest_lengths(
            scene, pool, segments, demands, start, repeats=settings.repeats,
            seed=settings.seed + number, exchanges=settings.exchanges,
            progress=parts.part(1 + number),
        )  # fmt: skip
        found += [] if plan is None else [plan]
    if not found:
        raise PlanError(
            f"no plan that meets all demands was found in {settings.exchanges} exchanges: widen "
            "the volume, allow repeats, raise exchanges or max_undetected"
        )
    return _finished(settings, scene, pool[np.sort(min(found, key=len))], segments, ideal)


def _demands(scene: Scene, settings: TracerDesignSettings) -> Demands:
    return Demands(
        mean=(settings.need_arcsec * ARCSEC / COVERAGE_FACTOR) ** 2,
        largest=(settings.largest_arcsec * ARCSEC / COVERAGE_FACTOR) ** 2,
        redundancy=settings.min_redundancy,
        share=settings.max_undetected,
        per_station=STATION_MINIMUM,
        significance=settings.rejection_significance,
        power=settings.power,
        checked=settings.checked,
    )


def _pool(ideal: Optimum, pairs: Lengths, scene: Scene, apart: float) -> tuple[Ints, Floats]:
    """Return candidates (indices) for whole plans, and how much the ideal plan likes each.

    All pairs of the best targets that are ``apart`` (m): shared targets check their lengths.
    """
    by_target = np.bincount(pairs.target, weights=ideal.weight, minlength=len(scene.targets))
    best = np.argsort(-by_target, kind="stable").tolist()
    good: list[int] = []
    for target in best:
        away = np.linalg.norm(scene.targets[good] - scene.targets[target], axis=1)
        if len(good) < POOL_TARGETS and (away >= apart).all():
            good.append(target)
    if len(good) < ENOUGH_TARGETS:
        good = best[:POOL_TARGETS]
    which = np.flatnonzero(np.isin(pairs.target, good))
    liked = ideal.weight[which] + 1e-6 * ideal.slopes[which] / ideal.slopes.max()
    return which, liked


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


def _finished(
    settings: TracerDesignSettings, scene: Scene, lengths: Lengths, segments: int, ideal: Optimum
) -> TracerDesign:
    """Return the design with the targets in use only."""
    used, numbers = np.unique(lengths.target, return_inverse=True)
    fewer = Scene(
        scene.stations, scene.table_angles, scene.targets[used], scene.target_std[used],
        scene.length_std, scene.length_std_relative, scene.circle_std, scene.error_motion_std,
    )  # fmt: skip
    own = Lengths.of(lengths.position, numbers, lengths.segment)
    known = Information(fewer, own, segments)
    checks = checks_of(known, settings.rejection_significance, settings.power)
    return TracerDesign(
        settings, fewer, own, known, checks, ideal, _checked_bound(settings, scene)
    )


def _checked_bound(settings: TracerDesignSettings, scene: Scene) -> int:
    """Return how many lengths the redundancy alone asks for.

    The leverages of a station's lengths add up to at least its own unknowns, 4 with a zero of its
    own and 3 without; each is at most 1 - redundancy. A circle knows some of them in advance.
    """
    if not settings.checked or settings.circle_std_m is not None:
        return 0
    own = 4 if settings.zero == PER_STATION else 3
    per_station = ceil(own / (1.0 - settings.min_redundancy) - 1e-9)
    return len(scene.stations) * max(per_station, STATION_MINIMUM)


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


def _finite(value: float) -> float | None:
    """Return a number for JSON, which has no infinity: None."""
    return float(value) if np.isfinite(value) else None
