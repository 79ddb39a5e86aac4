"""The policy ``until_goal``: fixed sweeps until the uncertainty is as wanted.

With known noise the uncertainty of a set of lengths is known before any is taken: the first sweep
is the set that reaches the goal with the planned noise. What is not known is learnt on the way:

* the noise, from the residuals of the first sweep; further steps are as many as Student's t then
  asks for (Stein's two stages, see :mod:`.noise`), where they pay most for their time;
* blocked beams: a step that was given up is replaced by the best at the same station, and beams
  nearby are held to be blocked too until better is known;
* suspect lengths are measured again; a length that is suspect twice is replaced by another target;
* a drift: the first step and the middle step are measured again, to close the sweep.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np

from rotcal_ros.arrays import Floats
from rotcal_ros.methods.distributions import normal_isf
from rotcal_ros.observations import Observation
from rotcal_ros.planning.policy.choices import Choice, Outcome, Standing
from rotcal_ros.planning.policy.lengths import LengthExperiment, Wish
from rotcal_ros.planning.policy.noise import LengthNoise, student_factor
from rotcal_ros.units import ARCSEC, DEGREE, MICROMETRE

PLANNED_FACTOR: Final = student_factor(math.inf)
RESERVE: Final = 0.9
"""The first sweep aims so far below the goal: a few lengths more then save turns of the table."""
BLOCKED_WIDTH: Final = 15.0 * DEGREE
"""A beam so near to a blocked one is as likely blocked as free."""
TINY: Final = 1e-6
POOR_CHANCE: Final = 0.5
"""A planned step with a smaller chance gives way to a better one at the same station."""
UNKNOWN: Final = 1e-3
"""A larger uncertainty (rad) is that of a station that nothing has placed yet."""


@dataclass(frozen=True, slots=True)
class Limits:
    """The goal (rad, k = 2, rms over the angles) and how sure the tests have to be.

    ``significance``: probability of suspecting any length, or a drift, when all is well.
    """

    uncertainty: float
    significance: float = 0.01


class UntilGoal:
    """Chooses among the steps of ``experiment`` until ``limits`` are met.

    ``again``: steps that a resumed plan measures again first; ``earlier`` is what the earlier runs
    observed, ``given_up`` the steps that they gave up. The noise of a resumed plan is estimated
    when its first sweep is complete, from all lengths there are then.
    """

    def __init__(
        self,
        experiment: LengthExperiment,
        limits: Limits,
        *,
        again: Iterable[int] = (),
        earlier: Iterable[Observation] = (),
        given_up: Iterable[int] = (),
    ) -> None:
        self._experiment, self._limits = experiment, limits
        self._lengths: dict[int, Observation] = {o.step: o for o in earlier}
        count = len(experiment.plan.steps)
        self._allowed = np.ones(count, dtype=np.bool_)
        self._from_blocked, self._from_free = np.full(count, np.pi), np.full(count, np.pi)
        """Angles (k,) of every beam to the nearest that was blocked, and free, rad."""
        self._at: int | None = None
        self._estimated = False
        self._stated = (1.0, PLANNED_FACTOR)
        """Factor of the noise and coverage factor, as they are known now."""
        self._asked_again: set[int] = set()
        self._closing: dict[int, float] = {}
        self._drift = ""
        self._queue: deque[tuple[int, str]] = deque(
            (step, "done step, measured again to join the runs") for step in again
        )
        for step in given_up:
            self._block(step)
        first = self._first_sweep()
        left = [s for s in first if s not in self._lengths and self._allowed[s]]
        self._queue += ((step, "first sweep") for step in left)

    def _first_sweep(self) -> list[int]:
        """Return the steps of the first sweep, with the reserve where there are enough."""
        goal = self._limits.uncertainty
        first = self._experiment.first_sweep(RESERVE * goal)
        reached = self._experiment.uncertainty(first, 1.0, PLANNED_FACTOR) <= RESERVE * goal
        return first if reached else self._experiment.first_sweep(goal)

    def choose(self) -> Choice:
        """Return the next step, or why nothing more is measured."""
        stop = ""
        while not self._queue and not stop:
            stop = self._plan_further()
        if stop:
            return Choice(None, stop + self._drift, self._standing())
        step, reason = self._queue[0]
        if step not in self._lengths and self._chance[step] < POOR_CHANCE:
            step, reason = self._queue[0] = self._better_than(step, reason)
        return Choice(step, reason, self._standing())

    def note(self, outcome: Outcome) -> None:
        """Take notice of a length, or of a step that was given up."""
        step = outcome.step
        if self._queue and self._queue[0][0] == step:
            self._queue.popleft()
        self._at = int(self._experiment.position[step])
        if outcome.observation is not None:
            self._from_free = np.minimum(self._from_free, self._angles_from(step))
            if math.isnan(self._closing.get(step, 0.0)):
                self._close(step, outcome.observation)
            self._lengths[step] = outcome.observation
        elif step not in self._lengths:
            self._block(step)
            self._replace(step, f"step {step} was given up: another target in its place")

    @property
    def noise_factor(self) -> float:
        """Noise of the lengths in units of the planned one: 1 before it is estimated."""
        return self._stated[0]

    def _standing(self) -> Standing:
        noise, factor = self._stated
        now = self._experiment.uncertainty(self._lengths, noise, factor)
        known = now if now < UNKNOWN else math.nan
        return Standing(len(self._queue), known, self._limits.uncertainty)

    def _plan_further(self) -> str:
        """Queue what is needed next; return why nothing is."""
        known = self._stated[0] if self._estimated else None
        significance = self._limits.significance
        noise, suspect = self._experiment.noise(self._lengths, significance, known)
        if suspect is not None:
            self._measure_again(*suspect)
            return ""
        if self._drifts(noise):
            return ""
        if not self._estimated and noise.dof > 0.0 and self._experiment.solvable(self._lengths):
            self._estimated = True
            share = self._experiment.share_of_noise(self._lengths, noise.factor)
            self._stated = (noise.factor, student_factor(noise.dof / share**2))
        factor, student = self._stated
        goal = self._limits.uncertainty
        now = self._experiment.uncertainty(self._lengths, factor, student)
        learnt = f"noise {factor:.3g} times the planned (k = {student:.3g})"
        if now <= goal:
            return f"goal reached: {_in_words(now)} <= {_in_words(goal)}, {learnt}"
        wish = Wish(goal, factor, student)
        more = self._experiment.pick(self._lengths, self._allowed, self._chance, wish, False)
        if not more:
            lacking = self._experiment.lacking_in_words(self._lengths)
            worse = lacking or f"{_in_words(now)} > {_in_words(goal)}"
            return f"no further step helps: {worse}, {learnt}"
        why = f"{learnt}: {len(more)} more lengths to {_in_words(goal)}"
        self._queue += ((step, why) for step in self._experiment.as_sweep(more, self._at))
        return ""

    def _measure_again(self, step: int, value: float) -> None:
        """Queue a suspect length again, or another target for it when it was suspect before."""
        why = f"the length of step {step} is suspect ({value:+.1f} standard deviations)"
        if step not in self._asked_again:
            self._asked_again.add(step)
            self._queue.append((step, f"{why}: measured again"))
            return
        del self._lengths[step]
        self._allowed[step] = False
        self._replace(step, f"{why} once more: another target in its place")

    def _drifts(self, noise: LengthNoise) -> bool:
        """Queue steps that close a sweep that drifts; False: it does not, or is closed already."""
        limit = normal_isf(0.5 * self._limits.significance)
        if self._closing or abs(noise.drift_value) <= limit:
            return False
        by_time = sorted(self._lengths, key=lambda step: self._lengths[step].window_end_ns)
        why = f"the lengths drift with time ({noise.drift_value:+.1f} standard deviations)"
        for step in (by_time[0], by_time[len(by_time) // 2]):
            self._closing[step] = math.nan
            self._queue.append((step, f"{why}: measured again to close the sweep"))
        return True

    def _close(self, step: int, observation: Observation) -> None:
        change = observation.mean[0] - self._lengths[step].mean[0]
        self._closing[step] = change
        known = (f"{s} by {c / MICROMETRE:+.2f} um" for s, c in self._closing.items() if c == c)
        self._drift = f"; closed: step {', '.join(known)}"

    def _block(self, step: int) -> None:
        """Hold a beam for blocked, and those near to it in direction for probably so."""
        self._from_blocked = np.minimum(self._from_blocked, self._angles_from(step))
        self._allowed[step] = False

    def _angles_from(self, step: int) -> Floats:
        directions = self._experiment.directions
        cosine = np.clip(directions @ directions[step], -1.0, 1.0)
        return np.asarray(np.arccos(cosine), dtype=np.float64)

    @property
    def _chance(self) -> Floats:
        """How probably each beam (k,) is free: less near a blocked one, more near free ones."""
        blocked = np.maximum(self._from_blocked, TINY)
        near = 0.5 ** ((blocked / BLOCKED_WIDTH) ** 2)
        return np.asarray(1.0 - near * np.minimum(1.0, self._from_free / blocked))

    def _better_than(self, step: int, reason: str) -> tuple[int, str]:
        """Return a step at the same station with a better chance, or ``step`` itself."""
        found, chance = self._instead(step), self._chance
        if found is None or chance[found] <= chance[step]:
            return step, reason
        return found, f"the beam of step {step} is probably blocked: another target in its place"

    def _replace(self, step: int, why: str) -> None:
        found = self._instead(step)
        if found is not None:
            self._queue.appendleft((found, why))

    def _instead(self, step: int) -> int | None:
        planned: Collection[int] = {*self._lengths, *(other for other, _ in self._queue)}
        place = int(self._experiment.position[step])
        noise, _ = self._stated
        return self._experiment.instead(place, planned, self._allowed, self._chance, noise)


def _in_words(uncertainty: float) -> str:
    return f"U {uncertainty / ARCSEC:.3f} arcsec"
