"""Finds the angles at which several curves are combined: those at which any was measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.curves.interpolation import SAME_ANGLE, TURN, interpolation_matrix
from rotcal_ros.foundation.curves.measured import MeasuredCurve, covers_circle
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.units import DEGREE

SAME: Final = 1e3 * SAME_ANGLE
"""rad; angles of two curves that are closer than this count as common, as in a comparison."""
LINKING: Final = 2
"""Least common angles that join two curves; with a single one a shift would not show."""


@dataclass(frozen=True, eq=False)
class Joined:
    """The angles (n,) rad of a combined curve, ascending, and how each input sees the curve.

    ``designs`` holds for every input the matrix (m_k, n) and ``rows`` which of its values (m_k,)
    are used. ``interpolated`` (k,) marks inputs with too few angles in common.
    """

    angles: Floats
    period: float
    designs: tuple[Floats, ...]
    rows: tuple[Ints, ...]
    interpolated: tuple[bool, ...]


def join_angles(curves: Sequence[MeasuredCurve]) -> Joined:
    """Return the union of the angles of all curves that are joined by common ones.

    Curves that share fewer than two angles with the rest are compared with it by interpolation,
    as :func:`~rotcal_ros.evaluation.compare.compare` does, and add no angles of their own. The
    order of the curves does not matter.
    """
    turn = any(curve.period for curve in curves)
    at = [np.mod(curve.angles, TURN) if turn else curve.angles for curve in curves]
    nodes, places = _merged(at, turn)
    linked = _linked([set(place.tolist()) for place in places])
    # Of groups of equal size the one that begins first: the order of the inputs says nothing.
    main = min(linked, key=lambda group: (-len(group), sorted(group)))
    chosen = np.array(sorted(main))
    angles = nodes[chosen]
    period = TURN if turn or covers_circle(angles) else 0.0
    designs, rows, interpolated = [], [], []
    for place, own in zip(places, at, strict=True):
        member = main.issuperset(place.tolist())
        row = np.arange(len(own)) if member or period else _within(angles, own)
        if member:
            design = (place[:, None] == chosen).astype(np.float64)
        else:
            design = interpolation_matrix(angles, own[row], period)
        designs.append(design)
        rows.append(row)
        interpolated.append(not member)
    return Joined(angles, period, tuple(designs), tuple(rows), tuple(interpolated))


def union(angles: Sequence[Floats], turn: bool) -> Floats:
    """Return all ``angles`` once, ascending, wrapped into one turn when they go round."""
    return _merged([np.mod(a, TURN) if turn else a for a in angles], turn)[0]


def _merged(at: Sequence[Floats], turn: bool) -> tuple[Floats, list[Ints]]:
    """Return the distinct angles, and for every curve which of them are its own."""
    every = np.concatenate(at)
    if turn:
        every = np.where(TURN - every < SAME, every - TURN, every)
    order = np.argsort(every, kind="stable")
    new = np.append(True, np.diff(every[order]) > SAME)
    index = np.empty(len(every), dtype=np.int64)
    index[order] = np.cumsum(new) - 1
    nodes = every[order][new]
    nodes[np.abs(nodes) < SAME] = 0.0
    return nodes, np.split(index, np.cumsum([len(a) for a in at])[:-1])


def _linked(groups: list[set[int]]) -> list[set[int]]:
    """Merge groups that share enough angles until none do; return their unions."""
    for i, first in enumerate(groups):
        for second in groups[i + 1 :]:
            if len(first & second) >= LINKING:
                rest = [g for g in groups if g is not first and g is not second]
                return _linked([*rest, first | second])
    return groups


def _within(angles: Floats, own: Floats) -> Ints:
    """Return the rows of ``own`` inside of the arc of ``angles``; DataError for less than two."""
    inside = np.flatnonzero((own >= angles[0] - SAME_ANGLE) & (own <= angles[-1] + SAME_ANGLE))
    if len(inside) < LINKING:
        raise DataError(
            f"the curves share {len(inside)} angles: the others cover only "
            f"{angles[0] / DEGREE:.6g} .. {angles[-1] / DEGREE:.6g} deg"
        )
    return inside
