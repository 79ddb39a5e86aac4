"""What is asked of the unknowns: rows that differ little from one that they share."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
from scipy.sparse import csr_array, vstack

from rotcal_ros.foundation.arrays import Bools, Floats, Ints

AT_ONCE: Final = 1024
"""Rows or columns that are worked out at once: what is dense of them stays small."""


@dataclass(frozen=True, eq=False)
class Outputs:
    """Rows C (o, p) that differ little from one that they share: of many, little is kept.

    ``few`` (o, p) beside the row of ``common`` (g, p) that each belongs to, by ``part`` (o,).
    """

    few: csr_array
    common: Floats
    part: Ints

    @classmethod
    def of(cls, parts: Sequence[Floats]) -> Outputs:
        """Return those of ``parts`` (o, p), one below the other, that share a row each."""
        common = np.zeros((len(parts), parts[0].shape[1]))
        for k, rows in enumerate(parts):
            if len(rows):  # what two of three rows share
                common[k] = np.median(rows[[0, len(rows) // 2, -1]], axis=0)
        few = [csr_array(rows - row) for rows, row in zip(parts, common, strict=True)]
        part = np.repeat(np.arange(len(parts)), [len(rows) for rows in parts])
        return cls(csr_array(vstack(few, format="csr")), common, part)

    def __len__(self) -> int:
        """Return their number o."""
        return len(self.part)

    def first(self, count: int) -> Outputs:
        """Return the first ``count`` of them."""
        return replace(self, few=self.few[:count], part=self.part[:count])

    def times(self, x: Floats) -> Floats:
        """Return C times ``x`` (p + q,) or (p + q, k); the last q unknowns count nothing."""
        x = x[: self.common.shape[1]]
        return np.asarray(self.few @ x + (self.common @ x)[self.part])

    def parts(self, unknowns: int) -> Iterator[tuple[slice, Floats]]:
        """Yield some rows after the other, (r, ``unknowns``) and which they are."""
        more = ((0, 0), (0, unknowns - self.common.shape[1]))
        for begin in range(0, len(self), AT_ONCE):
            here = slice(begin, min(begin + AT_ONCE, len(self)))
            yield here, np.pad(self.few[here].toarray() + self.common[self.part[here]], more)

    def lengths(self, scale: Floats) -> Floats:
        """Return the length (o,) of each, of unknowns times ``scale`` (p + q,)."""
        over = 1.0 / scale[: self.common.shape[1]] ** 2
        mixed = (self.few @ (self.common * over).T)[np.arange(len(self)), self.part]
        common = (self.common**2 @ over)[self.part]
        squares = (self.few * self.few) @ over + 2.0 * mixed + common
        return np.asarray(np.sqrt(np.maximum(squares, 0.0)))

    @cached_property
    def felt(self) -> Bools:
        """Which unknowns (p,) one of them feels."""
        every = [(rows != 0.0).any(axis=0) for _, rows in self.parts(self.common.shape[1])]
        return np.asarray(np.any(every, axis=0))
