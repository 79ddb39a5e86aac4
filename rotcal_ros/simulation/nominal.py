"""What the instruments would say without any error: exact observations of a plan."""

from __future__ import annotations

from math import dist

import numpy as np

from rotcal_ros.catalogue import Calibration
from rotcal_ros.errors import ConfigurationError
from rotcal_ros.geometry.rotations import rotation_about_z
from rotcal_ros.observations import Observation, PointKind
from rotcal_ros.planning.plan import Step
from rotcal_ros.simulation.settings import SimulationSettings


def nominal_observations(calibration: Calibration) -> tuple[Observation, ...]:
    """Return one exact observation for every step of the plan, the table being perfect.

    The tracer stands where the simulation of the configuration mounts it; ball centres are where
    the plan expects them. Raises ConfigurationError for points whose place the plan does not tell.
    """
    settings = calibration.configuration.group("simulation", SimulationSettings)
    return tuple(_observe(step, settings) for step in calibration.plan.steps)


def _observe(step: Step, settings: SimulationSettings) -> Observation:
    mean: tuple[float, ...]
    if step.kind is PointKind.REFLECTOR:
        mount = np.array(settings.tracer.mount_m)
        station = rotation_about_z(step.table_angle) @ mount
        mean = (dist(step.position, station) - settings.tracer.dead_distance_m,)
    elif step.kind is PointKind.CENTRE:
        mean = step.position
    else:
        raise ConfigurationError(
            f"step {step.index} measures a point of kind {step.kind.name}, which the plan alone "
            "does not tell: give a recorded bag instead of the configuration"
        )
    zeros = (0.0,) * len(mean)
    return Observation(
        step=step.index,
        attempt=0,
        table_index=step.table_index,
        table_angle=step.table_angle,
        target=step.target,
        station=step.station,
        kind=step.kind,
        mean=mean,
        std=zeros,
        scatter=zeros,
        probe_position=step.position,
        n_samples=1,
        n_used=1,
        accepted=True,
        reason="",
        table_angle_measured=step.table_angle,
        temperature_c=None,
        window_start_ns=0,
        window_end_ns=0,
    )
