"""The simulated polygon and autocollimator, and their settings: group ``simulation``."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.observations import Command, ProbeSample
from rotcal_ros.foundation.settings import group, setting
from rotcal_ros.foundation.units import ARCSEC, NANOSECOND
from rotcal_ros.methods.simulation.air import SimulatedTemperature
from rotcal_ros.methods.simulation.instrument import Series, SeriesInstrument, Table
from rotcal_ros.methods.simulation.noise import IndexedNoise
from rotcal_ros.methods.simulation.settings import SimulationSettings

FACES, MOUNTING, READING = 1001, 1002, 1003
"""Streams of random numbers; those below 1000 belong to rotcal_ros."""


@dataclass(frozen=True)
class SimulatedPolygonSettings:
    """The polygon as it really is, and how the person really mounts it."""

    faces: int = setting(12, doc="number of faces", minimum=3, maximum=144)
    first_faces: tuple[int, ...] = setting(
        (0, 1, 5), doc="face really before the autocollimator at table angle 0, by mounting",
        minimum=0,
    )  # fmt: skip
    face_arcsec: float = setting(2.0, doc="arcsec, standard deviation of face errors", minimum=0.0)
    mounting_arcsec: float = setting(
        10.0, doc="arcsec, standard deviation with which the person aligns a face", minimum=0.0
    )


@dataclass(frozen=True)
class AutocollimatorSettings:
    """The autocollimator: at rest beside the table, looking along -x."""

    noise_arcsec: float = setting(0.03, doc="arcsec, noise of one reading", minimum=0.0)
    range_arcsec: float = setting(300.0, doc="arcsec, largest reading", minimum=1.0)
    settling_time_s: float = setting(1.0, doc="s, from table at rest to reading", minimum=0.0)
    reading_time_s: float = setting(0.2, doc="s, from one reading to the next", minimum=1e-3)
    readings: int = setting(3, doc="readings for each order", minimum=1, maximum=1000)


@dataclass(frozen=True)
class PolygonSimulationSettings(SimulationSettings):
    """The simulated cell of the polygon method."""

    polygon: SimulatedPolygonSettings = group(SimulatedPolygonSettings)
    autocollimator: AutocollimatorSettings = group(AutocollimatorSettings)


class SimulatedAutocollimator(SeriesInstrument):
    """Reads the direction of the face before it: horizontal and vertical angle, rad.

    Everything follows from the true pose of the table, its tilts included.
    """

    frame = "autocollimator"

    def __init__(
        self,
        settings: PolygonSimulationSettings,
        table: Table,
        _temperature: SimulatedTemperature,
        start_ns: int,
    ) -> None:
        super().__init__(start_ns)
        self._polygon, self._own, self._table = settings.polygon, settings.autocollimator, table
        faces, mountings = self._polygon.faces, len(self._polygon.first_faces)
        of, align = self._polygon.face_arcsec * ARCSEC, self._polygon.mounting_arcsec * ARCSEC
        self.face_errors = of * IndexedNoise(settings.seed, FACES).normal(0, faces)
        self._mountings = align * IndexedNoise(settings.seed, MOUNTING).normal(0, mountings)
        self._noise, self._readings = IndexedNoise(settings.seed, READING), 0

    def series(self, _order: Command) -> Series:
        """Return how often and how fast it reads."""
        settling_s, reading_s = self._own.settling_time_s, self._own.reading_time_s
        return Series(
            self._own.readings, round(settling_s / NANOSECOND), round(reading_s / NANOSECOND)
        )

    def reading(self, stamp_ns: int, order: Command, number: int) -> ProbeSample:
        """Return what it reads of the face before it, with its noise."""
        noise = self._own.noise_arcsec * ARCSEC * self._noise.normal(2 * self._readings, 2)
        self._readings += 1
        read = np.append(self.seen(stamp_ns, order.station) + noise, 0.0)
        std = self._own.noise_arcsec * ARCSEC * np.array([1.0, 1.0, 0.0])
        return self.point(stamp_ns, order, read, std, number)

    def seen(self, stamp_ns: int, mounting: int) -> Floats:
        """Return the true reading (2,), rad, of the face nearest to the line of sight."""
        count, first = self._polygon.faces, self._polygon.first_faces
        turn = (first[mounting % len(first)] - np.arange(count)) * 2.0 * np.pi / count
        azimuth = turn + self.face_errors + self._mountings[mounting % len(first)]
        normals = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros(count)], axis=1)
        normals = normals @ self._table.poses(np.array([stamp_ns]))[0][0].T
        x, y, z = normals[int(np.argmax(normals[:, 0]))]
        read = np.array([np.arctan2(y, x), np.arcsin(z)])
        return np.where(np.abs(read).max() > self._own.range_arcsec * ARCSEC, np.nan, read)
