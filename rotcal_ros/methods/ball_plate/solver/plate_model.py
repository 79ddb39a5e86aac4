"""The centres of a plate as a model of the engine: their noise, groups, and what may spoil them.

The unknowns and the exact equations are those of :mod:`.layout`. Centres are written radial,
tangential and axial where x and y have the same noise, else as x, y and z.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np
from scipy.sparse import block_diag, csr_array

from rotcal_ros.adjust.bordered import SparseDesign
from rotcal_ros.adjust.designs import Derivatives
from rotcal_ros.adjust.gathering import Words
from rotcal_ros.adjust.kernels import ConstrainedKernel, DenseKernel, Design, LowRankUpdateKernel
from rotcal_ros.adjust.model import CurveModel, Disturbing, Grouping, KnownRelation, Model, Unit
from rotcal_ros.adjust.outputs import Outputs
from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.foundation.language import noted
from rotcal_ros.foundation.units import MICROMETRE
from rotcal_ros.methods.ball_plate.solver.layout import ROUNDING, PlateLayout
from rotcal_ros.methods.ball_plate.solver.problem import BallPlateProblem, on_circle

UM: Final = Unit("um", MICROMETRE)
WORDS: Final = Words("centres", "dirt, a touched plate or warm air", "there", "there")
GREW: Final = noted("the plate grew")
IN_PLANE: Final = ("the centres in the plane", "the centres along the axis")
BY_AXIS: Final = ("the centres along x", "the centres along y", "the centres along z")
LARGEST: Final = 1e-4
"""Drift or move, m, that nobody would overlook."""
LARGEST_GROWTH: Final = 5e-4
"""The same of a growth over a run: 20 K of aluminium."""
QUARTILE: Final = 0.6745
"""Median of |x| for a standard normal x."""
MOMENTS: Final = 40
"""Moments at which a knock is looked for, evenly over the run; a quarter where each costs more."""
RANDOM_MOMENTS: Final = 0.95
"""A knock comes at a random moment: its error is that of all but the worst 5 % of them."""
AGAIN: Final = "table position measured again"
NOT_CLOSED: Final = "the table position that was measured again at the end had changed"
MOST_REPEATED: Final = 0.2
"""Part of the rows that the last stops may repeat; more is a measurement of its own."""
MANY_CENTRES: Final = 3000
JUDGED: Final = 1200
"""Unknowns up to which it is asked which centres of a place are off together."""


class PlateRows:
    """The rows of a model: three of each centre of a ``layout``, in the order of measurement.

    ``frame`` (n, 3, 3) takes machine coordinates to them. ``by_axis``: x and y have noise of
    their own. ``extra`` (3 n, q): columns of further unknowns, the drift and where the table
    stands at positions that the last stops measure once more.
    """

    def __init__(self, layout: PlateLayout, *, by_axis: bool = False) -> None:
        self.layout, self.problem = layout, layout.problem
        std = self.problem.std
        alike = std is None or bool((std[:, 0] == std[:, 1]).all())
        self.turned = alike and not by_axis
        self.frame = layout.radial if self.turned else np.eye(3)[None].repeat(len(layout.row), 0)
        self.time = self.problem.run_time[layout.row]
        self.drift = self.of(drift_columns(self.time, self.problem.drift))
        self.again = self._again()
        self.extra = np.hstack([self.drift, self.again])

    def of(self, displacements: Floats) -> Floats:
        """Return rows (3 n, k) of ``displacements`` (n, 3, k) in machine coordinates."""
        return np.asarray((self.frame @ displacements).reshape(3 * len(self.frame), -1))

    def _again(self) -> Floats:
        """Return what the closing rows feel of the table at their positions, (3 n, 6 k).

        Where a drift is estimated it explains what changed: then they are rows like others.
        """
        layout, again = self.layout, closing_rows(self.problem)[self.layout.row]
        closing = np.flatnonzero(again & (not self.problem.drift))
        spots, number = np.unique(layout.at[closing], return_inverse=True)
        felt = layout.rows[(3 * closing[:, None] + np.arange(3)).ravel()]
        found = np.zeros((len(layout.row), 3, len(spots), 6))
        for k, spot in enumerate(spots.tolist()):
            own = felt[:, spot + layout.counts[0] * np.arange(6)].toarray().reshape(-1, 3, 6)
            found[closing[number == k], :, k] = own[number == k]
        if not self.turned:
            found = np.einsum("nba,nbkj->nakj", layout.radial, found)
        return found.reshape(3 * len(layout.row), -1)

    def design(self) -> Design:
        """Return the design: by circles where these are complete and all centres weigh alike."""
        layout, problem = self.layout, self.problem
        circular = layout.circular if self.turned and problem.weighed_alike else None
        if circular is not None and isinstance(circular.kernel(), LowRankUpdateKernel):
            return circular.with_extra(self.extra)
        rows = layout.rows
        if not self.turned:
            rows = csr_array(block_diag(np.swapaxes(layout.radial, 1, 2), format="csr") @ rows)
        found = SparseDesign(rows, np.zeros((0, layout.unknowns)), groups=layout.by_place(rows))
        return found.with_extra(self.extra) if self.extra.size else found

    def computed(self, x: Floats) -> Floats:
        """Return what the unknowns make of the rows (3 n,)."""
        layout = self.layout
        centres = layout.computed(x)
        if not self.turned:
            centres = (np.swapaxes(layout.radial, 1, 2) @ centres[:, :, None])[:, :, 0]
        return np.asarray(centres.ravel() + self.extra @ x[layout.unknowns :])

    def noise(self, design: Design, misclosure: Floats) -> tuple[Floats, float]:
        """Return standard deviations (3 n,), m: as stated, else as a first fit shows them.

        Then with the least that is noise; that is zero of stated ones.
        """
        problem, n = self.problem, len(self.frame)
        if problem.std is not None:
            return problem.std[self.layout.row].ravel(), 0.0
        if problem.sigma is not None:
            return np.full(3 * n, problem.sigma), 0.0
        kernel = design.kernel() or DenseKernel.of(design, np.zeros(0, dtype=np.int64))
        x = ConstrainedKernel.of(kernel, self.layout.definitions).solve(misclosure)
        left, checked = np.abs(misclosure - design.times(x)), 1.0 - kernel.leverage
        every = left / np.sqrt(np.maximum(checked, ROUNDING)) / QUARTILE
        axial, least = np.tile([False, False, True], n), self.layout.neglected(x)
        found = [max(float(np.median(every[part])), least) for part in (~axial, axial)]
        return np.where(axial, found[1], found[0]), least


def closing_rows(problem: BallPlateProblem) -> Bools:
    """Return which rows (n,) the last stops repeat, so that what happened in between shows."""
    stop = problem.stop
    _, cell = np.unique(problem.cell, return_inverse=True)
    earliest = np.full(cell.max() + 1, np.iinfo(np.int64).max)
    np.minimum.at(earliest, cell, stop)
    repeated, again = stop > earliest[cell], np.zeros(len(stop), dtype=np.bool_)
    for last in range(int(stop.max()), 0, -1):  # from the end, while a stop mostly repeats
        here = stop == last
        if 2 * np.count_nonzero(repeated[here]) <= np.count_nonzero(here):
            break
        again |= here & repeated
    return again if again.sum() <= MOST_REPEATED * len(again) else np.zeros_like(again)


def drift_columns(run_time: Floats, degree: int) -> Floats:
    """Return the displacement (n, 3, 3 degree) of centres by a drift of 1 m over the run.

    ``run_time`` runs from -0.5 to 0.5. The linear part comes first, then the bow: 1 m more at
    both ends than in the middle.
    """
    shapes = np.stack([run_time, 4.0 * run_time**2], axis=1)[:, :degree]
    columns = shapes[:, None, :, None] * np.eye(3)[:, None, :]
    return columns.reshape(len(run_time), 3, 3 * degree)


def plate_motion(problem: BallPlateProblem) -> Floats:
    """Return what a motion of the plate on the table does to the centres, (n, 3, 6).

    Shifts along x, y, z and turns about them, times the radius, in the frame of the table at
    position 0.
    """
    x, y, _ = on_circle(problem.angles).T
    table, ball, place = problem.position, problem.ball_step, problem.cmm_index
    motion = np.zeros((len(table), 3, 6))
    motion[:, 0, 0], motion[:, 1, 0] = x[table], y[table]
    motion[:, 0, 1], motion[:, 1, 1] = -y[table], x[table]
    motion[:, 2, 2] = 1.0
    motion[:, 2, 3], motion[:, 2, 4] = y[ball], -x[ball]
    motion[:, 0, 5], motion[:, 1, 5] = -y[place], x[place]
    return motion


def plate_model(layout: PlateLayout, *, by_axis: bool = False) -> Model:
    """Return unknowns, centres and what could spoil them; outputs are the six deviations.

    ``by_axis`` as of :class:`PlateRows`.
    """
    rows, problem = PlateRows(layout, by_axis=by_axis), layout.problem
    n, (table, cmm, ball) = len(layout.row), layout.counts
    design, drifts, again = rows.design(), rows.drift.shape[1], rows.again.shape[1]
    observed = rows.of(problem.centres[layout.row][:, :, None]).ravel()

    def equations(x: Floats) -> tuple[Floats, Derivatives]:
        return rows.computed(x), design

    more = drifts + again
    start = np.zeros(layout.unknowns + more)
    std, least = rows.noise(design, observed - rows.computed(start))
    blocks = {"table shift": 3 * table, "table turn": 3 * table, "CMM": 3 * cmm, "ball": 3 * ball}
    blocks |= {name: k for name, k in (("drift", drifts), (AGAIN, again)) if k}
    curves = layout.curves()
    shape = (
        curves.shape[0],
        len(start),
    )  # they do not feel the unknowns behind those of the table
    found = Outputs.alone(csr_array((curves.data, curves.indices, curves.indptr), shape=shape))
    closing = np.eye(again, len(start), len(start) - again)
    relation = KnownRelation(NOT_CLOSED, np.eye(again, found.shape[0] + again, found.shape[0]))
    return Model(
        blocks=blocks,
        observed=observed,
        std=std,
        equations=equations,
        outputs=found,
        further={AGAIN: closing} if again else {},
        closures=[relation] if again else [],
        words=WORDS,
        unit=UM,
        components=IN_PLANE if rows.turned else BY_AXIS,
        component=np.tile([0, 0, 1] if rows.turned else [0, 1, 2], n),
        groupings=_groupings(rows),
        effects=_effects(rows),
        row_names=lambda row: problem.row_name(layout.row[row // 3]),
        element=np.repeat(np.arange(n), 3),
        definitions=np.pad(layout.definitions, ((0, 0), (0, more))),
        unstated=problem.std is None and problem.sigma is None,
        least=least,
        shared=("CMM", "ball"),
    )


def _groupings(rows: PlateRows) -> list[Grouping]:
    """Return what may be spoiled together: of a table position, a ball, a CMM position.

    Neighbours round the plate or the table are near each other; of large problems it is not
    asked which. What spoils a position moves balls alike in the machine's axes, what spoils a ball
    on the plate does so radially and tangentially.
    """
    layout = rows.layout
    problem, row = layout.problem, layout.row
    table, ball, place = (
        each[row] for each in (problem.position, problem.ball_step, problem.cmm_index)
    )
    circle = on_circle(problem.angles) if layout.unknowns <= JUDGED else None

    def grouping(kind: str, number: Ints, beside: Ints, frame: Floats) -> Grouping:
        if circle is None:
            return Grouping(kind, np.repeat(number, 3))
        frame = np.repeat(frame @ np.swapaxes(rows.frame, 1, 2), 3, axis=0)
        near = np.repeat(circle[beside], 3, axis=0)
        return Grouping(kind, np.repeat(number, 3), near=near, frame=frame)

    machine = np.eye(3)[None]
    of_ball = [] if circle is None else [grouping("ball step", ball, table, layout.radial)]
    cmm = Grouping("CMM position", np.repeat(place, 3))
    return [grouping("table position", table, ball, machine), *of_ball, cmm]


def _effects(rows: PlateRows) -> tuple[Disturbing, ...]:
    """Return what could spoil the centres: the CMM drifts, the plate moves, warms and grows."""
    problem, row = rows.problem, rows.layout.row
    n = len(row)
    count = MOMENTS if n <= MANY_CENTRES else MOMENTS // 4
    moments = np.unique(np.ceil((np.arange(count) + 0.5) / count * n).astype(np.int64))
    later = np.repeat(np.arange(n), 3)[:, None] >= moments
    moved = later[:, :, None] * rows.of(plate_motion(problem)[row])[:, None]
    places = problem.radius * on_circle(problem.angles[problem.cmm_index[row]])
    grown = rows.of((rows.time[:, None] * places)[:, :, None])
    found = (
        Disturbing("drift", "the origin of the CMM drifts", rows.of(drift_columns(rows.time, 1)),
                   LARGEST, UM),
        Disturbing("growth", GREW, grown, LARGEST_GROWTH, Unit("um/m", MICROMETRE)),
        Disturbing("knock", "the plate moved on the table", moved.reshape(3 * n, -1), LARGEST, UM,
                   family=True, of_each=6, stays=True, usual=RANDOM_MOMENTS,
                   stands_for=n / len(moments)),
    )  # fmt: skip
    return found[1:] if problem.drift else found


def curve_model(layout: PlateLayout, angles: Floats) -> CurveModel:
    """Return the centres over the six deviations at the table positions in use.

    ``angles``, rad, are those of all table positions. Nothing is said of what the centres leave
    open, for other instruments may determine it.
    """
    model, count = plate_model(layout), layout.counts[0]
    more = model.size[1] - layout.unknowns
    curves = np.pad(layout.curves().toarray(), ((0, 0), (0, more)))
    each = {name: curves[k * count : (k + 1) * count] for k, name in enumerate(COMPONENTS)}
    alone = replace(
        model, outputs=np.zeros((0, model.size[1])), further={}, closures=[], definitions=None,
        unstated=False, least=0.0,
    )  # fmt: skip
    return CurveModel(alone, angles[np.sort(layout.table_positions)], each)
