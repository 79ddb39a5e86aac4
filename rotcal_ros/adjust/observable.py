"""What a solution makes of columns of errors: what is left of them, what they do to outputs."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Final

import numpy as np

from rotcal_ros.adjust.effects import ObservableEffect, ObservableFamily
from rotcal_ros.adjust.fit import Fit
from rotcal_ros.adjust.model import Disturbing, Steps
from rotcal_ros.adjust.outputs import Outputs
from rotcal_ros.foundation.arrays import Floats, Ints

AT_A_TIME, FEW = 128, 64
"""Steps that are summed up at once, of themselves and of what they do to all outputs."""
MOST_NUMBERS: Final = 100_000
"""Numbers of members of a family that are written out at once (1 MB)."""
WEAK, ROUNDED = 1e-6, 1e-12
"""Information of a size, per that of its errors without the unknowns, below which digits go, and
all of them are gone."""


def dense_columns(columns: Floats | Steps, which: slice) -> Floats:
    """Return some of the ``columns`` (n, k), written out."""
    return columns.whole(which) if isinstance(columns, Steps) else columns[:, which]


def observe_effect(fit: Fit, effect: Disturbing) -> ObservableEffect | ObservableFamily:
    """Return what a solution makes of an ``effect``."""
    if effect not in fit.seen:
        columns = effect.at(fit.computed)
        fit.seen[effect] = (
            observe_family(fit, columns, effect.width)
            if effect.family
            else observe_columns(fit, dense_columns(columns, slice(None)))
        )
    return fit.seen[effect]


def observe_columns(fit: Fit, columns: Floats) -> ObservableEffect:
    """Return what a solution makes of ``columns`` (n, k) of errors that are there together."""
    white = np.where(fit.used[:, None], columns / fit.std[:, None], 0.0)
    left = fit.residuals_of(white)
    return ObservableEffect(
        fit.moved(white).T, left.T @ left, left.T @ fit.white, (white**2).sum(axis=0)
    )


def observe_family(fit: Fit, columns: Floats | Steps, width: int = 1) -> ObservableFamily:
    """Return what a solution makes of ``columns`` (n, k w), of members of so many each."""
    if isinstance(columns, Steps) and not columns.centred and columns.stride == 1:
        return _steps_observable_by(fit, columns)
    parts, count = list[ObservableFamily](), columns.shape[1] // width
    last: list[Floats] | None = None
    some = max(1, min(AT_A_TIME, MOST_NUMBERS // (len(fit.std) * width)))
    for begin in range(0, max(count, 1), some):
        written = dense_columns(columns, slice(begin * width, (begin + some) * width))
        part, last = _part_observable_by(fit, written, width, last)
        parts.append(part)
    moved, own, beside, score, whole = (
        np.concatenate([getattr(part, each.name) for part in parts])
        for each in fields(ObservableFamily)
    )
    return ObservableFamily(moved, own, beside, score, whole)


def _part_observable_by(
    fit: Fit, columns: Floats, width: int, before: list[Floats] | None
) -> tuple[ObservableFamily, list[Floats]]:
    """Return the same of some members beside the last one ``before``, and the last of these.

    Of that its errors, what the unknowns take up and what they see of it, (., 1, w) each.
    """
    white = np.where(fit.used[:, None], columns / fit.std[:, None], 0.0)
    gain, back = fit.kernel.solve(white), fit.kernel.design.transpose_times(white)
    every = [each.reshape(len(each), -1, width) for each in (white, gain, back)]
    mine, solved, adjoint = every
    beside = _products(mine[:, :-1], mine[:, 1:]) - _products(adjoint[:, :-1], solved[:, 1:])
    if before is not None:
        first = _products(before[0], mine[:, :1]) - _products(before[2], solved[:, :1])
        beside = np.concatenate([first, beside])
    own = _products(mine, mine)
    whole = own.diagonal(axis1=1, axis2=2)
    own = own - _products(adjoint, solved)
    _firm_up(fit, own, whole, lambda which: white[:, which])
    moved, score = fit.moved_by(gain, white).T, (white.T @ fit.white).reshape(-1, width)
    last = [each[:, -1:].copy() for each in every]
    return ObservableFamily(moved, own, beside, score, whole), last


def _products(first: Floats, second: Floats) -> Floats:
    """Return the scalar products (k, w, w) of the columns of each of k members, (n, k, w)."""
    return np.asarray(first.transpose(1, 2, 0) @ second.transpose(1, 0, 2))


def _firm_up(fit: Fit, own: Floats, whole: Floats, white: Callable[[Ints], Floats]) -> None:
    """Work out anew what is a small difference of large numbers: ``own`` (k, w, w)."""
    w, scale = own.shape[1], np.sqrt(np.maximum(whole, np.finfo(np.float64).tiny))
    values = np.linalg.eigvalsh(own / scale[:, :, None] / scale[:, None])
    weak = ((values < WEAK) & (values > ROUNDED)).any(axis=1)
    every = np.flatnonzero(weak)
    for some in np.array_split(every, -(-len(every) // FEW)) if len(every) else ():
        columns = (some[:, None] * w + np.arange(w)).ravel()
        left = fit.residuals_of(white(columns)).reshape(len(fit.std), len(some), w).swapaxes(0, 1)
        own[some] = left.swapaxes(1, 2) @ left


def _steps_observable_by(fit: Fit, steps: Steps) -> ObservableFamily:
    """Return what a solution makes of steps, by running sums along each run."""
    moves, w = StepMoves(fit, steps), steps.width
    parts = [_run_observable_by(fit, moves.root, *run) for run in steps.runs]
    own, beside, score, whole = (
        np.concatenate([np.zeros((0, *shape)), *(part[k] for part in parts)])
        for k, shape in enumerate(((w, w), (w, w), (w,), (w,)))
    )
    ends = np.cumsum([len(first) for _, first in steps.runs])[:-1]
    for end in ends[(ends > 0) & (ends < len(own))].tolist():
        left = fit.residuals_of(moves.white(slice((end - 1) * w, (end + 1) * w)))
        beside[end - 1] = left[:, :w].T @ left[:, w:]
    _firm_up(fit, own, whole, moves.white)
    return ObservableFamily(moves, own, beside[:-1], score, whole)


def _run_observable_by(
    fit: Fit, root: Floats, rows: Ints, first: Ints
) -> tuple[Floats, Floats, Floats, Floats]:
    """Return of the steps of one run: S of each, of it and the next, u, and whole; m of each.

    ``root`` (n, w): what each row feels of a unit, whitened. In blocks: of a step, what all later
    blocks have in common with it is asked of the kernel.
    """
    mine, w = root[rows], root.shape[1]
    own, beside = np.zeros((2, len(first), w, w))
    ends = [*first[AT_A_TIME::AT_A_TIME].tolist(), len(rows)]
    for k, end in enumerate(ends):
        if not k % FEW:  # what is written out at once stays small
            many = ends[k : k + FEW]
            later = np.zeros((len(root), len(many), w))
            for j, until in enumerate(many):
                later[rows[until:], j] = mine[until:]
            fitted = fit.kernel.projected_in(later.reshape(len(root), -1), rows)
            taken = fitted.reshape(len(rows), len(many), w)
        of = slice(k * AT_A_TIME, (k + 1) * AT_A_TIME)
        begin, here = int(first[of][0]) if len(first) else 0, first[of]
        among, part = fit.kernel.hat_block(rows[begin:end]), mine[begin:end]
        within = part[:, :, None, None] * among[:, None, :, None] * part
        within = _later(_later(within).transpose(2, 3, 0, 1)).transpose(2, 3, 0, 1)
        within = np.pad(within, ((0, 1), (0, 0), (0, 1), (0, 0)))
        shared = _later(part[:, :, None] * taken[begin:end, k % FEW, None])
        shared = np.concatenate([shared, np.zeros((1, w, w))])
        apart = mine[end:].T @ taken[end:, k % FEW]
        at = here - begin
        after = np.append(at[1:], end - begin)[: len(at)]
        own[of] = within[at, :, at] + shared[at] + shared[at].swapaxes(1, 2) + apart
        beside[of] = within[at, :, after] + shared[at] + shared[after].swapaxes(1, 2) + apart
    square = _later(mine[:, :, None] * mine[:, None])[first]
    if len(first):
        beside[:-1], beside[-1] = square[1:] - beside[:-1], 0.0
    score = _later(mine * fit.white[rows, None])[first]
    return square - own, beside, score, square.diagonal(axis1=1, axis2=2)


@dataclass(frozen=True, eq=False)
class StepMoves:
    """What ``steps`` do to the outputs: (k w, o + a), too many numbers to be kept."""

    fit: Fit
    steps: Steps

    @cached_property
    def root(self) -> Floats:
        """What each row feels of a unit, whitened (n, w)."""
        return np.asarray(
            self.steps.influence * np.where(self.fit.used, 1.0 / self.fit.std, 0.0)[:, None]
        )

    def white(self, which: slice | Ints) -> Floats:
        """Return some columns (n, m), whitened."""
        by = np.where(self.fit.used, 1.0 / self.fit.std, 0.0)
        return np.asarray(self.steps.whole(which) * by[:, None])

    def __getitem__(self, which: slice) -> Floats:
        """Return what some columns do, (m, o + a)."""
        at, w = np.arange(self.steps.shape[1])[which], self.steps.width
        if len(at) <= FEW:
            return np.asarray(self.fit.moved(self.white(which)).T)
        found = np.empty((len(at), len(self.fit.model.output_rows)))
        place = np.full(self.steps.shape[1], -1)
        place[at] = np.arange(len(at))
        for members, influence in self._each(None):
            to = place[members[:, None] * w + np.arange(w)]
            found[to[to >= 0]] = influence[to >= 0]
        return found

    def worst(self, std: Floats, *roots: Floats) -> list[Floats]:
        """Return the most (k,) that combinations of each do to an output, of ``std`` (o + a,).

        As :func:`~.effects.worst_combined_effect`.
        """
        counts, outputs = np.isfinite(std) & (std > 0.0), self.fit.model.counting_outputs
        unit = np.where(counts, 1.0 / np.where(counts, std, 1.0), 0.0)[: len(outputs)]
        found = [np.zeros(len(r)) for r in roots]
        for members, influence in self._each(outputs):
            influence *= unit  # (m, w, o)
            for each, r in zip(found, roots, strict=True):
                if (mine := r[members]).any():
                    along = mine.swapaxes(1, 2) @ influence
                    squares = np.square(along, out=along).sum(axis=1)
                    each[members] = np.sqrt(squares.max(axis=1, initial=0.0))
        return found

    def _each(self, outputs: Outputs | None) -> Iterator[tuple[Ints, Floats]]:
        """Yield some moments (m,), and what moves from them on do to ``outputs``, (m, w, o).

        Sums of what all later rows do; ``outputs`` None: all of them.
        """
        before, o = 0, len(self.fit.model.output_rows if outputs is None else outputs)
        for rows, first in self.steps.runs:
            carried = np.zeros((self.steps.width, o))
            for end in range(len(rows), 0, -FEW):
                part = slice(max(end - FEW, 0), end)
                influence = self.fit.response_of(rows[part], outputs).T[::-1, None]
                influence = influence * self.root[rows[part], :, None][::-1]
                influence[0] += carried
                influence = np.cumsum(influence, axis=0, out=influence)
                carried = influence[-1].copy()
                mine = np.flatnonzero((first >= part.start) & (first < end))
                yield before + mine, influence[end - 1 - first[mine]]
            before += len(first)


def _later(rows: Floats) -> Floats:
    """Return the sums of each of the ``rows`` (e, ...) and all that come later."""
    return np.cumsum(rows[::-1], axis=0)[::-1]
