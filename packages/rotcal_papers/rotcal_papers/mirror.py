"""The plane mirror paper: its experiment, measured in a simulation, and its two ways as printed.

Only Sec. 2.2 of the paper is at hand, with its equations. So its plan of 17 positions from six
stations is measured on a simulated table, and its two recipes, stitching and
registration, are carried out beside this software's ways on the same points. Those are as printed,
too, but that a station of two normals has an axis.
The words stand in ``templates/mirror.yaml``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np

from rotcal_papers.reproduction import PrintedTable, Reproduction
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.components import COVERAGE_FACTOR
from rotcal_ros.foundation.observations import Observation, PointKind
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import ARCSEC, DEGREE
from rotcal_ros.geometry.rotations import fit_rigid_transform, wrap_angle
from rotcal_ros.methods.figures import Figure, style
from rotcal_ros.methods.plane_mirror.plan import (
    mirror_plan,
    nominal_mirror,
    position_angles,
    tracker_sees,
    tracker_stands,
)
from rotcal_ros.methods.plane_mirror.settings import MirrorPlanSettings, Way
from rotcal_ros.methods.plane_mirror.solver import (
    PlaneMirrorProblem,
    TrackerNoise,
    problem_from_observations,
    solve,
)
from rotcal_ros.methods.plane_mirror.solver.printed import axis_of_two, azimuths, fit_cone

SETTINGS: Final = MirrorPlanSettings(
    table_step_deg=22.5,
    table_positions=17,
    closing_nests=False,
    nests_m=(
        1.53, 0.47, 0.10, 0.39, 1.73, 0.55, -1.37, 1.35, 1.00,
        -2.02, -0.62, 0.10, -0.35, -1.56, 0.55, 1.26, -1.24, 1.00,
    ),
    mirror_lean_deg=1.4,
)  # fmt: skip
"""The experiment: six nests at places without symmetry, which would hide exchanged ones."""
STANDS: Final = tracker_stands(SETTINGS)
"""Stations A to F; each shares one position with the next."""
STEP: Final = SETTINGS.table_step_deg * DEGREE
MIRROR: Final = nominal_mirror(SETTINGS)
NORMAL_STD: Final = 1.0 * ARCSEC
"""Noise (k = 1) of a normal about each of its axes, for the spread of the recipes."""
NEST_STD: Final = 5e-6
"""Noise (k = 1) of a nest along each axis, m, for the same spread."""
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
    problem = simulate_points(truth, np.random.default_rng(SEED))
    ours = {way: solve(replace(problem, way=way)) for way in OURS}
    normals, frames = _seen_normals(problem)
    printed = apply_recipes(normals[None], frames[None])
    scattered = spread_of_recipes()
    values = _values(truth, ours, printed, scattered)
    return Reproduction.of(
        "mirror", values, _tables(truth, ours, printed), _figures(truth, ours, printed, scattered)
    )


def angles() -> Floats:
    """Return the commanded angles (17,), rad."""
    return np.array(position_angles(SETTINGS))


def true_errors() -> Floats:
    """Return the errors of the simulated table (17,), rad; the last position is the first one."""
    a = angles()
    return ARCSEC * (4.0 * np.cos(a + 0.3) + 1.5 * np.cos(2 * a - 1.3) + 0.6 * np.cos(4 * a + 2.4))


def simulate_points(errors: Floats, rng: np.random.Generator) -> PlaneMirrorProblem:
    """Return all points of the experiment, one reflector at each position, with usual noise."""
    see, observations = tracker_sees(SETTINGS), list[Observation]()
    for step in mirror_plan(SETTINGS).steps:
        turned = step.table_angle + errors[step.table_position]
        exact = np.array(see(replace(step, table_angle=turned)))
        root = np.linalg.cholesky(TrackerNoise().covariance(exact))
        x, y, z = (exact + root @ rng.standard_normal(3)).tolist()
        observations.append(step.observed((x, y, z)))
    return problem_from_observations(observations, angles())


def _seen_normals(problem: PlaneMirrorProblem) -> tuple[Floats, Floats]:
    """Return normals (22, 3), each in the frame of its station, and rotations (6, 3, 3) to A."""
    kind, xyz = problem.kind, problem.xyz
    across = xyz[kind == PointKind.DIRECT] - xyz[kind == PointKind.MIRRORED]
    seen = xyz[kind == PointKind.NEST].reshape(len(STANDS), -1, 3)
    frames = fit_rigid_transform(seen, seen[:1])[0]
    return across / np.linalg.norm(across, axis=1, keepdims=True), frames


def apply_recipes(normals: Floats, frames: Floats) -> Recipes:
    """Return what the two ways make of ``normals`` (t, 22, 3) and ``frames`` (t, 6, 3, 3).

    The paper's errors are commanded - measured, its angles arccos without a sense; here the sign
    is turned, and the sense is that of the table.
    """
    first = np.cumsum([0, *(len(stand.visit) for stand in STANDS)])
    parts = [normals[:, a:b] for a, b in pairwise(first.tolist())]
    sent = [angles()[list(stand.visit)] for stand in STANDS]
    cones = [fit_cone(*pair) for pair in zip(parts[:-1], sent[:-1], strict=True)]
    seen = [azimuths(part, axis) for part, (axis, _) in zip(parts, cones, strict=False)]
    counts = [len(visit) for visit in sent[:-1]]
    cone = np.average([height for _, height in cones], axis=0, weights=counts)
    last, axis = parts[-1], axis_of_two(parts[-1], cone, sent[-1])
    stitched, bare = (np.zeros((len(normals), len(angles()))) for _ in range(2))
    for curve, of_last in ((stitched, azimuths(last, axis)), (bare, angles_between(last))):
        for turned, stand in zip((*seen, of_last), STANDS, strict=True):
            curve[:, list(stand.visit)] = turned + curve[:, [stand.visit[0]]]
    together = np.concatenate(
        [
            np.einsum("tij,tkj->tki", frames[:, s], part[:, int(s > 0) :])
            for s, part in enumerate(parts)
        ],
        axis=1,
    )
    registered = azimuths(together, fit_cone(together, angles())[0])
    return Recipes(*(wrap_angle(found - angles()) for found in (registered, stitched, bare)))


def angles_between(normals: Floats) -> Floats:
    """Return the angles (t, k) between each of ``normals`` (t, k, 3) and the first, in space."""
    cosine = np.einsum("ti,tki->tk", normals[:, 0], normals)
    return np.asarray(np.arccos(np.clip(cosine, -1.0, 1.0)))


def spread_of_recipes() -> Recipes:
    """Return the rms error of each recipe at each position (17,), rad, by RUNS simulations."""
    rng = np.random.default_rng(SEED)
    exact = normals_on_cone(angles()[[i for stand in STANDS for i in stand.visit]], MIRROR.lean)
    normals = exact + NORMAL_STD * rng.standard_normal((RUNS, *exact.shape))
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    nests = np.reshape(SETTINGS.nests_m, (-1, 3))
    seen = np.array([nests - stand.place for stand in STANDS])
    scattered = seen + NEST_STD * rng.standard_normal((RUNS, *seen.shape))
    frames = fit_rigid_transform(scattered, scattered[:, :1])[0]
    found = apply_recipes(normals, frames)
    return Recipes(
        *(
            np.sqrt((errors**2).mean(axis=0))
            for errors in (found.registration, found.stitching, found.bare)
        )
    )


def _values(
    truth: Floats, ours: Mapping[Way, Result], printed: Recipes, scattered: Recipes
) -> dict[str, float]:
    closing = len(truth) - 1
    lean = MIRROR.lean
    two_flat = angles_between(normals_on_cone(np.array([0.0, STEP]), lean)[None])[0, 1]
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


@style.house_style
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


@style.house_style
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


def normals_on_cone(turned: Floats, lean: float) -> Floats:
    """Return normals (k, 3) that are ``turned`` by (k,) and ``lean`` out of the plane, rad."""
    across = np.cos(lean)
    return np.column_stack(
        [across * np.cos(turned), across * np.sin(turned), np.full_like(turned, np.sin(lean))]
    )
