"""Lengths from a table that carries the instrument, as a model of the engine: one way for all.

A place q of the instrument stands at v + U (d + R(c) Rz(angle) q) while the table is at an angle,
with its deviations d, m, and c, rad. Its lengths to the targets count from zeros. All unknowns are
changes of the start values. What is stated beforehand, such as the coordinates of the targets, is
among the observations, never to be left out. Slips that would not be found are errors that
lengths have in common.

Every length feels its position, its target, and few that all share. So the derivatives are given
by their entries, and stations or targets fall into groups (:mod:`rotcal_ros.adjust.bordered`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np
from scipy.sparse import csr_array, vstack

from rotcal_ros.adjust.gathering import Words
from rotcal_ros.adjust.model import (
    Disturbing,
    Grouping,
    Model,
    Steps,
    Unit,
    drifts,
    recurring,
)
from rotcal_ros.adjust.outputs import Outputs
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.units import MICROMETRE
from rotcal_ros.geometry.rotations import cross_matrix, rotation_about_z, rotation_from_vector
from rotcal_ros.planning.readings import passes

SMALL: Final = 1e-3
"""Variance, as a share of that of the lengths, that is too small to matter."""
KNOWN: Final = 1e-9
"""Standard deviation (m) of a coordinate that is called known, where others have errors."""
DATUM: Final = 1e-6
"""Standard deviation (m) of what is defined: any will do, for no length contradicts it."""
FIRM: Final = 1e-9
"""Share below which a turn of targets in one line is none."""
LARGEST_MOVE: Final = 1e-4
"""Drift or knock (m) that could not be overlooked."""
LARGEST_RATIO: Final = 1e-3
"""Error of the scale, or of the air's index per metre of height, that could not be missed."""
MOMENTS: Final = 64
"""Moments at which the instrument may move: one between two is seen nearly as well."""
PLACES: Final = 4_000_000
"""Numbers in what is tried of an effect, 32 MB: of very many lengths fewer moments."""
UM: Final = Unit("um", MICROMETRE)
PPM: Final = Unit("um/m", 1e-6)
WORDS: Final = Words(
    "lengths", "warm air, a person or an obstacle", "in the beams", "in its beams"
)


class KnownBeforehand(NamedTuple):
    """What is known of unknowns: ``rows`` (b, p) times them is 0 +- ``std`` (b,)."""

    what: str
    rows: csr_array
    std: Floats


@dataclass(frozen=True, eq=False)
class CarriedLengths:
    """Lengths ``observed`` +- ``std`` (k,), m, and where they were taken; start values.

    ``position``, ``place``, ``target``, ``zero`` (k,): indices into ``angles`` (m,) rad,
    ``places`` (p, 3), ``targets`` (n, 3) and ``zeros`` (s,), m. ``row``, ``order`` (k,): of the
    problem, and when. ``axes`` U (3, 3), ``origin`` v (3,) m. ``beam`` (k,): which unbroken beam
    each length is of; None: zeros are those. ``unbroken``: lengths of several stations are of one,
    whose counter may slip. ``later`` (k,): which of the ``later_zeros`` joins the zero of a
    length, -1 for none. ``called``: numbers (m,) and (n,) by which people call positions and
    targets; None: as they are. ``more``: blocks of further unknowns, which lengths do not feel.
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
    beam: Ints | None = None
    unbroken: bool = False
    later: Ints | None = None
    later_zeros: int = 0
    called: tuple[Ints, Ints] | None = None
    more: Mapping[str, int] = field(default_factory=dict)

    @cached_property
    def blocks(self) -> dict[str, int]:
        """The unknowns; lengths feel nothing of the frame, in which shifts are stated."""
        m = len(self.angles)
        return {
            "shift": 3 * m,
            "turn": m,
            "place": len(self.places),
            "zero": len(self.zeros),
            "target": self.targets.size,
            "frame": 2,
            **({"zero of a later run": self.later_zeros} if self.later_zeros else {}),
            **self.more,
        }

    @cached_property
    def first(self) -> dict[str, int]:
        """Where each block begins among the unknowns."""
        sizes = list(self.blocks.values())
        return dict(zip(self.blocks, np.cumsum([0, *sizes[:-1]]).tolist(), strict=True))

    @property
    def size(self) -> int:
        """How many unknowns there are."""
        return sum(self.blocks.values())

    @cached_property
    def ways(self) -> Floats:
        """Unit vectors (p, 3) along which each place is unknown: out from the axis.

        Along it and up it is a shift of all.
        """
        flat = self.places * [1.0, 1.0, 0.0]
        return np.asarray(flat / np.linalg.norm(flat, axis=1)[:, None])

    def rows_of(self, block: str, number: Sequence[int] | Ints | slice = slice(None)) -> csr_array:
        """Return rows that take unknowns of a block out of all, by their entries."""
        unknown = self.first[block] + np.arange(self.blocks[block])[number]
        count = len(unknown)
        entries = np.ones(count), unknown, np.arange(count + 1)
        return csr_array(entries, shape=(count, self.size))

    @cached_property
    def _entries(self) -> tuple[Ints, Ints]:
        """Columns of what each length feels, and where those of each begin (k + 1,)."""
        first = self.first
        every = [
            first["shift"] + 3 * self.position[:, None] + np.arange(3),
            first["turn"] + self.position[:, None],
            first["place"] + self.place[:, None],
            first["zero"] + self.zero[:, None],
            first["target"] + 3 * self.target[:, None] + np.arange(3),
        ]
        if self.later_zeros:
            assert self.later is not None
            every.append(first["zero of a later run"] + np.maximum(self.later, 0)[:, None])
        column = np.concatenate(every, axis=1)
        return column.ravel(), column.shape[1] * np.arange(len(column) + 1)

    def standing(self, x: Floats) -> Floats:
        """Return where the instrument stands (m, 3) at its first place, at the unknowns, m."""
        every = np.arange(len(self.angles))
        return self._stands(x, every, np.zeros_like(every))[0]

    def _stands(self, x: Floats, position: Ints, place: Ints) -> tuple[Floats, Floats, Floats]:
        """Return where it stands (k, 3), its arms (k, 3) as turned, and turns (m, 3)."""
        m, first = len(self.angles), self.first
        shift, turn = x[: 3 * m].reshape(m, 3), x[3 * m : first["place"]]
        vector = np.zeros_like(shift)
        vector[:, 2] = turn
        carry = rotation_from_vector(vector) @ rotation_about_z(self.angles)
        moved = x[first["place"] : first["zero"], None] * self.ways
        arm = np.einsum("kij,kj->ki", carry[position], (self.places + moved)[place])
        return self.origin + (shift[position] + arm) @ self.axes.T, arm, vector

    def computed(self, x: Floats) -> tuple[Floats, csr_array]:
        """Return the lengths (k,) and their derivatives (k, p) at the unknowns."""
        first = self.first
        stands, arm, vector = self._stands(x, self.position, self.place)
        target = x[first["target"] : first["frame"]].reshape(-1, 3)
        away = stands - (self.targets + target)[self.target]
        distance = np.linalg.norm(away, axis=1)
        unit = away / distance[:, None]
        felt = unit @ self.axes
        slope = np.eye(3) + 0.5 * cross_matrix(vector)  # of R(c), to the first order of c
        turned = np.einsum("ki,kij->kj", np.cross(arm, felt), slope[self.position])
        carry = rotation_from_vector(vector) @ rotation_about_z(self.angles)
        carried = np.einsum("ki,kij->kj", felt, carry[self.position])
        moved = np.einsum("kj,kj->k", carried, self.ways[self.place])[:, None]
        values = [felt, turned[:, 2:], moved, np.full((len(felt), 1), -1.0), -unit]
        zero = (self.zeros + x[first["zero"] : first["target"]])[self.zero]
        if self.later_zeros:
            assert self.later is not None
            later = (self.later >= 0).astype(np.float64)
            begin = first["zero of a later run"]
            zero = zero + later * x[begin : begin + self.later_zeros][np.maximum(self.later, 0)]
            values.append(-later[:, None])
        column, begins = self._entries
        entries = np.concatenate(values, axis=1).ravel(), column, begins
        return distance - zero, csr_array(entries, shape=(len(distance), self.size))

    @cached_property
    def beams(self) -> Floats:
        """From where each length was taken to its target at the start values, (k, 3), m."""
        stands = self._stands(np.zeros(self.size), self.position, self.place)[0]
        return np.asarray(self.targets[self.target] - stands)

    @cached_property
    def effects(self) -> tuple[Disturbing, ...]:
        """What could spoil the lengths, as they feel it at the start values."""
        once, when = np.zeros(len(self.observed), dtype=np.int64), self.order.astype(np.float64)
        beam = self.zero if self.beam is None else self.beam
        distance = np.linalg.norm(self.beams, axis=1)
        toward = self.beams / distance[:, None]
        arms = self.targets - self.origin
        reach = float(np.linalg.norm(arms, axis=1).max())
        spin = (cross_matrix(self.axes[None, :, 2])[0] @ arms.T).T[self.target] / reach
        turning = (toward * spin).sum(axis=1)[:, None]
        machine = np.hstack([toward, turning])
        again = passes(self.place, self.position, self.order)
        returning = np.hstack([machine * shape[:, None] for shape in recurring(again, when).T])
        gone = drifts(once, when)
        # the index at the mean height of a beam is that along it, for it grows linearly
        height = self.targets[self.target, 2] - 0.5 * self.beams[:, 2]
        layered = distance * (height - height.mean())
        frame = "the machine's frame drifts"
        effects = [
            Disturbing("drift", frame, gone * toward, LARGEST_MOVE, UM),
            Disturbing("drift", "the machine's frame turns", gone * turning, LARGEST_MOVE, UM),
            Disturbing("drift", "all lengths drift", gone, LARGEST_MOVE, UM),
            Disturbing("recurring drift", f"{frame} or turns in each turn of the table alike",
                       returning, LARGEST_MOVE, UM),
            Disturbing("knock", "the tracer moved on the table", self._knocks, LARGEST_MOVE, UM,
                       family=True, of_each=3, stays=True),
            Disturbing("refraction", "air lies in layers", layered[:, None], LARGEST_RATIO, PPM),
            Disturbing("scale", "the scale of the lengths is wrong", distance[:, None],
                       LARGEST_RATIO, PPM),
        ]  # fmt: skip
        if self.unbroken:
            effects.insert(5, self._slipping(beam, when))
        if 1 < len(np.unique(beam)) <= PLACES // len(beam):
            read = drifts(beam, when)
            effects.insert(
                3, Disturbing("drift", "lengths drift", read, LARGEST_MOVE, UM, family=True)
            )
        return tuple(effects)

    def _slipping(self, beam: Ints, when: Floats) -> Disturbing:
        """Return that a zero jumps within an unbroken beam."""
        shifts = Steps(beam, when)
        return Disturbing(
            "slip", "lengths shifted", shifts, LARGEST_MOVE, UM, family=True, stays=True
        )

    @cached_property
    def _knocks(self) -> Floats:
        """Moves of each place by a metre out, along and up, from some moments on, (k, 3 t)."""
        toward = self.beams / np.linalg.norm(self.beams, axis=1)[:, None]
        out = np.hypot(*self.places[:, :2].T)[:, None]
        outward = self.places * [1.0, 1.0, 0.0] / np.where(out > 0.0, out, 1.0)
        up = np.broadcast_to([0.0, 0.0, 1.0], outward.shape)
        ways = np.stack([outward, np.cross(up, outward), up], axis=1)[self.place]
        carried = rotation_about_z(self.angles)[self.position]
        moved = np.einsum("kwj,kij->kwi", ways, carried) @ self.axes.T
        felt = -np.einsum("kwi,ki->kw", moved, toward)
        steps = Steps(self.place, self.order.astype(np.float64))
        most = max(1, min(MOMENTS, PLACES // (3 * len(felt))))
        some = steps.whole(slice(None, None, max(1, -(-steps.shape[1] // most))))
        return np.asarray((some[:, :, None] * felt[:, None]).reshape(len(felt), -1))

    def groupings(self, beyond: Ints) -> list[Grouping]:
        """Return what may be spoiled together, none of what is ``beyond`` the lengths."""
        position, target = self.called or (
            np.arange(len(self.angles)),
            np.arange(len(self.targets)),
        )
        round_ = np.append(np.arctan2(self.beams[:, 1], self.beams[:, 0]), np.zeros(len(beyond)))
        toward = self.beams / np.linalg.norm(self.beams, axis=1)[:, None]
        toward = np.pad(toward, ((0, len(beyond)), (0, 0)))
        station = Grouping(
            "station", np.append(position[self.position], beyond), round_, toward, closed=True
        )
        found = [station, Grouping("target", np.append(target[self.target], beyond))]
        if len(self.places) > 1:
            found.insert(0, Grouping("place", np.append(self.place, beyond)))
        rank = np.argsort(np.argsort(self.order, kind="stable"), kind="stable")
        arrivals = 1 + int((np.diff(self.position[np.argsort(rank)]) != 0).sum())
        if arrivals > len(self.angles):  # else stretches of time are the stations
            size = max(len(rank) // len(self.angles), 8)
            time = np.append(rank.astype(np.float64), np.zeros(len(beyond)))
            found.append(Grouping("stretch of time", np.append(rank // size, beyond), time))
        return found

    def over(self, outputs: Outputs, stated: Sequence[KnownBeforehand]) -> Model:
        """Return the lengths, with what is ``stated``, and the ``outputs`` that are asked for."""
        k, parts = len(self.observed), [s for s in stated if len(s.std)]
        none = csr_array((0, self.size))
        known = csr_array(vstack([none, *(s.rows for s in parts)], format="csr"))

        def equations(x: Floats) -> tuple[Floats, csr_array]:
            computed, design = self.computed(x)
            data = np.append(design.data, known.data), np.append(design.indices, known.indices)
            begins = np.append(design.indptr, design.indptr[-1] + known.indptr[1:])
            whole = csr_array((*data, begins), shape=(k + known.shape[0], self.size))
            return np.append(computed, known @ x), whole

        counts, names = (
            [k, *(len(s.std) for s in parts)],
            ["the lengths", *(s.what for s in parts)],
        )
        components = list(dict.fromkeys(names))
        component = [components.index(name) for name in names]
        beyond = np.full(known.shape[0], -1)

        return Model(
            blocks=self.blocks,
            observed=np.append(self.observed, np.zeros(len(beyond))),
            std=np.concatenate([self.std, *(s.std for s in parts)]),
            equations=equations,
            outputs=outputs,
            words=WORDS,
            unit=UM,
            components=components,
            component=np.repeat(component, counts),
            judged=np.arange(k + len(beyond)) < k,
            groupings=self.groupings(beyond),
            effects=[e.beside(len(beyond)) for e in self.effects],
            row_names=self._names
            + [f"value {i} of {s.what}" for s in parts for i in range(len(s.std))],
        )

    @property
    def _names(self) -> list[str]:
        position, target = self.called or (
            np.arange(len(self.angles)),
            np.arange(len(self.targets)),
        )
        pairs = zip(
            self.place.tolist(), position[self.position].tolist(), target[self.target].tolist(),
            strict=True,
        )  # fmt: skip
        several = len(self.places) > 1
        return [
            f"place {q}, station {j}, target {i}" if several else f"station {j}, target {i}"
            for q, j, i in pairs
        ]


def taken(row: Ints, order: Ints) -> tuple[Ints, Ints, Ints]:
    """Return of which station and target each length (k,) is, and when, in the order of taking.

    ``row`` (p, n): of the problem, -1 for none; ``order``: when each row was taken.
    """
    station, target = np.nonzero(row >= 0)
    when = order[row[station, target]]
    first = np.argsort(when, kind="stable")
    return station[first], target[first], when[first]


def of_targets(lengths: CarriedLengths, std: Floats, free: bool) -> list[KnownBeforehand]:
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
            f"the targets' {axis}",
            lengths.rows_of("target", slice(a, None, 3)),
            np.maximum(std[:, a], KNOWN),
        )
        for a, axis in enumerate("xyz")
    ]


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
