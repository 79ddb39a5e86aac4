"""Among which lengths whole plans are sought, and with which of them the search begins."""

from __future__ import annotations

from math import ceil
from typing import Final

import numpy as np

from rotcal_ros.arrays import Floats, Ints
from rotcal_ros.planning.tracer_design.depth import Spread, flat_stations
from rotcal_ros.planning.tracer_design.optimum import Optimum
from rotcal_ros.planning.tracer_design.scene import Lengths, Scene
from rotcal_ros.planning.tracer_design.settings import PER_STATION, TracerDesignSettings

POOL_TARGETS: Final = 64
ENOUGH_TARGETS: Final = 40
POOL_SPACINGS: Final = 1.8
"""Whole plans are sought among all pairs of so many good targets, so many spacings apart."""
START_CHECKED: Final = 14
START_PLAIN: Final = 6
"""Lengths per station to begin with."""
OFF_PLANE: Final = 2
"""Lengths off the plane of the others to begin with, at each station."""
DEEP: Final = 0.5
"""Share of the largest depth that such a length gives."""


def pool_and_start(
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
