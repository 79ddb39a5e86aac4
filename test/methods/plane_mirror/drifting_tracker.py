"""A laser tracker that drifts while it stands: the physics written down again, for the tests.

The tracker turns two axes and measures azimuth, elevation and range. Between the first and the
last point of a station its zero of azimuth, its level and its zero of range creep. The world has
the table axis as z; stations stand outside, nests around, one mirror on the table.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from gathered_worlds import (
    ARCSEC,
    DIRECT,
    MIRROR_STATIONS,
    MIRRORED,
    NEST,
    mirror_and_glass,
    nests_around,
    places_at,
)

from rotcal_ros.foundation.observations import PointKind
from rotcal_ros.methods.plane_mirror.solver import PlaneMirrorProblem, TrackerNoise

KINDS = {DIRECT: PointKind.DIRECT, MIRRORED: PointKind.MIRRORED, NEST: PointKind.NEST}


@dataclass(frozen=True)
class Creep:
    """What the tracker's zeros do from the start of a station (0) to its end (1).

    ``azimuth``, ``tilt_x``, ``tilt_y`` (rad), ``range`` (m) and ``shift`` (3,) (m) of its head
    are the whole change; ``course`` says how much of it has come by a share of the time.
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
    moved: tuple[int, int, tuple[float, float, float]] = (0, 0, (0.0, 0.0, 0.0)),
) -> Campaign:
    """Return one calibration; ``every`` positions the nests are measured in between.

    ``moved`` is a nest, the round of nests (from 0) before which it was moved, and how (m).
    """
    rng = np.random.default_rng(5)
    angles = np.arange(17) * np.pi / 8
    ecc = rng.normal(0.0, 4.0 * ARCSEC, 17)
    ecc -= ecc[0]
    ecc[-1] = 0.0  # the closing position is the first one again
    mirrors = [mirror_and_glass(angle, np.radians(1.4)) for angle in angles + ecc]
    nests, spread = nests_around(n_nests), rng.standard_normal((3, 3))
    between = [visited for visited in range(1, 17) if every and visited % every == 0]
    rows, points, rounds = [], [], 0
    for s, visit in enumerate(MIRROR_STATIONS):
        middle = angles[list(visit)].mean()
        head = np.array([2.0 * np.cos(middle), 2.0 * np.sin(middle), 0.35])
        own, world = places_at(s, visit, head, nests, mirrors, spread, between)
        if not closing:
            own, world = own[:-n_nests], world[:-n_nests]
        is_nest = own[:, 2] == NEST
        first = is_nest & (own[:, 3] == 0)
        beyond = rounds + np.cumsum(first) > moved[1]
        world[is_nest & beyond & (own[:, 3] == moved[0] - 1)] += moved[2]
        rounds += int(first.sum())
        one = creep[s] if isinstance(creep, list) else creep or Creep()
        rows.append(own)
        points.append(_seen(world, head, 2.3 * middle + 0.4, one))
    measured = np.concatenate(rows)
    measured[:, 2] = [KINDS[kind] for kind in measured[:, 2].tolist()]
    measured[:, 3] += 1  # people count nests and reflectors from one
    return Campaign(angles, ecc, measured, np.concatenate(points))


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
