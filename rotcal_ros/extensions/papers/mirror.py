"""The plane mirror paper: its experiment, measured in a simulation, and its two ways as printed.

Only Sec. 2.2 of the paper is at hand, with its equations. So its plan of 17 positions from six
stations is measured on a simulated table, and its two recipes, stitching and
registration, are carried out beside this software's ways on the same points.
The words stand in ``templates/mirror.yaml``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np

from rotcal_ros.extensions.papers.reproduction import PrintedTable, Reproduction
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.components import COVERAGE_FACTOR
from rotcal_ros.foundation.observations import PointKind
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import ARCSEC, DEGREE
from rotcal_ros.geometry.rotations import align, rotation_about_z, wrap_angle
from rotcal_ros.methods.figures import Figure, style
from rotcal_ros.methods.plane_mirror.mirror_physics import (
    FlatMirror,
    TrackerStation,
    reflector_places,
)
from rotcal_ros.methods.plane_mirror.settings import Way
from rotcal_ros.methods.plane_mirror.solver import PlaneMirrorProblem, TrackerNoise, solve

POSITIONS: Final = 17
STEP: Final = 22.5 * DEGREE
VISITS: Final = (*(tuple(range(first, first + 4)) for first in range(0, 15, 3)), (15, 16))
"""Positions that stations A to F see, from 0: each shares one with the next."""
NESTS: Final = 6
STAND_OFF: Final = 2.0
REACH: Final = 1.5
"""Metres from the axis to the tracker, and from the glass to the reflector."""
MIRROR: Final = FlatMirror()
"""Leans by 1.4 degrees."""
NORMAL_STD: Final = 1.0 * ARCSEC
"""Of a normal about each of its axes, for the spread of the recipes."""
NEST_STD: Final = 5e-6
"""Of a nest along each axis, m, for the same."""
RUNS: Final = 2000
OURS: Final[tuple[Way, ...]] = ("stitching", "registration", "joint")
SEED: Final = 11


@dataclass(frozen=True, eq=False)
class Recipes:
    """Errors (..., 17) by the two printed recipes, actual - commanded, rad, zero at the first.

    ``bare``: stitching where a station of two normals is left without a projection, as printed.
    """

    registration: Floats
    stitching: Floats
    bare: Floats


def reproduce() -> Reproduction:
    """Return the paper's two ways and its closure, computed again."""
    truth = true_errors()
    problem = measured(truth, np.random.default_rng(SEED))
    ours = {way: solve(replace(problem, way=way)) for way in OURS}
    normals, frames = _seen_normals(problem)
    printed = recipes(normals[None], frames[None])
    scattered = spread_of_recipes()
    values = _values(truth, ours, printed, scattered)
    return Reproduction.of(
        "mirror", values, _tables(truth, ours, printed), _figures(truth, ours, printed, scattered)
    )


def angles() -> Floats:
    """Return the commanded angles (17,), rad."""
    return np.asarray(STEP * np.arange(POSITIONS), dtype=np.float64)


def true_errors() -> Floats:
    """Return the errors of the simulated table (17,), rad; the last position is the first one."""
    a = angles()
    return ARCSEC * (4.0 * np.cos(a + 0.3) + 1.5 * np.cos(2 * a - 1.3) + 0.6 * np.cos(4 * a + 2.4))


def stations() -> tuple[TrackerStation, ...]:
    """Return the six stations, each opposite to the middle of what it sees."""
    middle = [float(angles()[list(visit)].mean()) for visit in VISITS]
    return tuple(
        TrackerStation((STAND_OFF * np.cos(a), STAND_OFF * np.sin(a), 0.35), 2.3 * a + 0.4)
        for a in middle
    )


def nests() -> Floats:
    """Return the six nests (6, 3), m: no symmetry lets exchanged ones go unnoticed."""
    around = np.arange(NESTS) * 2.0 * np.pi / NESTS + 0.3
    reach, height = 1.6 + 0.17 * (np.arange(NESTS) % 4), 0.1 + 0.45 * (np.arange(NESTS) % 3)
    return np.column_stack([reach * np.cos(around), reach * np.sin(around), height])


def measured(errors: Floats, rng: np.random.Generator) -> PlaneMirrorProblem:
    """Return all points of the experiment, one reflector at each position, with usual noise."""
    noise, rows, points = TrackerNoise(), [], []
    for s, (station, visit) in enumerate(zip(stations(), VISITS, strict=True)):
        for k, nest in enumerate(nests(), start=1):
            rows.append((-1, s, PointKind.NEST, k))
            points.append(station.seen(nest))
        for i in visit:
            pose = MIRROR.pose(rotation_about_z(angles()[i] + errors[i]))
            (place,) = reflector_places(station.place, *pose, 1, REACH, MIRROR.width)
            for kind, seen in (
                (PointKind.DIRECT, place),
                (PointKind.MIRRORED, MIRROR.image(pose, station, place, f"position {i}")),
            ):
                rows.append((i, s, kind, 1))
                points.append(station.seen(seen))
    position, number, kind, nest = np.array(rows, dtype=np.int64).T
    exact = np.array(points)
    scatter = np.linalg.cholesky(noise.covariance(exact)) @ rng.standard_normal((*exact.shape, 1))
    return PlaneMirrorProblem(
        angles(), position, number, kind, nest, exact + scatter[..., 0], noise
    )


def _seen_normals(problem: PlaneMirrorProblem) -> tuple[Floats, Floats]:
    """Return normals (22, 3), each in the frame of its station, and rotations (6, 3, 3) to A."""
    kind, xyz = problem.kind, problem.xyz
    across = xyz[kind == PointKind.DIRECT] - xyz[kind == PointKind.MIRRORED]
    seen = xyz[kind == PointKind.NEST].reshape(len(VISITS), NESTS, 3)
    frames = align(seen, seen[:1])[0]
    return across / np.linalg.norm(across, axis=1, keepdims=True), frames


def recipes(normals: Floats, frames: Floats) -> Recipes:
    """Return what the two ways make of ``normals`` (t, 22, 3) and ``frames`` (t, 6, 3, 3).

    The paper's errors are commanded - measured, its angles arccos without a sense; here the sign
    is turned, and the sense is that of the table.
    """
    first = np.cumsum([0, *(len(visit) for visit in VISITS)])
    parts = [normals[:, a:b] for a, b in pairwise(first.tolist())]
    axes = [plane_axes(part) for part in parts[:-1]]
    heights = [np.einsum("ti,tki->tk", *pair) for pair in zip(axes, parts, strict=False)]
    last, cone = parts[-1], np.concatenate(heights, axis=1).mean(axis=1)
    turns = [about(axis, part) for axis, part in zip(axes, parts, strict=False)]
    stitched, bare = (np.zeros((len(normals), POSITIONS)) for _ in range(2))
    for curve, of_last in ((stitched, about(cone_axis(last, cone), last)), (bare, between(last))):
        for turned, visit in zip((*turns, of_last), VISITS, strict=True):
            curve[:, list(visit)] = turned + curve[:, [visit[0]]]
    together = np.concatenate(
        [
            np.einsum("tij,tkj->tki", frames[:, s], part[:, int(s > 0) :])
            for s, part in enumerate(parts)
        ],
        axis=1,
    )
    registered = about(plane_axes(together), together)
    return Recipes(*(wrap_angle(found - angles()) for found in (registered, stitched, bare)))


def plane_axes(normals: Floats) -> Floats:
    """Return the upward axes (t, 3) of the planes through the ends of ``normals`` (t, k, 3)."""
    centred = normals - normals.mean(axis=1, keepdims=True)
    axes = np.linalg.svd(centred, full_matrices=False)[2][:, -1]
    return np.asarray(axes * np.sign(axes[:, 2:]))


def cone_axis(normals: Floats, height: Floats) -> Floats:
    """Return the upward axes (t, 3) that two ``normals`` (t, 2, 3) have ``height`` (t,) along.

    The cure for a station of two normals: the mirror makes the same angle with the axis at every
    station, so that the others tell it.
    """
    first, second = normals[:, 0], normals[:, 1]
    alike = 1.0 + np.einsum("ti,ti->t", first, second)
    across = np.cross(first, second)
    along = (height / alike)[:, None] * (first + second)
    left = np.sqrt(np.maximum(1.0 - (along**2).sum(axis=1), 0.0)) / np.linalg.norm(across, axis=1)
    return np.asarray(along + (left * np.sign(across[:, 2]))[:, None] * across)


def about(axes: Floats, normals: Floats) -> Floats:
    """Return the angles (t, k) of ``normals`` (t, k, 3) about ``axes`` (t, 3) from the first."""
    flat = normals - np.einsum("tki,ti->tk", normals, axes)[..., None] * axes[:, None]
    first = flat[:, :1]
    sine = np.einsum("ti,tki->tk", axes, np.cross(first, flat))
    return np.asarray(np.arctan2(sine, (first * flat).sum(axis=2)))


def between(normals: Floats) -> Floats:
    """Return the angles (t, k) between each of ``normals`` (t, k, 3) and the first, in space."""
    cosine = np.einsum("ti,tki->tk", normals[:, 0], normals)
    return np.asarray(np.arccos(np.clip(cosine, -1.0, 1.0)))


def spread_of_recipes() -> Recipes:
    """Return the rms error of each recipe at each position (17,), rad, by RUNS simulations."""
    rng = np.random.default_rng(SEED)
    exact = np.array(
        [
            rotation_about_z(-station.heading) @ cone(angles()[[i]], MIRROR.lean)[0]
            for station, visit in zip(stations(), VISITS, strict=True)
            for i in visit
        ]
    )
    normals = exact + NORMAL_STD * rng.standard_normal((RUNS, *exact.shape))
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    seen = np.array([station.seen(nests()) for station in stations()])
    scattered = seen + NEST_STD * rng.standard_normal((RUNS, *seen.shape))
    frames = align(scattered, scattered[:, :1])[0]
    found = recipes(normals, frames)
    return Recipes(
        *(
            np.sqrt((errors**2).mean(axis=0))
            for errors in (found.registration, found.stitching, found.bare)
        )
    )


def _values(
    truth: Floats, ours: Mapping[Way, Result], printed: Recipes, scattered: Recipes
) -> dict[str, float]:
    closing = POSITIONS - 1
    lean = MIRROR.lean
    two_flat = between(cone(np.array([0.0, STEP]), lean)[None])[0, 1]
    values = {
        "registration_rms_arcsec": scattered.registration[1:].mean(),
        "registration_last_arcsec": scattered.registration[closing],
        "stitching_first_arcsec": scattered.stitching[1],
        "stitching_last_arcsec": scattered.stitching[closing - 1],
        "bare_closure_arcsec": two_flat - STEP,
        "bare_size_arcsec": abs(two_flat - STEP),
        "closure_registration_arcsec": printed.registration[0, closing],
        "closure_stitching_arcsec": printed.stitching[0, closing],
        "closure_bare_arcsec": printed.bare[0, closing],
    }
    for way, result in ours.items():
        values |= {
            f"closure_{way}_ours_arcsec": result.details["closure_rad"],
            f"u_{way}_arcsec": COVERAGE_FACTOR * result.std["ECC"].max(),
            f"apart_{way}_arcsec": rms(result.deviations["ECC"][1:] - truth[1:] + truth[0]),
        }
    return {name: float(value) / ARCSEC for name, value in values.items()} | {
        "lean_deg": lean / DEGREE
    }


def rms(values: Floats) -> float:
    """Return the root mean square of ``values`` (n,)."""
    return float(np.sqrt((values**2).mean()))


def _tables(truth: Floats, ours: Mapping[Way, Result], printed: Recipes) -> Iterator[PrintedTable]:
    columns = {
        "injected": truth - truth[0],
        "registration, as printed": printed.registration[0],
        "stitching, station F cured": printed.stitching[0],
        "stitching, as printed": printed.bare[0],
        **{f"{way}, ours": result.deviations["ECC"] for way, result in ours.items()},
    }
    yield PrintedTable.of(
        "Errors at the 17 positions, actual - commanded, arcsec (SIMULATED; the paper has the "
        "opposite sign)",
        ("angle / °", *columns),
        (".1f", *[".2f"] * len(columns)),
        np.column_stack([angles() / DEGREE, *(c / ARCSEC for c in columns.values())]),
    )


def _figures(
    truth: Floats, ours: Mapping[Way, Result], printed: Recipes, scattered: Recipes
) -> tuple[Figure, ...]:
    return (
        Figure(
            "Stitching and registration: errors of the table",
            "SIMULATED: 17 positions from six stations, one reflector, a mirror that leans by "
            f"{MIRROR.lean / DEGREE:.1f}°. The last position is the first one again; what the "
            "curve does not return to is the closure. Stitching as printed ends in a station of "
            "two normals, which have no plane.",
            draw_ways(truth - truth[0], ours, printed),
        ),
        Figure(
            "How their noise grows",
            f"Rms error over {RUNS} simulations with 1″ per normal and 5 µm per nest. Stitching "
            "adds the last error of each station to all that follow; registration does not.",
            draw_spread(scattered),
        ),
    )


@style.styled
def draw_ways(truth: Floats, ours: Mapping[Way, Result], printed: Recipes) -> str:
    """Draw the curves of both recipes and of our joint way beside the ``truth`` (17,), rad."""
    (ax,) = style.grid()
    degrees = angles() / DEGREE
    for number, (label, curve) in enumerate(
        {
            "registration, as printed": printed.registration[0],
            "stitching, as printed": printed.bare[0],
            "joint": ours["joint"].deviations["ECC"],
            "injected": truth,
        }.items()
    ):
        ax.plot(
            degrees, curve / ARCSEC, marker="os^x"[number], markersize=4, linewidth=0.9,
            markerfacecolor="none", color=style.COLOURS[number], label=label,
        )  # fmt: skip
    style.angle_axis(ax, degrees)
    ax.set_ylabel("ECC / arcsec")
    return style.svg(ax)


@style.styled
def draw_spread(scattered: Recipes) -> str:
    """Draw the rms error (17,), rad, of registration and of stitching."""
    (ax,) = style.grid()
    degrees = angles() / DEGREE
    for number, (label, rms) in enumerate(
        {"registration": scattered.registration, "stitching": scattered.stitching}.items()
    ):
        ax.plot(
            degrees, rms / ARCSEC, marker="os"[number], markersize=4, linewidth=0.9,
            color=style.COLOURS[number], label=label,
        )  # fmt: skip
    style.angle_axis(ax, degrees)
    ax.set_ylabel("rms error / arcsec")
    return style.svg(ax)


def cone(turned: Floats, lean: float) -> Floats:
    """Return normals (k, 3) that are ``turned`` by (k,) and ``lean`` out of the plane, rad."""
    across = np.cos(lean)
    return np.column_stack(
        [across * np.cos(turned), across * np.sin(turned), np.full_like(turned, np.sin(lean))]
    )
