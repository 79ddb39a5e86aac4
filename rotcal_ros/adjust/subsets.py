"""Which elements of a group may be wrong together: sectors, neighbourhoods, stretches.

A disturbance gathers: warm air lies in a sector of directions, a loose ball plate touches
neighbours, a knock lasts for a while. Such subsets are few and are tried all; any other subset is
searched for (:mod:`.explanations`).
"""

from __future__ import annotations

from functools import lru_cache
from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Bools, Floats, Ints

LEAST: Final = 2
"""Elements that gather: one alone is an outlier, and screening's."""
GROWTH: Final = 1.2
"""From one number of elements that are tried to the next."""
OVERLAP: Final = 8
"""Part of a subset by which it is moved to the next place."""
LARGEST_SHARE: Final = 0.5
"""Share of a group that may be wrong together; of more, the others are held to be."""


def largest_wrong_count(size: int) -> int:
    """Return how many of ``size`` elements may be wrong together."""
    return int(LARGEST_SHARE * size)


def _sizes(size: int) -> Ints:
    """Return how many of ``size`` elements are tried to be wrong together.

    Every number of few; of many, each is at least GROWTH times the one before: one that lies
    between explains nearly as much, and what is blamed is polished.
    """
    found = [LEAST]
    while found[-1] < largest_wrong_count(size):
        found.append(max(found[-1] + 1, int(GROWTH * found[-1])))
    return np.array(
        [
            min(number, largest_wrong_count(size))
            for number in found
            if largest_wrong_count(size) >= LEAST
        ]
    )


def _step(size: int) -> int:
    """Return from one place of subsets of so many elements to the next."""
    return max(1, size // OVERLAP)


def neighbourhoods(places: Floats) -> Bools:
    """Return each element's nearest ones, (q, e), for ``places`` (e, d) of the elements.

    Unit vectors for directions. From LEAST to LARGEST_SHARE of the elements, each set once.
    """
    return distinct_subsets(neighbourhoods_of_each(places[None])[0])


def neighbourhoods_of_each(places: Floats) -> Bools:
    """Return those (g, q, e), repeats too, of groups of as many elements, ``places`` (g, e, d)."""
    g, e = places.shape[:2]
    apart = np.linalg.norm(places[:, :, None] - places[:, None], axis=3)
    nearest = np.argsort(apart, axis=2, kind="stable")
    rank = np.empty((g, e, e), dtype=np.int64)
    np.put_along_axis(rank, nearest, np.broadcast_to(np.arange(e), (g, e, e)), axis=2)
    parts = [rank[:, :: _step(size)] < size for size in _sizes(e).tolist()]
    return np.concatenate([np.zeros((g, 0, e), dtype=np.bool_), *parts], axis=1)


def contiguous_runs(along: Floats, closed: bool = False) -> Bools:
    """Return unbroken runs (..., q, e) of elements in the order of ``along`` (..., e), as of time.

    ``closed``: the last is followed by the first, as of directions round a circle.
    """
    rank = np.argsort(np.argsort(along, kind="stable"), kind="stable")
    return np.moveaxis(_runs(along.shape[-1], closed)[:, rank], 0, -2)


@lru_cache(maxsize=64)
def _runs(e: int, closed: bool) -> Bools:
    """Return the runs of e elements that are in order."""
    place, found = np.arange(e), [np.zeros((0, e), dtype=np.bool_)]
    for size in _sizes(e).tolist():
        first = np.arange(0, e if closed else e - size + 1, _step(size))[:, None]
        found.append((place - first) % e < size)
    return distinct_subsets(np.concatenate(found))


def run_bounds(subsets: Bools) -> tuple[Ints, Ints, Bools]:
    """Return the first element of each of ``subsets`` (q, e), the one after its last, both (q,).

    And whether it is a run of neighbours: all between them.
    """
    e = subsets.shape[1]
    first, end = subsets.argmax(axis=1), e - np.argmax(subsets[:, ::-1], axis=1)
    return first, end, np.asarray(subsets.sum(axis=1) == end - first)


def distinct_subsets(*subsets: Bools) -> Bools:
    """Return all ``subsets`` (q, e), each once."""
    return distinct_of_each(np.concatenate(subsets)[None])[0]


def distinct_of_each(subsets: Bools) -> list[Bools]:
    """Return the ``subsets`` (g, q, e) of each group, each once."""
    return [some[first] for some, first in zip(subsets, _first_of_each(subsets), strict=True)]


def _first_of_each(subsets: Bools) -> Bools:
    """Return which of the ``subsets`` (g, q, e) are the first of their kind in a group, (g, q)."""
    bits = np.packbits(subsets, axis=2)
    words = np.pad(bits, ((0, 0), (0, 0), (0, -bits.shape[2] % 8))).view(np.uint64)
    order = np.lexsort(np.moveaxis(words, 2, 0), axis=1)  # it is stable
    ordered = np.take_along_axis(words, order[:, :, None], axis=1)
    first = np.ones(order.shape, dtype=np.bool_)
    first[:, 1:] = (ordered[:, 1:] != ordered[:, :-1]).any(axis=2)
    found = np.empty_like(first)
    np.put_along_axis(found, order, first, axis=1)
    return found
