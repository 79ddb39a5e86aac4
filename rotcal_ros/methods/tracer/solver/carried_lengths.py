"""Lengths from a table that carries the instrument, as a model of the engine: one way for all.

A place q of the instrument stands at v + U (d + R(c) Rz(angle) q) while the table is at an angle,
with its deviations d, m, and c, rad. Its lengths to the targets count from zeros. All unknowns are
changes of the start values. What is stated beforehand, such as the coordinates of the targets, is
among the observations, never to be left out. Slips that would not be found are errors that
lengths have in common.

The other instruments may determine what these lengths alone do not.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np

from rotcal_ros.adjust.designs import Derivatives
from rotcal_ros.adjust.error_motion import WHITE, Spectrum
from rotcal_ros.adjust.model import (
    CurveModel,
    Disturbing,
    Grouping,
    Model,
    Steps,
    Unit,
    block_rows,
    drifts,
)
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.errors import ObservabilityError
from rotcal_ros.foundation.units import MICROMETRE
from rotcal_ros.geometry.rotations import cross_matrix, rotation_about_z, rotation_from_vector
from rotcal_ros.methods.tracer.solver.circle import table_motion
from rotcal_ros.methods.tracer.solver.network import KNOWN
from rotcal_ros.methods.tracer.solver.problem import Grid, TracerProblem, arrange
from rotcal_ros.methods.tracer.solver.protections import LARGEST_MOVE, LARGEST_RATIO
from rotcal_ros.methods.tracer.solver.screening import WORDS
from rotcal_ros.methods.tracer.solver.solution import FREE_CIRCLE, TracerSolution
from rotcal_ros.methods.tracer.solver.start import find_any_start
from rotcal_ros.methods.tracer.solver.zeros import SLIPPED, Slips

CIRCLE: Final = 5
"""Stations from which on their plane gives the direction of the axis."""
SMALL: Final = 1e-3
"""Variance, as a share of that of the lengths, that is too small to matter."""

ROUNDING: Final = 1e-9
"""Share of its variance by which an error motion is another at every angle at least."""
UM: Final = Unit("um", MICROMETRE)
PPM: Final = Unit("um/m", 1e-6)


class KnownBeforehand(NamedTuple):
    """What is known of unknowns: ``rows`` (b, p) times them is 0 +- ``std`` (b,)."""

    what: str
    rows: Floats
    std: Floats


@dataclass(frozen=True, eq=False)
class CarriedLengths:
    """Lengths ``observed`` +- ``std`` (k,), m, and where they were taken; start values.

    ``position``, ``place``, ``target``, ``zero`` (k,): indices into ``angles`` (m,) rad,
    ``places`` (p, 3), ``targets`` (n, 3) and ``zeros`` (s,), m. ``row``, ``order`` (k,): of the
    problem, and when. ``axes`` U (3, 3), ``origin`` v (3,) m. ``common`` (k, r), m: independent
    errors that lengths share, each of its standard deviation. ``tilts``: whether the table's are
    unknown; one place feels nothing of them that is no shift.
    """

    observed: Floats
    std: Floats
    position: Ints
    place: Ints
    target: Ints
    zero: Ints
    row: Ints
    order: Ints
    angles: Floats
    places: Floats
    targets: Floats
    zeros: Floats
    axes: Floats
    origin: Floats
    common: Floats
    tilts: bool = False

    @cached_property
    def blocks(self) -> dict[str, int]:
        """The unknowns; lengths feel nothing of the frame, in which shifts or tilts are stated."""
        m = len(self.angles)
        return {
            "shift": 3 * m,
            "turn": 3 * m if self.tilts else m,
            "place": self.places.size,
            "zero": len(self.zeros),
            "target": self.targets.size,
            "frame": 4 if self.tilts else 2,
        }

    @property
    def turns(self) -> int:
        """How many turns of the table are unknown at each angle: about z, or all three."""
        return 3 if self.tilts else 1

    def rows_of(self, block: str, number: Sequence[int] | slice = slice(None)) -> Floats:
        """Return rows that take unknowns of a block out of all."""
        return block_rows(self.blocks, block)[number]

    def computed(self, x: Floats) -> tuple[Floats, Floats]:
        """Return the lengths (k,) and their derivatives (k, p) at the unknowns."""
        ends = np.cumsum(list(self.blocks.values()))[:-1]
        shift, turn, place, zero, target, _ = np.split(x, ends)
        vector = np.zeros_like(shift).reshape(-1, 3)
        vector[:, 3 - self.turns :] = turn.reshape(-1, self.turns)
        tilt, about = rotation_from_vector(vector), rotation_about_z(self.angles)
        carry = (tilt @ about)[self.position]
        arm = np.einsum("kij,kj->ki", carry, (self.places + place.reshape(-1, 3))[self.place])
        stands = self.origin + (shift.reshape(-1, 3)[self.position] + arm) @ self.axes.T
        away = stands - (self.targets + target.reshape(-1, 3))[self.target]
        distance = np.linalg.norm(away, axis=1)
        unit = away / distance[:, None]
        felt = unit @ self.axes
        slope = np.eye(3) + 0.5 * cross_matrix(vector)  # of R(c), to the first order of c
        turned = np.einsum("ki,kij->kj", np.cross(arm, felt), slope[self.position])
        moved = np.einsum("ki,kij->kj", felt, carry)
        design = np.zeros((len(distance), len(x)))
        first = dict(zip(self.blocks, [0, *ends.tolist()], strict=True))
        each = np.arange(len(distance))[:, None]
        for block, index, rows in (
            ("shift", self.position, felt),
            ("turn", self.position, turned[:, 3 - self.turns :]),
            ("place", self.place, moved),
            ("target", self.target, -unit),
        ):
            width = rows.shape[1]
            design[each, first[block] + width * index[:, None] + np.arange(width)] = rows
        design[each[:, 0], first["zero"] + self.zero] = -1.0
        return distance - (self.zeros + zero)[self.zero], design

    @cached_property
    def effects(self) -> tuple[Disturbing, ...]:
        """What could spoil the lengths; of moves, what each length feels at the start values."""
        design = self.computed(np.zeros(sum(self.blocks.values())))[1]

        def felt(block: str) -> Floats:
            """Return what each length (k, 3) feels of what all unknowns of a block do alike."""
            own = design @ self.rows_of(block).T
            return np.asarray(own.reshape(len(design), -1, 3).sum(axis=1))

        once, when = np.zeros(len(design), dtype=np.int64), self.order.astype(np.float64)
        gone, read = drifts(once, when), drifts(self.zero, when)
        moves = np.einsum("kij,kj->ki", _about_axis(self.places)[self.place], felt("place"))
        moved, shifted = Steps(self.place, when, moves), Steps(self.zero, when)
        distance = self.computed(np.zeros(design.shape[1]))[0] + self.zeros[self.zero]
        return (
            Disturbing("drift", "the machine drifts", gone * felt("target"), LARGEST_MOVE, UM),
            Disturbing("drift", "all lengths drift", gone, LARGEST_MOVE, UM),
            Disturbing("drift", "lengths drift", read, LARGEST_MOVE, UM, family=True),
            Disturbing(
                "knock", "the tracer moved on the table", moved, LARGEST_MOVE, UM, family=True
            ),
            Disturbing("slip", "lengths shifted", shifted, LARGEST_MOVE, UM, family=True),
            Disturbing(
                "scale", "the scale of the lengths is wrong", distance[:, None], LARGEST_RATIO, PPM
            ),
        )

    def model(self, curves: Mapping[str, Floats], stated: Sequence[KnownBeforehand]) -> CurveModel:
        """Return the lengths, with what is ``stated``, over the deviations ``curves``."""
        k, size = len(self.observed), sum(self.blocks.values())
        parts = [s for s in stated if len(s.rows)]
        known = np.concatenate([np.zeros((0, size)), *(s.rows for s in parts)])

        def equations(x: Floats) -> tuple[Floats, Derivatives]:
            computed, design = self.computed(x)
            return np.append(computed, known @ x), np.concatenate([design, known])

        counts = [k, *(len(s.rows) for s in parts)]
        beyond = np.full(len(known), -1)

        def below(columns: Floats) -> Floats:
            return np.pad(columns, ((0, len(known)), (0, 0)))

        model = Model(
            blocks=self.blocks,
            observed=np.append(self.observed, np.zeros(len(known))),
            std=np.concatenate([self.std, *(s.std for s in parts)]),
            equations=equations,
            outputs=np.zeros((0, size)),
            words=WORDS,
            unit=UM,
            components=["the lengths", *(s.what for s in parts)],
            component=np.repeat(np.arange(len(counts)), counts),
            judged=np.arange(k + len(known)) < k,
            groupings=[
                Grouping("place", np.append(self.place, beyond)),
                Grouping("position", np.append(self.position, beyond)),
                Grouping("target", np.append(self.target, beyond)),
            ],
            effects=[e.beside(len(known)) for e in self.effects],
            row_names=[
                *(f"length {row}" for row in self.row.tolist()),
                *(f"value {i} of {s.what}" for s in parts for i in range(len(s.rows))),
            ],
        )
        return CurveModel(model.sharing(below(self.common)), self.angles, curves)


def taken(row: Ints, order: Ints) -> tuple[Ints, Ints, Ints]:
    """Return of which station and target each length (k,) is, and when, in the order of taking.

    ``row`` (p, n): of the problem, -1 for none; ``order``: when each row was taken.
    """
    station, target = np.nonzero(row >= 0)
    when = order[row[station, target]]
    first = np.argsort(when, kind="stable")
    return station[first], target[first], when[first]


def _about_axis(places: Floats) -> Floats:
    """Return unit vectors (p, 3, 3): rows from the axis out to each place, around it, and up."""
    out = places * [1.0, 1.0, 0.0] / np.hypot(*places[:, :2].T)[:, None]
    up = np.broadcast_to([0.0, 0.0, 1.0], out.shape)
    return np.stack([out, np.cross(up, out), up], axis=1)


def of_targets(lengths: CarriedLengths, std: Floats, free: bool) -> KnownBeforehand:
    """Return what is stated of the targets: ``std`` (n, 3), m, of each coordinate; or nothing."""
    rows = lengths.rows_of("target", slice(0, 0) if free else slice(None))
    return KnownBeforehand("the targets", rows, np.maximum(std.ravel(), KNOWN)[: len(rows)])


def slips_of(zero: Ints, order: Ints, step_std: float, std: float) -> Floats:
    """Return columns (k, r) of what slips by ``step_std`` (m) at any moment do to the lengths.

    ``zero``, ``order`` (k,): which zero each has, and when it was taken. What is small against
    noise of ``std``, m, is left out.
    """
    found = [np.zeros((len(zero), 0))]
    for number in np.unique(zero) if step_std else ():
        rows = np.flatnonzero(zero == number)
        rows = rows[np.argsort(order[rows], kind="stable")]
        later = np.tri(len(rows))[:, 1:]
        size, ways = np.linalg.eigh(step_std**2 * later @ later.T)
        large = size > SMALL * std**2
        columns = np.zeros((len(zero), int(large.sum())))
        columns[rows] = ways[:, large] * np.sqrt(size[large])
        found.append(columns)
    return np.hstack(found)


def step_of(slip: float, slips: Slips | None, lengths: int) -> float:
    """Return the standard deviation, m, of a zero from one length to the next by unseen slips."""
    return slip * float(np.sqrt(SLIPPED / lengths * (1.0 if slips is None else 1.0 - slips.found)))


def curve_model(
    problem: TracerProblem, solution: TracerSolution | None, joined: Floats | None = None
) -> CurveModel:
    """Return the lengths of one place over ECC at its positions.

    Noise of lengths and targets is that of the lengths alone. Shifts of the table in the plane are
    stated: the error motion, about a centre that is not known. ``solution`` of the lengths alone,
    None where there is none: then ObservabilityError if no error motion is stated.
    ``joined`` (r, p, n), m: what errors in the zeros of joined runs do to the lengths.
    """
    if solution is None:
        grid = arrange(_on_a_circle(problem))[0]
        given, angles = problem.start_stations, problem.table_angles[grid.position_ids]
        given = None if given is None else given[grid.position_ids]
        state = find_any_start(grid, given, angles)[0]
        stations, distances = state[grid.first_strip, :3], state[:, 3]
    else:
        problem, grid, angles = solution.problem, solution.grid, solution.table_angles
        stations, distances = solution.fit.stations, solution.fit.distances
    lengths = _carried(problem, grid, angles, stations, distances, solution)
    if joined is not None:
        strip, target, _ = taken(grid.row, problem.measuring_order)
        together = np.hstack([lengths.common, joined[:, strip, target].T])
        lengths = replace(lengths, common=together)
    m = len(angles)
    plane = [3 * j + axis for j in range(m) for axis in (0, 1)]
    motion = lengths.rows_of("shift", plane) - np.tile(lengths.rows_of("frame"), (m, 1))
    size, spectrum = _error_motion(problem, solution)
    # by combinations that are independent of each other
    covariance = spectrum.covariance(angles) + ROUNDING * np.eye(m)
    whitening = np.linalg.inv(np.linalg.cholesky(covariance))
    motion, std = np.kron(whitening, np.eye(2)) @ motion, np.full(2 * m, max(size, KNOWN))
    return lengths.model(
        {"ECC": lengths.rows_of("turn")},
        [
            of_targets(lengths, grid.target_std, grid.free),
            KnownBeforehand("the error motion", motion, std),
            *_wandering(lengths, grid),
        ],
    )


def _on_a_circle(problem: TracerProblem) -> TracerProblem:
    """Return the problem whose stations need the fewest lengths."""
    return replace(problem, variant="joint", circle_std=problem.circle_std or FREE_CIRCLE)


def _error_motion(
    problem: TracerProblem, solution: TracerSolution | None
) -> tuple[float, Spectrum]:
    """Return standard deviation, m, and spectrum of the error motion: as stated, else as used."""
    stated = problem.error_motion_std
    stated = problem.circle_std if stated is None else stated
    if stated is None and solution is not None:
        return solution.error_motion.used, solution.spectrum
    if stated is None:
        raise ObservabilityError(
            "these lengths alone do not determine the error motion of the table, which they have "
            "to be weighed by beside other instruments: state solver.error_motion_std_m"
        )
    return stated, WHITE


def _carried(
    problem: TracerProblem,
    grid: Grid,
    angles: Floats,
    stations: Floats,
    distances: Floats,
    solution: TracerSolution | None,
) -> CarriedLengths:
    """Return the lengths of a ``grid``, from ``stations`` (m, 3) and ``distances`` (p,), m."""
    axes = np.eye(3)
    if len(stations) >= CIRCLE:
        plane = table_motion(stations, angles).plane
        axes = np.column_stack([*plane.basis(), plane.normal])
    # local place of each station = centre + Rz(angle) q
    local, m = stations @ axes, len(stations)
    about = rotation_about_z(angles)[:, :2, :2]
    design = np.concatenate([np.tile(np.eye(2), (m, 1, 1)), about], axis=2).reshape(2 * m, 4)
    found = np.linalg.lstsq(design, local[:, :2].ravel())[0]
    strip, target, order = taken(grid.row, problem.measuring_order)
    zero = grid.station if grid.zero is None else grid.zero
    row, std = grid.row[strip, target], grid.length_std[strip, target]
    slipping = problem.slip if grid.segment_ids is not None and problem.segment is not None else 0
    step = step_of(slipping, None if solution is None else solution.slips, len(row))
    return CarriedLengths(
        observed=grid.length[strip, target],
        std=std,
        position=grid.station[strip],
        place=np.zeros_like(strip),
        target=target,
        zero=zero[strip],
        row=row,
        order=order,
        angles=angles,
        places=np.array([[*found[2:], 0.0]]),
        targets=grid.targets,
        zeros=distances[grid.first_of_zero],
        axes=axes,
        origin=axes @ [*found[:2], local[:, 2].mean()],
        common=slips_of(grid.segment_of_strip[strip], order, step, float(std.min())),
    )


def _wandering(lengths: CarriedLengths, grid: Grid) -> list[KnownBeforehand]:
    """Return what is stated of zeros that wander from one length to the next."""
    if grid.walk is None:
        return []
    rows, there = lengths.rows_of("zero"), np.flatnonzero(np.isfinite(grid.walk))
    return [
        KnownBeforehand("the walk of the zero", rows[there + 1] - rows[there], grid.walk[there])
    ]
