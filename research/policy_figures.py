"""What the policy until_goal brings: coverage, time and blocked beams, by simulation.

    .venv/bin/python research/policy_figures.py [--runs 2000] [--zero per_segment] [--json FILE]

Every run measures with a tracer of its own place, targets and noise, by the policy itself, with
nominal geometry from the plan alone; lengths are exact distances with noise, of a table without
deviations. At the end those of the result are compared with their U, and U with the goal. All in
docs/evidence.md.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from math import ceil
from pathlib import Path
from typing import Any

import numpy as np

from rotcal_ros.foundation.errors import RotcalError
from rotcal_ros.foundation.observations import Approach, Observation, PointKind
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import ARCSEC, DEGREE, NANOSECOND
from rotcal_ros.geometry.rotations import positions_on_table
from rotcal_ros.methods.tracer.policy.experiment import Costs, LengthExperiment, StatedResult
from rotcal_ros.methods.tracer.policy.information import Scene
from rotcal_ros.methods.tracer.policy.sequence import SequenceForecast
from rotcal_ros.methods.tracer.policy.until_goal import (
    RESERVE,
    RESERVE_PER_SEGMENT,
    UntilGoal,
    first_sweep,
)
from rotcal_ros.methods.tracer.solver import TracerProblem, solve
from rotcal_ros.planning.choices import PolicyProgress, StepOutcome
from rotcal_ros.planning.plan import Plan, Step

MOUNT = np.array([0.0569, -0.0318, 0.1225])
ANGLES = np.radians(-145.0 + 30.0 * np.arange(11))
PLANNED_STD, TARGET_STD = 0.2e-6, 1.0e-6
GOAL = 1.202 * ARCSEC
STEP_S, TURN_S = 5.0, 10.0
ATTEMPTS = 3
TRUE = (0.5, 1.0, 1.5, 2.0)


def candidates(spacing: float) -> tuple[tuple[float, float, float], ...]:
    """Return targets (m) of the volume, seen 10 degrees up and from 0.25 m on."""
    box = [np.arange(a, b + 1e-9, spacing) for a, b in ((-0.6, 0.6), (-0.5, 0.5), (0.17, 1.02))]
    stations = positions_on_table(MOUNT, ANGLES)
    kept = []
    for place in product(*box):
        apart = np.array(place) - stations
        distance = np.linalg.norm(apart, axis=1)
        if (distance >= 0.25).all() and (apart[:, 2] >= np.sin(10.0 * DEGREE) * distance).all():
            kept.append((float(place[0]), float(place[1]), float(place[2])))
    return tuple(kept)


def experiment(
    spacing: float, per_segment: bool = False, error_motion: float | None = 0.0
) -> LengthExperiment:
    """Return the experiment of all candidates at all angles; ``error_motion`` as stated, m."""
    targets = candidates(spacing)
    pairs = enumerate(product(range(len(ANGLES)), range(len(targets))))
    steps = tuple(
        Step(k, j, float(ANGLES[j]), Approach.POSITIVE, PointKind.REFLECTOR, i, targets[i])
        for k, (j, i) in pairs
    )
    plan = Plan("tracer_multistation", tuple(ANGLES.tolist()), targets, steps)
    scene = Scene(
        positions_on_table(MOUNT, ANGLES), ANGLES, np.array(targets), TARGET_STD, PLANNED_STD,
        error_motion_std=error_motion,
    )  # fmt: skip
    solved = partial(stated, plan, per_segment, error_motion)
    return LengthExperiment(plan, scene, Costs(STEP_S, TURN_S), solved, per_segment=per_segment)


def stated(
    plan: Plan, per_segment: bool, error_motion: float | None, observations: Sequence[Observation]
) -> StatedResult:
    """Return what the solver states of ``observations``, with the noise as planned."""
    last = counted(observations, per_segment)
    try:
        return StatedResult.of(result_of(plan, per_segment, error_motion, last), last)
    except RotcalError as error:
        return StatedResult(np.inf, doubt=str(error))


def counted(observations: Sequence[Observation], per_segment: bool) -> list[Observation]:
    """Return the last observation of each step, of each unbroken beam."""
    return list({(o.segment if per_segment else 0, o.step): o for o in observations}.values())


def result_of(
    plan: Plan, per_segment: bool, error_motion: float | None, last: Sequence[Observation]
) -> Result:
    """Return the result of what counts."""
    return solve(TracerProblem(
        position=np.array([o.table_position for o in last]),
        target=np.array([o.target for o in last]),
        length=np.array([o.mean[0] for o in last]),
        length_std=PLANNED_STD,
        targets=np.array(plan.targets),
        target_std=TARGET_STD,
        table_angles=ANGLES,
        order=np.argsort(np.argsort([o.window_end_ns for o in last])),
        segment=np.array([o.segment for o in last]) if per_segment else None,
        error_motion_std=error_motion,
        start_stations=positions_on_table(MOUNT, ANGLES),
    ))  # fmt: skip


class Quick(UntilGoal):
    """The policy; where it stands is asked at the end only, which takes most of the time."""

    def _standing(self) -> PolicyProgress:
        return PolicyProgress(len(self._queue)) if self._queue else super()._standing()


class Cell:
    """One simulated calibration: true places and noise.

    ``blocked`` beams give nothing, and break the beam: the next length is read from another zero.
    ``break_after``: the beam breaks once more after so many lengths.
    """

    def __init__(
        self,
        of: LengthExperiment,
        rng: np.random.Generator,
        std: float,
        break_after: int | None = None,
    ) -> None:
        self.of, self.rng, self.std = of, rng, std
        mount = MOUNT + 0.005 * rng.standard_normal(3)
        self.stations = positions_on_table(mount, ANGLES)
        nominal = np.array(of.plan.targets)
        self.targets = nominal + TARGET_STD * rng.standard_normal(nominal.shape)
        self.zeros = rng.standard_normal(len(ANGLES))
        self.blocked = np.zeros(len(of.plan.steps), dtype=np.bool_)
        self.seconds, self.at, self.measured = 0.0, -1, of.nothing
        self.breaks, self.break_after, self.taken = 0, break_after, 0

    def measure(self, index: int) -> StepOutcome:
        """Return how a step goes, and let the time pass."""
        step = self.of.plan.steps[index]
        self.seconds += TURN_S * (self.at != step.table_position)
        self.at = step.table_position
        if self.blocked[index]:
            self.seconds += ATTEMPTS * STEP_S
            self.breaks += 1
            return StepOutcome(index, None)
        self.seconds += STEP_S
        distance = np.linalg.norm(self.targets[step.target] - self.stations[self.at])
        zero = self.zeros[0] + self.breaks if self.of.per_segment else self.zeros[self.at]
        value = float(distance - zero + self.std * self.rng.standard_normal())
        seen = step.observed((value,))
        seen = replace(seen, segment=self.breaks, window_end_ns=round(self.seconds / NANOSECOND))
        self.measured.add(seen)
        self.taken += 1
        self.breaks += self.taken == self.break_after
        return StepOutcome(index, seen)


@dataclass(frozen=True)
class Run:
    """One calibration: seconds, lengths, whether the goal was said to be met, errors within U.

    ``kept``: whether the result of the solver states no more than the goal.
    """

    seconds: float
    lengths: int
    met: bool
    inside: float
    slowest_choice_s: float
    reasons: tuple[str, ...] = ()
    kept: bool = False


def by_policy(cell: Cell) -> Run:
    """Measure as the policy chooses."""
    policy = Quick(cell.of, GOAL)
    slowest, reasons = 0.0, []
    while True:
        begun = time.thread_time()
        choice = policy.choose()
        slowest = max(slowest, time.thread_time() - begun)
        reasons.append(choice.reason)
        if choice.step is None:
            break
        policy.note(cell.measure(choice.step))
    return _judged(cell, choice.standing.uncertainty <= GOAL, slowest, tuple(reasons))


def as_planned(cell: Cell) -> Run:
    """Measure the set that reaches the goal with the planned noise, whatever happens."""
    for step in first_sweep(cell.of, GOAL):
        cell.measure(step)
    return _judged(cell, cell.of.uncertainty(cell.measured, 1.0) <= GOAL, 0.0)


def _judged(cell: Cell, met: bool, slowest: float, reasons: tuple[str, ...] = ()) -> Run:
    """Return how a calibration ended; true deviations are zero."""
    last = counted(cell.measured.observations, cell.of.per_segment)
    inside, kept = np.nan, False
    try:
        result = result_of(cell.of.plan, cell.of.per_segment, cell.of.scene.error_motion_std, last)
    except RotcalError:
        result = None
    if result is not None:
        ecc, covariance = result.deviations["ECC"], result.covariance["ECC"]
        centred = np.eye(len(ecc)) - 1.0 / len(ecc)
        variance = (centred @ covariance @ centred.T).diagonal()
        inside = float((np.abs(centred @ ecc) <= 2.0 * np.sqrt(variance)).mean())
        kept = 2.0 * np.sqrt(variance.mean()) <= GOAL
    return Run(cell.seconds, len(last), bool(met), inside, slowest, reasons, bool(kept))


def noise_rows(
    of: LengthExperiment,
    runs: int,
    factors: Sequence[float] = TRUE,
    break_after: int | None = None,
) -> list[dict[str, Any]]:
    """Return time and coverage at several true noises, of policy and fixed plan."""
    rows = []
    for true in factors:
        row: dict[str, Any] = {"true_um": true * PLANNED_STD * 1e6}
        for name, measure in (("fixed", as_planned), ("policy", by_policy)):
            rng = np.random.default_rng(20260705)
            std = true * PLANNED_STD
            found = [measure(Cell(of, rng, std, break_after)) for _ in range(runs)]
            row[name] = {
                "seconds": float(np.mean([run.seconds for run in found])),
                "lengths": float(np.mean([run.lengths for run in found])),
                "coverage_percent": 100.0 * float(np.mean([run.inside for run in found])),
                "met_percent": 100.0 * float(np.mean([run.met for run in found])),
                "kept_percent": 100.0 * float(np.mean([run.kept for run in found])),
                "slowest_choice_ms": 1e3 * max(run.slowest_choice_s for run in found),
            }
        rows.append(row)
        print(json.dumps(row), flush=True)
    return rows


def blocked_rows(of: LengthExperiment, cases: int) -> list[dict[str, Any]]:
    """Return how often the goal is met with a sector of the room blocked."""
    rows = []
    away = -of.directions
    azimuth = np.arctan2(away[:, 1], away[:, 0])
    for half_deg in (20.0, 40.0):
        row: dict[str, Any] = {"half_width_deg": half_deg}
        for name, measure in (("fixed", as_planned), ("policy", by_policy)):
            rng = np.random.default_rng(20260706)
            found = []
            for centre in 2.0 * np.pi * np.arange(cases) / cases:
                cell = Cell(of, rng, PLANNED_STD)
                off = np.abs((azimuth - centre + np.pi) % (2.0 * np.pi) - np.pi)
                cell.blocked = off <= half_deg * DEGREE
                found.append(measure(cell))
            row[name] = {
                "met_percent": 100.0 * float(np.mean([run.met for run in found])),
                "seconds": float(np.mean([run.seconds for run in found])),
            }
        rows.append(row)
        print(json.dumps(row), flush=True)
    return rows


def cost_of_protection(of: LengthExperiment) -> dict[str, Any]:
    """Return what the first sweep takes, and how much of that information alone would ask for."""
    reserve = RESERVE_PER_SEGMENT if of.per_segment else RESERVE
    from rotcal_design.tracer.optimum import ideal_plan  # tests of the core use the rest alone

    steps = np.array(first_sweep(of, reserve * GOAL))
    every = np.arange(len(of.plan.steps))
    zeros = 1 if of.per_segment else len(ANGLES)
    bound = ideal_plan(of.scene, of.lengths(every, of.nothing), zeros, (GOAL / 2.0) ** 2).bound
    turns = int((np.diff(of.position[steps]) != 0).sum())
    forecast = SequenceForecast(of.posed(of.nothing, 1.0, steps))(np.arange(len(steps)))
    return {
        "bound": ceil(bound),
        "lengths": len(steps),
        "lengths_s": STEP_S * (len(steps) - 1),
        "turns_s": TURN_S * turns,
        "least_turns_s": TURN_S * (len(ANGLES) - 1),
        **forecast.to_dict(),
    }


def main() -> None:
    """Run the simulations that are asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=2000)
    parser.add_argument("--true", type=float, nargs="*", default=TRUE, help="times planned noise")
    parser.add_argument("--sectors", type=int, default=40, help="directions; 0: none")
    parser.add_argument("--spacing", type=float, default=0.2)
    parser.add_argument("--zero", choices=("per_station", "per_segment"), default="per_station")
    parser.add_argument("--break-after", type=int, help="lengths until the beam breaks once")
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    of = experiment(given.spacing, given.zero == "per_segment")
    print(f"{len(of.plan.targets)} targets, {len(of.plan.steps)} candidates")
    print(json.dumps(cost_of_protection(of)), flush=True)
    found = {
        "noise": noise_rows(of, given.runs, given.true, given.break_after),
        "blocked": blocked_rows(of, given.sectors) if given.sectors else [],
    }
    if given.json:
        given.json.write_text(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
