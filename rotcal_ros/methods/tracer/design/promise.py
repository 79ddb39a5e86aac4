"""Which U the result of a plan will state: the plan measured many times over before it is.

To first order U follows from the geometry, but a result states it after the solver has looked at
what was measured: it may estimate the noise, leaves lengths out, and takes the error motion of the
table from the circle where none is stated, which scatters from run to run. So every run here is
solved by the solver itself, and what it states is counted.

A verdict that is not ``ok`` states nothing. The tests behind it call a few sound runs suspect,
whatever is planned: no length lowers their share, which is told apart. A run that is called so
misses the goal like one whose U is too large: what is promised is that a run ends well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from rotcal_ros.adjust.distributions import binomial_quantile
from rotcal_ros.foundation.arrays import Bools, Floats
from rotcal_ros.foundation.components import COVERAGE_FACTOR
from rotcal_ros.foundation.errors import RotcalError
from rotcal_ros.methods.tracer.design.scene import Scene
from rotcal_ros.methods.tracer.solver.problem import TracerProblem
from rotcal_ros.methods.tracer.solver.solution import adjust
from rotcal_ros.methods.tracer.solver.verdict import judge

LOOKS: Final = (400, 1000, 2500)
"""Runs after which is asked whether the promise is kept. Tests that call 3 % of sound runs suspect
leave 2 % of the 5 % to U: 400 runs rarely tell that much."""
FEWEST: Final = 100
"""Runs that tell how far a plan is from its goal."""
ASSURANCE: Final = 0.95
"""How sure it is that the probability is what is promised, so few runs being simulated."""


def most_missed(runs: int, confidence: float) -> int:
    """Return how many of so many ``runs`` may miss a goal that is met with ``confidence``.

    More often missed it would be so few times with a probability of (1 - ASSURANCE) / looks, by
    the binomial law: together the LOOKS are wrong with 1 - ASSURANCE at most. -1: they are too few
    to tell.
    """
    return binomial_quantile((1.0 - ASSURANCE) / len(LOOKS), runs, 1.0 - confidence) - 1


@dataclass(frozen=True, eq=False)
class Promise:
    """U (k = 2, rad) of ECC less its mean that simulated results state.

    ``rms`` (r,) over the angles, ``largest`` (r,) at the worst one, of each run; infinite where
    the verdict was not ok.
    """

    rms: Floats
    largest: Floats

    @property
    def runs(self) -> int:
        """How many were simulated."""
        return len(self.rms)

    @property
    def suspected(self) -> float:
        """Share of sound runs whose verdict is not ok."""
        return float(np.isinf(self.rms).mean())

    @property
    def median(self) -> tuple[float, float]:
        """What half of the results stay below, rms and largest, rad."""
        return self._exceeded_by(self.runs // 2)

    def below(self, confidence: float) -> tuple[float, float]:
        """Return what a result stays below with the probability ``confidence``, rms and largest.

        The order statistics that are above these quantiles with ASSURANCE, without any
        distribution assumed (Wilks, Ann. Math. Statist. 12 (1941) 91).
        """
        return self._exceeded_by(most_missed(self.runs, confidence))

    def likely(self, confidence: float) -> tuple[float, float]:
        """Return what it stays below so often as would suffice after the last look.

        Of the results that are ok, where fewer are.
        """
        share = most_missed(LOOKS[-1], confidence) / LOOKS[-1]
        not_ok = int(np.isinf(self.rms).sum())
        return self._exceeded_by(max(int(share * self.runs), min(not_ok, self.runs - 1)))

    def _exceeded_by(self, number: int) -> tuple[float, float]:
        """Return what so many of the results exceed, rms and largest; infinite for -1."""
        if number < 0:
            return np.inf, np.inf
        rank = self.runs - 1 - number
        return float(np.sort(self.rms)[rank]), float(np.sort(self.largest)[rank])

    def met(self, rms: float, largest: float = np.inf) -> float:
        """Return the share of results that state no more than these, rad, and are ok."""
        return float(self._met(rms, largest).mean())

    def kept(self, confidence: float, rms: float, largest: float = np.inf) -> bool:
        """Return whether results are so with the probability ``confidence``."""
        missed = int((~self._met(rms, largest)).sum())
        return missed <= most_missed(self.runs, confidence)

    def hopeless(self, confidence: float) -> bool:
        """Return whether those that are not ok are more than may miss any goal."""
        return self.suspected > 1.0 - confidence

    def _met(self, rms: float, largest: float) -> Bools:
        within = (self.rms <= rms) & (self.largest <= largest)
        return np.asarray(within & np.isfinite(self.rms), dtype=np.bool_)


def promised(
    problem: TracerProblem,
    scene: Scene,
    goal: tuple[float, float],
    confidence: float,
    *,
    looks: Sequence[int] = LOOKS,
    seed: int = 0,
) -> Promise:
    """Return what results of ``problem`` in the ``scene`` will state; its lengths do not matter.

    Lengths and targets scatter as stated, and the stations about their circle by its stated
    deviation and by the stated error motion. Where none is stated the table has none. Ends at one
    of the ``looks``, numbers of runs, if the ``goal`` (rms and largest, rad) is seen there to be
    met with ``confidence``, or as soon as the last look can no longer show it.
    """
    found: list[tuple[float, float]] = []
    missed = 0
    for number in range(looks[-1]):
        found.append(_stated(_measured(problem, scene, np.random.default_rng([seed, number]))))
        missed += not (found[-1][0] <= goal[0] and found[-1][1] <= goal[1])
        runs = number + 1
        if runs in looks and missed <= most_missed(runs, confidence):
            break
        if runs >= FEWEST and missed > most_missed(looks[-1], confidence):
            break
    return Promise(*np.array(found).T)


def expanded(covariance: Floats) -> Floats:
    """Return U (m,), k = 2, of deviations less their mean, from their ``covariance`` (m, m)."""
    turn = np.eye(len(covariance)) - 1.0 / len(covariance)
    variance = np.diagonal(turn @ covariance @ turn)
    return np.asarray(COVERAGE_FACTOR * np.sqrt(np.maximum(variance, 0.0)), dtype=np.float64)


def _measured(problem: TracerProblem, scene: Scene, rng: np.random.Generator) -> TracerProblem:
    """Return the ``problem`` as it is measured once more."""
    stations = scene.stations + _off_circle(scene, rng)
    apart = stations[problem.position] - scene.targets[problem.target]
    noise = problem.length_std * rng.standard_normal(len(apart))
    return replace(
        problem,
        length=np.linalg.norm(apart, axis=1) + noise,
        targets=scene.targets + scene.target_std * rng.standard_normal(scene.targets.shape),
    )


def _off_circle(scene: Scene, rng: np.random.Generator) -> Floats:
    """Return by how much (m, 3) the stations leave the places of a perfect table, m."""
    motion = scene.motion
    outward = motion.in_plane / np.linalg.norm(motion.in_plane, axis=1)[:, None]
    basis = motion.plane.basis()
    along = np.column_stack([-outward[:, 1], outward[:, 0]]) @ basis
    drawn = rng.standard_normal((3, len(outward), 1))
    turning = scene.error_motion_std or 0.0
    across = turning if scene.circle_std is None else scene.circle_std
    off = across * drawn[0] * (outward @ basis) + turning * drawn[1] * along
    return np.asarray(off + (scene.circle_std or 0.0) * drawn[2] * motion.plane.normal)


def _stated(problem: TracerProblem) -> tuple[float, float]:
    """Return U that the result of ``problem`` states, rms and largest, rad."""
    try:
        solution = adjust(problem)
    except RotcalError:
        return np.inf, np.inf
    if judge(solution.evidence, problem.settings)[0] != "ok":
        return np.inf, np.inf
    found = expanded(solution.angles.covariance)
    return float(np.sqrt((found**2).mean())), float(found.max())
