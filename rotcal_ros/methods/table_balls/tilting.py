"""An axis below the table's, A or B, that tilts it: its line, and its own motions.

With the tilt alpha all that the table carries stands at

    p = t + R u + (q + e) x R u - R (q x u) + d,    u = w - t,    R = Rx(alpha) (B: Ry)

w is where it stands with the tilt at 0, t = t0 + the place of the axis average line (YOA and ZOA;
B: XOB and ZOB), q its direction (BOA, COA; AOB, COB), d and e the motions (EXA, EYA, EZA) and
(EAA, EBA, ECA) at that tilt. Products of small turns are left out.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.units import DEGREE
from rotcal_ros.geometry.rotations import cross_matrix, rotation_from_vector
from rotcal_ros.methods.table_balls.settings import BallsPlanSettings, below_the_table, sense_of


@dataclass(frozen=True, eq=False)
class Tilting:
    """The axis ``letter`` through ``point`` (3,), m, at the ``tilts`` (t,), rad.

    They count counter-clockwise; ``degrees`` (t,) are the commanded ones.
    """

    letter: str
    point: Floats
    tilts: Floats
    degrees: tuple[float, ...]

    @classmethod
    def of(cls, plan: BallsPlanSettings) -> Tilting | None:
        """Return that of a plan; None: the table stands on no other."""
        letter = below_the_table(plan.chain)
        if not letter:
            return None
        tilts = sense_of(plan.chain, letter) * np.array(plan.tilts_deg) * DEGREE
        return cls(letter, np.array(plan.tilting_axis_m), tilts, plan.tilts_deg)

    @property
    def along(self) -> int:
        """The direction of the axis: 0 for x, 1 for y."""
        return "AB".index(self.letter)

    @property
    def across(self) -> tuple[int, int]:
        """The other two, so that the three are right-handed."""
        return (self.along + 1) % 3, (self.along + 2) % 3

    @property
    def line(self) -> tuple[str, ...]:
        """Names of the unknowns of its line: two places, then two turns, in the order of x y z."""
        axes = sorted(self.across)
        return tuple(f"{'XYZABC'[part + k]}O{self.letter}" for part in (0, 3) for k in axes)

    @property
    def motions(self) -> tuple[str, ...]:
        """Names of its motions, such as EXA to ECA."""
        return tuple(f"E{part}{self.letter}" for part in "XYZABC")

    @cached_property
    def turns(self) -> Floats:
        """The nominal rotations (t, 3, 3)."""
        return rotation_from_vector(self.tilts[:, None] * np.eye(3)[self.along])

    def back(self, points: Floats, tilt: Ints) -> Floats:
        """Return points (n, 3) as a perfect axis would have them at a tilt of 0."""
        inverse = np.swapaxes(self.turns, -1, -2)[tilt]
        return np.asarray(self.point + np.einsum("nij,nj->ni", inverse, points - self.point))

    def forth(self, points: Floats, tilt: int) -> Floats:
        """Return where a perfect axis takes ``points`` (..., 3) at a tilt."""
        return np.asarray(self.point + (points - self.point) @ self.turns[tilt].T)

    def of_line(self, four: Floats) -> tuple[Floats, Floats]:
        """Return the vectors (3,) of place and of direction that the unknowns of the line are."""
        place, turn = np.zeros(3), np.zeros(3)
        axes = sorted(self.across)
        place[axes], turn[axes] = four[:2], four[2:]
        return place, turn

    def tilted(
        self, away: Floats, tilt: Ints, line: Floats, motions: Floats
    ) -> tuple[Floats, Floats, Floats, Floats]:
        """Return ``away`` (n, 3), from t0, after the tilt; its derivatives.

        ``line`` (4,), ``motions`` (n, 6). The derivatives are by ``away`` (n, 3, 3), by the line
        (n, 3, 4), and by the motions at that tilt (n, 3, 6).
        """
        place, turn = self.of_line(line)
        d, e = motions[:, :3], motions[:, 3:]
        nominal, u = self.turns[tilt], away - place
        by_away = nominal + cross_matrix(turn + e) @ nominal - nominal @ cross_matrix(turn)
        carried = np.einsum("nij,nj->ni", nominal, u)
        by_turn = nominal @ cross_matrix(u) - cross_matrix(carried)
        axes = sorted(self.across)
        by_line = np.concatenate([(np.eye(3) - by_away)[:, :, axes], by_turn[:, :, axes]], axis=2)
        shift = np.broadcast_to(np.eye(3), by_away.shape)
        by_motions = np.concatenate([shift, -cross_matrix(carried)], axis=2)
        moved = place + np.einsum("nij,nj->ni", by_away, u) + d
        return moved, by_away, by_line, by_motions

    def definitions(self) -> Iterator[dict[str, Floats]]:
        """Yield what is zero by definition, as of the table's own motions.

        No motion has a mean; the pairs across the axis have no part that turns with it: that is
        where it stands, and where the table's axis stands on it.
        """
        mean, c, s = np.ones(len(self.tilts)), np.cos(self.tilts), np.sin(self.tilts)
        yield from ({name: mean} for name in self.motions)
        for part in (0, 3):
            x, y = (self.motions[part + k] for k in self.across)
            yield from ({x: c, y: s}, {x: -s, y: c})

    def table_axis(self, origin: Floats) -> dict[str, Floats]:
        """Return how the table's axis at ``origin`` (3,) feels the line (4) and the motions.

        By name of AXIS rows (t, 4 + 6 t), seen as with the tilt at 0.
        """
        count = len(self.tilts)
        inverse = np.swapaxes(self.turns, -1, -2)
        away = np.repeat((origin - self.point)[None], count, axis=0)
        _, _, by_line, by_motions = self.tilted(
            away, np.arange(count), np.zeros(4), np.zeros((count, 6))
        )
        line_turn = (inverse - np.eye(3))[:, :, sorted(self.across)]
        shift = np.concatenate([inverse @ by_line, np.zeros((count, 3, 6 * count))], axis=2)
        turn = np.concatenate(
            [np.zeros((count, 3, 2)), line_turn, np.zeros((count, 3, 6 * count))], axis=2
        )
        for k in range(6):
            column = 4 + k * count + np.arange(count)
            shift[np.arange(count), :, column] = (inverse @ by_motions)[:, :, k]
            if k >= 3:
                turn[np.arange(count), :, column] = inverse[:, :, k - 3]
        return {"XOC": shift[:, 0], "YOC": shift[:, 1], "AOC": turn[:, 0], "BOC": turn[:, 1]}
