"""A problem as the model of its lengths: start values, zeros, runs, and what is stated.

Each position has a shift and a turn of the table, and a zero, unless that belongs to a segment of
unbroken beam. The table's axis moves in its plane: shifts there are zero about a centre that is
not known, but for the error motion, which scatters along and across the circle alike. What turns
is what is left along the circle; so of the error motion the stations show what is across it, and
what is along it is believed to be as large. Unstated, its size is what they leave open
(:mod:`~rotcal_ros.adjust.scattering`). A stated circle binds shifts across it and along the axis.

Real axes move in few undulations, which few residuals witness; of order 2 the half that turns the
way of the table leaves none, for the centre takes it up, and the angle feels it twice. So it is
open which orders an unstated motion has (:data:`SPECTRA`).

Lengths of a later run count from a zero that is larger by an unknown: steps measured again in both
show it. A zero that wanders is another one at each length; its steps are observed to be zero.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
from scipy.sparse import csr_array, vstack

from rotcal_ros.adjust.closures import repeated_angles
from rotcal_ros.adjust.error_motion import WHITE, Spectrum
from rotcal_ros.adjust.model import (
    SECONDS,
    Disturbing,
    Grouping,
    KnownRelation,
    Model,
    Steps,
    drifts,
    recurring,
)
from rotcal_ros.adjust.outputs import Outputs
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.errors import DataError, ObservabilityError
from rotcal_ros.foundation.language import noted, phrase
from rotcal_ros.geometry.rotations import cross_matrix, rotation_about_z
from rotcal_ros.methods.tracer.solver import turning
from rotcal_ros.methods.tracer.solver.carried_lengths import (
    KNOWN,
    LAG,
    LARGEST_MOVE,
    LARGEST_RATIO,
    LATER_RUN,
    PPM,
    UM,
    WORDS,
    CarriedLengths,
    KnownBeforehand,
    order_taken,
)
from rotcal_ros.methods.tracer.solver.circle import check_sense, table_motion
from rotcal_ros.methods.tracer.solver.observability import (
    NEVER_TURNED,
    check_counts,
    check_each_alone,
    stand_at_one_place,
)
from rotcal_ros.methods.tracer.solver.problem import (
    Grid,
    TracerProblem,
    UnplacedRows,
    arrange_grid,
)
from rotcal_ros.methods.tracer.solver.reported import along_beams
from rotcal_ros.methods.tracer.solver.start import find_any_start, fit_zeros
from rotcal_ros.planning.readings import passes

SAME_ANGLE_DIFFERS: Final = noted("stations {0} and {1} stand at the same table angle but differ")

CIRCLE: Final = 5
"""Stations from which on their plane gives the direction of the axis."""
MOST_LENGTHS: Final = 3000
"""Zeros that wander are as many as lengths, and their normal matrix is dense: 72 MB."""
ROUND: Final = 1e-9
"""Error motion (m) of a table that is called perfectly round: what contradicts it has to be able
to do so."""
FREE_CIRCLE: Final = 1e-4
"""Error motion (m) that nobody would overlook."""
USUAL: Final = 3e-7
"""Error motion (m) from which that of very many stations is searched for."""
LOOSE: Final = 1e-5
"""Error motion (m) beside its low orders that leaves a place free across its circle."""
MOST_WITNESSES: Final = 500
"""Stations up to which it is asked of which orders an error motion is, or how large it may be; of
more its size is no question, and it is noise like that of the lengths."""
SPECTRA: Final[Mapping[Spectrum, float]] = {
    WHITE: 0.4,
    **{
        Spectrum.of_sizes([0.0, *(k**-fall for k in range(2, highest + 1))]): 0.1
        for highest in (3, 5, 8)
        for fall in (0.0, 1.0)
    },
}
"""Which orders an error motion may have, with what probability beforehand."""
ERROR_MOTION: Final = "the error motion"
STATED_CIRCLE: Final = "the stated circle"
ALONG_AXIS: Final = "the stated circle along the axis"
DATUM: Final = 1e-6
"""Standard deviation (m) of what is defined: any will do, for no length contradicts it."""
FIRM: Final = 1e-9
"""Share below which a turn of targets in one line is none."""
MOMENTS: Final = 64
"""Moments at which the instrument may move: one between two is seen nearly as well."""
PLACES: Final = 4_000_000
"""Numbers in what is tried of an effect, 32 MB: of very many lengths fewer moments."""


@dataclass(frozen=True)
class AssumedParameters:
    """What is not known beforehand, as it is supposed to be.

    ``walk``: standard deviation of a zero's step from one length to the next, m; 0: it stands.
    ``weight``: share of the reported moves of the targets that lengths follow, ``left``: what that
    leaves unknown of each, m. ``other``: standard deviations of an error motion beside its low
    orders, across the circle and along it, of a table that turns, m.
    """

    walk: float = 0.0
    weight: float = 1.0
    left: float = 0.0
    other: tuple[float, float] = (LOOSE, ROUND)


@dataclass(frozen=True, eq=False)
class PosedProblem:
    """A ``problem`` on its ``grid``, and its ``lengths`` at start values.

    ``ambiguous``: mirror images of the stations fit as well.
    """

    problem: TracerProblem
    grid: Grid
    absent: UnplacedRows
    lengths: CarriedLengths
    ambiguous: bool

    @classmethod
    def of(cls, problem: TracerProblem, alone: bool = True) -> PosedProblem:
        """Return what ``problem`` poses; raises what arranging and the start values raise.

        ``alone``: its lengths have to be enough for all unknowns.
        """
        grid, absent = arrange_grid(problem)
        if alone:
            check_counts(grid, absent.unfit.values())
        angles = problem.table_angles[grid.position_ids]
        given = problem.start_stations
        given = None if given is None else given[grid.position_ids]
        state, ambiguous = find_any_start(grid, given, angles)
        stations = state[grid.first_strip, :3]
        if stand_at_one_place(stations):
            raise ObservabilityError(NEVER_TURNED)
        if problem.variant == "station":
            check_each_alone(grid, state, problem.settings.max_station_std)
        if given is None and len(stations) >= CIRCLE:
            check_sense(table_motion(stations, angles), stations, angles, grid.position_ids)
        return cls.at(problem, grid, absent, state, ambiguous)

    @classmethod
    def at(
        cls,
        problem: TracerProblem,
        grid: Grid,
        absent: UnplacedRows,
        state: Floats,
        ambiguous: bool = False,
    ) -> PosedProblem:
        """Return it with stations and distances (p, 4) of the strips of its grid, m."""
        lengths = _lengths(problem, grid, state[grid.first_strip, :3], state[:, 3])
        return cls(problem, grid, absent, lengths, ambiguous)

    def again(self, stations: Floats) -> PosedProblem:
        """Return it with better start values: where stations (m, 3) stand, m."""
        state = fit_zeros(self.grid, stations[self.grid.station])
        return PosedProblem.at(self.problem, self.grid, self.absent, state, self.ambiguous)

    def every_station(self) -> Floats:
        """Return where the tracer stands at all table angles, at the start values, m."""
        stands = self.lengths.standing(self.lengths.start)
        found = np.tile(stands[0], (len(self.problem.table_angles), 1))
        found[self.grid.position_ids] = stands
        return found

    @cached_property
    def moved(self) -> Floats | None:
        """By how much the reported moves of its target make each length (k,) longer, m."""
        return along_beams(self.lengths, self.problem.moved)

    def lengths_of(self, supposed: AssumedParameters) -> CarriedLengths:
        """Return the lengths with the unknowns that what is supposed leaves them."""
        lengths = self.lengths
        if self.moved is not None:
            observed = lengths.observed - supposed.weight * self.moved
            std = np.hypot(lengths.std, supposed.left)
            lengths = replace(lengths, observed=observed, std=std)
        if supposed.walk:
            lengths = _wandering(lengths)
        if self.problem.circle_std is not None:
            lengths = replace(lengths, more={**lengths.more, "lean": 3})
        if lengths.speed is not None and (self.motion is None or self.motion > ROUND):
            orders = len(turning.low_orders(SPECTRA))
            lengths = replace(lengths, more={**lengths.more, turning.MOTION: 4 * orders})
        return lengths

    def model(self, supposed: AssumedParameters) -> Model:
        """Return the model whose outputs are ECC of all positions, from the first."""
        lengths, grid = self.lengths_of(supposed), self.grid
        position, target = grid.position_ids[lengths.position], grid.target_ids[lengths.target]
        stated = target_knowledge(lengths, grid.target_std, grid.free)
        if supposed.walk:
            stated.append(_steps_of_zeros(lengths, supposed.walk))
        begin = lengths.first["turn"]
        first = np.zeros(lengths.size)
        first[begin] = -1.0
        model = Model(
            blocks=lengths.blocks,
            observed=lengths.observed,
            std=lengths.std,
            equations=lengths.computed,
            outputs=Outputs.picked(begin + np.arange(len(lengths.angles)), first),
            words=WORDS,
            unit=UM,
            components=["the lengths"],
            groupings=_groupings(lengths, grid),
            effects=effects_of(lengths, unbroken=self.problem.segment is not None),
            row_names=lambda row: phrase(
                "{0}, target {1}",
                self.problem.station_name(int(position[row])),
                int(target[row]),
            ),
        )
        for known in stated:
            model = known.beside(model)
        return replace(self._about_axis(lengths, model, supposed), closures=self._closures)

    @property
    def _closures(self) -> list[KnownRelation]:
        """That stations at one angle see the same deviation, unless runs are repeated."""
        angles, number, found = self.lengths.angles, self.grid.position_ids, []
        if self.problem.repeated_runs:
            return []
        for first, last in repeated_angles(angles):
            rows = np.zeros((1, len(angles)))
            rows[0, [first, last]] = -1.0, 1.0
            what = phrase(SAME_ANGLE_DIFFERS, number[first], number[last])
            found.append(KnownRelation(what, rows, unit=SECONDS))
        return found

    @property
    def motion(self) -> float | None:
        """The error motion of the axis as it is stated, m; None: it is not."""
        stated = self.problem.error_motion_std
        return self.problem.circle_std if stated is None else stated

    def _about_axis(
        self, lengths: CarriedLengths, model: Model, supposed: AssumedParameters
    ) -> Model:
        """Return the model with what is known of how the table's axis moves."""
        across, motion, along = axis_knowledge(lengths, self.motion, self.problem.circle_std)
        for known in along:
            model = known.beside(model)
        size = None if self.motion is None else float(motion.std[0])
        if lengths.speed is None:
            model = with_error_motion(
                model, motion.what, motion.rows, size, lengths.angles, across
            )
        else:
            model = self._turning(lengths, model, motion, across, supposed)
        significance = self.problem.settings.test_significance
        scattering = [replace(each, significance=significance) for each in model.scatterings]
        return replace(model, correlated=scattering)

    def _turning(
        self, lengths: CarriedLengths, model: Model, motion: KnownBeforehand, across: csr_array,
        supposed: AssumedParameters,
    ) -> Model:  # fmt: skip
        """Return the model of a table that turns, with its motion and the lag of its feedback.

        A motion has low orders, which all runs have in common: as large as it is stated, or of a
        size that is estimated. Beside them it is another at every angle of each run, as large as
        stated, or as is supposed.
        """
        problem, m = self.problem, len(lengths.angles)
        if turning.MOTION not in lengths.more:
            model = motion.beside(model)
        elif self.motion is not None:
            rows = csr_array(motion.rows - across @ turning.motion_design(lengths, SPECTRA))
            model = motion._replace(rows=rows).beside(model)
            model = turning.with_stated_motion(model, lengths, SPECTRA, self.motion)
        else:
            rows = csr_array(motion.rows - across @ turning.motion_design(lengths, SPECTRA))
            model = KnownBeforehand(motion.what, rows, np.tile(supposed.other, m)).beside(model)
            model = turning.with_unknown_motion(model, lengths, SPECTRA, FREE_CIRCLE)
        shared = [name for name in lengths.blocks if name not in ("shift", "turn")]
        model = replace(model, shared=shared)  # hundreds of places, and few targets
        return turning.tie_runs_of_table(model, lengths, problem.lag, problem.lag_std)


def axis_knowledge(
    lengths: CarriedLengths, stated: float | None, circle: float | None
) -> tuple[csr_array, KnownBeforehand, list[KnownBeforehand]]:
    """Return what is known of where the table's axis carries the instrument.

    Shifts are off the axis by the error motion as it is ``stated`` (m), across the circle and
    along it by turns; then what a stated ``circle`` (m) says along the axis. Across it the two are
    contradicted together. First what takes moves x and y of each station to these rows
    (2 m, 2 m).
    """
    m, angles = len(lengths.angles), lengths.angles
    plane = np.arange(3 * m).reshape(m, 3)[:, :2].ravel()
    off = lengths.rows_of("shift", plane)
    off = off - csr_array(np.tile(np.eye(2), (m, 1))) @ lengths.rows_of("frame")
    round_ = np.arctan2(*lengths.places[0, 1::-1]) + angles
    cos, sin = np.cos(round_), np.sin(round_)
    turned = np.stack([cos, sin, -sin, cos], axis=1)
    column = 2 * np.arange(m)[:, None] + np.array([0, 1, 0, 1])
    entries = turned.ravel(), column.ravel(), 2 * np.arange(2 * m + 1)
    turning = csr_array(entries, shape=(2 * m, 2 * m))
    rows, size = csr_array(turning @ off), np.nan if stated is None else max(stated, ROUND)
    if circle is None:
        return turning, KnownBeforehand(ERROR_MOTION, rows, np.full(2 * m, size)), []
    lean = csr_array(np.column_stack([np.ones(m), np.cos(angles), np.sin(angles)]))
    height = lengths.rows_of("shift", 3 * np.arange(m) + 2) - lean @ lengths.rows_of("lean")
    both = csr_array(vstack([rows[0::2], circle / size * rows[1::2]], format="csr"))
    return (
        turning,
        KnownBeforehand(STATED_CIRCLE, both, np.full(2 * m, circle)),
        [KnownBeforehand(ALONG_AXIS, csr_array(height), np.full(m, circle))],
    )


def with_error_motion(
    model: Model,
    name: str,
    rows: csr_array,
    size: float | None,
    angles: Floats,
    turning: csr_array,
) -> Model:
    """Return the model in which ``rows`` (2 m, p) or more are zero but for an error motion.

    ``size``: as it is stated, m; None: it is not. ``turning`` (2 m, 2 m): what takes moves x and y
    at each of the ``angles`` (m,) of the table to the rows.
    """
    if len(angles) > MOST_WITNESSES:
        return model.with_prior(name, rows, np.zeros(rows.shape[0]), size or USUAL)
    ways = []
    if size is None:
        for spectrum, share in SPECTRA.items():
            root = spectrum.root(angles)
            waves = root[:, : 2 * len(spectrum.orders)] if spectrum.orders else root
            ways.append((share, turning @ np.kron(waves, np.eye(2))))
    return model.scattering(name, rows, size, FREE_CIRCLE, ways)


def carrying_axis(stations: Floats, angles: Floats) -> tuple[Floats, Floats, Floats]:
    """Return axes (3, 3), place on the table (3,) and origin (3,) that carry to ``stations``."""
    axes, m = np.eye(3), len(stations)
    if m >= CIRCLE:
        plane = table_motion(stations, angles).plane
        axes = np.column_stack([*plane.basis(), plane.normal])
    local = stations @ axes  # = centre + Rz(angle) q
    about = rotation_about_z(angles)[:, :2, :2]
    design = np.concatenate([np.tile(np.eye(2), (m, 1, 1)), about], axis=2).reshape(2 * m, 4)
    found = np.linalg.lstsq(design, local[:, :2].ravel(), rcond=None)[0]
    return axes, np.array([*found[2:], 0.0]), axes @ [*found[:2], local[:, 2].mean()]


def _lengths(
    problem: TracerProblem, grid: Grid, stations: Floats, distances: Floats
) -> CarriedLengths:
    """Return the lengths of a ``grid``, from ``stations`` (m, 3) and ``distances`` (p,), m."""
    angles = problem.table_angles[grid.position_ids]
    axes, place, origin = carrying_axis(stations, angles)
    strip, target, order = order_taken(grid.row, problem.measuring_order)
    zero, row = grid.station if grid.zero is None else grid.zero, grid.row[strip, target]
    later, std = _later_runs(problem, row)
    later_zeros = int(later.max(initial=-1)) + 1
    return CarriedLengths(
        observed=grid.length[strip, target],
        std=np.hypot(grid.length_std[strip, target], std),
        position=grid.station[strip],
        station=grid.station[strip],
        place=np.zeros_like(strip),
        target=target,
        zero=zero[strip],
        row=row,
        order=order,
        angles=angles,
        places=place[None],
        targets=grid.targets,
        zeros=distances[grid.first_of_zero],
        axes=axes,
        origin=origin,
        place_ways=outward_direction(place),
        more={"frame": 2}
        | ({LATER_RUN: later_zeros} if later_zeros else {})
        | ({} if problem.speed is None else {LAG: 1}),
        later=later,
        speed=None if problem.speed is None else problem.speed[row],
    )


def _later_runs(problem: TracerProblem, row: Ints) -> tuple[Ints, Floats]:
    """Return which later run each length (k,) is of, -1: none; and how much more it scatters, m.

    A target that is come to again stands elsewhere, by what the machine repeats. Raises DataError
    for a run without a step that was measured before.
    """
    if problem.run is None:
        return np.full(len(row), -1), np.zeros(len(row))
    runs, number = np.unique(problem.run, return_inverse=True)
    assert problem.again is not None
    repeats = problem.again > 0
    for later in range(1, len(runs)):
        if not repeats[number == later].any():
            raise DataError(
                f"no step of the runs before was measured again in run {runs[later]}, so its "
                "zero of the lengths is not known; resume once more, or measure from the start"
            )
    more = np.where(repeats & (number > 0), np.sqrt(2.0) * problem.position_std, 0.0)
    return number[row] - 1, more[row]


def _wandering(lengths: CarriedLengths) -> CarriedLengths:
    """Return the lengths with a zero for each, in the order of time within their zeros of now."""
    if len(lengths.row) > MOST_LENGTHS:
        raise DataError(
            f"{len(lengths.row)} lengths are too many for a zero that wanders: up to "
            f"{MOST_LENGTHS} are solved; set zero_walk_std_m to 0"
        )
    in_time = np.lexsort((lengths.order, lengths.zero))
    number = np.empty(len(in_time), dtype=np.int64)
    number[in_time] = np.arange(len(in_time))
    zeros = lengths.zeros[lengths.zero[in_time]]
    return replace(lengths, zero=number, zeros=zeros, beam=lengths.zero)


def _steps_of_zeros(lengths: CarriedLengths, walk: float) -> KnownBeforehand:
    """Return that a zero steps by ``walk`` (m) from one length of its beam to the next."""
    assert lengths.beam is not None
    beam = np.empty(len(lengths.zero), dtype=np.int64)
    beam[lengths.zero] = lengths.beam
    linked = np.flatnonzero(np.diff(beam) == 0)
    rows = lengths.rows_of("zero", linked + 1) - lengths.rows_of("zero", linked)
    return KnownBeforehand("the walk of the zero", csr_array(rows), np.full(len(linked), walk))


def outward_direction(place: Floats) -> Floats:
    """Return the way (3, 1) in which a ``place`` (3,) is unknown: out from the axis.

    Along it and up it is a shift of all.
    """
    flat = place * [1.0, 1.0, 0.0]
    return np.asarray(flat / np.linalg.norm(flat))[:, None]


def target_knowledge(lengths: CarriedLengths, std: Floats, free: bool) -> list[KnownBeforehand]:
    """Return what is stated of the targets: ``std`` (n, 3), m, of each coordinate.

    Or where they are ``free``, that they have not moved, turned or grown as a whole: it defines
    what lengths leave open, and nothing else.
    """
    if free:
        about = lengths.targets - lengths.targets.mean(axis=0)
        ways = np.zeros((lengths.targets.size, 7))
        ways[:, :3] = np.tile(np.eye(3), (len(about), 1))
        ways[:, 3:6] = -cross_matrix(about).reshape(-1, 3)
        ways[:, 6] = about.ravel()
        axes, size, _ = np.linalg.svd(ways / np.linalg.norm(ways, axis=0), full_matrices=False)
        rows = csr_array(csr_array(axes[:, size > FIRM].T) @ lengths.rows_of("target"))
        return [KnownBeforehand("the datum", rows, np.full(rows.shape[0], DATUM))]
    return [
        KnownBeforehand(
            phrase("the targets' {0}", axis),
            lengths.rows_of("target", slice(a, None, 3)),
            np.maximum(std[:, a], KNOWN),
        )
        for a, axis in enumerate("xyz")
    ]


def effects_of(lengths: CarriedLengths, *, unbroken: bool) -> list[Disturbing]:
    """Return what could spoil the lengths, as they feel it at the start values.

    ``unbroken``: lengths of several stations are of one beam, whose counter may slip.
    """
    once, when = np.zeros(len(lengths.row), dtype=np.int64), lengths.order.astype(np.float64)
    beam, toward = lengths.zero if lengths.beam is None else lengths.beam, lengths.toward
    arms = lengths.targets - lengths.origin
    reach = float(np.linalg.norm(arms, axis=1).max())
    spin = (cross_matrix(lengths.axes[None, :, 2])[0] @ arms.T).T[lengths.target] / reach
    turning = (toward * spin).sum(axis=1)[:, None]
    machine = np.hstack([toward, turning])
    again = passes(lengths.place, lengths.position, lengths.order)
    returning = np.hstack([machine * shape[:, None] for shape in recurring(again, when).T])
    gone = drifts(once, when)
    each = slips = list[Disturbing]()
    if 1 < len(np.unique(beam)) <= PLACES // len(beam):
        read = drifts(beam, when)
        each = [Disturbing("drift", "lengths drift", read, LARGEST_MOVE, UM, family=True)]
    if unbroken:
        slips = [Disturbing("slip", "lengths shifted", Steps(beam, when), LARGEST_MOVE, UM,
                            family=True, stays=True)]  # fmt: skip
    return [
        Disturbing("drift", "the machine's frame drifts", gone * toward, LARGEST_MOVE, UM),
        Disturbing("drift", "the machine's frame turns", gone * turning, LARGEST_MOVE, UM),
        Disturbing("drift", "all lengths drift", gone, LARGEST_MOVE, UM),
        *each,
        Disturbing("recurring drift",
                   "the machine's frame drifts or turns in each turn of the table alike",
                   returning, LARGEST_MOVE, UM),
        Disturbing("knock", "the tracer moved on the table", _knocks(lengths), LARGEST_MOVE, UM,
                   family=True),
        *slips,
        Disturbing("refraction", "air lies in layers", lengths.layered[:, None], LARGEST_RATIO,
                   PPM),
        Disturbing("scale", "the scale of the lengths is wrong", lengths.distance[:, None],
                   LARGEST_RATIO, PPM),
    ]  # fmt: skip


def _knocks(lengths: CarriedLengths) -> Steps:
    """Return moves of the place by a metre out, along and up, from some moments on."""
    out = lengths.place_ways[:, 0]
    ways = np.stack([out, np.cross([0.0, 0.0, 1.0], out), [0.0, 0.0, 1.0]])
    carried = rotation_about_z(lengths.angles)[lengths.position]
    moved = np.einsum("wj,kij->kwi", ways, carried) @ lengths.axes.T
    felt = -np.einsum("kwi,ki->kw", moved, lengths.toward)
    steps = Steps(lengths.place, lengths.order.astype(np.float64), felt)
    most = max(1, min(MOMENTS, PLACES // (3 * len(felt))))
    return replace(steps, stride=max(1, -(-(steps.shape[1] // 3) // most)))


def _groupings(lengths: CarriedLengths, grid: Grid) -> list[Grouping]:
    """Return what may be spoiled together."""
    position = grid.position_ids[lengths.position]
    round_ = np.arctan2(lengths.beams[:, 1], lengths.beams[:, 0])
    found = [
        Grouping("station", position, round_, lengths.toward, closed=True),
        Grouping("target", grid.target_ids[lengths.target]),
    ]
    rank = np.argsort(np.argsort(lengths.order, kind="stable"), kind="stable")
    arrivals = 1 + int((np.diff(lengths.position[np.argsort(rank)]) != 0).sum())
    if arrivals > len(lengths.angles):  # else stretches of time are the stations
        size = max(len(rank) // len(lengths.angles), 8)
        found.append(Grouping("stretch of time", rank // size, rank.astype(np.float64)))
    return found
