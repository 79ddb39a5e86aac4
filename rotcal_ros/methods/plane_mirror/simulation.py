"""The simulated laser tracker before a mirror, live and spoiled on purpose.

:class:`SimulatedTracker` is moved by a person and sees nests, reflectors and their images.
:data:`DISTURBANCES` measures a plan again with one thing wrong.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.errors import PlanError
from rotcal_ros.foundation.observations import Command, PointKind, ProbeSample
from rotcal_ros.foundation.units import ARCSEC, DEGREE, MICROMETRE, MILLIMETRE, NANOSECOND
from rotcal_ros.geometry.rotations import rotation_about_z, rotation_from_vector
from rotcal_ros.methods.configuration import Configuration
from rotcal_ros.methods.disturbance import (
    ALL_AXES,
    PPM,
    Disturbance,
    Disturbances,
    DisturbedMeasurement,
    Sizes,
    Streams,
    arrival_errors,
    error_motion,
    random_streams,
    relative_times,
    repeatability,
    scatter_in_plane,
    solver_statement,
    tilt,
)
from rotcal_ros.methods.plane_mirror.mirror_physics import FlatMirror, TrackerStation, on_circle
from rotcal_ros.methods.plane_mirror.plan import nominal_mirror, tracker_stands
from rotcal_ros.methods.plane_mirror.settings import MirrorPlanSettings, MirrorSimulationSettings
from rotcal_ros.methods.plane_mirror.solver.problem import TrackerNoise, noise_of
from rotcal_ros.methods.simulation.instrument import Series, SeriesInstrument, Table
from rotcal_ros.methods.simulation.noise import IndexedNoise, NoiseSource
from rotcal_ros.planning.plan import Plan

_HOUR_S: Final = 3600.0


class SimulatedTracker(SeriesInstrument):
    """A laser tracker and the person who moves it, its nests and its reflectors.

    The person puts everything up a little beside the plan: the tracker at each station, each nest
    once, each reflector whenever it has a new place. A reflector stays between its direct and
    its mirrored point. Where the beam misses the mirror the point is not a number.
    """

    frame = "tracker"

    def __init__(self, cell: MirrorSimulationSettings, table: Table, start_ns: int) -> None:
        super().__init__(start_ns)
        self.settings, self._table = cell.tracker, table
        settings, seed, mirror = cell.tracker, cell.noise_seed, cell.mirror
        turned = mirror.azimuth_deg * DEGREE, mirror.lean_deg * DEGREE
        bent = mirror.sag_um * MICROMETRE, mirror.twist_um * MICROMETRE
        self._mirror = FlatMirror(mirror.centre_m, *turned, *mirror.size_m, *bent)
        along = settings.range_std_um, settings.range_std_um_per_m
        across = settings.transverse_std_um, settings.transverse_std_um_per_m
        self._noise = TrackerNoise(*(MICROMETRE * um for um in (*along, *across)))
        self._point_noise = IndexedNoise(seed, NoiseSource.TRACKER)
        self._stand_noise = IndexedNoise(seed, NoiseSource.STAND)
        self._nest_noise = IndexedNoise(cell.seed, NoiseSource.NEST)
        self._reflector_noise = IndexedNoise(seed, NoiseSource.REFLECTOR)
        self._put_up: Command | None = None
        self._start_ns = start_ns
        self._wrong: dict[tuple[int, int], int] = {}
        self._arrivals = self._points = 0

    def order(self, now_ns: int, command: Command) -> None:
        """Put the reflector where ``command`` says and measure it."""
        if command.kind != PointKind.NEST and not _same_place(self._put_up, command):
            self._put_up = command
            self._arrivals += 1
        super().order(now_ns, command)

    def series(self, _order: Command) -> Series:
        """Return that one point answers an order, measured once the table has come to rest."""
        return Series(1, 0, round(self.settings.measure_time_s / NANOSECOND))

    def station(self, number: int) -> TrackerStation:
        """Return where the person put the tracker for station ``number``, and turned how."""
        settings = self.settings
        azimuth = settings.station_azimuths_deg[number % len(settings.station_azimuths_deg)]
        nominal = on_circle(settings.station_radius_m, azimuth * DEGREE, settings.station_height_m)
        off = settings.station_placing_mm * MILLIMETRE * self._stand_noise.normal(3 * number, 3)
        turned = float(self._stand_noise.uniform(number, 1)[0]) * 2.0 * np.pi
        x, y, z = (np.array(nominal) + off).tolist()
        return TrackerStation((x, y, z), heading=turned)

    def reading(self, stamp_ns: int, command: Command, _number: int) -> ProbeSample:
        """Measure: the true point in the tracker's frame, and its noise."""
        stand = self.station(command.station)
        place = self._place(command, stamp_ns)
        if command.kind == PointKind.MIRRORED:
            place = self._image(stand, place, stamp_ns)
        seen = self._drifted(stand.to_local(place), stamp_ns)
        if not np.all(np.isfinite(seen)):
            return self.point(stamp_ns, command, seen, 0.0)
        covariance = self._noise.covariance(seen)
        normal = self._point_noise.normal(3 * self._points, 3)
        self._points += 1
        measured = seen + np.linalg.cholesky(covariance) @ normal
        return self.point(stamp_ns, command, measured, np.sqrt(np.diag(covariance)))

    def _drifted(self, seen: Floats, stamp_ns: int) -> Floats:
        """Return where the drifting axes of the tracker show a point in its frame."""
        hours = (stamp_ns - self._start_ns) * NANOSECOND / _HOUR_S
        turn = rotation_about_z(self.settings.azimuth_drift_arcsec_per_h * ARCSEC * hours)
        longer = self.settings.range_drift_um_per_h * MICROMETRE * hours
        return np.asarray(turn @ seen * (1.0 + longer / np.linalg.norm(seen)))

    def _place(self, command: Command, stamp_ns: int) -> Floats:
        """Return where the reflector of an order really is, machine frame."""
        nominal, settings = np.array(command.position), self.settings
        if command.kind == PointKind.NEST:
            off = settings.nest_placing_mm * self._nest_noise.normal(3 * command.target, 3)
            return nominal + (off + self._displaced(command)) * MILLIMETRE
        if not settings.reflectors_on_table:
            noise = self._reflector_noise.normal(3 * self._arrivals, 3)
            return nominal + settings.reflector_placing_mm * MILLIMETRE * noise
        off = settings.reflector_placing_mm * self._reflector_noise.normal(3 * command.target, 3)
        carried = rotation_about_z(-command.table_angle) @ nominal + off * MILLIMETRE
        rotation, shift = self._table.poses(np.array([stamp_ns]))
        return np.asarray(rotation[0] @ carried + shift[0])

    def _displaced(self, command: Command) -> Floats:
        """Return by how many millimetres a nest stands, or a reflector sits, wrong."""
        settings = self.settings
        concerned = (
            command.target == settings.displaced_nest != 0
            and command.station in settings.displaced_at_stations
        )
        if not concerned:
            return np.zeros(3)
        attempt = self._wrong.setdefault((command.step, command.attempt), len(self._wrong))
        wrong = attempt < settings.displaced_attempts
        return np.array([0.6, -0.8, 0.0]) * settings.displaced_mm * wrong

    def _image(self, stand: TrackerStation, place: Floats, stamp_ns: int) -> Floats:
        rotation, shift = self._table.poses(np.array([stamp_ns]))
        pose = self._mirror.pose(rotation[0], shift[0])
        try:
            return self._mirror.image(pose, stand, place, "")
        except PlanError:
            return np.full(3, np.nan)


def _same_place(before: Command | None, after: Command) -> bool:
    """Return whether two orders leave a reflector where it is: its image may be the second."""
    return (
        before is not None
        and replace(before, step=after.step, attempt=after.attempt, kind=after.kind) == after
    )


TILT: Final = solver_statement("tilt_std_arcsec", ARCSEC)
LISTED: Final = (
    Disturbance(
        "drift",
        "the tracker's azimuth drifts by so much at every station, linearly while it stands",
        "arcsec", ARCSEC, 0.3, 100.0,
    ),
    Disturbance(
        "uneven drift",
        "the tracker's azimuth swings by so much at every station, one sine while it stands",
        "arcsec", ARCSEC, 0.3, 100.0, stated=solver_statement("uneven_drift_std_arcsec", ARCSEC),
    ),
    Disturbance(
        "one place",
        "half of the reflectors are seen so far aside in the mirror, at one table position",
        "um", MICROMETRE, 3.0, 1000.0,
    ),
    Disturbance(
        "knock",
        "the mirror is turned on the table, about x, y and z alike, half-way through the run",
        "arcsec", ARCSEC, 0.3, 100.0,
    ),
    Disturbance(
        "axis noise",
        "the tracker's errors across the beam are so many times the stated ones",
        "times", 1.0, 1.2, 100.0, scatters=True,
    ),
    error_motion(1.0, 100.0),
    repeatability(0.3, 100.0),
    Disturbance(
        "refraction",
        "the index of the air changes sideways through the room by so much per metre",
        "ppm/m", PPM, 0.3, 100.0,
    ),
    Disturbance(
        "scale", "the tracker's distances are too long by so much", "ppm", PPM, 1.0, 1000.0
    ),
    tilt(0.1, 100.0, TILT),
    Disturbance(
        "gauge",
        "the table's axis leans by so much against the vertical",
        "arcsec", ARCSEC, 100.0, 3600.0,
    ),
)  # fmt: skip


def measure(
    configuration: Configuration, plan: Plan, sizes: Sizes, seed: int
) -> DisturbedMeasurement:
    """Return what the tracker sees with the stated noise and the effects of ``sizes``.

    The table has no ECC; the true ECC are zero.
    """
    noise, other = random_streams(seed)
    stations = [TrackerStation(stand.place) for stand in tracker_stands(configuration.plan)]
    station = np.array([step.station for step in plan.steps])
    head = np.array([stations[s].place for s in station.tolist()])
    seen = _places(configuration, plan, stations, sizes, (noise, other)) - head
    seen = _bent(seen, sizes) * (1.0 + sizes.get("scale", 0.0))
    since = _since_put_up(station)
    azimuth = sizes.get("drift", 0.0) * since
    azimuth = azimuth + sizes.get("uneven drift", 0.0) * np.sin(2.0 * np.pi * since)
    seen = np.einsum("nij,nj->ni", rotation_about_z(azimuth), seen)
    seen = seen + sizes.get("one place", 0.0) * _aside(configuration.plan, plan, seen)
    seen = seen + _noise(configuration, seen, sizes, noise)
    observations = tuple(
        step.observed((x, y, z)) for step, (x, y, z) in zip(plan.steps, seen.tolist(), strict=True)
    )
    return DisturbedMeasurement(observations, {"ECC": np.zeros(len(plan.distinct_angles))})


def _places(
    configuration: Configuration,
    plan: Plan,
    stations: list[TrackerStation],
    sizes: Sizes,
    streams: Streams,
) -> Floats:
    """Return where the points or their images are at every step (n, 3), m, in the room."""
    noise, other = streams
    settings: MirrorPlanSettings = configuration.plan
    solver, mirror = configuration.solver, nominal_mirror(settings)
    rotation, shift = _table(configuration, plan, sizes, (noise, other))
    slope = solver.mirror_slope_std_arcsec * ARCSEC * noise.standard_normal((len(plan.steps), 3))
    knock = rotation_from_vector(sizes.get("knock", 0.0) * ALL_AXES)
    after = relative_times(plan) >= 0.5
    places = np.array([step.position for step in plan.steps])
    for k, step in enumerate(plan.steps):
        carried = rotation[k] @ knock if after[k] else rotation[k]
        if step.kind is PointKind.MIRRORED:
            centre, frame = mirror.pose(carried, shift[k])
            pose = centre, rotation_from_vector(slope[k]) @ frame
            places[k] = mirror.image(pose, stations[step.station], places[k], f"step {k}")
        elif step.kind is PointKind.DIRECT and settings.carries != "mirror":
            nominal = rotation_about_z(step.table_angle)
            places[k] = carried @ nominal.T @ places[k] + shift[k]
    return places


def _table(
    configuration: Configuration, plan: Plan, sizes: Sizes, streams: Streams
) -> tuple[Floats, Floats]:
    """Return rotation (n, 3, 3) and shift (n, 3) of the table at every step."""
    noise, other = streams
    m = len(plan.table_angles)
    position = np.array([step.table_position for step in plan.steps])
    arrived = arrival_errors(plan, sizes, other)
    angle = np.array([step.table_angle for step in plan.steps]) + arrived
    lean = scatter_in_plane(m, TILT(configuration), noise)
    lean += scatter_in_plane(m, sizes.get("tilt", 0.0), other)
    shift = scatter_in_plane(m, sizes.get("error motion", 0.0), other)
    axis = rotation_from_vector(np.array([sizes.get("gauge", 0.0), 0.0, 0.0]))
    turned = axis @ rotation_from_vector(lean)[position] @ rotation_about_z(angle)
    return np.asarray(turned, dtype=np.float64), shift[position]


def _bent(seen: Floats, sizes: Sizes) -> Floats:
    """Return the points (n, 3) where they seem to be through air whose index grows along x."""
    distance = np.linalg.norm(seen, axis=1)[:, None]
    beam = seen / distance
    gradient = np.array([sizes.get("refraction", 0.0), 0.0, 0.0])
    across = gradient - (beam @ gradient)[:, None] * beam
    return np.asarray(seen + 0.5 * distance**2 * across, dtype=np.float64)


def _aside(settings: MirrorPlanSettings, plan: Plan, seen: Floats) -> Floats:
    """Return the direction (n, 3) level across the beam of half the images at one position.

    It is the position in the middle of the plan; other points have none.
    """
    middle = len(plan.table_angles) // 2
    wrong = [
        step.kind is PointKind.MIRRORED
        and step.table_position == middle
        and 2 * step.target <= max(settings.reflectors, 2)
        for step in plan.steps
    ]
    level = np.cross([0.0, 0.0, 1.0], seen)
    level = level / np.linalg.norm(level, axis=1)[:, None]
    return np.where(np.array(wrong)[:, None], level, 0.0)


def _since_put_up(station: Floats) -> Floats:
    """Return the time (n,) since the tracker was put up at its station, 0 to 1."""
    time = np.zeros(len(station))
    for s in np.unique(station):
        rows = np.flatnonzero(station == s)
        time[rows] = np.linspace(0.0, 1.0, len(rows))
    return time


def _noise(
    configuration: Configuration, seen: Floats, sizes: Sizes, noise: np.random.Generator
) -> Floats:
    """Return errors (n, 3) of the tracker at points (n, 3) in its frame, m."""
    factor = np.linalg.cholesky(noise_of(configuration.solver).covariance(seen))
    error = np.einsum("nij,nj->ni", factor, noise.standard_normal(seen.shape))
    beam = seen / np.linalg.norm(seen, axis=1)[:, None]
    along = np.einsum("ni,ni->n", error, beam)[:, None] * beam
    return np.asarray(along + sizes.get("axis noise", 1.0) * (error - along), dtype=np.float64)


DISTURBANCES: Final = Disturbances(LISTED, measure)
