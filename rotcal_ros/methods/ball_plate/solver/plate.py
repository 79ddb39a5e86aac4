"""The centres of a plate as a model of the engine: noise, groups, and what could spoil them."""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.sparse import block_diag as blocks_of
from scipy.sparse import csr_array

from rotcal_ros.adjust.circles import Circular
from rotcal_ros.adjust.bordered import FewEach, Groups
from rotcal_ros.adjust.designs import Derivatives
from rotcal_ros.adjust.gathering import Words
from rotcal_ros.adjust.kernels import Design, Whole
from rotcal_ros.adjust.model import Disturbing, Equations, Grouping, Model, Unit, steps
from rotcal_ros.foundation.arrays import Bools, Floats
from rotcal_ros.foundation.units import MICROMETRE
from rotcal_ros.methods.ball_plate.solver.layout import PlateLayout
from rotcal_ros.methods.ball_plate.solver.problem import BallPlateProblem, on_circle
from rotcal_ros.geometry.rotations import cross_matrix, rotation_about_z

UM: Final = Unit("um", MICROMETRE)
WORDS: Final = Words("centres", "dirt, a touched plate or warm air", "there", "there")
LARGEST: Final = 1e-4
"""Drift or move, m, that nobody would overlook."""
LARGEST_GROWTH: Final = 5e-4
"""The same of a growth over a run: 20 K of aluminium."""
QUARTILE: Final = 0.6745
ROUNDING: Final = 1e3 * np.finfo(np.float64).eps
"""Standard deviation of a coordinate below which centres have no noise, as part of the radius."""


def drift_columns(run_time: Floats, degree: int) -> Floats:
    """Return the displacement (n, 3, 3 degree) of centres by a drift of 1 m over the run.

    ``run_time`` runs from -0.5 to 0.5. The linear part comes first, then the bow: 1 m more at
    both ends than in the middle.
    """
    shapes = np.stack([run_time, 4.0 * run_time**2], axis=1)[:, :degree]
    columns = shapes[:, None, :, None] * np.eye(3)[:, None, :]
    return columns.reshape(len(run_time), 3, 3 * degree)


def rigid_motion(angles: Floats) -> Floats:
    """Return what a shift x, y, z and a rotation times radius do to points of the circle.

    (n, 3, 6) displacements per metre of each, of the points at ``angles`` (n,), rad.
    """
    cross = cross_matrix(-on_circle(angles))
    return np.concatenate([np.broadcast_to(np.eye(3), cross.shape), cross], axis=2)


def plate_motion(problem: BallPlateProblem) -> Floats:
    """Return likewise (n, 3, 6) what a motion of the plate on the table does to the centres.

    The motion is given in the frame of the table at position 0.
    """
    turn = rotation_about_z(problem.angles)[problem.position]
    return np.asarray(turn @ rigid_motion(problem.angles[problem.ball_step]))


def plate_model(layout: PlateLayout) -> Model:
    """Return unknowns, centres and what could spoil them; outputs are the six deviations."""
    problem, n = layout.problem, len(layout.row)
    frame = np.eye(3)[None] if _turned_noise(problem) else np.swapaxes(layout.radial, 1, 2)
    times = problem.run_time[layout.row]

    def seen(columns: Floats) -> Floats:
        """Return columns (n, 3, k) of the machine's frame as the rows have them, (3 n, k)."""
        to = layout.radial if _turned_noise(problem) else np.eye(3)[None]
        return np.asarray((to @ columns).reshape(3 * n, -1))

    drift = seen(drift_columns(times, problem.drift))
    design = _design(layout, drift)
    observed = seen(problem.centres[layout.row][:, :, None]).ravel()
    turned = _turned_noise(problem)

    def equations(x: Floats) -> tuple[Floats, Derivatives]:
        centres = (frame @ layout.computed(x)[:, :, None]).ravel()
        return centres + drift @ x[layout.unknowns :], design

    component = np.tile([0, 0, 1], n)
    std, unstated = _std(layout, design, observed - equations(np.zeros(design.shape[1]))[0])
    m, s, r = layout.counts
    each = {
        "table position": problem.position, "ball step": problem.ball_step,
        "CMM position": problem.cmm_index,
    }  # fmt: skip
    along = {"table position": "ball step", "ball step": "table position", "CMM position": "ball step"}
    when = np.repeat(np.arange(n, dtype=np.float64), 3)
    axes = ("radial", "tangential", "axial") if turned else ("x", "y", "z")
    names = [problem.row_name(k) for k in layout.row.tolist()]
    curves = csr_array(layout.curves())
    return Model(
        blocks={"table shift": 3 * m, "table turn": 3 * m, "CMM position": 3 * s, "ball": 3 * r}
        | ({"drift": drift.shape[1]} if problem.drift else {}),
        observed=observed,
        std=std,
        equations=equations,
        outputs=_padded(layout, curves, drift.shape[1]),
        words=WORDS,
        unit=UM,
        components=("the centres in the plane", "the centres along the axis"),
        component=component,
        groupings=[
            Grouping(
                kind, np.repeat(number[layout.row], 3),
                np.repeat(each[along[kind]][layout.row], 3).astype(np.float64),
            )
            for kind, number in each.items()
        ],
        effects=_effects(layout, seen, times),
        row_names=[name for name in names for _ in range(3)],
        element=np.repeat(np.arange(n), 3),
        definitions=layout.defined,
        unstated=unstated,
    )


def _padded(layout, curves, more):
    found = layout.defined.outputs(curves)
    if not more:
        return found
    from dataclasses import replace
    few = csr_array((found.few.data, found.few.indices, found.few.indptr), shape=(found.few.shape[0], found.few.shape[1]+more))
    return replace(found, few=few, common=np.pad(found.common, ((0,0),(0,more))))


def _turned_noise(problem: BallPlateProblem) -> bool:
    """Whether x and y of every centre have the same noise: then radial and tangential have, too."""
    return problem.std is None or bool((problem.std[:, 0] == problem.std[:, 1]).all())


def _design(layout: PlateLayout, drift: Floats) -> Design:
    """Return the design: circles where these are complete and all centres weigh alike."""
    problem = layout.problem
    circular = layout.circular if _turned_noise(problem) and problem.weighed_alike else None
    if circular is not None and circular.kernel() is not None:
        return circular.with_extra(drift)
    rows = layout.rows
    if not _turned_noise(problem):
        rows = csr_array(blocks_of(np.swapaxes(layout.radial, 1, 2)) @ rows)
    joined = np.arange(6 * layout.counts[0], layout.unknowns)
    found = FewEach(rows, np.zeros((0, layout.unknowns)), groups=Groups.of(rows, joined))
    return found.with_extra(drift) if drift.shape[1] else found


def _std(layout: PlateLayout, design: Design, misclosure: Floats) -> tuple[Floats, bool]:
    """Return standard deviations (3 n,), m, as stated; else as a first fit shows them, and True."""
    problem, n = layout.problem, len(layout.row)
    if problem.std is not None:
        return problem.std[layout.row].ravel(), False
    if problem.sigma is not None:
        return np.full(3 * n, problem.sigma), False
    kernel = design.kernel() or Whole.of(design, np.zeros(0, dtype=np.int64))
    left = misclosure - kernel.taken(misclosure[:, None])[:, 0]
    share = np.sqrt(np.maximum(1.0 - kernel.leverage, 1e-6))
    plane, axial = np.tile([True, True, False], n), np.tile([False, False, True], n)
    least = ROUNDING * problem.radius
    guess = [max(float(np.median(np.abs(left / share)[m])) / QUARTILE, least) for m in (plane, axial)]
    return np.where(plane, *guess), True


def _effects(layout: PlateLayout, seen, times: Floats) -> tuple[Disturbing, ...]:
    """Return what could spoil the centres: drift of the CMM, a plate that moved, or grew."""
    problem, n = layout.problem, len(layout.row)
    motion = seen(plate_motion(problem)[layout.row])
    once, when = np.zeros(3 * n, dtype=np.int64), np.repeat(np.arange(n), 3).astype(np.float64)
    places = problem.radius * on_circle(problem.angles[problem.cmm_index[layout.row]])
    found = [
        Disturbing("drift", "the origin of the CMM drifts", seen(drift_columns(times, 1)), LARGEST, UM),
        Disturbing("growth", "the plate grows", seen((times[:, None] * places)[:, :, None]), LARGEST_GROWTH, Unit("um/m", MICROMETRE)),
        Disturbing("knock", "the plate moved on the table", steps(once, when, motion), LARGEST, UM, family=True),
    ]
    return tuple(found[1:] if problem.drift else found)
