"""The simulated polygon and autocollimator, and their settings: group ``simulation``."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.observations import Command
from rotcal_ros.foundation.settings import group, setting
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.methods.simulation.air import SimulatedTemperature
from rotcal_ros.methods.simulation.instrument import AngleReader, Table
from rotcal_ros.methods.simulation.noise import IndexedNoise
from rotcal_ros.methods.simulation.settings import AngleReaderSettings, SimulationSettings

FACES, MOUNTING, READING = 1001, 1002, 1003
"""Streams of random numbers; those below 1000 belong to rotcal_ros."""


@dataclass(frozen=True)
class SimulatedPolygonSettings:
    """The polygon as it really is, and how the person really mounts it."""

    faces: int = setting(12, doc="number of faces", minimum=3, maximum=144)
    first_faces: tuple[int, ...] = setting(
        (0, 1, 5),
        doc="face really before the autocollimator at table angle 0, by mounting",
        minimum=0,
    )
    face_arcsec: float = setting(2.0, doc="arcsec, standard deviation of face errors", minimum=0.0)
    mounting_arcsec: float = setting(
        10.0, doc="arcsec, standard deviation with which the person aligns a face", minimum=0.0
    )


@dataclass(frozen=True)
class PolygonSimulationSettings(SimulationSettings):
    """The simulated cell of the polygon method; the autocollimator looks along -x."""

    polygon: SimulatedPolygonSettings = group(SimulatedPolygonSettings)
    autocollimator: AngleReaderSettings = group(AngleReaderSettings)


class SimulatedAutocollimator(AngleReader):
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
        super().__init__(settings.autocollimator, settings.noise_seed, READING, start_ns)
        self._polygon, self._table = settings.polygon, table
        faces, mountings = self._polygon.faces, len(self._polygon.first_faces)
        of, align = self._polygon.face_arcsec * ARCSEC, self._polygon.mounting_arcsec * ARCSEC
        self.face_errors = of * IndexedNoise(settings.seed, FACES).normal(0, faces)
        self._mountings = align * IndexedNoise(settings.noise_seed, MOUNTING).normal(0, mountings)

    def seen(self, stamp_ns: int, order: Command) -> Floats:
        """Return the true reading (2,), rad, of the face nearest to the line of sight."""
        count, first = self._polygon.faces, self._polygon.first_faces
        mounting = order.station % len(first)
        turn = (first[mounting] - np.arange(count)) * 2.0 * np.pi / count
        azimuth = turn + self.face_errors + self._mountings[mounting]
        normals = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros(count)], axis=1)
        normals = normals @ self._table.poses(np.array([stamp_ns]))[0][0].T
        x, y, z = normals[int(np.argmax(normals[:, 0]))]
        return np.array([np.arctan2(y, x), np.arcsin(z)])
