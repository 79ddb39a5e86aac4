"""The lengths from several places of a rigid table as a model of the engine: all six deviations.

A place q of the tracer stands at v + U (d + R(c) Rz(angle) q) while the table is at an angle, with
its deviations d, m, and c, rad; lengths to the targets count from zeros. The axis (v, U) and the
places are unknown, too: what leans or shifts the machine, or the table's own frame, is open, and
the definition of the deviations fixes it. They have no mean and, of those across the axis, no part
that turns with the table.

Each arrival may scatter, by a shift and by a turn that moves a station at its arm. Of the six
motions one size and five mixtures are held to be possible; turns alone weigh most, for they move
the curves as much as shifts do and leave half the trace.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
from scipy.sparse import csr_array

from rotcal_ros.adjust.model import (
    Disturbing,
    Expected,
    Grouping,
    KnownRelation,
    Model,
    Steps,
    Unit,
    block_rows,
    drifts,
)
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.foundation.units import MICROMETRE, TURN
from rotcal_ros.geometry.rotations import cross_matrix, rotation_about_z, rotation_from_vector
from rotcal_ros.methods.tracer.solver.protections import LARGEST_MOVE, LARGEST_RATIO
from rotcal_ros.methods.tracer.solver.screening import WORDS
from rotcal_ros.methods.tracer_six.solver.curves import gauge_design, table_curves
from rotcal_ros.methods.tracer_six.solver.problem import SixProblem, StationLayout
from rotcal_ros.methods.tracer_six.solver.start import Start

UM: Final = Unit("um", MICROMETRE)
PPM: Final = Unit("um/m", 1e-6)
SLIPPED: Final = 0.5
"""Probability that a measurement holds a slip."""
KNOWN: Final = 1e-9
"""Standard deviation, m, of what is stated to be exact."""
LARGEST_SCATTER: Final = 1e-5
"""Scatter, m, that nobody would overlook."""
MIXTURES: Final = np.radians([0.0, 22.5, 45.0, 67.5, 90.0])
"""Direction of (shift, turn times radius): from shifts alone to turns alone."""
MIXTURE_PRIOR: Final = (0.1, 0.05, 0.05, 0.1, 0.7)
"""How likely each is beforehand."""
CLOSES: Final = 1e-7
"""Rad by which angles that are whole turns apart may miss them."""


@dataclass(frozen=True, eq=False)
class SixLengths:
    """Lengths (k,) in the order of the problem's ``row`` (k,), and where they were taken.

    ``position``, ``station``, ``place``, ``target``, ``zero`` (k,): indices into those of the
    ``layout``, ``order`` (k,): when. ``axes`` U (3, 3), ``origin`` v (3,) m, ``places`` (p, 3) m,
    in the table's frame, ``targets`` (n, 3), ``zeros`` (s,) m: start values, with ``shift`` and
    ``turn`` (m, 3).
    """

    layout: StationLayout
    row: Ints
    station: Ints
    target: Ints
    order: Ints
    axes: Floats
    origin: Floats
    places: Floats
    targets: Floats
    zeros: Floats
    shift: Floats
    turn: Floats

    @classmethod
    def of(cls, problem: SixProblem, layout: StationLayout, state: Start) -> SixLengths:
        """Return those of a ``layout`` about the start values ``state``."""
        curves = table_curves(state.rotation, state.translation, layout.angles)
        station, target = np.nonzero(layout.grid.row >= 0)
        row = layout.grid.row[station, target]
        first = np.argsort(row)
        row = row[first]
        return cls(
            layout, row, station[first], target[first], problem.measuring_order[row],
            curves.axes, curves.origin, (state.places - curves.table_origin) @ curves.table_turn,
            layout.grid.targets, state.zeros, curves.translation, curves.rotation,
        )  # fmt: skip

    @cached_property
    def position(self) -> Ints:
        """Table position (k,) of each length."""
        return self.layout.position[self.station]

    @cached_property
    def place(self) -> Ints:
        """Place (k,) of each length."""
        return self.layout.place[self.station]

    @cached_property
    def zero(self) -> Ints:
        """Zero (k,) of each length."""
        return self.layout.zero[self.station, self.target]

    @cached_property
    def blocks(self) -> dict[str, int]:
        """The unknowns, all changes of the start values."""
        m = len(self.layout.angles)
        return {
            "shift": 3 * m, "turn": 3 * m, "place": self.places.size, "zero": len(self.zeros),
            "target": self.targets.size, "axis": 4, "lean": 4,
        }  # fmt: skip

    @cached_property
    def first(self) -> dict[str, int]:
        """Where the unknowns of each block begin."""
        ends = np.cumsum([0, *self.blocks.values()]).tolist()
        return dict(zip(self.blocks, ends, strict=False))

    def rows_of(self, block: str) -> Floats:
        """Return rows that take the unknowns of a block out of all."""
        return block_rows(self.blocks, block)

    def stands(self, x: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """Return where the tracer stands (k, 3), axes U (3, 3), arms (k, 3), R(c) Rz (k, 3, 3)."""
        parts = np.split(x, np.cumsum(list(self.blocks.values()))[:-1])
        shift, turn, place, _, _, axis, _ = parts
        axes = self.axes @ rotation_from_vector(np.array([axis[2], axis[3], 0.0]))
        c = self.turn + turn.reshape(-1, 3)
        carry = (rotation_from_vector(c) @ rotation_about_z(self.layout.angles))[self.position]
        arm = (carry @ (self.places + place.reshape(-1, 3))[self.place][:, :, None])[:, :, 0]
        out = (self.shift + shift.reshape(-1, 3))[self.position] + arm
        origin = self.origin + np.array([axis[0], axis[1], 0.0])
        return origin + out @ axes.T, axes, arm, carry

    def computed(self, x: Floats) -> tuple[Floats, csr_array]:
        """Return the lengths (k,) and their derivatives (k, p) at the unknowns."""
        stands, axes, arm, carry = self.stands(x)
        first, k = self.first, len(self.row)
        c = self.turn + x[first["turn"] : first["place"]].reshape(-1, 3)
        moved_target = x[first["target"] : first["axis"]].reshape(-1, 3)
        away = stands - (self.targets + moved_target)[self.target]
        distance = np.linalg.norm(away, axis=1)
        unit = away / distance[:, None]
        felt = unit @ axes
        turned = np.einsum("ki,kij->kj", np.cross(arm, felt), _slope(c)[self.position])
        axis = x[first["axis"] : first["lean"]]
        lean = np.array([axis[2], axis[3], 0.0])
        out = (stands - self.origin - np.array([axis[0], axis[1], 0.0])) @ self.axes
        leaned = (np.cross(out, unit @ self.axes) @ _slope(lean))[:, :2]
        parts = (
            ("shift", self.position, felt),
            ("turn", self.position, turned),
            ("place", self.place, np.einsum("ki,kij->kj", felt, carry)),
            ("zero", self.zero, np.full((k, 1), -1.0)),
            ("target", self.target, -unit),
            ("axis", np.zeros(k, dtype=np.int64), np.hstack([unit[:, :2], leaned])),
        )
        columns = [
            first[block] + rows.shape[1] * index[:, None] + np.arange(rows.shape[1])
            for block, index, rows in parts
        ]
        column, value = np.hstack(columns), np.hstack([rows for _, _, rows in parts])
        begin = np.arange(k + 1) * column.shape[1]
        shape = (k, sum(self.blocks.values()))
        design = csr_array((value.ravel(), column.ravel(), begin), shape=shape)
        zero = self.zeros + x[first["zero"] : first["target"]]
        return distance - zero[self.zero], design

    @cached_property
    def at_start(self) -> tuple[Floats, Floats]:
        """What lengths feel (k, 3) of a move of the tracer in the machine, and its arms (k, 3)."""
        x = np.zeros(sum(self.blocks.values()))
        stands, axes, arm, _ = self.stands(x)
        away = stands - self.targets[self.target]
        return away / np.linalg.norm(away, axis=1)[:, None], arm @ axes.T

    def of_stations(self, columns: Floats) -> Floats:
        """Return what moves (k, 3) of each station's lengths by itself are, (k, 3 V)."""
        k, v = len(columns), len(self.layout.position)
        found = np.zeros((k, v, 3))
        found[np.arange(k), self.station] = columns
        return found.reshape(k, 3 * v)


def model_of(problem: SixProblem, lengths: SixLengths) -> Model:
    """Return the model of all that the lengths and what is stated say."""
    layout, m = lengths.layout, len(lengths.layout.angles)
    grid = layout.grid
    unit, arm = lengths.at_start
    names = [
        f"{layout.station_name(s)}, target {grid.target_ids[t]}"
        for s, t in zip(lengths.station.tolist(), lengths.target.tolist(), strict=True)
    ]
    when = lengths.order.astype(np.float64)
    model = Model(
        blocks=lengths.blocks,
        observed=grid.length[lengths.station, lengths.target],
        std=grid.length_std[lengths.station, lengths.target],
        equations=lengths.computed,
        outputs=np.concatenate(
            [lengths.rows_of(b)[a::3] for b in ("shift", "turn") for a in range(3)]
        ),
        words=WORDS,
        unit=UM,
        components=["the lengths"],
        groupings=[
            Grouping("station", lengths.station, near=unit),
            Grouping("target", lengths.target, when),
        ],
        effects=effects_of(lengths),
        row_names=names,
        definitions=_definitions(lengths),
        shared=("place", "zero", "target", "axis", "lean"),
        closures=_closures(problem, lengths),
    )
    size = model.size[1]

    def wide(rows: Floats) -> csr_array:
        return csr_array(np.pad(rows, ((0, 0), (0, size - rows.shape[1]))))

    if problem.slip and problem.zero != "per_station":
        slips = next(e for e in model.effects if e.effect == "slip")
        model = replace(model, expected=[Expected(slips, problem.slip, SLIPPED)])
    scatters = problem.scatter_translation_std != 0.0 or problem.scatter_rotation_std != 0.0
    if scatters:
        model = model.with_unknowns("scatter of an arrival", lengths.of_stations(unit))
        size = model.size[1]
    if not grid.free:
        for axis in range(3):
            rows = wide(lengths.rows_of("target")[axis::3])
            std = np.maximum(grid.target_std[:, axis], KNOWN)
            model = model.knowing(
                f"the targets along {'xyz'[axis]}", rows, np.zeros(len(std)), std
            )
    if problem.tilt_std is not None:
        tilts = lengths.rows_of("turn").reshape(m, 3, -1)[:, :2].reshape(2 * m, -1)
        lean = gauge_design(layout.angles)[0] @ lengths.rows_of("lean")
        start = lengths.turn[:, :2].ravel()
        model = model.knowing("the tilts", wide(tilts - lean), -start, problem.tilt_std)
    return _with_scatter(problem, lengths, model, arm) if scatters else model


def _definitions(lengths: SixLengths) -> Floats:
    """Return rows of what the deviations have none of: means, and parts that turn."""
    m, found = len(lengths.layout.angles), []
    in_plane = gauge_design(lengths.layout.angles)[1]  # (4, 2 m)
    for block in ("shift", "turn"):
        rows = lengths.rows_of(block).reshape(m, 3, -1)
        found += [in_plane @ rows[:, :2].reshape(2 * m, -1), rows[:, 2].mean(axis=0)[None]]
    if lengths.layout.grid.free:  # and the targets, as a whole, stay where they are
        rows = lengths.rows_of("target").reshape(len(lengths.targets), 3, -1)
        apart = cross_matrix(lengths.targets - lengths.targets.mean(axis=0))
        found += [rows.sum(axis=0), np.einsum("nij,njp->ip", apart, rows)]
    return np.concatenate(found)


def _with_scatter(problem: SixProblem, lengths: SixLengths, model: Model, arm: Floats) -> Model:
    """Return the model whose stations scatter from arrival to arrival, its last unknowns."""
    shift, turn = problem.scatter_translation_std, problem.scatter_rotation_std
    places = lengths.places - lengths.places.mean(axis=0)
    arms = np.zeros((len(lengths.layout.position), 3))
    arms[lengths.station] = arm
    radius = float(np.sqrt((places**2).sum() / len(places)))
    before = model.size[1] - arms.size
    known = csr_array(np.eye(arms.size, model.size[1], before))
    name = "the scatter of arrivals"
    if shift is not None and turn is not None:
        ways = [(1.0, roots_of(shift, turn, arms))]
        return model.scattering(name, known, 1.0, LARGEST_SCATTER, ways)
    mixtures = np.column_stack([np.cos(MIXTURES), np.sin(MIXTURES) / radius])
    ways = [
        (share, roots_of(along, about, arms))
        for share, (along, about) in zip(MIXTURE_PRIOR, mixtures.tolist(), strict=True)
    ]
    return model.scattering(name, known, None, LARGEST_SCATTER, ways)


def _slope(vector: Floats) -> Floats:
    """Return how R(c) turns further with its vector c (..., 3), to the third order of it."""
    across = cross_matrix(vector)
    return np.asarray(np.eye(3) + 0.5 * across + across @ across / 6.0)


def roots_of(shift: float, turn: float, arms: Floats) -> Floats:
    """Return the root (3 V, 3 V) of what a ``shift`` (m) and a ``turn`` (rad) do at ``arms``."""
    across = cross_matrix(arms)
    square = shift**2 * np.eye(3) + turn**2 * across @ across.swapaxes(1, 2)
    values, vectors = np.linalg.eigh(square)
    each = vectors * np.sqrt(np.maximum(values, 0.0))[:, None]
    v = len(arms)
    found = np.zeros((v, 3, v, 3))
    found[np.arange(v), :, np.arange(v)] = each
    return found.reshape(3 * v, 3 * v)


def effects_of(lengths: SixLengths) -> tuple[Disturbing, ...]:
    """Return what could spoil the lengths."""
    unit, _ = lengths.at_start
    once, when = np.zeros_like(lengths.order), lengths.order.astype(np.float64)
    distance = lengths.computed(np.zeros(sum(lengths.blocks.values())))[0]
    distance = distance + lengths.zeros[lengths.zero]
    reach = float(np.linalg.norm(lengths.targets, axis=1).max())
    turned = np.einsum("ki,kij->kj", unit, cross_matrix(lengths.targets / reach)[lengths.target])
    machine = np.hstack([-unit, turned])  # shifts, and turns times the reach
    runs, gone = drifts(lengths.place, when), drifts(once, when)
    again = (runs.sum(axis=1)[:, None] * machine) if runs.size else np.zeros((len(when), 0))
    later = lengths.place[:, None] == np.arange(1, len(lengths.places))
    elsewhere = (later[:, :, None] * -unit[:, None]).reshape(len(unit), -1)
    moves = np.einsum(
        "ki,kij->kj",
        unit @ lengths.axes,
        rotation_about_z(lengths.layout.angles)[lengths.position],
    )
    _, _, arm, _ = lengths.stands(np.zeros(sum(lengths.blocks.values())))
    height = lengths.targets[lengths.target, 2] + lengths.origin[2] + arm[:, 2]
    air = distance * (0.5 * height - 0.5 * height.mean())
    return (
        Disturbing("drift", "the machine drifts", gone * machine, LARGEST_MOVE, UM),
        Disturbing("drift", "the machine drifts in each run alike", again, LARGEST_MOVE, UM),
        Disturbing("drift", "the machine stands elsewhere in one run than in another,", elsewhere,
                   LARGEST_MOVE, UM),
        Disturbing("knock", "the tracer slipped on the table", Steps(lengths.place, when, moves),
                   LARGEST_MOVE, UM, family=True),
        Disturbing("slip", "lengths shifted", Steps(lengths.zero, when), LARGEST_MOVE, UM,
                   family=True),
        Disturbing("scale", "the scale of the lengths is wrong", distance[:, None], LARGEST_RATIO,
                   PPM),
        Disturbing("refraction", "air in layers bends the beams", air[:, None], LARGEST_RATIO,
                   PPM),
    )  # fmt: skip


def _closures(problem: SixProblem, lengths: SixLengths) -> list[KnownRelation]:
    """Return what should agree where the table came to an angle again, from the same side."""
    angles, m = lengths.layout.angles, len(lengths.layout.angles)
    side = np.zeros(m) if problem.upward is None else problem.upward[lengths.layout.position_ids]
    found = []
    for last in range(1, m):
        apart = (angles[last] - angles[:last]) / TURN
        same = np.flatnonzero((np.abs(apart - np.round(apart)) * TURN < CLOSES)
                              & (side[:last] == side[last]))  # fmt: skip
        for first in same[:1].tolist():
            for c, name in enumerate(COMPONENTS):
                rows = np.zeros((1, 6 * m))
                rows[0, c * m + last], rows[0, c * m + first] = 1.0, -1.0
                ids = lengths.layout.position_ids[[first, last]].tolist()
                what = f"{name} at positions {ids[0]} and {ids[1]}, whole turns apart, differs"
                found.append(KnownRelation(what, rows))
    return found
