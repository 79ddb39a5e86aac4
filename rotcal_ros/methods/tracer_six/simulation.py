"""The simulated tracer that a person fixes at one place of the table after the other.

:data:`DISTURBANCES` measures a plan again with one thing wrong.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.observations import Command
from rotcal_ros.foundation.units import MICROMETRE, MILLIMETRE
from rotcal_ros.geometry.rotations import rotation_about_z, rotation_from_vector
from rotcal_ros.methods.configuration import Configuration
from rotcal_ros.methods.disturbance import (
    ALL_AXES,
    Disturbances,
    DisturbedMeasurement,
    Sizes,
    angle_numbers,
    arrival_numbers,
    error_motion,
    random_streams,
    repeatability,
    table_deviations,
    tilt,
)
from rotcal_ros.methods.simulation.air import SimulatedTemperature
from rotcal_ros.methods.simulation.instrument import Table
from rotcal_ros.methods.simulation.noise import IndexedNoise, NoiseSource
from rotcal_ros.methods.tracer.simulation import (
    TANGENTIAL,
    TracerAndReflector,
    leaning_axis,
    length_disturbances,
    observe_plan,
    steps_of,
    tangential_shift,
)
from rotcal_ros.methods.tracer_six.plan import places_of
from rotcal_ros.methods.tracer_six.settings import SixSimulationSettings
from rotcal_ros.planning.plan import Plan
from rotcal_ros.planning.points import parse_points

_MOST: Final = 1000
"""Places; the mountings at each have random numbers of their own."""


LISTED: Final = (
    *length_disturbances(0.3, 0.1, 0.3),
    error_motion(0.1, 10.0),
    repeatability(0.05, 10.0),
    tilt(0.1, 10.0),
    leaning_axis(2000.0),
    TANGENTIAL,
)


class CarriedTracer(TracerAndReflector):
    """The tracer stands where the order's station says, missed by a little at each mounting.

    An order for another place, or for a step that was left behind already, comes after a new
    mounting: the person has fixed the tracer anew, and its zero is another one. Turns are made
    again without one.
    """

    def __init__(
        self,
        settings: SixSimulationSettings,
        table: Table,
        temperature: SimulatedTemperature,
        start_ns: int,
    ) -> None:
        self.tracer_settings = settings.tracer
        self._places = parse_points(settings.tracer.places_m, "simulation.tracer.places_m")
        super().__init__(settings, self._places[0], table, temperature, start_ns)
        self._placing = IndexedNoise(settings.noise_seed, NoiseSource.MOUNTING)
        self._mounted_zero = IndexedNoise(settings.noise_seed, NoiseSource.MOUNTED_ZERO)
        self._mountings: dict[int, int] = {}
        self._place, self._step = -1, -1
        self._done: set[int] = set()
        self._turns = False

    def order(self, now_ns: int, command: Command) -> None:
        """Go to the position of ``command``, the tracer being at the place of its station."""
        self._turns = self._turns or command.turn is not None
        again = command.step in self._done and command.step != self._step
        left_behind = again and not self._turns
        if command.station != self._place or left_behind:
            self._fix(command.station)
        self._step = command.step
        self._done.add(command.step)
        super().order(now_ns, command)

    def _fix(self, place: int) -> None:
        """Fix the tracer at ``place``, with the errors of this mounting."""
        if place >= len(self._places):
            raise ConfigurationError(
                f"simulation.tracer.places_m has {len(self._places)} places, the plan needs "
                f"place {place}: list as many as the plan has"
            )
        count = self._mountings.get(place, 0)
        self._mountings[place] = count + 1
        self._place = place
        self._done.clear()
        number, settings = place + _MOST * count, self.tracer_settings
        off: Floats = settings.placing_mm * self._placing.normal(3 * number, 3)
        if place == settings.misplaced_place and count == 0:
            off = off + np.array([settings.misplaced_mm, 0.0, 0.0])
        self._mount = np.array(self._places[place]) + off * MILLIMETRE
        zero = float(self._mounted_zero.normal(number, 1)[0])
        self._zero_m = settings.mounting_zero_um * MICROMETRE * zero


def measure(
    configuration: Configuration, plan: Plan, sizes: Sizes, seed: int
) -> DisturbedMeasurement:
    """Return what a tracer reads at its places, with the stated noise and effects of ``sizes``.

    The table has no deviations but those that ``sizes`` give it, which are true ones.
    """
    noise, other = random_streams(seed)
    true = table_deviations(len(plan.distinct_angles), sizes, other)
    stations = _stations(configuration, plan, sizes, true, other)
    observations = observe_plan(configuration, plan, stations, sizes, (noise, other))
    return DisturbedMeasurement(observations, true)


def _stations(
    configuration: Configuration,
    plan: Plan,
    sizes: Sizes,
    true: dict[str, Floats],
    other: np.random.Generator,
) -> Floats:
    """Return where the tracer is at every step (n, 3), m, from the axis."""
    steps = steps_of(plan)
    mount = np.array(places_of(configuration.plan))[steps.place]
    mount = mount + sizes.get("knock", 0.0) * np.outer(steps.time >= 0.5, ALL_AXES)
    turn = rotation_about_z(np.array(plan.table_angles)[steps.position])
    turned = np.einsum("nij,nj->ni", turn, mount)
    angle = angle_numbers(plan)[steps.position]
    rotation = np.column_stack([true["EAC"], true["EBC"], true["ECC"]])[angle]
    scatter = other.standard_normal((len(plan.steps), 3))[arrival_numbers(plan)]
    rotation = rotation + sizes.get("repeatability", 0.0) * scatter
    moved = np.einsum("nij,nj->ni", rotation_from_vector(rotation), turned)
    shift = np.column_stack([true["EXC"], true["EYC"], true["EZC"]])[angle]
    along = tangential_shift(turned, np.array(plan.table_angles)[steps.position], sizes)
    return np.asarray(moved + shift + along, dtype=np.float64)


DISTURBANCES: Final = Disturbances(LISTED, measure)
