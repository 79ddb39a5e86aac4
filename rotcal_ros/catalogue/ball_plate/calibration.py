"""From observations to the ball plate problem, its result and its trials."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from rotcal_ros.arrays import Floats
from rotcal_ros.catalogue.ball_plate.plan import BallPlatePlanSettings
from rotcal_ros.catalogue.ball_plate.solver_settings import BallPlateSolverSettings
from rotcal_ros.catalogue.configuration import Configuration
from rotcal_ros.catalogue.method import Trials
from rotcal_ros.errors import ConfigurationError, DataError
from rotcal_ros.methods import ball_plate
from rotcal_ros.methods.ball_plate.problem import BallPlateProblem
from rotcal_ros.observations import Observation
from rotcal_ros.planning.plan import Plan
from rotcal_ros.results import Result


def solve(configuration: Configuration, plan: Plan, observations: Sequence[Observation]) -> Result:
    """Solve the accepted observations of a ball plate plan; angles are those of the table."""
    result = ball_plate.solve(_chosen(configuration, plan, observations))
    return replace(result, angles=np.array(plan.table_angles)[:: configuration.solver.coarser])


def trials(
    configuration: Configuration, plan: Plan, observations: Sequence[Observation]
) -> Trials:
    """Prepare Monte Carlo trials about the accepted observations of a ball plate plan.

    Raises ConfigurationError when neither the set-up nor the residuals tell the noise.
    """
    prepared = ball_plate.plate_trials(_chosen(configuration, plan, observations))
    if not np.max(prepared.std) > 1e-12:
        raise ConfigurationError(
            f"{configuration.source}: exact centres tell no noise; state solver.sigma_centre_m"
        )
    return prepared


def _chosen(
    configuration: Configuration, plan: Plan, observations: Sequence[Observation]
) -> BallPlateProblem:
    """Return the part of the data that the settings of the solver choose."""
    settings: BallPlateSolverSettings = configuration.solver
    return ball_plate.select(
        problem(configuration, plan, observations),
        balls=list(settings.balls) or None,
        cmm_positions=list(settings.cmm_positions) or None,
        coarser=settings.coarser,
    )


def problem(
    configuration: Configuration, plan: Plan, observations: Sequence[Observation]
) -> BallPlateProblem:
    """Return the problem that observations of a plan pose.

    The row numbers are the steps of the plan, so that messages and the search for a moved plate
    follow the order of measurement. All centres weigh the same: the scatter of a few touches
    says less about a centre than the residuals of all of them.
    """
    if not observations:
        raise DataError("no ball was measured: there is nothing to solve")
    settings: BallPlatePlanSettings = configuration.plan
    plate, sigma = settings.plate, configuration.solver.sigma_centre_m
    return BallPlateProblem(
        grid=plate.grid,
        radius=plate.circle_radius_m,
        position=np.array([o.table_position for o in observations], dtype=np.int64),
        ball_step=np.array([o.target for o in observations], dtype=np.int64),
        centres=np.array([o.mean for o in observations]) - np.array(settings.centre_m),
        sigma=sigma or None,
        row=np.array([o.step for o in observations], dtype=np.int64),
        separate_groups=plate.separate_groups,
    )


def gauge(angles: Floats, deviations: Mapping[str, Floats]) -> dict[str, Floats]:
    """Return what the method can see of six deviations at equidistant ``angles`` (n,).

    Eq. 16 to 18: no mean in any component, and nothing in the pairs EXC, EYC and EAC, EBC that
    turns with the table, as a shifted or tilted plate would.
    """
    seen = {name: values - values.mean() for name, values in deviations.items()}
    turn = np.exp(1j * (angles - angles[0]))
    for x, y in (("EXC", "EYC"), ("EAC", "EBC")):
        plane = seen[x] + 1j * seen[y]
        plane = plane - np.mean(plane * turn.conj()) * turn
        seen[x], seen[y] = plane.real.copy(), plane.imag.copy()
    return seen
