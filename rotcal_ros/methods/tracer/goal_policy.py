"""The policy ``until_goal`` for a laser tracer: the plan's steps as candidates."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from rotcal_ros.foundation.arrays import Floats, rms_about_mean
from rotcal_ros.foundation.components import COVERAGE_FACTOR
from rotcal_ros.foundation.errors import ConfigurationError, PlanError, RotcalError
from rotcal_ros.foundation.observations import Observation
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.geometry.rotations import on_table
from rotcal_ros.methods.configuration import Configuration
from rotcal_ros.methods.continuation import Continuation
from rotcal_ros.methods.tracer.policy.experiment import Costs, LengthExperiment, Stated
from rotcal_ros.methods.tracer.policy.scene import Scene
from rotcal_ros.methods.tracer.policy.until_goal import GoalLimits, UntilGoal
from rotcal_ros.methods.tracer.settings import TracerPlanSettings
from rotcal_ros.methods.tracer.solver_settings import TracerSolverSettings
from rotcal_ros.planning.choices import UNTIL_GOAL, Policy
from rotcal_ros.planning.plan import Plan


def until_goal(configuration: Configuration, plan: Plan) -> Callable[[Continuation], Policy]:
    """Return what makes the policy for a continuation; the first sweep is planned only once.

    Raises ConfigurationError for what until_goal cannot plan with, PlanError when the goal is out
    of reach of all steps; what is returned raises PlanError when a first step is asked for.
    """
    settings, source = configuration.planner, configuration.source
    goal = settings.goal_arcsec * ARCSEC
    if goal <= 0.0:
        raise ConfigurationError(
            f"{source}: planner: the policy {UNTIL_GOAL} needs a goal: give goal_arcsec"
        )
    if configuration.plan.repeated:
        raise ConfigurationError(
            f"{source}: planner: the policy {UNTIL_GOAL} chooses single steps, repeated runs "
            "measure all of them: leave out plan.runs and plan.bidirectional, or the policy"
        )
    experiment = length_experiment(configuration, plan)
    _check_reach(experiment, goal, source)
    return partial(
        _begun, experiment, GoalLimits(goal, configuration.solver.rejection_significance)
    )


def _begun(experiment: LengthExperiment, limits: GoalLimits, continuation: Continuation) -> Policy:
    if continuation.run == 0 and continuation.start_index:
        raise PlanError(
            f"start_index {continuation.start_index}: the policy {UNTIL_GOAL} measures in an "
            "order of its own; go on with 'rotcal run --resume'"
        )
    done = {o.step for o in continuation.observations}
    gone = {step.index for step in experiment.plan.steps} - done - set(continuation.steps)
    return UntilGoal(
        experiment,
        limits,
        again=continuation.again,
        earlier=continuation.observations,
        given_up=sorted(gone),
    )


def length_experiment(configuration: Configuration, plan: Plan) -> LengthExperiment:
    """Return the plan's steps as lengths about the nominal place of the tracer."""
    settings: TracerSolverSettings = configuration.solver
    planner = configuration.planner
    scene = Scene(
        stations=on_table(_mount(configuration), plan.table_angles),
        table_angles=np.array(plan.table_angles),
        targets=np.array(plan.targets),
        target_std=np.full(3, settings.target_std_m),
        length_std=planner.expected_std_m or settings.length_std_m,
        length_std_relative=settings.length_std_relative,
        error_motion_std=settings.error_motion_std_m,
    )
    if settings.variant == "joint" and settings.datum == "free":
        raise ConfigurationError(
            f"{configuration.source}: planner: the policy {UNTIL_GOAL} plans with the machine's "
            "coordinates: the solver's datum must be 'prior'"
        )
    in_segments = settings.zero == "per_segment"
    if in_segments and settings.zero_walk_std_m != 0.0:
        raise ConfigurationError(
            f"{configuration.source}: planner: the policy {UNTIL_GOAL} plans with zeros that "
            "stand: leave out solver.zero_walk_std_m, or the policy"
        )
    costs = Costs(planner.step_s, planner.turn_s)
    return LengthExperiment(
        plan, scene, costs, per_segment=in_segments, solver=settings,
        solved=partial(stated, configuration, plan),
    )  # fmt: skip


def stated(
    configuration: Configuration, plan: Plan, observations: Sequence[Observation]
) -> Stated:
    """Return what the result of the accepted ``observations`` states, or why there is none."""
    from rotcal_ros.methods.calibration import Calibration  # which knows every method

    try:
        result = Calibration(configuration, plan).solve(observations)
    except RotcalError as error:
        return Stated(np.inf, doubt=str(error))
    motion = result.error_motion
    return Stated(
        COVERAGE_FACTOR * rms_about_mean(result.covariance["ECC"]),
        motion.likely if motion is not None and motion.used != motion.stated else 0.0,
        "" if result.verdict == "ok" else next(iter(result.warnings), result.verdict),
    )


def _mount(configuration: Configuration) -> Floats:
    """Return where the tracer stands on the table (3,), m."""
    settings: TracerPlanSettings = configuration.plan
    place = settings.tracer_m
    if not place and configuration.simulated:
        place = configuration.simulation.tracer.mount_m
    if len(place) != 3:
        raise ConfigurationError(
            f"{configuration.source}: plan: the policy {UNTIL_GOAL} has to know, to a few "
            "centimetres, where the tracer stands on the table: give tracer_m: [x, y, z]"
        )
    return np.array(place)


def _check_reach(experiment: LengthExperiment, goal: float, source: str) -> None:
    every = range(len(experiment.plan.steps))
    best = experiment.planned(experiment.nothing, 1.0, COVERAGE_FACTOR, every)
    if best > goal:
        raise PlanError(
            f"{source}: planner: goal_arcsec {goal / ARCSEC:g} is out of reach: all {len(every)} "
            f"steps of the plan give {best / ARCSEC:.3g}; offer more targets, or a better spread "
            "of them"
        )
