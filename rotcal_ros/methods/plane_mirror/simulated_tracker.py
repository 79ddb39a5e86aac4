"""The simulated laser tracker: moved by a person, it sees nests, reflectors and their images."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.errors import PlanError
from rotcal_ros.foundation.observations import Command, PointKind, ProbeSample
from rotcal_ros.foundation.units import ARCSEC, DEGREE, MICROMETRE, MILLIMETRE, NANOSECOND
from rotcal_ros.geometry.rotations import rotation_about_z
from rotcal_ros.methods.plane_mirror.mirror_physics import FlatMirror, TrackerStation, on_circle
from rotcal_ros.methods.plane_mirror.settings import (
    MirrorSimulationSettings,
    SimulatedMirrorSettings,
)
from rotcal_ros.methods.plane_mirror.solver.problem import TrackerNoise
from rotcal_ros.methods.simulation.instrument import Series, SeriesInstrument, Table
from rotcal_ros.methods.simulation.noise import IndexedNoise, NoiseSource

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
        settings, seed = cell.tracker, cell.noise_seed
        self._mirror = _flat_mirror(cell.mirror)
        self._noise = TrackerNoise(
            range_std=settings.range_std_um * MICROMETRE,
            range_std_per_metre=settings.range_std_um_per_m * MICROMETRE,
            transverse_std=settings.transverse_std_um * MICROMETRE,
            transverse_std_per_metre=settings.transverse_std_um_per_m * MICROMETRE,
        )
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
        seen = self._drifted(stand.seen(place), stamp_ns)
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
        drifted: Floats = turn @ seen * (1.0 + longer / np.linalg.norm(seen))
        return drifted

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
        place: Floats = rotation[0] @ carried + shift[0]
        return place

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
        """Return the image of a reflector in the mirror as the table holds it at ``stamp_ns``."""
        rotation, shift = self._table.poses(np.array([stamp_ns]))
        pose = self._mirror.pose(rotation[0], shift[0])
        try:
            return self._mirror.image(pose, stand, place, "")
        except PlanError:
            return np.full(3, np.nan)


def _flat_mirror(settings: SimulatedMirrorSettings) -> FlatMirror:
    width, height = settings.size_m
    return FlatMirror(
        centre=settings.centre_m,
        azimuth=settings.azimuth_deg * DEGREE,
        lean=settings.lean_deg * DEGREE,
        width=width,
        height=height,
        sag=settings.sag_um * MICROMETRE,
        twist=settings.twist_um * MICROMETRE,
    )


def _same_place(before: Command | None, after: Command) -> bool:
    """Return whether two orders leave a reflector where it is: its image may be the second."""
    return (
        before is not None
        and replace(before, step=after.step, attempt=after.attempt, kind=after.kind) == after
    )
