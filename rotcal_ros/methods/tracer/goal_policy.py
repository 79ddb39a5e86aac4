"""The policy ``until_goal`` for a laser tracer: the plan's steps as candidates.

And what the paper's plan on the same table, with the noise of now, would take and give.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from functools import partial
from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.components import COVERAGE_FACTOR
from rotcal_ros.foundation.errors import ConfigurationError, PlanError, RotcalError
from rotcal_ros.foundation.observations import Observation
from rotcal_ros.foundation.units import ARCSEC, DEGREE
from rotcal_ros.geometry.rotations import positions_on_table
from rotcal_ros.methods.configuration import Configuration
from rotcal_ros.methods.continuation import Continuation
from rotcal_ros.methods.tracer.plan import tracer_plan
from rotcal_ros.methods.tracer.policy.experiment import Costs, LengthExperiment, StatedResult
from rotcal_ros.methods.tracer.policy.information import Information, Lengths, Scene
from rotcal_ros.methods.tracer.policy.until_goal import UntilGoal
from rotcal_ros.methods.tracer.settings import (
    STATIONS_PER_TARGET,
    TracerPlanSettings,
    TracerSolverSettings,
)
from rotcal_ros.methods.tracer.simulation import cell_time
from rotcal_ros.planning.choices import UNTIL_GOAL, StepPolicy
from rotcal_ros.planning.plan import Plan, PlanComparison, PlanFigures, Step
from rotcal_ros.planning.sequence_time import constant_time_model


def until_goal(configuration: Configuration, plan: Plan) -> Callable[[Continuation], StepPolicy]:
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
    return partial(_begun, experiment, goal)


def _begun(experiment: LengthExperiment, goal: float, continuation: Continuation) -> StepPolicy:
    if continuation.run == 0 and continuation.start_index:
        raise PlanError(
            f"start_index {continuation.start_index}: the policy {UNTIL_GOAL} measures in an "
            "order of its own; resume with 'rotcal run --resume'"
        )
    done = {o.step for o in continuation.observations}
    gone = {step.index for step in experiment.plan.steps} - done - set(continuation.steps)
    return UntilGoal(
        experiment,
        goal,
        again=continuation.again,
        earlier=continuation.observations,
        given_up=sorted(gone),
    )


def length_experiment(configuration: Configuration, plan: Plan) -> LengthExperiment:
    """Return the plan's steps as lengths about the nominal place of the tracer."""
    settings: TracerSolverSettings = configuration.solver
    planner = configuration.planner
    scene = Scene(
        stations=positions_on_table(_mount(configuration), plan.table_angles),
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
        plan, scene, costs, partial(stated, configuration, plan), per_segment=in_segments,
        solver=settings,
    )  # fmt: skip


def stated(
    configuration: Configuration, plan: Plan, observations: Sequence[Observation]
) -> StatedResult:
    """Return what the result of the accepted ``observations`` states, or why there is none."""
    from rotcal_ros.methods.calibration import Calibration, last_accepted  # know every method

    try:
        result = Calibration(configuration, plan).solve(observations)
    except RotcalError as error:
        return StatedResult(np.inf, doubt=str(error))
    return StatedResult.of(result, tuple(last_accepted(observations).values()))


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
    best = experiment.planned(experiment.nothing, 1.0, every)
    if best > goal:
        raise PlanError(
            f"{source}: planner: goal_arcsec {goal / ARCSEC:g} is out of reach: all {len(every)} "
            f"steps of the plan give {best / ARCSEC:.3g}; offer more targets, or a better spread "
            "of them"
        )


ABOVE_TRACER: Final = 1.3025
"""Height (m) of the block's centre over the tracer: its first target is 1.13 m away."""


def compare(
    configuration: Configuration, plan: Plan, steps: Sequence[int], lost: Collection[int]
) -> PlanComparison:
    """Return the figures of ``steps`` of ``plan`` and of the paper's plan at the same angles.

    Steps that gave no length (``lost``) take time and give no information.

    Both with the planned noise of a length (``planner.expected_std_m``), and with the times that
    the policy reckons with. Raises ConfigurationError where the tracer's place is not known.
    """
    scene = length_experiment(configuration, plan).scene
    papers = papers_plan(plan.table_angles, float(scene.stations[0, 2]))
    targets = np.array(papers.targets)
    elsewhere = replace(scene, targets=targets, target_std=scene.target_std[0])
    chosen = [plan.steps[step] for step in steps]
    return PlanComparison(
        own=_figures(configuration, scene, chosen, lost),
        papers=_figures(configuration, elsewhere, papers.steps, ()),
        length_std=scene.length_std,
    )


def papers_plan(table_angles: Sequence[float], tracer_height: float) -> Plan:
    """Return the paper's plan at ``table_angles`` (rad), its block over the tracer (height, m).

    64 targets in 450 x 600 x 450 mm, all stations at each target.
    """
    return tracer_plan(
        TracerPlanSettings(
            table_angles_deg=tuple(angle / DEGREE for angle in table_angles),
            box_centre_m=(0.0, 0.0, tracer_height + ABOVE_TRACER),
            box_size_m=(0.45, 0.6, 0.45),
            box_points=(4, 4, 4),
            order=STATIONS_PER_TARGET,
        )
    )


def _figures(
    configuration: Configuration, scene: Scene, steps: Sequence[Step], lost: Collection[int]
) -> PlanFigures:
    planner, shared = configuration.planner, configuration.solver.zero == "per_segment"
    pairs = {(step.table_position, step.target) for step in steps if step.index not in lost}
    lengths = Lengths.of(*np.array(sorted(pairs)).T)
    if not shared:
        lengths = replace(lengths, segment=lengths.position)
    known = Information(scene, lengths, 1 if shared else len(scene.stations))
    simulated = configuration.simulated
    return PlanFigures(
        lengths=len(pairs),
        uncertainty=COVERAGE_FACTOR * known.rms_std,
        seconds=constant_time_model(planner.turn_s, planner.step_s).seconds(steps),
        cell_seconds=cell_time(configuration).seconds(steps) if simulated else None,
    )
