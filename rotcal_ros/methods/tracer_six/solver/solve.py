"""The six-deviations method from problem to result: the model, and what only it can say.

The poses d, m, and c, rad, of :mod:`~rotcal_ros.methods.tracer.solver.carried_lengths` are unknown
at every angle, in a frame (v, U) along the axis that the start values have. Places may move
against each other, but not all together: that is what the poses do. So nothing is open. The
deviations are what is left of the poses without their means and, of those across the axis, without
what turns with the table.

Each arrival may scatter, by a shift and by a turn that moves a station at its arm. Of the six
motions one size and five mixtures are held to be possible; turns alone weigh most, for they move
the curves as much as shifts do and leave half the trace.

Noise, outliers, moves, slips, scatter of arrivals, closures and verdict are the engine's
(docs/engine.md). Here are the set-up's own doubts: places that are numbered off, a z that points
into the table, positions without a result.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Any, Final

import numpy as np
from scipy.linalg import null_space
from scipy.sparse import csr_array, vstack

from rotcal_ros.adjust.causes import start_diagnosis
from rotcal_ros.adjust.closures import repeated_angles
from rotcal_ros.adjust.engine import Adjusted, Trials
from rotcal_ros.adjust.engine import adjust as adjusted
from rotcal_ros.adjust.fit import fit_model
from rotcal_ros.adjust.model import (
    CurveModel,
    Disturbing,
    Grouping,
    KnownRelation,
    Model,
    Steps,
    UnseenEventPrior,
    block_rows,
    drifts,
)
from rotcal_ros.adjust.observable import observe_columns
from rotcal_ros.adjust.outputs import Outputs
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.components import COMPONENTS, HALF_OF_95_PERCENT, unit_of
from rotcal_ros.foundation.errors import ObservabilityError
from rotcal_ros.foundation.language import Phrase, noted, phrase
from rotcal_ros.foundation.protection import Protection
from rotcal_ros.foundation.results import Placement, Result, Verdict
from rotcal_ros.foundation.units import ARCSEC, DEGREE
from rotcal_ros.geometry.rotations import cross_matrix, rotation_about_z, rotation_from_vector
from rotcal_ros.methods.tracer.solver.carried_lengths import (
    KNOWN,
    LAG,
    LARGEST_MOVE,
    LARGEST_RATIO,
    PPM,
    SCATTER,
    UM,
    WORDS,
    CarriedLengths,
    order_taken,
)
from rotcal_ros.methods.tracer.solver.observability import (
    Numbering,
    limits_of,
    prior_datum_advice,
    told_of_a_turned_sign,
)
from rotcal_ros.methods.tracer.solver.reported import (
    ReportedPlaceWeight,
    along_beams,
    nearest_weight,
    weigh_reported_places,
)
from rotcal_ros.methods.tracer.solver.reporting import (
    expand_to_all_rows,
    segment_details,
    tangential_protection,
    target_corrections,
)
from rotcal_ros.methods.tracer.solver.turning import (
    TimeCorrelatedLengths,
    in_time,
    tie_runs_of_table,
)
from rotcal_ros.methods.tracer.solver.turning_report import TurningReport
from rotcal_ros.methods.tracer_six.solver.poses import (
    Curves,
    StartPoses,
    find_start,
    gauge_design,
    table_curves,
)
from rotcal_ros.methods.tracer_six.solver.problem import SixProblem, StationLayout, lay_out

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
    strip, target, order = order_taken(grid.row, problem.measuring_order)
    station, row = grid.station[strip], grid.row[strip, target]
    places = (state.places - curves.table_origin) @ curves.table_turn
    more = {}
    if problem.tilt_std is not None:
        more["lean"] = axis_lean_directions(places).shape[1]
    if not problem.scatter_translation_std == problem.scatter_rotation_std == 0.0:
        more[SCATTER] = 3 * len(layout.position)
    if problem.speed is not None:
        more[LAG] = 1
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
        speed=None if problem.speed is None else problem.speed[row],
    )
    ways = _told_of_targets(found) if grid.free else None
    return replace(found, target_ways=ways, more=more)


def axis_lean_directions(places: Floats) -> Floats:
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
    station, target = grid.position_ids[lengths.station], grid.target_ids[lengths.target]
    effects = effects_of(lengths)
    slips = [e for e in effects if e.effect == "slip"]
    if not problem.slip or problem.zero == "per_station":
        slips = []
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
            Grouping("station", station, near=-lengths.toward),
            Grouping("target", target, when),
        ],
        effects=effects,
        row_names=lambda row: phrase(
            "{0}, target {1}", problem.station_name(int(station[row])), int(target[row])
        ),
        shared=("place", "zero", "target", "lean"),
        expected=[UnseenEventPrior(each, problem.slip, SLIPPED) for each in slips],
        closures=_closures(problem, layout),
    )
    for axis in range(0 if grid.free else 3):
        rows = lengths.rows_of("target", slice(axis, None, 3))
        std = np.maximum(grid.target_std[:, axis], KNOWN)
        model = model.with_prior(
            phrase("the targets along {0}", "xyz"[axis]), rows, np.zeros(len(std)), std
        )
    if problem.tilt_std is not None:
        lean = gauge_design(layout.angles)[0] @ axis_lean_directions(lengths.places)
        tilts = [lengths.rows_of("turn", slice(axis, None, 3)) for axis in range(2)]
        rows = vstack(tilts, format="csr")
        rows = rows - np.concatenate([lean[::2], lean[1::2]]) @ lengths.rows_of("lean")
        none = np.zeros(rows.shape[0])
        model = model.with_prior("the tilts", csr_array(rows), none, problem.tilt_std)
    if lengths.speed is not None:
        shared = [name for name in lengths.blocks if name not in ("shift", "turn")]
        model = tie_runs_of_table(
            replace(model, shared=shared), lengths, problem.lag, problem.lag_std
        )
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
        root = pose_covariance_root(shift or 0.0, turn or 0.0, arms).reshape(len(arms), 3, -1)
        felt = -(lengths.toward[:, None] @ root[lengths.station])[:, 0]
        model = model.with_unknowns(STATED, felt)
        rows = csr_array(block_rows(model.blocks, STATED))
        model = model.with_prior("the stated scatter", rows, np.zeros(arms.size), 1.0)
    if turn is None and shift is not None:
        _require_seen(lengths.places, radius)
    ways = [
        (share, pose_covariance_root(along, about, arms)) for share, (along, about) in possible
    ]
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


def pose_covariance_root(shift: float, turn: float, arms: Floats) -> Floats:
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
    """Return what should agree where the table came to an angle again, from the same side.

    What several turns of a table show of an angle becomes one mean, which says how they agree.
    """
    ids, m = layout.position_ids, len(layout.angles)
    found = list[KnownRelation]()
    if problem.speed is not None:
        return found
    for first, last in repeated_angles(
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


UPSIDE_DOWN: Final = noted(
    "beams go down by {0:.0f} degrees, through the table, and none goes up as steeply: the z "
    "axis of targets and places seems to point into the table, and then EZC, EAC and EBC have "
    "the wrong sign"
)
NO_DEVIATIONS: Final = noted(
    "no deviations for position(s) {0}: fewer than three places have enough lengths"
)

METHOD = "tracer_six"
STEEP: Final = 45.0 * DEGREE
"""No beam goes down so steeply: tracers look past their own foot by 35 degrees or so at most."""
FITTING: Final = 3.0
"""Times the stated noise up to which lengths of the opposite sign are said to fit."""
CURE: Final = (
    "measure more targets, spread low around the table, from places 120 degrees apart, or keep "
    "the beam unbroken (fewer zeros)"
)


@dataclass(frozen=True, eq=False)
class SixSolution:
    """A solved problem: the ``lengths`` in its ``layout``, and what the engine ``found``.

    ``absent``: why rows have no place in it. ``reported``: what was made of reported places.
    """

    problem: SixProblem
    layout: StationLayout
    lengths: CarriedLengths
    found: Adjusted
    absent: dict[int, Phrase]
    reported: ReportedPlaceWeight | None = None
    in_time: TimeCorrelatedLengths | None = None

    @property
    def unknowns(self) -> Floats:
        """The unknowns of the lengths, as they were solved."""
        x = self.found.fit.x[: self.found.model.size[1]]
        return x if self.in_time is None else np.asarray(self.in_time.places @ x)

    def part(self, block: str) -> Floats:
        """Return the solved unknowns of a block; of poses and points (k, 3)."""
        return self.lengths.part(self.unknowns, block)

    @cached_property
    def curves(self) -> Curves:
        """The curves and frames of the solved poses."""
        lengths = self.lengths
        turned = rotation_from_vector(self.part("turn"))
        rotation = lengths.axes @ turned @ rotation_about_z(self.layout.angles)
        translation = lengths.origin + self.part("shift") @ lengths.axes.T
        return table_curves(rotation, translation, self.layout.angles)

    @property
    def places(self) -> Floats:
        """The places (p, 3), m, in the frame that turns with the table, z along the axis."""
        moved = self.lengths.places + self.part("place")
        return np.asarray((moved - self.curves.table_origin) @ self.curves.table_turn)

    @property
    def radius(self) -> float:
        """The mean distance, m, of the places from the axis."""
        return float(np.hypot(*self.places[:, :2].T).mean())

    @cached_property
    def turns(self) -> TurningReport:
        """What is known of a table that turned."""
        again = self.problem.earlier[self.lengths.row]
        return TurningReport(self.lengths, again, self.found, self.in_time)

    @property
    def targets(self) -> Floats:
        """The targets (n, 3), m."""
        return np.asarray(self.lengths.targets + self.part("target"))

    @property
    def positions(self) -> Ints:
        """The table positions (m,) that have a result."""
        return self.layout.position_ids

    def deviations(self) -> Floats:
        """Return the six curves (6, m), m and rad."""
        return np.concatenate([self.curves.translation.T, self.curves.rotation.T])

    @property
    def trials(self) -> Trials:
        """Draws the curves of measurements like the given one, (count, 6 m)."""
        return replace(self.found.trials, value=self.deviations().ravel())


def adjust(problem: SixProblem) -> SixSolution:
    """Return the solution of ``problem``; raises what :func:`solve` raises."""
    return told_of_a_turned_sign(
        problem,
        _adjusted,
        lambda s: bool((s.found.scale * s.found.diagnosis.noise.factors < FITTING).all()),
    )


def _adjusted(problem: SixProblem) -> SixSolution:
    layout, absent = lay_out(problem)
    lengths = lengths_of(problem, layout, find_start(problem, layout))
    if lengths.speed is not None:  # its places are but the plan's, to millimetres
        model = model_of(problem, layout, lengths)
        fit = start_diagnosis(model, limits_of(problem.settings)).fit
        lengths = lengths_of(problem, layout, _standing(lengths, fit.x))
    along = along_beams(lengths, problem.moved)

    def solved(weight: float, left: float = 0.0) -> SixSolution:
        moved = lengths
        if along is not None:
            observed, std = lengths.observed - weight * along, np.hypot(lengths.std, left)
            moved = replace(lengths, observed=observed, std=std)
        try:
            found, noise = _solved(problem, layout, moved)
        except ObservabilityError as error:
            advice = f"{CURE}{prior_datum_advice(free=layout.grid.free)}"
            raise ObservabilityError(f"{error}: {advice}") from None
        return SixSolution(problem, layout, moved, found, absent, in_time=noise)

    weight = 1.0
    if along is not None:
        weight = nearest_weight(model_of(problem, layout, lengths), along)
    solution, reported = weigh_reported_places(solved(weight), weight, lengths, along, solved)
    solution = replace(solution, reported=reported)
    _check_curves(solution, problem.settings.max_station_std)
    return solution


def _standing(lengths: CarriedLengths, x: Floats) -> StartPoses:
    """Return the poses, places and zeros at the unknowns ``x``, as start values."""
    turned = rotation_from_vector(lengths.part(x, "turn")) @ rotation_about_z(lengths.angles)
    return StartPoses(
        lengths.axes @ turned,
        lengths.origin + lengths.part(x, "shift") @ lengths.axes.T,
        lengths.places + lengths.part(x, "place"),
        lengths.zeros + lengths.part(x, "zero"),
    )


def _solved(
    problem: SixProblem, layout: StationLayout, lengths: CarriedLengths
) -> tuple[Adjusted, TimeCorrelatedLengths | None]:
    """Return the solution, and the noise in time of a table that turned."""
    model, limits = model_of(problem, layout, lengths), limits_of(problem.settings)
    if lengths.speed is None:
        return adjusted(model, limits), None
    return in_time(start_diagnosis(model, limits), lengths, problem.earlier[lengths.row], limits)


def _check_curves(solution: SixSolution, limit: float) -> None:
    """Raise ObservabilityError where a curve is known worse than ``limit`` of the radius."""
    std, places = solution.found.fit.noise_std.reshape(6, -1), solution.lengths.places
    radius = float(np.linalg.norm(places - places.mean(axis=0), axis=1).max())
    share = std / np.repeat([radius, 1.0], 3)[:, None]
    component, position = np.unravel_index(np.argmax(share), share.shape)
    if share[component, position] > limit:
        factor, unit = unit_of(COMPONENTS[component])
        raise ObservabilityError(
            f"{COMPONENTS[component]} at position {position} is known to "
            f"{std[component, position] / factor:.2g} {unit} only (standard deviation): {CURE}"
        )


def solve(problem: SixProblem) -> Result:
    """Return EXC, EYC, EZC (m), EAC, EBC, ECC (rad) of the table at the commanded angles.

    Actual - commanded, of the point of the axis at the machine's z = 0, in a frame along the axis
    with x towards the machine's x. Each curve has zero mean; EXC, EYC and EAC, EBC have no part
    that turns with the table, for that is how the axis itself is defined. Standard deviations
    come from the lengths, the targets' prior and the scatter of the table from run to run;
    positions whose places leave a direction open are absent.

    Raises ObservabilityError where the places or the lengths cannot determine all six (it names
    the lost direction), DataError for contradictory or implausible data.
    """
    return result_of(adjust(problem))


def result_of(solution: SixSolution) -> Result:
    """Return what is known of a solved problem in the form that all methods share."""
    layout, lengths, problem = solution.layout, solution.lengths, solution.problem
    m, reported = len(layout.angles), solution.reported
    numbering, upward = _numbering(solution), SteepestBeams.of(solution)
    plain = solution.found.result(
        METHOD,
        layout.angles,
        {name: slice(k * m, (k + 1) * m) for k, name in enumerate(COMPONENTS)},
        (lengths.position, lengths.target),
        counts_from="mean",
        doubts=_doubts(solution),
        protections=(*_protections(solution), numbering.protection(), upward.protection()),
        details=_details(solution),
        further=False,
    )
    verdict, warnings = upward.judged(*numbering.judged(plain.verdict, plain.warnings))
    warnings = (*warnings, *solution.turns.remarks(problem.lag, solution.radius))
    if reported is not None and reported.warning:
        warnings = (*warnings, reported.warning)

    def named(text: Phrase) -> Phrase:
        """Return a text of the engine with the stations called by their names."""
        match text.template, text.parts:
            case "{0} {1}", ("station", int(number)):
                return problem.station_name(number)
        parts = (named(part) if isinstance(part, Phrase) else part for part in text.parts)
        return phrase(text.template, *parts)

    every = expand_to_all_rows(plain, problem, lengths, solution.absent)
    return replace(
        every,
        deviations=dict(zip(COMPONENTS, solution.deviations(), strict=True)),
        rejected=tuple(replace(r, why=named(r.why)) for r in every.rejected),
        verdict=verdict,
        warnings=tuple(map(named, warnings)),
        protections=tuple(replace(p, why=named(p.why)) for p in plain.protections),
        placement=Placement.upwards(solution.curves.origin, solution.curves.axes[:, 2]),
    )


def _numbering(solution: SixSolution) -> Numbering:
    """Return how the places found stand round the axis to those that the plan states."""
    found = solution.places[:, :2] @ (1.0, 1j)
    stated = solution.problem.places[solution.layout.place_ids, :2] @ (1.0, 1j)
    return Numbering.of(
        phrase("the plan (places, azimuth_deg)"),
        solution.layout.angles,
        float(np.abs(found).mean()),
        float(np.angle(np.vdot(stated, found))),
        solution.problem.place_tolerance,
    )


def _doubts(solution: SixSolution) -> list[Phrase]:
    missing = solution.problem.missing(solution.positions)
    names = ", ".join(map(str, missing))
    few = phrase(NO_DEVIATIONS, names)
    return [few] if missing else []


def _protections(solution: SixSolution) -> Iterator[Protection]:
    """Yield what is said of effects that no length shows, or that are measured."""
    problem = solution.problem
    yield Protection("error motion", "estimated", phrase("EXC, EYC and EZC are measured"))
    std = problem.tilt_std
    if std is None:
        yield Protection("tilt", "estimated", phrase("EAC and EBC are measured"))
    else:
        held = phrase(
            "EAC and EBC are held to a stated {0:.2g} arcsec, which the budget holds", std / ARCSEC
        )
        yield Protection("tilt", "bounded", held)
    yield Protection(
        "gauge",
        "harmless",
        phrase(
            "the curves are referred to the axis itself: what a lean or shift of the machine "
            "or of the table's own frame does is taken off"
        ),
    )
    stated = (problem.scatter_translation_std, problem.scatter_rotation_std)
    for sizes in solution.found.fit.sizes.values():
        if not sizes.contrasts:
            why = phrase("no distance between places shows it: the stated value is used")
            yield Protection("repeatability", "not protected", why)
        elif None in stated:
            yield Protection(
                "repeatability",
                "estimated",
                phrase("between runs, from {0} contrasts between the places", sizes.contrasts),
            )
        else:
            yield Protection(
                "repeatability",
                "tested",
                phrase(
                    "stated; {0} contrasts between the places show more of it", sizes.contrasts
                ),
            )
    yield from solution.turns.protections()
    if problem.speed is not None:
        yield Protection(
            "repeatability",
            "tested",
            phrase(
                "the table passes each angle once for every target and place: what it does not "
                "repeat joins the scatter of the lengths"
            ),
        )
    yield tangential_protection(
        solution.radius,
        alike=phrase(", by the same at every place,"),
        of=phrase(" of ECC"),
        beside=phrase("what differs from place to place is scatter"),
        within=_returned(solution),
        shown=phrase("angles that were measured again"),
        untested=phrase("it"),
    )


def _returned(solution: SixSolution) -> float | None:
    """Return within how many m the tracer came back along its circle, 95 %; None: untested.

    Seen by an angle that comes again, after a whole turn or in the same run, whichever says less.
    """
    radius = solution.radius
    closings = [c for c in solution.found.closed if c.relation.what.startswith("ECC ")]
    each = [(radius * c.error[0], radius * c.std[0]) for c in closings]
    layout, lengths, fit = solution.layout, solution.lengths, solution.found.fit
    stood = np.column_stack([layout.place, layout.position])
    _, first, which = np.unique(stood, axis=0, return_index=True, return_inverse=True)
    later = np.arange(len(stood)) != first[which]
    if later.any():
        side = np.where(later, 0.5, 0.0)
        side[first[which[later]]] = -0.5
        if solution.found.found_effects:  # a drift that was taken off may be just that
            fit = fit_model(fit.model, fit.used, fit.std, fit.x)
        arm = lengths.stands(lengths.start)[1] @ lengths.axes.T
        along = np.cross([0.0, 0.0, 1.0], arm) / np.hypot(arm[:, 0], arm[:, 1])[:, None]
        felt = -(lengths.toward * along).sum(axis=1) * side[lengths.station]
        felt = np.pad(felt, (0, len(fit.std)))
        seen = observe_columns(fit, felt[: len(fit.std), None])
        size = float(seen.score[0] / seen.information[0, 0])
        each.append((size, solution.found.scale / float(np.sqrt(seen.information[0, 0]))))
    return max((abs(e) + HALF_OF_95_PERCENT * u for e, u in each), default=None)


def _details(solution: SixSolution) -> dict[str, Any]:
    """Return the method's own part of the result, SI.

    ``places`` (p, 3) in the frame that turns with the table, z along the axis; ``place_ids`` are
    the problem's; ``axis``: where the axis meets the machine's z = 0, and its direction.
    """
    problem, curves, grid = solution.problem, solution.curves, solution.layout.grid
    found, lengths, places = solution.found, solution.lengths, solution.layout.place_ids
    reported = solution.reported
    return {
        "datum": problem.datum,
        "zero": problem.zero,
        "position_ids": solution.positions,
        "place_ids": places,
        "places": solution.places,
        "zeros": lengths.zeros + solution.part("zero"),
        "segments": []
        if problem.segment is None
        else segment_details(found, lengths, grid, places),
        "target_ids": grid.target_ids,
        "targets": solution.targets,
        **target_corrections(found, lengths),
        "axis": {"origin": curves.origin, "direction": curves.axes[:, 2]},
        "coverage_factor": HALF_OF_95_PERCENT,
        "covariance_scale": found.scale,
        **({} if reported is None else {"reported_places": asdict(reported)}),
        **solution.turns.details(),
    }


@dataclass(frozen=True, slots=True)
class SteepestBeams:
    """The elevations (rad, above the tracer along +z) of the steepest beams both ways.

    Targets and places typed in a frame whose z points into the table fit every length as well, and
    EZC, EAC and EBC change their signs. No length shows that. But a tracer stands on the table: no
    beam goes through it.
    """

    lowest: float
    highest: float

    @classmethod
    def of(cls, solution: SixSolution) -> SteepestBeams:
        """Return that of all lengths that were used, in the stated frame."""
        lengths = solution.lengths
        beam = solution.targets[lengths.target] - lengths.stands(solution.unknowns)[0]
        used = solution.found.fit.used[: len(beam)]
        rises = (beam[:, 2] / np.linalg.norm(beam, axis=1))[used]
        return cls(float(np.arcsin(rises.min())), float(np.arcsin(rises.max())))

    def judged(
        self, verdict: Verdict, warnings: tuple[Phrase, ...]
    ) -> tuple[Verdict, tuple[Phrase, ...]]:
        """Return ``verdict`` and ``warnings``; a frame that stands on its head is not ok."""
        if self.lowest > -STEEP or self.highest > STEEP:
            return verdict, warnings
        warning = phrase(UPSIDE_DOWN, -self.lowest / DEGREE)
        return "suspect" if verdict == "ok" else verdict, (*warnings, warning)

    def protection(self) -> Protection:
        """Return whether targets and places that are both mirrored in z would be found."""
        unseen = phrase(
            "targets and places whose z axis points into the table fit every length as well and "
            "turn the signs of EZC, EAC and EBC"
        )
        if self.highest > STEEP and self.lowest > -STEEP:
            return Protection(
                "sign of z",
                "tested",
                phrase(
                    "{0}, but beams that go up by {1:.0f} degrees would go down as "
                    "steeply, through the table",
                    unseen,
                    self.highest / DEGREE,
                ),
            )
        return Protection(
            "sign of z",
            "not protected",
            phrase(
                "{0}; no beam goes up by {1:.0f} degrees or more alone, which would show "
                "it, for none goes down so steeply, through the table",
                unseen,
                STEEP / DEGREE,
            ),
        )


def curve_model(solution: SixSolution) -> CurveModel:
    """Return the model of a solution, to be solved with other instruments."""
    lengths, model = solution.lengths, solution.found.model
    every = np.eye(6 * len(solution.layout.angles), model.size[1]).reshape(2, -1, 3, model.size[1])
    curves = {name: every[k // 3, :, k % 3] for k, name in enumerate(COMPONENTS)}
    return CurveModel(replace(model, outputs=every[0, :0, 0]), lengths.angles, curves)
