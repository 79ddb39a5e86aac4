"""The lengths from several places of a rigid table as a model of the engine: all six deviations.

A place q of the tracer stands at v + U (d + R(c) Rz(angle) q) while the table is at an angle;
lengths to the targets count from zeros. The poses d, m, and c, rad, are unknown at every angle, in
a frame (v, U) along the axis that the start values have. Places may move against each other, but
not all together: that is what the poses do. So nothing is open. The deviations are what is left of
the poses without their means and, of those across the axis, without what turns with the table.

Each arrival may scatter, by a shift and by a turn that moves a station at its arm. Of the six
motions one size and five mixtures are held to be possible; turns alone weigh most, for they move
the curves as much as shifts do and leave half the trace.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
from scipy.linalg import null_space
from scipy.sparse import csr_array, vstack

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
from rotcal_ros.adjust.outputs import Outputs
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.foundation.errors import ObservabilityError
from rotcal_ros.foundation.units import MICROMETRE, TURN
from rotcal_ros.geometry.rotations import cross_matrix, rotation_about_z, rotation_from_vector
from rotcal_ros.methods.tracer.solver.carried_lengths import LARGEST_MOVE, LARGEST_RATIO, WORDS
from rotcal_ros.methods.tracer_six.solver.curves import gauge_design, table_curves
from rotcal_ros.methods.tracer_six.solver.problem import SixProblem, StationLayout
from rotcal_ros.methods.tracer_six.solver.start import StartPoses

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
SCATTER, STATED = "scatter of an arrival", "stated scatter of an arrival"
"""The blocks of how far each station is off, when the table does not repeat."""
FELT: Final = 1.6
"""Times as much curves feel scatter as contrasts do: turns leave half the trace (six_coverage)."""
LEAST_LEVER: Final = 0.03
"""Share of the radius by which a line of places passes the axis for turns to show."""
ALIKE: Final = 1e-9
"""Share of the largest singular value below which one is rounding."""
NOTHING: Final = 1e-13
"""Share of the largest eigenvalue of a direction that the lengths leave open."""
CLOSES: Final = 1e-7
"""Rad by which angles that are whole turns apart may miss them."""


@dataclass(frozen=True, eq=False)
class SixLengths:
    """Lengths (k,), each a ``row`` of the problem, and where they were taken.

    ``station``, ``target``, ``order`` (k,): indices into those of the ``layout``, and when.
    ``axes`` U (3, 3), ``origin`` v (3,) m, ``places`` (p, 3) m, in the table's frame, ``targets``
    (n, 3), ``zeros`` (s,) m: start values, with ``shift`` and ``turn`` (m, 3). ``blocks``: the
    unknowns, ``shift`` and ``turn``, and changes of all others. ``place_ways`` (3 p, a),
    ``target_ways`` (3 n, b): how places and targets may move; None: in any way. ``lean_ways`` (4,
    c): how the axis may lean, in the machine and in the table, against the frames in which tilts
    are stated.
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
    blocks: dict[str, int]
    place_ways: Floats
    lean_ways: Floats
    target_ways: Floats | None = None

    @classmethod
    def of(cls, problem: SixProblem, layout: StationLayout, state: StartPoses) -> SixLengths:
        """Return those of a ``layout`` about the start values ``state``."""
        curves = table_curves(state.rotation, state.translation, layout.angles)
        station, target = np.nonzero(layout.grid.row >= 0)
        row, m, grid = layout.grid.row[station, target], len(layout.angles), layout.grid
        places = (state.places - curves.table_origin) @ curves.table_turn
        ways, lean = null_space(_rigid(places).T, rcond=ALIKE), np.eye(4)
        if ways.shape[1] + 6 > places.size:  # in a line: nothing shows how the table lies about it
            along = places[-1] - places[0]
            lean = null_space(np.array([[0.0, 0.0, *along[:2].tolist()]]))
        blocks = {
            "shift": 3 * m, "turn": 3 * m, "place": ways.shape[1], "zero": len(state.zeros),
            "target": grid.targets.size,
        }  # fmt: skip
        if problem.tilt_std is not None:
            blocks["lean"] = lean.shape[1]
        found = cls(
            layout, row, station, target, problem.measuring_order[row], curves.axes,
            curves.origin, places, grid.targets, state.zeros, curves.translation,
            curves.rotation, blocks, ways, lean,
        )  # fmt: skip
        if grid.free:
            ways = found._told_of_targets()
            blocks = blocks | {"target": ways.shape[1]}
            found = replace(found, blocks=blocks, target_ways=ways)
        if problem.scatter_translation_std == problem.scatter_rotation_std == 0.0:
            return found
        return replace(found, blocks=blocks | {SCATTER: 3 * len(layout.position)})

    def _told_of_targets(self) -> Floats:
        """Return the moves of targets (3 n, b) that lengths tell of, were there no deviations.

        Not how all stand, nor how all bend while places of one height draw together.
        """
        design = self.computed(np.zeros(sum(self.blocks.values())))[1]
        square = (design.T @ design).toarray()
        scale = np.sqrt(np.where(square.diagonal() > 0.0, square.diagonal(), 1.0))
        values, ways = np.linalg.eigh(square / scale / scale[:, None])
        at = self.first["target"]
        open_ = (ways[:, values < NOTHING * values[-1]] / scale[:, None])[
            at : at + self.targets.size
        ]
        return np.asarray(null_space(open_.T, rcond=ALIKE))

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
    def first(self) -> dict[str, int]:
        """Where the unknowns of each block begin."""
        ends = np.cumsum([0, *self.blocks.values()]).tolist()
        return dict(zip(self.blocks, ends, strict=False))

    def picked(self, block: str, begin: int = 0, step: int = 1) -> csr_array:
        """Return rows (k, p) that take unknowns of a block out of all: every ``step``-th."""
        which = self.first[block] + np.arange(begin, self.blocks[block], step)
        shape = len(which), sum(self.blocks.values())
        return csr_array((np.ones(len(which)), which, np.arange(len(which) + 1)), shape=shape)

    @cached_property
    def start(self) -> Floats:
        """The unknowns (p,) at the start values."""
        known = np.concatenate([self.shift.ravel(), self.turn.ravel()])
        return np.pad(known, (0, sum(self.blocks.values()) - len(known)))

    def part(self, x: Floats, block: str) -> Floats:
        """Return the unknowns of a block; of poses and points (k, 3)."""
        found = x[self.first[block] : self.first[block] + self.blocks[block]]
        if block == "zero":
            return found
        ways = {"place": self.place_ways, "target": self.target_ways}.get(block)
        return (found if ways is None else ways @ found).reshape(-1, 3)

    def stands(self, x: Floats) -> tuple[Floats, Floats, Floats]:
        """Return where the tracer stands (k, 3), arms R(c) Rz q (k, 3), R(c) Rz (k, 3, 3)."""
        turned = rotation_from_vector(self.part(x, "turn"))
        carry = (turned @ rotation_about_z(self.layout.angles))[self.position]
        arm = (carry @ (self.places + self.part(x, "place"))[self.place][:, :, None])[:, :, 0]
        out = self.part(x, "shift")[self.position] + arm
        stands = self.origin + out @ self.axes.T
        if SCATTER in self.blocks:
            stands = stands + self.part(x, SCATTER)[self.station]
        return stands, arm, carry

    def computed(self, x: Floats) -> tuple[Floats, csr_array]:
        """Return the lengths (k,) and their derivatives (k, p) at the unknowns."""
        stands, arm, carry = self.stands(x)
        first, k = self.first, len(self.row)
        away = stands - (self.targets + self.part(x, "target"))[self.target]
        distance = np.linalg.norm(away, axis=1)
        unit = away / distance[:, None]
        felt = unit @ self.axes
        further = _slope(self.part(x, "turn"))[self.position]
        parts = [
            ("shift", self.position, felt, None),
            ("turn", self.position, np.einsum("ki,kij->kj", np.cross(arm, felt), further), None),
            ("place", self.place, np.einsum("ki,kij->kj", felt, carry), self.place_ways),
            ("zero", self.zero, np.full((k, 1), -1.0), None),
            ("target", self.target, -unit, self.target_ways),
        ]
        if SCATTER in self.blocks:
            parts.append((SCATTER, self.station, unit, None))
        columns, values = list[Ints](), list[Floats]()
        for block, number, rows, ways in parts:
            if ways is None:
                size = rows.shape[1]
                columns.append(first[block] + size * number[:, None] + np.arange(size))
            else:
                size = ways.shape[1]
                columns.append(np.broadcast_to(first[block] + np.arange(size), (k, size)))
                rows = np.einsum("ki,kij->kj", rows, ways.reshape(-1, 3, size)[number])
            values.append(rows)
        column, value = np.hstack(columns), np.hstack(values)
        begin = np.arange(k + 1) * column.shape[1]
        shape = (k, sum(self.blocks.values()))
        design = csr_array((value.ravel(), column.ravel(), begin), shape=shape)
        zero = self.zeros + self.part(x, "zero")
        return distance - zero[self.zero], design

    @cached_property
    def at_start(self) -> tuple[Floats, Floats]:
        """What lengths feel (k, 3) of a move of the tracer in the machine, and its arms (k, 3)."""
        stands, arm, _ = self.stands(self.start)
        away = stands - self.targets[self.target]
        return away / np.linalg.norm(away, axis=1)[:, None], arm @ self.axes.T


def _rigid(points: Floats) -> Floats:
    """Return what shifts and turns of all do to ``points`` (k, 3), as columns (3 k, 6)."""
    turns = -cross_matrix(points - points.mean(axis=0))
    shifts = np.broadcast_to(np.eye(3), turns.shape)
    return np.concatenate([shifts, turns], axis=2).reshape(-1, 6)


def model_of(problem: SixProblem, lengths: SixLengths) -> Model:
    """Return the model of all that the lengths and what is stated say."""
    layout, grid = lengths.layout, lengths.layout.grid
    unit, arm = lengths.at_start
    stations = [layout.station_name(k) for k in range(len(layout.position))]
    when, effects = lengths.order.astype(np.float64), effects_of(lengths)
    slips = [e for e in effects if e.effect == "slip"]
    if not problem.slip or problem.zero == "per_station":
        slips = []
    model = Model(
        blocks=lengths.blocks,
        observed=grid.length[lengths.station, lengths.target],
        std=grid.length_std[lengths.station, lengths.target],
        equations=lengths.computed,
        start=lengths.start,
        outputs=_curves(lengths),
        words=WORDS,
        unit=UM,
        components=["the lengths"],
        groupings=[
            Grouping("station", lengths.station, near=unit),
            Grouping("target", lengths.target, when),
        ],
        effects=effects,
        row_names=[
            f"{stations[s]}, target {grid.target_ids[t]}"
            for s, t in zip(lengths.station.tolist(), lengths.target.tolist(), strict=True)
        ],
        shared=("place", "zero", "target", "lean"),
        expected=[Expected(each, problem.slip, SLIPPED) for each in slips],
        closures=_closures(problem, lengths),
    )
    for axis in range(0 if grid.free else 3):
        rows = lengths.picked("target", axis, 3)
        std = np.maximum(grid.target_std[:, axis], KNOWN)
        model = model.with_prior(f"the targets along {'xyz'[axis]}", rows, np.zeros(len(std)), std)
    if problem.tilt_std is not None:
        lean = gauge_design(layout.angles)[0] @ lengths.lean_ways
        rows = vstack([lengths.picked("turn", axis, 3) for axis in range(2)], format="csr")
        rows = rows - np.concatenate([lean[::2], lean[1::2]]) @ lengths.picked("lean")
        none = np.zeros(rows.shape[0])
        model = model.with_prior("the tilts", csr_array(rows), none, problem.tilt_std)
    if SCATTER not in lengths.blocks:
        return model
    arms = np.zeros((len(stations), 3))
    arms[lengths.station] = arm
    return _scattering(problem, lengths, model, arms)


def _scattering(problem: SixProblem, lengths: SixLengths, model: Model, arms: Floats) -> Model:
    """Return the model whose stations, at ``arms`` (V, 3), scatter from arrival to arrival."""
    shift, turn = problem.scatter_translation_std, problem.scatter_rotation_std
    places = lengths.places - lengths.places.mean(axis=0)
    radius = float(np.sqrt((places**2).sum() / len(places)))
    size, possible = None, [(1.0, [0.0, 1.0 / radius] if turn is None else [1.0, 0.0])]
    if shift is None and turn is None:
        mixed = np.column_stack([np.cos(MIXTURES), np.sin(MIXTURES) / radius]).tolist()
        possible = list(zip(MIXTURE_PRIOR, mixed, strict=True))
    elif shift is not None and turn is not None:
        size, possible = 1.0, [(1.0, [shift, turn])]
    elif shift or turn:  # beside what is stated of one the other is estimated
        root = roots_of(shift or 0.0, turn or 0.0, arms).reshape(len(arms), 3, -1)
        felt = (lengths.at_start[0][:, None] @ root[lengths.station])[:, 0]
        model = model.with_unknowns(STATED, felt)
        rows = csr_array(block_rows(model.blocks, STATED))
        model = model.with_prior("the stated scatter", rows, np.zeros(arms.size), 1.0)
    if turn is None and shift is not None:
        _require_seen(lengths.places, radius)
    ways = [(share, roots_of(along, about, arms)) for share, (along, about) in possible]
    rows = csr_array(block_rows(model.blocks, SCATTER))
    return model.scattering("the arrivals", rows, size, LARGEST_SCATTER, ways, influence=FELT)


def _require_seen(places: Floats, radius: float) -> None:
    """Raise ObservabilityError where turns of the table change no distance between ``places``."""
    first, second = np.triu_indices(len(places), 1)
    along = places[second] - places[first]
    along /= np.linalg.norm(along, axis=1)[:, None]
    if np.linalg.norm(np.cross(places[first], along), axis=1).max() < LEAST_LEVER * radius:
        raise ObservabilityError(
            "no distance between the places shows how the table scatters from run to run: state "
            "scatter_translation_std and scatter_rotation_std, or measure from three places"
        )


def _curves(lengths: SixLengths) -> Outputs:
    """Return the six curves (6 m, p): poses less their means, and less parts that turn."""
    angles, p, found = lengths.layout.angles, sum(lengths.blocks.values()), []
    design, inverse = gauge_design(angles)  # (2 m, 4), (4, 2 m)
    for block in ("shift", "turn"):
        picked = [lengths.picked(block, axis, 3) for axis in range(3)]
        common = np.zeros((5, p))
        common[:4] = inverse[:, ::2] @ picked[0] + inverse[:, 1::2] @ picked[1]
        common[4] = picked[2].sum(axis=0) / len(angles)
        share = np.zeros((3, len(angles), 5))
        share[0, :, :4], share[1, :, :4], share[2, :, 4] = -design[::2], -design[1::2], -1.0
        few = csr_array(vstack(picked, format="csr"))
        found.append(Outputs(few, common, share.reshape(-1, 5)))
    return Outputs.of(found)


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
    unit, arm = lengths.at_start
    once, when = np.zeros_like(lengths.order), lengths.order.astype(np.float64)
    distance = lengths.computed(lengths.start)[0]
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
    height = lengths.targets[lengths.target, 2] + lengths.origin[2] + arm[:, 2]
    air = distance * (0.5 * height - 0.5 * height.mean())
    return (
        Disturbing("drift", "the machine drifts", gone * machine, LARGEST_MOVE, UM),
        Disturbing("drift", "the machine drifts in each run alike", again, LARGEST_MOVE, UM),
        Disturbing("drift", "the machine stands elsewhere in one run than in another", elsewhere,
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
