"""The simulated machine that touches the balls of a plate, live and spoiled on purpose.

:class:`SimulatedTouchProbe` touches balls on the table, one point after the other.
:data:`DISTURBANCES` measures a plan again with one thing wrong.
"""

from __future__ import annotations

from math import dist
from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Floats, Ints, Stamps
from rotcal_ros.foundation.observations import Command, PointKind, ProbeSample
from rotcal_ros.foundation.units import ARCSEC, DEGREE, MICROMETRE, NANOSECOND
from rotcal_ros.geometry.rotations import rotation_about_z, rotation_from_vector
from rotcal_ros.methods.ball_plate.settings import (
    PlateSimulationSettings,
    SimulatedPlateSettings,
    TouchProbeSettings,
)
from rotcal_ros.methods.configuration import Configuration
from rotcal_ros.methods.disturbance import (
    ALL_AXES,
    PPM,
    Disturbance,
    Disturbances,
    DisturbedMeasurement,
    Sizes,
    Streams,
    angle_numbers,
    arrival_errors,
    error_motion,
    random_streams,
    relative_times,
    repeatability,
    table_deviations,
    tilt,
)
from rotcal_ros.methods.simulation.air import SimulatedTemperature
from rotcal_ros.methods.simulation.instrument import Series, SeriesInstrument, Table
from rotcal_ros.methods.simulation.motion import Motion, MotionLimits
from rotcal_ros.methods.simulation.noise import IndexedNoise, NoiseSource
from rotcal_ros.methods.simulation.settings import SimulationSettings
from rotcal_ros.methods.simulation.table import rotations
from rotcal_ros.planning.plan import Plan

_PLAY_M = 1e-4
"""How much too near to a ball a path may come: the driver does not know its true place."""
_WAVES = 12
"""Plane waves that the machine's error is made of."""


def upper_half(count: int) -> Floats:
    """Return directions (count, 3) that cover the upper half of a ball evenly."""
    height = (np.arange(count) + 0.5) / count
    around = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(count)
    flat = np.sqrt(1.0 - height**2)
    return np.asarray(np.column_stack([flat * np.cos(around), flat * np.sin(around), height]))


def plate_balls(settings: SimulatedPlateSettings, seed: int) -> Floats:
    """Return the true ball centres (R, 3) in the table frame at angle 0, m."""
    steps = np.array(settings.ball_steps)
    angle = settings.azimuth_deg * DEGREE + 2.0 * np.pi * steps / settings.grid
    places = settings.circle_radius_m * np.column_stack(
        [np.cos(angle), np.sin(angle), np.zeros_like(angle)]
    )
    noise = IndexedNoise(seed, NoiseSource.BALL)
    errors = np.array([noise.normal(3 * int(step), 3) for step in steps])
    turn = np.array(settings.clamping_turn_arcsec)[:, None] * ARCSEC
    clamped = (places + settings.manufacture_um * MICROMETRE * errors) @ rotations(*turn)[0].T
    return np.asarray(clamped + np.array(settings.clamping_shift_um) * MICROMETRE)


class MachineError:
    """The systematic error of the machine: scales, squareness and a smooth field beside them."""

    def __init__(self, settings: TouchProbeSettings, seed: int) -> None:
        noise = IndexedNoise(seed, NoiseSource.MACHINE)
        count = 3 * _WAVES
        self._waves = noise.normal(0, 3 * count).reshape(count, 3) / settings.wavelength_m
        self._phases = 2.0 * np.pi * noise.uniform(0, count)
        self._size = settings.systematic_um * MICROMETRE * np.sqrt(2.0 / _WAVES)
        self._linear = np.diag(settings.scale_um_per_m) * MICROMETRE
        self._linear[np.triu_indices(3, 1)] = np.array(settings.squareness_um_per_m) * MICROMETRE

    def __call__(self, places: Floats) -> Floats:
        """Return reported - true place (n, 3) at ``places`` (n, 3), m."""
        waves = np.cos(places @ self._waves.T + self._phases)
        field = self._size * waves.reshape(len(places), 3, _WAVES).sum(axis=2)
        return np.asarray(field + places @ self._linear.T)


class SimulatedTouchProbe(SeriesInstrument):
    """A probe that travels to the ball at the ordered place and touches its upper half.

    It touches whatever ball is nearest to the order, once table and probe are at rest. Touch k
    of the whole run depends on k and on the table, never on how time was cut. ``balls`` (R, 3):
    their centres in the table frame at angle 0, m.
    """

    def __init__(
        self,
        cell: SimulationSettings,
        settings: TouchProbeSettings,
        balls: Floats,
        ball_diameter_m: float,
        table: Table,
        start_ns: int,
    ) -> None:
        super().__init__(start_ns)
        self.settings = settings
        self._table, self._balls = table, balls
        self._reach = 0.5 * ball_diameter_m + settings.tip_radius_m
        self._limits = MotionLimits(settings.speed_m_s, settings.acceleration_m_s2, 0.0, 1.0)
        self._error = MachineError(settings, cell.seed)
        self._noise = IndexedNoise(cell.noise_seed, NoiseSource.TOUCH)
        self._dirt = IndexedNoise(cell.noise_seed, NoiseSource.DIRT)
        self._from = self._place = settings.initial_position_m
        self._lift = 0.0
        self._motion = Motion(start_ns, [0.0], self._limits)
        self._touches = 0

    def order(self, now_ns: int, command: Command) -> None:
        """Go to the ball at the position of ``command`` and touch it."""
        super().order(now_ns, command)
        way, height = dist(self._place, command.position), self.settings.clearance_m
        self._lift = height
        lifted = [-height, 0.0, way, way + height] if way else [0.0]
        self._motion = Motion(now_ns, lifted, self._limits)
        self.rest_ns = max(now_ns, self._motion.end_ns)
        self._from, self._place = self._place, command.position

    def go(self, now_ns: int, place: Floats) -> bool:
        """Move in a straight line to ``place`` (3,), m; False: a ball stands in the way."""
        x, y, z = place.tolist()
        start = self.positions(np.array([now_ns]))[0]
        line = place - start
        length = float(np.linalg.norm(line))
        if length:
            to_balls = self._standing_balls(now_ns) - start
            along = np.clip(to_balls @ line / length**2, 0.0, 1.0)
            nearest = np.linalg.norm(to_balls - np.multiply.outer(along, line), axis=1)
            if nearest.min() < self._reach - _PLAY_M:
                return False
        self._from, self._place, self._lift = tuple(start.tolist()), (x, y, z), 0.0
        self._motion = Motion(now_ns, [0.0, length] if length else [0.0], self._limits)
        self.rest_ns = max(now_ns, self._motion.end_ns)
        return True

    def touched(
        self, stamp_ns: int, surface: Floats, direction: Floats, search: tuple[float, float]
    ) -> Floats | None:
        """Return where the machine believes the tip's centre is when it meets a ball."""
        self._touches += 1
        start = surface + self.settings.tip_radius_m * direction
        to_start = start - self._nearest_ball(stamp_ns, surface)
        middle = float(to_start @ direction)
        inside = middle**2 - float(to_start @ to_start) + (self._reach + self._dirt_now()) ** 2
        way = -middle + np.sqrt(max(inside, 0.0))
        if inside < 0.0 or not -search[1] <= way <= search[0]:
            return None
        return self._believed(start + way * direction)

    def positions(self, stamps: Stamps) -> Floats:
        """Return the nominal positions (n, 3) of the tip, m: up, across and down again."""
        start, stop = np.array(self._from), np.array(self._place)
        length, height = dist(self._from, self._place), self._lift
        if not length:
            return np.tile(stop, (len(stamps), 1))
        way = self._motion.state(stamps)[0]
        share = np.clip(way / length, 0.0, 1.0)
        positions: Floats = start + np.multiply.outer(share, stop - start)
        positions[:, 2] += height - np.maximum(0.0, np.maximum(-way, way - length))
        return positions

    def series(self, order: Command) -> Series:
        """Return the touches of a ball, or the one point that the machine makes of it."""
        count = self.settings.points_per_ball if order.kind == PointKind.SURFACE else 1
        settling_s, touch_s = self.settings.settling_time_s, self.settings.touch_time_s
        return Series(count, round(settling_s / NANOSECOND), round(touch_s / NANOSECOND))

    def reading(self, stamp_ns: int, order: Command, number: int) -> ProbeSample:
        """Return a touch point, the centre that the machine computes, or how far off it is."""
        self._touches += 1
        place = self._nearest_ball(stamp_ns, np.array(order.position))
        tip = 0.0
        if order.kind == PointKind.SURFACE:
            away = upper_half(self.settings.points_per_ball)[number]
            lobes = (
                self.settings.lobing_um * MICROMETRE * np.cos(3.0 * np.arctan2(away[1], away[0]))
            )
            place = place + (self._reach + self._dirt_now() + lobes) * away
            tip = self.settings.tip_radius_m
        place = self._believed(place)
        if order.kind == PointKind.READING:  # a nest that stands where it was sent
            place = place - np.array(order.position)
        std = self.settings.noise_um * MICROMETRE
        return self.point(stamp_ns, order, place, std, number, tip)

    def _standing_balls(self, stamp_ns: int) -> Floats:
        rotation, translation = self._table.poses(np.array([stamp_ns]))
        return np.asarray(self._balls @ rotation[0].T + translation[0])

    def _nearest_ball(self, stamp_ns: int, place: Floats) -> Floats:
        balls = self._standing_balls(stamp_ns)
        return np.asarray(balls[int(np.argmin(np.linalg.norm(balls - place, axis=1)))])

    def _dirt_now(self) -> float:
        dirty = self._dirt.uniform(self._touches, 1)[0] < self.settings.dirt_probability
        return float(dirty * self.settings.dirt_um * MICROMETRE)

    def _believed(self, place: Floats) -> Floats:
        """Return where the machine believes to be with the tip at ``place`` (3,), m."""
        noise = self.settings.noise_um * MICROMETRE * self._noise.normal(3 * self._touches, 3)
        return np.asarray(place + self._error(place[None])[0] + noise)


USUAL_STD: Final = 5e-8
"""Standard deviation (m) of a centre along each axis where the configuration states none."""
PLATE_STD: Final = 5e-6
MACHINE_STD: Final = 5e-7
"""How far (m) balls are from their places, and the machine's systematic error; both are solved."""
OFF_CENTRE: Final = 0.5
"""Metres that the plate stands off centre per radian that the axis leans."""

LISTED: Final = (
    Disturbance(
        "drift",
        "the origin of the machine drifts along x, y and z alike, linearly over the whole run",
        "um", MICROMETRE, 0.05, 100.0,
    ),
    Disturbance(
        "knock",
        "half-way through the run the plate is shifted by so much, along x, y and z alike, and "
        "turned by as much at its circle",
        "um", MICROMETRE, 0.05, 100.0,
    ),
    Disturbance(
        "axis noise",
        "the centres scatter along z so many times as much as along x and y",
        "times", 1.0, 1.5, 100.0, scatters=True,
    ),
    error_motion(0.1, 10.0),
    repeatability(0.02, 10.0),
    Disturbance(
        "refraction", "there is no beam: nothing happens", "ppm/m", PPM, 1000.0, 1000.0
    ),
    Disturbance(
        "scale", "the machine's x scale is too long by so much", "ppm", PPM, 1.0, 100.0
    ),
    tilt(0.1, 10.0),
    Disturbance(
        "gauge",
        "the axis leans by so much against the machine's z axis, and the plate is off centre by "
        "2.4 um for each arcsec",
        "arcsec", ARCSEC, 10.0, 2000.0,
    ),
    Disturbance(
        "growth",
        "the plate warms and grows from its centre by so much, linearly over the whole run",
        "um/m", PPM, 0.1, 100.0,
    ),
    Disturbance(
        "one place",
        "at one table position a quarter of the balls, neighbours, are displaced by so much "
        "together, along x, y and z alike",
        "um", MICROMETRE, 0.05, 10.0,
    ),
)  # fmt: skip


def measure(
    configuration: Configuration, plan: Plan, sizes: Sizes, seed: int
) -> DisturbedMeasurement:
    """Return the ball centres that a machine finds, with noise and the effects of ``sizes``.

    The table has no deviations but those that ``sizes`` give it, which are true ones.
    """
    noise, other = random_streams(seed)
    true = table_deviations(len(plan.distinct_angles), sizes, other)
    position = angle_numbers(plan)[[step.table_position for step in plan.steps]]
    place = np.array([step.position for step in plan.steps])
    centres = _true_centres(configuration, plan, position, sizes, true, (noise, other))
    # the machine's systematic error, the same whenever it is at a place
    which = np.unique(np.round(place, 6), axis=0, return_inverse=True)[1].ravel()
    machine = MACHINE_STD * noise.standard_normal((int(which.max()) + 1, 3))
    centres = centres + np.array(configuration.plan.centre_m) + machine[which]
    centres[:, 0] *= 1.0 + sizes.get("scale", 0.0)
    centres += sizes.get("drift", 0.0) * np.outer(relative_times(plan), ALL_AXES)
    # a quarter of the balls, neighbours, at a middle position
    ball, at = np.array([(step.target, step.table_position) for step in plan.steps]).T
    balls = np.unique(ball)
    spoiled = np.isin(ball, balls[: max(len(balls) // 4, 2)]) & (at == len(plan.table_angles) // 3)
    centres += sizes.get("one place", 0.0) * np.outer(spoiled, ALL_AXES)
    std = np.broadcast_to(configuration.solver.sigma_centre_m or USUAL_STD, 3).copy()
    std[2] *= sizes.get("axis noise", 1.0)
    centres += std * noise.standard_normal(centres.shape)
    observations = tuple(
        step.observed((x, y, z))
        for step, (x, y, z) in zip(plan.steps, centres.tolist(), strict=True)
    )
    return DisturbedMeasurement(observations, true)


def _true_centres(
    configuration: Configuration,
    plan: Plan,
    position: Ints,
    sizes: Sizes,
    true: dict[str, Floats],
    streams: Streams,
) -> Floats:
    """Return where the balls are at every step (n, 3), m, from the axis."""
    noise, other = streams
    settings = configuration.plan
    off = sizes.get("gauge", 0.0)
    plate = settings.plate.places + PLATE_STD * noise.standard_normal((settings.plate.grid, 3))
    plate = plate + OFF_CENTRE * off * np.array([1.0, 0.0, 0.0])
    balls = plate[[step.target for step in plan.steps]]
    balls = balls * (1.0 + sizes.get("growth", 0.0) * relative_times(plan))[:, None]
    knock = sizes.get("knock", 0.0) * ALL_AXES
    after = relative_times(plan) >= 0.5
    turned = balls @ rotation_from_vector(knock / settings.plate.circle_radius_m).T + knock
    balls = np.where(after[:, None], turned, balls)
    angle = np.array([step.table_angle for step in plan.steps]) - settings.table_start_deg * DEGREE
    angle = angle + arrival_errors(plan, sizes, other)
    balls = np.einsum("nij,nj->ni", rotation_about_z(angle), balls)
    lean = np.column_stack([true["EAC"], true["EBC"], true["ECC"]])[position]
    balls = np.einsum("nij,nj->ni", rotation_from_vector(lean), balls)
    balls = balls + np.column_stack([true["EXC"], true["EYC"], true["EZC"]])[position]
    return np.asarray(balls @ rotation_from_vector(np.array([off, 0.0, 0.0])).T)


def touch_probe(
    settings: PlateSimulationSettings,
    table: Table,
    _temperature: SimulatedTemperature,
    start_ns: int,
) -> SimulatedTouchProbe:
    """Return the machine that touches the plate on ``table``."""
    balls = plate_balls(settings.plate, settings.seed)
    diameter_m = settings.plate.ball_diameter_m
    return SimulatedTouchProbe(settings, settings.touch_probe, balls, diameter_m, table, start_ns)


DISTURBANCES: Final = Disturbances(LISTED, measure)
