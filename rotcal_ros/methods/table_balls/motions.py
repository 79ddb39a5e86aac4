"""What is stated of the table's motions: their sizes, and the orders in which they move.

The balls do not determine all motions at an angle; for those the statement stands. It is weighed
as if each angle moved by itself, so that it leads nothing astray; what it does to the uncertainty
follows from the orders. Of orders that nobody states, each alone, several and white motion are
held to be possible, and of those that fit what the balls show every output keeps the worst: one in
a low order, as those of real axes are, is the same witness at every angle, and passes for an axis
that stands or leans elsewhere.

Whether what is stated of motions, linear axes, tip and bar is true is another matter: of a motion
in one order a ball shows a part, which may be small by chance. What stays unseen of more
(:func:`undetected_motions`) follows from the solution alone, not from what was read.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import isfinite
from typing import TYPE_CHECKING, Final, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np

from rotcal_ros.adjust.distributions import chi2_sf, noise_growth, noncentrality
from rotcal_ros.adjust.effects import UNSEEN, LargestUndetected
from rotcal_ros.adjust.engine import LIMITS, Adjusted
from rotcal_ros.adjust.error_motion import HIGHEST, WHITE, Correlated, Spectrum
from rotcal_ros.adjust.fit import Fit
from rotcal_ros.adjust.model import Model
from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.protection import POWER
from rotcal_ros.methods.table_balls.settings import (
    FALLING,
    STATED,
    WHITE_ONLY,
    BallsSolverSettings,
)

if TYPE_CHECKING:
    from rotcal_ros.methods.table_balls.model import BallsOnTable

MOTION_KINDS: Final = {"radial": (0, 1), "axial": (2,), "tilt": (3, 4)}
"""Motions of one kind by their numbers among the six: EXC and EYC, EZC, EAC and EBC."""
LOWEST: Final = {"radial": 2, "axial": 1, "tilt": 2}
"""Lowest order that is no part of the definition of the axis, but for what EXC and EYC, or EAC and
EBC, have of the first order against the turn."""
EXCEEDED: Final = 5.0
"""Times as large as stated that something may be without striking anybody."""
FACTORS: Final = np.geomspace(0.05, 1000.0, 80)
"""Sizes of motions, per stated, that are tried."""
SILENT: Final = 1e-9
"""Share of the largest variance of what is shown below which another is none."""
SINGLE: Final = 6
"""Order up to which a motion may be in one alone; above, one passes for no other axis."""
HIDDEN: Final = 0.6
"""Share of a motion that may be in its lowest order, which passes for another axis."""
ORDERS: Final = 36
"""Highest order in which motions are compared."""
SHOWN: Final = 1e-3
"""Square of motions, per that of noise, below which nothing shows them."""
SMALLER: Final = (0.2, 0.5, 1.0)
"""Sizes of motions, per stated, at which ways to move are compared: a statement is generous."""
LIKELY: Final = 0.002
"""Likelihood, per that of the best, from which on a way to move is possible: by simulation, as
research/ball_coverage.py does. The truth is rarely below, and what is far from it mostly."""


def possible_spectra(solver: BallsSolverSettings) -> dict[str, tuple[Spectrum, ...]]:
    """Return the spectra that are possible of each kind of motion."""
    sizes = {
        "radial": solver.radial_orders, "axial": solver.axial_orders, "tilt": solver.tilt_orders
    }  # fmt: skip
    if solver.error_motion_orders == WHITE_ONLY:
        return dict.fromkeys(MOTION_KINDS, (WHITE,))
    if solver.error_motion_orders == FALLING:
        return {kind: (Spectrum.falling(LOWEST[kind]),) for kind in MOTION_KINDS}
    if solver.error_motion_orders == STATED:
        return {kind: (Spectrum.of_sizes(sizes[kind]),) for kind in MOTION_KINDS}
    return {kind: tuple(_any(lowest)) for kind, lowest in LOWEST.items()}


def _any(lowest: int) -> Iterator[Spectrum]:
    """Yield white, single orders, several, and such with most of it in the ``lowest``."""

    def alike(first: int, last: int) -> Spectrum:
        return Spectrum.of_sizes((np.arange(1, last + 1) >= first).tolist())

    hidden = Spectrum((lowest,), (1.0,))
    yield from Spectrum.one_each(SINGLE)
    yield from (alike(lowest, 4), alike(lowest, HIGHEST), Spectrum.falling(lowest))
    for rest in (WHITE, alike(lowest + 1, lowest + 1), alike(lowest + 2, lowest + 2),
                 alike(lowest + 1, HIGHEST)):  # fmt: skip
        yield Spectrum.mean({hidden: HIDDEN, rest: 1.0 - HIDDEN})


def motion_columns(spectrum: Spectrum, angles: Floats, tilts: int) -> Iterator[Floats]:
    """Yield columns (t p, r) of a motion of size 1 at the ``angles`` (p,) of all ``tilts``.

    Of its own at every tilt and, in orders, the same at all: what a bearing does when it turns
    does not know how it lies.
    """
    once = spectrum.root(angles)
    yield np.asarray(np.kron(np.eye(tilts), once), dtype=np.float64)
    if tilts > 1 and spectrum.orders:
        yield np.tile(once, (tilts, 1))


class Contradiction(NamedTuple):
    """Motions of a ``kind`` are ``factor`` times as large as stated, with this ``probability``.

    That is: how probably they are what is shown, were the statement true.
    """

    kind: str
    factor: float
    probability: float


@dataclass(frozen=True, eq=False)
class StatedMotions(Correlated):
    """What the errors of statements have in common that hold of the table's motions.

    ``rows`` and ``parts`` as of :class:`~.error_motion.Correlated`, a part for each kind of
    motion. ``stated`` (6,): sizes of the motions, m and rad; ``ways``: columns (6 t p, r) of them
    in each possible way, by kind; ``first``: where they are among the unknowns. ``angles`` (p,).
    """

    stated: Floats
    ways: Mapping[str, tuple[Floats, ...]]
    first: int
    angles: Floats

    @classmethod
    def of(
        cls,
        rows: Floats,
        before: int,
        sums: Floats,
        stated: Floats,
        angles: Floats,
        tilts: int,
        possible: Mapping[str, tuple[Spectrum, ...]],
        first: int,
    ) -> StatedMotions:
        """Return that of statements whose rows follow ``before`` others.

        ``rows`` (k, 6 t p): what each takes of the motions, per standard deviation; ``sums``
        (d, 6 t p): what is zero by definition; ``possible``: spectra of each kind.
        """
        basis, count = np.linalg.qr(sums.T)[0], tilts * len(angles)
        every, parts = dict[str, tuple[Floats, ...]](), list[tuple[Floats, ...]]()
        for kind, numbers in MOTION_KINDS.items():
            each = [
                way
                for spectrum in possible[kind]
                for way in motion_columns(spectrum, angles, tilts)
            ]
            width = len(numbers) * np.array([way.shape[1] for way in each])
            found = np.zeros((6, count, width.sum()))
            ends = np.cumsum(width)[:-1]
            for way, here in zip(each, np.split(np.arange(width.sum()), ends), strict=True):
                for number, columns in zip(numbers, np.split(here, len(numbers)), strict=True):
                    found[number, :, columns] = stated[number] * way.T
            flat = found.reshape(6 * count, -1)
            flat -= basis @ (basis.T @ flat)
            every[kind] = tuple(np.split(flat, ends, axis=1))
            parts.append(tuple(np.split(rows @ flat, ends, axis=1)))
        at = before + np.arange(len(rows))
        return cls(at, tuple(parts), stated, every, first, angles)

    def possible(self, fit: Fit) -> Bools:
        """Return which ways to move (w, v, u), of each kind one, fit what the balls show.

        Of the motions order by order, as if these were independent, which they are where angles
        are even and complete; by the likelihood of each per that of the best.
        """
        moved, gain, noise = self._moved(fit)
        if len(moved) > len(self.stated) * len(self.angles):
            return super().possible(fit)  # several tilts, each of which may move by itself
        scale, merit = np.repeat(self.stated, len(self.angles))[:, None], np.zeros(())
        ways = [[way / scale for way in each] for each in self.ways.values()]
        known = gain[:, self.rows]
        for order in range(min(ORDERS, len(self.angles) // 2) + 1):
            wave = _waves(order, self.angles)
            white = _white(_along(wave, noise))
            influence, columns = white @ _along(wave, known), list[list[Floats]]()
            for both in zip(ways, self.parts, strict=True):
                each = zip(*both, strict=True)
                columns.append([white @ _along(wave, w) - influence @ root for w, root in each])
            size, axes = np.linalg.eigh(sum(_square(c) for each in columns for c in each))
            shown = axes[:, size > SHOWN].T
            squares = [np.array([_square(shown @ c) for c in each]) for each in columns]
            merit = merit + _log_likelihood(shown @ white @ _along(wave, moved)[:, 0], squares)
        best = merit.max(axis=0)
        return np.asarray(best >= best.max() + np.log(LIKELY))

    def contradictions(self, fit: Fit) -> Iterator[Contradiction]:
        """Yield of each kind of motion how what is shown of it fits its statement.

        Each way to move is weighed by how well it fits at the size that suits it best; the rest
        of its directions, which noise rules, say nothing.
        """
        for kind, each in self._shown(fit).items():
            yield _contradiction(kind, each)

    def found_from(self, fit: Fit) -> Iterator[Floats]:
        """Yield of each kind of motion how many times (w,) as large as stated each way is found.

        With a probability of POWER by :meth:`contradictions`; infinite where nothing shows it.
        """
        each = LIMITS.significance / len(MOTION_KINDS)
        for shown in self._shown(fit).values():
            rules = [int((grown > 1.0).sum()) for grown, _ in shown]
            yield np.array([np.sqrt(noise_growth(each, POWER, n)) if n else np.inf for n in rules])

    def _shown(self, fit: Fit) -> dict[str, list[tuple[Floats, Floats]]]:
        """Return of each way of each kind its variances along axes (a,), and the squares shown.

        Both per variance of the noise.
        """
        if fit in self._looked:
            return self._looked[fit]
        value, gain, noise = self._moved(fit)
        known, count = gain[:, self.rows], len(value) // 6
        scale = np.repeat(self.stated, count)
        per_way = [
            np.concatenate([
                way / scale[:, None] - known @ root
                for way, root in zip(both, roots, strict=True)
            ], axis=1)
            for both, roots in zip(zip(*self.ways.values(), strict=True),
                                   zip(*self.parts, strict=True), strict=True)
        ]  # fmt: skip
        found = dict[str, list[tuple[Floats, Floats]]]()
        for kind, numbers in MOTION_KINDS.items():
            own = np.isin(np.repeat(np.arange(6), count), numbers)
            white = _white(noise[own])
            shown = white @ value[own]
            found[kind] = [_along_axes(white @ way[own], shown) for way in per_way]
        self._looked[fit] = found
        return found

    def _moved(self, fit: Fit) -> tuple[Floats, Floats, Floats]:
        """Return motions (6 t p,), what whitened errors do to them, and what those of readings do.

        Per stated size of each.
        """
        count = len(next(iter(self.ways.values()))[0])
        motions = slice(self.first, self.first + count)
        scale = np.repeat(self.stated, count // 6)
        gain = fit.gain(motions) / scale[:, None]
        return fit.x[motions] / scale, gain, np.delete(gain, self.rows, axis=1)

    @cached_property
    def _looked(self) -> WeakKeyDictionary[Fit, dict[str, list[tuple[Floats, Floats]]]]:
        """What :meth:`_shown` returned: it is asked twice."""
        return WeakKeyDictionary()


def stated_motions_of(model: Model) -> Iterator[StatedMotions]:
    """Yield what is stated of motions; nothing where balls determine all of them."""
    yield from (each for each in model.correlated if isinstance(each, StatedMotions))


def undetected_motions(balls: BallsOnTable, found: Adjusted) -> dict[str, LargestUndetected]:
    """Return what may stay unseen of each kind of motion that is stated, and of each other block.

    A motion is found by what the balls show of it, see
    :meth:`~.motions.StatedMotions.contradictions`, all else by chi-squared; where motions are
    stated too, they explain whatever that would find.
    """
    fit, model, outputs = found.fit, found.model, len(found.value)
    std = found.counting_std[:outputs]
    counts, last = std > 0.0, len(model.components) - 1
    row, worst = int(np.argmax(model.of_component == last)), dict[str, LargestUndetected]()

    def share(rows: slice) -> Floats:
        return np.asarray(
            fit.alone(np.arange(rows.start, rows.stop))[:outputs][counts] / std[counts, None]
        )

    for together in stated_motions_of(model):
        every = slice(row, row + len(together.rows))
        influence, row = share(every), every.stop
        sizes = together.found_from(fit)
        for kind, roots, size in zip(MOTION_KINDS, together.parts, sizes, strict=True):
            moved = [np.linalg.norm(influence @ root, axis=1).max(initial=0.0) for root in roots]
            worst[kind] = LargestUndetected.worst(size, np.array(moved), EXCEEDED)
    needed = noncentrality(LIMITS.significance, POWER, max(fit.dof, 1))
    for name in (name for name, std in balls.known.items() if isfinite(std)):
        block = slice(row, row + balls.blocks[name])
        left, row = fit.redundancy[block], block.stop
        checked = (left > UNSEEN) & (not model.correlated)
        size = np.where(checked, np.sqrt(needed / np.where(checked, left, 1.0)), np.inf)
        does = share(block)
        error = np.linalg.norm(np.minimum(size, EXCEEDED) * does, axis=1).max(initial=0.0)
        feels = np.abs(does).max(axis=0, initial=0.0) > UNSEEN
        worst[name] = LargestUndetected(float(error), bool((size <= EXCEEDED)[feels].all()))
    return worst


def _waves(order: int, angles: Floats) -> Floats:
    """Return orthonormal rows (1 or 2, n) of what undulates so often in a turn."""
    phase = order * angles
    _, size, rows = np.linalg.svd(np.array([np.cos(phase), np.sin(phase)]), full_matrices=False)
    return np.asarray(rows[size > SILENT * size[0]])


def _log_likelihood(value: Floats, squares: Sequence[Floats]) -> Floats:
    """Return that (f, w, v, ...) of a ``value`` (m,) with white noise of 1 and a way of each part.

    ``squares``: covariances (w, m, m) of the ways of each part, which are as large as stated; at
    each of the sizes :data:`SMALLER`. Up to what all have in common.
    """
    m, which = len(value), list[Ints]()
    bordered = np.zeros((1, m + 1, m + 1))
    for each in squares:
        does = np.trace(each, axis1=1, axis2=2) > SILENT  # the others are the same here: nothing
        which.append(np.where(does, np.cumsum(does), 0))
        more = np.zeros((1 + int(does.sum()), m + 1, m + 1))
        more[1:, :m, :m] = each[does]
        bordered = bordered[..., None, :, :] + more
    own, found = np.eye(m + 1), []
    own[m, :m], own[m, m] = value, 1.0 + value @ value
    for size in SMALLER:  # the last pivot of Cholesky's factor shows the square, whitened
        pivots = np.linalg.cholesky(own + size**2 * bordered[0]).diagonal(axis1=-2, axis2=-1)
        merit = 0.5 * pivots[..., m] ** 2 - np.log(pivots[..., :m].prod(axis=-1))
        found.append(merit[np.ix_(*which)])
    return np.array(found)


def _square(columns: Floats) -> Floats:
    return np.asarray(columns @ columns.T)


def _along(wave: Floats, motions: Floats) -> Floats:
    """Return what five of six ``motions`` (6 p, k) are along a ``wave`` (w, p), (5 w, k).

    Nothing is stated of ECC, the last one.
    """
    each = motions.reshape(6, wave.shape[1], -1)[:5]
    return np.asarray((wave @ each).reshape(5 * len(wave), -1))


def _white(noise: Floats) -> Floats:
    """Return rows (k, m) that make errors with the root ``noise`` (m, n) white, but for none."""
    size, axes = np.linalg.eigh(noise @ noise.T)
    kept = size > SILENT * max(size[-1], np.finfo(np.float64).tiny)
    return np.asarray((axes[:, kept] / np.sqrt(size[kept])).T)


def _along_axes(way: Floats, value: Floats) -> tuple[Floats, Floats]:
    """Return the variances (a,) of a way (m, r) to move, and what a ``value`` (m,) has of each.

    Squared.
    """
    wide = len(way) < way.shape[1]
    size, axes = np.linalg.eigh(way @ way.T if wide else way.T @ way)
    kept = size > SILENT * max(size[-1], np.finfo(np.float64).tiny)
    size, axes = size[kept], axes[:, kept]
    along = axes if wide else way @ (axes / np.sqrt(size))
    return size, (along.T @ value) ** 2


def _contradiction(kind: str, ways: Sequence[tuple[Floats, Floats]]) -> Contradiction:
    """Return how what is shown fits each of the ways, as :func:`_along_axes` returns them."""
    merit, chance, factor = np.zeros((3, len(ways)))
    for k, (grown, squares) in enumerate(ways):
        ruled = 1.0 + np.multiply.outer(FACTORS**2, grown)
        fits = -0.5 * (np.log(ruled) + squares / ruled - squares).sum(axis=1)
        merit[k], factor[k] = fits.max(), FACTORS[fits.argmax()]
        if (rules := grown > 1.0).any():
            square = float((squares / (1.0 + grown))[rules].sum())
            chance[k] = chi2_sf(square, int(rules.sum()))
        else:
            chance[k] = 1.0
    weight = np.exp(merit - merit.max())
    weight /= weight.sum()
    size_of = float(np.sqrt(weight @ factor**2))
    return Contradiction(kind, size_of, float(weight @ chance))
