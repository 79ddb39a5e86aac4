"""The order in which a designed plan is measured, and the time it takes."""

from __future__ import annotations

from rotcal_ros.planning.sequence_choice import MeasuringOrder, measuring_orders
from rotcal_ros.planning.sequence_time import AT_ONCE, Drive, TimeModel
from rotcal_ros.planning.tracer_design.design import TracerDesign


def time_model(design: TracerDesign) -> TimeModel:
    """Return the time model that the settings of the design describe."""
    settings = design.settings
    return TimeModel(
        table=Drive(AT_ONCE, AT_ONCE, settle=settings.rotation_s),
        machine=Drive(settings.machine_speed_m_s, settings.machine_acceleration_m_s2),
        dwell=settings.length_s,
    )


def quickest_order(design: TracerDesign) -> MeasuringOrder:
    """Return the quickest order of the lengths; what drift would do in it is not asked.

    Raises PlanError when a pair is measured more than once.
    """
    position, target = design.lengths.position, design.lengths.target
    scene = design.scene
    costs = time_model(design).costs(scene.table_angles, scene.targets, position, target)
    return min(
        measuring_orders(position, target, costs, seed=design.settings.seed, most_sweeps=1),
        key=lambda way: way.seconds,
    )
