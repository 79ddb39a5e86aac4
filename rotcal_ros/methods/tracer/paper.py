"""The paper's plan on the table and with the noise of another one: what it would take and give."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from rotcal_ros.foundation.components import COVERAGE_FACTOR
from rotcal_ros.foundation.units import DEGREE
from rotcal_ros.methods.configuration import Configuration
from rotcal_ros.methods.tracer.goal_policy import length_experiment
from rotcal_ros.methods.tracer.plan import tracer_plan
from rotcal_ros.methods.tracer.policy.information import Information
from rotcal_ros.methods.tracer.policy.scene import Lengths, Scene
from rotcal_ros.methods.tracer.settings import STATIONS_PER_TARGET, TracerPlanSettings
from rotcal_ros.methods.tracer.timing import cell_time, plan_seconds
from rotcal_ros.planning.plan import Compared, Plan, PlanFigures, Step
from rotcal_ros.planning.sequence_time import stated_time

ABOVE_TRACER: Final = 1.3025
"""Height (m) of the block's centre over the tracer: its first target is 1.13 m away."""


def compare(
    configuration: Configuration, plan: Plan, steps: Sequence[int], lost: Collection[int]
) -> Compared:
    """Return the figures of ``steps`` of ``plan`` and of the paper's plan at the same angles.

    Steps that gave no length (``lost``) take time and tell nothing.

    Both with the planned noise of a length (``planner.expected_std_m``), and with the times that
    the policy reckons with. Raises ConfigurationError where the tracer's place is not known.
    """
    scene = length_experiment(configuration, plan).scene
    papers = papers_plan(plan.table_angles, float(scene.stations[0, 2]))
    targets = np.array(papers.targets)
    elsewhere = replace(scene, targets=targets, target_std=scene.target_std[0])
    chosen = [plan.steps[step] for step in steps]
    return Compared(
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
        seconds=plan_seconds(stated_time(planner.turn_s, planner.step_s), steps),
        cell_seconds=plan_seconds(cell_time(configuration), steps) if simulated else None,
    )
