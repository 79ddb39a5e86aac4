"""How a measurement stands to its goal, and what another plan takes for the same."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from rotcal_ros.foundation.arrays import rms_about_mean
from rotcal_ros.foundation.components import COVERAGE_FACTOR
from rotcal_ros.foundation.observations import Observation
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.methods.calibration import Calibration
from rotcal_ros.planning.choices import StepChoice
from rotcal_ros.planning.plan import PlanComparison

UNFINISHED = "it has not: the measurement was interrupted"


@dataclass(frozen=True)
class GoalStanding:
    """A goal and what became of it.

    ``goal``, ``reached``: expanded uncertainty (k = 2) of ECC about its mean, root mean square
    over the angles, rad; wanted, and as the result states it. ``measured`` lengths were accepted
    of ``candidates`` pairs. ``reason``: why the policy stopped. ``compared``: what is known of
    this plan and of the paper's in advance.
    """

    goal: float
    reached: float
    measured: int
    candidates: int
    reason: str
    compared: PlanComparison

    def describe(self) -> str:
        """Return one short line for the terminal."""
        papers = self.compared.papers
        sign = "<=" if self.reached <= self.goal else ">"
        return (
            f"goal: rms of U {self.reached / ARCSEC:.2f} {sign} {self.goal / ARCSEC:.2f} arcsec "
            f"by {self.measured} of {self.candidates} lengths, {self.compared.own.seconds:.0f} s "
            f"at the paper's pace; its {papers.lengths} take {papers.seconds:.0f} s to "
            f"{papers.uncertainty / ARCSEC:.2f}"
        )


def goal_standing(
    calibration: Calibration,
    result: Result,
    choices: Sequence[StepChoice],
    observations: Sequence[Observation],
) -> GoalStanding | None:
    """Return how ``result`` stands to the goal of the policy; None without goal or ``choices``."""
    compare = calibration.method.compare
    goals = [choice.standing.goal for choice in choices if choice.standing.goal > 0.0]
    if compare is None or not goals:
        return None
    steps = tuple(choice.step for choice in choices if choice.step is not None)
    accepted = [o for o in observations if o.accepted]
    lost = set(steps) - {o.step for o in accepted}
    last = choices[-1]
    return GoalStanding(
        goal=goals[-1],
        reached=COVERAGE_FACTOR * rms_about_mean(result.covariance["ECC"]),
        measured=len(accepted),
        candidates=len(calibration.plan.steps),
        reason=last.reason if last.step is None else UNFINISHED,
        compared=compare(calibration.configuration, calibration.plan, steps, lost),
    )
