"""Where mirror, tracker and reflectors stand: which station sees which table position, and how.

The world is the machine frame, the table axis its +z. Angles are radians, lengths metres.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from rotcal_ros.foundation.arrays import Floats

SPREAD: Final = 0.3
"""The reflectors of a position spread over this share of the mirror's shorter edge."""


def incidence(station: ArrayLike, centre: Floats, frame: Floats) -> float:
    """Return the angle between the mirror's normal and the beam from ``station`` (3,)."""
    beam = np.asarray(station, dtype=np.float64) - centre
    return float(np.arccos(np.clip(beam @ frame[:, 2] / np.linalg.norm(beam), -1.0, 1.0)))


def reflector_places(
    station: ArrayLike, centre: Floats, frame: Floats, count: int, reach: float, edge: float
) -> Floats:
    """Return places (count, 3) that the tracker sees near the middle of the mirror.

    They lie ``reach`` from the glass along the reflected beam, beside each other, spread by a
    share of the ``edge`` of the mirror.
    """
    beam = centre - np.asarray(station, dtype=np.float64)
    beam = beam / np.linalg.norm(beam)
    reflected = beam - 2.0 * (beam @ frame[:, 2]) * frame[:, 2]
    side = np.linspace(-0.5, 0.5, count) if count > 1 else np.zeros(1)
    offsets = np.outer(side, frame[:, 0]) + np.outer(side**2, frame[:, 1])
    places: Floats = centre + reach * reflected + SPREAD * edge * offsets
    return places


def station_visits(n_positions: int, per_station: int, shared: int) -> tuple[range, ...]:
    """Return the table positions that each tracker station measures.

    Every station measures ``per_station`` positions, the last one what is left; neighbours have
    ``shared`` (less than ``per_station``) in common.
    """
    visits = [range(min(per_station, n_positions))]
    while visits[-1].stop < n_positions:
        first = visits[-1].stop - shared
        visits.append(range(first, min(first + per_station, n_positions)))
    return tuple(visits)


def on_circle(radius: float, azimuth: float, height: float) -> tuple[float, float, float]:
    """Return the place (m) at ``radius`` from the axis."""
    return float(radius * np.cos(azimuth)), float(radius * np.sin(azimuth)), height
