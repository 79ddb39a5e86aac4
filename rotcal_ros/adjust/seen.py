"""What a solution makes of columns of errors: what is left of them, what they do to outputs."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from scipy.sparse import diags_array

from rotcal_ros.adjust.effects import Seen
from rotcal_ros.adjust.fit import Fit
from rotcal_ros.adjust.model import Steps
from rotcal_ros.foundation.arrays import Floats, Ints

AT_A_TIME, FEW = 128, 64
"""Steps that are summed up at once, of themselves and of what they do to all outputs."""
WEAK: Final = 1e-4
"""Information of a size, per that of its errors without the unknowns, below which digits go."""


def columns_of(columns: Floats | Steps, which: slice) -> Floats:
    """Return some of the ``columns`` (n, k), written out."""
    return columns.whole(which) if isinstance(columns, Steps) else columns[:, which]


def seen_by(fit: Fit, columns: Floats | Steps, *, family: bool = False) -> Seen:
    """Return what a solution makes of ``columns`` (n, k) of errors, of a ``family`` or together.

    Of a family, which may have as many columns as there are observations, neighbours alone.
    """
    if isinstance(columns, Steps):
        return _steps_seen_by(fit, columns)
    white = np.where(fit.used[:, None], columns / fit.std[:, None], 0.0)
    if family:
        return _family_seen_by(fit, white)
    left = fit.left_of(white)
    return Seen(fit.moved(white).T, left.T @ left, left.T @ fit.white, (white**2).sum(axis=0))


def _family_seen_by(fit: Fit, white: Floats) -> Seen:
    """Return what a solution makes of whitened columns (n, k), each beside the next."""
    gain, felt = fit.kernel.solve(white), fit.kernel.design.adjoint(white)
    whole = (white**2).sum(axis=0)
    own = whole - (felt * gain).sum(axis=0)
    beside = (white[:, :-1] * white[:, 1:]).sum(axis=0) - (felt[:, :-1] * gain[:, 1:]).sum(axis=0)
    for k in np.flatnonzero(own < WEAK * whole).tolist():  # a small difference of large numbers
        own[k] = (fit.left_of(white[:, k : k + 1]) ** 2).sum()
    information = diags_array([beside, own, beside], offsets=[-1, 0, 1], format="csr")
    return Seen(fit.moved(white).T, information, white.T @ fit.white, whole)


def _steps_seen_by(fit: Fit, steps: Steps) -> Seen:
    """Return what a solution makes of steps, by running sums along each run."""
    moves = StepMoves(fit, steps)
    parts = [np.zeros((4, 0)), *(_run_seen_by(fit, moves.root, *run) for run in steps.runs)]
    own, beside, score, whole = np.concatenate(parts, axis=1)
    ends = np.cumsum([len(first) for _, first in steps.runs])[:-1]
    for end in ends[(ends > 0) & (ends < len(own))].tolist():
        left = fit.left_of(moves.white(slice(end - 1, end + 1)))
        beside[end - 1] = left[:, 0] @ left[:, 1]
    for k in np.flatnonzero(own < WEAK * whole).tolist():  # a small difference of large numbers
        own[k] = (fit.left_of(moves.white(slice(k, k + 1))) ** 2).sum()
    between = beside[:-1]
    information = diags_array([between, own, between], offsets=[-1, 0, 1], format="csr")
    return Seen(moves, information, score, whole)


def _run_seen_by(fit: Fit, root: Floats, rows: Ints, first: Ints) -> Floats:
    """Return of the steps of one run: S of each and of it and the next, u, and whole, (4, m).

    In blocks: of a step, what all later blocks have in common with it is asked of the kernel.
    """
    mine, own, beside = root[rows], np.zeros(len(first)), np.zeros(len(first))
    ends = [*first[AT_A_TIME::AT_A_TIME].tolist(), len(rows)]
    later = np.zeros((len(root), len(ends)))
    for k, end in enumerate(ends):
        later[rows[end:], k] = mine[end:]
    taken = mine[:, None] * fit.kernel.taken_in(later, rows)
    for k, end in enumerate(ends):
        of = slice(k * AT_A_TIME, (k + 1) * AT_A_TIME)
        begin, here = int(first[of][0]) if len(first) else 0, first[of]
        among = fit.kernel.among(rows[begin:end])
        within = _later(_later(mine[begin:end, None] * among * mine[begin:end]).T)
        within = np.pad(within, ((0, 1), (0, 1)))
        shared = np.append(_later(taken[begin:end, k]), 0.0)
        apart = float(taken[end:, k].sum())
        at = here - begin
        after = np.append(at[1:], end - begin)[: len(at)]
        own[of] = within[at, at] + 2.0 * shared[at] + apart
        beside[of] = within[at, after] + shared[at] + shared[after] + apart
    square = _later(mine**2)[first]
    if len(first):
        beside[:-1], beside[-1] = square[1:] - beside[:-1], 0.0
    return np.stack([square - own, beside, _later(mine * fit.white[rows])[first], square])


@dataclass(frozen=True, eq=False)
class StepMoves:
    """What ``steps`` do to the outputs: (k, o + a), too many numbers to be kept."""

    fit: Fit
    steps: Steps

    @cached_property
    def root(self) -> Floats:
        """By what an error is whitened (n,)."""
        return np.where(self.fit.used, 1.0 / self.fit.std, 0.0)

    def white(self, which: slice) -> Floats:
        """Return some columns (n, m), whitened."""
        return np.asarray(self.steps.whole(which) * self.root[:, None])

    def __getitem__(self, which: slice) -> Floats:
        """Return what some columns do, (m, o + a)."""
        return np.asarray(self.fit.moved(self.white(which)).T)

    def worst(self, std: Floats) -> Floats:
        """Return the most (k,) that each does to an output, in their ``std`` (o + a,)."""
        counts, outputs = np.isfinite(std) & (std > 0.0), self.fit.model.counting_outputs
        unit = np.where(counts, 1.0 / np.where(counts, std, 1.0), 0.0)[: len(outputs)]
        found = [np.zeros(0)]
        for rows, first in self.steps.runs:
            most, carried = np.zeros(len(rows)), np.zeros(len(outputs))
            for end in range(len(rows), 0, -FEW):
                part = slice(max(end - FEW, 0), end)
                felt = self.fit.response_of(rows[part], outputs).T[::-1]
                felt *= self.root[rows[part], None][::-1]
                felt[0] += carried
                felt = np.cumsum(felt, axis=0, out=felt)
                carried = felt[-1].copy()
                felt *= unit
                most[part] = np.maximum(felt.max(axis=1), -felt.min(axis=1))[::-1]
            found.append(most[first])
        return np.concatenate(found)


def _later(rows: Floats) -> Floats:
    """Return the sums of each of the ``rows`` (e, ...) and all that come later."""
    return np.cumsum(rows[::-1], axis=0)[::-1]
