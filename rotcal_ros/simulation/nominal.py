"""What the instruments would say without any error: exact observations of a plan."""

from __future__ import annotations

from collections.abc import Callable
from math import dist

import numpy as np

from rotcal_ros.catalogue import Calibration
from rotcal_ros.configuration import Configuration
from rotcal_ros.errors import ConfigurationError
from rotcal_ros.geometry.rotations import rotation_about_z
from rotcal_ros.observations import Observation, PointKind
from rotcal_ros.planning.mirror_plan import MirrorPlanSettings, nominal_mirror, tracker_stands
from rotcal_ros.planning.plan import Plan, Step
from rotcal_ros.simulation.settings import SimulationSettings
from rotcal_ros.simulation.tracker_mirror import FlatMirror, TrackerStation, image

See = Callable[[Step], tuple[float, ...]]


def nominal_observations(calibration: Calibration) -> tuple[Observation, ...]:
    """Return one exact observation for every step of the plan, the table being perfect.

    A laser tracer stands where the simulation of the configuration mounts it; ball centres,
    tracker stations, mirror, nests and reflectors are where the plan expects them.
    """
    see = _instrument(calibration.configuration, calibration.plan)
    return tuple(step.observed(see(step)) for step in calibration.plan.steps)


def _instrument(configuration: Configuration, plan: Plan) -> See:
    """Return what is seen at each step of a plan; a plan has one kind of instrument."""
    kinds = {step.kind for step in plan.steps}
    if kinds == {PointKind.REFLECTOR}:
        return _tracer(configuration)
    if kinds <= {PointKind.SURFACE, PointKind.CENTRE}:
        return lambda step: step.position
    if kinds <= {PointKind.DIRECT, PointKind.MIRRORED, PointKind.NEST}:
        return _tracker(configuration, plan)
    names = ", ".join(sorted(kind.name for kind in kinds))
    raise ConfigurationError(
        f"{configuration.source}: the plan alone does not tell what points of the kinds {names} "
        "look like: give a recorded bag instead of the configuration"
    )


def _tracer(configuration: Configuration) -> See:
    tracer = configuration.group("simulation", SimulationSettings).tracer

    def see(step: Step) -> tuple[float, ...]:
        station = rotation_about_z(step.table_angle) @ np.array(tracer.mount_m)
        return (dist(step.position, station) - tracer.dead_distance_m,)

    return see


def _tracker(configuration: Configuration, plan: Plan) -> See:
    """Every tracker looks along +x; the mirror is flat."""
    settings = configuration.group("plan", MirrorPlanSettings)
    stands = [TrackerStation(s.place) for s in tracker_stands(settings, plan.table_angles)]
    width, height = settings.mirror_size_m
    mirror = FlatMirror(width=width, height=height)

    def see(step: Step) -> tuple[float, ...]:
        stand, place = stands[step.station], np.array(step.position)
        if step.kind is PointKind.MIRRORED:
            pose = nominal_mirror(settings, step.table_angle)
            place = image(mirror, *pose, stand, place, f"step {step.index}")
        return tuple(stand.seen(place).tolist())

    return see
