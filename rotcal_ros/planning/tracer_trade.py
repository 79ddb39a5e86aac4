"""How many lengths, how large a circle, how quiet a tracer: what a wanted uncertainty takes.

For each radius and noise targets are taken from a grid of places in the measuring volume, each
seen from all table positions, until the wanted uncertainty is reached and every length is checked
by others, so that no hidden error of one moves an angle by more than the wanted uncertainty.
Beside it stands what no plan can beat, whatever it measures from where.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from rotcal_ros.arrays import Bools, Floats
from rotcal_ros.components import COVERAGE_FACTOR
from rotcal_ros.planning.sequence_time import TimeModel
from rotcal_ros.planning.tracer_design.information import Information
from rotcal_ros.planning.tracer_design.scene import Lengths, Scene, on_table
from rotcal_ros.units import DEGREE

LEAST_REDUNDANCY: Final = 0.25
MOST_TARGETS: Final = 64
TRIED: Final = 8
"""Targets that are tried exactly before the best is taken."""
DETECTABLE: Final = 4.3 + 0.84
"""Standard deviations: limit of the test of 704 lengths, and what 80 % probability adds."""
ROUNDS: Final = 40
"""Of the multiplicative algorithm (Silvey, Titterington and Torsney 1978) for the bound."""


@dataclass(frozen=True)
class Surroundings:
    """Where the tracer turns and the reflector may go: m and rad, in the frame of the table.

    ``height`` of the tracer's centre, ``low`` and ``high`` corners of the volume, ``spacing`` of
    the grid of possible targets: closer ones would share the machine's error. A beam is at least
    ``elevation`` above the horizontal and ``nearest`` long.
    """

    table_angles: tuple[float, ...]
    height: float = 0.1225
    low: tuple[float, float, float] = (-0.6, -0.5, 0.17)
    high: tuple[float, float, float] = (0.6, 0.5, 1.02)
    spacing: float = 0.17
    elevation: float = 10.0 * DEGREE
    nearest: float = 0.25

    def targets(self) -> Floats:
        """Return the possible places of the reflector (n, 3)."""
        axes = [
            np.linspace(low, high, int(np.floor((high - low) / self.spacing + 1e-9)) + 1)
            for low, high in zip(self.low, self.high, strict=True)
        ]
        return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)

    def candidates(self, scene: Scene, zero_per_station: bool) -> Lengths:
        """Return all pairs of a position and a target that it can measure."""
        m, n = len(scene.stations), len(scene.targets)
        position, target = np.divmod(np.arange(m * n), n)
        apart = scene.targets[target] - scene.stations[position]
        distance = np.linalg.norm(apart, axis=1)
        seen = (distance >= self.nearest) & (apart[:, 2] >= np.sin(self.elevation) * distance)
        position, target = position[seen], target[seen]
        return Lengths.of(position, target, position if zero_per_station else 0)


@dataclass(frozen=True)
class Trade:
    """What one radius and noise take; ``lengths`` None: the wanted uncertainty is out of reach.

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


def trade(
    surroundings: Surroundings,
    limit: float,
    radii: Sequence[float],
    sigmas: Sequence[float],
    *,
    target_std: float,
    error_motion_std: float = 0.0,
    zero_per_station: bool = False,
    time: TimeModel,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[Trade, ...]:
    """Return what U(ECC) <= ``limit`` (rad) takes for each radius and noise (m, k = 1).

    ``target_std`` (m) of each coordinate of the machine, ``error_motion_std`` (m) of the table;
    ``progress(done, total)`` is called after each.
    """
    rows = []
    for radius in radii:
        for sigma in sigmas:
            angles = np.array(surroundings.table_angles)
            scene = Scene(
                stations=on_table((radius, 0.0, surroundings.height), angles),
                table_angles=angles,
                targets=surroundings.targets(),
                target_std=np.array(target_std),
                length_std=sigma,
                error_motion_std=error_motion_std,
            )
            candidates = surroundings.candidates(scene, zero_per_station)
            segments = len(angles) if zero_per_station else 1
            rows.append(_traded(scene, candidates, segments, limit, radius, time))
            if progress is not None:
                progress(len(rows), len(radii) * len(sigmas))
    return tuple(rows)


def _traded(
    scene: Scene, candidates: Lengths, segments: int, limit: float, radius: float, time: TimeModel
) -> Trade:
    every = Information(scene, candidates, segments)
    motion = float(every.variances().mean()) - every.mean_variance
    goal = (limit / COVERAGE_FACTOR) ** 2 - motion
    if every.mean_variance > goal:
        return Trade(radius, scene.length_std, _expanded(every))
    plan = _enough(scene, candidates, segments, goal, limit)
    if plan is None:
        return Trade(radius, scene.length_std, _expanded(every))
    position = plan.lengths.position
    turns = time.turns(scene.table_angles)
    order = np.unique(position)
    # closed: all positions once round, and the first again
    turning = float(turns[order[:-1], order[1:]].sum() + turns[order[-1], order[0]])
    return Trade(
        radius=radius,
        sigma=scene.length_std,
        expanded=_expanded(plan),
        lengths=len(plan.lengths),
        targets=len(np.unique(plan.lengths.target)),
        bound=lengths_bound(plan, candidates, goal),
        redundancy=float(_redundancy(plan).min()),
        seconds=turning + len(plan.lengths) * (time.dwell + time.report),
    )


def lengths_bound(plan: Information, candidates: Lengths, goal: float) -> float:
    """Return the number of lengths below which no plan has a mean variance of ``goal`` (rad^2).

    phi is convex in the weights w of the candidates: with d = -dphi/dw at any w0, phi(w) >=
    phi(w0) + sum w0 d - sum w d >= phi(w0) + sum w0 d - N max d. The best w0 on the way of the
    multiplicative algorithm from ``plan`` is taken.
    """
    total, best = float(len(plan.lengths)), 0.0
    weight = np.full(len(candidates), total / len(candidates))
    for _ in range(ROUNDS):
        design = Information(plan.scene, candidates.weighing(weight), plan.segments)
        slopes = design.slopes(candidates)
        gained = float(weight @ slopes)
        best = max(best, (design.mean_variance + gained - goal) / float(slopes.max()))
        weight = weight * np.sqrt(slopes)
        # an inverse variance grows with the lengths: scaled to just reach the goal
        total = max(total * design.mean_variance / goal, 1.0)
        weight *= total / weight.sum()
    return best


def _enough(
    scene: Scene, candidates: Lengths, segments: int, goal: float, limit: float
) -> Information | None:
    """Return the fewest targets, each from all positions, that reach the ``goal`` and are checked.

    None where MOST_TARGETS are not enough. The target with the largest gain comes next; then each
    is exchanged for a better one.
    """
    everywhere = np.bincount(candidates.target) == len(scene.stations)
    chosen: list[int] = []
    plan = Information(scene, candidates[[]], segments)
    while len(chosen) < min(MOST_TARGETS, int(everywhere.sum())):
        chosen.append(_next_target(plan, candidates, everywhere, chosen))
        plan = Information(scene, candidates[np.isin(candidates.target, chosen)], segments)
        for number in range(len(chosen)):
            rest = plan.without(plan.lengths.target == chosen[number])
            others = chosen[:number] + chosen[number + 1 :]
            better = _next_target(rest, candidates, everywhere, others)
            trial = rest.with_lengths(candidates[candidates.target == better])
            if trial.mean_variance < plan.mean_variance:
                chosen[number], plan = better, trial
        if plan.mean_variance <= goal and _checked(plan, limit):
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


def _checked(plan: Information, limit: float) -> bool:
    """Whether each length is checked, and none hides an error that moves an angle by ``limit``."""
    if _redundancy(plan).min() < LEAST_REDUNDANCY:
        return False
    return largest_hidden_effect(plan) <= limit


def largest_hidden_effect(plan: Information) -> float:
    """Return by how much an error of one length that just stays unseen moves an angle, rad.

    It stays unseen up to DETECTABLE / sqrt(redundancy) standard deviations (Baarda 1968).
    """
    beams = plan.beams(plan.lengths)
    shift = DETECTABLE * np.sqrt(beams.variance / _redundancy(plan))
    return float((np.abs(beams.angles) * (shift / beams.variance)[:, None]).max())


def _redundancy(plan: Information) -> Floats:
    """Return the redundancy (k,) of the plan's lengths: the share of an error that shows."""
    beams = plan.beams(plan.lengths)
    return np.asarray(1.0 - beams.spread / beams.variance, dtype=np.float64)


def _expanded(plan: Information) -> float:
    return COVERAGE_FACTOR * float(np.sqrt(plan.variances().mean()))
