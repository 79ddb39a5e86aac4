"""A laser tracker that drifts while it stands: the physics written down again, for the tests.

The tracker turns two axes and measures azimuth, elevation and range. Between the first and the
last point of a station its zero of azimuth, its level and its zero of range creep. The world has
the table axis as z; stations stand outside, nests around, one mirror on the table.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field

import numpy as np

from rotcal_ros.foundation.observations import PointKind
from rotcal_ros.methods.plane_mirror.solver import PlaneMirrorProblem, TrackerNoise

ARCSEC = np.pi / 648000.0
STATIONS = [range(s, min(s + 4, 17)) for s in range(0, 16, 3)]
"""Positions seen from each station: those of the paper, 22.5 degrees apart."""


@dataclass(frozen=True)
class Creep:
    """What the tracker's zeros do from the start of a station (0) to its end (1).

    ``azimuth``, ``tilt_x``, ``tilt_y`` (rad), ``range`` (m) and ``shift`` (3,) (m) of its head
    are the whole change; ``course`` tells how much of it has come by a share of the time.
    """

    azimuth: float = 0.0
    tilt_x: float = 0.0
    tilt_y: float = 0.0
    range: float = 0.0
    shift: tuple[float, float, float] = (0.0, 0.0, 0.0)
    course: object = field(default=lambda share: share)


@dataclass(frozen=True)
class Campaign:
    """Commanded angles, true ECC (N,), and rows: exact points in the drifting tracker's frame."""

    angles: np.ndarray
    ecc: np.ndarray
    rows: np.ndarray
    exact: np.ndarray

    def problem(self, xyz: np.ndarray | None = None, **settings: object) -> PlaneMirrorProblem:
        position, station, kind, nest = self.rows.T
        return PlaneMirrorProblem(
            self.angles, position, station, kind, nest, self.exact if xyz is None else xyz,
            **{"noise": TrackerNoise(), "uneven_drift_std": 0.0, **settings},
        )  # fmt: skip

    def noisy(self, rng: np.random.Generator, trials: int, factor: float = 1.0) -> np.ndarray:
        """Return (trials, n, 3): azimuth, elevation and range each with its noise."""
        x, y, z = self.exact.T
        ground = np.hypot(x, y)
        r = np.hypot(ground, z)
        across = factor * (3.75e-6 + 1.5e-6 * r)
        along = factor * (2.5e-6 + 0.25e-6 * r)
        e = rng.standard_normal((3, trials, len(r)))
        azimuth = np.arctan2(y, x) + across / ground * e[0]
        elevation = np.arctan2(z, ground) + across / r * e[1]
        r = r + along * e[2]
        return np.stack(
            [
                r * np.cos(elevation) * np.cos(azimuth),
                r * np.cos(elevation) * np.sin(azimuth),
                r * np.sin(elevation),
            ],
            axis=-1,
        )


def campaign(
    creep: Creep | list[Creep] | None = None,
    *,
    closing: bool = True,
    every: int = 0,
    n_nests: int = 6,
    reflectors: int = 3,
    lean: float = np.radians(1.4),
    moved: tuple[int, int, tuple[float, float, float]] = (0, 0, (0.0, 0.0, 0.0)),
    seed: int = 5,
) -> Campaign:
    """Return one calibration; ``every`` positions the nests are measured in between.

    ``moved`` is a nest, the round of nests (from 0) before which it was moved, and how (m).
    """
    rng = np.random.default_rng(seed)
    angles = np.arange(17) * np.pi / 8
    ecc = rng.normal(0.0, 4.0 * ARCSEC, 17)
    ecc -= ecc[0]
    ecc[-1] = 0.0  # the closing position is the first one again
    around = np.arange(n_nests) * 2.0 * np.pi / n_nests + 0.3
    reach, height = 1.6 + 0.17 * (np.arange(n_nests) % 4), 0.1 + 0.45 * (np.arange(n_nests) % 3)
    nests = np.column_stack([reach * np.cos(around), reach * np.sin(around), height])
    rows, points, rounds = [], [], itertools.count()
    for s, visit in enumerate(STATIONS):
        middle = angles[list(visit)].mean()
        head = np.array([2.0 * np.cos(middle), 2.0 * np.sin(middle), 0.35])
        own_rows, own = [], []

        def nest_round(s=s, own_rows=own_rows, own=own):
            own_rows.extend((-1, s, PointKind.NEST, k + 1) for k in range(n_nests))
            places = nests.copy()
            if moved[0] and next(rounds) >= moved[1]:
                places[moved[0] - 1] += moved[2]
            own.extend(places)

        nest_round()
        for count, i in enumerate(visit):
            if every and count and count % every == 0:
                nest_round()
            turned = angles[i] + ecc[i]
            normal = np.array([np.cos(lean) * np.cos(turned), np.cos(lean) * np.sin(turned),
                               np.sin(lean)])  # fmt: skip
            on_glass = np.array([0.05 * np.cos(turned), 0.05 * np.sin(turned), 0.15])
            beam = on_glass - head
            beam /= np.linalg.norm(beam)
            back = beam - 2.0 * (beam @ normal) * normal
            for k in range(reflectors):
                place = on_glass + 1.5 * back + 0.01 * rng.standard_normal(3)
                image = place - 2.0 * ((place - on_glass) @ normal) * normal
                own_rows += [(i, s, PointKind.DIRECT, k + 1), (i, s, PointKind.MIRRORED, k + 1)]
                own += [place, image]
        if closing:
            nest_round()
        one = creep[s] if isinstance(creep, list) else creep or Creep()
        rows += own_rows
        points.append(_seen(np.array(own), head, 2.3 * middle + 0.4, one))
    return Campaign(angles, ecc, np.array(rows, dtype=np.int64), np.concatenate(points))


def _seen(world: np.ndarray, head: np.ndarray, heading: float, creep: Creep) -> np.ndarray:
    """Return points (n, 3) one after another, as the creeping tracker shows them."""
    seen = np.empty_like(world)
    for q, point in enumerate(world):
        share = creep.course(q / max(len(world) - 1, 1))
        c, s = np.cos(heading), np.sin(heading)
        x, y, z = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) @ (point - head)
        x, y, z = np.array([x, y, z]) + share * np.array(creep.shift)
        y, z = (
            np.cos(a := share * creep.tilt_x) * y - np.sin(a) * z,
            np.sin(a) * y + np.cos(a) * z,
        )
        x, z = (
            np.cos(b := share * creep.tilt_y) * x + np.sin(b) * z,
            np.cos(b) * z - np.sin(b) * x,
        )
        azimuth = np.arctan2(y, x) + share * creep.azimuth
        elevation = np.arctan2(z, np.hypot(x, y))
        r = np.sqrt(x * x + y * y + z * z) + share * creep.range
        seen[q] = (r * np.cos(elevation) * np.cos(azimuth),
                   r * np.cos(elevation) * np.sin(azimuth), r * np.sin(elevation))  # fmt: skip
    return seen
