"""The lengths from several places of a rigid table as a model of the engine: all six deviations.

The poses d, m, and c, rad, of :mod:`~rotcal_ros.methods.tracer.solver.carried_lengths` are unknown
at every angle, in a frame (v, U) along the axis that the start values have. Places may move
against each other, but not all together: that is what the poses do. So nothing is open. The
deviations are what is left of the poses without their means and, of those across the axis, without
what turns with the table.

Each arrival may scatter, by a shift and by a turn that moves a station at its arm. Of the six
motions one size and five mixtures are held to be possible; turns alone weigh most, for they move
the curves as much as shifts do and leave half the trace.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np
from scipy.linalg import null_space
from scipy.sparse import csr_array, vstack

from rotcal_ros.adjust.closures import coming_again
from rotcal_ros.adjust.model import (
    Disturbing,
    Expected,
    Grouping,
    KnownRelation,
    Model,
    Steps,
    block_rows,
    drifts,
)
from rotcal_ros.adjust.outputs import Outputs
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.foundation.errors import ObservabilityError
from rotcal_ros.foundation.language import phrase
from rotcal_ros.geometry.rotations import cross_matrix, rotation_about_z
from rotcal_ros.methods.tracer.solver.carried_lengths import (
    KNOWN,
    LARGEST_MOVE,
    LARGEST_RATIO,
    PPM,
    SCATTER,
    UM,
    WORDS,
    CarriedLengths,
    taken,
)
from rotcal_ros.methods.tracer_six.solver.poses import StartPoses, gauge_design, table_curves
from rotcal_ros.methods.tracer_six.solver.problem import SixProblem, StationLayout

SLIPPED: Final = 0.5
"""Probability that a measurement holds a slip."""
LARGEST_SCATTER: Final = 1e-5
"""Scatter, m, that nobody would overlook."""
MIXTURES: Final = np.radians([0.0, 22.5, 45.0, 67.5, 90.0])
"""Direction of (shift, turn times radius): from shifts alone to turns alone."""
MIXTURE_PRIOR: Final = (0.1, 0.05, 0.05, 0.1, 0.7)
"""How likely each is beforehand."""
STATED: Final = "stated scatter of an arrival"
"""The block of what is stated of it, where a part is not."""
FELT: Final = 1.6
"""Times as much curves feel scatter as contrasts do: turns leave half the trace (six_coverage)."""
LEAST_LEVER: Final = 0.03
"""Share of the radius by which a line of places passes the axis for turns to show."""
ALIKE: Final = 1e-9
"""Share of the largest singular value below which one is rounding."""
NOTHING: Final = 1e-13
"""Share of the largest eigenvalue of a direction that the lengths leave open."""


def lengths_of(problem: SixProblem, layout: StationLayout, state: StartPoses) -> CarriedLengths:
    """Return the lengths of a ``layout`` about the start values ``state``.

    In a frame along the axis. Places move against each other, and targets in any way that lengths
    tell of.
    """
    curves, grid = table_curves(state.rotation, state.translation, layout.angles), layout.grid
    strip, target, order = taken(grid.row, problem.measuring_order)
    station, row = grid.station[strip], grid.row[strip, target]
    places = (state.places - curves.table_origin) @ curves.table_turn
    more = {}
    if problem.tilt_std is not None:
        more["lean"] = lean_ways(places).shape[1]
    if not problem.scatter_translation_std == problem.scatter_rotation_std == 0.0:
        more[SCATTER] = 3 * len(layout.position)
    found = CarriedLengths(
        observed=grid.length[strip, target],
        std=grid.length_std[strip, target],
        position=layout.position[station],
        place=layout.place[station],
        target=target,
        zero=(grid.station if grid.zero is None else grid.zero)[strip],
        row=row,
        order=order,
        station=station,
        angles=layout.angles,
        places=places,
        targets=grid.targets,
        zeros=state.zeros,
        axes=curves.axes,
        origin=curves.origin,
        place_ways=null_space(_rigid(places).T, rcond=ALIKE),
        turning=(0, 1, 2),
        poses=(curves.translation, curves.rotation),
    )
    ways = _told_of_targets(found) if grid.free else None
    return replace(found, target_ways=ways, more=more)


def lean_ways(places: Floats) -> Floats:
    """Return how the axis may lean (4, c), in the machine and in the table, m.

    Against the frames in which tilts are stated. Places in a line do not show how the table lies
    about it.
    """
    if null_space(_rigid(places).T, rcond=ALIKE).shape[1] + 6 == places.size:
        return np.eye(4)
    along = places[-1] - places[0]
    return np.asarray(null_space(np.array([[0.0, 0.0, *along[:2].tolist()]])))


def _told_of_targets(lengths: CarriedLengths) -> Floats:
    """Return the moves of targets (3 n, b) that lengths tell of, were there no deviations.

    Not how all stand, nor how all bend while places of one height draw together.
    """
    design = lengths.computed(np.zeros(lengths.size))[1]
    square = (design.T @ design).toarray()
    scale = np.sqrt(np.where(square.diagonal() > 0.0, square.diagonal(), 1.0))
    values, ways = np.linalg.eigh(square / scale / scale[:, None])
    left = (ways[:, values < NOTHING * values[-1]] / scale[:, None])[lengths.first["target"] :]
    return np.asarray(null_space(left.T, rcond=ALIKE))


def _rigid(points: Floats) -> Floats:
    """Return what shifts and turns of all do to ``points`` (k, 3), as columns (3 k, 6)."""
    turns = -cross_matrix(points - points.mean(axis=0))
    shifts = np.broadcast_to(np.eye(3), turns.shape)
    return np.concatenate([shifts, turns], axis=2).reshape(-1, 6)


def model_of(problem: SixProblem, layout: StationLayout, lengths: CarriedLengths) -> Model:
    """Return the model of all that the lengths and what is stated say."""
    grid, when = layout.grid, lengths.order.astype(np.float64)
    names = [problem.station_name(k) for k in grid.position_ids.tolist()]
    effects = effects_of(lengths)
    slips = [e for e in effects if e.effect == "slip"]
    if not problem.slip or problem.zero == "per_station":
        slips = []
    pairs = zip(lengths.station.tolist(), grid.target_ids[lengths.target].tolist(), strict=True)
    model = Model(
        blocks=lengths.blocks,
        observed=lengths.observed,
        std=lengths.std,
        equations=lengths.computed,
        start=lengths.start,
        outputs=_curves(lengths),
        words=WORDS,
        unit=UM,
        components=["the lengths"],
        groupings=[
            Grouping("station", grid.position_ids[lengths.station], near=-lengths.toward),
            Grouping("target", grid.target_ids[lengths.target], when),
        ],
        effects=effects,
        row_names=[phrase("{0}, target {1}", names[s], t) for s, t in pairs],
        shared=("place", "zero", "target", "lean"),
        expected=[Expected(each, problem.slip, SLIPPED) for each in slips],
        closures=_closures(problem, layout),
    )
    for axis in range(0 if grid.free else 3):
        rows = lengths.rows_of("target", slice(axis, None, 3))
        std = np.maximum(grid.target_std[:, axis], KNOWN)
        model = model.with_prior(
            phrase("the targets along {0}", "xyz"[axis]), rows, np.zeros(len(std)), std
        )
    if problem.tilt_std is not None:
        lean = gauge_design(layout.angles)[0] @ lean_ways(lengths.places)
        tilts = [lengths.rows_of("turn", slice(axis, None, 3)) for axis in range(2)]
        rows = vstack(tilts, format="csr")
        rows = rows - np.concatenate([lean[::2], lean[1::2]]) @ lengths.rows_of("lean")
        none = np.zeros(rows.shape[0])
        model = model.with_prior("the tilts", csr_array(rows), none, problem.tilt_std)
    return _scattering(problem, lengths, model) if SCATTER in lengths.blocks else model


def _scattering(problem: SixProblem, lengths: CarriedLengths, model: Model) -> Model:
    """Return the model whose stations scatter from arrival to arrival."""
    arms = np.zeros((lengths.blocks[SCATTER] // 3, 3))
    arms[lengths.station] = lengths.stands(lengths.start)[1] @ lengths.axes.T
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
        felt = -(lengths.toward[:, None] @ root[lengths.station])[:, 0]
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


def _curves(lengths: CarriedLengths) -> Outputs:
    """Return the six curves (6 m, p): poses less their means, and less parts that turn."""
    angles, found = lengths.angles, []
    design, inverse = gauge_design(angles)  # (2 m, 4), (4, 2 m)
    for block in ("shift", "turn"):
        picked = [lengths.rows_of(block, slice(axis, None, 3)) for axis in range(3)]
        common = np.zeros((5, lengths.size))
        common[:4] = inverse[:, ::2] @ picked[0] + inverse[:, 1::2] @ picked[1]
        common[4] = picked[2].sum(axis=0) / len(angles)
        share = np.zeros((3, len(angles), 5))
        share[0, :, :4], share[1, :, :4], share[2, :, 4] = -design[::2], -design[1::2], -1.0
        few = csr_array(vstack(picked, format="csr"))
        found.append(Outputs(few, common, share.reshape(-1, 5)))
    return Outputs.of(found)


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


def effects_of(lengths: CarriedLengths) -> tuple[Disturbing, ...]:
    """Return what could spoil the lengths."""
    toward = lengths.toward
    once, when = np.zeros_like(lengths.order), lengths.order.astype(np.float64)
    reach = float(np.linalg.norm(lengths.targets, axis=1).max())
    spin = cross_matrix(lengths.targets / reach)[lengths.target]
    machine = np.hstack([toward, -np.einsum("ki,kij->kj", toward, spin)])  # turns times the reach
    runs, gone = drifts(lengths.place, when), drifts(once, when)
    again = (runs.sum(axis=1)[:, None] * machine) if runs.size else np.zeros((len(when), 0))
    later = lengths.place[:, None] == np.arange(1, len(lengths.places))
    elsewhere = (later[:, :, None] * toward[:, None]).reshape(len(toward), -1)
    about = rotation_about_z(lengths.angles)[lengths.position]
    moves = -np.einsum("ki,kij->kj", toward @ lengths.axes, about)
    return (
        Disturbing("drift", "the machine drifts", gone * machine, LARGEST_MOVE, UM),
        Disturbing("drift", "the machine drifts in each run alike", again, LARGEST_MOVE, UM),
        Disturbing("drift", "the machine stands elsewhere in one run than in another", elsewhere,
                   LARGEST_MOVE, UM),
        Disturbing("knock", "the tracer slipped on the table", Steps(lengths.place, when, moves),
                   LARGEST_MOVE, UM, family=True),
        Disturbing("slip", "lengths shifted", Steps(lengths.zero, when), LARGEST_MOVE, UM,
                   family=True),
        Disturbing("scale", "the scale of the lengths is wrong", lengths.distance[:, None],
                   LARGEST_RATIO, PPM),
        Disturbing("refraction", "air in layers bends the beams", lengths.layered[:, None],
                   LARGEST_RATIO, PPM),
    )  # fmt: skip


def _closures(problem: SixProblem, layout: StationLayout) -> list[KnownRelation]:
    """Return what should agree where the table came to an angle again, from the same side."""
    ids, m = layout.position_ids, len(layout.angles)
    found = []
    for first, last in coming_again(
        layout.angles, None if problem.upward is None else problem.upward[ids]
    ):
        for c, name in enumerate(COMPONENTS):
            rows = np.zeros((1, 6 * m))
            rows[0, c * m + last], rows[0, c * m + first] = 1.0, -1.0
            what = phrase(
                "{0} at positions {1} and {2}, whole turns apart, differs",
                name, ids[first], ids[last],
            )  # fmt: skip
            found.append(KnownRelation(what, rows))
    return found
