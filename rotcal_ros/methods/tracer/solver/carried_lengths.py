"""Lengths from a table that carries the instrument, and where they were taken: one way for all.

A place q of the instrument stands at v + U (d + R(c) Rz(angle) q) while the table is at an angle,
with its deviations d, m, and c, rad. Its lengths to the targets count from zeros. What is stated
beforehand, such as the coordinates of the targets, is among the observations, never to be left
out. Slips that would not be found are errors that lengths have in common.

Every length feels its position, its target, and few that all share. So the derivatives are given
by their entries, and stations or targets fall into groups (:mod:`rotcal_ros.adjust.bordered`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np
from scipy.sparse import csr_array

from rotcal_ros.adjust.gathering import Words
from rotcal_ros.adjust.model import Model, Unit
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.units import MICROMETRE
from rotcal_ros.geometry.rotations import cross_matrix, rotation_about_z, rotation_from_vector

KNOWN: Final = 1e-9
"""Standard deviation (m) of a coordinate that is called known, where others have errors."""
LARGEST_MOVE: Final = 1e-4
"""Drift or knock (m) that could not be overlooked."""
LARGEST_RATIO: Final = 1e-3
"""Error of the scale, or of the air's index per metre of height, that could not be missed."""
UM: Final = Unit("um", MICROMETRE)
PPM: Final = Unit("um/m", 1e-6)
WORDS: Final = Words(
    "lengths", "warm air, a person or an obstacle", "in the beams", "in its beams"
)
LATER_RUN: Final = "zero of a later run"
SCATTER: Final = "scatter of an arrival"
"""The block of how far each station is off, when the table does not repeat."""
LAG: Final = "lag"
"""The block of how late the feedback of a table that turns is behind its lengths, s."""


class KnownBeforehand(NamedTuple):
    """What is known of unknowns: ``rows`` (b, p) times them is 0 +- ``std`` (b,)."""

    what: str
    rows: csr_array
    std: Floats

    def beside(self, model: Model) -> Model:
        """Return the model with it."""
        return model.with_prior(self.what, self.rows, np.zeros(len(self.std)), self.std)


@dataclass(frozen=True, eq=False)
class CarriedLengths:
    """Lengths ``observed`` +- ``std`` (k,), m, and where they were taken; start values.

    ``position``, ``place``, ``target``, ``zero`` (k,): indices into ``angles`` (m,) rad,
    ``places`` (p, 3), ``targets`` (n, 3) and ``zeros`` (s,), m. ``row``, ``order`` (k,): of the
    problem, and when; ``station`` (k,): at which arrival of the table. ``axes`` U (3, 3),
    ``origin`` v (3,) m. ``turning``: about which axes the table may be off its angles;
    ``place_ways`` (3 p, a), ``target_ways`` (3 n, b): how places and targets may move, None: in
    any way. ``more``: blocks of further unknowns, of which lengths feel two: LATER_RUN, the zeros
    that join that of a length where ``later`` (k,) is not -1, and SCATTER. ``beam`` (k,): which
    unbroken beam each length is of; None: zeros are those. ``poses``: shifts and turns (m, 3)
    from which these unknowns begin; all others are changes.
    """

    observed: Floats
    std: Floats
    position: Ints
    place: Ints
    target: Ints
    zero: Ints
    row: Ints
    order: Ints
    station: Ints
    angles: Floats
    places: Floats
    targets: Floats
    zeros: Floats
    axes: Floats
    origin: Floats
    place_ways: Floats
    turning: Sequence[int] = (2,)
    target_ways: Floats | None = None
    more: Mapping[str, int] = field(default_factory=dict)
    later: Ints = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    beam: Ints | None = None
    speed: Floats | None = None
    poses: tuple[Floats, Floats] | None = None

    @cached_property
    def blocks(self) -> dict[str, int]:
        """The unknowns, and how many of each."""
        m = len(self.angles)
        return {
            "shift": 3 * m,
            "turn": len(self.turning) * m,
            "place": self.place_ways.shape[1],
            "zero": len(self.zeros),
            "target": self.targets.size if self.target_ways is None else self.target_ways.shape[1],
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
    def start(self) -> Floats:
        """The unknowns (p,) at the start values."""
        known = np.concatenate([each.ravel() for each in self.poses or (np.zeros(0),)])
        return np.pad(known, (0, self.size - len(known)))

    def rows_of(self, block: str, number: Sequence[int] | Ints | slice = slice(None)) -> csr_array:
        """Return rows that take unknowns of a block out of all, by their entries."""
        unknown = self.first[block] + np.arange(self.blocks[block])[number]
        count = len(unknown)
        entries = np.ones(count), unknown, np.arange(count + 1)
        return csr_array(entries, shape=(count, self.size))

    def part(self, x: Floats, block: str) -> Floats:
        """Return the unknowns of a block; of poses and points (k, 3), turns in all ways."""
        found = x[self.first[block] : self.first[block] + self.blocks[block]]
        if block in ("zero", LATER_RUN, LAG):
            return found
        if block == "turn":
            turns = np.zeros((len(self.angles), 3))
            turns[:, self.turning] = found.reshape(len(turns), -1)
            return turns
        ways = {"place": self.place_ways, "target": self.target_ways}.get(block)
        return (found if ways is None else ways @ found).reshape(-1, 3)

    def standing(self, x: Floats) -> Floats:
        """Return where the instrument stands (m, 3) at its first place, at the unknowns, m."""
        every = np.arange(len(self.angles))
        return self._stands(x, every, np.zeros_like(every))[0]

    def stands(self, x: Floats) -> tuple[Floats, Floats, Floats]:
        """Return where it stands (k, 3), its arms R(c) Rz q (k, 3), and R(c) Rz (k, 3, 3)."""
        ahead = None if self.speed is None else self.speed * self.part(x, LAG)
        stands, arm, carry = self._stands(x, self.position, self.place, ahead)
        if SCATTER in self.blocks:
            stands = stands + self.part(x, SCATTER)[self.station]
        return stands, arm, carry

    def _stands(
        self, x: Floats, position: Ints, place: Ints, ahead: Floats | None = None
    ) -> tuple[Floats, Floats, Floats]:
        turned = rotation_from_vector(self.part(x, "turn")) @ rotation_about_z(self.angles)
        carry = turned[position]
        if ahead is not None:
            carry = carry @ rotation_about_z(ahead)
        arm = np.einsum("kij,kj->ki", carry, (self.places + self.part(x, "place"))[place])
        out = self.part(x, "shift")[position] + arm
        return self.origin + out @ self.axes.T, arm, carry

    @cached_property
    def _felt(self) -> list[tuple[str, Ints, Floats | None]]:
        """The blocks that lengths feel, the number (k,) of each one's, and how these may move."""
        found = [
            ("shift", self.position, None),
            ("turn", self.position, None),
            ("place", self.place, self.place_ways),
            ("zero", self.zero, None),
            ("target", self.target, self.target_ways),
        ]
        if LATER_RUN in self.blocks:
            found.append((LATER_RUN, np.maximum(self.later, 0), None))
        if SCATTER in self.blocks:
            found.append((SCATTER, self.station, None))
        if self.speed is not None:
            found.append((LAG, np.zeros_like(self.position), None))
        return found

    @cached_property
    def _entries(self) -> tuple[Ints, Ints]:
        """Columns of what each length feels, and where those of each begin (k + 1,)."""
        every, k = list[Ints](), len(self.row)
        widths = {"turn": len(self.turning), "zero": 1, LATER_RUN: 1, LAG: 1}
        for block, number, ways in self._felt:
            first = self.first[block]
            if ways is None:
                width = widths.get(block, 3)
                every.append(first + width * number[:, None] + np.arange(width))
            else:
                every.append(np.broadcast_to(first + np.arange(ways.shape[1]), (k, ways.shape[1])))
        column = np.concatenate(every, axis=1)
        return column.ravel(), column.shape[1] * np.arange(k + 1)

    def computed(self, x: Floats) -> tuple[Floats, csr_array]:
        """Return the lengths (k,) and their derivatives (k, p) at the unknowns."""
        stands, arm, carry = self.stands(x)
        away = stands - (self.targets + self.part(x, "target"))[self.target]
        distance = np.linalg.norm(away, axis=1)
        unit = away / distance[:, None]
        felt = unit @ self.axes
        slope = _slope(self.part(x, "turn"))[self.position]
        turned = np.einsum("ki,kij->kj", np.cross(arm, felt), slope)[:, self.turning]
        carried = np.einsum("ki,kij->kj", felt, carry)
        zero = (self.zeros + self.part(x, "zero"))[self.zero]
        values = [felt, turned, carried, np.full((len(felt), 1), -1.0), -unit]
        if LATER_RUN in self.blocks:
            later = (self.later >= 0).astype(np.float64)
            zero = zero + later * self.part(x, LATER_RUN)[np.maximum(self.later, 0)]
            values.append(-later[:, None])
        if SCATTER in self.blocks:
            values.append(unit)
        if self.speed is not None:  # about the axis of the table as it turned
            along = np.cross(carry[:, :, 2], arm)
            values.append((self.speed * (felt * along).sum(axis=1))[:, None])
        for k, (_, number, ways) in enumerate(self._felt):
            if ways is not None:
                own = ways.reshape(-1, 3, ways.shape[1])[number]
                values[k] = np.einsum("ki,kij->kj", values[k], own)
        column, begins = self._entries
        entries = np.concatenate(values, axis=1).ravel(), column, begins
        return distance - zero, csr_array(entries, shape=(len(distance), self.size))

    @cached_property
    def beams(self) -> Floats:
        """From where each length was taken to its target at the start values, (k, 3), m."""
        return np.asarray(self.targets[self.target] - self.stands(self.start)[0])

    @cached_property
    def distance(self) -> Floats:
        """The lengths (k,) of the beams, m."""
        return np.asarray(np.linalg.norm(self.beams, axis=1))

    @cached_property
    def toward(self) -> Floats:
        """Unit vectors (k, 3) along the beams."""
        return np.asarray(self.beams / self.distance[:, None])

    @property
    def layered(self) -> Floats:
        """What lengths (k,) feel of an index that grows by 1 per metre of height.

        The index at the mean height of a beam is that along it, for it grows linearly.
        """
        height = self.targets[self.target, 2] - 0.5 * self.beams[:, 2]
        return np.asarray(self.distance * (height - height.mean()))


def _slope(vector: Floats) -> Floats:
    """Return how R(c) turns further with its vector c (..., 3), to the third order of it."""
    across = cross_matrix(vector)
    return np.asarray(np.eye(3) + 0.5 * across + across @ across / 6.0)


def order_taken(row: Ints, order: Ints) -> tuple[Ints, Ints, Ints]:
    """Return of which strip and target each length (k,) is, and when, in the order of taking.

    ``row`` (p, n): of the problem, -1 for none; ``order``: when each row was taken.
    """
    strip, target = np.nonzero(row >= 0)
    when = order[row[strip, target]]
    first = np.argsort(when, kind="stable")
    return strip[first], target[first], when[first]
