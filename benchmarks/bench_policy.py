"""Choosing the next length among ten thousand, against inverting for every candidate.

Both know the lengths of a first sweep and look for the one that lowers the mean variance of the
angles most. The opponent adds each candidate's row to the normal matrix of all unknowns (stations,
zeros and the targets in use) and inverts it.
"""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path

import numpy as np
from racing import Row

sys.path.insert(0, str(Path(__file__).parents[1] / "research"))
import policy_figures as figures

from rotcal_ros.methods.tracer.policy.experiment import LengthExperiment, MeasuredLengths
from rotcal_ros.methods.tracer.policy.until_goal import UntilGoal, best_at, first_sweep
from rotcal_ros.planning.choices import StepOutcome

SPACING_M = 0.105
SECTOR_DEG = 30.0
WRONG_NUMBER = 40
ERROR_MOTION = 3e-8  # m
LOOSE_STD = 0.02  # m, of stations and zeros before anything is measured


class Inverting:
    """The mean variance of the angles by a full inverse."""

    def __init__(self, of: LengthExperiment, known: MeasuredLengths) -> None:
        self.of, self.m = of, len(of.plan.table_angles)
        own = np.array([o.step for o in known.observations])
        self.in_use = np.unique(of.target[own])
        # last come a target not in use, and centre and radius of the stations' circle
        size = 4 * self.m + 3 * len(self.in_use) + 6
        radius = float(np.hypot(*figures.MOUNT[:2]))
        outward = of.scene.stations[:, :2] / radius
        along = outward @ [[0.0, 1.0], [-1.0, 0.0]]
        each = np.arange(self.m)[:, None]
        self.turn, round_ = np.zeros((2, self.m, size))
        self.turn[each, 3 * each + [0, 1]] = along / radius
        self.turn[:, -3:-1] = -along / radius
        self.turn -= self.turn.mean(axis=0)
        round_[each, 3 * each + [0, 1]] = outward
        round_[:, -3:] = -np.column_stack([outward, np.ones(self.m)])
        prior = np.full(size, figures.TARGET_STD**-2)
        prior[: 4 * self.m] = prior[-3:] = LOOSE_STD**-2
        self.normal = np.diag(prior) + round_.T @ round_ / ERROR_MOTION**2
        for step in own:
            self.normal += self.square(step)

    def square(self, step: int) -> np.ndarray:
        """Return the information of one length."""
        j, i = self.of.position[step], self.of.target[step]
        slot = np.flatnonzero(self.in_use == i)
        place = 4 * self.m + 3 * (slot[0] if len(slot) else len(self.in_use))
        row = np.zeros(self.turn.shape[1])
        row[3 * j : 3 * j + 3] = self.of.directions[step]
        row[3 * self.m + j] = -1.0
        row[place : place + 3] = -self.of.directions[step]
        return np.outer(row, row) / figures.PLANNED_STD**2

    def best(self, candidates: np.ndarray) -> int:
        """Return the best of the candidates, one inverse for each."""
        variances = []
        for step in candidates:
            covariance = np.linalg.inv(self.normal + self.square(step))
            variances.append((self.turn @ covariance * self.turn).sum())
        return int(candidates[np.argmin(variances)])


def best_of_all(of: LengthExperiment) -> Row:
    """One choice among all candidates; ``difference`` is that of the steps chosen.

    All in seconds of the processor.
    """
    cell = figures.Cell(of, np.random.default_rng(1), figures.PLANNED_STD)
    for step in first_sweep(of, 0.75 * figures.GOAL):
        cell.measure(step)
    every = np.ones(len(of.plan.steps), dtype=np.bool_)
    ours_s = np.inf
    for _ in range(20):
        begun = time.thread_time()
        ours = best_at(of, None, cell.measured, (), every, np.ones(len(every)), 1.0)
        ours_s = min(ours_s, time.thread_time() - begun)
    left = np.setdiff1d(np.arange(len(every)), list(cell.measured.steps))
    inverting = Inverting(of, cell.measured)
    begun = time.thread_time()
    theirs = inverting.best(left)
    theirs_s = time.thread_time() - begun
    name = f"best of {len(left)} lengths"
    return Row(name, ours_s, theirs_s, theirs_s / ours_s, float(abs(ours - theirs)))


@dataclass(frozen=True)
class Trouble:
    """What goes wrong in a calibration: noise, blocked beams, a wrong length, a drift, a break."""

    noise: float = 1.0  # times the planned
    blocked: bool = False  # in a sector
    wrong_m: float = 0.0  # one length
    drift_m: float = 0.0  # from length to length
    break_after: int | None = None  # lengths

    def changed(self, outcome: StepOutcome, number: int) -> StepOutcome:
        """Return the length number ``number`` as it is read."""
        seen = outcome.observation
        if seen is None:
            return outcome
        error = self.drift_m * number + self.wrong_m * (number == WRONG_NUMBER)
        return replace(outcome, observation=replace(seen, mean=(seen.mean[0] + error,)))


TROUBLES = (
    Trouble(noise=2.0, blocked=True, wrong_m=20e-6, break_after=30),
    Trouble(noise=4.0),
    Trouble(drift_m=1e-8),
    Trouble(drift_m=1e-7),
)


def slowest_choice(of: LengthExperiment, opponent_s: float) -> Row:
    """The slowest choice of whole calibrations, whatever goes wrong.

    Each is followed three times, and the best time of each choice counts. ``opponent_s`` is what
    the opponent takes for the best single candidate.
    """
    choices, slowest = 0, 0.0
    for trouble in TROUBLES:
        every = np.min([list(seconds_of_choices(of, trouble)) for _ in range(3)], axis=0)
        choices, slowest = choices + len(every), max(slowest, float(every.max()))
    zero = "one zero" if of.per_segment else "a zero per station"
    name = f"slowest of {choices} choices, {zero}"
    return Row(name, slowest, opponent_s, opponent_s / slowest, None)


def seconds_of_choices(of: LengthExperiment, trouble: Trouble) -> Iterator[float]:
    """Follow the policy and yield the processor time of each choice."""
    away = -of.directions
    azimuth = np.degrees(np.arctan2(away[:, 1], away[:, 0]))
    noise_m = trouble.noise * figures.PLANNED_STD
    cell = figures.Cell(of, np.random.default_rng(1), noise_m, trouble.break_after)
    cell.blocked = trouble.blocked & (np.abs(azimuth) < SECTOR_DEG)
    policy = UntilGoal(of, figures.GOAL)
    for number in count():
        begun = time.thread_time()
        choice = policy.choose()
        yield time.thread_time() - begun
        if choice.step is None:
            return
        policy.note(trouble.changed(cell.measure(choice.step), number))


def rows() -> Iterator[Row]:
    """Yield one measurement each."""
    of = figures.experiment(SPACING_M, error_motion=ERROR_MOTION)
    best = best_of_all(of)
    yield best
    for case in (of, figures.experiment(SPACING_M, per_segment=True, error_motion=ERROR_MOTION)):
        yield slowest_choice(case, best.opponent_s)
