"""How many lengths, how large a circle, how quiet a tracer: what a required uncertainty takes.

For each radius and noise targets are taken from a grid of places in the measuring volume, each
seen from all table positions, until the required uncertainty is reached and every length is
checked by others, so that no hidden error of one moves an angle by more than the required
uncertainty. Beside it stands what no plan can beat, whatever it measures from where.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from rotcal_design.settings import TracerDesignSettings
from rotcal_design.tracer.candidates import candidates, make_scene
from rotcal_design.tracer.optimum import ideal_plan
from rotcal_design.tracer.search import (
    LengthReliability,
    design_demands,
    length_reliability,
    zero_count,
)
from rotcal_ros.foundation.arrays import Bools
from rotcal_ros.foundation.components import COVERAGE_FACTOR
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.methods.tracer.policy.information import Information, Lengths, Scene
from rotcal_ros.planning.sequence_time import TimeModel

MOST_TARGETS: Final = 64
"""Most targets, as many as the paper has; a goal that needs more is called out of reach."""
TRIED: Final = 8
"""Targets that are tried exactly before the best is taken."""


@dataclass(frozen=True)
class Trade:
    """What one radius and noise take; ``lengths`` None: the required uncertainty is out of reach.

    ``radius`` (m) of the tracer's circle, ``sigma`` (m) of one length. ``expanded``: U (k = 2) of
    ECC, rms over the angles about their mean, rad: of the plan, or of all candidates together.
    ``bound``: fewer lengths than this reach it in no plan, checked or not.
    """

    radius: float
    sigma: float
    expanded: float
    lengths: int | None = None
    targets: int | None = None
    bound: float | None = None
    redundancy: float | None = None
    seconds: float | None = None


def tracer_trade(
    settings: TracerDesignSettings,
    radii: Sequence[float],
    sigmas: Sequence[float],
    *,
    time: TimeModel,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[Trade, ...]:
    """Return what the goal of ``settings`` takes for each radius (m) and noise (m, k = 1).

    They stand for those of ``settings``; ``progress(done, total)`` is called after each.
    """
    rows: list[Trade] = []
    for radius in radii:
        for sigma in sigmas:
            mount = (radius, 0.0, settings.mount_m[2])
            rows.append(_traded(replace(settings, mount_m=mount, length_std_m=sigma), time))
            if progress is not None:
                progress(len(rows), len(radii) * len(sigmas))
    return tuple(rows)


def _traded(settings: TracerDesignSettings, time: TimeModel) -> Trade:
    scene = make_scene(settings)
    pairs, segments = candidates(scene, settings), zero_count(scene, settings)
    wanted = design_demands(scene, settings)
    every = Information(scene, pairs, segments)
    goal, radius = wanted.mean, settings.mount_m[0]
    plan = None
    if every.mean_variance <= goal:
        plan = _enough(scene, pairs, segments, goal, settings)
    if plan is None:
        return Trade(radius, scene.length_std, COVERAGE_FACTOR * every.rms_std)
    # closed: all positions once round, and the first again
    turns, order = time.turns(scene.table_angles), np.unique(plan.lengths.position)
    turning = float(turns[order[:-1], order[1:]].sum() + turns[order[-1], order[0]])
    return Trade(
        radius=radius,
        sigma=scene.length_std,
        expanded=COVERAGE_FACTOR * plan.rms_std,
        lengths=len(plan.lengths),
        targets=len(np.unique(plan.lengths.target)),
        bound=ideal_plan(scene, pairs, segments, goal).bound,
        redundancy=float(_checks(plan, settings).redundancy.min()),
        seconds=turning + len(plan.lengths) * (time.dwell + time.report),
    )


def _enough(
    scene: Scene, pairs: Lengths, segments: int, goal: float, settings: TracerDesignSettings
) -> Information | None:
    """Return the fewest targets, each from all positions, that reach the ``goal`` and are checked.

    None where MOST_TARGETS are not enough. The target with the largest gain comes next; then each
    is exchanged for a better one.
    """
    everywhere = np.bincount(pairs.target) == len(scene.stations)
    chosen: list[int] = []
    plan = Information(scene, pairs[[]], segments)
    while len(chosen) < min(MOST_TARGETS, int(everywhere.sum())):
        chosen.append(_next_target(plan, pairs, everywhere, chosen))
        plan = Information(scene, pairs[np.isin(pairs.target, chosen)], segments)
        for number in range(len(chosen)):
            rest = plan.without(plan.lengths.target == chosen[number])
            others = chosen[:number] + chosen[number + 1 :]
            better = _next_target(rest, pairs, everywhere, others)
            trial = rest.with_lengths(pairs[pairs.target == better])
            if trial.mean_variance < plan.mean_variance:
                chosen[number], plan = better, trial
        if plan.mean_variance <= goal and _checked(plan, settings):
            return plan
    return None


def _next_target(
    plan: Information, candidates: Lengths, everywhere: Bools, chosen: Sequence[int]
) -> int:
    """Return the target that, measured from all positions, lowers the mean variance most.

    Those with the largest gains of single lengths are tried.
    """
    gains = np.bincount(candidates.target, plan.gains(candidates))
    gains[~everywhere] = -np.inf
    gains[list(chosen)] = -np.inf
    tried = np.argsort(-gains, kind="stable")[:TRIED]
    left = [plan.with_lengths(candidates[candidates.target == t]).mean_variance for t in tried]
    return int(tried[np.argmin(left)])


def _checks(plan: Information, settings: TracerDesignSettings) -> LengthReliability:
    return length_reliability(plan, settings.rejection_significance, settings.power)


def _checked(plan: Information, settings: TracerDesignSettings) -> bool:
    """Whether each length is checked, and none hides an error as large as the required U."""
    found = _checks(plan, settings)
    hidden = settings.max_undetected * settings.need_arcsec * ARCSEC
    enough = found.redundancy.min() >= settings.min_redundancy
    return bool(enough and np.abs(found.effect).max() <= hidden)
